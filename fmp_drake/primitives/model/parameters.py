"""The ranges of a skill's parameters."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fmp_drake.errors import SkillError
from fmp_drake.primitives.data.numeric import GREATEST, is_number, is_whole


def check_parameters(values: Mapping[str, Any]) -> None:
    """Raise SkillError where a parameter of `FourierMovementPrimitive` is out of range.

    `scales` is checked where it is used, against the channels.
    """
    half = values["n_steps"] // 2 if is_whole(values["n_steps"]) else 0

    def whole(least: float, most: float = np.inf) -> Callable[[Any], bool]:
        return lambda value: is_whole(value) and least <= value <= most

    def real(least: float, most: float = np.inf) -> Callable[[Any], bool]:
        return lambda value: is_number(value) and least <= value <= most

    def one_of(*names: str) -> Callable[[Any], bool]:
        return lambda value: isinstance(value, str) and value in names

    tiny = 1 / GREATEST
    for name, allowed, fine in (
        ("n_steps", "a whole number, at least 8", whole(8)),
        (
            "stride",
            "a whole number, at least 1, or None",
            lambda value: value is None or whole(1)(value),
        ),
        ("rate", "positive, from 1e-6 to 1e6 Hz", real(1e-6, 1e6)),
        (
            "n_components",
            "a whole number, at least 1, or 'bic'",
            lambda value: whole(1)(value) or one_of("bic")(value),
        ),
        ("overlap", f"from 2 to n_steps / 2 = {half}", whole(2, half)),
        ("explained_variance", "in (0, 1]", real(tiny, 1)),
        ("regularization", "positive", real(tiny)),
        ("shrinkage", "0 or more", real(0)),
        ("tolerance", "positive", real(tiny)),
        ("selection", "'cost' or 'evidence'", one_of("cost", "evidence")),
        ("random_state", "a whole number from 0 to 2^32 - 1", whole(0, 2**32 - 1)),
    ):
        if not fine(values[name]):
            raise SkillError(f"{name} is {values[name]!r}; it must be {allowed}.")
