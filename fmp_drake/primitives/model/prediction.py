"""Prediction of later samples and of other channels, by Gaussians and by similar windows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln, softmax

from fmp_drake.numeric import Array, Mask, finite_array
from fmp_drake.primitives.data.windows import sliding_windows, windows_of_all

# Weight of the distance of two pasts relative to the weight of their difference in
# shape.
_DISTANCE_WEIGHT = 0.2
# Width of the kernel over similar pasts or windows relative to the variance of the recordings,
# and greatest number of them that count.
_KERNEL_WIDTH, _MOST_SIMILAR = 0.002, 60
# Time constants, in samples, with which the offsets to the present value and velocity decay.
_DECAY, _VELOCITY_DECAY = 20.0, 4.0
# Number of last velocities that an extrapolation uses.
_VELOCITIES = 5
# Relative ridge of its regression, and its least variance in squared scaled units.
_RIDGE, _LEAST_VARIANCE = 1e-6, 1e-10
# Windows that are inferred from other ones, to estimate the errors, and the number of parts
# of the recordings: a window is inferred from those of other parts.
_TRIALS, _PARTS = 300, 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Predicted samples of a movement.

    Attributes
    ----------
    values : ndarray, shape (H, D)
        Expected samples.
    covariances : ndarray, shape (H, D, D)
        Covariance of each sample under the mixture, so uncertainty about the component
        is included. With a phase model they are calibrated by cross-validation.
    degrees_of_freedom : float, optional
        Degrees of freedom, above 2, of the multivariate t distributions that have these
        covariances. The fewer cycles were demonstrated, the heavier are their tails.
        None for Gaussians.

    Examples
    --------
    >>> import numpy as np
    >>> prediction = Prediction(
    ...     values=np.zeros((1, 2)), covariances=np.eye(2)[None]
    ... )
    >>> prediction.values.shape
    (1, 2)
    >>> prediction.log_density(np.zeros((1, 2))).round(3)
    array([-1.838])
    """

    values: Array
    covariances: Array
    degrees_of_freedom: float | None = None

    def log_density(self, values: ArrayLike) -> Array:
        """Return the log density of each of the true samples (H, D), shape (H,)."""
        y = finite_array(values, "the values", self.values.shape)
        d, error = y.shape[1], y - self.values
        solved = np.linalg.solve(self.covariances, error[..., None])[..., 0]
        squares = np.sum(error * solved, axis=1)
        volumes = np.linalg.slogdet(self.covariances)[1]
        if self.degrees_of_freedom is None:
            return -0.5 * (squares + volumes + d * np.log(2 * np.pi))
        n = self.degrees_of_freedom
        constant = (
            gammaln((n + d) / 2) - gammaln(n / 2) - d / 2 * np.log((n - 2) * np.pi)
        )
        tails = (n + d) / 2 * np.log1p(squares / (n - 2))
        return constant - 0.5 * volumes - tails


class Replayed(NamedTuple):
    """Mean and spread of the samples that followed similar pasts.

    Attributes
    ----------
    values : ndarray, shape (H, D)
        Weighted mean.
    spread : ndarray, shape (H, D, D)
        Weighted covariance.
    distance : float
        Mean squared distance of the present to the most similar past.
    """

    values: Array
    spread: Array
    distance: float


