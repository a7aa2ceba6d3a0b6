"""Replay of the demonstrations: the simplest baseline."""

import numpy as np
from numpy.typing import NDArray

from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.primitives.data.windows import joined_recordings


class Replay(TrajectoryModel):
    """Nearest neighbours in the demonstrations, without a model.

    Samples are demonstrated windows. The prediction is the median continuation of the
    parts most similar to the observed samples, offset so that it begins at the present
    value. The offset decays.

    Parameters
    ----------
    neighbours : int
        Number of similar parts.
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
        index = np.random.default_rng(seed).integers(len(self._windows), size=n)
        return self._windows[index]

    def _continue(
        self, prefix: NDArray[np.float64], horizon: int
    ) -> NDArray[np.float64]:
        size = len(prefix) + horizon
        parts = [y for y in self.recordings_ if len(y) >= size]
        view = np.lib.stride_tricks.sliding_window_view
        places = np.concatenate(
            [np.swapaxes(view(y, size, axis=0), 1, 2) for y in parts]
        )
        return continuation(
            places, prefix, neighbours=self.neighbours, anchor_time=self.anchor_time
        )


def continuation(
    windows: NDArray[np.float64],
    past: NDArray[np.float64],
    *,
    neighbours: int = 5,
    anchor_time: float,
) -> NDArray[np.float64]:
    """Return the median end (H, D) of the windows that begin most like a past.

    Parameters
    ----------
    windows : ndarray, shape (N, K + H, D)
    past : ndarray, shape (K, D)
    neighbours, anchor_time
        As of `Replay`.
    """
    known = len(past)
    distances = np.sum((windows[:, :known] - past) ** 2, axis=(1, 2))
    best = windows[np.argsort(distances, kind="stable")[:neighbours]]
    offsets = past[-1] - best[:, known - 1]
    left = np.exp(-np.arange(1, windows.shape[1] - known + 1) / anchor_time)
    out: NDArray[np.float64] = np.median(
        best[:, known:] + left[:, None] * offsets[:, None], axis=0
    )
    return out
