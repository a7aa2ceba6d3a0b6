"""Joining overlapping windows to the recordings that they were cut from."""

import numpy as np
from numpy.typing import NDArray


def joined_recordings(windows: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Join windows (N, T, D) that overlap exactly: arrays (n, D), in order.

    The models that need the whole signal (its period, its phase) get it from the same
    windows as the others. A window that does not continue the one before, sample
    for sample, starts a recording of its own.
    """
    out: list[list[NDArray[np.float64]]] = []
    guess = 0
    for i, window in enumerate(windows):
        shift = _shift(windows[i - 1], window, guess) if i else 0
        if shift:
            out[-1].append(window[-shift:])
            guess = shift
        else:
            out.append([window])
    return [np.concatenate(parts) for parts in out]


def _shift(before: NDArray[np.float64], after: NDArray[np.float64], guess: int) -> int:
    """Return by how many samples a window is later than another, 0 for unknown."""
    last = len(before) - 2  # At least two samples must agree.
    found = np.flatnonzero(np.all(before == after[0], axis=1))
    for s in sorted(
        (int(s) for s in found if 1 <= s <= last), key=lambda s: s != guess
    ):
        if np.array_equal(before[s:], after[:-s]):
            return s
    return 0
