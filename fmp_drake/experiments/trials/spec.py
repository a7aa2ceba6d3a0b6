"""Distributions over scenarios, from a YAML file."""

import re
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from math import exp, log
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.trials.trial import Trial
from fmp_drake.numeric import check_number, is_number, is_whole, shown
from fmp_drake.settings import check_yaml
from fmp_drake.station import LoadRobot, LoadScenario, ParseScenario, models_dir
from fmp_drake.station.scenario import field_names
from fmp_drake.station.scenario_parts import Disturbance

KINDS = {
    "uniform": "[least, most], within 1e+15",
    "log_uniform": "[least, most], both positive",
    "normal": "[mean, standard deviation, least, most]",
    "choice": "[one, another, ...], at most 200, equally likely",
}
"""Names of the distributions, with the values that each expects."""

# Greatest bound of a uniform distribution, which may draw integers; attempts to draw a
# value between the bounds of a normal distribution; disturbances of a trial. Each choice is
# tried in advance, in 20 ms.
_GREATEST, _ATTEMPTS, _MOST_DISTURBANCES, _MOST_CHOICES = 1e15, 1000, 1000, 200


@dataclass(frozen=True)
class Distribution:
    """Distribution of one value of a scenario.

    Parameters
    ----------
    kind : str
        One of `KINDS`. Uniform between whole numbers draws whole numbers.
    values : tuple
        One of `KINDS`.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> 0.3 < Distribution("uniform", (0.3, 0.8)).draw(rng) < 0.8
    True
    """

    kind: str
    values: tuple[Any, ...]

    @classmethod
    def read(cls, given: Mapping[str, Any], name: str) -> "Distribution":
        """Read a distribution such as ``{uniform: [0, 1]}``.

        Raises
        ------
        ExperimentError
            If the values do not fit; it lists the allowed ones.
        """
        ((kind, values),) = given.items()
        fits = isinstance(values, list) and len(values) > 0
        if fits and kind == "choice":
            fits = len(values) <= _MOST_CHOICES
        elif fits:
            fits = len(values) == (4 if kind == "normal" else 2)
            fits = fits and all(map(is_number, values))
        if fits and kind == "uniform":
            fits = values[0] <= values[1] and max(map(abs, values)) <= _GREATEST
        elif fits and kind == "log_uniform":
            fits = 0 < values[0] <= values[1]
        elif fits and kind == "normal":
            fits = values[1] > 0 and values[2] <= values[0] <= values[3]
        if not fits:
            raise ExperimentError(
                f"{name} is {{{kind}: {shown(values)}}}; expected {kind}: {KINDS[kind]}."
            )
        return cls(kind, tuple(values))

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw a value."""
        if self.kind == "choice":
            return self.values[rng.integers(len(self.values))]
        if self.kind == "log_uniform":
            least, most = map(log, self.values)
            return exp(rng.uniform(least, most))
        if self.kind == "uniform":
            least, most = self.values
            if is_whole(least) and is_whole(most):
                return int(rng.integers(least, most, endpoint=True))
            return float(rng.uniform(least, most))
        mean, deviation, least, most = self.values
        for _ in range(_ATTEMPTS):
            if least <= (value := float(rng.normal(mean, deviation))) <= most:
                return value
        # So little of the distribution is within the bounds that it is flat there.
        return float(rng.uniform(least, most))

    def extremes(self) -> tuple[Any, ...]:
        """Return the values that are the least and the greatest, or all choices."""
        return self.values[2:] if self.kind == "normal" else self.values


_KEYS = ("description", "base", "robot", "offsets", "fields", "disturbances")
_FILES = ("skill.demonstration", "skill.file", "ink.picture")
# With a mapping for every disturbance, this may be drawn.
_COUNT = "disturbances.count"
# What is wiped on a board is nothing to follow without one.
_TASK = "skill.demonstration"


class TrialSpec:
    """Distributions over scenarios.

    A trial depends on this text, a seed and its number only.

    Parameters
    ----------
    text : str
        YAML with any of the keys `description`; `base`, the name of a scenario or a
        choice of several; `robot`, the name of a robot or a choice of several instead of
        the bases' own, without joint friction where it is not known; `fields`, values or
        distributions by nested or dotted names such as ``board.translation[2]`` (a base in
        free space keeps its `skill.demonstration`);
        `offsets`, the same, added to what the base has; `disturbances` with `count` and
        the fields of `each`.
    folder : pathlib.Path
        Folder of the files that it names.

    Raises
    ------
    ExperimentError, StationError
        Where a name or a value does not fit a scenario; it lists what is allowed.

    Examples
    --------
    >>> spec = TrialSpec("fields: {press.force: {uniform: [5.0, 15.0]}}")
    >>> trial = spec.draw(seed=0, number=3)
    >>> trial == spec.draw(seed=0, number=3)
    True
    >>> 5.0 < trial.parameters["press.force"] < 15.0
    True
    """

    def __init__(self, text: str, *, folder: Path = Path()) -> None:
        self.text = text
        self.folder = folder
        check_yaml(text, "the specification", ExperimentError)
        try:
            given = yaml.safe_load(text) or {}
        except (yaml.YAMLError, ValueError) as error:
            raise ExperimentError(
                f"the specification cannot be read as YAML: {error}."
            ) from None
        if not isinstance(given, dict) or not set(given) <= set(_KEYS):
            raise ExperimentError(
                f"distributions have the keys {', '.join(_KEYS)}; got "
                f"{', '.join(map(shown, given)) if isinstance(given, dict) else shown(given)}."
            )
        self.description = str(given.get("description", ""))
        base = given.get("base", "table_top")
        self._base = _read("base", base if isinstance(base, dict) else str(base))
        names = self._base.values if isinstance(self._base, Distribution) else [base]
        self._robot = _read("robot", given.get("robot"))
        self._bases = {name: self._load(str(name)) for name in names}
        self._fields = dict(_leaves(given.get("fields") or {}))
        self._offsets = dict(_leaves(given.get("offsets") or {}))
        pushes = given.get("disturbances") or {"count": 0}
        if not isinstance(pushes, dict) or not set(pushes) <= {"count", "each"}:
            raise ExperimentError(
                f"disturbances is {shown(pushes)}; expected a mapping with count and "
                "each."
            )
        self._count = _read(_COUNT, pushes.get("count", 1))
        self._each = dict(_leaves(pushes.get("each") or {}))
        self._check()

    @classmethod
    def load(cls, path: str | Path, *, robot: str | None = None) -> "TrialSpec":
        """Load a YAML file, or one that comes with the package by its bare name.

        Parameters
        ----------
        path : str or pathlib.Path
        robot : str, optional
            Name or YAML file of the robot of all trials, instead of the file's.
        """
        file = Path(path)
        if file.suffix not in (".yaml", ".yml"):
            file = models_dir() / "worlds" / f"{path}.yaml"
        if not file.is_file():
            known = sorted(p.stem for p in (models_dir() / "worlds").glob("*.yaml"))
            raise ExperimentError(
                f"there are no distributions {path}; give a YAML file or one of: "
                f"{', '.join(known)}."
            )
        try:
            text = file.read_text(encoding="utf-8")
        except UnicodeDecodeError as error:
            raise ExperimentError(f"{file} is not text: {error}.") from None
        if robot is not None:
            name = Path(robot).resolve() if Path(robot).is_file() else robot
            text = f"{text.rstrip()}\nrobot: {name}\n"  # The last key counts in YAML.
        return cls(text, folder=file.parent)

    def plan(self, *, seed: int, seconds: float) -> dict[str, str]:
        """Return the common settings of all trials of a store."""
        return {"spec": self.text, "seed": str(seed), "seconds": repr(float(seconds))}

    def draw(self, *, seed: int, number: int) -> Trial:
        """Draw a trial.

        Parameters
        ----------
        seed : int
            Of all trials.
        number : int
            Of this one; other numbers do not influence it.
        """
        sequence = np.random.SeedSequence(seed, spawn_key=(number,))
        rng = np.random.default_rng(sequence)
        return self._make(
            number,
            lambda value: value.draw(rng) if isinstance(value, Distribution) else value,
        )

    def _make(self, number: int, choose: Callable[[Any], Any]) -> Trial:
        """Return a trial with a chosen value of each distribution."""
        parameters: dict[str, Any] = {}

        def take(name: str, value: Any) -> Any:
            chosen = choose(value)
            if isinstance(value, Distribution):
                parameters[name] = chosen
            return chosen

        fields = deepcopy(self._bases[take("base", self._base)])
        robot = take("robot", self._robot)
        for name, value in self._fields.items():
            chosen = self._resolved(name, take(name, value))
            if name != _TASK or fields["board"]["shape"] != "none":
                _put(fields, name, chosen)
        for name, value in self._offsets.items():
            offset, (place, key) = take(f"{name}, offset", value), _place(fields, name)
            if not (is_number(offset) and is_number(place[key])):
                raise ExperimentError(
                    f"the offset {shown(offset)} of {name}, which is "
                    f"{shown(place[key])}; expected two numbers."
                )
            place[key] += offset
        if robot not in (None, fields["robot"]):
            self._replace_robot(fields, robot)
        for i in range(take(_COUNT, self._count)):
            each = _as_mapping(Disturbance())
            for name, value in self._each.items():
                _put(each, name, take(f"disturbances[{i}].{name}", value))
            fields["disturbances"].append(each)
        text = yaml.dump(fields, Dumper=yaml.CSafeDumper, sort_keys=False)
        return Trial(number=number, scenario=text, parameters=parameters)

    def _check(self) -> None:
        """Check the extremes of all distributions against `Scenario`."""
        drawn = [
            self._base,
            self._robot,
            self._count,
            *self._fields.values(),
            *self._each.values(),
        ]
        extremes = [d.extremes() for d in drawn if isinstance(d, Distribution)]
        is_drawn = isinstance(self._count, Distribution)
        for count in self._count.extremes() if is_drawn else [self._count]:
            check_number(
                count,
                _COUNT,
                least=0,
                most=_MOST_DISTURBANCES,
                whole=True,
                error=ExperimentError,
            )
        for i in range(max(map(len, extremes), default=1)):

            def nth(value: Any, i: int = i) -> Any:
                if not isinstance(value, Distribution):
                    return value
                return value.extremes()[i % len(value.extremes())]

            ParseScenario(
                self._make(0, nth).scenario, name="a scenario at its extremes"
            )

    def _load(self, name: str) -> dict[str, Any]:
        path = self.folder / name if name.endswith((".yaml", ".yml")) else name
        fields: dict[str, Any] = _as_mapping(LoadScenario(path))
        return fields

    def _replace_robot(self, fields: dict[str, Any], name: Any) -> None:
        """Put a robot into a scenario, with its posture, and friction if it is known."""
        beside = self.folder / str(name)
        robot = str(beside.resolve()) if beside.is_file() else str(name)
        fields["robot"], fields["posture"] = robot, []
        if not LoadRobot(robot).friction.height:
            fields["friction"]["enabled"] = False
            fields["impedance"]["friction_compensation"]["enabled"] = False

    def _resolved(self, name: str, value: Any) -> Any:
        """Return the full path of a file that lies beside the YAML file."""
        beside = name in _FILES and value and (self.folder / str(value)).is_file()
        return str((self.folder / value).resolve()) if beside else value


def _read(name: str, value: Any) -> Any:
    """Return a distribution where the value is one."""
    return Distribution.read(value, name) if _is_distribution(value) else value


def _as_mapping(value: Any) -> Any:
    """Return a scenario, or a part of one, as mappings and lists with every key."""
    if isinstance(value, list):
        return [_as_mapping(each) for each in value]
    names = field_names(value)
    if not names:
        return value
    return {name: _as_mapping(getattr(value, name)) for name in names}


def _leaves(given: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the names and values or distributions of nested mappings and lists.

    Keys may be dotted names themselves.
    """
    if isinstance(given, Mapping) and not _is_distribution(given):
        for key, value in given.items():
            yield from _leaves(value, f"{name}.{key}".lstrip("."))
    elif isinstance(given, list) and given:
        for i, value in enumerate(given):
            yield from _leaves(value, f"{name}[{i}]")
    else:
        yield name, _read(name, given)


