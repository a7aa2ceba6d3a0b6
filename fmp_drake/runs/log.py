"""Log of a run: its signals and their samples, and an `.npz` file without pickle.

The signals are output ports of the station, except for `erase_time`, which the run
computes. B is the frame of the board, T that of the target, which is B on a flat board,
and W the world.

In the file each signal is an array (N, columns), named as in `SIGNALS`. The metadata
contain the name of the array of its times (N,); signals with the same samples share it:

    with np.load("run.npz") as file:
        metadata = json.loads(str(file["metadata"]))
        force = file["normal_force"]
        time = file[metadata["signals"]["normal_force"]["times"]]

`RunLog.load` reads and checks a log.
"""

import math
import platform
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from pydrake.systems.framework import Context
from pydrake.systems.primitives import VectorLogSink

from fmp_drake import __version__
from fmp_drake.errors import RunError
from fmp_drake.numeric import Array, as_path
from fmp_drake.primitives.data.channels import POSITION_CHANNELS
from fmp_drake.primitives.data.files import FileFormat

FORMAT = FileFormat(
    name="fmp-drake-run",
    version=1,
    what="log",
    source="written by `fmp-drake wipe --log`",
    error=RunError,
)

type Chunk = Mapping[str, Samples]


class Samples(NamedTuple):
    """Logged samples of one signal: times (N,) in s and values (N, columns)."""

    times: Array
    values: Array


