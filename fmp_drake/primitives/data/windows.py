"""Sliding windows over demonstrations."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import DemonstrationError, SkillError
from fmp_drake.primitives.data.demonstration import Demonstration
from fmp_drake.primitives.data.numeric import all_finite, as_floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """What a skill is learned from.

    Attributes
    ----------
    values : ndarray, shape (N, T, D)
    source : ndarray, shape (N,)
        The index of the demonstration, or of the window itself, each comes from.
    example : Demonstration or None
        One that names the channels; None for bare windows.
    """

    values: NDArray[np.float64]
    source: NDArray[np.int64]
    example: Demonstration | None


def sliding_windows(
    values: NDArray[np.float64], *, n_steps: int, stride: int
) -> NDArray[np.float64]:
    """Cut samples (N, D) into windows `stride` samples apart: (n, T, D).

    Section V-A of the paper, with T = 120 and a stride of 10. A recording shorter
    than one window gives none.
    """
    if n_steps < 1 or stride < 1:
        raise DemonstrationError(
            f"n_steps is {n_steps} and stride {stride}; both must be at least 1."
        )
    if len(values) < n_steps:
        return np.empty((0, n_steps, values.shape[1]))
    view = np.lib.stride_tricks.sliding_window_view(values, n_steps, axis=0)
    return np.ascontiguousarray(np.swapaxes(view[::stride], 1, 2))


def demonstration_windows(
    demonstrations: Sequence[Demonstration],
    *,
    n_steps: int,
    stride: int,
    rate: float,
    at_least: int = 2,
) -> NDArray[np.float64]:
    """Resample every demonstration, window each on its own, and stack: (N, T, D).

    Raises
    ------
    DemonstrationError
        Where the demonstrations have different channels, or give fewer than
        `at_least` windows.
    """
    each = _windows_of_each(
        demonstrations, n_steps=n_steps, stride=stride, rate=rate, at_least=at_least
    )
    return np.concatenate(each)


def _windows_of_each(
    demonstrations: Sequence[Demonstration],
    *,
    n_steps: int,
    stride: int,
    rate: float,
    at_least: int,
) -> list[NDArray[np.float64]]:
    if not demonstrations:
        raise DemonstrationError("there is no demonstration; give at least one.")
    first = demonstrations[0]
    for number, demonstration in enumerate(demonstrations):
        for what in ("channels", "units"):
            theirs, ours = getattr(demonstration, what), getattr(first, what)
            if theirs != ours:
                raise DemonstrationError(
                    f"demonstration {number} has the {what} {', '.join(theirs)}, the "
                    f"first has {', '.join(ours)}; they must be the same."
                )
        if demonstration.rotation_reference != first.rotation_reference:
            raise DemonstrationError(
                f"demonstration {number} has the rotation reference "
                f"{demonstration.rotation_reference}, the first has "
                f"{first.rotation_reference}; they must be the same (give one to "
                "`add_orientation`)."
            )
    each = [
        sliding_windows(d.resample(rate).values, n_steps=n_steps, stride=stride)
        for d in demonstrations
    ]
    count = sum(len(windows) for windows in each)
    if count < at_least:
        longest = max(d.duration for d in demonstrations)
        needed = (n_steps - 1 + stride * (at_least - 1)) / rate
        raise DemonstrationError(
            f"the demonstrations give {count} windows of {n_steps / rate:g} s "
            f"(the longest lasts {longest:.3g} s); at least {at_least} are needed. "
            f"Record at least {needed:.3g} s, or choose shorter windows "
            "(n_steps)."
        )
    return each


def as_windows(
    X: Any, *, n_steps: int, stride: int, rate: float, at_least: int
) -> Windows:
    """Return the windows of a demonstration, a list of them, or an array (N, T, D).

    Raises
    ------
    DemonstrationError
        Where there is nothing to learn from in it.
    """
    if isinstance(X, Demonstration):
        X = [X]
    is_list = isinstance(X, Sequence) and not isinstance(X, str)
    if is_list and all(isinstance(d, Demonstration) for d in X):
        each = _windows_of_each(
            X, n_steps=n_steps, stride=stride, rate=rate, at_least=at_least
        )
        return Windows(
            values=each[0] if len(each) == 1 else np.concatenate(each),
            source=np.repeat(np.arange(len(each)), [len(w) for w in each]),
            example=X[0],
        )
    try:
        values = as_floats(X, "the windows")
    except SkillError:
        raise DemonstrationError(
            f"{type(X).__name__} cannot be learned from; give a Demonstration, a "
            "list of them, or windows (windows, n_steps, channels)."
        ) from None
    if values.ndim != 3 or values.shape[1] != n_steps or values.shape[2] == 0:
        raise DemonstrationError(
            f"the windows have shape {values.shape}; expected (windows, "
            f"n_steps = {n_steps}, channels)."
        )
    if len(values) < at_least:
        raise DemonstrationError(
            f"there are {len(values)} windows; at least {at_least} are needed."
        )
    if not all_finite(values):
        raise DemonstrationError("the windows hold NaN or infinite numbers.")
    return Windows(values=values, source=np.arange(len(values)), example=None)


def window_weights(
    windows: Windows, weights: ArrayLike | None
) -> NDArray[np.float64] | None:
    """Return how often each window counts, shape (N,), on average 1.

    Parameters
    ----------
    windows : Windows
    weights : array_like, optional
        One for each demonstration, or for each window of an array; none negative.
    """
    if weights is None:
        return None
    given = as_floats(weights, "the weights", error=DemonstrationError)
    count = int(windows.source[-1]) + 1
    if given.shape != (count,) or not (all_finite(given) and np.all(given >= 0)):
        raise DemonstrationError(
            f"the weights are {given}; expected {count} numbers that are not negative."
        )
    each = given[windows.source]
    if np.count_nonzero(each) < 2:
        raise DemonstrationError(
            f"the weights leave {np.count_nonzero(each)} windows; at least 2 must count."
        )
    return each / each.mean()
