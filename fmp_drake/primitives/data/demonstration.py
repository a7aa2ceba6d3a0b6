"""Recorded demonstrations, and their files."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from fmp_drake.errors import DemonstrationError, SkillFileError
from fmp_drake.numeric import GREATEST, as_floats, check_number
from fmp_drake.primitives.data.file_format import FileFormat
from fmp_drake.primitives.data.files import replaced

if TYPE_CHECKING:
    from fmp_drake.primitives.data.reading.reading_options import ReadingOptions

FORMAT = FileFormat(
    name="fmp-drake-demonstration",
    version=1,
    what="demonstration",
    source="an .npz with `time` and `values` or `position`, a table (.csv), a bag ...",
)

_MAX_GAP_SECONDS = 0.5
_UNIFORM = 1e-3
NAMES = ("channels", "units", "frame", "note", "rotation_reference")

# A rotation vector, rad; see `fmp_drake.primitives.editing.orientation`.
ROTATION_CHANNELS = ("rx", "ry", "rz")


@dataclass(frozen=True, kw_only=True, eq=False)
class Demonstration:
    """One recording of one or several channels over time.

    The arrays are checked once and read-only afterwards, so that all that learns from
    them may rely on them.

    Attributes
    ----------
    time : ndarray, shape (N,)
        Seconds, strictly increasing.
    values : ndarray, shape (N, D)
        The channels, by default the position of the end effector in metres.
    channels : tuple of str
        Name of each channel.
    units : tuple of str
        Unit of each channel.
    frame : str
        Name of the frame the values are expressed in; "" where unknown.
    note : str
        Where the recording comes from.
    rotation_reference : tuple of float, optional
        Unit quaternion (x, y, z, w) of the rotation at which the rotation channels `rx`,
        `ry` and `rz` are 0; None where there are none. See `add_orientation`.

    Raises
    ------
    DemonstrationError
        Where the arrays do not fit together, hold NaN, or time does not increase.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0, 10, 0.01)
    >>> circle = 0.1 * np.column_stack([np.cos(time), np.sin(time)])
    >>> demonstration = Demonstration(time=time, values=circle, frame="board")
    >>> demonstration.channels, demonstration.units
    (('x', 'y'), ('m', 'm'))
    >>> demonstration.resample(20.0).values.shape
    (200, 2)
    """

    time: NDArray[np.float64]
    values: NDArray[np.float64]
    channels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    frame: str = ""
    note: str = field(default="", repr=False)
    rotation_reference: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check everything once, so that later code may rely on it."""
        time, values = (
            as_floats(getattr(self, name), name, error=DemonstrationError).copy()
            for name in ("time", "values")
        )
        if values.ndim == 1:
            values = values[:, None]
        if time.ndim != 1 or values.ndim != 2 or len(time) != len(values):
            raise DemonstrationError(
                f"time has shape {time.shape} and values {values.shape}; expected "
                "(N,) and (N, channels)."
            )
        if len(time) < 4 or values.shape[1] == 0:
            raise DemonstrationError(
                f"the demonstration has {len(time)} samples of {values.shape[1]} "
                "channels; at least 4 samples of 1 channel are needed."
            )
        for name, array in (("time", time), ("values", values)):
            bad = ~(np.abs(array) < GREATEST)
            if np.any(bad):
                row = int(np.argwhere(bad)[0][0])
                raise DemonstrationError(
                    f"{name} holds {int(np.sum(bad))} NaN or infinite numbers (or some "
                    f"above {GREATEST:g}), the first in sample {row}; remove or fill "
                    "them."
                )
        steps = np.diff(time)
        if np.any(steps <= 0):
            row = int(np.argmax(steps <= 0))
            raise DemonstrationError(
                f"time does not increase after sample {row} ({time[row]:g} s, then "
                f"{time[row + 1]:g} s); it must increase strictly."
            )
        d = values.shape[1]
        for name, nominal in (("channels", default_channels(d)), ("units", ("m",) * d)):
            given = _names(name, getattr(self, name))
            object.__setattr__(self, name, given or nominal)
        if len(self.channels) != d or len(self.units) != d:
            raise DemonstrationError(
                f"{len(self.channels)} channel names and {len(self.units)} units for "
                f"{d} channels; give one of each per channel."
            )
        if len(set(self.channels)) != d:
            raise DemonstrationError(
                f"the channel names {self.channels} repeat; make them unique."
            )
        if self.rotation_reference is not None:
            reference = _unit_quaternion(self.rotation_reference, self.channels)
            object.__setattr__(self, "rotation_reference", reference)
        time.setflags(write=False)
        values.setflags(write=False)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "values", values)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return float(self.time[-1] - self.time[0])

    @property
    def n_channels(self) -> int:
        """The number of channels D."""
        return self.values.shape[1]

    def is_uniform(self, rate: float) -> bool:
        """Return whether the samples are spaced 1/rate apart, to a thousandth."""
        return bool(np.all(np.abs(np.diff(self.time) * rate - 1) < _UNIFORM))

    def resample(self, rate: float) -> "Demonstration":
        """Return the demonstration, sampled uniformly at another rate.

        It is low-pass filtered (zero phase, at 0.4 of the new rate) where the recording
        is more than twice as fast, and interpolated by a cubic spline.

        Parameters
        ----------
        rate : float
            Samples per second (Hz).

        Raises
        ------
        DemonstrationError
            Where a gap between samples is too long to interpolate.
        """
        check_number(rate, "rate", above=0.0, unit="Hz", error=DemonstrationError)
        if self.is_uniform(rate):
            return self
        steps = np.diff(self.time)
        widest = int(np.argmax(steps))
        allowed = max(_MAX_GAP_SECONDS, 2 / rate)
        if steps[widest] > allowed:
            raise DemonstrationError(
                f"there is a gap of {steps[widest]:.3g} s after "
                f"{self.time[widest]:.3g} s; the longest that can be interpolated is "
                f"{allowed:g} s. Cut the recording there into two demonstrations."
            )
        native = 1 / float(np.median(steps))
        count = int(np.floor(self.duration * rate * (1 + 1e-9))) + 1
        if count < 2:
            raise DemonstrationError(
                f"the demonstration lasts {self.duration:.3g} s; at {rate:g} Hz that "
                "is fewer than 2 samples."
            )
        values: NDArray[np.float64] = self.values
        time: NDArray[np.float64] = self.time
        if native > 2 * rate:
            uniform = np.arange(time[0], time[-1], 1 / native)
            values = CubicSpline(time, values)(uniform)
            time = uniform
            from scipy.signal import butter, sosfiltfilt  # Slow to import.

            sos = butter(4, 0.4 * rate, fs=native, output="sos")
            pad = min(len(values) - 1, 3 * int(np.ceil(native / rate)))
            values = sosfiltfilt(sos, values, axis=0, padlen=pad)
        new = self.time[0] + np.arange(count) / rate
        return replace(
            self, time=new - self.time[0], values=CubicSpline(time, values)(new)
        )

    def select(self, channels: ArrayLike) -> "Demonstration":
        """Return the demonstration with only the named channels, in that order.

        Without all three rotation channels there is no rotation reference either.
        """
        names = [str(name) for name in np.asarray(channels).ravel()]
        missing = [name for name in names if name not in self.channels]
        if missing:
            raise DemonstrationError(
                f"there is no channel {missing[0]!r}; the channels are "
                f"{', '.join(self.channels)}."
            )
        index = [self.channels.index(name) for name in names]
        has_rotation = set(ROTATION_CHANNELS) <= set(names)
        return replace(
            self,
            values=self.values[:, index],
            channels=tuple(names),
            units=tuple(self.units[i] for i in index),
            rotation_reference=self.rotation_reference if has_rotation else None,
        )

    def save(self, path: str | Path) -> None:
        """Write the demonstration to an `.npz` or `.csv` file, by its name.

        A `.csv` has no place for the frame, and is refused for rotation channels, which
        mean nothing without their reference.
        """
        path = Path(path)
        if path.suffix == ".csv":
            self._save_csv(path)
            return
        metadata = {name: getattr(self, name) for name in NAMES}
        FORMAT.write(path, metadata, {"time": self.time, "values": self.values})

    def _save_csv(self, path: Path) -> None:
        if self.rotation_reference is not None:
            raise SkillFileError(
                f"cannot write {path}: a .csv has no place for the reference of the "
                "rotation channels; save an .npz."
            )
        names = zip(self.channels, self.units, strict=True)
        with (
            replaced(path, SkillFileError) as part,
            part.open("w", newline="", encoding="utf-8") as stream,
        ):
            writer = csv.writer(stream)
            writer.writerow(["time [s]", *(f"{n} [{u}]" for n, u in names)])
            for t, row in zip(self.time, self.values, strict=True):
                writer.writerow([repr(float(t)), *(repr(float(v)) for v in row)])

    @classmethod
    def load(
        cls, path: str | Path, options: "ReadingOptions | None" = None
    ) -> "Demonstration":
        """Read a demonstration from a file; `read_demonstrations` says of which kinds.

        What was recognised in it is in the `note`.

        Parameters
        ----------
        path : str or Path
        options : ReadingOptions, optional
            What the file does not say: columns, unit, rate, topic.

        Raises
        ------
        SkillFileError
            Where the file is missing, broken or of another kind.
        DemonstrationError
            Where its numbers cannot be used, or it holds several demonstrations.
        """
        # The readers make demonstrations.
        from fmp_drake.primitives.data.recordings import read_demonstrations

        found, _ = read_demonstrations([path], options)
        if len(found) != 1:
            raise DemonstrationError(
                f"{path} holds {len(found)} demonstrations; read them with "
                "`read_demonstrations`."
            )
        return found[0]


