"""Storage of trials in a SQLite file."""

import fcntl
import hashlib
import importlib.util
import json
import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fmp_drake.errors import ExperimentError
from fmp_drake.primitives.data.files import replaced
from fmp_drake.runs.judging import RunResult

_NAME = "worlds.sqlite"
_TABLES = """
CREATE TABLE IF NOT EXISTS plan (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS worlds (
    key TEXT PRIMARY KEY, number INTEGER NOT NULL, code TEXT NOT NULL,
    scenario TEXT NOT NULL, parameters TEXT NOT NULL, is_feasible INTEGER NOT NULL,
    verdict TEXT NOT NULL, checked TEXT NOT NULL, metrics TEXT NOT NULL,
    events TEXT NOT NULL, error TEXT NOT NULL, attempts INTEGER NOT NULL, cpu_seconds REAL NOT NULL);
"""
_MAKE_LAST = (
    "UPDATE worlds SET rowid = (SELECT max(rowid) + 1 FROM worlds) WHERE key = ?"
)
# Columns in JSON, which can represent NaN, unlike a number in SQLite.
_JSON = ("parameters", "checked", "metrics")


def check_parquet() -> None:
    """Raise an ExperimentError where pyarrow is not installed."""
    if importlib.util.find_spec("pyarrow") is None:
        raise ExperimentError(
            "Parquet files need pyarrow: pip install 'fmp-drake[parquet]'."
        )


@dataclass(kw_only=True)
class Trial(RunResult):
    """A randomised scenario, and the result of its run: a row of a store.

    Attributes
    ----------
    number : int
    scenario : str
        Scenario in YAML, with every key.
    parameters : dict of str to object
        Drawn values by the names of the fields.
    code : str
        The `code_version` of the run.
    is_feasible : bool
        Whether the feasibility check passes.
    verdict : str
        Text of the feasibility check.
    checked : dict
        Values of the feasibility check.
    metrics : dict or None
        Metrics of the run; None without a run, or after an exception.
    events : str
        Faults that the run reports, with their times.
    error : str
        Exception; empty without one.
    attempts : int
        Number of attempts to run it.
    cpu_seconds : float

    Examples
    --------
    >>> trial = Trial(number=0, scenario="press: {force: 8.0}")
    >>> trial.was_run
    False
    """

    number: int
    parameters: dict[str, Any] = field(default_factory=dict)
    code: str = ""
    is_feasible: bool = True
    verdict: str = ""
    checked: dict[str, Any] = field(default_factory=dict)
    events: str = ""
    attempts: int = 1
    cpu_seconds: float = 0.0

    @property
    def was_run(self) -> bool:
        """Whether it was simulated, or an attempt failed."""
        return self.metrics is not None or bool(self.error)