class SignalKind(NamedTuple):
    """Description of a signal.

    Attributes
    ----------
    period : float
        Sampling period, s; infinite for a signal that is logged only at the end.
    meaning : str
    unit : str
        Common unit of all columns, or the units of the columns, separated by commas; 1
        for none.
    frame : str
        B, T, W, or empty if the values have no frame.
    columns : tuple of str
        Empty if the number of columns depends on the scenario or the skill. A name with
        ``{}`` represents one column for each joint.
    """

    period: float
    meaning: str
    unit: str
    frame: str = ""
    columns: tuple[str, ...] = ()

    def metadata(self, size: int) -> dict[str, Any]:
        """Return the metadata of the signal in a log, for a number of columns."""
        metadata = self._asdict()
        del metadata["period"]
        if any("{}" in column for column in self.columns):
            joints = range(1, size // len(self.columns) + 1)
            metadata["columns"] = [c.format(i) for c in self.columns for i in joints]
            if "," in self.unit:
                units = self.unit.split(",")
                metadata["unit"] = ",".join(unit for unit in units for _ in joints)
        return metadata


MILLISECOND = 0.001
# Exact multiples of a millisecond in floating point at any time. A sample that differs by a
# rounding error from an update of the controller would split an integrator's step.
_FAST, _SLOW, _RARE = 0.005, 0.01, 0.04
_XYZ = POSITION_CHANNELS
_XX = tuple(a + b for a in _XYZ for b in _XYZ)
_POSE = ("qw", "qx", "qy", "qz", *_XYZ)
_JOINTS = ("joint{}",)
_SPEEDS = ("joint{}_velocity",)
_ERROR = "of the controller: a rotation vector, a translation"
_STATE = "of the arm: angles, then velocities"
_CLEANED = "fraction of the cells that are clean"
_PENETRATION = "of the deepest hard point below the board's surface"
_STATUS = "of the controller: see fmp_drake.systems.impedance.controller_status"
_ERASED = "time at which a cell became clean, along x first"
_REMAPS = "re-mappings so far, and those after a push among them"

_KINDS: dict[str, tuple[Any, ...]] = {
    "desired_position": (_FAST, "p_BE of the skill", "m", "B", _XYZ),
    "desired_velocity": (_FAST, "its velocity", "m/s", "B", _XYZ),
    "desired_acceleration": (_FAST, "its acceleration", "m/s^2", "B", _XYZ),
    "covariance": (_RARE, "of the tracked component, row by row", "m^2", "B", _XX),
    "weights": (_RARE, "of the tracked movement", "m", "B"),
    "component": (_RARE, "index of the tracked component", "1", "", ("component",)),
    "remaps": (_FAST, _REMAPS, "1", "", ("all", "reactive")),
    "measured_position": (_FAST, "p_BE", "m", "B", _XYZ),
    "measured_velocity": (_FAST, "v_BE", "m/s", "B", _XYZ),
    "measured_pose": (_FAST, "R_TE and p_TE", "1,1,1,1,m,m,m", "T", _POSE),
    "desired_orientation": (_FAST, "R_TE of the skill", "1", "T", _POSE[:4]),
    "tracking_error": (
        _FAST,
        _ERROR,
        "rad,rad,rad,m,m,m",
        "B",
        ("rx", "ry", "rz", *_XYZ),
    ),
    "status": (MILLISECOND, _STATUS, "1"),
    "torque": (MILLISECOND, "commanded, without gravity", "N m", "", _JOINTS),
    "actuation": (MILLISECOND, "torque with gravity", "N m", "", _JOINTS),
    "state": (MILLISECOND, _STATE, "rad,rad/s", "", (*_JOINTS, *_SPEEDS)),
    "ink": (math.inf, "fraction left in each cell, along x first", "1", "B"),
    "erase_time": (math.inf, _ERASED, "s", "B"),
    "cleaned_fraction": (_RARE, _CLEANED, "1", "", ("cleaned",)),
    "normal_force": (_SLOW, "of the eraser on the board", "N", "", ("force",)),
    "desired_normal_force": (_SLOW, "along the normal", "N", "", ("force",)),
    "penetration": (_SLOW, _PENETRATION, "m", "", ("depth",)),
    "contact_area": (_SLOW, "between eraser and board", "m^2", "", ("area",)),
    "disturbance": (_SLOW, "force of the disturbances on E", "N", "W", _XYZ),
}
# What is different over a curved surface.
_CURVED: dict[str, dict[str, Any]] = {
    "desired_position": {"meaning": "(u, v, h)", "frame": ""},
    "measured_position": {"meaning": "(u, v, h)", "frame": ""},
    "desired_velocity": {"meaning": "its velocity, of (u, v, h)"},
    "desired_acceleration": {"meaning": "its acceleration, of (u, v, h)"},
    "measured_velocity": {"meaning": "of E relative to the target", "frame": "T"},
    "tracking_error": {"frame": "T"},
}
SIGNALS = {name: SignalKind(*kind) for name, kind in _KINDS.items()}
"""Signals of a log by their names."""


def skill_signals(
    channels: Sequence[str],
    units: Sequence[str],
    *,
    weights: int,
    is_curved: bool = False,
) -> dict[str, SignalKind]:
    """Return `SIGNALS` with the names and units of a skill's channels.

    Parameters
    ----------
    channels, units : sequence of str
        Of the skill.
    weights : int
        Number of weights for each channel.
    is_curved : bool
        Whether the surface is curved: positions are (u, v, h) then, and velocities and
        errors are those in the moving task frame T.

    Examples
    --------
    >>> kinds = skill_signals(["x", "force"], ["m", "N"], weights=10)
    >>> kinds["covariance"].columns
    ('xx', 'forcex', 'xforce', 'forceforce')
    """
    changes = _CURVED if is_curved else {}
    signals = SIGNALS | {n: SIGNALS[n]._replace(**new) for n, new in changes.items()}
    if len(channels) == 3 and set(units) == {"m"}:
        return signals
    pairs = [(a, b) for a in range(len(units)) for b in range(len(units))]
    covariance = SIGNALS["covariance"]._replace(
        columns=tuple(channels[b] + channels[a] for a, b in pairs),
        unit=",".join(f"{units[b]} {units[a]}" for a, b in pairs),
    )
    kind = SIGNALS["weights"]._replace(
        unit=",".join(unit for unit in units for _ in range(weights))
    )
    return signals | {"covariance": covariance, "weights": kind}


def pop_samples(
    sinks: Mapping[str, VectorLogSink], context: Context
) -> dict[str, Samples]:
    """Return the logged samples of each signal, and clear the logs."""
    chunk = {}
    for name, sink in sinks.items():
        log = sink.FindMutableLog(context)
        chunk[name] = Samples(log.sample_times().copy(), log.data().T.copy())
        log.Clear()
    return chunk


def signal_kind(name: str) -> SignalKind:
    """Return the description of a signal.

    Raises
    ------
    RunError
        If the name is not in `SIGNALS`.
    """
    try:
        return SIGNALS[name]
    except KeyError:
        raise RunError(
            f"there is no signal {name!r}; a log may contain {', '.join(SIGNALS)}."
        ) from None


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """One quantity over time.

    Attributes
    ----------
    times : ndarray, shape (N,)
        Ascending, s.
    values : ndarray, shape (N, columns)
    unit, frame, meaning : str
        As in `SignalKind`.
    columns : tuple of str
        Names of the columns, or none.

    Examples
    --------
    >>> time, values = np.array([0.0, 0.1]), np.array([[0.05], [0.04]])
    >>> height = Signal(times=time, values=values, unit="m")
    >>> height.values.shape
    (2, 1)
    """

    times: Array
    values: Array
    unit: str = "1"
    frame: str = ""
    meaning: str = ""
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check that the lengths agree, and that the times are ascending."""
        count = len(self.times) if self.times.ndim == 1 else -1
        if self.values.ndim != 2 or len(self.values) != count:
            raise RunError(
                f"times are {self.times.shape} and values {self.values.shape}; expected "
                "(N,) and (N, columns)"
            )
        if self.columns and len(self.columns) != self.values.shape[1]:
            raise RunError(
                f"{len(self.columns)} names are given for {self.values.shape[1]} columns"
            )
        if not np.all(np.isfinite(self.times)) or np.any(np.diff(self.times) < 0):
            raise RunError("times are not finite or not ascending")

    def __repr__(self) -> str:
        """Return the size, the unit and the names of the columns, without the numbers."""
        count, columns = self.values.shape
        span = f"{count} samples"
        if count:
            span += f" from {self.times[0]:g} to {self.times[-1]:g} s"
        names = f": {', '.join(self.columns)}" if self.columns else ""
        plural = "" if columns == 1 else "s"
        unit = "" if self.unit == "1" else f" in {self.unit}"
        return f"<Signal: {span}, {columns} column{plural}{unit}{names}>"


@dataclass(frozen=True, kw_only=True, eq=False)
class RunLog:
    """Signals of a run, with its scenario and metrics.

    Attributes
    ----------
    signals : mapping from str to Signal
    scenario : str
        YAML.
    seed : int
    versions : mapping from str to str
        Versions of the packages during the run.
    metrics : mapping from str to number, str or None
        Metrics of the run, if any.

    Examples
    --------
    >>> from fmp_drake.runs.log import Signal
    >>> time, values = np.array([0.0, 0.1]), np.array([[0.05], [0.04]])
    >>> height = Signal(times=time, values=values, unit="m")
    >>> log = RunLog(signals={"height": height}, scenario="table_top")
    >>> log["height"].unit
    'm'
    """

    signals: Mapping[str, Signal]
    scenario: str = ""
    seed: int = 0
    versions: Mapping[str, str] = field(default_factory=lambda: current_versions())
    metrics: Mapping[str, float | str | None] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return the names of the signals, without their samples."""
        return f"<RunLog: {', '.join(self.signals) or 'no signals'}>"

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the signals, of which `in` tells whether one exists."""
        return iter(self.signals)

    def __getitem__(self, name: str) -> Signal:
        """Return a signal by its name."""
        try:
            return self.signals[name]
        except KeyError:
            raise RunError(
                f"this log has no signal {name!r}; it has {', '.join(self.signals)}."
            ) from None

    @classmethod
    def load(cls, path: str | Path) -> "RunLog":
        """Read a log.

        Raises
        ------
        RunError
            If the file is missing, broken, not a log or from a newer version.
        """
        metadata, arrays = FORMAT.read(as_path(path, error=RunError))
        try:
            return cls(
                signals={
                    name: _read_signal(arrays[name], arrays[entry["times"]], entry)
                    for name, entry in metadata["signals"].items()
                },
                scenario=str(metadata["scenario"]),
                seed=int(metadata["seed"]),
                versions={str(k): str(v) for k, v in metadata["versions"].items()},
                metrics=dict(metadata["figures"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError, RunError) as error:
            raise RunError(f"{path} is an incomplete log: {error}.") from None


def write_log(
    path: Path,
    signals: Mapping[str, tuple[Array, Array]],
    *,
    scenario: str,
    seed: int,
    metrics: Mapping[str, Any],
    kinds: Mapping[str, SignalKind] = SIGNALS,
) -> None:
    """Write a log for `RunLog.load`, completely or not at all.

    Parameters
    ----------
    path : pathlib.Path
    signals : mapping from str to (times, values)
        Shapes (N,) or (N, 1), s, and (N, columns), by names of `SIGNALS`. Signals with
        the same times object share an array in the file.
    scenario : str
        YAML.
    seed : int
    metrics : mapping from str to number, str or None
    kinds : mapping from str to SignalKind
        Descriptions of the signals, from `skill_signals`.

    Raises
    ------
    RunError
        If it cannot be written; an existing file then remains unchanged.
    """
    times_by_id = {id(times): times for times, _ in signals.values()}
    names = {key: f"time_{i}" for i, key in enumerate(times_by_id)}
    metadata = {
        "signals": {
            name: {
                "times": names[id(times)],
                **kinds[name].metadata(values.shape[1]),
            }
            for name, (times, values) in signals.items()
        },
        "scenario": scenario,
        "seed": seed,
        "versions": current_versions(),
        "figures": dict(metrics),  # The key of version 1 of the format.
    }
    arrays = {name: values for name, (_, values) in signals.items()}
    arrays |= {names[key]: times for key, times in times_by_id.items()}
    FORMAT.write(path, metadata, arrays)


def current_versions() -> dict[str, str]:
    """Return the versions of the packages that a run depends on."""
    versions = {"python": platform.python_version(), "fmp_drake": __version__}
    for package in ("drake", "numpy", "scipy"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "unknown"
    return versions


def _read_signal(
    values: NDArray[Any], times: NDArray[Any], metadata: Mapping[str, Any]
) -> Signal:
    """Return a signal from its arrays and metadata."""
    if values.dtype.kind != "f" or times.dtype.kind != "f":
        raise RunError("a signal contains values other than numbers")
    return Signal(
        times=times,
        values=values,
        unit=str(metadata["unit"]),
        frame=str(metadata["frame"]),
        meaning=str(metadata["meaning"]),
        columns=tuple(str(column) for column in metadata["columns"]),
    )


class TemporaryArray:
    """Growing array in an anonymous temporary file.

    It takes no memory. The file is in the system's folder for temporary files (`TMPDIR`),
    and is deleted with the process, even if that is killed.

    Parameters
    ----------
    row : tuple of int
        Shape of a row; () for a number.
    dtype : data type
    """

    def __init__(
        self, row: tuple[int, ...] = (), dtype: DTypeLike = np.float64
    ) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        weakref.finalize(self, self._file.close)
        self._dtype = np.dtype(dtype)
        self._row = row
        self._rows = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the rows so far."""
        return self._rows, *self._row

    def append(self, rows: ArrayLike) -> None:
        """Append rows, shape (n, ...)."""
        array = np.asarray(rows, dtype=self._dtype).reshape(-1, *self._row)
        self._file.write(array.tobytes())
        self._rows += len(array)

    def array(self) -> NDArray[Any]:
        """Return all rows so far as a read-only memory map of the file."""
        if not self._rows:
            return np.zeros(self.shape, dtype=self._dtype)
        self._file.flush()
        return np.asarray(np.memmap(self._file, self._dtype, "r", shape=self.shape))
