"""Numbers from outside: arrays of them, or an error that says what is wrong."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import FmpError, SkillError

# Squares and products of greater numbers overflow.
GREATEST = 1e100


def as_floats(
    value: Any, what: str, *, error: type[FmpError] = SkillError
) -> NDArray[np.float64]:
    """Return an array of real numbers, which may be NaN or infinite.

    Parameters
    ----------
    value : array_like
    what : str
        The name of the value, for the error.
    error : type
        Of the error where `value` holds anything but real numbers.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biufO":
            raise TypeError
        return array.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError):
        shown = repr(value)
        shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
        raise error(f"{what}: {shown} cannot be read as real numbers.") from None


def all_finite(array: NDArray[np.float64]) -> bool:
    """Tell whether no number is NaN, infinite or so great that its square may be."""
    # Comparisons with NaN are false. No copies: windows may fill a gigabyte.
    return array.size == 0 or bool(array.max() < GREATEST and array.min() > -GREATEST)


def is_number(value: Any) -> bool:
    """Tell whether a value is one real, finite number."""
    return isinstance(value, int | float | np.integer | np.floating) and all_finite(
        as_floats(value, "a number")
    )


def is_whole(value: Any) -> bool:
    """Tell whether a value is an integer."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
