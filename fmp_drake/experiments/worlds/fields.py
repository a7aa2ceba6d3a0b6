"""The values of a scenario by their dotted names."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.worlds.distribution import KINDS
from fmp_drake.station.scenario import field_names


def as_mapping(value: Any) -> Any:
    """Return a scenario, or a part of one, as mappings and lists with every key."""
    if isinstance(value, list):
        return [as_mapping(each) for each in value]
    names = field_names(value)
    if not names:
        return value
    return {name: as_mapping(getattr(value, name)) for name in names}


def leaves(given: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the names and values of nested mappings and lists.

    Keys may be dotted names themselves. A distribution is a value.
    """
    if isinstance(given, Mapping) and not is_distribution(given):
        for key, value in given.items():
            yield from leaves(value, f"{name}.{key}".lstrip("."))
    elif isinstance(given, list):
        for i, value in enumerate(given):
            yield from leaves(value, f"{name}[{i}]")
    else:
        yield name, given


def is_distribution(given: Any) -> bool:
    """Return whether a value is a distribution, to be read as such."""
    return isinstance(given, Mapping) and len(given) == 1 and set(given) <= set(KINDS)


def put(fields: dict[str, Any], name: str, value: Any) -> None:
    """Put a value where a dotted name such as ``board.rpy[2]`` says.

    Parameters
    ----------
    fields : dict
        Of `as_mapping`.

    Raises
    ------
    ExperimentError
        Where there is nothing of that name; it lists what there is.
    """
    place, key = _place(fields, name)
    place[key] = value


def get(fields: dict[str, Any], name: str) -> Any:
    """Return the value of a dotted name, as for `put`."""
    place, key = _place(fields, name)
    return place[key]


def _place(fields: dict[str, Any], name: str) -> tuple[Any, str | int]:
    """Return the mapping or list that holds a value, and its key there."""
    place: Any = fields
    keys = [int(k) if k.isdigit() else k for k in re.findall(r"[^.\[\]]+", name)]
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
