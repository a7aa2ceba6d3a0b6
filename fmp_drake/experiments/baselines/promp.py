"""Probabilistic movement primitives (ProMP) with von Mises bases, as in section V."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp, softmax
from sklearn.base import BaseEstimator, clone
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import ExperimentError, SkillError
from fmp_drake.experiments.baselines.alignment import align_periods, movement_period
from fmp_drake.experiments.baselines.method import (
    HORIZON,
    PAST,
    Forecast,
    Method,
    long_enough,
)
from fmp_drake.numeric import Array, check_number, finite_array
from fmp_drake.primitives.data.windows import joined_recordings, windows_of_all
from fmp_drake.primitives.model.mixture import fit_gaussians
from fmp_drake.primitives.model.prediction import Conditioning, Prediction

# Least variance of the observation noise: 0.1 mm where the values are metres.
_LEAST_NOISE = 1e-8
# Greatest length of a window, samples.
_MOST_WINDOW = 120


def von_mises_bases(
    z: ArrayLike,
    *,
    frequencies: Sequence[float],
    n_bases: int = 20,
    width: float = 100.0,
) -> Array:
    """Return normalised von Mises bases (21) of one or several frequencies, (K, B).

    Interpretation of (21): z_t = t / T is the time in windows, f is in cycles per window,
    and the n centres of a frequency are c_i = i / (n f), i = 0 to n - 1. So the angles
    2 pi f c_i are uniform over [0, 2 pi) without the end, which would repeat the first
    ("uniformly placed between 0 and 2 pi"). The sum in the denominator is over the bases
    of the same frequency; with several frequencies (ProMP-VM-Mult) the bases of each sum
    to one.

    For a large width h a basis is a cosine: b_i ~ 1 + cos(.) / h, and
    Phi_i ~ (1 + cos(.) / h) / n. The amplitude of harmonic k falls like h^-k.

    Parameters
    ----------
    z : array_like, shape (K,)
        Times, in windows.
    frequencies : sequence of float
        f, cycles per window.
    n_bases : int
        n, of each frequency.
    width : float
        h of (21).

    Examples
    --------
    >>> von_mises_bases([0.0, 0.25, 0.5], frequencies=(1.0, 2.0), n_bases=5).shape
    (3, 10)

    References
    ----------
    A. Paraschos et al., "Probabilistic movement primitives", NIPS 2013; "Using
    probabilistic movement primitives in robotics", Autonomous Robots 42(3), 2018.
    """
    for frequency in frequencies:
        check_number(frequency, "a frequency", above=0.0, error=ExperimentError)
    if not frequencies:
        raise ExperimentError("there are no frequencies; give at least one.")
    check_number(n_bases, "n_bases", least=3, whole=True, error=ExperimentError)
    check_number(width, "width", above=0.0, error=ExperimentError)
    f = np.asarray(frequencies, dtype=float)
    centres = np.arange(n_bases) / n_bases  # f c_i, in periods
    periods = np.multiply.outer(np.asarray(z, dtype=float), f)[..., None]
    # Divided by exp(1 / h), which the normalisation cancels.
    b = np.exp((np.cos(2 * np.pi * (periods - centres)) - 1) / width)
    b /= b.sum(axis=-1, keepdims=True)
    return b.reshape(len(b), -1)


class MixturePosterior(NamedTuple):
    """Posterior of a mixture of M Gaussians in n dimensions.

    Leading axes (...) are those of the observations.

    Attributes
    ----------
    log_evidence : ndarray, shape (...)
        Log density of the observation under the mixture.
    probabilities : ndarray, shape (M, ...)
        Probabilities of the components, given the observation.
    means : ndarray, shape (M, ..., n)
        Means of the components, given the observation.
    """

    log_evidence: Array
    probabilities: Array
    means: Array


class ProMP(BaseEstimator):  # type: ignore[misc]
    """ProMP-VM and ProMP-VM-Mult of section V, one Gaussian or a mixture.

    A window is y_t = Phi(t / T) w + noise, with the normalised von Mises bases (21).
    The weights of every window and channel come from ridge least squares; those of
    all channels together follow one Gaussian (as in ProMP) or a mixture (as in V-B,
    by EM from k-means); the noise is the least squares' residual.

    Numerics: up to terms of order h^-2, n bases of one frequency span three dimensions. So
    they are redundant for any n > 3, and those of several frequencies contain the same
    constant. The ridge makes the solution unique: it selects the least weights. The
    weights' covariances are singular except for `reg_covar` on their diagonals. The paper
    reports instabilities of EM with ProMP-VM-Mult; with these two there were none.

    The ridge matters most. The amplitude of harmonic k in the bases falls like h^-k, so its
    weights grow like h^k. With too small a ridge noise dominates the weights, k-means
    clusters that noise, and samples fall into the holes of the pattern. On the bundled
    8-shape (f = 1 to 5, M = 10, learned from three quarters), ridges of 1e-8, 3e-7 and 1e-4
    with h = 100 gave the heatmap of the held-out quarter a forward Kullback-Leibler
    divergence of 2.3, 0.95 and 3.6; reg_covar from 1e-8 to 1e-4 made little difference. The
    defaults are the paper's bases (cosines) with the best ridge.

    Parameters
    ----------
    frequencies : tuple of float or int
        f of (21), cycles per window. ProMP-VM-Mult has several: (1, 2, 3, 4, 5) in V-C.
        An integer n selects the first n multiples of the movement's own frequency, T / P
        with the fundamental period P of the windows. A window need not contain whole
        periods.
    n_bases : int
        n of (21), of each frequency.
    width : float
        h of (21); large makes the bases cosines.
    ridge : float
        Added to the diagonal of Phi' Phi.
    n_components : int
        M; at most half the number of windows are used.
    reg_covar : float
        Variance added to every weight.
    tolerance : float
        Variance with which `condition` meets a keypoint.

    Attributes
    ----------
    n_steps_, n_channels_ : int
        T and D.
    frequencies_ : tuple of float
    proportions_ : ndarray, shape (M,)
    means_ : ndarray, shape (M, D * B)
        Means of the weights, ordered by channel.
    covariances_ : ndarray, shape (M, D * B, D * B)
    noise_ : ndarray, shape (D,)
        Variance of the observation noise.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import sliding_windows
    >>> path = np.sin(np.arange(200) * np.pi / 10)[:, None]
    >>> windows = sliding_windows(path, n_steps=40, stride=3)
    >>> model = ProMP(frequencies=(2.0,)).fit(windows)
    >>> trajectory = model.condition([0], [[0.5]])
    >>> trajectory.shape, round(float(trajectory[0, 0]), 3)
    ((40, 1), 0.5)

    References
    ----------
    A. Paraschos et al., "Probabilistic movement primitives", NIPS 2013; "Using
    probabilistic movement primitives in robotics", Autonomous Robots 42(3), 2018.
    """

    def __init__(
        self,
        *,
        frequencies: tuple[float, ...] | int = (3.0,),
        n_bases: int = 20,
        width: float = 100.0,
        ridge: float = 3e-7,
        n_components: int = 1,
        reg_covar: float = 1e-6,
        tolerance: float = 1e-8,
    ) -> None:
        self.frequencies = frequencies
        self.n_bases = n_bases
        self.width = width
        self.ridge = ridge
        self.n_components = n_components
        self.reg_covar = reg_covar
        self.tolerance = tolerance

    def fit(self, windows: ArrayLike) -> Self:
        """Learn from windows.

        Parameters
        ----------
        windows : array_like, shape (N, T, D)
            At least 2, in the order of the recordings that they were cut from.

        Raises
        ------
        ExperimentError
            If the windows or a parameter of the model are invalid.
        """
        windows = finite_array(
            windows, "the windows", ("N", "T", "D"), error=ExperimentError
        )
        n = len(windows)
        if n < 2:
            raise ExperimentError("there is 1 window; at least 2 are needed.")
        for name in ("ridge", "reg_covar", "tolerance"):
            check_number(getattr(self, name), name, above=0, error=ExperimentError)
        check_number(
            self.n_components,
            "n_components",
            least=1,
            whole=True,
            error=ExperimentError,
        )
        self.n_steps_, self.n_channels_ = windows.shape[1:]
        if isinstance(self.frequencies, int | np.integer):
            period = movement_period(joined_recordings(windows))
            harmonics = range(1, int(self.frequencies) + 1)
            self.frequencies_ = tuple(self.n_steps_ / period * k for k in harmonics)
        else:
            self.frequencies_ = tuple(self.frequencies)
        rows = self._rows(np.arange(self.n_steps_))
        left, singular, right = np.linalg.svd(rows, full_matrices=False)
        filters = singular / (singular**2 + self.ridge)
        channels = np.swapaxes(windows, 1, 2)
        channel_weights = (channels @ left * filters) @ right
        residual = channels - channel_weights @ rows.T
        freedom = self.n_steps_ - float(np.sum(filters * singular))
        self.noise_ = np.sum(residual**2, axis=(0, 2)) / (n * max(freedom, 1.0))
        self.noise_ = np.maximum(self.noise_, _LEAST_NOISE)
        weights = channel_weights.reshape(n, -1)
        most_components = min(n // 2, len(np.unique(weights, axis=0)))
        try:
            fit = fit_gaussians(
                weights,
                sample_weights=np.ones(n),
                n_components=min(self.n_components, most_components),
                regularization=self.reg_covar,
                shrinkage=0.0,
                seed=0,
            )
        except (np.linalg.LinAlgError, SkillError):
            raise ExperimentError(
                f"reg_covar is {self.reg_covar!r}: too small for the covariances of "
                f"{weights.shape[1]} redundant weights; expected a larger one."
            ) from None
        self._conditioning: tuple[tuple[int, int], Conditioning] | None = None
        self.proportions_, self.means_ = fit.proportions, fit.means
        self.covariances_ = fit.covariances
        return self

    def sample(self, n: int = 1, *, seed: int = 0) -> Array:
        """Draw n trajectories without observation noise, shape (n, T, D)."""
        check_is_fitted(self)
        for name, value in (("n", n), ("seed", seed)):
            check_number(value, name, least=0, whole=True, error=ExperimentError)
        rng = np.random.default_rng(seed)
        counts = rng.multinomial(n, self.proportions_ / self.proportions_.sum())
        parts = [
            rng.multivariate_normal(mean, covariance, count, method="eigh")
            for count, mean, covariance in zip(
                counts, self.means_, self.covariances_, strict=True
            )
        ]
        weights = rng.permutation(np.concatenate(parts))
        return self.trajectory(weights, np.arange(self.n_steps_))

    def condition(self, steps: ArrayLike, values: ArrayLike) -> Array:
        """Return the expected trajectory through keypoints.

        Every Gaussian is conditioned; the trajectory is the mean of the component with the
        greatest probability given the keypoints.

        Parameters
        ----------
        steps : array_like, shape (K,)
            Real numbers from 0 to T - 1.
        values : array_like, shape (K, D)

        Returns
        -------
        ndarray, shape (T, D)

        Raises
        ------
        ExperimentError
            If the keypoints are invalid.
        """
        check_is_fitted(self)
        times = finite_array(steps, "the steps", ("K",), error=ExperimentError)
        for time in times:
            check_number(
                time, "a step", least=0, most=self.n_steps_ - 1, error=ExperimentError
            )
        shape = (len(times), self.n_channels_)
        y = finite_array(values, "the values", shape, error=ExperimentError)
        posterior = self.posterior(times, y, noise=self.tolerance)
        best = posterior.means[np.argmax(posterior.probabilities)]
        return self.trajectory(best, np.arange(self.n_steps_))

    def predict(self, prefix: ArrayLike, horizon: int) -> Prediction:
        """Return the continuation of observed samples (K, D), noise included.

        The samples are the start of a window. The expectation is over all components. The
        bases are periodic, so the horizon may be longer than the window.
        """
        check_is_fitted(self)
        check_number(horizon, "horizon", least=1, whole=True, error=ExperimentError)
        shape = ("K", self.n_channels_)
        y = finite_array(prefix, "the prefix", shape, error=ExperimentError)
        k, d = y.shape
        if self._conditioning is None or self._conditioning[0] != (k, horizon):
            rows = self._observation_matrix(np.arange(k + horizon))
            noise = np.diag(np.tile(self.noise_, k + horizon))
            conditioning = Conditioning(
                self.proportions_,
                self.means_ @ rows.T,
                rows @ self.covariances_ @ rows.T + noise,
                noise=np.zeros(k * d),
                channels=d,
            )
            self._conditioning = (k, horizon), conditioning
        values, covariances = self._conditioning[1].predict(y)
        return Prediction(values=values, covariances=covariances)

    def posterior(
        self, steps: ArrayLike, values: ArrayLike, *, noise: ArrayLike
    ) -> MixturePosterior:
        """Return the mixture of the weights given values (..., K, D) at any steps (K,).

        Every component is conditioned like the one Gaussian of Paraschos et al. (2018);
        the probabilities of the components follow from Bayes' rule.

        Parameters
        ----------
        steps : array_like, shape (K,)
        values : array_like, shape (..., K, D)
            One observation, or several independent ones.
        noise : array_like, shape () or (D,)
            Variance of each channel, positive.
        """
        check_is_fitted(self)
        y = np.asarray(values, dtype=float)
        variances = np.broadcast_to(noise, y.shape[-2:]).ravel()
        y = y.reshape(*y.shape[:-2], -1)
        rows = self._observation_matrix(steps)
        posteriors, log_joint = [], []
        for proportion, mean, covariance in zip(
            self.proportions_, self.means_, self.covariances_, strict=True
        ):
            cross = rows @ covariance
            factor = cho_factor(cross @ rows.T + np.diag(variances), lower=True)
            error = y - rows @ mean
            solved = cho_solve(factor, error.T).T
            posteriors.append(mean + solved @ cross)
            log_root = np.sum(np.log(np.diag(factor[0])))
            squares = np.sum(error * solved, axis=-1) + len(rows) * np.log(2 * np.pi)
            log_joint.append(np.log(proportion) - 0.5 * squares - log_root)
        total = logsumexp(log_joint, axis=0)
        return MixturePosterior(total, np.exp(log_joint - total), np.stack(posteriors))

    def trajectory(self, weights: Array, steps: ArrayLike) -> Array:
        """Return the values (..., K, D) of weights (..., D * B) at steps (K,)."""
        phi = self._rows(steps)
        channel_weights = weights.reshape(
            *weights.shape[:-1], self.n_channels_, phi.shape[1]
        )
        return np.swapaxes(channel_weights @ phi.T, -1, -2)

    def _rows(self, steps: ArrayLike) -> Array:
        """Return Phi at steps (K,), shape (K, B)."""
        return von_mises_bases(
            np.asarray(steps) / self.n_steps_,
            frequencies=self.frequencies_,
            n_bases=self.n_bases,
            width=self.width,
        )

    def _observation_matrix(self, steps: ArrayLike) -> Array:
        """Return the matrix from weights to values at steps (K,), (K * D, D * B)."""
        channels = np.eye(self.n_channels_)
        rows = np.einsum("kb,de->kdeb", self._rows(steps), channels)
        return rows.reshape(-1, self.means_.shape[1])


# Narrow bases: nearly the best on held-out data of all bundled demonstrations. The
# paper's cosines (width 100, ridge 3e-7) represent few harmonics, enough for polishing only.
_ONE_PERIOD = ProMP(frequencies=(1.0,), width=0.3, ridge=1e-4, n_components=10)


class AlignedProMP(Method):
    """ProMP-VM over one period of aligned data (Fig. 5a and 6a of the paper): f = 1.

    The fundamental period of the recordings is estimated, and they are cut into aligned
    periods of equal length T. Steps count from phase 0, the maximum of the channel with
    the largest range.

    Parameters
    ----------
    model : ProMP, optional
        Model of the aligned periods, of frequency 1; it is not changed. By default it has
        narrow bases (width 0.3, ridge 1e-4) and 10 Gaussians.

    Attributes
    ----------
    n_steps_ : int
        T.
    period_ : float
        Mean duration of the aligned periods, samples; T is the estimated one, rounded.
    aligned_ : AlignedPeriods
    model_ : ProMP
        Fitted to the aligned periods.

    Examples
    --------
    >>> import numpy as np
    >>> path = np.sin(np.arange(400) * np.pi / 10)[:, None]
    >>> path += 0.01 * np.random.default_rng(0).standard_normal(path.shape)
    >>> model = AlignedProMP()
    >>> model.fit([path])
    >>> model.n_steps_
    20
    """

    name = "ProMP, aligned"

    def __init__(self, *, model: ProMP | None = None) -> None:
        self.model = model

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        recordings = long_enough(recordings)
        period = movement_period(recordings)
        self.n_steps_ = round(period)
        self.aligned_ = align_periods(recordings, period=period, n_steps=self.n_steps_)
        self.period_ = float(self.aligned_.durations.mean())
        self.model_ = clone(self.model or _ONE_PERIOD).fit(self.aligned_.values)

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Return the expectation over the T phases at which `past` (K, D) may start.

        Each is weighted by the evidence of the samples.
        """
        scale = self.n_steps_ / self.period_
        evidence = np.empty(self.n_steps_)
        futures = np.empty((self.n_steps_, horizon, past.shape[1]))
        for phase in range(self.n_steps_):
            steps = phase + scale * np.arange(len(past) + horizon)
            posterior = self.model_.posterior(
                steps[: len(past)], past, noise=self.model_.noise_
            )
            evidence[phase] = posterior.log_evidence
            mean = posterior.probabilities @ posterior.means
            futures[phase] = self.model_.trajectory(mean, steps[len(past) :])
        return Forecast(values=np.tensordot(softmax(evidence), futures, axes=1))


class WindowedProMP(Method):
    """ProMP-VM-Mult over windows, with the movement's own frequency and 80 Gaussians."""

    name = "ProMP, own frequencies"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        longest = max(map(len, recordings))
        size = int(np.clip(longest // 2, PAST + HORIZON, _MOST_WINDOW))
        stride = 1 if longest < 2 * _MOST_WINDOW else 2
        windows = windows_of_all(recordings, n_steps=size, stride=stride)
        if not len(windows):
            raise ExperimentError(f"no recording has {size} samples.")
        self._model = ProMP(frequencies=5, n_components=80).fit(windows)

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (K, D)."""
        prediction = self._model.predict(past, horizon)
        return Forecast(values=prediction.values, covariances=prediction.covariances)