class Replay:
    """Prediction by the continuations of similar pasts (kernel regression).

    Similar pasts have about the same shape and position. Their continuations are moved
    to the present value and velocity by offsets that decay.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    seen : int
        K, samples of a past.
    horizon : int
        Samples to predict.

    Examples
    --------
    >>> import numpy as np
    >>> wave = np.sin(np.arange(200) * np.pi / 10)[:, None]
    >>> again = Replay([wave], seen=10, horizon=20).predict(wave[:10]).values
    >>> bool(np.allclose(again, wave[10:30], atol=0.1))
    True
    """

    def __init__(self, recordings: Sequence[Array], seen: int, horizon: int) -> None:
        self._seen, self._ahead = seen, np.arange(horizon)
        usable = [y for y in recordings if len(y) > seen]
        d = recordings[0].shape[1]
        # The end of a recording is a past, too: of the samples that it has.
        gap = np.full((horizon, d), np.nan)
        self._values = np.concatenate(
            [np.empty((0, d)), *(x for y in usable for x in (y, gap))]
        )
        pasts = [sliding_windows(y[:-1], n_steps=seen, stride=1) for y in usable]
        self._pasts = np.concatenate([np.empty((0, seen, d)), *pasts])
        self._shapes = self._pasts - self._pasts.mean(axis=1, keepdims=True)
        starts = np.cumsum([0, *(len(y) + horizon for y in usable)])[:-1]
        self._next = np.concatenate(
            [np.empty(0, dtype=int)]
            + [a + seen + np.arange(len(p)) for a, p in zip(starts, pasts, strict=True)]
        )
        all_values = np.concatenate(list(recordings))
        self.variance = max(float(all_values.var(axis=0).sum()), 1e-300)
        steps = np.arange(1.0, horizon + 1)[:, None]
        self._decay = np.exp(-steps / _DECAY)
        self._travel = steps * np.exp(-steps / _VELOCITY_DECAY)

    @property
    def is_possible(self) -> bool:
        """Whether a recording is long enough to predict from."""
        return len(self._pasts) > 0

    def predict(self, past: Array) -> Replayed:
        """Predict the samples that follow a past (K, D)."""
        shape = past - past.mean(axis=0)
        distance = _squared(self._shapes - shape)
        distance += _DISTANCE_WEIGHT * _squared(self._pasts - past)
        count = min(_MOST_SIMILAR, len(distance))
        nearest = np.sort(np.argpartition(distance, count - 1)[:count])
        nearest = nearest[np.argsort(distance[nearest], kind="stable")]
        least = float(distance[nearest[0]])
        width = least + _KERNEL_WIDTH * self.variance * self._seen
        weights = np.exp((least - distance[nearest]) / width)
        futures = self._values[self._next[nearest, None] + self._ahead]
        is_known = np.isfinite(futures[..., 0])
        offset = past - self._pasts[nearest]
        # Difference over two samples: over one, the noise of a sensor would count
        # double.
        steps = min(2, self._seen - 1)
        change = (offset[:, -1] - offset[:, -1 - steps]) / max(steps, 1)
        futures = (
            futures + self._decay * offset[:, -1:] + self._travel * change[:, None]
        )
        futures = np.where(is_known[..., None], futures, 0.0)
        weighted = weights[:, None] * is_known
        weighted /= np.maximum(weighted.sum(axis=0), 1e-300)
        values = np.einsum("nh,nhd->hd", weighted, futures)
        # Where all continuations have ended, the last value stays.
        last = np.maximum.accumulate(np.where(is_known.any(axis=0), self._ahead, 0))
        values = values[last]
        deviations = np.swapaxes(futures - values, 0, 1)
        spread = np.swapaxes(deviations, 1, 2) * weighted.T[:, None] @ deviations
        return Replayed(values, spread[last], least / self._seen)


def _squared(values: Array) -> Array:
    """Return the sums of squares of values (n, K, D), shape (n,)."""
    return np.einsum("nkd,nkd->n", values, values)


class Extrapolation:
    """Linear prediction of the change from the last velocities, one for each step ahead.

    It is more accurate for the next few samples than a phase model and similar pasts.
    Each channel has its own coefficients.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    seen : int
        K, samples of a past.
    horizon : int
        Greatest number of samples to predict. Fewer are predicted where the recordings
        are too short.

    Examples
    --------
    >>> import numpy as np
    >>> wave = np.sin(np.arange(200) * np.pi / 10)[:, None]
    >>> values, covariances = Extrapolation([wave], 10, 20).blended(
    ...     wave[:10], np.zeros((20, 1)), np.ones((20, 1, 1))
    ... )
    >>> bool(np.allclose(values, wave[10:30], atol=1e-3))
    True
    """

    def __init__(self, recordings: Sequence[Array], seen: int, horizon: int) -> None:
        self._order = p = min(_VELOCITIES, seen - 1)
        d = recordings[0].shape[1]
        view = np.lib.stride_tricks.sliding_window_view
        coefficients, covariances, leverages = [], [], []
        for step in range(1, horizon + 1):
            usable = [y for y in recordings if len(y) > p + step]
            count = sum(len(y) - p - step for y in usable)
            if count <= 2 * p:
                break
            x = np.concatenate(
                [view(np.diff(y[:-step], axis=0), p, axis=0) for y in usable]
            )
            change = np.concatenate([y[p + step :] - y[p:-step] for y in usable])
            square = np.einsum("ndp,ndq->dpq", x, x)
            ridge = _RIDGE * np.trace(square, axis1=1, axis2=2) / p + 1e-12
            square += ridge[:, None, None] * np.eye(p)
            solved = np.linalg.solve(
                square, np.einsum("ndp,nd->dp", x, change)[..., None]
            )
            coefficients.append(solved[..., 0].T)
            error = change - np.einsum("ndp,pd->nd", x, coefficients[-1])
            # Windows that overlap are not independent: there are count / step. To first
            # order this is the final prediction error (Akaike, 1970) of that number.
            # Unfamiliar pasts have greater errors.
            covariance = error.T @ error / count * (1 + 2 * p * step / count)
            leverages.append(step * np.linalg.inv(square))
            independent = d * step / (count + d * step)
            covariance -= independent * covariance * (1 - np.eye(d))
            covariances.append(covariance + _LEAST_VARIANCE * np.eye(d))
        self._coefficients = np.reshape(coefficients, (-1, p, d))
        self._covariances = np.reshape(covariances, (-1, d, d))
        self._leverages = np.reshape(leverages, (-1, d, p, p))

    def blended(
        self, past: Array, values: Array, covariances: Array
    ) -> tuple[Array, Array]:
        """Update a prediction (H, D), (H, D, D) by the extrapolation of a past (K, D).

        The errors of both may be fully correlated, which the covariances allow for.
        """
        count = min(len(self._covariances), len(values))
        velocities = np.diff(past[-self._order - 1 :], axis=0)
        expected = past[-1] + np.einsum(
            "hpd,pd->hd", self._coefficients[:count], velocities
        )
        # A past that is unlike those of the recordings is extrapolated less well.
        leverage = self._leverages[:count]
        leverage = np.einsum("pd,hdpq,qd->hd", velocities, leverage, velocities)
        growth = np.sqrt(1 + leverage)
        extrapolated = self._covariances[:count] * growth[:, :, None] * growth[:, None]
        prior = covariances[:count]
        gains = np.swapaxes(np.linalg.solve(prior + extrapolated, prior), 1, 2)
        change = np.einsum("hab,hb->ha", gains, expected - values[:count])
        updated = prior - gains @ prior
        a, b = (np.trace(c, axis1=1, axis2=2) for c in (prior, extrapolated))
        updated *= (1 + 2 * np.sqrt(a * b) / (a + b))[:, None, None]
        values, covariances = values.copy(), covariances.copy()
        values[:count] += change
        covariances[:count] = (updated + np.swapaxes(updated, 1, 2)) / 2
        return values, covariances


