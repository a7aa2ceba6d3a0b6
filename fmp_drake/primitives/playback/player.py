"""Playback of a skill for any duration: Algorithm 2 and section V-D of the paper."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from fmp_drake.errors import SkillError
from fmp_drake.numeric import (
    Array,
    as_flag,
    as_floats,
    check_number,
    finite_array,
    one_blas_thread,
)
from fmp_drake.primitives.model.basis import closing_samples
from fmp_drake.primitives.model.mapping import MappingPlan
from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive
from fmp_drake.primitives.model.region import (
    DemonstratedRegion,
    automatic_margin,
    drawn_out,
)
from fmp_drake.primitives.model.trajectory_mixture import check_skill
from fmp_drake.primitives.playback.motion import (
    Motion,
    Segment,
    decayed_offset,
    look_ahead,
    look_ahead_at_once,
    make_segment,
    segment_motion,
)
from fmp_drake.primitives.playback.playback_state import PlaybackState, start_variances
from fmp_drake.primitives.playback.trackers import LqrTracker, Tracker

type Score = Callable[[Array], Array]

# Tolerance of the mapped weights to the motion of a pushed robot, as a fraction of the
# movement's half width.
_PUSH_TOLERANCE = 0.05
# Least time between two re-mappings, and least period, in time constants of the offset. Circles
# of 0.5 to 2.5 s at tempos of 1 to 8 keep their size with 4, and grow up to fifteenfold with 2
# or 3. Of a longer offset a movement of less than 2 s keeps a part at every re-mapping.
_BLENDS = 5.0
# Rounding error of a time, as a fraction of a tick.
_ROUNDING = 1e-6
# Samples at the end of a window whose velocity amplifies noise.
_NOISY = 3
# Greatest number of samples that are tried until a movement stays in the region.
_TRIES = 8
# Number of phases that are compared with a motion, their greatest distance from the
# component's phase, rad, and the number of Gauss-Newton steps from the best of them.
_PHASES = 41
_LARGEST_PHASE_ERROR = 1.5
_PHASE_STEPS = 4


class Player:
    """Plays a fitted skill from any start, for any duration.

    The start is mapped onto sample K - 1 of a window. From there the weights relax to
    their target while the window is played to its end. Then the last K values
    are mapped onto the first K samples of a new window (Algorithm 1), which may
    change the component, and the movement continues from sample K - 1. This repeats
    every T - K ticks or more often. A `PlaybackState` determines the continuation of a
    playback; the methods of a player return a new state and change none.

    A mapped window fits the observation partly by the component's isotropic noise,
    which is white in time: a peak at the observed samples, and 0 between and after
    them. A robot should not follow that: from a start 10 cm above a demonstration that
    never left the board it fell at 2 m/s. Far from the demonstrations, the window fits
    the observation by variations that were not demonstrated: from the middle of a
    wiping pattern by 22 standard deviations, a stroke three times as wide as the widest
    demonstrated one. The weights are therefore projected onto the span of the
    component, and into its ellipsoid of a given confidence. The remaining difference in
    position and velocity is an offset that decays like a critically damped spring. The
    offset also makes position and velocity exactly continuous at every re-mapping, and
    starts the movement at rest.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    tracker : Tracker
        Controller of the weights; `LqrTracker()` where None. With a phase model it is used
        only for a `target`.
    sample : bool
        Track a new sample of the component after every mapping, instead of its
        mean (`skill.expected`): more variation (Fig. 10b).
    target : array_like, shape (D*T,), optional
        Weights to track instead, from `skill.analyze`.
    seed : int
        Seed of the samples.
    blend_time : float
        Time constant of the offset's decay, s. With a phase model, from the first
        re-mapping on, it is at most a fifth of the time between two of them: with a longer
        one, the offset that is left at a re-mapping, and is mapped with the history, grows
        from one to the next. Without one, it is divided by tempos above 1.
    confidence : float
        Fraction of a component's samples inside the ellipsoid that bounds mapped
        weights, in (0, 1]; 1 is no bound.
    start_tolerance : float
        Tolerance of the mapped weights to the start, as a fraction of the movement's
        half width; the offset absorbs the remaining difference. 0 uses the skill's
        tolerance, which gains millimetres where the demonstrations did not vary and
        costs metres where they did.
    margin : float or "automatic", optional
        Largest distance of samples from the demonstrated paths, m; None for no bound. See
        `DemonstratedRegion` and `track_sample`. "automatic" is a fifth of the movement's
        half width over its channels in m, if the skill has demonstrated paths.
    remap_ticks : int, optional
        Ticks between two re-mappings, at most T - K as in the paper. With a phase
        model, a re-mapping takes place before its windows blend into their beginnings.
        The greatest possible number where None, but 3 fewer with a mixture whose model and
        number of components were not asked for: its velocity at the end of a window
        amplifies noise of the recordings: 1 mm led samples up to 50 mm off the movement.
        Nor is the end of a window played whose harmonics were changed (`modulate_skill`).
        Much smaller numbers change the movement of a mixture, which may grow, or come to
        rest.

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

    def __repr__(self) -> str:
        """Return the skill that is played."""
        return f"Player({self.skill!r})"

    def __init__(
        self,
        skill: FourierMovementPrimitive,
        *,
        tracker: Tracker | None = None,
        sample: bool = False,
        target: ArrayLike | None = None,
        seed: int = 0,
        blend_time: float = 0.4,
        confidence: float = 0.99,
        start_tolerance: float = 0.2,
        margin: float | Literal["automatic"] | None = "automatic",
        remap_ticks: int | None = None,
    ) -> None:
        check_skill(skill, "Player(skill)")
        if margin == "automatic":
            margin = automatic_margin(skill)
        self.region = None if margin is None else DemonstratedRegion(skill, margin)
        check_number(blend_time, "blend_time", least=1e-3, unit="s")
        check_number(confidence, "confidence", above=0.0, most=1.0)
        check_number(seed, "seed", least=0, whole=True)
        self.skill = skill
        self.sample = as_flag(sample, "sample")
        self.seed = int(seed)
        self.blend_time = float(blend_time)
        self.tick_seconds = 1 / skill.rate
        most_ticks = skill.n_steps - skill.overlap
        is_free = skill.model == skill.n_components == "automatic"
        # Windows with changed harmonics ring near their ends.
        unplayed = (
            _NOISY * is_free if skill.calibration_ else closing_samples(skill.n_steps)
        )
        default = max(1, most_ticks - unplayed)
        # The windows of a mixture may be far shorter than a cycle of its movement.
        self._longest_blend = self.blend_time
        if skill.phase_model_ is not None:
            default = most_ticks = max(1, most_ticks - closing_samples(skill.n_steps))
            longest = min(most_ticks * self.tick_seconds, skill.period_)
            self._longest_blend = longest / _BLENDS
        ticks = default if remap_ticks is None else remap_ticks
        check_number(ticks, "remap_ticks", least=1, most=most_ticks, whole=True)
        self.ticks_between_remaps = int(ticks)
        if target is not None:
            if sample:
                raise SkillError("give either a target or sample=True, not both.")
            target = finite_array(target, "the target", (skill.components_[0].dim,))
        self._target = None if target is None else target.copy()
        tracker = LqrTracker() if tracker is None else tracker
        if isinstance(tracker, type) or not hasattr(tracker, "relaxation"):
            raise SkillError(f"tracker is {tracker!r}; give one such as LqrTracker().")
        self.relaxations = [
            tracker.relaxation(c, n_steps=skill.n_steps, tick=self.tick_seconds)
            for c in skill.components_
        ]
        self._confidence = confidence
        tolerance = start_variances(skill, start_tolerance)
        self._start_plan = skill.mapping_plan([skill.overlap - 1], tolerance=tolerance)
        first = np.arange(skill.overlap)
        self._remap_plan = skill.mapping_plan(first)
        pushed = np.tile(start_variances(skill, _PUSH_TOLERANCE), skill.overlap)
        self._push_plan = skill.mapping_plan(first, tolerance=pushed)
        self._rows = skill.basis.synthesize(np.eye(skill.n_steps))[..., 0].T
        self._covariances: dict[int, Array] = {}

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
        check_number(tempo, "tempo", least=0)
        check_number(seed or 0, "seed", least=0, whole=True)
        y = finite_array(position, "the start", (self.skill.n_channels_,))
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
        """Return the state some seconds of real time later, with all ticks and re-mappings."""
        PlaybackState.check(state)
        tick, rounding = self.tick_seconds, _ROUNDING * self.tick_seconds
        seconds = float(as_floats(seconds, "seconds", ()))
        # A tick that is overdue is as long ago.
        if not min(state.seconds_until(tick), 0.0) - rounding <= seconds < np.inf:
            check_number(seconds, "seconds", least=0, unit="s")
        while seconds >= (wait := state.seconds_until(tick)) - rounding:
            state = self._tick(state, wait)
            seconds -= wait
        if seconds <= rounding:
            return state
        tempo, moving = state.tempo + state.tempo_rate * seconds, seconds
        if tempo < 0:  # It stops before.
            tempo, moving = 0.0, -state.tempo / state.tempo_rate
        return replace(
            state,
            offset=decayed_offset(state.offset, state.blend_time, seconds)[:2],
            time_since_tick=state.time_since_tick + (state.tempo + tempo) / 2 * moving,
            tempo=tempo,
        )

    def blend_time_of(self, state: PlaybackState) -> float:
        """Return the time constant of the decay of an unpushed state's offset, s."""
        if not state.remaps:
            return self.blend_time
        return min(self.blend_time, self._longest_blend / max(state.tempo, 1.0))

    def remap(
        self, state: PlaybackState, *, observed: ArrayLike | None = None
    ) -> PlaybackState:
        """Map K values onto the start of a new window; the motion does not jump.

        Parameters
        ----------
        state : PlaybackState
        observed : array_like, shape (K, D), optional
            Measured values at the last K ticks, the newest last, of a robot that was
            pushed off its path. The new motion meets them within 5 % of the movement's
            half width. The last desired values where None.
        """
        PlaybackState.check(state)
        values, plan = state.history, self._remap_plan
        if observed is not None:
            values = finite_array(observed, "the observed values", state.history.shape)
            plan = self._push_plan
        motion = self.motion(state)[:2]
        state = replace(
            state,
            step=self.skill.overlap - 1,
            # The newest measured value is of now.
            time_since_tick=state.time_since_tick if observed is None else 0.0,
            remaps=state.remaps + 1,
        )
        blend_time = min(state.blend_time, self.blend_time_of(state))
        state = replace(state, blend_time=blend_time)
        return self._entered(state, plan, values.ravel(), motion)

    def retarget(
        self, state: PlaybackState, target: Array, *, at_once: bool = False
    ) -> PlaybackState:
        """Track other weights, shape (D*T,); the motion does not jump.

        With `at_once` the weights do not relax to the target but are replaced by it.
        """
        target = finite_array(target, "the target", state.weights.shape)
        weights = target if at_once else state.weights
        new = replace(state, target=target, weights=weights)
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
        values: Array,
        motion: Array,
    ) -> PlaybackState:
        """Return the state with mapped weights and the same motion, shape (2, D)."""
        mapping, target = plan.map(values), self._target
        gaussian = self.skill.components_[mapping.component]
        state = replace(
            state,
            weights=gaussian.confined(mapping.weights, self._confidence),
            target=gaussian.mean if target is None else target,
            component=mapping.component,
            offset=np.zeros_like(state.offset),
        )
        state = replace(state, offset=motion - self.motion(state)[:2])
        if target is not None:
            return state
        if state.sample:
            return self.track_sample(state)
        return self._tracking(
            state, self.skill.expected(state.component, self._past(state))
        )

    # Choosing a sample --------------------------------------------------------

    @one_blas_thread()
    def track_sample(
        self,
        state: PlaybackState,
        *,
        count: int = 1,
        score: Score | None = None,
        scored: Sequence[int] | None = None,
    ) -> PlaybackState:
        """Track a sample of a state's component; the motion does not jump.

        Where the player has a region, samples are moved towards the mean. They then
        stay in the region up to the next re-mapping, or leave it hardly farther than
        the mean does. The first sample after which the next window's mean also stays
        inside is tracked: otherwise the speed at the end of a window may carry the
        movement out. With a score, the `scored` channels of samples are also moved away
        from the mean, as far as the region allows, because the best samples often lie at
        its boundary: by up to 1.5 times their difference from the mean, or 3 times that
        from the cycle of a phase model. Where this difference would accelerate more than the
        movement, only its slow part is enlarged, not the noise of the recordings.

        Parameters
        ----------
        state : PlaybackState
            The samples follow from its seed and its number of re-mappings.
        count : int
            Number of samples drawn.
        score : callable, optional
            Returns the scores (S,) of S samples from their values (S, N, D) at the ticks up
            to the next re-mapping. Samples with greater scores are tried first.
        scored : sequence of int, optional
            Channels on which the score depends: those in m where None.

        Examples
        --------
        >>> windows = np.random.default_rng(0).standard_normal((40, 24, 2))
        >>> skill = FourierMovementPrimitive(n_steps=24, rate=10, overlap=4).fit(windows)
        >>> player = Player(skill)
        >>> high = player.track_sample(
        ...     player.start([0.0, 0.0]),
        ...     count=16,
        ...     score=lambda values: values[..., 1].mean(axis=1),
        ... )
        >>> high.target.shape
        (48,)
        """
        check_number(count, "count", least=1, whole=True)
        skill, region = self.skill, self.region
        rng = np.random.default_rng([state.seed, state.remaps])
        if region is not None:
            count = max(count, _TRIES)
        past = self._past(state)
        centre, deviation = skill.draw(state.component, rng, count, past=past)
        if region is None and score is None:
            return self._tracking(state, centre[0] + deviation[0])
        if skill.phase_model_ is not None:
            # The last candidate is the expected window, which was checked to stay inside.
            expected = skill.expected(state.component, past)
            centre = np.concatenate([centre, expected[None]])
            deviation = np.concatenate([deviation, np.zeros_like(expected)[None]])
        steady, values = self._next_values(state, centre, deviation)
        # Up to the next re-mapping.
        ticks = skill.overlap - 1 + self.ticks_between_remaps - state.step
        steady = steady[..., :ticks, :]
        if region is not None and score is not None:
            if scored is None:
                scored = [i for i, unit in enumerate(skill.units_) if unit == "m"]
            near = values[:, :ticks]
            deviation = drawn_out(skill, deviation, steady, near, channels=scored)
            values = self._next_values(state, centre, deviation)[1]
        values = values[:, :ticks]
        if region is not None:
            parts = region.largest_channel_fractions(steady, values)
            deviation *= np.repeat(parts, skill.n_steps, axis=1)
            values *= parts[:, None]
        values += steady
        targets = centre + deviation
        order = np.arange(count)
        if score is not None:
            scores = as_floats(score(values[:count]), "the scores", (count,))
            order = np.argsort(-scores, kind="stable")
        if region is None:
            return self._tracking(state, targets[order[0]])
        best_state, least_ratio = state, math.inf
        for i in [*order[:_TRIES], *range(count, len(targets))]:
            candidate = self._tracking(state, targets[i])
            ratio = region.largest_ratio(self._next_mean(candidate, values[i]))
            if skill.phase_model_ is not None:
                outside = float(np.max(region.distance(values[i])))
                ratio = max(ratio, outside / region.margin)
            if ratio < least_ratio:
                best_state, least_ratio = candidate, ratio
            if ratio <= 1:
                break
        return best_state

    def _past(self, state: PlaybackState) -> Array:
        """Return the first samples (K, D) of the window that a state plays."""
        return self.skill.synthesize(state.weights)[: self.skill.overlap]

    def _tracking(self, state: PlaybackState, target: Array) -> PlaybackState:
        """Return the state that tracks weights; those of a phase model are played at once.

        A weighted mean of two weights that differ in phase would leave the cycle.
        """
        at_once = self.skill.phase_model_ is not None
        return self.retarget(state, target, at_once=at_once)

    def _next_values(
        self,
        state: PlaybackState,
        centre: Array,
        deviation: Array,
    ) -> tuple[Array, Array]:
        """Return the values of S targets at the next ticks, as two summands.

        Returns
        -------
        steady : ndarray, shape (N, D) or (S, N, D)
            Values of the centres (S, D*T).
        values : ndarray, shape (S, N, D)
            Contribution of the deviations (S, D*T).
        """
        skill = self.skill
        if skill.phase_model_ is None:
            gaussian = skill.components_[state.component]
            state = self.retarget(state, gaussian.mean)
            prospect = look_ahead(skill, self.relaxations[state.component], state)
            contributions = np.tensordot(
                deviation @ gaussian.basis, prospect.response, (1, 2)
            )
            return prospect.steady, contributions
        steady, rows = look_ahead_at_once(skill, state, self.motion(state)[:2])

        def values_of(weights: Array) -> Array:
            windows = weights.reshape(len(weights), skill.n_channels_, skill.n_steps)
            return np.swapaxes(windows @ rows.T, 1, 2) * skill.scales_

        return steady + values_of(centre), values_of(deviation)

    def _next_mean(self, state: PlaybackState, values: Array) -> Array:
        """Return the values (N, D) of the next window if its mean is tracked.

        Parameters
        ----------
        state : PlaybackState
        values : ndarray, shape (N, D)
            Values at the ticks up to the next re-mapping.
        """
        skill, end = self.skill, replace(self._later(state, values), sample=False)
        next_state = self.remap(end)
        relaxation = self.relaxations[next_state.component]
        prospect = look_ahead(skill, relaxation, next_state, responses=False)
        return prospect.steady[: self.ticks_between_remaps]

    # Quantities of a state ----------------------------------------------------

    def segment(self, state: PlaybackState) -> Segment:
        """Prepare the motion from a state to its next tick, for `segment_motion`."""
        PlaybackState.check(state)
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

    def phase(self, state: PlaybackState) -> float:
        """Return the phase of the desired motion at a state, rad, from 0 to 2 pi.

        This is the phase at which the cycle of the phase model has the most similar
        position and velocity, near the phase of the tracked component. It is continuous,
        modulo 2 pi, where the motion is, unless that is still far from the cycle.

        Raises
        ------
        SkillError
            Where the skill has no phase model.
        """
        PlaybackState.check(state)
        model = self.skill.phase_model_
        if model is None:
            raise SkillError("the skill is a mixture, which has no phase.")
        velocity, rate = model.velocity.mean, self.skill.rate
        # In units of the cycle, per radian.
        motion = self.motion(replace(state, tempo=1.0, tempo_rate=0.0))[:2]
        desired = (motion / self.skill.scales_ / [[1.0], [velocity * rate]]).ravel()
        step = state.step + state.time_since_tick * rate - model.reference_step
        nominal = model.grid.phases[state.component] + velocity * step
        phases = nominal + np.linspace(
            -_LARGEST_PHASE_ERROR, _LARGEST_PHASE_ERROR, _PHASES
        )
        cycle = np.concatenate(
            [model.cycle.values(phases), model.cycle.values(phases, 1)], axis=1
        )
        phase = phases[np.argmin(np.sum((cycle - desired) ** 2, axis=1))]
        for _ in range(_PHASE_STEPS):
            value, first, second = (model.cycle.values(phase, k) for k in range(3))
            jacobian = np.concatenate([first, second])
            error = desired - np.concatenate([value, first])
            change = jacobian @ error / max(jacobian @ jacobian, 1e-300)
            phase += np.clip(change, -0.2, 0.2)
        return float(np.mod(phase, 2 * np.pi))

    def weights(self, state: PlaybackState) -> Array:
        """Return the Fourier weights at a state, shape (D*T,)."""
        relaxation = self.relaxations[state.component]
        return relaxation.after(state.weights, state.target, state.time_since_tick)

    def covariance(self, state: PlaybackState) -> Array:
        """Return the covariance of the movement about the desired value, shape (D, D)."""
        return self.skill.predicted_covariance(state.component, self._step(state))

    def variation(self, state: PlaybackState) -> Array:
        """Return the covariance of the demonstrations about the desired value, (D, D).

        It is (18), without the errors of predictions in `covariance`: a stiffness
        follows the variation of the demonstrations, not the difficulty of predicting
        them.
        """
        return self.skill.covariance(state.component, self._step(state))

    def _step(self, state: PlaybackState) -> float:
        """Return the position of a state in its window, in samples."""
        step = state.step + state.time_since_tick * self.skill.rate
        return min(step, self.skill.n_steps - 1.0)

    def plan(self, state: PlaybackState, ticks: int) -> tuple[Array, Array]:
        """Return the uninterrupted continuation of a state.

        Parameters
        ----------
        state : PlaybackState
        ticks : int
            Length of the continuation.

        Returns
        -------
        values : ndarray, shape (ticks + 1, D)
            Desired values at the state and at every tick.
        covariances : ndarray, shape (ticks + 1, D, D)
            Their covariances.
        """
        check_number(ticks, "ticks", least=0, whole=True)
        values, covariances = [self.motion(state)[:1]], [self.covariance(state)[None]]
        # At constant tempo, and at tempo 1 where the state's is 0.
        state = replace(state, tempo=state.tempo or 1.0, tempo_rate=0.0)
        last = self.skill.overlap - 1 + self.ticks_between_remaps
        while ticks > 0:
            relaxation = self.relaxations[state.component]
            count = max(1, min(ticks, last - state.step))
            prospect = look_ahead(self.skill, relaxation, state, responses=False)
            values.append(prospect.steady[:count])
            table = self._covariance_table(state.component)
            rows = table[state.step + 1 : state.step + 1 + count].copy()
            state = self._later(state, values[-1])
            if state.step >= last:
                state = self.remap(state)
                rows[-1] = self._covariance_table(state.component)[state.step]
            covariances.append(rows)
            ticks -= count
        return np.concatenate(values), np.concatenate(covariances)

    def _later(self, state: PlaybackState, values: Array) -> PlaybackState:
        """Return the state after some ticks of its window, with their values (N, D)."""
        relaxation = self.relaxations[state.component]
        seconds = len(values) * self.tick_seconds
        wait = (seconds - state.time_since_tick) / (state.tempo or 1.0)
        return replace(
            state,
            weights=relaxation.after(state.weights, state.target, seconds),
            step=state.step + len(values),
            history=np.concatenate([state.history, values])[-self.skill.overlap :],
            offset=decayed_offset(state.offset, state.blend_time, wait)[:2],
            time_since_tick=0.0,
        )

    def _covariance_table(self, component: int) -> Array:
        """Return the covariances at the samples of a window, shape (T, D, D)."""
        if component not in self._covariances:
            steps = range(self.skill.n_steps)
            rows = [self.skill.predicted_covariance(component, k) for k in steps]
            self._covariances[component] = np.array(rows)
        return self._covariances[component]

    def rollout(self, start: ArrayLike, duration: float) -> Motion:
        """Play from one or several starts for some seconds, sampled at every tick.

        Parameters
        ----------
        start : array_like, shape (D,) or (S, D)
            The samples of start i are drawn from the seed of the player plus i.
        duration : float
            s.

        Returns
        -------
        Motion, shape (ticks + 1, 3, D) or (S, ticks + 1, 3, D)
            As returned by `motion`: `.position` has the shape (ticks + 1, D), `.time`
            (ticks + 1,).
        """
        check_number(duration, "duration", least=0, unit="s")
        starts = as_floats(start, "the start")
        ticks = int(np.floor(duration * self.skill.rate * (1 + 1e-9)))
        rows = np.atleast_2d(starts)
        out = np.empty((len(rows), ticks + 1, 3, self.skill.n_channels_))
        for i, position in enumerate(rows):
            state = self.start(position, seed=self.seed + i)
            for k in range(ticks + 1):
                out[i, k] = self.motion(state)
                state = self._tick(state, self.tick_seconds)
        time = np.arange(ticks + 1) / self.skill.rate
        return Motion(out if starts.ndim == 2 else out[0], time=time)
