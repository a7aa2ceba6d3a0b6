"""Gaussian process regression with a periodic kernel."""

import warnings
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp, softmax
from sklearn.base import BaseEstimator
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    ExpSineSquared,
    WhiteKernel,
)
from sklearn.utils.validation import check_is_fitted

from fmp_drake.experiments.baselines.checks import (
    check_ranges,
    checked_count,
    checked_keypoints,
    checked_prefix,
    checked_windows,
)
from fmp_drake.experiments.baselines.joining import joined_recordings
from fmp_drake.experiments.baselines.period import fundamental_period
from fmp_drake.experiments.baselines.trajectory_model import Conditioned


class PeriodicGP(BaseEstimator):  # type: ignore[misc]
    """A Gaussian process of time with a periodic kernel that slowly decays.

    For each channel, in its own standard deviations, section 5.4.3 of Rasmussen and
    Williams (2006)::

        k(t, t') = s^2 exp(-2 sin^2(pi (t - t') / p) / l^2)
                   exp(-(t - t')^2 / (2 r^2)) + noise^2 [t = t']

    s, l, p, r and the noise maximise the marginal likelihood of a part of the recording,
    the memory, of which `n_points` are drawn at random (at even distances the noise
    cannot be told from movements between the points). The likelihood has a maximum at every
    multiple of the period, so the search starts from an estimated one.

    A window is a posterior trajectory that starts at an unknown moment after the memory
    has ended, within one period: a mixture over that moment, the same for all
    channels. So a prefix is first placed in time, by its evidence, and then
    continued. What a component is to a mixture, a moment is here.

    Parameters
    ----------
    n_points : int
        Of the memory; the cost grows with the cube.
    n_periods : float
        Length of the memory, periods; at least two windows.
    n_moments : int
        In a period.
    tolerance : float
        Variance with which `condition` meets a keypoint.
    random_state : int
        Seed of the drawn points.

    Attributes
    ----------
    n_steps_, n_channels_ : int
        T and D.
    period_ : float
        The estimated period, samples.
    kernels_ : tuple
        scikit-learn's fitted kernel of every channel.
    log_marginal_likelihood_ : ndarray, shape (D,)

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, "Gaussian processes for machine learning", MIT
    Press, 2006.
    """

    def __init__(
        self,
        *,
        n_points: int = 200,
        n_periods: float = 3.0,
        n_moments: int = 48,
        tolerance: float = 1e-8,
        random_state: int = 0,
    ) -> None:
        self.n_points = n_points
        self.n_periods = n_periods
        self.n_moments = n_moments
        self.tolerance = tolerance
        self.random_state = random_state

    def fit(self, windows: ArrayLike) -> Self:
        """Learn from windows (N, T, D): from the end of the longest recording."""
        check_ranges(
            self,
            ("n_points", "at least 10", self.n_points >= 10),
            ("n_periods", "at least 2", self.n_periods >= 2),
            ("n_moments", "at least 4", self.n_moments >= 4),
            ("tolerance", "positive", self.tolerance > 0),
        )
        y = checked_windows(windows)
        recordings = joined_recordings(y)
        self.period_ = period = fundamental_period(recordings)
        longest = max(recordings, key=len)
        length = int(max(2 * y.shape[1], np.ceil(self.n_periods * period)))
        memory = longest[-length:]
        rng = np.random.default_rng(self.random_state)
        count = min(self.n_points, len(memory))
        kept = np.sort(rng.choice(len(memory), count, replace=False))
        # Time 0 is the first sample after the memory.
        self._time = (kept - float(len(memory)))[:, None]
        self.mean_ = longest.mean(axis=0)
        spread = longest.std(axis=0)
        self.scale_ = np.where(spread > 0, spread, 1.0)
        seen = (memory[kept] - self.mean_) / self.scale_
        start = ConstantKernel(1.0, (1e-2, 1e2)) * ExpSineSquared(
            1.0, period, (0.1, 10.0), (0.85 * period, 1.15 * period)
        ) * RBF(5 * period, (0.5 * period, 100 * period)) + WhiteKernel(
            1e-3, (1e-8, 1.0)
        )
        kernels, self._solves, likelihoods = [], [], []
        for channel in seen.T:
            process = GaussianProcessRegressor(start, alpha=1e-10)
            with warnings.catch_warnings():
                # A parameter at the end of its range is a result like others.
                warnings.simplefilter("ignore", ConvergenceWarning)
                process.fit(self._time, channel)
            kernel = process.kernel_
            gram = kernel(self._time)
            gram[np.diag_indices_from(gram)] += 1e-10
            factor = cho_factor(gram, lower=True)
            self._solves.append((factor, cho_solve(factor, channel)))
            kernels.append(kernel)
            likelihoods.append(process.log_marginal_likelihood_value_)
        self.kernels_ = tuple(kernels)
        self.log_marginal_likelihood_ = np.array(likelihoods)
        self.n_steps_, self.n_channels_ = y.shape[1:]
        return self

    def sample(
        self, n: int = 1, *, seed: int = 0, with_noise: bool = False
    ) -> NDArray[np.float64]:
        """Draw trajectories, shape (n, T, D), from random moments."""
        self.check_fitted()
        checked_count(n, seed)
        rng = np.random.default_rng(seed)
        size = self.n_moments
        counts = rng.multinomial(n, np.full(size, 1 / size))
        out = np.empty((n, self.n_steps_, self.n_channels_))
        steps, done = np.arange(self.n_steps_), 0
        for moment, count in zip(self._moments(), counts, strict=True):
            if not count:
                continue
            for d in range(self.n_channels_):
                mean, cov = self._posterior(d, moment + steps, with_noise=with_noise)
                variances, vectors = np.linalg.eigh(cov)
                factor = vectors * np.sqrt(np.maximum(variances, 0))
                drawn = mean + rng.standard_normal((count, len(steps))) @ factor.T
                out[done : done + count, :, d] = drawn
            done += count
        return rng.permutation(out * self.scale_ + self.mean_)

    def log_density(self, windows: ArrayLike) -> NDArray[np.float64]:
        """Return the log density per time step of windows (N, T, D), shape (N,).

        Of the mixture over the moments, with the observation noise.
        """
        self.check_fitted()
        y = checked_windows(windows, shape=(self.n_steps_, self.n_channels_))
        scaled = (y - self.mean_) / self.scale_
        each = self._log_evidence(np.arange(self.n_steps_), scaled)
        total = logsumexp(each, axis=0) - np.log(self.n_moments)
        stretch = float(np.sum(np.log(self.scale_)))
        return total / self.n_steps_ - stretch

    def condition(self, steps: ArrayLike, values: ArrayLike) -> Conditioned:
        """Place values (K, D) at steps (K,) in time and condition on them."""
        self.check_fitted()
        steps, y = checked_keypoints(
            steps, values, n_steps=self.n_steps_, n_channels=self.n_channels_
        )
        scaled = (y - self.mean_) / self.scale_
        noise = self.tolerance / self.scale_**2
        shares = softmax(self._log_evidence(steps, scaled[None], noise)[:, 0])
        best = int(np.argmax(shares))
        t, k = self.n_steps_, len(steps)
        mean = np.empty((t, self.n_channels_))
        covariance = np.zeros((t, self.n_channels_, self.n_channels_))
        times = self._moments()[best] + np.concatenate([steps, np.arange(t)])
        for d in range(self.n_channels_):
            prior, cov = self._posterior(d, times, with_noise=False)
            gram = cov[:k, :k] + noise[d] * np.eye(k)
            gain = np.linalg.solve(gram, cov[:k, k:]).T
            mean[:, d] = prior[k:] + gain @ (scaled[:, d] - prior[:k])
            left = np.diag(cov)[k:] - np.sum(gain * cov[k:, :k], axis=1)
            covariance[:, d, d] = np.maximum(left, 0) * self.scale_[d] ** 2
        return Conditioned(
            mean=mean * self.scale_ + self.mean_,
            covariance=covariance,
            component=best,
            responsibilities=shares,
        )

    def predict(self, prefix: ArrayLike, horizon: int) -> NDArray[np.float64]:
        """Return the expected continuation (horizon, D) of samples (K, D).

        Over all moments, each by its evidence.
        """
        self.check_fitted()
        y = checked_prefix(prefix, horizon, n_channels=self.n_channels_)
        scaled = (y - self.mean_) / self.scale_
        k = len(y)
        shares = softmax(self._log_evidence(np.arange(k), scaled[None])[:, 0])
        out = np.zeros((horizon, self.n_channels_))
        for share, moment in zip(shares, self._moments(), strict=True):
            if share < 1e-6:
                continue
            for d in range(self.n_channels_):
                times = moment + np.arange(k + horizon)
                prior, cov = self._posterior(d, times, with_noise=False)
                gram = cov[:k, :k] + self._noise(d) * np.eye(k)
                step = np.linalg.solve(gram, scaled[:, d] - prior[:k])
                out[:, d] += share * (prior[k:] + cov[k:, :k] @ step)
        return out * self.scale_ + self.mean_

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self, "kernels_")

    def _moments(self) -> NDArray[np.float64]:
        """Return when a window may start, samples after the memory."""
        return self.period_ * np.arange(self.n_moments) / self.n_moments

    def _noise(self, channel: int) -> float:
        # A floor for the solves: a ten-thousandth of the standard deviation.
        return max(float(self.kernels_[channel].k2.noise_level), 1e-8)

    def _posterior(
        self, channel: int, times: NDArray[np.float64], *, with_noise: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean and covariance of a scaled channel, given the memory."""
        kernel = self.kernels_[channel].k1
        factor, alpha = self._solves[channel]
        at = times[:, None]
        cross = kernel(at, self._time)
        cov = kernel(at) - cross @ cho_solve(factor, cross.T)
        cov[np.diag_indices_from(cov)] += self._noise(channel) if with_noise else 1e-10
        return cross @ alpha, cov

    def _log_evidence(
        self,
        steps: NDArray[np.float64] | NDArray[np.int64],
        values: NDArray[np.float64],
        noise: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Return the log density of scaled values (N, K, D) at every moment, (S, N)."""
        out = np.zeros((self.n_moments, len(values)))
        for i, moment in enumerate(self._moments()):
            for d in range(self.n_channels_):
                mean, cov = self._posterior(d, moment + steps, with_noise=noise is None)
                if noise is not None:
                    cov[np.diag_indices_from(cov)] += noise[d]
                lower = np.linalg.cholesky(cov)
                z = np.linalg.solve(lower, (values[:, :, d] - mean).T)
                out[i] -= 0.5 * np.sum(z**2, axis=0) + np.sum(np.log(np.diag(lower)))
        return out - 0.5 * len(steps) * self.n_channels_ * np.log(2 * np.pi)
