"""Recorded demonstrations, and reading and writing of their files."""

import csv
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError, SkillFileError
from fmp_drake.numeric import (
    GREATEST,
    Array,
    as_floats,
    as_path,
    as_paths,
    check_number,
    check_type,
    read_only,
)
from fmp_drake.primitives.data.channels import (
    POSITION_CHANNELS,
    QUATERNION_CHANNELS,
    ROTATION_CHANNELS,
    Quaternion,
    channel_indices,
    default_channels,
)
from fmp_drake.primitives.data.files import replaced
from fmp_drake.primitives.data.orientation import (
    QuaternionOrder,
    RotationRangeError,
    as_rotation,
    mean_rotation,
    rotation_vectors,
    rotations_of,
    unit_quaternion,
)
from fmp_drake.primitives.data.reading.arrays import FORMAT, METADATA
from fmp_drake.primitives.data.reading.columns import recognise_columns
from fmp_drake.primitives.data.reading.kinds import read_tables
from fmp_drake.primitives.data.reading.parts import joined_parts
from fmp_drake.primitives.data.reading.table import LONGEST_GAP, ReadingOptions, Table

_LEAST_SAMPLES = 4
_UNIFORM = 1e-3
# Ratio of the step at a gap to the median step.
_GAP = 2.5
# Remarks on how an orientation was read.
_READING = re.compile(" read as | are taken for ")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Demonstration:
    """Recording of one or several channels over time.

    The arrays are checked once and read-only afterwards.

    Attributes
    ----------
    time : ndarray, shape (N,)
        Seconds, strictly increasing; dates (datetime64) become seconds from the first.
    values : ndarray, shape (N, D)
        The channels, by default the position of the end effector, m.
    channels : tuple of str
        Name of each channel.
    units : tuple of str
        Unit of each channel.
    frame : str
        Name of the frame of the values; "" where unknown.
    note : str
        Origin of the recording.
    rotation_reference : tuple of float, optional
        Unit quaternion (x, y, z, w) of the rotation at which the rotation channels `rx`,
        `ry` and `rz` are 0; None without rotation channels. See `add_orientation`.

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

    time: Array
    values: Array
    channels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    frame: str = ""
    note: str = ""
    rotation_reference: Quaternion | None = None

    def __post_init__(self) -> None:
        """Check the arrays, and make them read-only."""
        dates: Any = self.time
        if getattr(getattr(dates, "dtype", None), "kind", "") == "M":
            dates = np.asarray(dates)
            seconds = (dates - dates[:1]) / np.timedelta64(1, "s")
            object.__setattr__(self, "time", seconds)
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
                + " Give values.T."
                * (values.T.shape[:1] == time.shape)
            )
        if len(time) < _LEAST_SAMPLES or values.shape[1] == 0:
            raise DemonstrationError(
                f"the demonstration has {len(time)} samples of {values.shape[1]} "
                f"channels; at least {_LEAST_SAMPLES} samples of 1 channel are needed."
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
        for name, default in (("channels", default_channels(d)), ("units", ("m",) * d)):
            names = _names(name, getattr(self, name))
            object.__setattr__(self, name, names or default)
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
            reference = _checked_reference(self.rotation_reference, self.channels)
            object.__setattr__(self, "rotation_reference", reference)
        object.__setattr__(self, "time", read_only(time))
        object.__setattr__(self, "values", read_only(values))

    def __repr__(self) -> str:
        """Return channels, number of samples and duration."""
        named = zip(self.channels, self.units, strict=True)
        channels = ", ".join(f"{channel} ({unit})" for channel, unit in named)
        return f"<Demonstration: {channels}; {len(self.time)} samples in {self.duration:.4g} s>"

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    def is_uniform(self, rate: float) -> bool:
        """Return whether the samples are spaced 1/rate apart, to a thousandth."""
        return bool(np.all(np.abs(np.diff(self.time) * rate - 1) < _UNIFORM))

    def resample(self, rate: float) -> "Demonstration":
        """Return the demonstration at another, uniform sample rate.

        It begins at the same time and is interpolated by a cubic spline. A recording at more
        than twice the new rate is low-pass filtered first (zero phase, at 0.4 of the new
        rate). Samples in bursts, and those of a fast recording with gaps, are averaged
        before: a spline would amplify their noise.

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
        allowed = _longest_gap(rate)
        if steps[widest] > allowed:
            raise DemonstrationError(
                f"there is a gap of {steps[widest]:.3g} s after "
                f"{self.time[widest]:.3g} s; the longest that can be interpolated is "
                f"{allowed:g} s. Use its parts: demonstration.split_at_gaps({rate:g})."
            )
        count = int(np.floor(self.duration * rate * (1 + 1e-9))) + 1
        if count < 2:
            raise DemonstrationError(
                f"the demonstration lasts {self.duration:.3g} s; at {rate:g} Hz that "
                "is fewer than 2 samples."
            )
        time, values = _without_bursts(self.time, self.values, rate)
        recorded_rate = 1 / float(np.median(np.diff(time)))
        if recorded_rate > 2 * rate:
            uniform = np.arange(time[0], time[-1], 1 / recorded_rate)
            values = CubicSpline(time, values)(uniform)
            time = uniform
            from scipy.signal import butter, sosfiltfilt  # Slow to import.

            sos = butter(4, 0.4 * rate, fs=recorded_rate, output="sos")
            pad = min(len(values) - 1, 3 * int(np.ceil(recorded_rate / rate)))
            values = sosfiltfilt(sos, values, axis=0, padlen=pad)
        new = self.time[0] + np.arange(count) / rate
        return replace(self, time=new, values=CubicSpline(time, values)(new))

    def split_at_gaps(self, rate: float) -> list["Demonstration"]:
        """Return the parts between gaps that are too long to interpolate.

        Parts of fewer than 4 samples, also at the rate, are left out. Skills are learned from
        such parts.

        Parameters
        ----------
        rate : float
            Sample rate (Hz) that the parts can be resampled to.

        Examples
        --------
        >>> time = np.r_[0:2:0.05, 8:11:0.05]
        >>> recording = Demonstration(time=time, values=np.sin(time))
        >>> [round(part.duration, 2) for part in recording.split_at_gaps(20.0)]
        [1.95, 2.95]
        """
        check_number(rate, "rate", above=0.0, unit="Hz", error=DemonstrationError)
        ends = np.flatnonzero(np.diff(self.time) > _longest_gap(rate)) + 1
        if len(ends) == 0:
            return [self]
        parts = np.split(np.arange(len(self.time)), ends)
        shortest = (_LEAST_SAMPLES - 1) / rate * (1 - _UNIFORM)
        return [
            self.rows(part)
            for part in parts
            if len(part) >= _LEAST_SAMPLES
            and self.time[part[-1]] - self.time[part[0]] >= shortest
        ]

    def rows(self, index: ArrayLike) -> "Demonstration":
        """Return the demonstration with only the samples of indices or of a mask (N,)."""
        rows = np.asarray(index)
        return replace(self, time=self.time[rows], values=self.values[rows])

    def select(self, channels: Sequence[str | int]) -> "Demonstration":
        """Return the demonstration with only some channels, by name, in their order.

        The rotation reference is dropped unless all three rotation channels are named.
        """
        index = channel_indices(channels, self.channels, error=DemonstrationError)
        names = tuple(self.channels[i] for i in index)
        has_rotation = set(ROTATION_CHANNELS) <= set(names)
        return replace(
            self,
            values=self.values[:, index],
            channels=names,
            units=tuple(self.units[i] for i in index),
            rotation_reference=self.rotation_reference if has_rotation else None,
        )

    def save(self, path: str | Path) -> None:
        """Write the demonstration to an `.npz` or `.csv` file, by the file's ending.

        A `.csv` does not hold the frame. It is refused for rotation channels, whose
        reference it cannot hold.
        """
        path = as_path(path, error=SkillFileError)
        check_ending(path, has_rotation=self.rotation_reference is not None)
        if path.suffix == ".npz":
            metadata = {name: getattr(self, name) for name in METADATA}
            FORMAT.write(path, metadata, {"time": self.time, "values": self.values})
            return
        names = zip(self.channels, self.units, strict=True)
        with (
            replaced(path, SkillFileError) as part,
            part.open("w", newline="", encoding="utf-8") as stream,
        ):
            writer = csv.writer(stream)
            writer.writerow(["time [s]", *(f"{n} [{u}]" for n, u in names)])
            writer.writerows(np.column_stack([self.time, self.values]).tolist())

    @classmethod
    def load(
        cls, path: str | Path, options: ReadingOptions | None = None
    ) -> "Demonstration":
        """Read a demonstration from a file of a kind that `read_demonstrations` reads.

        The `note` lists what was recognised in it.

        Parameters
        ----------
        path : str or Path
        options : ReadingOptions, optional
            Information that the file lacks: columns, unit, rate, topic.

        Raises
        ------
        SkillFileError
            Where the file is missing, broken or of another kind.
        DemonstrationError
            Where its numbers cannot be used, or it holds several demonstrations.
        """
        demonstrations, _ = read_demonstrations(
            as_path(path, error=SkillFileError), options
        )
        if len(demonstrations) != 1:
            raise DemonstrationError(
                f"{path} holds {len(demonstrations)} demonstrations; read them with "
                "`read_demonstrations`."
            )
        return demonstrations[0]


