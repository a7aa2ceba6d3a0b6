"""Sliding windows over demonstrations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import as_floats, check_number, finite_array
from fmp_drake.primitives.data.demonstration import Demonstration
from fmp_drake.primitives.data.joining import joined_recordings

_WHAT = "the windows (or give a Demonstration, or a list of them)"


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """The windows that a skill is learned from, and where each comes from.

    Attributes
    ----------
    values : ndarray, shape (N, T, D)
    source : ndarray, shape (N,)
        The index of the demonstration that each window comes from, or its own index
        where the windows were given as an array.
    example : Demonstration or None
        The first demonstration, which names channels, units and frame; None where the
        windows were given as an array.
    resampled : list of ndarray, shape (n, D), or None
        The demonstrations that were cut, at one rate; None where the windows were given
        as an array.
    """

    values: NDArray[np.float64]
    source: NDArray[np.int64]
    example: Demonstration | None
    resampled: list[NDArray[np.float64]] | None = None

    def recordings(self) -> list[NDArray[np.float64]]:
        """Return what the windows were cut from, arrays (n, D).

        Windows that were given as an array are joined where they overlap exactly.
        """
        if self.resampled is None:
            return joined_recordings(self.values)
        chosen = set(self.source.tolist())
        return [y for i, y in enumerate(self.resampled) if i in chosen]

    def paths(self, stride: int) -> tuple[NDArray[np.float64], ...]:
        """Return the demonstrated paths, each (samples, D), without repetitions.

        None where the windows were given as an array: nobody knows how they overlap.
        """
        if self.example is None:
            return ()
        apart = (np.diff(self.source) != 0) | (stride > self.values.shape[1])
        return tuple(
            np.concatenate([each[:-1, :stride].reshape(-1, each.shape[2]), each[-1]])
            for each in np.split(self.values, np.flatnonzero(apart) + 1)
        )


def extent_of(values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the least and the greatest value of recordings (n, D), shape (2, D)."""
    return np.stack(
        [
            np.min([y.min(axis=0) for y in values], axis=0),
            np.max([y.max(axis=0) for y in values], axis=0),
        ]
    )


def sliding_windows(
    values: NDArray[np.float64], *, n_steps: int, stride: int
) -> NDArray[np.float64]:
    """Cut samples (N, D) into windows `stride` samples apart: (n, T, D).

    Section V-A of the paper, with T = 120 and a stride of 10. A recording shorter
    than one window gives none.
    """
    for name, value in (("n_steps", n_steps), ("stride", stride)):
        check_number(value, name, least=1, whole=True, error=DemonstrationError)
    if len(values) < n_steps:
        return np.empty((0, n_steps, values.shape[1]))
    view = np.lib.stride_tricks.sliding_window_view(values, n_steps, axis=0)
    return np.ascontiguousarray(np.swapaxes(view[::stride], 1, 2))


def _check_alike(demonstrations: Sequence[Demonstration]) -> None:
    """Raise where demonstrations differ in channels, units or rotation reference."""
    first = demonstrations[0]
    for number, demonstration in enumerate(demonstrations):
        for what in ("channels", "units", "rotation_reference"):
            theirs, ours = getattr(demonstration, what), getattr(first, what)
            if theirs != ours:
                given, first_given = (
                    ", ".join(map(str, value or ["none"])) for value in (theirs, ours)
                )
                raise DemonstrationError(
                    f"demonstration {number} has the {what.replace('_', ' ')} {given}; "
                    f"the first has {first_given}. They must be the same."
                )


def _recordings(X: Any, *, n_steps: int, rate: float) -> Sequence[Demonstration] | None:
    """Return X as demonstrations, None where it is windows."""
    if isinstance(X, Demonstration):
        return [X]
    if isinstance(X, Sequence) and not isinstance(X, str):
        if all(isinstance(each, Demonstration) for each in X):
            return X
        arrays = [x for x in X if isinstance(x, np.ndarray) and x.ndim in (1, 2)]
        are_windows = all(x.ndim == 2 and len(x) == n_steps for x in arrays)
        if len(arrays) == len(X) and not are_windows:
            return [_sampled(x, rate) for x in arrays]
    array = as_floats(X, _WHAT, error=DemonstrationError)
    return [_sampled(array, rate)] if array.ndim in (1, 2) else None


def _sampled(values: NDArray[np.float64], rate: float) -> Demonstration:
    return Demonstration(time=np.arange(len(values)) / rate, values=values)


def as_windows(
    X: Any, *, n_steps: int, stride: int, rate: float, at_least: int = 2
) -> Windows:
    """Return the windows of one or several recordings, or those in an array (N, T, D).

    A recording is a demonstration, or an array (N, D) or (N,) sampled at the rate. Each
    is resampled to the rate; no window crosses from one to the next.

    Raises
    ------
    DemonstrationError
        Where they have different channels, or give fewer than `at_least` windows.
    """
    recordings = _recordings(X, n_steps=n_steps, rate=rate)
    if recordings is not None:
        X = recordings
        if not X:
            raise DemonstrationError("there is no demonstration; give at least one.")
        _check_alike(X)
        resampled = [d.resample(rate).values for d in X]
        each = [sliding_windows(y, n_steps=n_steps, stride=stride) for y in resampled]
        counts = [len(windows) for windows in each]
        if sum(counts) < at_least:
            longest = max(d.duration for d in X)
            needed = (n_steps - 1 + stride * (at_least - 1)) / rate
            raise DemonstrationError(
                f"the demonstrations give {sum(counts)} windows of {n_steps / rate:g} s "
                f"(the longest lasts {longest:.3g} s); at least {at_least} are needed. "
                f"Record at least {needed:.3g} s, or choose shorter windows (n_steps; --window)."
            )
        return Windows(
            values=each[0] if len(each) == 1 else np.concatenate(each),
            source=np.repeat(np.arange(len(each)), counts),
            example=X[0],
            resampled=resampled,
        )
    shape = ("windows", n_steps, "channels")
    values = finite_array(X, _WHAT, shape, error=DemonstrationError)
    if len(values) < at_least:
        raise DemonstrationError(
            f"there are {len(values)} windows; at least {at_least} are needed."
        )
    return Windows(values=values, source=np.arange(len(values)), example=None)


def weighted_windows(
    windows: Windows, weights: ArrayLike | None
) -> tuple[Windows, NDArray[np.float64] | None]:
    """Return the windows that count, and the weight of each in the fit, on average 1.

    Parameters
    ----------
    windows : Windows
    weights : array_like, optional
        One for each demonstration, or for each window of an array; none negative.
    """
    if weights is None:
        return windows, None
    count = int(windows.source[-1]) + 1
    given = finite_array(weights, "the weights", (count,), error=DemonstrationError)
    if np.any(given < 0):
        raise DemonstrationError(f"the weights are {given}; none may be negative.")
    each = given[windows.source]
    if np.count_nonzero(each) < 2:
        raise DemonstrationError(
            f"the weights leave {np.count_nonzero(each)} windows; at least 2 must count."
        )
    if not np.all(each):
        values, source = windows.values[each > 0], windows.source[each > 0]
        windows = replace(windows, values=values, source=source)
    return windows, each[each > 0] / each[each > 0].mean()
