"""Dataclasses of settings: each number says its range where its default is."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from fmp_drake.errors import FmpError
from fmp_drake.numeric import check_number


def bounded(default: float | Sequence[float] | None, **limits: float) -> Any:
    """Declare a number of a dataclass, or a list of numbers, with its range.

    Parameters
    ----------
    default : float, sequence of floats or None
        Each instance gets a list of its own. With None the number may be None.
    **limits : float
        Its limits `above`, `least`, `below`, `most`, as for `check_number`.

    Returns
    -------
    dataclasses.Field
    """
    if isinstance(default, Sequence):
        return dataclasses.field(default_factory=lambda: list(default), metadata=limits)
    return dataclasses.field(default=default, metadata=limits)


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
            if len(value) != len(default):
                raise error(f"{place} is {value}; expected {len(default)} numbers.")
            for i, each in enumerate(value):
                check_number(each, f"{place}[{i}]", error=error, **field.metadata)
        elif value is default is None:
            continue
        elif isinstance(default, float | int) or field.metadata:
            check_number(value, place, error=error, **field.metadata)
