"""Logs of runs: all signals of a run in one `.npz`, without pickle.

Each signal is an array (N, columns), named as in `runs.signals.SIGNALS`. The metadata name
the array of its times (N,), which signals that were sampled together share:

    with np.load("run.npz") as file:
        about = json.loads(str(file["metadata"]))
        force = file["normal_force"]
        time = file[about["signals"]["normal_force"]["times"]]

`RunLog.load` reads and checks a log.
"""

import math
import os
import platform
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fmp_drake import __version__
from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import Blocks, FileFormat, check_writable
from fmp_drake.runs.signals import SIGNALS, SignalKind

FORMAT = FileFormat(
    name="fmp-drake-run",
    version=1,
    what="log",
    source="written by `fmp-drake wipe --log`",
    error=RunError,
)

# Size of a block that is read at once.
_BLOCK_BYTES = 1 << 20

type Rows = NDArray[np.float64] | Blocks


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
        A name for each column, or none.

    Examples
    --------
    >>> time, values = np.array([0.0, 0.1]), np.array([[0.05], [0.04]])
    >>> height = Signal(times=time, values=values, unit="m")
    >>> height.values.shape
    (2, 1)
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]
    unit: str = "1"
    frame: str = ""
    meaning: str = ""
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check that everything has the same length."""
        n = len(self.times) if self.times.ndim == 1 else -1
        if self.values.ndim != 2 or len(self.values) != n:
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
        Versions of the packages that wrote it.
    metrics : mapping from str to number, str or None
        Metrics that the run reported, if any.

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
        metadata, arrays = FORMAT.read(Path(path))
        try:
            return cls(
                signals={
                    name: _read_signal(arrays[name], arrays[about["times"]], about)
                    for name, about in metadata["signals"].items()
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
    signals: Mapping[str, tuple[Rows, Rows]],
    *,
    scenario: str,
    seed: int,
    metrics: Mapping[str, Any],
    kinds: Mapping[str, SignalKind] = SIGNALS,
) -> None:
    """Write a log for `RunLog.load`; the file appears complete or not at all.

    Parameters
    ----------
    path : pathlib.Path
    signals : mapping from str to (times, values)
        Shapes (N,) or (N, 1), s, and (N, columns), by names of `SIGNALS`; in memory or
        in a `Spill`. Signals with the same object of times share it in the file.
    scenario : str
        YAML.
    seed : int
    metrics : mapping from str to number, str or None
    kinds : mapping from str to SignalKind
        Descriptions of the signals, from `skill_signals`.

    Raises
    ------
    RunError
        If it cannot be written; an existing file then stays unchanged.
    """
    clocks = {id(times): times for times, _ in signals.values()}
    names = {number: f"time_{i}" for i, number in enumerate(clocks)}
    metadata = {
        "signals": {
            name: {
                "times": names[id(times)],
                **kinds[name].described(values.shape[1]),
            }
            for name, (times, values) in signals.items()
        },
        "scenario": scenario,
        "seed": seed,
        "versions": current_versions(),
        "figures": dict(metrics),  # As version 1 of the format calls them.
    }
    arrays = {name: values for name, (_, values) in signals.items()}
    arrays |= {names[number]: times for number, times in clocks.items()}
    FORMAT.write(path, metadata, arrays)


def check_log(path: Path | None) -> None:
    """Check that a log can be written, before any work is done."""
    check_writable(path)
    if path is not None and path.suffix.lower() != ".npz":
        raise RunError(f"{path} is not a log; its name must end in .npz.")


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
    values: NDArray[Any], times: NDArray[Any], about: Mapping[str, Any]
) -> Signal:
    """Return a signal from its arrays and metadata."""
    if values.dtype.kind != "f" or times.dtype.kind != "f":
        raise RunError("a signal holds something other than numbers")
    return Signal(
        times=times,
        values=values,
        unit=str(about["unit"]),
        frame=str(about["frame"]),
        meaning=str(about["meaning"]),
        columns=tuple(str(column) for column in about["columns"]),
    )


class Spill:
    """Growing array in a temporary file without a name.

    It takes no memory, and the file disappears with the process, even if that is killed.
    It is in the system's folder for temporary files (`TMPDIR`).

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
        added = np.asarray(rows, dtype=self._dtype).reshape(-1, *self._row)
        self._file.write(added.tobytes())
        self._rows += len(added)

    def array(self) -> NDArray[Any]:
        """Return all rows so far, a read-only memory map of the file."""
        if not self._rows:
            return np.zeros(self.shape, dtype=self._dtype)
        self._file.flush()
        return np.asarray(np.memmap(self._file, self._dtype, "r", shape=self.shape))

    def blocks(self) -> Iterator[NDArray[Any]]:
        """Yield all rows so far in blocks of about a megabyte."""
        self._file.flush()
        size = math.prod(self._row) * self._dtype.itemsize
        step = max(1, _BLOCK_BYTES // size) * size
        for start in range(0, self._rows * size, step):
            count = min(step, self._rows * size - start)
            data = os.pread(self._file.fileno(), count, start)
            yield np.frombuffer(data, self._dtype).reshape(-1, *self._row)
