"""Sliding windows over demonstrations."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives.demonstration import Demonstration


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
    if not demonstrations:
        raise DemonstrationError("there is no demonstration; give at least one.")
    channels = demonstrations[0].channels
    for number, demonstration in enumerate(demonstrations):
        if demonstration.channels != channels:
            raise DemonstrationError(
                f"demonstration {number} has the channels "
                f"{', '.join(demonstration.channels)}, the first has "
                f"{', '.join(channels)}; they must be the same."
            )
    windows = np.concatenate(
        [
            sliding_windows(d.resample(rate).values, n_steps=n_steps, stride=stride)
            for d in demonstrations
        ]
    )
    if len(windows) < at_least:
        longest = max(d.duration for d in demonstrations)
        needed = (n_steps - 1 + stride * (at_least - 1)) / rate
        raise DemonstrationError(
            f"the demonstrations give {len(windows)} windows of {n_steps / rate:g} s "
            f"(the longest lasts {longest:.3g} s); at least {at_least} are needed. "
            f"Record at least {needed:.3g} s, or choose shorter windows "
            "(n_steps)."
        )
    return windows
