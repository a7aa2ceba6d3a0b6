"""From a partial trajectory to Fourier weights: Algorithm 1 of the paper."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cholesky, solve_triangular

from fmp_drake.errors import SkillError
from fmp_drake.primitives.data.numeric import GREATEST, all_finite, as_floats
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian

Selection = Literal["cost", "evidence"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Mapping:
    """The weights that meet an observation, and the component they belong to.

    Attributes
    ----------
    weights : ndarray, shape (D*T,)
        w_K of (16).
    component : int
        j* of (15).
    costs : ndarray, shape (M,)
        What was minimised over the components: (15) divided by lambda, or the
        negative log evidence up to a constant.
    """

    weights: NDArray[np.float64]
    component: int
    costs: NDArray[np.float64]


class MappingPlan:
    """Everything of Algorithm 1 that does not depend on the observed values.

    By the matrix inversion lemma the candidate (14) of component j is::

        w_j = mu_j + Sigma_j Phi' S_j^-1 (y - Phi mu_j),
        S_j = Phi Sigma_j Phi' + lambda I,

    and the two quadratic terms of (15) add up to
    lambda (y - Phi mu_j)' S_j^-1 (y - Phi mu_j). So only systems of the size
    of the observation are solved, here, and a mapping is two products.

    Parameters
    ----------
    proportions : ndarray, shape (M,)
    components : sequence of LowRankGaussian
    rows : array_like, shape (m, D*T)
        Phi: what is observed, as rows that multiply the weights.
    tolerance : array_like, shape () or (m,)
        lambda of (13), in squared units of the observation; one for all, or one
        each (a smaller one is met more closely).
    selection : {"cost", "evidence"}
        How to choose the component: by (15), or by the evidence of the
        observation, which adds the log determinant of S_j.
    """

    def __init__(
        self,
        proportions: NDArray[np.float64],
        components: tuple[LowRankGaussian, ...],
        *,
        rows: ArrayLike,
        tolerance: ArrayLike = 1e-8,
        selection: Selection = "cost",
    ) -> None:
        phi = np.atleast_2d(np.asarray(rows, dtype=float))
        size = len(phi)
        if phi.shape[1] != components[0].dim:
            raise SkillError(
                f"the rows have shape {phi.shape}; expected (m, {components[0].dim})."
            )
        lam = as_floats(tolerance, "the tolerance")
        if lam.shape not in ((), (size,)):
            raise SkillError(
                f"the tolerance has shape {lam.shape}; expected one number or ({size},)."
            )
        lam = np.broadcast_to(lam, (size,))
        if not np.all((lam > 0) & (lam < GREATEST)):
            raise SkillError(
                f"the tolerances run from {np.min(lam)} to {np.max(lam)}; every one "
                "must be positive and finite."
            )
        if selection not in ("cost", "evidence"):
            raise SkillError(
                f"selection is {selection!r}; choose 'cost' (15) or 'evidence'."
            )
        self.size = size
        n_components = len(components)
        whitening = np.empty((n_components, size, size))
        expected = np.empty((n_components, size))
        offsets = np.empty(n_components)
        self._gains = np.empty((n_components, phi.shape[1], size))
        self._means = np.stack([c.mean for c in components])
        for j, component in enumerate(components):
            expected[j], cov = component.marginal(phi)
            cov[np.diag_indices(size)] += lam
            try:
                lower = cholesky(cov, lower=True)
            except np.linalg.LinAlgError:
                raise SkillError(
                    "the observations depend on each other more closely than the "
                    f"tolerance of {np.min(lam):g} can tell; choose a greater one."
                ) from None
            whitening[j] = solve_triangular(lower, np.eye(size), lower=True)
            self._gains[j] = component.multiply(phi).T @ (whitening[j].T @ whitening[j])
            offsets[j] = -np.log(proportions[j])
            if selection == "evidence":
                offsets[j] += np.sum(np.log(np.diag(lower)))
        # (15) weighs the squares by 1, a log density by 1/2.
        weight = 1.0 if selection == "cost" else 0.5
        self._whitening = np.sqrt(weight) * whitening.reshape(-1, size)
        self._whitened = np.einsum(
            "jab,jb->ja", self._whitening.reshape(whitening.shape), expected
        )
        self._expected = expected
        self._offsets = offsets

    def map(self, values: ArrayLike) -> Mapping:
        """Map observed values, shape (m,), to weights."""
        y = self._checked(values)
        z = (self._whitening @ y).reshape(self._whitened.shape) - self._whitened
        costs = np.einsum("ja,ja->j", z, z) + self._offsets
        j = int(np.argmin(costs))
        return Mapping(
            weights=self._means[j] + self._gains[j] @ (y - self._expected[j]),
            component=j,
            costs=costs,
        )

    def map_many(
        self, values: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """Map observations, shape (S, m), each on its own.

        Returns
        -------
        weights : ndarray, shape (S, D*T)
        components : ndarray, shape (S,)
        costs : ndarray, shape (S, M)
        """
        y = as_floats(values, "the observations")
        if y.ndim != 2 or y.shape[1] != self.size:
            raise SkillError(
                f"the observations have shape {y.shape}; expected (S, {self.size})."
            )
        if not all_finite(y):
            raise SkillError("the observations hold NaN or infinite values.")
        z = (y @ self._whitening.T).reshape(-1, *self._whitened.shape) - self._whitened
        costs = np.einsum("sja,sja->sj", z, z) + self._offsets
        components = np.argmin(costs, axis=1)
        weights = np.empty((len(y), self._means.shape[1]))
        for j in np.unique(components):
            of_j = components == j
            delta = y[of_j] - self._expected[j]
            weights[of_j] = self._means[j] + delta @ self._gains[j].T
        return weights, components, costs

    def _checked(self, values: ArrayLike) -> NDArray[np.float64]:
        y = as_floats(values, "the observation")
        if y.shape != (self.size,):
            raise SkillError(
                f"the observation has shape {y.shape}; expected ({self.size},)."
            )
        if not all_finite(y):
            raise SkillError("the observation holds NaN or infinite values.")
        return y

    def candidates(self, values: ArrayLike) -> NDArray[np.float64]:
        """Return the candidate weights (14) of every component, shape (M, D*T)."""
        delta = self._checked(values) - self._expected
        out: NDArray[np.float64] = self._means + np.einsum(
            "jna,ja->jn", self._gains, delta
        )
        return out
