"""The Fourier movement primitive: learning, sampling, mapping."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import DemonstrationError, SkillError
from fmp_drake.primitives.basis import FourierBasis
from fmp_drake.primitives.demonstration import Demonstration
from fmp_drake.primitives.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.mapping import Mapping, MappingPlan, Selection
from fmp_drake.primitives.mixture import fit_mixture, log_densities
from fmp_drake.primitives.windows import demonstration_windows


class FourierMovementPrimitive(BaseEstimator):  # type: ignore[misc]
    """A rhythmic skill, learned from demonstrations that need no preparation.

    Demonstrations are cut into overlapping windows; the Fourier weights of the windows
    follow a Gaussian mixture (section IV of the paper).

    Parameters
    ----------
    n_steps : int
        T, samples in a window: enough for one or more periods.
    stride : int
        Samples between the starts of two windows.
    rate : float
        Samples per second (Hz); demonstrations are resampled to it.
    n_components : int
        M, Gaussians in the mixture.
    overlap : int
        K, samples that two consecutive windows share when a skill is played.
    explained_variance : float
        Share of the windows' variance that the components model in full; the
        rest is isotropic.
    regularization : float
        Variance added to every weight (m^2 for a position); 1e-8 is 0.1 mm per sample.
    tolerance : float
        lambda of (13).
    selection : {"cost", "evidence"}
        How a mapping chooses its component: (15), or the evidence.
    random_state : int
        Seed of the k-means initialisation.

    Attributes
    ----------
    proportions_ : ndarray, shape (M,)
        The pi_j of (9), falling.
    components_ : tuple of LowRankGaussian
        The Gaussians of (9) over the D*T weights.
    n_channels_ : int
        D.
    n_windows_ : int
        N, the windows learned from.
    extent_ : ndarray, shape (2, D)
        Least and greatest value of each channel in the demonstrations.
    channels_, units_ : tuple of str
    frame_ : str
        Of the demonstrations.
    """

    def __init__(
        self,
        *,
        n_steps: int = 120,
        stride: int = 10,
        rate: float = 20.0,
        n_components: int = 10,
        overlap: int = 10,
        explained_variance: float = 0.9999,
        regularization: float = 1e-8,
        tolerance: float = 1e-8,
        selection: Selection = "cost",
        random_state: int = 0,
    ) -> None:
        self.n_steps = n_steps
        self.stride = stride
        self.rate = rate
        self.n_components = n_components
        self.overlap = overlap
        self.explained_variance = explained_variance
        self.regularization = regularization
        self.tolerance = tolerance
        self.selection = selection
        self.random_state = random_state

    def fit(
        self,
        X: Demonstration | Sequence[Demonstration] | ArrayLike,
        y: object = None,  # noqa: ARG002 - scikit-learn's signature
    ) -> Self:
        """Learn from demonstrations, or from windows of shape (N, T, D).

        Raises
        ------
        DemonstrationError
            Where the demonstrations cannot be used or are too short.
        SkillError
            Where a parameter is out of range.
        """
        self.check_parameters()
        windows, example = self._windows(X)
        weights = self.basis.analyze(windows)
        self.proportions_, self.components_ = fit_mixture(
            weights,
            n_components=self.n_components,
            explained_variance=self.explained_variance,
            regularization=self.regularization,
            seed=self.random_state,
        )
        self.n_windows_ = len(windows)
        self.n_channels_ = windows.shape[2]
        self.extent_ = np.stack([windows.min(axis=(0, 1)), windows.max(axis=(0, 1))])
        self.channels_ = example.channels
        self.units_ = example.units
        self.frame_ = example.frame
        return self

    def score_samples(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the log density of windows (N, T, D), shape (N,).

        The real weights are an isometry of the samples, so this is a density
        over trajectories, in units^-(T*D).
        """
        self.check_fitted()
        windows, _ = self._windows(X, at_least=1)
        return log_densities(
            self.basis.analyze(windows), self.proportions_, self.components_
        )

    def score(self, X: ArrayLike, y: object = None) -> float:  # noqa: ARG002
        """Return the mean log density per sample (time step) of windows."""
        return float(np.mean(self.score_samples(X))) / self.n_steps

    def sample(
        self, n: int = 1, *, seed: int = 0, with_noise: bool = True
    ) -> NDArray[np.float64]:
        """Draw trajectories, shape (n, T, D)."""
        self.check_fitted()
        rng = np.random.default_rng(seed)
        counts = rng.multinomial(n, self.proportions_ / self.proportions_.sum())
        weights = np.concatenate(
            [
                component.sample(rng, size, with_noise=with_noise)
                for component, size in zip(self.components_, counts, strict=True)
                if size
            ]
            or [np.empty((0, self.components_[0].dim))]
        )
        return self.basis.synthesize(rng.permutation(weights))

    def observation_rows(
        self, steps: ArrayLike, *, derivative: int = 0
    ) -> NDArray[np.float64]:
        """Return Phi^D (20) of some steps, shape (len(steps) * D, D*T).

        Ordered like values of shape (steps, D) flattened: all channels of the first
        step, then of the second. Derivatives are per second.
        """
        self.check_fitted()
        rows = self.basis.rows(np.atleast_1d(steps), derivative)
        rows = rows * self.rate**derivative
        d = self.n_channels_
        out = np.einsum("kt,cd->kcdt", rows, np.eye(d))
        return out.reshape(len(rows) * d, d * self.n_steps)

    def mapping_plan(self, steps: ArrayLike) -> MappingPlan:
        """Prepare Algorithm 1 for positions observed at fixed steps."""
        return MappingPlan(
            self.proportions_,
            self.components_,
            rows=self.observation_rows(steps),
            tolerance=self.tolerance,
            selection=self.selection,
        )

    def map_partial(self, values: ArrayLike, *, first_step: int = 0) -> Mapping:
        """Map a partial trajectory (K, D) to weights (Algorithm 1).

        Parameters
        ----------
        values : array_like, shape (K, D)
            Observed values at K consecutive steps.
        first_step : int
            The step of the first.
        """
        self.check_fitted()
        y = np.asarray(values, dtype=float)
        last = self.n_steps - first_step
        if y.ndim != 2 or y.shape[1] != self.n_channels_ or not 1 <= len(y) <= last:
            raise SkillError(
                f"the partial trajectory has shape {y.shape}; expected (1 to {last}, "
                f"{self.n_channels_})."
            )
        if not np.all(np.isfinite(y)):
            raise SkillError("the partial trajectory holds NaN or infinite values.")
        plan = self.mapping_plan(first_step + np.arange(len(y)))
        return plan.map(y.ravel())

    def covariance(self, component: int, step: float) -> NDArray[np.float64]:
        """Return the covariance (18) of a component's value, shape (D, D)."""
        gaussian: LowRankGaussian = self.components_[component]
        row = self.basis.local_rows(step)[0]
        factor = gaussian.basis.reshape(self.n_channels_, self.n_steps, -1)
        factor = np.tensordot(row, factor, axes=(0, 1))
        noise = gaussian.noise * (row @ row) * np.eye(self.n_channels_)
        out: NDArray[np.float64] = (factor * gaussian.variances) @ factor.T + noise
        return out

    @property
    def basis(self) -> FourierBasis:
        """The Fourier basis of a window."""
        if self._basis.n_steps != self.n_steps:
            self.__dict__.pop("_basis")
        return self._basis

    @cached_property
    def _basis(self) -> FourierBasis:
        return FourierBasis(self.n_steps)

    def __getstate__(self) -> dict[str, Any]:
        """Leave the basis out of copies: it follows from the parameters."""
        state = dict(super().__getstate__())
        state.pop("_basis", None)
        return state

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self, "components_")

    def check_parameters(self) -> None:
        """Raise SkillError where a parameter is out of range."""
        k, t = self.overlap, self.n_steps
        for name, allowed, fine in (
            ("n_steps", "at least 8", t >= 8),
            ("stride", "at least 1", self.stride >= 1),
            ("rate", "positive", np.isfinite(self.rate) and self.rate > 0),
            ("n_components", "at least 1", self.n_components >= 1),
            ("overlap", f"from 2 to n_steps / 2 = {t // 2}", 2 <= k <= t // 2),
            ("explained_variance", "in (0, 1]", 0 < self.explained_variance <= 1),
            ("regularization", "positive", self.regularization > 0),
            ("tolerance", "positive", self.tolerance > 0),
            (
                "selection",
                "'cost' or 'evidence'",
                self.selection in ("cost", "evidence"),
            ),
        ):
            if not fine:
                raise SkillError(
                    f"{name} is {getattr(self, name)!r}; it must be {allowed}."
                )

    def _windows(
        self, X: Any, *, at_least: int = 2
    ) -> tuple[NDArray[np.float64], Demonstration]:
        """Return windows (N, T, D) and a demonstration that names the channels."""
        if isinstance(X, Demonstration):
            X = [X]
        is_list = isinstance(X, Sequence) and not isinstance(X, str)
        if is_list and all(isinstance(d, Demonstration) for d in X):
            windows = demonstration_windows(
                X,
                n_steps=self.n_steps,
                stride=self.stride,
                rate=self.rate,
                at_least=at_least,
            )
            return windows, X[0]
        try:
            windows = np.asarray(X, dtype=float)
        except (TypeError, ValueError):
            raise DemonstrationError(
                f"{type(X).__name__} cannot be learned from; give a Demonstration, a "
                "list of them, or windows (windows, n_steps, channels)."
            ) from None
        if windows.ndim != 3 or windows.shape[1] != self.n_steps:
            raise DemonstrationError(
                f"the windows have shape {windows.shape}; expected (windows, "
                f"n_steps = {self.n_steps}, channels)."
            )
        if len(windows) < at_least:
            raise DemonstrationError(
                f"there are {len(windows)} windows; at least {at_least} are needed."
            )
        flat = windows.reshape(len(windows) * self.n_steps, windows.shape[2])
        time = np.arange(len(flat)) / self.rate
        return windows, Demonstration(time=time, values=flat)
