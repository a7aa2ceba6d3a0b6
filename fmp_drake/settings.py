"""Dataclasses of settings: each number says its range where its default is."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

from fmp_drake.errors import FmpError

_FITS = {
    "above": lambda value, bound: value > bound,
    "at least": lambda value, bound: value >= bound,
    "at most": lambda value, bound: value <= bound,
}


def bounded(
    default: float | Sequence[float] | None,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> Any:
    """Declare a number of a dataclass, or a list of numbers, with its range.

    Parameters
    ----------
    default : float, sequence of floats or None
        Each instance gets a list of its own. With None the number may be None.
    above, at_least, at_most : float, optional
        The range, as `check_settings` checks it.

    Returns
    -------
    dataclasses.Field
    """
    bounds = {"above": above, "at least": at_least, "at most": at_most}
    metadata = {word: bound for word, bound in bounds.items() if bound is not None}
    if isinstance(default, Sequence):
        return dataclasses.field(
            default_factory=lambda: list(default), metadata=metadata
        )
    return dataclasses.field(default=default, metadata=metadata)


def check_settings(settings: Any, error: type[FmpError], name: str = "") -> None:
    """Check every number of a dataclass, and of the dataclasses in it.

    Numbers must be finite and in the range that `bounded` declared; lists that have
    a default must be as long as that.

    Parameters
    ----------
    settings : dataclass
    error : type
        What to raise.
    name : str
        What the names in messages begin with.

    Raises
    ------
    FmpError
        Of the given type, naming the value and what is allowed.
    """
    for field in dataclasses.fields(settings):
        value, place = getattr(settings, field.name), f"{name}{field.name}"
        default = field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        if dataclasses.is_dataclass(value):
            check_settings(value, error, f"{place}.")
        elif default == []:
            for i, each in enumerate(value):
                check_settings(each, error, f"{place}[{i}].")
        elif isinstance(default, list):
            if len(value) != len(default) or not all(map(_is_finite, value)):
                raise error(
                    f"{place} is {value}; expected {len(default)} finite numbers."
                )
            for each in value:
                _check_range(each, field.metadata, f"{place} is {value}", error)
        elif isinstance(default, float | int) or field.metadata:
            if value is default is None:
                continue
            if not _is_finite(value):
                raise error(f"{place} is {value!r}; expected a finite number.")
            _check_range(value, field.metadata, f"{place} is {value}", error)


def _is_finite(value: Any) -> bool:
    return isinstance(value, Real) and math.isfinite(value)


def _check_range(
    value: float, bounds: Mapping[str, float], given: str, error: type[FmpError]
) -> None:
    if not all(_FITS[word](value, bound) for word, bound in bounds.items()):
        allowed = " and ".join(f"{word} {bound:g}" for word, bound in bounds.items())
        raise error(f"{given}; it must be {allowed}.")