def _without_bursts(time: Array, values: Array, rate: float) -> tuple[Array, Array]:
    """Return samples of which none are closer than half their mean distance in time.

    Where there are gaps, they are at least a quarter of a sample at the new rate apart.
    Closer ones are averaged.
    """
    steps = np.diff(time)
    least = 0.5 * float(np.mean(steps))
    if np.max(steps) > _GAP * np.median(steps):
        least = max(least, 0.25 / rate)
    least *= 1 - 1e-6  # Rounding of time stamps.
    if np.min(steps) >= least:
        return time, values
    first = [0]
    while (i := int(np.searchsorted(time, time[first[-1]] + least))) < len(time):
        first.append(i)
    counts = np.diff(first, append=len(time))
    averaged = np.add.reduceat(values, first) / counts[:, None]
    # Relative to the start, as time stamps may be large.
    times = np.add.reduceat(time - time[0], first) / counts
    return time[0] + times, averaged


def check_ending(path: Path, *, has_rotation: bool = False) -> None:
    """Raise an error for a file name that `Demonstration.save` does not support."""
    if path.suffix not in (".npz", ".csv"):
        raise SkillFileError(
            f"cannot write {path}: the name of a demonstration ends with .npz or .csv."
        )
    if has_rotation and path.suffix == ".csv":
        raise SkillFileError(
            f"cannot write {path}: a .csv has no place for the reference of the "
            "rotation channels; save an .npz."
        )


