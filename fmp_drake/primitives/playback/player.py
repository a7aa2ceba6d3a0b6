"""Playing a skill for any duration: Algorithm 2 and section V-D of the paper."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from fmp_drake.errors import SkillError
from fmp_drake.primitives.data.numeric import all_finite, as_floats, is_number, is_whole
from fmp_drake.primitives.model.mapping import MappingPlan
from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.polynomial_segment import PolynomialSegment
from fmp_drake.primitives.playback.segment import Segment, critically_damped
from fmp_drake.primitives.playback.segment_maker import SegmentMaker
from fmp_drake.primitives.playback.start_tolerance import start_variances
from fmp_drake.primitives.playback.tracking import LqrTracker, Tracker
from fmp_drake.primitives.playback.window_table import WindowTable

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive

# How closely the mapped weights meet the motion of a pushed robot, as a share of the
# movement's half width.
_PUSH_TOLERANCE = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class _Entry:
    """Weights (S, n), targets (S, n), components (S,), offsets (S, 2, D)."""

    weights: NDArray[np.float64]
    target: NDArray[np.float64]
    component: NDArray[np.int64]
    offset: NDArray[np.float64]


class Player:
    """Plays a fitted skill from any start, for as long as wanted.

    The start is mapped onto sample K - 1 of a window. From there the weights drift to
    their target while the window is played to its last sample. Then the last K values
    are mapped onto the first K samples of a new window (Algorithm 1), which may
    change the component, and the movement goes on from sample K - 1: every T - K
    ticks, for ever.

    A mapped window meets the observation partly by the component's isotropic rest,
    which is white noise in time: a peak at the observed samples, nothing between
    or after them. A robot should not follow that (from a start 10 cm above
    a demonstration that never left the board it fell at 2 m/s). And far from the
    demonstrations it meets the observation by variations that nobody has shown (from
    the middle of a wiping pattern, 22 standard deviations: a stroke three times
    as wide as the widest demonstrated). So the weights are kept in the span of the
    component and inside its ellipsoid of a given confidence, and what that leaves of
    the position and velocity is an offset that decays like a critically damped
    spring. It also makes position and velocity exactly continuous at every
    re-mapping, and lets the movement start from rest.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    tracker : Tracker
        How the weights drift; `LqrTracker()` where None.
    sample : bool
        Track a sample of the component, drawn anew at every mapping, instead of its
        mean: more variation (Fig. 10b).
    target : array_like, shape (D*T,), optional
        Weights of your own to track instead, from `skill.analyze`.
    seed : int
        Of the samples.
    blend_time : float
        Seconds, the time constant of the offset's decay.
    confidence : float
        Share of a component's own samples inside the ellipsoid that mapped weights
        are kept in, in (0, 1]; 1 is no bound.
    start_tolerance : float
        How closely the mapped weights meet the start, as a share of the movement's
        half width (`start_variances`); the offset takes the rest. 0 is as closely as
        the skill's tolerance says, which buys millimetres where the demonstrations did
        not vary by metres where they did.
    """

    def __init__(
        self,
        skill: "FourierMovementPrimitive",
        *,
        tracker: Tracker | None = None,
        sample: bool = False,
        target: ArrayLike | None = None,
        seed: int = 0,
        blend_time: float = 0.4,
        confidence: float = 0.99,
        start_tolerance: float = 0.2,
    ) -> None:
        skill.check_fitted()
        if not (is_number(blend_time) and blend_time >= 1e-3):
            raise SkillError(
                f"blend_time is {blend_time} s; it must be positive, at least 1 ms."
            )
        if not (is_number(confidence) and 0 < confidence <= 1):
            raise SkillError(f"confidence is {confidence}; it must be in (0, 1].")
        if not (is_whole(seed) and seed >= 0):
            raise SkillError(
                f"seed is {seed}; it must be a whole number that is not negative."
            )
        self.skill = skill
        self.sample = sample
        self.seed = int(seed)
        self.blend_time = float(blend_time)
        self.tick_seconds = 1 / skill.rate
        self.ticks_between_remaps = skill.n_steps - skill.overlap
        self._own_target = self._checked_target(target)
        rule = LqrTracker() if tracker is None else tracker
        self._drifts = [
            rule.drift(c, n_steps=skill.n_steps, tick=self.tick_seconds)
            for c in skill.components_
        ]
        self._radii = [
            float(np.sqrt(chi2.ppf(confidence, max(c.rank, 1))))
            for c in skill.components_
        ]
        self._start_tolerance = start_variances(skill, start_tolerance)
        self._start_plan = self._plan_start(skill.overlap - 1)
        first = np.arange(skill.overlap)
        self._remap_plan = skill.mapping_plan(first)
        pushed = start_variances(skill, _PUSH_TOLERANCE)
        self._push_plan = skill.mapping_plan(
            first, tolerance=np.tile(pushed, skill.overlap)
        )
        self._rows = skill.basis.synthesize(np.eye(skill.n_steps))[..., 0].T
        self._tables: dict[int, WindowTable] = {}
        self._segments = SegmentMaker(skill, self._drifts, blend_time=self.blend_time)
        self._covariances: dict[int, NDArray[np.float64]] = {}

    def start(self, position: ArrayLike, *, step: int | None = None) -> PlaybackState:
        """Map a measured start, shape (D,), at rest, to a sample of a window.

        Parameters
        ----------
        position : array_like, shape (D,)
        step : int, optional
            The sample, from K - 1 (where None) to T - 1.
        """
        y = as_floats(position, "the start")
        first = self.skill.overlap - 1
        step = first if step is None else step
        if not (is_whole(step) and first <= step <= self.skill.n_steps - 1):
            raise SkillError(
                f"the start is at step {step}; it must be from {first} to "
                f"{self.skill.n_steps - 1}."
            )
        if y.shape != (self.skill.n_channels_,) or not all_finite(y):
            raise SkillError(
                f"the start is {y}; expected {self.skill.n_channels_} finite numbers."
            )
        plan = self._start_plan if step == first else self._plan_start(step)
        at_rest = np.stack([y, np.zeros_like(y)])
        return _state(
            self._enter(plan, y[None], at_rest[None], step=step, remaps=0),
            step=step,
            history=np.tile(y, (self.skill.overlap, 1)),
            remaps=0,
        )

    def tick(self, state: PlaybackState) -> PlaybackState:
        """Return the state one sample later."""
        if state.step >= self.skill.n_steps - 1:
            raise SkillError(
                f"the window ends at step {state.step}; re-map before the next tick."
            )
        later = critically_damped(state.offset, 1 / self.blend_time, self.tick_seconds)
        weights, step = self.weights(state, self.tick_seconds), state.step + 1
        # A row of the basis at a sample: the series itself.
        value = weights.reshape(self.skill.n_channels_, -1) @ self._rows[step]
        value *= self.skill.scales_
        value += later[0]
        return replace(
            state,
            weights=weights,
            offset=later[:2],
            step=step,
            history=np.concatenate([state.history[1:], value[None]]),
        )

    def remap(
        self,
        state: PlaybackState,
        *,
        seconds: float = 0.0,
        observed: ArrayLike | None = None,
        sample: bool | None = None,
    ) -> PlaybackState:
        """Map K values onto the start of a new window.

        Parameters
        ----------
        state : PlaybackState
        seconds : float
            Since the tick of the state; the new state's tick is then.
        observed : array_like, shape (K, D), optional
            What is mapped, a value per tick, the newest last: the measured motion of a
            robot that was pushed off its path, met within 5 % of the movement's half width. The last
            desired values where None. The desired motion goes on without a jump in
            either case.
        sample : bool, optional
            Instead of the player's.
        """
        step, remaps = self.skill.overlap - 1, state.remaps + 1
        values, plan = state.history, self._remap_plan
        if observed is not None:
            values = as_floats(observed, "what is mapped")
            if values.shape != state.history.shape or not all_finite(values):
                raise SkillError(
                    f"what is mapped has shape {values.shape}; expected "
                    f"{state.history.shape} finite values."
                )
            plan = self._push_plan
        entry = self._enter(
            plan,
            values.reshape(1, -1),
            self.motion(state, seconds)[None, :2],
            step=step,
            remaps=remaps,
            sample=sample,
        )
        return _state(entry, step=step, history=state.history, remaps=remaps)

    def plan(
        self, state: PlaybackState, ticks: int, *, sample: bool | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where a state leads to if nothing interferes.

        Parameters
        ----------
        state : PlaybackState
        ticks : int
            How far to look ahead.
        sample : bool, optional
            Of re-mappings, instead of the player's.

        Returns
        -------
        values : ndarray, shape (ticks + 1, D)
            Desired, from the tick of the state on.
        covariances : ndarray, shape (ticks + 1, D, D)
            Of each of them (18).
        """
        d = self.skill.n_channels_
        values, covariances = np.empty((ticks + 1, d)), np.empty((ticks + 1, d, d))
        values[0], covariances[0] = self.motion(state)[0], self._covariance(state)
        for i in range(1, ticks + 1):
            state = self.tick(state)
            values[i], covariances[i] = state.history[-1], self._covariance(state)
            if state.step == self.skill.n_steps - 1:
                state = self.remap(state, sample=sample)
        return values, covariances

    def candidates(self, state: PlaybackState, count: int) -> NDArray[np.float64]:
        """Draw targets from the component of a state, shape (count, D*T).

        They follow from the player's seed and the number of re-mappings.
        """
        rng = np.random.default_rng([self.seed, state.remaps, count])
        gaussian = self.skill.components_[state.component]
        return gaussian.sample(rng, count, with_noise=False)

    def segment(self, state: PlaybackState) -> Segment | PolynomialSegment:
        """Prepare the motion from the tick of a state to the next (see `motion`)."""
        return self._segments.make(state)

    def motion(self, state: PlaybackState, seconds: float = 0.0) -> NDArray[np.float64]:
        """Return the desired motion some seconds after the tick of a state.

        Parameters
        ----------
        state : PlaybackState
        seconds : float
            From 0 to one tick.

        Returns
        -------
        ndarray, shape (3, D)
            Value, velocity (per second) and acceleration (per second^2) of every
            channel. The drift of the weights is part of the derivatives.
        """
        return self.segment(state).motion(seconds)

    def weights(
        self, state: PlaybackState, seconds: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the weights some seconds after the tick of a state, (D*T,)."""
        drift = self._drifts[state.component]
        return drift.after(state.weights, state.target, seconds)

    def covariance(
        self, state: PlaybackState, seconds: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the covariance (18) of the desired value, shape (D, D)."""
        step = min(state.step + seconds * self.skill.rate, self.skill.n_steps - 1.0)
        return self.skill.covariance(state.component, step)

    def _covariance(self, state: PlaybackState) -> NDArray[np.float64]:
        """Return the covariance (18) at the tick of a state, from a table."""
        j = state.component
        if j not in self._covariances:
            steps = range(self.skill.n_steps)
            self._covariances[j] = np.array(
                [self.skill.covariance(j, step) for step in steps]
            )
        return self._covariances[j][state.step]

    def rollout(self, start: ArrayLike, duration: float) -> NDArray[np.float64]:
        """Play from one or many starts for some seconds, sampled at every tick.

        Parameters
        ----------
        start : array_like, shape (D,) or (S, D)
            The samples of start i are drawn from the seed of the player plus i.
        duration : float
            Seconds.

        Returns
        -------
        ndarray, shape (ticks + 1, 3, D) or (S, ticks + 1, 3, D)
            Value, velocity and acceleration, as `motion` gives them.
        """
        if not (is_number(duration) and duration >= 0):
            raise SkillError(f"duration is {duration} s; it must not be negative.")
        starts = as_floats(start, "the start")
        ticks = int(np.floor(duration * self.skill.rate * (1 + 1e-9)))
        many = np.atleast_2d(starts)
        out = np.empty((len(many), ticks + 1, 3, many.shape[-1]))
        done = 0
        for chunk in self.stream(many):
            size = min(chunk.shape[1], ticks + 1 - done)
            out[:, done : done + size] = chunk[:, :size]
            done += size
            if done > ticks:
                break
        return out[0] if starts.ndim == 1 else out

    def stream(self, start: ArrayLike) -> Iterator[NDArray[np.float64]]:
        """Play from one or many starts without end, a window at a time.

        Yields arrays like those of `rollout`, of T - K ticks each, one after the
        other.
        """
        y = as_floats(start, "the start")
        d = self.skill.n_channels_
        if y.ndim not in (1, 2) or y.shape[-1] != d or not all_finite(y):
            raise SkillError(
                f"the start has shape {y.shape}; expected ({d},) or (starts, {d}) "
                "finite numbers."
            )
        many = np.atleast_2d(y)
        step, remaps = self.skill.overlap - 1, 0
        at_rest = np.stack([many, np.zeros_like(many)], axis=1)
        entry = self._enter(self._start_plan, many, at_rest, step=step, remaps=0)
        while True:
            window = self._window(entry)
            yield window[:, :-1] if y.ndim == 2 else window[0, :-1]
            remaps += 1
            entry = self._enter(
                self._remap_plan,
                window[:, -self.skill.overlap :, 0].reshape(len(many), -1),
                window[:, -1, :2],
                step=step,
                remaps=remaps,
            )

    def _plan_start(self, step: int) -> MappingPlan:
        return self.skill.mapping_plan([step], tolerance=self._start_tolerance)

    def _window(self, entry: _Entry) -> NDArray[np.float64]:
        """Play one window for all starts, (S, T - K + 1, 3, D)."""
        ticks, d = self.ticks_between_remaps + 1, self.skill.n_channels_
        out = np.empty((len(entry.component), ticks, 3, d))
        for j in np.unique(entry.component):
            of_j = entry.component == j
            if j not in self._tables:
                self._tables[j] = WindowTable(self.skill, self._drifts[j])
            out[of_j] = self._tables[j].motions(entry.weights[of_j], entry.target[of_j])
        seconds = np.arange(ticks) * self.tick_seconds
        offsets = critically_damped(entry.offset, 1 / self.blend_time, seconds)
        return out + np.transpose(offsets, (2, 1, 0, 3))

    def _enter(
        self,
        plan: MappingPlan,
        values: NDArray[np.float64],
        motions: NDArray[np.float64],
        *,
        step: int,
        remaps: int,
        sample: bool | None = None,
    ) -> _Entry:
        """Map observations (S, m) to weights, without a jump from motions (S, 2, D)."""
        mapped, components, _ = plan.map_many(values)
        skill = self.skill
        d, n = skill.n_channels_, skill.n_steps
        rows = skill.basis.local_rows(step)
        target = np.empty_like(mapped)
        offset = np.empty_like(motions)
        for j in np.unique(components):
            of_j = components == j
            gaussian = skill.components_[j]
            inside = (mapped[of_j] - gaussian.mean) @ gaussian.basis
            spread = np.sqrt(gaussian.variances + gaussian.noise)
            deviation = np.linalg.norm(inside / spread, axis=1, keepdims=True)
            inside *= np.minimum(1.0, self._radii[j] / np.maximum(deviation, 1e-12))
            mapped[of_j] = gaussian.mean + inside @ gaussian.basis.T
            target[of_j] = self._targets(
                int(j), np.flatnonzero(of_j), remaps, sample=sample
            )
            w, w_dot, _ = self._drifts[j].advance(mapped[of_j], target[of_j], 0.0)
            here = w.reshape(-1, d, n) @ rows[:2].T
            moving = w_dot.reshape(-1, d, n) @ rows[0]
            velocity = here[..., 1] * skill.rate + moving
            reached = np.stack([here[..., 0], velocity], axis=1) * skill.scales_
            offset[of_j] = motions[of_j] - reached
        return _Entry(
            weights=mapped, target=target, component=components, offset=offset
        )

    def _targets(
        self,
        component: int,
        starts: NDArray[np.int64],
        remaps: int,
        *,
        sample: bool | None,
    ) -> NDArray[np.float64]:
        """Return what to track after a mapping, (S, n) or (n,)."""
        if self._own_target is not None:
            return self._own_target
        gaussian = self.skill.components_[component]
        if not (self.sample if sample is None else sample):
            return gaussian.mean
        return np.concatenate(
            [
                gaussian.sample(
                    np.random.default_rng([self.seed + int(i), remaps]),
                    with_noise=False,
                )
                for i in starts
            ]
        )

    def _checked_target(self, target: ArrayLike | None) -> NDArray[np.float64] | None:
        if target is None:
            return None
        if self.sample:
            raise SkillError("give either a target or sample=True, not both.")
        own = as_floats(target, "the target")
        n = self.skill.components_[0].dim
        if own.shape != (n,) or not all_finite(own):
            raise SkillError(
                f"the target has shape {own.shape}; expected ({n},) finite weights."
            )
        return own


def _state(
    entry: _Entry, *, step: int, history: NDArray[np.float64], remaps: int
) -> PlaybackState:
    return PlaybackState(
        weights=entry.weights[0],
        target=entry.target[0],
        component=int(entry.component[0]),
        step=step,
        history=history,
        offset=entry.offset[0],
        remaps=remaps,
    )
