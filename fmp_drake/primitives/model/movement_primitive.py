"""The Fourier movement primitive: learning, sampling, mapping."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, DensityMixin
from sklearn.utils.validation import check_is_fitted

from fmp_drake.numeric import as_floats, check_number, finite_array
from fmp_drake.primitives.data.demonstration import Demonstration, default_channels
from fmp_drake.primitives.data.scaling import ChannelScales, channel_scales
from fmp_drake.primitives.data.windows import Windows, as_windows, weighted_windows
from fmp_drake.primitives.model.basis import FourierBasis
from fmp_drake.primitives.model.keypoint import (
    Keypoint,
    channel_indices,
    stack_keypoints,
)
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.mapping import Mapping, MappingPlan, Selection
from fmp_drake.primitives.model.mixture import Progress, fit_mixture, log_densities
from fmp_drake.primitives.model.parameters import check_parameters

# Section V of the paper.
PAPER_SETTINGS: dict[str, Any] = {"n_components": 10, "stride": 10, "shrinkage": 0.0}


class FourierMovementPrimitive(DensityMixin, BaseEstimator):  # type: ignore[misc]
    """A rhythmic skill, learned from demonstrations that need no preparation.

    Demonstrations are cut into overlapping windows; the Fourier weights of the windows
    follow a Gaussian mixture (section IV of the paper). What has been seen of a movement
    is mapped to weights of that mixture (Algorithm 1), which give its continuation; a
    `Player` plays the skill (Algorithm 2).

    The defaults are those that generalise: learned from 2 minutes of simulated hands
    that wipe, polish and draw an 8, they give the next minute a mean log-likelihood of
    17.0 nats per sample, `PAPER_SETTINGS` 6.7 (from 30 s: 15.5 against -771). Phase
    is an angle, so the weights lie near a closed curve: many components follow it,
    and shrinkage keeps their covariances from fitting the few windows of each.

    Parameters
    ----------
    n_steps : int
        T, samples in a window: enough for one or more periods.
    stride : int, optional
        Samples between the starts of two windows; a sixtieth of a window (2 samples of
        120) where None.
    rate : float
        Samples per second (Hz); demonstrations are resampled to it.
    n_components : int or "bic"
        M, Gaussians in the mixture; "bic" chooses by the Bayesian information
        criterion.
    overlap : int
        K, samples that two consecutive windows share when a skill is played.
    explained_variance : float
        Fraction of the windows' variance that the components model in full; what is
        left is isotropic.
    regularization : float
        Variance added to every weight (m^2 for a position); 1e-8 is 0.1 mm per sample.
    shrinkage : float
        Pseudo-counts (windows) of the covariance that all components share, mixed into
        each; 0 is the paper's plain EM.
    scales : "units" or array_like, shape (D,)
        What the values of a channel are divided by before anything else, so that
        metres, newtons and radians can live in one model. "units": 1 where all
        channels have the same unit, else the standard deviation of all channels
        of a unit. The regularization and the tolerance are in scaled units.
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
        The Gaussians of (9) over the D*T weights of the scaled values.
    scales_ : ndarray, shape (D,)
    n_channels_ : int
        D.
    n_windows_ : int
        N, the windows learned from.
    extent_ : ndarray, shape (2, D)
        Least and greatest value of each channel in the demonstrations.
    paths_ : tuple of ndarray, shape (samples, D)
        The demonstrations; empty where unknown, as for windows given as an array.
    channels_, units_ : tuple of str
    frame_ : str
        Of the demonstrations.
    rotation_reference_ : tuple of float or None
        Quaternion (x, y, z, w) of the rotation at which the channels `rx`, `ry`, `rz`
        are 0; None where the skill has no orientation.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0, 20, 0.05)
    >>> circles = 0.1 * np.column_stack([np.cos(2 * time), np.sin(2 * time)])
    >>> demonstration = Demonstration(time=time, values=circles)
    >>> skill = FourierMovementPrimitive(n_components=2).fit(demonstration)
    >>> mapping = skill.map_partial(circles[:10])  # half a second has been seen
    >>> future = skill.synthesize(mapping.weights)
    >>> bool(np.allclose(future, circles[:120], atol=1e-3))
    True
    """

    def __init__(
        self,
        *,
        n_steps: int = 120,
        stride: int | None = None,
        rate: float = 20.0,
        n_components: int | Literal["bic"] = 80,
        overlap: int = 10,
        explained_variance: float = 0.9999,
        regularization: float = 1e-8,
        shrinkage: float = 5.0,
        scales: ChannelScales = "units",
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
        self.shrinkage = shrinkage
        self.scales = scales
        self.tolerance = tolerance
        self.selection = selection
        self.random_state = random_state

    def fit(
        self,
        X: Demonstration | Sequence[Demonstration] | ArrayLike,
        y: object = None,  # noqa: ARG002 - scikit-learn's signature
        *,
        weights: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> Self:
        """Learn from demonstrations, or from windows of shape (N, T, D).

        Parameters
        ----------
        X : Demonstration, sequence of Demonstration, or array_like
            Demonstrations may differ in length.
        y : ignored
        weights : array_like, optional
            How much each demonstration (or window) counts, relative to the others; one
            of 0 is left out.
        progress : callable, optional
            Called with a sentence about each step of the fit.

        Raises
        ------
        DemonstrationError
            Where the demonstrations cannot be used or are too short.
        SkillError
            Where a parameter is out of range.
        """
        self.check_parameters()
        windows, counts = weighted_windows(self._windows(X, at_least=2), weights)
        values, example = windows.values, windows.example
        d = values.shape[2]
        self.n_windows_ = len(values)
        self.n_channels_ = d
        self.paths_ = windows.paths(self.window_stride)
        self.extent_ = np.stack([values.min(axis=(0, 1)), values.max(axis=(0, 1))])
        self.channels_ = example.channels if example else default_channels(d)
        self.units_ = example.units if example else ("m",) * d
        self.frame_ = example.frame if example else ""
        self.rotation_reference_ = example.rotation_reference if example else None
        self.scales_ = channel_scales(self.scales, values, self.units_)
        self.proportions_, self.components_ = fit_mixture(
            self.analyze(values),
            n_components=self.n_components,
            explained_variance=self.explained_variance,
            regularization=self.regularization,
            shrinkage=self.shrinkage,
            seed=self.random_state,
            sample_weights=counts,
            progress=progress,
        )
        return self

    def analyze(self, windows: ArrayLike) -> NDArray[np.float64]:
        """Return the Fourier weights (..., D*T) of windows of samples (..., T, D)."""
        check_is_fitted(self, "scales_")
        shape = ("...", self.n_steps, self.n_channels_)
        return self.basis.analyze(
            as_floats(windows, "the windows", shape) / self.scales_
        )

    def synthesize(self, weights: ArrayLike) -> NDArray[np.float64]:
        """Return the windows of samples (..., T, D) that have weights (..., D*T)."""
        check_is_fitted(self, "scales_")
        shape = ("...", self.n_channels_ * self.n_steps)
        return (
            self.basis.synthesize(as_floats(weights, "the weights", shape))
            * self.scales_
        )

    def score_samples(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the log density of windows (N, T, D), shape (N,).

        The real weights are an isometry of the samples, so this is a density
        over trajectories, in units^-(T*D).
        """
        self.check_fitted()
        weights = self.analyze(self._windows(X, at_least=1).values)
        stretch = self.n_steps * float(np.sum(np.log(self.scales_)))
        return log_densities(weights, self.proportions_, self.components_) - stretch

    def score(self, X: ArrayLike, y: object = None) -> float:  # noqa: ARG002
        """Return the mean log density per sample (time step) of windows."""
        return float(np.mean(self.score_samples(X))) / self.n_steps

    def sample(
        self, n: int = 1, *, seed: int = 0, with_noise: bool = True
    ) -> NDArray[np.float64]:
        """Draw trajectories of one window from the mixture, shape (n, T, D)."""
        self.check_fitted()
        for name, value in (("n", n), ("seed", seed)):
            check_number(value, name, least=0, most=2**31 - 1, whole=True)
        rng = np.random.default_rng(seed)
        counts = rng.multinomial(n, self.proportions_ / self.proportions_.sum())
        weights = np.concatenate(
            [
                component.sample(rng, size, with_noise=with_noise)
                for component, size in zip(self.components_, counts, strict=True)
            ]
        )
        return self.synthesize(rng.permutation(weights))

    def observation_rows(
        self,
        steps: ArrayLike,
        *,
        channels: Sequence[str | int] | None = None,
        derivative: int = 0,
    ) -> NDArray[np.float64]:
        """Return Phi^D (20): the matrix from weights to values at K steps, (K*C, D*T).

        Ordered like values of shape (steps, C) flattened: all C channels of the first
        step, then of the second. In the channels' units, derivatives per second.
        """
        self.check_fitted()
        times = as_floats(steps, "the steps", ("K",))
        rows = self.basis.rows(times, derivative)
        rows = rows * self.rate**derivative
        index = channel_indices(channels, self.channels_)
        out = np.zeros((len(rows), len(index), self.n_channels_, self.n_steps))
        for i, channel in enumerate(index):
            out[:, i, channel] = rows * self.scales_[channel]
        return out.reshape(len(rows) * len(index), -1)

    def mapping_plan(
        self,
        steps: ArrayLike,
        *,
        channels: Sequence[str | int] | None = None,
        derivative: int = 0,
        tolerance: ArrayLike | None = None,
    ) -> MappingPlan:
        """Prepare Algorithm 1 for values observed at fixed steps.

        Parameters
        ----------
        steps : array_like, shape (K,)
            Any times in samples, from 0 to T - 1.
        channels : sequence of str or int, optional
            The C observed ones; all where None.
        derivative : int
            Of the values: 1 for velocities.
        tolerance : array_like, shape () or (K*C,), optional
            lambda of (13), in squared units of the values; the skill's where None.

        Returns
        -------
        MappingPlan
            For observations of shape (K*C,), ordered as (K, C) flattened.
        """
        rows = self.observation_rows(steps, channels=channels, derivative=derivative)
        if tolerance is None:
            index = channel_indices(channels, self.channels_)
            tolerance = np.tile(self._tolerances()[index], np.size(steps))
        return self._plan(rows, tolerance)

    def _plan(self, rows: NDArray[np.float64], tolerance: ArrayLike) -> MappingPlan:
        return MappingPlan(
            self.proportions_,
            self.components_,
            rows=rows,
            tolerance=tolerance,
            selection=self.selection,
        )

    def map_keypoints(self, keypoints: Sequence[Keypoint]) -> Mapping:
        """Return the weights whose trajectory passes the keypoints (Algorithm 1).

        The keypoints may be at any steps, of any channels and derivatives.
        """
        self.check_fitted()
        rows, values, tolerances = stack_keypoints(
            keypoints,
            names=self.channels_,
            tolerance=self._tolerances(),
            rows_of=self.observation_rows,
        )
        return self._plan(rows, tolerances).map(values)

    def _tolerances(self) -> NDArray[np.float64]:
        """Return lambda of each channel, in its squared unit, shape (D,)."""
        return self.tolerance * self.scales_**2

    def map_partial(self, values: ArrayLike, *, first_step: int = 0) -> Mapping:
        """Return the weights whose trajectory begins like an observed one (Algorithm 1).

        Parameters
        ----------
        values : array_like, shape (K, D)
            Observed values at K consecutive steps.
        first_step : int
            The step of the first.
        """
        self.check_fitted()
        check_number(
            first_step, "first_step", least=0, most=self.n_steps - 1, whole=True
        )
        shape = ("K", self.n_channels_)
        y = finite_array(values, "the partial trajectory", shape)
        check_number(
            len(y), "the length of the trajectory", most=self.n_steps - first_step
        )
        plan = self.mapping_plan(first_step + np.arange(len(y)))
        return plan.map(y.ravel())

    def covariance(self, component: int, step: float) -> NDArray[np.float64]:
        """Return the covariance (18) of a component at a time in samples, (D, D)."""
        self.check_fitted()
        last = len(self.components_) - 1
        check_number(component, "component", least=0, most=last, whole=True)
        check_number(step, "step", least=0, most=self.n_steps - 1)
        gaussian: LowRankGaussian = self.components_[component]
        row = self.basis.local_rows(step)[0]
        factor = gaussian.basis.reshape(self.n_channels_, self.n_steps, gaussian.rank)
        factor = np.tensordot(row, factor, axes=(0, 1)) * self.scales_[:, None]
        noise = gaussian.noise * (row @ row) * np.diag(self.scales_**2)
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

    @property
    def window_stride(self) -> int:
        """Samples between the starts of two windows: `stride`, or its default."""
        return max(1, self.n_steps // 60) if self.stride is None else self.stride

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self, "components_")

    def check_parameters(self) -> None:
        """Raise SkillError where a parameter is out of range."""
        check_parameters(self.get_params())

    def _windows(self, X: Any, *, at_least: int) -> Windows:
        return as_windows(
            X,
            n_steps=self.n_steps,
            stride=self.window_stride,
            rate=self.rate,
            at_least=at_least,
        )
