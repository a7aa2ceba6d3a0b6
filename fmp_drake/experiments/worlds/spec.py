"""Distributions over scenarios, from a YAML file."""

from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.worlds.distribution import Distribution
from fmp_drake.experiments.worlds.fields import (
    as_mapping,
    get,
    is_distribution,
    leaves,
    put,
)
from fmp_drake.numeric import is_number, is_whole
from fmp_drake.station import Disturbance, LoadScenario, ParseScenario, models_dir

_KEYS = ("description", "base", "offsets", "fields", "disturbances")
_FILES = ("skill.demonstration", "skill.file", "ink.picture")
# With a mapping for every disturbance, this may be drawn.
_COUNT = "disturbances.count"


@dataclass(frozen=True)
class Drawn:
    """One world that was drawn.

    Attributes
    ----------
    scenario : str
        YAML, with every key.
    parameters : dict of str to object
        What was drawn, by the names of the fields.
    """

    scenario: str
    parameters: dict[str, Any]


class WorldSpec:
    """Distributions over scenarios.

    A world depends on this text, a seed and its number, and on nothing else.

    Parameters
    ----------
    text : str
        YAML with any of the keys `description`; `base`, the name of a scenario or a
        choice of several; `fields`, values or distributions by nested or dotted names
        such as ``board.translation[2]``; `offsets`, the same, added to what the base
        has; `disturbances` with `count` and the fields of `each`.
    folder : pathlib.Path
        In which the files are that it names.

    Raises
    ------
    ExperimentError, StationError
        Where a name or a value does not fit a scenario; it lists what is allowed.

    Examples
    --------
    >>> spec = WorldSpec("fields: {press.force: {uniform: [5.0, 15.0]}}")
    >>> world = spec.draw(seed=0, number=3)
    >>> world == spec.draw(seed=0, number=3)
    True
    >>> 5.0 < world.parameters["press.force"] < 15.0
    True
    """

    def __init__(self, text: str, *, folder: Path = Path()) -> None:
        self.text = text
        self.folder = folder
        try:
            given = yaml.safe_load(text) or {}
        except yaml.YAMLError as error:
            raise ExperimentError(f"worlds cannot be read as YAML: {error}.") from None
        if not isinstance(given, dict) or not set(given) <= set(_KEYS):
            raise ExperimentError(
                f"worlds have the keys {', '.join(_KEYS)}; got "
                f"{', '.join(map(str, given)) if isinstance(given, dict) else given!r}."
            )
        self.description = str(given.get("description", ""))
        base = given.get("base", "table_top")
        self._base = _read("base", base if isinstance(base, dict) else str(base))
        names = self._base.values if isinstance(self._base, Distribution) else [base]
        self._bases = {name: self._load(str(name)) for name in names}
        self._fields = {n: _read(n, v) for n, v in leaves(given.get("fields") or {})}
        self._offsets = {n: _read(n, v) for n, v in leaves(given.get("offsets") or {})}
        pushes = given.get("disturbances") or {"count": 0}
        if not isinstance(pushes, dict) or not set(pushes) <= {"count", "each"}:
            raise ExperimentError(
                f"disturbances is {pushes!r}; expected a mapping with count and each."
            )
        self._count = _read(_COUNT, pushes.get("count", 1))
        self._each = {n: _read(n, v) for n, v in leaves(pushes.get("each") or {})}
        self._check()

    @classmethod
    def load(cls, path: str | Path) -> "WorldSpec":
        """Load a YAML file, or one that comes with the package by its bare name."""
        file = Path(path)
        if file.suffix not in (".yaml", ".yml"):
            file = models_dir() / "worlds" / f"{path}.yaml"
        if not file.is_file():
            known = sorted(p.stem for p in (models_dir() / "worlds").glob("*.yaml"))
            raise ExperimentError(
                f"there are no worlds {path}; give a YAML file or one of: "
                f"{', '.join(known)}."
            )
        return cls(file.read_text(encoding="utf-8"), folder=file.parent)

    def plan(self, *, seed: int, seconds: float) -> dict[str, str]:
        """Return what the worlds of a store have in common."""
        return {"spec": self.text, "seed": str(seed), "seconds": repr(float(seconds))}

    def draw(self, *, seed: int, number: int) -> Drawn:
        """Draw a world.

        Parameters
        ----------
        seed : int
            Of all worlds.
        number : int
            Of this one; that of others makes no difference to it.
        """
        sequence = np.random.SeedSequence(seed, spawn_key=(number,))
        rng = np.random.default_rng(sequence)
        return self._make(
            lambda value: value.draw(rng) if isinstance(value, Distribution) else value
        )

    def _make(self, choose: Any) -> Drawn:
        """Make a scenario of what is chosen of each distribution."""
        parameters: dict[str, Any] = {}

        def take(name: str, value: Any) -> Any:
            chosen = choose(value)
            if isinstance(value, Distribution):
                parameters[name] = chosen
            return chosen

        fields = deepcopy(self._bases[take("base", self._base)])
        for name, value in self._fields.items():
            put(fields, name, self._found(name, take(name, value)))
        for name, value in self._offsets.items():
            offset, before = take(f"{name}, offset", value), get(fields, name)
            if not (is_number(offset) and is_number(before)):
                raise ExperimentError(
                    f"the offset {offset!r} of {name}, which is {before!r}; expected "
                    "two numbers."
                )
            put(fields, name, before + offset)
        for i in range(take(_COUNT, self._count)):
            each = as_mapping(Disturbance())
            for name, value in self._each.items():
                put(each, name, take(f"disturbances[{i}].{name}", value))
            fields["disturbances"].append(each)
        text = yaml.dump(fields, Dumper=yaml.CSafeDumper, sort_keys=False)
        return Drawn(text, parameters)

    def _check(self) -> None:
        """Check the extremes of all distributions against `Scenario`."""
        drawn = [self._base, self._count, *self._fields.values(), *self._each.values()]
        extremes = [d.extremes() for d in drawn if isinstance(d, Distribution)]
        counts = [self._count]
        if isinstance(self._count, Distribution):
            counts = list(self._count.extremes())
        if not all(is_whole(count) and count >= 0 for count in counts):
            raise ExperimentError(
                f"{_COUNT} may be {counts}; expected whole numbers, not negative."
            )
        for i in range(max(map(len, extremes), default=1)):

            def nth(value: Any, i: int = i) -> Any:
                if not isinstance(value, Distribution):
                    return value
                return value.extremes()[i % len(value.extremes())]

            ParseScenario(self._make(nth).scenario, name="a world at its extremes")

    def _load(self, name: str) -> dict[str, Any]:
        path = self.folder / name if name.endswith((".yaml", ".yml")) else name
        fields: dict[str, Any] = as_mapping(LoadScenario(path))
        return fields

    def _found(self, name: str, value: Any) -> Any:
        """Return the whole path of a file that is beside the YAML file."""
        beside = name in _FILES and value and (self.folder / str(value)).is_file()
        return str((self.folder / value).resolve()) if beside else value


def _read(name: str, value: Any) -> Any:
    """Return a distribution where the value is one."""
    return Distribution.read(value, name) if is_distribution(value) else value
