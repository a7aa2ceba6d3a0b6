"""A Gaussian whose covariance is low-rank plus isotropic."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from fmp_drake.errors import SkillError
from fmp_drake.numeric import Array

# Covariance of the background of a density relative to that of all windows.
_WIDE = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class LowRankGaussian:
    """A Gaussian in n dimensions whose covariance is U diag(s) U' + noise I.

    Every operation is exact and none builds an n x n array.

    Attributes
    ----------
    mean : ndarray, shape (n,)
    basis : ndarray, shape (n, r)
        U, with orthonormal columns.
    variances : ndarray, shape (r,)
        s, none negative: variance along each column beyond the noise.
    noise : float
        Variance in every direction, positive; the only one in the orthogonal complement
        of U.

    Examples
    --------
    >>> import numpy as np
    >>> gaussian = LowRankGaussian(
    ...     mean=np.zeros(3), basis=np.eye(3)[:, :1], variances=np.array([4.0]), noise=1.0
    ... )
    >>> gaussian.multiply(np.eye(3)).diagonal()
    array([5., 1., 1.])
    """

    mean: Array
    basis: Array
    variances: Array
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
        least = np.min(self.variances, initial=0)
        if not (self.noise > 0 and least >= 0):
            raise SkillError(
                f"noise is {self.noise} and the least variance {least}; noise must be "
                "positive and no variance negative."
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

    def multiply(self, vectors: ArrayLike) -> Array:
        """Return the covariance times vectors, shape (..., n)."""
        x = np.asarray(vectors, dtype=float)
        return ((x @ self.basis) * self.variances) @ self.basis.T + self.noise * x

    def precision_diagonal(self) -> Array:
        """Return the diagonal of the precision matrix, shape (n,)."""
        shrink = self.variances / (self.variances + self.noise)
        return (1 - (self.basis**2) @ shrink) / self.noise

    def mahalanobis_squared(self, vectors: ArrayLike) -> Array:
        """Return (x - mean)' precision (x - mean) of vectors (..., n)."""
        delta = np.asarray(vectors, dtype=float) - self.mean
        coordinates = delta @ self.basis
        outside = np.sum(delta**2, axis=-1) - np.sum(coordinates**2, axis=-1)
        weighted = np.sum(coordinates**2 / (self.variances + self.noise), axis=-1)
        return weighted + np.maximum(outside, 0) / self.noise

    def log_density(self, vectors: ArrayLike) -> Array:
        """Return the natural logarithm of the density at vectors (..., n)."""
        log_det = np.sum(np.log(self.variances + self.noise))
        log_det += (self.dim - self.rank) * np.log(self.noise)
        log_det += self.dim * np.log(2 * np.pi)
        return -0.5 * (self.mahalanobis_squared(vectors) + log_det)

    def sample(
        self, rng: np.random.Generator, size: int = 1, *, with_noise: bool = True
    ) -> Array:
        """Draw vectors, shape (size, n).

        Parameters
        ----------
        rng : numpy.random.Generator
        size : int
        with_noise : bool
            False draws from the low-rank part alone. The isotropic noise of a
            skill's weights is white noise in time: part of the density, but
            not something that a robot should follow.
        """
        if not with_noise:
            scaled = rng.standard_normal((size, self.rank)) * np.sqrt(self.variances)
            return self.mean + scaled @ self.basis.T
        white = np.sqrt(self.noise) * rng.standard_normal((size, self.dim))
        stretch = np.sqrt(1 + self.variances / self.noise) - 1
        return self.mean + white + ((white @ self.basis) * stretch) @ self.basis.T

    def marginal(self, rows: ArrayLike) -> tuple[Array, Array]:
        """Return mean (m,) and covariance (m, m) of A x, for A of shape (m, n)."""
        a = np.asarray(rows, dtype=float)
        factor = a @ self.basis
        cov = (factor * self.variances) @ factor.T + self.noise * (a @ a.T)
        return a @ self.mean, cov

    def confined(self, vector: Array, confidence: float) -> Array:
        """Return a vector projected onto the span and into an ellipsoid, shape (n,).

        Parameters
        ----------
        vector : ndarray, shape (n,)
        confidence : float
            Fraction of the distribution inside the ellipsoid, in (0, 1].
        """
        coordinates = (vector - self.mean) @ self.basis
        spread = np.sqrt(self.variances + self.noise)
        squared = float(np.sum((coordinates / spread) ** 2))
        radius_squared = float(chi2.ppf(confidence, max(self.rank, 1)))
        coordinates *= np.sqrt(min(1.0, radius_squared / max(squared, 1e-24)))
        return self.mean + self.basis @ coordinates


def wide_gaussian(
    proportions: Array, components: tuple[LowRankGaussian, ...]
) -> LowRankGaussian:
    """Return one wide Gaussian over all components: their covariance times a factor."""
    means = np.stack([c.mean for c in components])
    mean = proportions @ means
    covariance = (means - mean).T @ (proportions[:, None] * (means - mean))
    for proportion, c in zip(proportions, components, strict=True):
        covariance += proportion * (c.basis * c.variances) @ c.basis.T
    covariance[np.diag_indices_from(covariance)] += proportions @ [
        c.noise for c in components
    ]
    variances, vectors = np.linalg.eigh(_WIDE * covariance)
    noise = max(float(variances[0]), 1e-300)
    return LowRankGaussian(
        mean=mean,
        basis=np.ascontiguousarray(vectors),
        variances=np.maximum(variances - noise, 0.0),
        noise=noise,
    )