def add_orientation(
    demonstration: Demonstration,
    rotations: Rotation | ArrayLike,
    *,
    order: QuaternionOrder | None = None,
    reference: Rotation | ArrayLike | None = None,
) -> Demonstration:
    """Return a demonstration with the channels `rx`, `ry` and `rz` added, in rad.

    Parameters
    ----------
    demonstration : Demonstration
        Of N samples, for example of a position in frame B.
    rotations : scipy Rotation or array_like, shape (N, 4)
        R_BE at the same times.
    order : {"xyzw", "wxyz"}
        Of quaternions; see `as_rotation`.
    reference : scipy Rotation or array_like, shape (4,), optional
        R_ref, as (x, y, z, w) where a quaternion; the mean rotation where None.

    Raises
    ------
    DemonstrationError
        Where the rotations do not match the demonstration, jump by more than 90 degrees
        between two samples, or reach 360 degrees from the reference.
    """
    check_type(demonstration, "demonstration", Demonstration, error=DemonstrationError)
    rotation = as_rotation(rotations, order=order)
    if rotation.single or len(rotation) != len(demonstration.time):
        count = 1 if rotation.single else len(rotation)
        raise DemonstrationError(
            f"there are {count} rotations for {len(demonstration.time)} samples; give "
            "one for each."
        )
    if demonstration.rotation_reference is not None:
        raise DemonstrationError("the demonstration has rotation channels already.")
    if reference is None:
        quaternion = mean_rotation(rotation)
    else:
        given = as_rotation(reference, order="xyzw")
        if not given.single and len(given) != 1:
            raise DemonstrationError(f"there are {len(given)} references; give one.")
        quaternion = unit_quaternion(given)
    vectors = rotation_vectors(rotation, quaternion)
    return replace(
        demonstration,
        values=np.concatenate([demonstration.values, vectors], axis=1),
        channels=(*demonstration.channels, *ROTATION_CHANNELS),
        units=(*demonstration.units, "rad", "rad", "rad"),
        rotation_reference=quaternion,
    )


def with_reference(demonstration: Demonstration, other: Demonstration) -> Demonstration:
    """Return a demonstration whose rotation vectors have the reference of another one.

    It is unchanged where one of them has no rotation channels.
    """
    reference = other.rotation_reference
    if reference is None:
        return demonstration
    near = other.select(ROTATION_CHANNELS).values.mean(axis=0)
    return change_reference(demonstration, reference, near=near)


def change_reference(
    demonstration: Demonstration, reference: Quaternion, *, near: ArrayLike
) -> Demonstration:
    """Return a demonstration whose rotation vectors have another reference.

    It is unchanged where it has no rotation channels.

    Parameters
    ----------
    demonstration : Demonstration
    reference : tuple of float
        Quaternion (x, y, z, w) of R_ref.
    near : array_like, shape (3,)
        The rotation vectors begin as near to this one as possible, rad.
    """
    known = demonstration.rotation_reference
    if known in (None, reference):
        return demonstration
    index = channel_indices(ROTATION_CHANNELS, demonstration.channels)
    values = demonstration.values.copy()
    values[:, index] = rotation_vectors(
        rotations_of(values[:, index], known), reference, near=near
    )
    return replace(demonstration, values=values, rotation_reference=reference)


