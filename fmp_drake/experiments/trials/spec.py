"""Distributions over scenarios, which a YAML file specifies."""

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
from fmp_drake.experiments.trials.store import Trial
from fmp_drake.numeric import check_number, is_number, is_whole, shown
from fmp_drake.settings import check_yaml
from fmp_drake.skills.learning import default_demonstration
from fmp_drake.station import LoadRobot, LoadScenario, ParseScenario, models_dir
from fmp_drake.station.scenario_parts import field_names
from fmp_drake.systems.scripted_disturbances import Disturbance

KINDS = {
    "uniform": "[least, most], within 1e+15",
    "log_uniform": "[least, most], both positive",
    "normal": "[mean, standard deviation, least, most]",
    "choice": "[one, another, ...], at most 200, equally likely",
}
"""Kinds of distributions, with the values that each expects."""

# Greatest bound of a uniform distribution, which may draw integers; greatest numbers of
# attempts to draw a normal value between its bounds, of disturbances in a trial, and of
# choices, each of which is tried in advance in 20 ms.
_GREATEST, _ATTEMPTS, _MOST_DISTURBANCES, _MOST_CHOICES = 1e15, 1000, 1000, 200


@dataclass(frozen=True)
class Distribution:
    """Distribution of one value of a scenario.

    Parameters
    ----------
    kind : str
        One of `KINDS`. A uniform distribution between integers draws integers.
    values : tuple
        Values that `KINDS` describes.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> 0.3 < Distribution("uniform", (0.3, 0.8)).draw(rng) < 0.8
    True
    """

    kind: str
    values: tuple[Any, ...]

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
        # The bounds are so narrow that the distribution is flat between them.
        return float(rng.uniform(least, most))

    def extremes(self) -> tuple[Any, ...]:
        """Return the least and the greatest value, or all choices."""
        return self.values[2:] if self.kind == "normal" else self.values


def read_value(name: str, value: Any) -> Any:
    """Read a distribution such as ``{uniform: [0, 1]}``; return another value unchanged.

    Raises
    ------
    ExperimentError
        If the values of a distribution are invalid; it lists the allowed ones.
    """
    if not _is_distribution(value):
        return value
    ((kind, values),) = value.items()
    if not _is_valid(kind, values):
        raise ExperimentError(
            f"{name} is {{{kind}: {shown(values)}}}; expected {kind}: {KINDS[kind]}."
        )
    return Distribution(kind, tuple(values))


def _is_distribution(value: Any) -> bool:
    """Return whether a value from YAML is a distribution."""
    return isinstance(value, Mapping) and len(value) == 1 and set(value) <= set(KINDS)


def _is_valid(kind: str, values: Any) -> bool:
    """Return whether a distribution of a kind can have values, as `KINDS` says."""
    match kind, values:
        case "choice", [_, *_]:
            return len(values) <= _MOST_CHOICES
        case _, [*numbers] if not all(map(is_number, numbers)):
            return False
        case "uniform", [least, most]:
            return -_GREATEST <= least <= most <= _GREATEST
        case "log_uniform", [least, most]:
            return 0 < least <= most
        case "normal", [mean, deviation, least, most]:
            return deviation > 0 and least <= mean <= most
    return False


_KEYS = ("description", "base", "robot", "offsets", "fields", "disturbances")
_FILES = ("skill.demonstration", "skill.file", "ink.picture", "tool")
# Number of disturbances, which may be drawn.
_COUNT = "disturbances.count"
# Part of a dotted name.
_KEY = re.compile(r"[^.\[\]]+")
# Demonstration; a scenario in free space keeps its own.
_DEMONSTRATION = "skill.demonstration"


