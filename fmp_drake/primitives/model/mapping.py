"""Mapping of a partial trajectory to Fourier weights: Algorithm 1 of the paper."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky, solve_triangular

from fmp_drake.errors import SkillError
from fmp_drake.numeric import GREATEST, Array, as_floats, finite_array, one_blas_thread
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian


@dataclass(frozen=True, kw_only=True, eq=False)
class Keypoint:
    """Values of some channels that a movement has to pass at one step of a window.

    Attributes
    ----------
    step : float
        Time in samples from the start of the window, 0 to T - 1.
    values : array_like, shape (C,)
        Values of the C channels, in their units, per second^derivative.
    channels : sequence of str or int, optional
        Names or indices of the channels; all D where None.
    derivative : int
        0 for values, 1 for velocities, 2 for accelerations; at most 4.
    tolerance : float or array_like, shape (C,), optional
        lambda of (13), in squared units of the values; the skill's where None.

    Examples
    --------
    Through x = 0.1 m at step 40, upwards at 0.2 m/s in the middle of the window:

    >>> at = Keypoint(step=40, values=[0.1], channels=["x"])
    >>> fast = Keypoint(step=60, values=[0.2], channels=["z"], derivative=1)

    `FourierMovementPrimitive.map_keypoints` takes them.
    """

    step: float
    values: ArrayLike
    channels: Sequence[str | int] | None = None
    derivative: int = 0
    tolerance: ArrayLike | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Mapping:
    """Weights of the component that fits an observation best.

    Attributes
    ----------
    weights : ndarray, shape (D*T,)
        w_K of (16).
    component : int
        j* of (15).
    costs : ndarray, shape (M,)
        Cost of each component: (15) divided by lambda.

    Examples
    --------
    Of two components, the one that starts like the observation is chosen:

    >>> import numpy as np
    >>> components = tuple(
    ...     LowRankGaussian(
    ...         mean=np.full(2, m), basis=np.eye(2), variances=np.ones(2), noise=1e-6
    ...     )
    ...     for m in (0.0, 5.0)
    ... )
    >>> plan = MappingPlan(np.full(2, 0.5), components, rows=[[1.0, 0.0]])
    >>> mapping = plan.map([4.0])
    >>> mapping.component, mapping.weights.round(3)
    (1, array([4., 5.]))
    """

    weights: Array
    component: int
    costs: Array


class MappingPlan:
    """Algorithm 1, prepared for observations at the same steps of a window.

    It maps observed values to the Fourier weights of the component that fits best.
    Everything that does not depend on the values is computed once. By the matrix inversion
    lemma the candidate (14) of component j is::

        w_j = mu_j + Sigma_j Phi' S_j^-1 (y - Phi mu_j),
        S_j = Phi Sigma_j Phi' + lambda I,

    and the two quadratic terms of (15) add up to
    lambda (y - Phi mu_j)' S_j^-1 (y - Phi mu_j). Only systems of the size of the
    observation are solved, in the constructor; a mapping is two matrix products.

    Parameters
    ----------
    proportions : ndarray, shape (M,)
    components : sequence of LowRankGaussian
    rows : array_like, shape (m, D*T)
        Phi: maps the weights to the observation.
    tolerance : array_like, shape () or (m,)
        lambda of (13), in squared units of the observation, common or for each value.
        An observation with a smaller one is met more closely.

    Examples
    --------
    >>> import numpy as np
    >>> component = LowRankGaussian(
    ...     mean=np.zeros(4), basis=np.eye(4)[:, :2], variances=np.ones(2), noise=1e-6
    ... )
    >>> plan = MappingPlan(np.ones(1), (component,), rows=np.eye(4)[:1])
    >>> plan.map([2.0]).weights.round(3)
    array([2., 0., 0., 0.])
    """

    @one_blas_thread()
    def __init__(
        self,
        proportions: Array,
        components: tuple[LowRankGaussian, ...],
        *,
        rows: ArrayLike,
        tolerance: ArrayLike = 1e-8,
    ) -> None:
        phi = np.atleast_2d(as_floats(rows, "the rows"))
        phi = as_floats(phi, "the rows", ("m", components[0].dim))
        size = len(phi)
        lam = as_floats(tolerance, "the tolerance")
        if lam.ndim:
            lam = as_floats(lam, "the tolerance", (size,))
        lam = np.broadcast_to(lam, (size,))
        if not np.all((lam > 0) & (lam < GREATEST)):
            raise SkillError(
                f"the tolerances run from {np.min(lam)} to {np.max(lam)}; every one "
                "must be positive and finite."
            )
        self.size = size
        n_components = len(components)
        whitening = np.empty((n_components, size, size))
        self._gains = np.empty((n_components, phi.shape[1], size))
        self._means = np.stack([c.mean for c in components])
        expected = self._means @ phi.T
        for j, component in enumerate(components):
            cross = component.multiply(phi)
            cov = cross @ phi.T + np.diag(lam)
            try:
                lower = cholesky(cov, lower=True)
            except np.linalg.LinAlgError:
                raise SkillError(
                    "the observations depend on each other more closely than the "
                    f"tolerance of {np.min(lam):g} can tell; choose a greater one."
                ) from None
            whitening[j] = solve_triangular(lower, np.eye(size), lower=True)
            self._gains[j] = cross.T @ (whitening[j].T @ whitening[j])
        self._whitening = whitening.reshape(-1, size)
        self._whitened = np.einsum("jab,jb->ja", whitening, expected)
        self._expected = expected
        self._offsets = -np.log(proportions)

    def map(self, values: ArrayLike) -> Mapping:
        """Return the weights of the component that fits observed values (m,) best."""
        y = finite_array(values, "the observation", (self.size,))
        z = (self._whitening @ y).reshape(self._whitened.shape)
        z -= self._whitened
        costs = np.vecdot(z, z) + self._offsets
        j = int(np.argmin(costs))
        return Mapping(
            weights=self._means[j] + self._gains[j] @ (y - self._expected[j]),
            component=j,
            costs=costs,
        )


class LruCache[T]:
    """A small cache of the most recently used values, by their keys.

    Parameters
    ----------
    count : int
        Number of values to keep.

    Examples
    --------
    >>> squares = LruCache[int](2)
    >>> squares.get(3, lambda: 9), squares.get(3, lambda: 1 / 0)
    (9, 9)
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._values: dict[Hashable, T] = {}

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value of a key; make it where it is not in the cache."""
        # A dictionary keeps the order of insertion: the oldest value comes first.
        # Other threads may change it between two lines.
        value = self._values.pop(key, None)
        if value is None:
            value = make()
        self._values[key] = value
        for oldest in list(self._values)[: -self._count]:
            self._values.pop(oldest, None)
        return value
