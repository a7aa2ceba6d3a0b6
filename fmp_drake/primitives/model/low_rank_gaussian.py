"""A Gaussian whose covariance is low-rank plus isotropic."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from fmp_drake.errors import SkillError


@dataclass(frozen=True, kw_only=True, eq=False)
class LowRankGaussian:
    """Gaussian in n dimensions with covariance U diag(s) U' + noise I.

    Every operation is exact and none builds an n x n array.

    Attributes
    ----------
    mean : ndarray, shape (n,)
    basis : ndarray, shape (n, r)
        U, with orthonormal columns.
    variances : ndarray, shape (r,)
        s, each greater than -noise (a posterior varies less than the isotropic rest
        where it has been observed).
    noise : float
        Variance of the isotropic rest, positive.
    """

    mean: NDArray[np.float64]
    basis: NDArray[np.float64]
    variances: NDArray[np.float64]
    noise: float

    def __post_init__(self) -> None:
        """Check the shapes and signs, and make the arrays read-only."""
        n = self.mean.shape[0]
        r = self.variances.shape[0]
        if self.mean.shape != (n,) or self.basis.shape != (n, r):
            raise SkillError(
                f"mean has shape {self.mean.shape}, basis {self.basis.shape} and "
                f"variances {self.variances.shape}; expected (n,), (n, r), (r,)."
            )
        if not self.noise > 0 or not np.all(self.variances > -self.noise):
            raise SkillError(
                f"noise is {self.noise} and the least variance "
                f"{np.min(self.variances, initial=0)}; noise must be positive "
                "and every variance greater than -noise."
            )
        for array in (self.mean, self.basis, self.variances):
            array.setflags(write=False)

    @property
    def dim(self) -> int:
        """The number of dimensions n."""
        return self.mean.shape[0]

    @property
    def rank(self) -> int:
        """The number of columns r of the factor."""
        return self.variances.shape[0]

    def multiply(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """Return the covariance times vectors, shape (..., n)."""
        x = np.asarray(vectors, dtype=float)
        return ((x @ self.basis) * self.variances) @ self.basis.T + self.noise * x

    def solve(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """Return the precision (inverse covariance) times vectors (..., n)."""
        x = np.asarray(vectors, dtype=float)
        shrink = self.variances / (self.variances + self.noise)
        return (x - ((x @ self.basis) * shrink) @ self.basis.T) / self.noise

    def precision_diagonal(self) -> NDArray[np.float64]:
        """Return the diagonal of the precision matrix, shape (n,)."""
        shrink = self.variances / (self.variances + self.noise)
        return (1 - (self.basis**2) @ shrink) / self.noise

    def mahalanobis_squared(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """Return (x - mean)' precision (x - mean) of vectors (..., n)."""
        delta = np.asarray(vectors, dtype=float) - self.mean
        inside = delta @ self.basis
        rest = np.sum(delta**2, axis=-1) - np.sum(inside**2, axis=-1)
        weighted = np.sum(inside**2 / (self.variances + self.noise), axis=-1)
        return weighted + np.maximum(rest, 0) / self.noise

    def log_density(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """Return the natural logarithm of the density at vectors (..., n)."""
        log_det = np.sum(np.log(self.variances + self.noise))
        log_det += (self.dim - self.rank) * np.log(self.noise)
        log_det += self.dim * np.log(2 * np.pi)
        return -0.5 * (self.mahalanobis_squared(vectors) + log_det)

    def sample(
        self, rng: np.random.Generator, size: int = 1, *, with_noise: bool = True
    ) -> NDArray[np.float64]:
        """Draw vectors, shape (size, n).

        Parameters
        ----------
        rng : numpy.random.Generator
        size : int
        with_noise : bool
            False draws from the low-rank part alone. The isotropic rest of a
            skill's weights is white noise in time: part of the density, but
            not something that a robot should follow.
        """
        if not with_noise:
            spread = np.sqrt(np.maximum(self.variances, 0))
            scaled = rng.standard_normal((size, self.rank)) * spread
            return self.mean + scaled @ self.basis.T
        white = np.sqrt(self.noise) * rng.standard_normal((size, self.dim))
        stretch = np.sqrt(1 + self.variances / self.noise) - 1
        return self.mean + white + ((white @ self.basis) * stretch) @ self.basis.T

    def marginal(
        self, rows: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean (m,) and covariance (m, m) of rows (m, n) times x."""
        a = np.asarray(rows, dtype=float)
        factor = a @ self.basis
        cov = (factor * self.variances) @ factor.T + self.noise * (a @ a.T)
        return a @ self.mean, cov

    def posterior(
        self, rows: ArrayLike, values: ArrayLike, noise: ArrayLike
    ) -> "LowRankGaussian":
        """Return the Gaussian given rows @ x = values + white noise, exactly.

        Parameters
        ----------
        rows : array_like, shape (m, n)
        values : array_like, shape (m,)
        noise : array_like, shape () or (m,)
            Variance of each observation's noise.

        Returns
        -------
        LowRankGaussian
            Of rank up to r + m and the same isotropic rest.
        """
        a = np.asarray(rows, dtype=float)
        mean, cov = self.marginal(a)
        cov[np.diag_indices_from(cov)] += np.asarray(noise, dtype=float)
        factor = cho_factor(cov)
        cross = self.multiply(a)  # (m, n): rows times the covariance
        delta = np.asarray(values, dtype=float) - mean
        span, _ = np.linalg.qr(np.concatenate([self.basis, a.T], axis=1))
        inside = span.T @ self.basis
        seen = span.T @ cross.T
        core = (inside * self.variances) @ inside.T
        core -= seen @ cho_solve(factor, seen.T)
        variances, rotation = np.linalg.eigh((core + core.T) / 2)
        return LowRankGaussian(
            mean=self.mean + cross.T @ cho_solve(factor, delta),
            basis=span @ rotation,
            variances=np.maximum(variances, (1e-9 - 1) * self.noise),
            noise=self.noise,
        )