def read_demonstrations(
    paths: str | Path | Sequence[str | Path], options: ReadingOptions | None = None
) -> tuple[list[Demonstration], list[str]]:
    """Read demonstrations from files of many kinds.

    Tables in text files (`.csv` and others, with any delimiter), exports of OptiTrack and
    Vicon, `.xlsx`, JSON, JSON lines, YAML, `.npz`, `.npy`, `.mat`, `.parquet`, HDF5, ROS 1 and
    ROS 2 bags, MCAP, and LeRobot datasets; a file may be compressed by gzip or zip. Datasets
    give one demonstration for each episode: a LeRobot folder, or robomimic's HDF5 file.
    Quaternions, rotation vectors and Euler angles (`roll`, `pitch`, `yaw`) become the
    orientation channels `rx`, `ry` and `rz`; all demonstrations have one reference.
    Lengths become metres, degrees radians. A file that holds only a force or an orientation
    is added to the recordings of positions or joints beside it, at the same absolute times.

    Parameters
    ----------
    paths : str or Path, or a sequence of them
    options : ReadingOptions, optional
        Information that the files lack: columns, unit, rate, topic.

    Returns
    -------
    demonstrations : list of Demonstration
    remarks : list of str
        Remarks on recognised and omitted parts, by file.

    Raises
    ------
    SkillFileError
        Where a file is missing, broken or of a kind that cannot be read.
    DemonstrationError
        Where its numbers cannot be used.
    """
    options = options or ReadingOptions()
    demonstrations: list[Demonstration] = []
    remarks: list[str] = []
    orientations: dict[int, tuple[Path, Array, Table]] = {}
    tables: list[tuple[Path, Table]] = []
    for path in as_paths(paths, "paths", error=SkillFileError):
        with _naming(path), np.errstate(all="ignore"):  # Infinite numbers are refused.
            tables += [
                (path, table if table.saved else recognise_columns(table, options))
                for table in read_tables(path, options)
            ]
    for path, table in joined_parts(tables):
        with _naming(path), np.errstate(all="ignore"):
            if table.saved is not None:
                demonstrations.append(Demonstration(**table.saved))
                continue
            recording = _from_table(table)
            if set(QUATERNION_CHANNELS) <= set(recording.channels):
                quaternions = recording.select(QUATERNION_CHANNELS).values
                orientations[len(demonstrations)] = path, quaternions, table
            if recording.note:
                remarks.append(f"{path.name}: {recording.note}")
            demonstrations.append(recording)
    if orientations:
        reference = mean_rotation(
            np.concatenate(
                [quaternions for _, quaternions, _ in orientations.values()]
            ),
            order="xyzw",
        )
    for i, (path, quaternions, table) in orientations.items():
        recording = demonstrations[i]
        hint = "; ".join(r for r in table.remarks if _READING.search(r))
        try:
            recording = add_orientation(
                recording, quaternions, order="xyzw", reference=reference
            )
        except DemonstrationError as error:
            turns_on = isinstance(error, RotationRangeError)
            has_position = set(POSITION_CHANNELS) <= set(recording.channels)
            if not (table.has_angles or (turns_on and has_position)):
                with _naming(path, hint):
                    raise
            left_out = f"orientation left out: {error}" + f" ({hint})" * bool(hint)
            remarks.append(f"{path.name}: {left_out}")
            note = "; ".join(filter(None, [recording.note, left_out]))
            recording = replace(recording, note=note)
        names = [c for c in recording.channels if c not in QUATERNION_CHANNELS]
        demonstrations[i] = recording.select(names)
    first = next((d for d in demonstrations if d.rotation_reference), None)
    if first is not None:
        demonstrations = [with_reference(d, first) for d in demonstrations]
    return demonstrations, remarks


def _from_table(table: Table) -> Demonstration:
    return Demonstration(
        time=table.values[:, 0],
        values=table.values[:, 1:],
        channels=table.names[1:],
        units=table.units[1:],
        frame=table.frame,
        note="; ".join(table.remarks),
    )


@contextmanager
def _naming(path: Path, hint: str = "") -> Iterator[None]:
    """Add the name of a file, and a hint, to errors raised inside."""
    try:
        yield
    except (DemonstrationError, SkillFileError) as error:
        if str(path) in str(error):
            raise
        more = f" ({hint})" if hint else ""
        raise type(error)(f"{path}: {error}{more}") from None


def _longest_gap(rate: float) -> float:
    """Return the longest gap that can be interpolated for a sample rate, s."""
    return max(LONGEST_GAP, 2 / rate)


def _names(what: str, value: Any) -> tuple[str, ...]:
    """Return names of channels or units as a tuple."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        names = tuple(value)
        if all(isinstance(name, str) for name in names):
            return names
    raise DemonstrationError(f"{what} is {value!r}; expected one name per channel.")


def _checked_reference(reference: Any, channels: tuple[str, ...]) -> Quaternion:
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
    # Others stay unchanged: a saved file must return identical numbers.
    if abs(length - 1) > 1e-12:
        x, y, z, w = x / length, y / length, z / length, w / length
    return (x, y, z, w)
