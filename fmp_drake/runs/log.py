"""Logs of a run: all its signals in one `.npz`, without pickle.

An array of the file is a signal, named as in `runs.signals.SIGNALS`, (N, columns); its
times (N,) are in the array that the metadata name, shared by signals that were sampled
together:

    with np.load("run.npz") as file:
        about = json.loads(str(file["metadata"]))
        force = file["normal_force"]
        time = file[about["signals"]["normal_force"]["times"]]

`RunLog.load` does that, and checks it.
"""

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake import __version__
from fmp_drake.errors import RunError
from fmp_drake.primitives.data.file_format import FileFormat
from fmp_drake.primitives.data.files import Blocks, check_writable
from fmp_drake.runs.signals import signal_kind

FORMAT = FileFormat(
    name="fmp-drake-run",
    version=1,
    what="log",
    source="written by `fmp-drake wipe --log`",
    error=RunError,
)

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
    """The signals of a run, and what it was a run of.

    Attributes
    ----------
    signals : mapping from str to Signal
    scenario : str
        YAML.
    seed : int
    versions : mapping from str to str
        Of the packages that made it.
    metrics : mapping from str to number, str or None
        What the run reported, if anything.

    Examples
    --------
    >>> from fmp_drake.runs import Signal
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
            Where the file is missing, broken, foreign or from a newer version.
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
) -> None:
    """Write a log that `RunLog.load` reads, whole or not at all.

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

    Raises
    ------
    RunError
        Where it cannot be written; an existing file is then as before.
    """
    clocks = {id(times): times for times, _ in signals.values()}
    names = {number: f"time_{i}" for i, number in enumerate(clocks)}
    metadata = {
        "signals": {
            name: {"times": names[id(times)], **signal_kind(name).described()}
            for name, (times, _) in signals.items()
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
    """Refuse a log that cannot be written, before any work is done."""
    check_writable(path)
    if path is not None and path.suffix.lower() != ".npz":
        raise RunError(f"{path} is no log; let its name end in .npz.")


def current_versions() -> dict[str, str]:
    """Return the versions of what a run depends on."""
    found = {"python": platform.python_version(), "fmp_drake": __version__}
    for package in ("drake", "numpy", "scipy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found


def _read_signal(
    values: NDArray[Any], times: NDArray[Any], about: Mapping[str, Any]
) -> Signal:
    """Return a signal of a file."""
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