class TrialSpec:
    """Distributions over scenarios.

    A trial depends only on this text, a seed and its number.

    Parameters
    ----------
    text : str
        YAML with any of these keys: `description`; `base`, the name of a scenario or a
        choice of several; `robot`, the name of a robot or a choice of several, instead of
        those of the bases; `fields`, values or distributions by nested or dotted names
        such as ``board.translation[2]``; `offsets`, the same, added to the values of the
        base; `disturbances` with their `count` and the fields of `each`. Friction is
        disabled for a robot whose joint friction is unknown. A base in free space keeps
        its `skill.demonstration`.
    folder : pathlib.Path
        Folder of the files that the text names.

    Raises
    ------
    ExperimentError, StationError
        If a name or a value is not valid in a scenario; it lists the allowed ones.

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
        content = _read_yaml(text)
        keys = content if isinstance(content, dict) else [content]
        if not isinstance(content, dict) or not set(content) <= set(_KEYS):
            raise ExperimentError(
                f"distributions have the keys {', '.join(_KEYS)}; got "
                f"{', '.join(map(shown, keys))}."
            )
        for key in ("base", "robot"):
            value = content.get(key)
            if isinstance(value, dict | list) and not _is_distribution(value):
                raise ExperimentError(
                    f"{key} is {shown(value)}; expected a name, or choice: {KINDS['choice']}."
                )
        base = content.get("base", "table_top")
        self._base = read_value("base", base if isinstance(base, dict) else str(base))
        names = self._base.values if isinstance(self._base, Distribution) else [base]
        self._robot = read_value("robot", content.get("robot"))
        self._bases = {name: self._load(str(name)) for name in names}
        self._fields = _named_values(content, "fields")
        self._offsets = _named_values(content, "offsets")
        disturbances = content.get("disturbances") or {"count": 0}
        is_mapping = isinstance(disturbances, dict)
        if not is_mapping or not set(disturbances) <= {"count", "each"}:
            raise ExperimentError(
                f"disturbances is {shown(disturbances)}; expected a mapping with count "
                "and each."
            )
        self._count = read_value(_COUNT, disturbances.get("count", 1))
        self._disturbance = _named_values(disturbances, "each")
        self._check()

    @classmethod
    def load(cls, path: str | Path, *, robot: str | None = None) -> "TrialSpec":
        """Load a YAML file, or one that comes with the package by its bare name.

        Parameters
        ----------
        path : str or pathlib.Path
        robot : str, optional
            Name or YAML file of the robot of all trials, instead of that in the file.
        """
        file = Path(path)
        if file.suffix not in (".yaml", ".yml"):
            file = models_dir() / "worlds" / f"{path}.yaml"
        if not file.is_file():
            names = sorted(p.stem for p in (models_dir() / "worlds").glob("*.yaml"))
            raise ExperimentError(
                f"there are no distributions {path}; give a YAML file or one of: "
                f"{', '.join(names)}."
            )
        try:
            text = file.read_text(encoding="utf-8")
        except UnicodeDecodeError as error:
            raise ExperimentError(f"{file} is not text: {error}.") from None
        if robot is not None:
            name = str(Path(robot).resolve()) if Path(robot).is_file() else robot
            content = _read_yaml(text)
            if isinstance(content, dict):  # Workers read this text.
                text = yaml.dump(content | {"robot": name}, sort_keys=False)
        return cls(text, folder=file.parent)

    def plan(self, *, seed: int, duration: float) -> dict[str, str]:
        """Return the common settings of all trials of a store."""
        length = repr(float(duration))
        return {"spec": self.text, "seed": str(seed), "duration": length}

    def draw(self, *, seed: int, number: int) -> Trial:
        """Draw a trial.

        Parameters
        ----------
        seed : int
            Seed of all trials.
        number : int
            Number of this trial, which does not depend on the other ones.
        """
        sequence = np.random.SeedSequence(seed, spawn_key=(number,))
        rng = np.random.default_rng(sequence)
        return self._make(number, lambda distribution: distribution.draw(rng))

    def _make(self, number: int, choose: Callable[[Distribution], Any]) -> Trial:
        """Return a trial with one value of each distribution."""
        parameters: dict[str, Any] = {}

        def take(name: str, value: Any) -> Any:
            if not isinstance(value, Distribution):
                return value
            parameters[name] = choose(value)
            return parameters[name]

        fields = deepcopy(self._bases[take("base", self._base)])
        has_board = fields["board"]["shape"] != "none"
        robot = take("robot", self._robot)
        for name, value in self._fields.items():
            single_value = self._absolute_path(name, take(name, value))
            if name != _DEMONSTRATION or has_board:
                _put(fields, name, single_value)
            else:  # Not played, but drawn, so that later draws do not depend on the base.
                parameters.pop(name, None)
        for name, value in self._offsets.items():
            offset = take(f"{name}, offset", value)
            container, key = _find(fields, name)
            if not (is_number(offset) and is_number(container[key])):
                raise ExperimentError(
                    f"the offset {shown(offset)} of {name}, which is "
                    f"{shown(container[key])}; expected two numbers."
                )
            container[key] += offset
        if robot not in (None, fields["robot"]):
            self._replace_robot(fields, robot)
        for i in range(take(_COUNT, self._count)):
            disturbance = _as_mapping(Disturbance())
            for name, value in self._disturbance.items():
                _put(disturbance, name, take(f"disturbances[{i}].{name}", value))
            fields["disturbances"].append(disturbance)
        text = yaml.dump(fields, Dumper=yaml.CSafeDumper, sort_keys=False)
        return Trial(number=number, scenario=text, parameters=parameters)

    def _check(self) -> None:
        """Check the extremes of all distributions against `Scenario`."""
        values = [
            self._base,
            self._robot,
            self._count,
            *self._fields.values(),
            *self._offsets.values(),
            *self._disturbance.values(),
        ]
        extremes = [v.extremes() for v in values if isinstance(v, Distribution)]
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

            def extreme(distribution: Distribution, i: int = i) -> Any:
                extremes = distribution.extremes()
                if distribution is self._count:  # With all disturbances.
                    return max(extremes)
                return extremes[i % len(extremes)]

            trial = self._make(0, extreme)
            scenario = ParseScenario(
                trial.scenario, name="an extreme of the specification"
            )
            if not scenario.skill.file:
                default_demonstration(scenario.skill.demonstration)

    def _load(self, name: str) -> dict[str, Any]:
        path = self.folder / name if name.endswith((".yaml", ".yml")) else name
        fields: dict[str, Any] = _as_mapping(LoadScenario(path))
        return fields

    def _replace_robot(self, fields: dict[str, Any], name: Any) -> None:
        """Replace the robot of a scenario, with its posture and its known friction."""
        file = self.folder / str(name)
        robot = str(file.resolve()) if file.is_file() else str(name)
        fields["robot"], fields["posture"] = robot, []
        if not LoadRobot(robot).friction.height:
            fields["friction"]["enabled"] = False
            fields["impedance"]["friction_compensation"]["enabled"] = False

    def _absolute_path(self, name: str, value: Any) -> Any:
        """Return the absolute path of a file in the folder, any other value unchanged."""
        if name not in _FILES or not value:
            return value
        given = Path(str(value))
        file = self.folder / given
        if given.suffix and not (file.exists() or given.exists()):
            raise ExperimentError(
                f"{name} is {shown(value)}; there is no such file in "
                f"{self.folder.resolve()}."
            )
        return str(file.resolve()) if file.is_file() else value


def own_files(fields: Mapping[str, Any]) -> list[Path]:
    """Return the files on which a scenario depends, except those of the package."""
    files: list[Path] = []
    for name in (*_FILES, "robot"):
        value: Any = fields
        for key in name.split("."):
            value = (value or {}).get(key)
        file = Path(str(value or ""))
        if not file.is_absolute() or file.is_relative_to(models_dir().resolve()):
            continue
        found = {file}
        if name == "robot":  # Its model may include others beside it.
            model = Path(LoadRobot(file).model)
            found |= {model, *model.parent.glob("*.[us]*df")}
        files += [each for each in sorted(found) if each.is_file()]
    return files


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """Loader that reads `1e5` as a number, as scenarios do; in YAML 1.1 it is a word."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$"),
    list("-+0123456789"),
)