class Conditioning:
    """Distribution of samples of C channels, given other values of a Gaussian mixture.

    Parameters
    ----------
    proportions : ndarray, shape (M,)
    means : ndarray, shape (M, m + H C)
        Of m observed values, and of H samples.
    covariances : ndarray, shape (M, m + H C, m + H C)
    noise : ndarray, shape (m,)
        Variance of the noise of the observed values.
    channels : int
        C.
    spread : ndarray, shape (H,), optional
        Factors of the covariance between the components.

    Examples
    --------
    >>> import numpy as np
    >>> twice = np.array([[[1.0, 2.0], [2.0, 4.0]]])
    >>> model = Conditioning(
    ...     np.ones(1), np.zeros((1, 2)), twice, noise=np.zeros(1), channels=1
    ... )
    >>> model.predict(np.array([3.0]))[0]
    array([[6.]])
    """

    def __init__(
        self,
        proportions: Array,
        means: Array,
        covariances: Array,
        *,
        noise: Array,
        channels: int,
        spread: Array | None = None,
    ) -> None:
        m, known, d = len(means), len(noise), channels
        count = (means.shape[1] - known) // d
        samples = np.arange(count)
        observed = covariances[:, :known, :known] + np.diag(noise)
        self._observed = means[:, :known]
        self._means = means[:, known:].reshape(m, count, d)
        self._whitening = np.linalg.inv(np.linalg.cholesky(observed))
        self._gains = covariances[:, known:, :known] @ np.swapaxes(
            self._whitening, 1, 2
        )
        # Diagonal blocks only: the covariance of each sample.
        blocks = self._gains.reshape(m, count, d, known)
        later = covariances[:, known:, known:].reshape(m, count, d, count, d)
        self._covariances = np.swapaxes(later[:, samples, :, samples], 0, 1)
        self._covariances = self._covariances - blocks @ np.swapaxes(blocks, 2, 3)
        roots = np.diagonal(self._whitening, axis1=1, axis2=2)
        self._offsets = np.log(proportions) + np.sum(np.log(roots), axis=1)
        self._spread = np.sqrt(np.ones(count) if spread is None else spread)

    def predict(self, values: Array) -> tuple[Array, Array]:
        """Return mean (H, C) and covariances (H, C, C) given m values of any shape.

        They are those of the mixture, with components weighted by their evidence.
        """
        error = (values.ravel() - self._observed)[..., None]
        whitened = self._whitening @ error
        evidence = self._offsets - 0.5 * np.sum(whitened**2, axis=(1, 2))
        probabilities = softmax(evidence)
        means = self._means + (self._gains @ whitened).reshape(self._means.shape)
        mean = np.tensordot(probabilities, means, axes=1)
        spread = np.sqrt(probabilities)[:, None, None] * (means - mean)
        spread = spread * self._spread[:, None]
        covariances = np.tensordot(probabilities, self._covariances, axes=1)
        return mean, covariances + np.einsum("mha,mhb->hab", spread, spread)


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
        windows = windows_of_all(recordings, n_steps=span)
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
        nearest = np.argsort(distance, kind="stable")[:_MOST_SIMILAR]
        weights = softmax(-distance[nearest] / (distance[nearest[0]] + self._width))
        windows = self._inferred[is_used][nearest]
        mean = np.tensordot(weights, windows, axes=1)
        deviations = windows - mean
        return mean, np.einsum("n,nha,nhb->hab", weights, deviations, deviations)
