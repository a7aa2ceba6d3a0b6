"""Playing a skill for any duration: Algorithm 2 and section V-D of the paper."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.numeric import all_finite, as_floats, is_number, is_whole
from fmp_drake.primitives.model.mapping import MappingPlan
from fmp_drake.primitives.model.region import DemonstratedRegion
from fmp_drake.primitives.playback.confidence import confined
from fmp_drake.primitives.playback.motion import Motion
from fmp_drake.primitives.playback.own_target import checked_target
from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.remap_ticks import remap_ticks_of
from fmp_drake.primitives.playback.sampling import track_component
from fmp_drake.primitives.playback.segment import (
    Segment,
    decayed_offset,
    make_segment,
    segment_motion,
)
from fmp_drake.primitives.playback.start_tolerance import start_variances
from fmp_drake.primitives.playback.trackers import LqrTracker, Tracker

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive

# How closely the mapped weights meet the motion of a pushed robot, as a fraction of the
# movement's half width.
_PUSH_TOLERANCE = 0.05
# Fraction of a tick that rounding may add to, or take from, a time.
_ROUNDING = 1e-6


class Player:
    """Plays a fitted skill from any start, for as long as wanted.

    The start is mapped onto sample K - 1 of a window. From there the weights relax to
    their target while the window is played to its end. Then the last K values
    are mapped onto the first K samples of a new window (Algorithm 1), which may
    change the component, and the movement goes on from sample K - 1: every T - K
    ticks, or oftener, for ever. Where a playback stands is a `PlaybackState`; the
    methods of a player turn one state into another and never change it.

    A mapped window meets the observation partly by the component's isotropic noise,
    which is white in time: a peak at the observed samples, nothing between
    or after them. A robot should not follow that (from a start 10 cm above
    a demonstration that never left the board it fell at 2 m/s). And far from the
    demonstrations it meets the observation by variations that nobody has shown (from
    the middle of a wiping pattern, 22 standard deviations: a stroke three times
    as wide as the widest demonstrated). So the weights are kept in the span of the
    component and inside its ellipsoid of a given confidence, and what that leaves of
    the position and velocity is an offset that decays like a critically damped
    spring. It also makes position and velocity exactly continuous at every
    re-mapping, and lets the movement start at rest.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    tracker : Tracker
        How the weights relax; `LqrTracker()` where None. A phase model uses it for a target
        of your own only: what it plays goes on from a mapping by itself.
    sample : bool
        Track a sample of the component, drawn anew at every mapping, instead of its
        mean (`skill.expected`): more variation (Fig. 10b).
    target : array_like, shape (D*T,), optional
        Weights of your own to track instead, from `skill.analyze`.
    seed : int
        Of the samples.
    blend_time : float
        Seconds, the time constant of the offset's decay.
    confidence : float
        Fraction of a component's own samples inside the ellipsoid that mapped weights
        are kept in, in (0, 1]; 1 is no bound.
    start_tolerance : float
        How closely the mapped weights meet the start, as a fraction of the movement's
        half width (`start_variances`); the offset makes up for what remains. 0 is as
        closely as the skill's tolerance says, which buys millimetres where the
        demonstrations did not vary by metres where they did.
    margin : float, optional
        How far samples may leave the demonstrated paths, m; None for no bound. See
        `DemonstratedRegion` and `track_sample`.
    remap_ticks : int, optional
        Ticks between two re-mappings; as many as there may be (`remap_ticks_of`) where None.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import FourierMovementPrimitive, Player
    >>> t = np.arange(1200) / 20
    >>> circles = np.stack([np.cos(2 * t), np.sin(2 * t)], axis=1)
    >>> windows = np.stack([circles[i : i + 120] for i in range(0, 1080, 5)])
    >>> skill = FourierMovementPrimitive(n_components=16).fit(windows)
    >>> player = Player(skill)
    >>> state = player.advance(player.start([1.5, 0.0]), seconds=20.03)
    >>> position, velocity, acceleration = player.motion(state)
    >>> print(round(float(np.hypot(*position)), 1))
    1.0
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
        margin: float | None = None,
        remap_ticks: int | None = None,
    ) -> None:
        skill.check_fitted()
        self.region = None if margin is None else DemonstratedRegion(skill, margin)
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
        self.ticks_between_remaps = remap_ticks_of(skill, remap_ticks)
        self._own_target = checked_target(skill, target, sample=sample)
        rule = LqrTracker() if tracker is None else tracker
        self.relaxations = [
            rule.relaxation(c, n_steps=skill.n_steps, tick=self.tick_seconds)
            for c in skill.components_
        ]
        self._confidence = confidence
        tolerance = start_variances(skill, start_tolerance)
        self._start_plan = skill.mapping_plan([skill.overlap - 1], tolerance=tolerance)
        first = np.arange(skill.overlap)
        self._remap_plan = skill.mapping_plan(first)
        pushed = start_variances(skill, _PUSH_TOLERANCE)
        self._push_plan = skill.mapping_plan(
            first, tolerance=np.tile(pushed, skill.overlap)
        )
        self._rows = skill.basis.synthesize(np.eye(skill.n_steps))[..., 0].T
        self._covariances: dict[int, NDArray[np.float64]] = {}

    # From state to state ------------------------------------------------------

    def start(
        self,
        position: ArrayLike,
        *,
        tempo: float = 1.0,
        seed: int | None = None,
    ) -> PlaybackState:
        """Map a measured start, at rest, onto sample K - 1 of a window.

        Parameters
        ----------
        position : array_like, shape (D,)
        tempo : float
            Seconds of the skill per second.
        seed : int, optional
            Instead of the player's.
        """
        y = as_floats(position, "the start")
        if y.shape != (self.skill.n_channels_,) or not all_finite(y):
            raise SkillError(
                f"the start is {y}; expected {self.skill.n_channels_} finite numbers."
            )
        state = PlaybackState(
            weights=self.skill.components_[0].mean,
            target=self.skill.components_[0].mean,
            component=0,
            step=self.skill.overlap - 1,
            history=np.tile(y, (self.skill.overlap, 1)),
            offset=np.zeros((2, len(y))),
            blend_time=self.blend_time,
            tempo=tempo,
            sample=self.sample,
            seed=self.seed if seed is None else seed,
        )
        at_rest = np.stack([y, np.zeros_like(y)])
        return self._entered(state, self._start_plan, y, at_rest)

    def advance(self, state: PlaybackState, seconds: float) -> PlaybackState:
        """Return the state some seconds of real time later.

        Ticks, and the re-mappings at the ends of windows, that fall due are made.
        """
        while True:
            wait = state.seconds_until(self.tick_seconds)
            if seconds < wait - _ROUNDING * self.tick_seconds:
                break
            state = self._tick(state, wait)
            seconds -= wait
        if seconds <= _ROUNDING * self.tick_seconds:
            return state
        tempo = max(state.tempo + state.tempo_rate * seconds, 0.0)
        return replace(
            state,
            offset=decayed_offset(state.offset, state.blend_time, seconds)[:2],
            time_since_tick=state.time_since_tick + (state.tempo + tempo) / 2 * seconds,
            tempo=tempo,
        )

    def remap(
        self, state: PlaybackState, *, observed: ArrayLike | None = None
    ) -> PlaybackState:
        """Map K values onto the start of a new window, without a jump of the motion.

        Parameters
        ----------
        state : PlaybackState
        observed : array_like, shape (K, D), optional
            What is mapped, a value per tick, the newest last: the measured motion of a
            robot that was pushed off its path, met within 5 % of the movement's half
            width. The last desired values where None.
        """
        values, plan = state.history, self._remap_plan
        if observed is not None:
            values = as_floats(observed, "what is mapped")
            if values.shape != state.history.shape or not all_finite(values):
                raise SkillError(
                    f"what is mapped has shape {values.shape}; expected "
                    f"{state.history.shape} finite values."
                )
            plan = self._push_plan
        motion = self.motion(state)[:2]
        state = replace(
            state,
            step=self.skill.overlap - 1,
            time_since_tick=0.0,
            remaps=state.remaps + 1,
        )
        return self._entered(state, plan, values.ravel(), motion)

    def retarget(
        self,
        state: PlaybackState,
        target: NDArray[np.float64],
        *,
        at_once: bool = False,
    ) -> PlaybackState:
        """Track other weights, shape (D*T,), without a jump of the motion.

        At once they are played without being relaxed to: the offset makes up for it.
        """
        weights = target if at_once else state.weights
        new = replace(state, weights=weights, target=target)
        change = self.motion(state)[:2] - self.motion(new)[:2]
        return replace(new, offset=state.offset + change)

    def _tick(self, state: PlaybackState, seconds: float) -> PlaybackState:
        """Return the state at the next tick, which is some seconds away."""
        relaxation, step = self.relaxations[state.component], state.step + 1
        weights = relaxation.after(state.weights, state.target, self.tick_seconds)
        offset = decayed_offset(state.offset, state.blend_time, seconds)[:2]
        # A row of the basis at a sample: the series itself.
        value = weights.reshape(self.skill.n_channels_, -1) @ self._rows[step]
        value = value * self.skill.scales_ + offset[0]
        state = replace(
            state,
            weights=weights,
            offset=offset,
            step=step,
            history=np.concatenate([state.history[1:], value[None]]),
            time_since_tick=0.0,
            tempo=max(state.tempo + state.tempo_rate * seconds, 0.0),
        )
        last = self.skill.overlap - 1 + self.ticks_between_remaps
        return self.remap(state) if step >= last else state

    def _entered(
        self,
        state: PlaybackState,
        plan: MappingPlan,
        values: NDArray[np.float64],
        motion: NDArray[np.float64],
    ) -> PlaybackState:
        """Return the state with mapped weights, and the motion (2, D) as it was."""
        mapping, own = plan.map(values), self._own_target
        gaussian = self.skill.components_[mapping.component]
        state = replace(
            state,
            weights=confined(gaussian, mapping.weights, self._confidence),
            target=gaussian.mean if own is None else own,
            component=mapping.component,
            offset=np.zeros_like(state.offset),
        )
        state = replace(state, offset=motion - self.motion(state)[:2])
        return track_component(self, state) if own is None else state

    # What a state means -------------------------------------------------------

    def segment(self, state: PlaybackState) -> Segment:
        """Prepare the motion from a state to its next tick, for `segment_motion`."""
        return make_segment(self.skill, self.relaxations[state.component], state)

    def motion(self, state: PlaybackState) -> Motion:
        """Return the desired motion at a state.

        Returns
        -------
        Motion, shape (3, D)
            Position, velocity (per second) and acceleration (per second^2) of each
            channel. The relaxation of the weights is part of the derivatives.
        """
        return Motion(segment_motion(self.segment(state), 0.0))

    def weights(self, state: PlaybackState) -> NDArray[np.float64]:
        """Return the Fourier weights at a state, shape (D*T,)."""
        relaxation = self.relaxations[state.component]
        return relaxation.after(state.weights, state.target, state.time_since_tick)

    def covariance(self, state: PlaybackState) -> NDArray[np.float64]:
        """Return the covariance (18) of the desired value at a state, shape (D, D)."""
        step = state.step + state.time_since_tick * self.skill.rate
        return self.skill.covariance(
            state.component, min(step, self.skill.n_steps - 1.0)
        )

    def plan(
        self, state: PlaybackState, ticks: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where a state leads to if nothing interferes.

        Parameters
        ----------
        state : PlaybackState
        ticks : int
            How far to look ahead.

        Returns
        -------
        values : ndarray, shape (ticks + 1, D)
            Desired at the state, and then at every tick.
        covariances : ndarray, shape (ticks + 1, D, D)
            Of each of them (18).
        """
        d = self.skill.n_channels_
        values, covariances = np.empty((ticks + 1, d)), np.empty((ticks + 1, d, d))
        values[0], covariances[0] = self.motion(state)[0], self.covariance(state)
        # At its nominal tempo, where it stands still or changes its tempo.
        tempo = state.tempo if state.tempo > 0 else 1.0
        state = replace(state, tempo=tempo, tempo_rate=0.0)
        for i in range(1, ticks + 1):
            state = self._tick(state, state.seconds_until(self.tick_seconds))
            values[i], covariances[i] = state.history[-1], self._at_tick(state)
        return values, covariances

    def _at_tick(self, state: PlaybackState) -> NDArray[np.float64]:
        """Return the covariance (18) at the tick of a state, from a table."""
        j = state.component
        if j not in self._covariances:
            self._covariances[j] = np.array(
                [self.skill.covariance(j, step) for step in range(self.skill.n_steps)]
            )
        return self._covariances[j][state.step]

    def rollout(self, start: ArrayLike, duration: float) -> Motion:
        """Play from one or many starts for some seconds, sampled at every tick.

        Parameters
        ----------
        start : array_like, shape (D,) or (S, D)
            The samples of start i are drawn from the seed of the player plus i.
        duration : float
            Seconds.

        Returns
        -------
        Motion, shape (ticks + 1, 3, D) or (S, ticks + 1, 3, D)
            As `motion` gives them: `.position` has the shape (ticks + 1, D).
        """
        if not (is_number(duration) and duration >= 0):
            raise SkillError(f"duration is {duration} s; it must not be negative.")
        starts = as_floats(start, "the start")
        ticks = int(np.floor(duration * self.skill.rate * (1 + 1e-9)))
        many = np.atleast_2d(starts)
        out = np.empty((len(many), ticks + 1, 3, self.skill.n_channels_))
        for i, position in enumerate(many):
            state = self.start(position, seed=self.seed + i)
            for k in range(ticks + 1):
                out[i, k] = self.motion(state)
                state = self._tick(state, self.tick_seconds)
        return Motion(out if starts.ndim == 2 else out[0])
