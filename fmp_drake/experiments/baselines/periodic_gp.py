"""Gaussian process regression with a periodic kernel."""

import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp, softmax
from scipy.stats import multivariate_normal
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    ExpSineSquared,
    WhiteKernel,
)

from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.primitives.data.joining import joined_recordings
from fmp_drake.primitives.model.phase.period import fundamental_period


class PeriodicGP(TrajectoryModel):
    """A Gaussian process over time with a kernel that is periodic and slowly decays.

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
    continued.

    Parameters
    ----------
    n_points : int
        Samples of the memory that are used; the cost grows with the cube.
    n_periods : float
        Length of the memory, periods; at least two windows.
    n_moments : int
        Starts of a window that are tried, in a period.
    random_state : int
        Seed of the drawn points.

    Attributes
    ----------
    period_ : float
        The estimated period, samples.
    mean_, scale_ : ndarray, shape (D,)
        Mean and standard deviation of each channel of the recording.
    processes_ : tuple of GaussianProcessRegressor
        scikit-learn's fitted process of every channel, in standard deviations; its time
        is in samples, 0 is the first sample after the memory.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import sliding_windows
    >>> path = np.sin(np.arange(150) * np.pi / 10)[:, None]
    >>> windows = sliding_windows(path, n_steps=30, stride=5)
    >>> model = PeriodicGP(n_points=20, n_moments=8).fit(windows)
    >>> model.sample(3).shape
    (3, 30, 1)

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
        random_state: int = 0,
    ) -> None:
        self.n_points = n_points
        self.n_periods = n_periods
        self.n_moments = n_moments
        self.random_state = random_state

    def _learn(self, windows: NDArray[np.float64]) -> None:
        self._check_parameters(n_points=10, n_periods=2, n_moments=4)
        recordings = joined_recordings(windows)
        self.period_ = period = fundamental_period(recordings)
        longest = max(recordings, key=len)
        length = int(max(2 * self.n_steps_, np.ceil(self.n_periods * period)))
        memory = longest[-length:]
        rng = np.random.default_rng(self.random_state)
        count = min(self.n_points, len(memory))
        kept = np.sort(rng.choice(len(memory), count, replace=False))
        time = (kept - float(len(memory)))[:, None]
        self.mean_ = longest.mean(axis=0)
        spread = longest.std(axis=0)
        self.scale_ = np.where(spread > 0, spread, 1.0)
        observed = (memory[kept] - self.mean_) / self.scale_
        start = ConstantKernel(1.0, (1e-2, 1e2)) * ExpSineSquared(
            1.0, period, (0.1, 10.0), (0.85 * period, 1.15 * period)
        ) * RBF(5 * period, (0.5 * period, 100 * period)) + WhiteKernel(
            1e-3, (1e-8, 1.0)
        )
        with warnings.catch_warnings():
            # A parameter at the end of its range is a result like others.
            warnings.simplefilter("ignore", ConvergenceWarning)
            self.processes_ = tuple(
                GaussianProcessRegressor(start, alpha=1e-10).fit(time, channel)
                for channel in observed.T
            )

    def _draw(self, n: int, seed: int) -> NDArray[np.float64]:
        rng = np.random.default_rng(seed)
        counts = rng.multinomial(n, np.full(self.n_moments, 1 / self.n_moments))
        out = np.empty((n, self.n_steps_, self.n_channels_))
        steps, done = np.arange(self.n_steps_), 0
        for moment, count in zip(self._moments(), counts, strict=True):
            for d in range(self.n_channels_ if count else 0):
                mean, cov = self._posterior(d, moment + steps)
                out[done : done + count, :, d] = rng.multivariate_normal(
                    mean, cov, size=count, method="eigh", check_valid="ignore"
                )
            done += count
        return rng.permutation(out * self.scale_ + self.mean_)

    def log_density(self, windows: ArrayLike) -> NDArray[np.float64]:
        """Return the log density of windows (N, T, D) per time step, shape (N,).

        That of the mixture over the moments, noise included.
        """
        scaled = (self._checked_windows(windows) - self.mean_) / self.scale_
        each = self._log_evidence(scaled)
        total = logsumexp(each, axis=0) - np.log(self.n_moments)
        stretch = float(np.sum(np.log(self.scale_)))
        return total / self.n_steps_ - stretch

    def _continue(
        self, prefix: NDArray[np.float64], horizon: int
    ) -> NDArray[np.float64]:
        """Return the expectation over all moments, each weighted by its evidence."""
        scaled = (prefix - self.mean_) / self.scale_
        k = len(prefix)
        probabilities = softmax(self._log_evidence(scaled[None])[:, 0])
        out = np.zeros((horizon, self.n_channels_))
        for probability, moment in zip(probabilities, self._moments(), strict=True):
            for d in range(self.n_channels_ if probability > 1e-6 else 0):
                prior, cov = self._posterior(d, moment + np.arange(k + horizon))
                gram = cov[:k, :k] + self._noise(d) * np.eye(k)
                step = np.linalg.solve(gram, scaled[:, d] - prior[:k])
                out[:, d] += probability * (prior[k:] + cov[k:, :k] @ step)
        return out * self.scale_ + self.mean_

    def _moments(self) -> NDArray[np.float64]:
        """Return when a window may start, samples after the memory."""
        return self.period_ * np.arange(self.n_moments) / self.n_moments

    def _noise(self, channel: int) -> float:
        # A floor for the solves: a ten-thousandth of the standard deviation.
        return max(float(self.processes_[channel].kernel_.k2.noise_level), 1e-8)

    def _posterior(
        self, channel: int, times: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean and covariance of a scaled channel, without noise."""
        process = self.processes_[channel]
        mean, cov = process.predict(times[:, None], return_cov=True)
        return mean, cov - process.kernel_.k2.noise_level * np.eye(len(times))

    def _log_evidence(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the log density of scaled values (N, K, D) at every moment, (S, N)."""
        k = values.shape[1]
        out = np.zeros((self.n_moments, len(values)))
        for i, moment in enumerate(self._moments()):
            for d in range(self.n_channels_):
                mean, cov = self._posterior(d, moment + np.arange(k))
                observed = multivariate_normal(mean, cov + self._noise(d) * np.eye(k))
                out[i] += observed.logpdf(values[:, :, d])
        return out
