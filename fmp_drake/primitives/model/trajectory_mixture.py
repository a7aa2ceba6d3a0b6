"""Gaussian mixture over trajectories: densities, samples, mapping, prediction."""

import reprlib
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp
from sklearn.base import BaseEstimator, DensityMixin
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import NoPhaseError, SkillError
from fmp_drake.numeric import Array, as_floats, check_number, finite_array
from fmp_drake.primitives.data.channels import channel_indices
from fmp_drake.primitives.data.windows import Windows, as_windows
from fmp_drake.primitives.model.basis import FourierBasis
from fmp_drake.primitives.model.low_rank_gaussian import (
    LowRankGaussian,
    wide_gaussian,
)
from fmp_drake.primitives.model.mapping import (
    Keypoint,
    LruCache,
    Mapping,
    MappingPlan,
)
from fmp_drake.primitives.model.phase.calibration import Calibration, variance_factor
from fmp_drake.primitives.model.phase.phase_model import PhaseModel
from fmp_drake.primitives.model.prediction import (
    Conditioning,
    Extrapolation,
    Prediction,
    Replay,
    SimilarWindows,
)


class TrajectoryMixture(DensityMixin, BaseEstimator):  # type: ignore[misc]
    """Fitted Gaussian mixture over the Fourier weights of windows.

    The base class of `FourierMovementPrimitive`, which learns it and documents the
    parameters and attributes.

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
    proportions_: Array
    components_: tuple[LowRankGaussian, ...]
    phase_model_: PhaseModel | None
    calibration_: Calibration | None
    memory_: tuple[Array, ...]
    scales_: Array
    n_channels_: int
    channels_: tuple[str, ...]

    def analyze(self, windows: ArrayLike) -> Array:
        """Return the Fourier weights (..., D*T) of windows of samples (..., T, D)."""
        check_is_fitted(self, "scales_")
        shape = ("...", self.n_steps, self.n_channels_)
        return self.basis.analyze(
            as_floats(windows, "the windows", shape) / self.scales_
        )

    def synthesize(self, weights: ArrayLike) -> Array:
        """Return the windows of samples (..., T, D) with Fourier weights (..., D*T)."""
        check_is_fitted(self, "scales_")
        shape = ("...", self.n_channels_ * self.n_steps)
        return (
            self.basis.synthesize(as_floats(weights, "the weights", shape))
            * self.scales_
        )

    def score_samples(self, X: Any) -> Array:
        """Return the log density of windows (N, T, D), shape (N,).

        The real weights are an isometry of the samples, so this is a density over
        trajectories, in units^-(T*D). It contains a broad background, so that it does
        not vanish for a new kind of movement. A mixture with a requested model or
        number of components has no background.
        """
        self.check_fitted()
        weights = self.analyze(self._windows(X, at_least=1).values)
        logs = np.stack([c.log_density(weights) for c in self.components_], axis=-1)
        out = logsumexp(logs + np.log(self.proportions_), axis=-1)
        calibration = self.calibration_
        if calibration is not None and calibration.background_weight > 0:
            background = self._cache.get(
                ("background", self.components_),
                lambda: wide_gaussian(self.proportions_, self.components_),
            )
            fraction = calibration.background_weight
            out = np.logaddexp(
                np.log1p(-fraction) + out,
                np.log(fraction) + background.log_density(weights),
            )
        stretch = self.n_steps * float(np.sum(np.log(self.scales_)))
        return out - stretch

    def score(self, X: Any, y: object = None) -> float:  # noqa: ARG002
        """Return the mean log density per sample (time step) of windows."""
        return float(np.mean(self.score_samples(X))) / self.n_steps

    def sample(self, n: int = 1, *, seed: int = 0, with_noise: bool = True) -> Array:
        """Draw trajectories of one window, shape (n, T, D).

        They are drawn from the phase model itself where there is one: its Gaussians are
        linear in the phase noise and only approximate it.

        Parameters
        ----------
        n : int
        seed : int
        with_noise : bool
            Add the white noise of the components, which a robot should not follow. The
            phase model has none.
        """
        self.check_fitted()
        for name, value in (("n", n), ("seed", seed)):
            check_number(value, name, least=0, most=2**31 - 1, whole=True)
        return np.sum(self.draw_windows(n, seed=seed, with_noise=with_noise), axis=0)

    def draw_windows(
        self, n: int, *, seed: int = 0, with_noise: bool = False
    ) -> tuple[Array, Array]:
        """Draw trajectories of one window as two summands.

        Parameters
        ----------
        n : int
        seed : int
        with_noise : bool
            As for `sample`.

        Returns
        -------
        centre, deviation : ndarray, shape (n, T, D)
            As for `draw`.
        """
        rng = np.random.default_rng(seed)
        counts = rng.multinomial(n, self.proportions_ / self.proportions_.sum())
        drawn = [
            self.draw(j, rng, int(size), with_noise=with_noise)
            for j, size in enumerate(counts)
        ]
        order = rng.permutation(n)
        centre, deviation = map(np.concatenate, zip(*drawn, strict=True))
        return self.synthesize(centre[order]), self.synthesize(deviation[order])

    def draw(
        self,
        component: int,
        rng: np.random.Generator,
        size: int = 1,
        *,
        past: Array | None = None,
        with_noise: bool = False,
    ) -> tuple[Array, Array]:
        """Draw weights of windows of a component.

        Parameters
        ----------
        component : int
        rng : numpy.random.Generator
        size : int
        past : ndarray, shape (K, D), optional
            The first samples of a window, which a sample of the phase model continues.
        with_noise : bool
            As for `sample`.

        Returns
        -------
        centre, deviation : ndarray, shape (size, D*T)
            Two parts that add up: the mean (with a phase model, the cycle at a random
            phase velocity), and the deviation from it.
        """
        self.check_fitted()
        gaussian = self.components_[component]
        if self.phase_model_ is None:
            drawn = gaussian.sample(rng, size, with_noise=with_noise)
            centre = np.broadcast_to(gaussian.mean, drawn.shape)
            return centre, drawn - gaussian.mean
        scaled_past = None if past is None else past / self.scales_
        parts = self.phase_model_.draw(
            rng, component, size, self.n_steps, past=scaled_past
        )
        return self.basis.analyze(parts[0]), self.basis.analyze(parts[1])

    def expected(self, component: int, past: Array) -> Array:
        """Return the weights (D*T,) that a playback of a component tracks.

        They are the component's mean; with a phase model, those of the cycle that continues
        the first samples, `past` (K, D). The mean of windows whose phases spread is smaller
        than each window: right for a prediction, wrong for a playback.
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
            If the skill has no phase model.
        """
        return self._with_phase().period / self.rate

    @property
    def tempos_(self) -> Array:
        """Tempo of each demonstrated cycle relative to the mean, shape (C,)."""
        model = self._with_phase()
        return model.period / model.history.lengths

    @property
    def amplitudes_(self) -> Array:
        """Size of each demonstrated cycle relative to the mean cycle, shape (C,)."""
        return self._with_phase().history.amplitudes

    def phase(self, values: ArrayLike) -> Array:
        """Return the unwrapped phase of consecutive samples of the movement, shape (n,).

        It grows by 2 pi in every cycle. The same phase is the same place in the cycle in
        all recordings.

        Parameters
        ----------
        values : array_like, shape (n, D)
            At the skill's rate, at least 2 samples.

        Raises
        ------
        SkillError
            If the skill has no phase model.
        """
        model = self._with_phase()
        y = finite_array(values, "the values", ("n", self.n_channels_))
        check_number(len(y), "the number of samples", least=2, whole=True)
        return model.phase(y / self.scales_)

    def _with_phase(self) -> PhaseModel:
        self.check_fitted()
        if self.phase_model_ is None:
            raise NoPhaseError(
                "the skill is a mixture, which has no phase; learn it with "
                "model='phase' or 'automatic' from about 1.5 cycles on."
            )
        return self.phase_model_

    def predict(self, values: ArrayLike, horizon: int) -> Prediction:
        """Predict the next samples of a movement, with covariances.

        Parameters
        ----------
        values : array_like, shape (n, D)
            Observed at consecutive steps. The last K, the skill's `overlap`, are used.
        horizon : int
            Samples to predict, at most T - K.

        Returns
        -------
        Prediction
            The mean over all components, weighted by their evidence. To predict often,
            make one `PredictionPlan`.
        """
        return PredictionPlan(self, horizon).predict(values)

    def infer(self, values: ArrayLike, channels: Sequence[str | int]) -> Prediction:
        """Infer the other channels of a movement from observed ones, with covariances.

        The components are averaged by their evidence. Far from its reference step a
        component of a phase model is not accurate, so each sample is inferred from the
        observations near it. Where a movement of few windows does not repeat, the recorded
        windows whose observed channels are similar take the place of the components.

        Parameters
        ----------
        values : array_like, shape (n, C)
            Consecutive samples of the observed channels.
        channels : sequence of str or int
            The C observed channels.

        Returns
        -------
        Prediction
            The n samples of the D - C other channels, in their order.

        Raises
        ------
        SkillError
            If the channels are not some of the skill's, or the values do not fit them.
        """
        self.check_fitted()
        observed_channels = channel_indices(channels, self.channels_)
        inferred_channels = [
            i for i in range(self.n_channels_) if i not in observed_channels
        ]
        if not inferred_channels:
            raise SkillError("all channels are observed; leave out those to infer.")
        y = finite_array(values, "the values", ("n", len(observed_channels)))
        n = len(y)
        span = min(n, self.overlap, self.n_steps)
        model, factor, variances = self._inference(
            observed_channels, inferred_channels, span
        )
        y = y / self.scales_[observed_channels]
        mean = np.empty((n, len(inferred_channels)))
        covariances = np.empty((n, len(inferred_channels), len(inferred_channels)))
        # The middle of each window; the first and the last one also up to their ends.
        first, margin = 0, span // 4
        while True:
            last = first + span >= n
            first = min(first, n - span)
            inferred = model.predict(y[first : first + span])
            of = slice(0 if first == 0 else margin, span if last else span - margin)
            mean[first:][of], covariances[first:][of] = inferred[0][of], inferred[1][of]
            if last:
                break
            first += max(1, span - 2 * margin)
        scales = self.scales_[inferred_channels]
        covariances = factor * covariances + np.diag(variances)
        return Prediction(
            values=mean * scales,
            covariances=covariances * np.outer(scales, scales),
            degrees_of_freedom=getattr(self.calibration_, "degrees_of_freedom", None),
        )

    def _inference(
        self, observed: list[int], inferred: list[int], span: int
    ) -> tuple[Conditioning | SimilarWindows, float, Array]:
        """Return a model of scaled channels, given others at the same `span` samples.

        Also return the factor of its covariances and variances (I,) to be added to them.
        """
        factor, variances = 1.0, np.zeros(len(inferred))
        if self.phase_model_ is not None:
            # Observed samples are not calibrated; the variances of few cycles are too
            # small.
            factor = variance_factor(max(self.phase_model_.cycles, 1))
        elif recordings := [y / self.scales_ for y in self.paths_ if len(y) >= span]:
            similar = SimilarWindows(recordings, observed, inferred, span)
            if self.memory_:
                # A mixture of so few windows does not predict, either.
                return similar, factor, variances
            variances = similar.error_variances
        rows = [
            self.observation_rows(np.arange(span), channels=index)
            / np.tile(self.scales_[index], span)[:, None]
            for index in (observed, inferred)
        ]
        parts = [c.marginal(np.concatenate(rows)) for c in self.components_]
        conditioning = Conditioning(
            self.proportions_,
            np.stack([mean for mean, _ in parts]),
            np.stack([covariance for _, covariance in parts]),
            noise=np.full(span * len(observed), self.tolerance),
            channels=len(inferred),
        )
        return conditioning, factor, variances

    def observation_rows(
        self,
        steps: ArrayLike,
        *,
        channels: Sequence[str | int] | None = None,
        derivative: int = 0,
    ) -> Array:
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
            three plans are cached: players of one skill share theirs.
        """
        rows = self.observation_rows(steps, channels=channels, derivative=derivative)
        if tolerance is None:
            index = channel_indices(channels, self.channels_)
            tolerance = np.tile(self._tolerances()[index], np.size(steps))
        arrays = (rows, as_floats(tolerance, "the tolerance"), self.proportions_)
        key = (self.components_, *(a.tobytes() for a in arrays))
        return self._cache.get(key, lambda: self._plan(rows, tolerance))

    def _plan(self, rows: Array, tolerance: ArrayLike) -> MappingPlan:
        return MappingPlan(
            self.proportions_,
            self.components_,
            rows=rows,
            tolerance=tolerance,
        )

    def map_keypoints(self, keypoints: Sequence[Keypoint]) -> Mapping:
        """Return the weights whose trajectory passes the keypoints (Algorithm 1).

        The keypoints may be at any steps, of any channels and derivatives.

        Raises
        ------
        SkillError
            If a keypoint does not fit the skill, or there is none.
        """
        self.check_fitted()
        if not isinstance(keypoints, Sequence) or not all(
            isinstance(point, Keypoint) for point in keypoints
        ):
            raise SkillError(f"{keypoints!r} is not a list of Keypoint; give one.")
        if not keypoints:
            raise SkillError("there is no keypoint; give at least one.")
        rows, values, tolerances = [], [], []
        for point in keypoints:
            check_number(point.step, "the step of a keypoint")
            name = f"of the keypoint at step {point.step:g}"
            index = channel_indices(point.channels, self.channels_)
            rows.append(
                self.observation_rows(
                    point.step, channels=index, derivative=point.derivative
                )
            )
            shape = (len(index),)
            values.append(finite_array(point.values, f"the values {name}", shape))
            allowed = self._tolerances()[index]
            if point.tolerance is not None:
                allowed = as_floats(point.tolerance, f"the tolerance {name}")
                if allowed.ndim == 0:
                    allowed = np.full(shape, allowed)
            tolerances.append(as_floats(allowed, f"the tolerance {name}", shape))
        plan = self._plan(np.concatenate(rows), np.concatenate(tolerances))
        return plan.map(np.concatenate(values))

    def _tolerances(self) -> Array:
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

    def covariance(self, component: int, step: float) -> Array:
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
        return (factor * gaussian.variances) @ factor.T + noise

    def predicted_covariance(self, component: int, step: float) -> Array:
        """Return the covariance (D, D) of the movement about a window that is played.

        It is (18) and, after the first K samples, the errors of playback. The components
        of a phase model contain those of predictions; with few cycles there are more,
        because `predict` also uses the observed samples for replay, and a window that is
        played does not.
        """
        out = self.covariance(component, step)
        calibration, is_mixture = self.calibration_, self.phase_model_ is None
        if calibration and (is_mixture or calibration.playback_covariances is not None):
            errors = calibration.playback_covariance(step - self.overlap + 1)
            out = out + errors * np.outer(self.scales_, self.scales_)
        return out

    @property
    def basis(self) -> FourierBasis:
        """The Fourier basis of a window."""
        return _basis(self.n_steps)

    @cached_property
    def _cache(self) -> LruCache[Any]:
        return LruCache(4)

    def __getstate__(self) -> dict[str, Any]:
        """Leave the cache out of copies."""
        state = super().__getstate__()
        return {name: value for name, value in state.items() if name != "_cache"}

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
            # A fitted skill has a rate, whether it was stated or not.
            rate=float(self.rate) if hasattr(self, "components_") else self.rate,
            at_least=at_least,
        )


