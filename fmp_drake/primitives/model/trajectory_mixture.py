"""A distribution of trajectories: densities, samples, mapping, prediction."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, DensityMixin
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import SkillError
from fmp_drake.numeric import as_floats, check_number, finite_array
from fmp_drake.primitives.data.windows import Windows, as_windows
from fmp_drake.primitives.model.basis import FourierBasis
from fmp_drake.primitives.model.keypoint import (
    Keypoint,
    channel_indices,
    stack_keypoints,
)
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.mapping import Mapping, MappingPlan, Selection
from fmp_drake.primitives.model.mixture import log_densities
from fmp_drake.primitives.model.phase.phase_model import PhaseModel
from fmp_drake.primitives.model.prediction import Prediction, PredictionPlan
from fmp_drake.primitives.model.recent import Recent


class TrajectoryMixture(DensityMixin, BaseEstimator):  # type: ignore[misc]
    """What a fitted skill can do: a Gaussian mixture over the weights of windows.

    The base of `FourierMovementPrimitive`, which learns it and says what its parameters
    and attributes are.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import FourierMovementPrimitive
    >>> windows = np.random.default_rng(0).standard_normal((40, 24, 2))
    >>> skill = FourierMovementPrimitive(n_steps=24).fit(windows)
    >>> isinstance(skill, TrajectoryMixture), skill.sample(3).shape
    (True, (3, 24, 2))
    """

    n_steps: int
    stride: int | None
    rate: float
    overlap: int
    tolerance: float
    selection: Selection
    proportions_: NDArray[np.float64]
    components_: tuple[LowRankGaussian, ...]
    phase_model_: PhaseModel | None
    scales_: NDArray[np.float64]
    n_channels_: int
    channels_: tuple[str, ...]

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
        """Draw trajectories of one window, shape (n, T, D).

        From the mixture; or from the phase model itself, whose Gaussians only
        approximate it: a phase that strays leaves their straight directions.

        Parameters
        ----------
        n : int
        seed : int
        with_noise : bool
            Add the white noise of the components, which no robot should follow. The
            phase model has none.
        """
        self.check_fitted()
        for name, value in (("n", n), ("seed", seed)):
            check_number(value, name, least=0, most=2**31 - 1, whole=True)
        rng = np.random.default_rng(seed)
        counts = rng.multinomial(n, self.proportions_ / self.proportions_.sum())
        parts: list[NDArray[np.float64]] = []
        for j, size in enumerate(counts):
            if self.phase_model_ is None:
                drawn = self.components_[j].sample(rng, size, with_noise=with_noise)
            else:
                drawn = np.sum(self.draw(j, rng, int(size)), axis=0)
            parts.append(drawn)
        return self.synthesize(rng.permutation(np.concatenate(parts)))

    def draw(
        self,
        component: int,
        rng: np.random.Generator,
        size: int = 1,
        *,
        past: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw weights of windows that belong to a component, without its white noise.

        Parameters
        ----------
        component : int
        rng : numpy.random.Generator
        size : int
        past : ndarray, shape (K, D), optional
            The first samples of a window, from whose phase and tempo a sample of the
            phase model goes on.

        Returns
        -------
        centre, deviation : ndarray, shape (size, D*T)
            Two parts to be added: the mean, or of a phase model the cycle at a tempo that
            varies, and how the sample differs from it.
        """
        self.check_fitted()
        gaussian = self.components_[component]
        if self.phase_model_ is None:
            drawn = gaussian.sample(rng, size, with_noise=False)
            centre = np.broadcast_to(gaussian.mean, drawn.shape)
            return centre, drawn - gaussian.mean
        seen = None if past is None else past / self.scales_
        parts = self.phase_model_.draw(rng, component, size, self.n_steps, past=seen)
        return self.basis.analyze(parts[0]), self.basis.analyze(parts[1])

    def expected(
        self, component: int, past: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the weights (D*T,) to which a window of a component leads.

        Those of the component's mean; of a phase model those of the cycle that goes on
        from the phase and tempo of the first samples, `past` (K, D). The mean over windows
        whose phases spread is smaller than each of them: right where it predicts, wrong
        where it is played.
        """
        if self.phase_model_ is None:
            return self.components_[component].mean
        window = self.phase_model_.expected(
            component, self.n_steps, past=past / self.scales_
        )
        return self.basis.analyze(window)

    @property
    def period_(self) -> float:
        """Mean period of the movement, s.

        Raises
        ------
        SkillError
            Where the skill has no phase model.
        """
        return self._with_phase().period / self.rate

    @property
    def tempos_(self) -> NDArray[np.float64]:
        """Tempo of each demonstrated cycle, 1 is the mean, shape (C,)."""
        model = self._with_phase()
        return model.period / model.history.lengths

    @property
    def amplitudes_(self) -> NDArray[np.float64]:
        """Size of each demonstrated cycle, 1 is the mean cycle's, shape (C,)."""
        return self._with_phase().history.amplitudes

    def phase(self, values: ArrayLike) -> NDArray[np.float64]:
        """Return the phase of consecutive samples of the movement, shape (n,).

        It is unwrapped: it grows by 2 pi in every cycle. The same phase is the same
        place in the cycle, in all recordings.

        Parameters
        ----------
        values : array_like, shape (n, D)
            At the skill's rate, at least 2 samples.

        Raises
        ------
        SkillError
            Where the skill has no phase model.
        """
        model = self._with_phase()
        y = finite_array(values, "the values", ("n", self.n_channels_))
        check_number(len(y), "the number of samples", least=2, whole=True)
        return model.phase(y / self.scales_)

    def _with_phase(self) -> PhaseModel:
        self.check_fitted()
        if self.phase_model_ is None:
            raise SkillError(
                "the skill is a mixture, which knows no phase; learn it with "
                "model='phase' or 'automatic' from four cycles or more."
            )
        return self.phase_model_

    def predict(self, values: ArrayLike, horizon: int) -> Prediction:
        """Return how a movement goes on, and how sure that is.

        Parameters
        ----------
        values : array_like, shape (n, D)
            Observed at consecutive steps. The last K, the skill's `overlap`, count.
        horizon : int
            Samples to predict, at most T - K.

        Returns
        -------
        Prediction
            The mean over all components, weighted by their evidence. To predict often,
            make a `PredictionPlan` once.
        """
        return PredictionPlan(self, horizon).predict(values)

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
            For observations of shape (K*C,), ordered as (K, C) flattened. The last
            three are kept: players of one skill share theirs.
        """
        rows = self.observation_rows(steps, channels=channels, derivative=derivative)
        if tolerance is None:
            index = channel_indices(channels, self.channels_)
            tolerance = np.tile(self._tolerances()[index], np.size(steps))
        arrays = (rows, as_floats(tolerance, "the tolerance"), self.proportions_)
        key = (self.components_, self.selection, *(a.tobytes() for a in arrays))
        return self._plans.get(key, lambda: self._plan(rows, tolerance))

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

    @cached_property
    def _plans(self) -> Recent[MappingPlan]:
        return Recent(3)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out of copies what follows from the rest."""
        state = super().__getstate__()
        return {k: v for k, v in state.items() if k not in ("_basis", "_plans")}

    @property
    def window_stride(self) -> int:
        """Samples between the starts of two windows: `stride`, or its default."""
        return max(1, self.n_steps // 60) if self.stride is None else self.stride

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self, "components_")

    def _windows(self, X: Any, *, at_least: int) -> Windows:
        return as_windows(
            X,
            n_steps=self.n_steps,
            stride=self.window_stride,
            rate=self.rate,
            at_least=at_least,
        )