def _read_yaml(text: str) -> Any:
    """Return the content of a specification."""
    check_yaml(text, "the specification", ExperimentError)
    try:
        return yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError) as error:
        raise ExperimentError(
            f"the specification cannot be read as YAML: {error}."
        ) from None


def _as_mapping(value: Any) -> Any:
    """Return a scenario, or a part of one, as mappings and lists with every key."""
    if isinstance(value, list):
        return [_as_mapping(item) for item in value]
    names = field_names(value)
    if not names:
        return value
    return {name: _as_mapping(getattr(value, name)) for name in names}


def _named_values(content: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Return the values or distributions below a key by their dotted names."""
    tree = content.get(key) or {}
    if not isinstance(tree, Mapping) or _is_distribution(tree):
        raise ExperimentError(
            f"{key} is {shown(tree)}; expected names with values or distributions, such as "
            "force: {uniform: [5.0, 15.0]}."
        )
    values: dict[str, Any] = {}
    known: set[tuple[str, ...]] = set()
    for name, value in _leaves(tree):
        keys = tuple(_KEY.findall(name))
        if keys in known:
            raise ExperimentError(f"{key} has {name} twice; keep one.")
        known.add(keys)
        values[name] = value
    return values


def _leaves(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the names and values or distributions of nested mappings and lists.

    Keys may be dotted names.
    """
    if isinstance(tree, Mapping) and not _is_distribution(tree):
        for key, value in tree.items():
            yield from _leaves(value, f"{name}.{key}".lstrip("."))
    elif isinstance(tree, list) and tree:
        for i, value in enumerate(tree):
            yield from _leaves(value, f"{name}[{i}]")
    else:
        yield name, read_value(name, tree)


def _put(fields: dict[str, Any], name: str, value: Any) -> None:
    """Set the value of a dotted name such as ``board.rpy[2]``."""
    container, key = _find(fields, name)
    container[key] = value


def _find(fields: dict[str, Any], name: str) -> tuple[Any, str | int]:
    """Return the mapping or list with the value of a dotted name, and the value's key.

    Parameters
    ----------
    fields : dict
        From `_as_mapping`.

    Raises
    ------
    ExperimentError
        Where there is no such name; it lists the allowed ones.
    """
    container: Any = fields
    keys = [int(k) if k.isdecimal() else k for k in _KEY.findall(name)]
    for i, key in enumerate(keys):
        parent = ".".join(map(str, keys[:i])) or "it"
        if not isinstance(container, dict | list):
            raise ExperimentError(
                f"{parent} is a value or one distribution ({', '.join(KINDS)}); got {key}."
            )
        is_list = isinstance(container, list)
        allowed = list(range(len(container)) if is_list else container)
        if key not in allowed:
            names = ", ".join(map(str, allowed)) or (
                "no values; give them in a scenario, the base"
            )
            raise ExperimentError(f"there is no {name}: {parent} has {names}.")
        if i == len(keys) - 1:
            return container, key
        container = container[key]
    raise ExperimentError(f"{name!r} is not a name; expected one such as board.rpy[2].")