def _is_distribution(given: Any) -> bool:
    """Return whether a value is a distribution, to be read as such."""
    return isinstance(given, Mapping) and len(given) == 1 and set(given) <= set(KINDS)


def _put(fields: dict[str, Any], name: str, value: Any) -> None:
    """Set the value of a dotted name such as ``board.rpy[2]``."""
    place, key = _place(fields, name)
    place[key] = value


def _place(fields: dict[str, Any], name: str) -> tuple[Any, str | int]:
    """Return the mapping or list that holds the value of a dotted name, and its key there.

    Parameters
    ----------
    fields : dict
        Of `_as_mapping`.

    Raises
    ------
    ExperimentError
        Where there is no such name; it lists the allowed ones.
    """
    place: Any = fields
    keys = [int(k) if k.isdecimal() else k for k in re.findall(r"[^.\[\]]+", name)]
    for i, key in enumerate(keys):
        before = ".".join(map(str, keys[:i])) or "it"
        if not isinstance(place, dict | list):
            raise ExperimentError(
                f"there is no {name}: {before} is a value. Distributions are "
                f"{', '.join(KINDS)}."
            )
        known = list(range(len(place)) if isinstance(place, list) else place)
        if key not in known:
            raise ExperimentError(
                f"there is no {name}: {before} has {', '.join(map(str, known))}."
            )
        if i == len(keys) - 1:
            return place, key
        place = place[key]
    raise ExperimentError(f"{name!r} is no name; expected one such as board.rpy[2].")
