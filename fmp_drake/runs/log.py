"""Logs of a run: all its signals in one `.npz`, without pickle.

An array of the file is a signal, named as in `run_signals.SIGNALS`, (N, columns); its
times (N,) are in the array that the metadata name, shared where they are equal:

    with np.load("run.npz") as file:
        about = json.loads(str(file["metadata"]))
        force = file["normal_force"]
        time = file[about["signals"]["normal_force"]["times"]]

`RunLog.load` does that, and checks it.
"""

import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake import __version__
from fmp_drake.errors import FmpError, SkillFileError
from fmp_drake.primitives.data.files import check_writable, read_versioned, write_npz
from fmp_drake.runs.signals import signal_kind

FORMAT = "fmp-drake-run"
VERSION = 1


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
            raise FmpError(
                f"times are {self.times.shape} and values {self.values.shape}; expected "
                "(N,) and (N, columns)"
            )
        if self.columns and len(self.columns) != self.values.shape[1]:
            raise FmpError(
                f"{len(self.columns)} names are given for {self.values.shape[1]} columns"
            )
        if not np.all(np.isfinite(self.times)) or np.any(np.diff(self.times) < 0):
            raise FmpError("times are not finite or not ascending")

    @classmethod
    def named(cls, name: str, times: ArrayLike, values: ArrayLike) -> "Signal":
        """Return a signal with the unit, frame and columns that its name has."""
        kind = signal_kind(name)
        data = np.asarray(values, dtype=float)
        data = data[:, None] if data.ndim == 1 else data
        try:
            return cls(
                times=np.asarray(times, dtype=float), values=data, **kind._asdict()
            )
        except FmpError as error:
            raise FmpError(f"signal {name}: {error}.") from None


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
    figures : mapping from str to number, str or None
        What the run reported, if anything.
    """

    signals: Mapping[str, Signal]
    scenario: str = ""
    seed: int = 0
    versions: Mapping[str, str] = field(default_factory=lambda: current_versions())
    figures: Mapping[str, float | str | None] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Signal:
        """Return a signal by its name."""
        try:
            return self.signals[name]
        except KeyError:
            raise FmpError(
                f"this log has no signal {name!r}; it has {', '.join(self.signals)}."
            ) from None

    def save(self, path: str | Path) -> None:
        """Write the log; an existing file is replaced at the end.

        Raises
        ------
        FmpError
            Where it cannot be written; an existing file is then as before.
        """
        arrays: dict[str, Any] = {}
        about: dict[str, Any] = {}
        clocks: list[NDArray[np.float64]] = []
        for name, signal in self.signals.items():
            number = _place(clocks, signal.times)
            arrays[name] = signal.values
            about[name] = {
                "times": f"time_{number}",
                "unit": signal.unit,
                "frame": signal.frame,
                "meaning": signal.meaning,
                "columns": list(signal.columns),
            }
        arrays |= {f"time_{i}": times for i, times in enumerate(clocks)}
        metadata = {
            "format": FORMAT,
            "version": VERSION,
            "signals": about,
            "scenario": self.scenario,
            "seed": self.seed,
            "versions": dict(self.versions),
            "figures": dict(self.figures),
        }
        try:
            write_npz(
                Path(path), {"metadata": np.array(json.dumps(metadata)), **arrays}
            )
        except SkillFileError as error:
            raise FmpError(str(error)) from None

    @classmethod
    def load(cls, path: str | Path) -> "RunLog":
        """Read a log.

        Raises
        ------
        FmpError
            Where the file is missing, broken, foreign or from a newer version.
        """
        path = Path(path)
        if not path.is_file():
            raise FmpError(f"there is no log {path}.")
        try:
            metadata, arrays, _ = read_versioned(
                path,
                hint="a log is written by `fmp-drake wipe --log`",
                foreign=f"{path} is no log of a run; write one with `fmp-drake wipe "
                "--log`.",
                form=FORMAT,
                newest=VERSION,
            )
        except SkillFileError as error:
            raise FmpError(str(error)) from None
        try:
            return cls(
                signals={
                    name: _read_signal(arrays[name], arrays[about["times"]], about)
                    for name, about in metadata["signals"].items()
                },
                scenario=str(metadata["scenario"]),
                seed=int(metadata["seed"]),
                versions={str(k): str(v) for k, v in metadata["versions"].items()},
                figures=dict(metadata["figures"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError, FmpError) as error:
            raise FmpError(f"{path} is an incomplete log: {error}.") from None


def check_log(path: Path | None) -> None:
    """Refuse a log that cannot be written, before any work is done."""
    check_writable(path)
    if path is not None and path.suffix.lower() != ".npz":
        raise FmpError(f"{path} is no log; let its name end in .npz.")


def current_versions() -> dict[str, str]:
    """Return the versions of what a run depends on."""
    found = {"python": platform.python_version(), "fmp_drake": __version__}
    for package in ("drake", "numpy", "scipy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found


def _place(clocks: list[NDArray[np.float64]], times: NDArray[np.float64]) -> int:
    """Return where equal times are among the clocks; they are added if nowhere."""
    for number, clock in enumerate(clocks):
        if np.array_equal(clock, times):
            return number
    clocks.append(times)
    return len(clocks) - 1


def _read_signal(
    values: NDArray[Any], times: NDArray[Any], about: Mapping[str, Any]
) -> Signal:
    """Return a signal of a file."""
    if values.dtype.kind != "f" or times.dtype.kind != "f":
        raise FmpError("a signal holds something other than numbers")
    return Signal(
        times=times,
        values=values,
        unit=str(about["unit"]),
        frame=str(about["frame"]),
        meaning=str(about["meaning"]),
        columns=tuple(str(column) for column in about["columns"]),
    )
