"""Probabilistic movement primitives with von Mises bases, as the paper runs them."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import SkillError
from fmp_drake.experiments.baselines.checks import (
    check_ranges,
    checked_count,
    checked_keypoints,
    checked_prefix,
    checked_windows,
)
from fmp_drake.experiments.baselines.mixture_posterior import (
    MixturePosterior,
    condition_mixture,
)
from fmp_drake.experiments.baselines.trajectory_model import Conditioned
from fmp_drake.experiments.baselines.von_mises_basis import VonMisesBasis
from fmp_drake.primitives.model.em import fit_gaussians
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.mixture import log_densities

# Least variance of the observation noise: 0.1 mm where the values are metres.
_LEAST_NOISE = 1e-8


class ProMP(BaseEstimator):  # type: ignore[misc]
    """ProMP-VM and ProMP-VM-Mult of section V, one Gaussian or a mixture.

    A window is y_t = Phi(t / T) w + noise, with the normalised von Mises bases (21).
    The weights of every window and channel come from ridge least squares; those of
    all channels together follow one Gaussian (as in ProMP) or a mixture (as in V-B,
    by EM from k-means); the noise is the least squares' residual.

    Numerics: n bases of one frequency span, but for terms of order h^-2, three
    dimensions, so the bases of one frequency are redundant for any n > 3, and those of
    several share the constant. The ridge picks the least weights, which makes the
    solution unique; the weights' covariances are singular but for `reg_covar` on their
    diagonals, nothing else. The paper reports instabilities of EM with ProMP-VM-Mult;
    with these two there were none.

    The ridge matters most, and not for the reason one thinks of: the coordinates of
    what bases still hold of harmonic k grow like h^k, so without enough of it noise
    rules the weights, k-means clusters that noise, and samples fall into the
    holes of the pattern. On the bundled 8-shape (f = 1 to 5, M = 10, three quarters
    learned from), ridges of 1e-8, 3e-7 and 1e-4 with h = 100 gave the heatmap of
    the held-out quarter a forward Kullback-Leibler divergence of 2.3, 0.95 and 3.6;
    reg_covar from 1e-8 to 1e-4 made little difference. The defaults are the
    paper's bases (cosines) with the ridge that was best there; `best_on_held_out`
    makes the choice for other data.

    Parameters
    ----------
    frequencies : tuple of float
        f of (21), cycles per window: must be known. Several make ProMP-VM-Mult:
        (1, 2, 3, 4, 5) in V-C.
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
    random_state : int
        Seed of k-means.

    Attributes
    ----------
    n_steps_, n_channels_ : int
        T and D.
    proportions_ : ndarray, shape (M,)
    means_ : ndarray, shape (M, D * B)
        Of the weights, those of a channel together.
    covariances_ : ndarray, shape (M, D * B, D * B)
    noise_ : ndarray, shape (D,)
        Variance of the observation noise.

    References
    ----------
    A. Paraschos et al., "Probabilistic movement primitives", NIPS 2013; "Using
    probabilistic movement primitives in robotics", Autonomous Robots 42(3), 2018.
    """

    def __init__(
        self,
        *,
        frequencies: tuple[float, ...] = (3.0,),
        n_bases: int = 20,
        width: float = 100.0,
        ridge: float = 3e-7,
        n_components: int = 1,
        reg_covar: float = 1e-6,
        tolerance: float = 1e-8,
        random_state: int = 0,
    ) -> None:
        self.frequencies = frequencies
        self.n_bases = n_bases
        self.width = width
        self.ridge = ridge
        self.n_components = n_components
        self.reg_covar = reg_covar
        self.tolerance = tolerance
        self.random_state = random_state

    def fit(self, windows: ArrayLike) -> Self:
        """Learn from windows, shape (N, T, D), at least 2."""
        basis = self.basis
        check_ranges(
            self,
            ("ridge", "positive", self.ridge > 0),
            ("n_components", "at least 1", self.n_components >= 1),
            ("reg_covar", "positive", self.reg_covar > 0),
            ("tolerance", "positive", self.tolerance > 0),
        )
        y = checked_windows(windows, at_least=2)
        n, self.n_steps_, self.n_channels_ = y.shape
        phi = basis.rows(np.arange(self.n_steps_) / self.n_steps_)
        left, singular, right = np.linalg.svd(phi, full_matrices=False)
        filters = singular / (singular**2 + self.ridge)
        seen = np.swapaxes(y, 1, 2) @ left  # (N, D, rank)
        weights = (seen * filters) @ right
        rest = np.swapaxes(y, 1, 2) - weights @ phi.T
        free = self.n_steps_ - float(np.sum(filters * singular))
        self.noise_ = np.sum(rest**2, axis=(0, 2)) / (n * max(free, 1.0))
        self.noise_ = np.maximum(self.noise_, _LEAST_NOISE)
        flat = weights.reshape(n, -1)
        most = min(n // 2, len(np.unique(flat, axis=0)))
        try:
            fit = fit_gaussians(
                flat,
                sample_weights=np.ones(n),
                n_components=min(self.n_components, most),
                regularization=self.reg_covar,
                shrinkage=0.0,
                seed=self.random_state,
            )
        except (np.linalg.LinAlgError, SkillError):
            raise SkillError(
                f"reg_covar is {self.reg_covar!r}: too little for the covariances of "
                f"{flat.shape[1]} redundant weights; it must be greater."
            ) from None
        self.proportions_, self.means_ = fit.proportions, fit.means
        self.covariances_ = fit.covariances
        return self

    def sample(
        self, n: int = 1, *, seed: int = 0, with_noise: bool = False
    ) -> NDArray[np.float64]:
        """Draw trajectories, shape (n, T, D).

        Without the observation noise, which is white in time and nothing that a robot
        should follow, unless it is asked for.
        """
        self.check_fitted()
        checked_count(n, seed)
        rng = np.random.default_rng(seed)
        counts = rng.multinomial(n, self.proportions_ / self.proportions_.sum())
        size = self.means_.shape[1]
        parts = [np.empty((0, size))]
        for count, mean, covariance in zip(
            counts, self.means_, self.covariances_, strict=True
        ):
            if count:
                white = rng.standard_normal((count, size))
                parts.append(mean + white @ _factor(covariance).T)
        weights = rng.permutation(np.concatenate(parts))
        out = self._trajectories(weights, np.arange(self.n_steps_))
        if with_noise:
            out += np.sqrt(self.noise_) * rng.standard_normal(out.shape)
        return out

    def log_density(self, windows: ArrayLike) -> NDArray[np.float64]:
        """Return the log density per time step of windows (N, T, D), shape (N,).

        Of the observed trajectories: the weights' mixture and the observation noise.
        """
        self.check_fitted()
        y = checked_windows(windows, shape=(self.n_steps_, self.n_channels_))
        scale = np.sqrt(self.noise_)
        scaled = np.swapaxes(y / scale, 1, 2).reshape(len(y), -1)
        components = tuple(
            self._trajectory_gaussian(mean, covariance, scale)
            for mean, covariance in zip(self.means_, self.covariances_, strict=True)
        )
        stretch = self.n_steps_ * float(np.sum(np.log(scale)))
        densities = log_densities(scaled, self.proportions_, components)
        return (densities - stretch) / self.n_steps_

    def condition(self, steps: ArrayLike, values: ArrayLike) -> Conditioned:
        """Condition on values (K, D) at steps (K,), from 0 to T - 1.

        Every Gaussian is conditioned; the component is that with the greatest posterior
        probability (its evidence and its proportion).
        """
        self.check_fitted()
        steps, y = checked_keypoints(
            steps, values, n_steps=self.n_steps_, n_channels=self.n_channels_
        )
        posterior = self.posterior(steps, y, noise=self.tolerance)
        j = int(np.argmax(posterior.responsibilities))
        every = np.arange(self.n_steps_)
        phi, d = self.basis.rows(every / self.n_steps_), self.n_channels_
        blocks = posterior.covariance(j).reshape(d, phi.shape[1], d, -1)
        along = np.tensordot(phi, blocks, axes=(1, 1))  # (T, D, D, B)
        return Conditioned(
            mean=self._trajectories(posterior.means[j], every),
            covariance=np.einsum("tdeb,tb->tde", along, phi),
            component=j,
            responsibilities=posterior.responsibilities,
        )

    def predict(self, prefix: ArrayLike, horizon: int) -> NDArray[np.float64]:
        """Return the expected continuation (horizon, D) of samples (K, D).

        The samples are put at the start of a window, with the observation noise; the
        expectation is over all components. The bases are periodic, so the horizon may
        be longer than the window.
        """
        self.check_fitted()
        y = checked_prefix(prefix, horizon, n_channels=self.n_channels_)
        steps = np.arange(len(y))
        posterior = self.posterior(steps, y, noise=self.noise_)
        return self._trajectories(posterior.mean(), len(y) + np.arange(horizon))

    def posterior(
        self, steps: ArrayLike, values: ArrayLike, *, noise: ArrayLike
    ) -> MixturePosterior:
        """Return the mixture of the weights given values (K, D) at any steps (K,).

        Parameters
        ----------
        noise : array_like, shape () or (D,)
            Variance of each channel.
        """
        self.check_fitted()
        y = np.asarray(values, dtype=float)
        phi = self.basis.rows(np.asarray(steps, dtype=float) / self.n_steps_)
        d = self.n_channels_
        rows = np.einsum("kb,de->kdeb", phi, np.eye(d)).reshape(len(phi) * d, -1)
        return condition_mixture(
            self.proportions_,
            self.means_,
            self.covariances_,
            rows=rows,
            values=y.ravel(),
            noise=np.broadcast_to(noise, y.shape).ravel(),
        )

    def trajectory(self, weights: ArrayLike, steps: ArrayLike) -> NDArray[np.float64]:
        """Return the values (..., K, D) of weights (..., D * B) at steps (K,)."""
        self.check_fitted()
        return self._trajectories(np.asarray(weights), np.asarray(steps))

    @property
    def basis(self) -> VonMisesBasis:
        """The bases (21)."""
        return VonMisesBasis(
            frequencies=tuple(self.frequencies),
            n_bases=self.n_bases,
            width=self.width,
        )

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self, "means_")

    def _trajectories(
        self, weights: NDArray[np.float64], steps: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        phi = self.basis.rows(steps / self.n_steps_)
        each = weights.reshape(*weights.shape[:-1], self.n_channels_, phi.shape[1])
        return np.swapaxes(each @ phi.T, -1, -2)

    def _trajectory_gaussian(
        self,
        mean: NDArray[np.float64],
        covariance: NDArray[np.float64],
        scale: NDArray[np.float64],
    ) -> LowRankGaussian:
        """Return Phi w + noise, in units of the noise, channel by channel."""
        phi, d = self.basis.rows(np.arange(self.n_steps_) / self.n_steps_), len(scale)
        factor = _factor(covariance).reshape(d, phi.shape[1], -1)
        spread = np.einsum("tb,dbr->dtr", phi, factor, optimize=True)
        spread /= scale[:, None, None]
        left, singular, _ = np.linalg.svd(
            spread.reshape(d * self.n_steps_, -1), full_matrices=False
        )
        middle = self._trajectories(mean, np.arange(self.n_steps_)) / scale
        return LowRankGaussian(
            mean=np.ascontiguousarray(middle.T).ravel(),
            basis=left,
            variances=singular**2,
            noise=1.0,
        )


def _factor(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a square root L of a covariance, L L' = covariance."""
    variances, vectors = np.linalg.eigh(covariance)
    out: NDArray[np.float64] = vectors * np.sqrt(np.maximum(variances, 0))
    return out