class PredictionPlan:
    """Prediction from the last K samples of a movement, prepared for a skill.

    Each component is conditioned on the samples; the components are averaged by evidence.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    horizon : int
        Samples to predict, at most T - K.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import FourierMovementPrimitive
    >>> t = np.arange(1200) / 20
    >>> circles = np.stack([np.cos(2 * t), np.sin(2 * t)], axis=1)
    >>> windows = np.stack([circles[i : i + 120] for i in range(0, 1080, 5)])
    >>> skill = FourierMovementPrimitive(n_components=16).fit(windows)
    >>> prediction = PredictionPlan(skill, horizon=20).predict(circles[100:110])
    >>> bool(np.allclose(prediction.values, circles[110:130], atol=0.01))
    True
    """

    def __init__(self, skill: TrajectoryMixture, horizon: int) -> None:
        skill.check_fitted()
        k, d = skill.overlap, skill.n_channels_
        check_number(
            horizon, "the horizon", least=1, most=skill.n_steps - k, whole=True
        )
        calibration = skill.calibration_
        if calibration is not None:
            calibration = calibration.at(horizon)
        rows = skill.observation_rows(np.arange(k + horizon))
        parts = [component.marginal(rows) for component in skill.components_]
        self._conditioning = Conditioning(
            skill.proportions_,
            np.stack([mean for mean, _ in parts]),
            np.stack([covariance for _, covariance in parts]),
            noise=np.tile(skill.tolerance * skill.scales_**2, k),
            channels=d,
            spread=None if calibration is None else calibration.factors,
        )
        self._shape = (k, d)
        self._scales = skill.scales_
        self._calibration, self._replay = calibration, None
        self._has_phase = skill.phase_model_ is not None
        if skill.memory_:
            replay = Replay(skill.memory_, k, horizon)
            self._replay = replay if replay.is_possible else None
            self._extrapolation = Extrapolation(skill.memory_, k, horizon)

    def predict(self, values: ArrayLike) -> Prediction:
        """Predict the next samples after observed ones (n, D); the last K are used."""
        k, d = self._shape
        y = finite_array(values, "the observed samples", ("n", d))
        if len(y) < k:
            raise SkillError(
                f"{len(y)} samples were observed; a prediction needs the last {k}."
            )
        past, calibration = y[-k:], self._calibration
        if calibration is None:
            mean, covariances = self._conditioning.predict(past)
            return Prediction(values=mean, covariances=covariances)
        scales, squares = self._scales, np.outer(self._scales, self._scales)
        mean = np.zeros_like(calibration.error_covariances[:, 0])
        covariances = calibration.error_covariances
        if calibration.model_weight > 0:
            mean, covariances = self._conditioning.predict(past)
            mean, covariances = mean / scales, covariances / squares
            if not self._has_phase:
                # The components of a mixture are those of EM.
                covariances = covariances + calibration.error_covariances
        replay = self._replay
        if replay is not None:
            mean, covariances = calibration.combined(
                mean, covariances, replay.predict(past / scales), replay.variance
            )
            mean, covariances = self._extrapolation.blended(
                past / scales, mean, covariances
            )
        return Prediction(
            values=mean * scales,
            covariances=covariances * squares,
            degrees_of_freedom=calibration.degrees_of_freedom,
        )


@lru_cache(maxsize=4)
def _basis(n_steps: int) -> FourierBasis:
    """Return the basis that all skills with windows of this length share."""
    return FourierBasis(n_steps)


def check_skill(skill: Any, call: str) -> None:
    """Raise where the argument of a call is not a fitted skill.

    Raises
    ------
    SkillError
        Where it is something else.
    sklearn.exceptions.NotFittedError
        Where it is a skill before `fit`.
    """
    if not hasattr(skill, "check_fitted"):
        raise SkillError(
            f"{call} needs a skill, such as FourierMovementPrimitive().fit(demonstrations); "
            f"it is {reprlib.repr(skill)}."
        )
    skill.check_fitted()
