"""Settings: dataclasses whose numbers declare their ranges, and size limits of YAML."""

import dataclasses
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import yaml

from fmp_drake.errors import FmpError
from fmp_drake.numeric import check_number, check_type, shown

# Limits of YAML text: bytes, nodes with aliases expanded, and levels. The station with
# the most settings has 300 nodes on 5 levels.
_MOST_BYTES, _MOST_NODES, _MOST_LEVELS = 2**20, 20_000, 50
_LONG_INTEGER = re.compile(r"[-+]?[\da-fA-FxXob_:]{100,}")


def bounded(default: float | Sequence[float] | None, **limits: Any) -> Any:
    """Declare a dataclass field, a number or a list of numbers, with its range.

    Parameters
    ----------
    default : float, sequence of floats or None
        Each instance gets its own list. A list must be as long as its default, unless
        the default is empty: the number of joints, for example, depends on the robot.
        With None the number may be None.
    **limits : float or str
        Its limits `above`, `least`, `below`, `most`, and a `hint`, as for
        `check_number`.

    Returns
    -------
    dataclasses.Field
    """
    if isinstance(default, Sequence):
        return dataclasses.field(default_factory=lambda: list(default), metadata=limits)
    return dataclasses.field(default=default, metadata=limits)


def check_settings(settings: Any, error: type[FmpError], name: str = "") -> None:
    """Check every number of a dataclass, and of the dataclasses in it.

    Arrays become lists. Numbers must be finite and in the range that `bounded` declared. A
    dataclass may check further conditions in a method `inconsistency`, which returns an
    error message or an empty string.

    Parameters
    ----------
    settings : dataclass
    error : type
        Type of the error.
    name : str
        Prefix of the names in messages.

    Raises
    ------
    FmpError
        Of the given type, with the name, the value and the allowed range. Also for an
        attribute that is not a field; classes of a user's own may have others.
    """
    fields = dataclasses.fields(settings)
    names = [field.name for field in fields]
    # An assignment to a misspelled name, such as press.forse = 8.0, would have no effect.
    is_own = type(settings).__module__.startswith("fmp_drake.")
    for key in getattr(settings, "__dict__", {}) if is_own else ():
        if key not in names and not key.startswith("_"):
            owner = name.rstrip(". ") or type(settings).__name__
            raise error(f"there is no {name}{key}: {owner} has {', '.join(names)}.")
    for field in fields:
        value, path = getattr(settings, field.name), f"{name}{field.name}"
        default = field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        if isinstance(value, np.ndarray) and value.ndim == 1:
            value = value.tolist()
            setattr(settings, field.name, value)
        if dataclasses.is_dataclass(value):
            check_settings(value, error, f"{path}.")
        elif dataclasses.is_dataclass(default):
            check_type(value, path, type(default), error=error)
        elif isinstance(default, list) and field.type != list[str]:
            _check_list(value, default, field.metadata, error, path)
        elif value is default is None:
            continue
        elif isinstance(default, float | int) or field.metadata:
            check_number(value, path, error=error, **field.metadata)
    if hasattr(settings, "inconsistency") and (message := settings.inconsistency()):
        raise error(message)


def _check_list(
    values: Any, default: list[Any], limits: Any, error: type[FmpError], name: str
) -> None:
    """Check a list of numbers or of dataclasses."""
    fits = isinstance(values, Sequence) and not isinstance(values, str)
    if not fits or (default and len(values) != len(default)):
        expected = f"{len(default)} numbers" if default else "a list"
        raise error(f"{name} is {values}; expected {expected}.")
    for i, value in enumerate(values):
        if dataclasses.is_dataclass(value):
            check_settings(value, error, f"{name}[{i}].")
        elif not isinstance(value, list) or default:  # Else lists of names.
            check_number(value, f"{name}[{i}]", error=error, **limits)


def check_yaml(text: str | bytes, name: str, error: type[FmpError]) -> None:
    """Check that YAML can be loaded in bounded time and memory.

    Parameters
    ----------
    text : str or bytes
    name : str
        Of the text, for errors.
    error : type
        Type of the error.

    Raises
    ------
    FmpError
        Of the given type. The text is not YAML, is too long, too deep or, with its
        aliases expanded, too large, or contains an integer beyond the range of floats,
        or a key twice.
    """
    if len(text) > _MOST_BYTES:
        raise error(
            f"{name} is {len(text)} bytes long; at most {_MOST_BYTES} are read."
        )
    sizes: dict[str, int] = {}  # Nodes of each anchor; 0 until its end.
    # Enclosing anchors, each with the number of nodes before it.
    open_anchors: list[tuple[str, int]] = []
    count = 0
    try:
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            anchor = str(getattr(event, "anchor", None) or "")
            if isinstance(event, yaml.AliasEvent):
                count += sizes.get(anchor, 1)
                if sizes.get(anchor) == 0:
                    raise error(f"{name} contains itself, by its alias *{anchor}.")
            elif isinstance(event, yaml.ScalarEvent):
                count += 1
                sizes |= {anchor: 1} if anchor else {}
                if _LONG_INTEGER.fullmatch(event.value):
                    raise error(
                        f"{name} contains {event.value[:20]}..., an integer of "
                        f"{len(event.value)} digits, which no setting can be."
                    )
            elif isinstance(event, yaml.CollectionStartEvent):
                open_anchors.append((anchor, count))
                count += 1
                sizes |= {anchor: 0} if anchor else {}
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, before = open_anchors.pop()
                sizes |= {anchor: count - before} if anchor else {}
            if len(open_anchors) > _MOST_LEVELS:
                raise error(
                    f"{name} is nested deeper than {_MOST_LEVELS} levels, which is "
                    "more than any setting has."
                )
            if count > _MOST_NODES:
                raise error(
                    f"{name} has more than {_MOST_NODES} values with its aliases "
                    "expanded; no larger text is read."
                )
        if key := _repeated_key(yaml.compose(text, Loader=yaml.CSafeLoader)):
            raise error(
                f"{name} has the key {shown(key)} twice in one place; keep one."
            )
    except (yaml.YAMLError, UnicodeError) as reason:
        raise error(
            f"{name} cannot be read as YAML: {' '.join(str(reason).split())}."
        ) from None


def _repeated_key(node: yaml.Node | None) -> str:
    """Return a key that a mapping in a YAML node has twice, or ""."""
    if not isinstance(node, yaml.CollectionNode):
        return ""
    items = node.value
    if isinstance(node, yaml.MappingNode):
        counts = Counter(str(key.value) for key, _ in node.value)
        if repeated := [key for key, count in counts.items() if count > 1]:
            return repeated[0]
        items = [value for _, value in node.value]
    return next(filter(None, map(_repeated_key, items)), "")