def default_channels(count: int) -> tuple[str, ...]:
    """Return the names of channels that have none: x, y, z, or c0, c1 and so on."""
    return tuple("xyz"[:count]) if count <= 3 else tuple(f"c{i}" for i in range(count))


def _names(what: str, given: Any) -> tuple[str, ...]:
    """Return names of channels or units as a tuple."""
    if isinstance(given, Sequence) and not isinstance(given, str):
        names = tuple(given)
        if all(isinstance(name, str) for name in names):
            return names
    raise DemonstrationError(f"{what} is {given!r}; expected one name per channel.")


def _unit_quaternion(
    reference: Any, channels: tuple[str, ...]
) -> tuple[float, float, float, float]:
    try:
        x, y, z, w = (float(q) for q in reference)
    except (TypeError, ValueError):
        x, y, z, w = (np.nan,) * 4
    length = float(np.linalg.norm([x, y, z, w]))
    if not abs(length - 1) < 1e-6:
        raise DemonstrationError(
            f"rotation_reference is {reference}; expected a unit quaternion (x, y, z, w)."
        )
    missing = set(ROTATION_CHANNELS) - set(channels)
    if missing:
        raise DemonstrationError(
            f"there is a rotation reference but no channel {min(missing)}; add the "
            "rotation channels with `add_orientation`."
        )
    if abs(length - 1) > 1e-12:  # Else as it is: files have to give back the same.
        x, y, z, w = x / length, y / length, z / length, w / length
    return (x, y, z, w)
