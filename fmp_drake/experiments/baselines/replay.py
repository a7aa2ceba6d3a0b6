"""Replaying what was demonstrated: the simplest rival."""

import numpy as np
from numpy.typing import NDArray

from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.primitives.data.joining import joined_recordings


class Replay(TrajectoryModel):
    """No model at all: samples are demonstrated windows, predictions are memories.

    The places of the demonstrations that were most like what has been seen are looked
    up; the median of what followed there is the prediction, moved so that it begins at
    the present value. The move decays.

    Parameters
    ----------
    neighbours : int
        Places that are looked up.
    anchor_time : float
        Time constant of the decay, in samples.

    Attributes
    ----------
    recordings_ : list of ndarray, shape (n, D)

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import sliding_windows
    >>> path = np.sin(np.arange(200) * np.pi / 10)[:, None]
    >>> model = Replay().fit(sliding_windows(path, n_steps=40, stride=3))
    >>> bool(np.allclose(model.predict(path[:10], horizon=20), path[10:30]))
    True
    """

    def __init__(self, *, neighbours: int = 5, anchor_time: float = 10.0) -> None:
        self.neighbours = neighbours
        self.anchor_time = anchor_time

    def _learn(self, windows: NDArray[np.float64]) -> None:
        self._check_parameters(neighbours=1, anchor_time=0)
        self.recordings_ = joined_recordings(windows)
        self._windows = windows

    def _draw(self, n: int, seed: int) -> NDArray[np.float64]:
        chosen = np.random.default_rng(seed).integers(len(self._windows), size=n)
        return self._windows[chosen]

    def _continue(
        self, prefix: NDArray[np.float64], horizon: int
    ) -> NDArray[np.float64]:
        size = len(prefix) + horizon
        parts = [y for y in self.recordings_ if len(y) >= size]
        view = np.lib.stride_tricks.sliding_window_view
        places = np.concatenate(
            [np.swapaxes(view(y, size, axis=0), 1, 2) for y in parts]
        )
        apart = np.sum((places[:, : len(prefix)] - prefix) ** 2, axis=(1, 2))
        best = np.argsort(apart, kind="stable")[: self.neighbours]
        offsets = prefix[-1] - places[best, len(prefix) - 1]
        left = np.exp(-np.arange(1, horizon + 1) / self.anchor_time)
        futures = places[best, len(prefix) :] + left[:, None] * offsets[:, None]
        return np.median(futures, axis=0)
