"""A folder that keeps worlds and what happened in them."""

import fcntl
import importlib.util
import json
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.worlds.world import Outcome, Task

_NAME = "worlds.sqlite"
_TABLES = """
CREATE TABLE IF NOT EXISTS plan (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS worlds (
    key TEXT PRIMARY KEY, number INTEGER NOT NULL, code TEXT NOT NULL,
    scenario TEXT NOT NULL, parameters TEXT NOT NULL, is_feasible INTEGER NOT NULL,
    verdict TEXT NOT NULL, checked TEXT NOT NULL, metrics TEXT NOT NULL,
    events TEXT NOT NULL, error TEXT NOT NULL, attempts INTEGER NOT NULL, cpu_seconds REAL NOT NULL);
"""
# Kept as JSON, which knows NaN; a number of SQLite does not.
_JSON = ("parameters", "checked", "metrics")


@dataclass(kw_only=True)
class World(Outcome):
    """A world that was stored: its outcome, and what it is.

    Attributes
    ----------
    number : int
    code : str
        The `code_version` that has run it.
    scenario : str
        YAML.
    parameters : dict
        What was drawn.
    attempts : int
        How often it was begun.

    Examples
    --------
    >>> world = World(number=0, code="", scenario="", parameters={}, checked={})
    >>> world.was_run
    False
    """

    number: int
    code: str
    scenario: str
    parameters: dict[str, Any]
    attempts: int = 1

    @cached_property
    def fields(self) -> dict[str, Any]:
        """What the scenario says, also one that an older version has drawn."""
        fields: dict[str, Any] = yaml.load(self.scenario, Loader=yaml.CSafeLoader)
        return fields

    @property
    def was_run(self) -> bool:
        """Whether it was simulated, or an attempt was made."""
        return self.metrics is not None or bool(self.error)


def check_parquet() -> None:
    """Raise an ExperimentError where pyarrow is not installed."""
    if importlib.util.find_spec("pyarrow") is None:
        raise ExperimentError(
            "Parquet files need pyarrow: pip install fmp-drake[parquet]."
        )


class WorldStore:
    """Worlds in a SQLite file of a folder, one row each, readable at any moment.

    Parameters
    ----------
    folder : pathlib.Path
    plan : dict of str to str, optional
        What the worlds are drawn from. A new folder needs one; that of an existing
        folder must be the same.

    Raises
    ------
    ExperimentError
        Where there is no store, or one of another plan.

    Examples
    --------
    >>> store = WorldStore(Path("out"), {"spec": "", "seed": "0", "seconds": "14.0"})
    >>> store.worlds()
    []
    """

    def __init__(self, folder: Path, plan: dict[str, str] | None = None) -> None:
        self.folder = folder
        file = folder / _NAME
        if plan is None and not file.is_file():
            raise ExperimentError(f"there are no worlds in {folder}.")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._base = sqlite3.connect(file, isolation_level=None)
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.executescript(_TABLES)
            known = dict(self._base.execute("SELECT name, value FROM plan"))
            if not known and plan:
                known = plan
                rows = list(plan.items())
                self._base.executemany("INSERT INTO plan VALUES (?, ?)", rows)
        except (OSError, sqlite3.Error) as error:
            raise ExperimentError(f"cannot keep worlds in {folder}: {error}.") from None
        self.plan: dict[str, str] = known
        for name, value in (plan or {}).items():
            if known[name] != value:
                shown = f" ({known[name]}, not {value})" if len(value) < 40 else ""
                raise ExperimentError(
                    f"{folder} has worlds of another {name}{shown}; give another "
                    "folder."
                )

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Keep others from running the same worlds at the same time."""
        lock = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
        except BlockingIOError:
            raise ExperimentError(
                f"worlds are being run in {self.folder} by another process; wait for it."
            ) from None
        finally:
            os.close(lock)

    def keep(self, task: Task, world: World) -> None:
        """Write a world, in place of an earlier row of the same key."""
        row = {"key": task.key} | asdict(world)
        row |= {name: json.dumps(row[name]) for name in _JSON}
        names = ", ".join(row)
        marks = ", ".join(f":{name}" for name in row)
        self._base.execute(
            f"INSERT OR REPLACE INTO worlds ({names}) VALUES ({marks})", row
        )

    def finished(self, *, force: bool) -> set[str]:
        """Return the keys of the worlds that need not run, with `force` or without."""
        rows = self._base.execute("SELECT key, metrics, error FROM worlds")
        return {
            k for k, metrics, error in rows if not force or metrics != "null" or error
        }

    def world(self, number: int) -> World:
        """Return a world by its number.

        Raises
        ------
        ExperimentError
            Where there is none of that number.
        """
        worlds = {world.number: world for world in self.worlds()}
        if number not in worlds:
            known = f"{min(worlds)} to {max(worlds)}" if worlds else "none yet"
            raise ExperimentError(
                f"{self.folder} has no world {number}; its worlds are {known}."
            )
        return worlds[number]

    def worlds(self) -> list[World]:
        """Return the worlds by their numbers, of each what was written last."""
        cursor = self._base.execute("SELECT * FROM worlds ORDER BY rowid")
        names = [each[0] for each in cursor.description]
        found = {}
        for values in cursor:
            row = dict(zip(names, values, strict=True))
            row |= {name: json.loads(row[name]) for name in _JSON}
            row["is_feasible"] = bool(row["is_feasible"])
            del row["key"]
            found[row["number"]] = World(**row)
        return [found[number] for number in sorted(found)]

    def export(self, path: Path) -> None:
        """Write the worlds to a Parquet file, one column for each parameter and metric.

        It needs what `check_parquet` checks.
        """
        import pyarrow
        import pyarrow.parquet

        rows = []
        for world in self.worlds():
            row = asdict(world)
            for name in _JSON:
                row |= {f"{name}.{k}": v for k, v in (row.pop(name) or {}).items()}
            rows.append(row)
        names = list(dict.fromkeys(name for row in rows for name in row))
        columns = {name: [row.get(name) for row in rows] for name in names}
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
