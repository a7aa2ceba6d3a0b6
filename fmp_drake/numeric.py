"""Types of arrays, checks of the user's values, and threads."""

import math
import operator
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from os import PathLike
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import ThreadpoolController

from fmp_drake.errors import FmpError, SkillError

type Array = NDArray[np.float64]
type Mask = NDArray[np.bool_]
type Indices = NDArray[np.int64]

# Products of several greater numbers overflow.
GREATEST = 1e100


def as_floats(
    value: Any,
    what: str,
    shape: tuple[int | str, ...] | None = None,
    *,
    error: type[FmpError] = SkillError,
) -> Array:
    """Return an array of real numbers, which may be NaN or infinite.

    Parameters
    ----------
    value : array_like
    what : str
        Name of the value, for the error.
    shape : tuple of int and str, optional
        Length of each axis. A name stands for any length but 0, a leading "..." for
        any number of axes. Where one axis is expected, a number is an array of length 1.
        None is any shape.
    error : type
        Raised where the shape differs, or a value is not a real number.
    """
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise error(f"{what}: some values are masked; leave them out.")
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biufO":
            raise TypeError
        array = array.astype(float, copy=False)
        if shape is not None and len(shape) == 1 and array.ndim == 0:
            array = array[None]
    except (TypeError, ValueError, OverflowError):
        raise error(f"{what}: {shown(value)} cannot be read as real numbers.") from None
    if shape is not None and array.shape != shape:
        lengths = [length for length in shape if length != "..."]
        any_more = len(lengths) < len(shape) and array.ndim > len(lengths)
        fits = any_more or array.ndim == len(lengths)
        trailing = array.shape[array.ndim - len(lengths) :]
        if not fits or not all(
            length > 0 if isinstance(expected, str) else length == expected
            for length, expected in zip(trailing, lengths, strict=True)
        ):
            form = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
            raise error(f"cannot use {what} of shape {array.shape}; expected ({form}).")
    return array


def finite_array(
    value: Any,
    what: str,
    shape: tuple[int | str, ...] | None = None,
    *,
    error: type[FmpError] = SkillError,
) -> Array:
    """Return an array of finite real numbers of an expected shape.

    Parameters
    ----------
    value, what, shape, error
        As for `as_floats`. NaN, infinity and numbers above `GREATEST` are errors, too.
    """
    array = as_floats(value, what, shape, error=error)
    if not all_finite(array):
        raise error(f"there are NaN or infinite numbers in {what}.")
    return array


def check_number(
    value: Any,
    what: str,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    whole: bool = False,
    unit: str = "",
    hint: str = "",
    error: type[FmpError] = SkillError,
) -> None:
    """Raise an error with the value and the allowed range, for a number outside it.

    Parameters
    ----------
    value : object
        Expected to be one real, finite number.
    what : str
        Name of the value, for the error.
    above, least, below, most : float, optional
        Exclusive and inclusive lower limit, exclusive and inclusive upper limit.
    whole : bool
        Whether only integers are allowed.
    unit : str
        Of the value, for the error.
    hint : str
        Advice, for the error.
    error : type
        Type of the error.
    """
    limits = (
        (above, "greater than", operator.gt),
        (least, "at least", operator.ge),
        (below, "less than", operator.lt),
        (most, "at most", operator.le),
    )
    bounds = [(limit, text, fits) for limit, text, fits in limits if limit is not None]
    is_kind = is_whole(value) if whole else is_number(value)
    if not is_kind or not all(fits(value, limit) for limit, _, fits in bounds):
        unit = f" {unit}" if unit else ""
        texts = [
            "positive"
            if (limit, text) == (0, "greater than")
            else f"{text} {limit}{unit}"
            for limit, text, _ in bounds
        ]
        kind = ["a whole number"] if whole else [] if bounds else ["a finite number"]
        allowed = ", ".join([*kind, " and ".join(texts)] if texts else kind)
        is_long = isinstance(value, str) or (is_whole(value) and abs(value) > GREATEST)
        text = shown(value) if is_long else value
        hint = f" ({hint})" if hint else ""
        raise error(f"{what} is {text}{unit}; it must be {allowed}{hint}.")


def check_type(value: Any, what: str, kind: Any, *, error: type[FmpError]) -> None:
    """Raise an error with the value and the expected type, where it is of another one.

    Parameters
    ----------
    value : object
    what : str
        Name of the value, for the error.
    kind : type or union of types
    error : type
        Type of the error.
    """
    if not isinstance(value, kind):
        kinds = getattr(kind, "__args__", (kind,))
        names = ["None" if k is NoneType else k.__name__ for k in kinds]
        text = " ".join(shown(value).split())
        raise error(f"{what} is {text}; its type must be {' or '.join(names)}.")


def as_path(value: Any, what: str = "the path", *, error: type[FmpError]) -> Path:
    """Return a path of a file; raise an error for what cannot be one."""
    check_type(value, what, str | PathLike, error=error)
    return Path(value)


def as_paths(value: Any, what: str, *, error: type[FmpError]) -> list[Path]:
    """Return one path, or several, as a list; raise an error for anything else."""
    if isinstance(value, str | PathLike):
        return [Path(value)]
    check_type(value, what, str | PathLike | Iterable, error=error)
    return [as_path(path, f"{what}[{i}]", error=error) for i, path in enumerate(value)]


def as_flag(value: Any, what: str, *, error: type[FmpError] = SkillError) -> bool:
    """Return a value that is True or False, also of NumPy; raise an error for others."""
    if not np.isscalar(value) or value not in (True, False):
        raise error(f"{what} is {shown(value)}; it must be True or False.")
    return bool(value)


def shown(value: Any) -> str:
    """Return a value as text for an error message, at most 60 characters."""
    if is_whole(value) and abs(value) > GREATEST:
        # Python refuses to write integers of more than 4300 digits.
        return f"an integer of more than {len(str(int(GREATEST))) - 1} digits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def rms(values: ArrayLike) -> float:
    """Return the root mean square of all values."""
    return math.sqrt(np.mean(np.square(values)))


def all_finite(array: Array) -> bool:
    """Return whether no number is NaN, infinite or above `GREATEST`."""
    # Comparisons with NaN are false. No copies: windows may fill a gigabyte.
    return array.size == 0 or bool(array.max() < GREATEST and array.min() > -GREATEST)


def read_only[T: np.generic](array: NDArray[T]) -> NDArray[T]:
    """Make an array read-only, and return it."""
    array.setflags(write=False)
    return array


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return start and end of the runs of true values in a mask (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def is_number(value: Any) -> bool:
    """Return whether a value is one real, finite number."""
    # The comparison is false for NaN, and exact for integers of any size.
    if isinstance(value, np.floating):
        value = float(value)  # A small type cannot hold the limits.
    is_real = isinstance(value, int | float | np.integer)
    return is_real and bool(-GREATEST < value < GREATEST)


def is_whole(value: Any) -> bool:
    """Return whether a value is an integer."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in a block or, as a decorator, in a function.

    Products of a few hundred numbers take ten times as long with two threads as with one,
    and a hundred times as long on a busy machine.
    """
    with _libraries().limit(limits=1, user_api="blas"):
        yield


def in_threads[T, R](function: Callable[[T], R], values: Iterable[T]) -> list[R]:
    """Apply a function to values in parallel threads, which pays where NumPy takes the time.

    At most eight threads, because each needs memory for its own arrays.
    """
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 8)) as executor:
        return list(executor.map(function, values))
