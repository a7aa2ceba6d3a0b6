"""Inference of channels by recorded windows that are similar."""

from collections.abc import Sequence

import numpy as np
from scipy.special import softmax

from fmp_drake.numeric import Array, Mask

# Width of the kernel over similar windows relative to the variance of the recordings, and
# greatest number of windows that count.
_KERNEL_WIDTH, _MOST_WINDOWS = 0.002, 60
# Windows that are inferred from others, to estimate the errors.
_TRIALS = 300
# They are inferred from windows of other parts of this number.
_PARTS = 4


class SimilarWindows:
    """Inference of channels by recorded windows whose observed channels are similar.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
        At least `span` samples each.
    observed, inferred : sequence of int
        C and I channels.
    span : int
        Samples in a window.

    Attributes
    ----------
    error_variances : ndarray, shape (I,)
        Mean squared errors of windows that are inferred from other parts of the
        recordings.

    Examples
    --------
    >>> t = np.arange(200) * np.pi / 10
    >>> circles = np.stack([np.cos(t), np.sin(t)], axis=1)
    >>> similar = SimilarWindows([circles], [0], [1], span=10)
    >>> inferred, spread = similar.predict(circles[5:15, :1])
    >>> bool(np.allclose(inferred, circles[5:15, 1:], atol=0.1))
    True
    >>> bool(similar.error_variances < 0.01)
    True
    """

    def __init__(
        self,
        recordings: Sequence[Array],
        observed: Sequence[int],
        inferred: Sequence[int],
        span: int,
    ) -> None:
        view = np.lib.stride_tricks.sliding_window_view
        windows = np.concatenate([view(y, span, axis=0) for y in recordings])
        windows = windows.swapaxes(1, 2)
        self._observed, self._inferred = windows[..., observed], windows[..., inferred]
        variance = float(self._observed.var(axis=(0, 1)).sum())
        self._width = _KERNEL_WIDTH * max(variance, 1e-300) * span
        counts = [len(y) - span + 1 for y in recordings]
        recording = np.repeat(np.arange(len(counts)), counts)
        place = np.concatenate([np.arange(count) for count in counts])
        distance = max(span, sum(counts) // _PARTS)
        squares = []
        for i in np.unique(np.linspace(0, len(windows) - 1, _TRIALS).astype(int)):
            is_other = (recording != recording[i]) | (abs(place - place[i]) >= distance)
            mean = self._inferred.mean(axis=(0, 1))
            if is_other.any():
                mean = self._predict(self._observed[i], is_other)[0]
            squares.append(np.mean((self._inferred[i] - mean) ** 2, axis=0))
        # Few parts underestimate the errors: to first order by two over their number.
        self.error_variances = np.mean(squares, axis=0) * (1 + 2 / _PARTS)

    def predict(self, values: Array) -> tuple[Array, Array]:
        """Return mean (span, I) and covariances (span, I, I) given values (span, C)."""
        mean, covariances = self._predict(values, np.ones(len(self._observed), bool))
        return mean, covariances + np.diag(self.error_variances)

    def _predict(self, values: Array, is_used: Mask) -> tuple[Array, Array]:
        """Return mean and spread of the used windows that are similar."""
        distance = np.sum((self._observed[is_used] - values) ** 2, axis=(1, 2))
        nearest = np.argsort(distance, kind="stable")[:_MOST_WINDOWS]
        weights = softmax(-distance[nearest] / (distance[nearest[0]] + self._width))
        windows = self._inferred[is_used][nearest]
        mean = np.tensordot(weights, windows, axes=1)
        deviations = windows - mean
        return mean, np.einsum("n,nha,nhb->hab", weights, deviations, deviations)