class TrialStore:
    """Trials in a SQLite file of a folder, one row each, readable at any time.

    Parameters
    ----------
    folder : pathlib.Path
    plan : dict of str to str, optional
        Specification, seed and simulated time, as from `TrialSpec.plan`. Required for a new
        folder; in an existing folder it must equal the stored plan.

    Raises
    ------
    ExperimentError
        If there is no store, or one with another plan.

    Examples
    --------
    >>> store = TrialStore(Path("out"), {"spec": "", "seed": "0", "duration": "14.0"})
    >>> store.trials()
    []
    """

    def __init__(self, folder: Path, plan: dict[str, str] | None = None) -> None:
        self.folder = folder
        file = folder / _NAME
        if plan is None and not file.is_file():
            raise ExperimentError(f"there are no trials in {folder}.")
        with self._reported():
            folder.mkdir(parents=True, exist_ok=True)
            self._base = sqlite3.connect(file, isolation_level=None)
            self._base.row_factory = sqlite3.Row
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.executescript(_TABLES)
            self.plan: dict[str, str] = self._planned(plan or {})
        for name, value in (plan or {}).items():
            stored = self.plan.get(name)
            if stored != value:
                difference = f" ({stored}, not {value})" if len(value) < 40 else ""
                raise ExperimentError(
                    f"{folder} has trials of another {name}{difference}; give another "
                    "folder."
                )

    @contextmanager
    def _reported(self) -> Iterator[None]:
        """Report a failure of the file system or of SQLite as an ExperimentError."""
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            advice = "The stored trials are kept; the same command continues with the missing ones."
            # A file that is broken, unlike one that cannot be written.
            if type(error) is sqlite3.DatabaseError:
                advice = f"Delete its {_NAME}, or give another folder."
            raise ExperimentError(
                f"cannot store trials in {self.folder}: {error}. {advice}"
            ) from None

    def _planned(self, plan: dict[str, str]) -> dict[str, str]:
        """Return the stored plan; write a plan if there is none.

        It is written in one transaction. An incomplete plan without trials is replaced: an
        earlier version was killed while it wrote.
        """
        self._base.execute("BEGIN IMMEDIATE" if plan else "BEGIN")
        stored = dict(self._base.execute("SELECT name, value FROM plan"))
        if "seconds" in stored:  # Of an earlier version.
            stored["duration"] = stored.pop("seconds")
        (count,) = self._base.execute("SELECT count(*) FROM worlds").fetchone()
        if set(stored) < set(plan) and count == 0:
            stored = plan
            self._base.executemany(
                "INSERT OR REPLACE INTO plan VALUES (?, ?)", list(plan.items())
            )
        self._base.execute("COMMIT")
        return stored

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Lock the folder, so that no other process runs the same trials."""
        lock = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
        except BlockingIOError:
            raise ExperimentError(
                f"another process runs trials in {self.folder}; wait until it ends."
            ) from None
        finally:
            os.close(lock)

    def key(self, trial: Trial) -> str:
        """Return the key of a row: a hash of number, scenario, simulated time and code."""
        duration = float(self.plan["duration"])
        parts = (str(trial.number), trial.scenario, duration.hex(), trial.code)
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]

    def add(self, trial: Trial) -> None:
        """Write a trial; it replaces a row with the same key."""
        row = {"key": self.key(trial)} | asdict(trial)
        row |= {name: json.dumps(row[name]) for name in _JSON}
        names = ", ".join(row)
        marks = ", ".join(f":{name}" for name in row)
        with self._reported():
            self._base.execute(
                f"INSERT OR REPLACE INTO worlds ({names}) VALUES ({marks})", row
            )

    def missing(self, trials: Sequence[Trial], *, force: bool) -> list[Trial]:
        """Return those of some trials that have to be run.

        With `force` those that were found infeasible, but not run, are missing. The stored
        rows of the others become the last ones, which `trials` returns.
        """
        finished, last = set[str](), dict[int, str]()
        for key, number, metrics, error in self._base.execute(
            "SELECT key, number, metrics, error FROM worlds ORDER BY rowid"
        ):
            last[number] = key
            if not force or metrics != "null" or error:
                finished.add(key)
        keys = {self.key(trial): trial for trial in trials}
        # Another version of the code has run these since.
        earlier = [
            (key,)
            for key, trial in keys.items()
            if key in finished and key != last[trial.number]
        ]
        with self._reported():
            self._base.executemany(_MAKE_LAST, earlier)
        return [trial for key, trial in keys.items() if key not in finished]

    def trial(self, number: int) -> Trial:
        """Return a trial by its number.

        Raises
        ------
        ExperimentError
            If there is no trial with that number.
        """
        trials = {trial.number: trial for trial in self.trials()}
        if number not in trials:
            available = f"{min(trials)} to {max(trials)}" if trials else "none yet"
            raise ExperimentError(
                f"{self.folder} has no trial {number}; its trials are {available}."
            )
        return trials[number]

    def trials(self) -> list[Trial]:
        """Return the last row of each trial, in the order of their numbers."""
        trials = {}
        for stored in self._base.execute("SELECT * FROM worlds ORDER BY rowid"):
            row = dict(stored)
            row |= {name: json.loads(row[name]) for name in _JSON}
            row["is_feasible"] = bool(row["is_feasible"])
            del row["key"]
            trials[row["number"]] = Trial(**row)
        return [trials[number] for number in sorted(trials)]

    def export(self, path: Path) -> None:
        """Write the trials to a Parquet file, one column for each parameter and metric.

        It requires pyarrow; see `check_parquet`.
        """
        import pyarrow
        import pyarrow.parquet

        rows = []
        for trial in self.trials():
            row = asdict(trial)
            for name in _JSON:
                row |= {f"{name}.{k}": v for k, v in (row.pop(name) or {}).items()}
            rows.append(row)
        names = list(dict.fromkeys(name for row in rows for name in row))
        columns = {name: [row.get(name) for row in rows] for name in names}
        with replaced(path, ExperimentError) as part:
            pyarrow.parquet.write_table(pyarrow.table(columns), part)
