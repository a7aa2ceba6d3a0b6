"""The Fourier movement primitive as a Drake system."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    EventStatus,
    LeafSystem,
)

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, as_flag, check_number, check_type
from fmp_drake.primitives import (
    FourierMovementPrimitive,
    PlaybackState,
    Player,
    Tracker,
)
from fmp_drake.primitives.playback.motion import Segment, segment_motion
from fmp_drake.systems.ink.grid import CoverageChoice
from fmp_drake.systems.interface.callbacks import (
    declare_cache,
    eval_cache,
    eval_number,
)

Calc = Callable[[Context, BasicVector], None]

MAX_TEMPO = 4.0
"""Fastest tempo; 1 is as demonstrated."""

# The tempo changes at most by this, per second.
_TEMPO_RATE = 5.0
# Time constant of the offset after a re-mapping to a pushed robot, s.
_PUSHED_BLEND_TIME = 0.15
# A measured value is plausible up to this distance from the middle of the demonstrated
# values, in widths of the widest channel of its unit; at least up to the distance below.
_PLAUSIBLE_WIDTHS = 10.0
_PLAUSIBLE = {"m": 2.0, "rad": 4 * math.pi, "N": 200.0}
# Longest plan, s.
_LONGEST_PLAN = 600.0
# Difference of equal times, relative to them and to 1 s: Drake adds up periods.
_SAME = 1e-12
# Time for which the last plausible measurement is used instead of a missing one, s.
_MEASUREMENT_EXPIRY = 0.5


class FourierPrimitiveSystem(LeafSystem):
    """Plays a learned skill from the measured start, for any duration.

    The discrete state is a `PlaybackState`, with the Fourier weights, at the last
    event. At initialisation the measured position is mapped to weights (Algorithm
    1). Then one periodic event, at the rate of the skill, brings the weights closer to
    the mean (or a sample) of the active component (Algorithm 2), and re-maps them every
    T - K samples, or somewhat earlier: the last K desired positions become the start of
    a new window (section V-D of the paper). The outputs follow from that state in closed
    form, so they are exact at every time between two events. Position and velocity are
    continuous at a re-mapping. The acceleration jumps: with a mixture of the bundled
    figure 8 by 0.2 to 0.7 m/s^2, where its greatest value is 1.7; with a phase model by
    0.03 m/s^2 at most.

    In the reactive mode the movement waits for a robot that is pushed off its path: it
    slows down above half of `push_threshold` and stands still beyond it. After a push of
    `push_dwell` the last K measured positions are mapped to a new window, so that the
    movement continues from the present position of the robot.

    A measured position that is not finite, or far outside the demonstrations, is an error
    at initialisation. Later, in the reactive mode, the last plausible one is used instead,
    for 0.5 s. Then the movement stands still until the measurement is plausible again.

    A simulation may begin at any time. A Context that has been played, saved or cloned
    continues in another Simulator; to begin anew, give it the default state first.

    Where a diagram has several, give each its name by `DiagramBuilder.AddNamedSystem`: Drake
    ends the program (SystemExit) where two systems of a diagram have one name.

    Input ports
    -----------
    measured_position : (D,)
        Position of the robot in the frame of the skill; read at initialisation and, in
        the reactive mode, at every event.
    tempo : (1,), optional
        Skill time per real time, from 0 to `MAX_TEMPO`; 1 where unconnected.
        Read at every event; the tempo changes by at most 5 per second.
    sample : (1,), optional
        Whether a sample (0.5 or more) or a mean is tracked after the next re-mapping;
        the parameter where unconnected.
    ink : (ny nx,)
        Remaining ink in the cells of the choice's grid; only with a choice.

    Output ports
    ------------
    position, velocity, acceleration : (D,)
        Desired, in the frame and units of the skill, per second and per second^2.
    motion : (3*D,)
        Position, velocity and acceleration, by one evaluation.
    covariance : (D*D,)
        Of the demonstrations about the desired position (18), row by row.
    weights : (D*T,)
        The Fourier weights, channel by channel.
    component : (1,)
        Index of the active component j*.
    phase : (1,)
        Phase of the desired motion, rad, from 0 to 2 pi; only where the skill has a
        phase model.
    plan : (P*D,)
        Desired positions at the last event and the ticks after it, without disturbances.
    plan_covariance : (P*D*D,)
        Of the plan: (18) and the prediction errors.
    remaps : (2,)
        Number of re-mappings, and of the reactive ones among them.
    measurement_age : (1,)
        Time since the measured position was plausible, s; 0 while it is, and outside the
        reactive mode. At 0.5 s or more the movement stands still.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    tracker : Tracker, optional
        `LqrTracker()` where None.
    sample : bool
        Track samples of the components instead of their means.
    seed : int
        Of the samples.
    push_threshold : float, optional
        Distance between measured and desired position above which the robot counts as
        pushed, over the channels in m (over all where none is); None for no reactive mode.
    push_dwell : float
        Duration of a push before the measured motion is mapped, s.
    plan_seconds : float
        Length of the plan, s; at most 600.
    choice : fmp_drake.systems.ink.grid.CoverageChoice, optional
        Choice of the sample that passes over the most ink until the next re-mapping, at
        the start and after each re-mapping. For skills of 3 position channels in the
        frame of the board.
    margin : float or "automatic", optional
        Largest distance of samples from the demonstrated paths, m, as for `Player`; None
        for no bound.
    soft_start : bool
        Begin with the tempo 0, so that a robot at rest follows the path of the skill
        from the start. It is otherwise off the path by the distance that the skill
        moves in 0.15 s. The movement begins at the first event, a multiple of the skill's
        tick (0.05 s at 20 Hz): up to a tick after the initialisation.

    Examples
    --------
    >>> import numpy as np
    >>> from pydrake.systems.analysis import Simulator
    >>> from fmp_drake.primitives import FourierMovementPrimitive
    >>> from fmp_drake.systems import FourierPrimitiveSystem
    >>> t = np.arange(1200) / 20
    >>> circles = np.stack([np.cos(2 * t), np.sin(2 * t)], axis=1)
    >>> windows = np.stack([circles[i : i + 120] for i in range(0, 1080, 5)])
    >>> skill = FourierMovementPrimitive(n_components=16).fit(windows)
    >>> system = FourierPrimitiveSystem(skill)
    >>> simulator = Simulator(system)
    >>> context = simulator.get_mutable_context()
    >>> start = system.GetInputPort("measured_position").FixValue(context, [1.5, 0.0])
    >>> status = simulator.AdvanceTo(20.0)
    >>> position = system.GetOutputPort("position").Eval(context)
    >>> print(round(float(np.hypot(*position)), 1))
    1.0
    """

    def __init__(
        self,
        skill: FourierMovementPrimitive,
        *,
        tracker: Tracker | None = None,
        sample: bool = False,
        seed: int = 0,
        push_threshold: float | None = None,
        push_dwell: float = 0.2,
        plan_seconds: float = 3.0,
        choice: CoverageChoice | None = None,
        margin: float | Literal["automatic"] | None = "automatic",
        soft_start: bool = False,
    ) -> None:
        super().__init__()
        self.set_name("fourier_primitive")
        sample = as_flag(sample, "sample", error=SystemsError)
        player = Player(skill, tracker=tracker, sample=sample, seed=seed, margin=margin)
        self._player = player
        if push_threshold is not None:
            check_number(push_threshold, "push_threshold", above=0, error=SystemsError)
        check_number(push_dwell, "push_dwell", above=0, unit="s", error=SystemsError)
        check_number(
            plan_seconds,
            "plan_seconds",
            above=0,
            most=_LONGEST_PLAN,
            unit="s",
            error=SystemsError,
        )
        if choice is not None:
            check_type(choice, "choice", CoverageChoice, error=SystemsError)
        self._push_threshold = push_threshold
        # The distance of a push is measured over the channels in m, without rotations
        # and forces.
        lengths = [i for i, unit in enumerate(skill.units_) if unit == "m"]
        self._lengths = lengths or list(range(skill.n_channels_))
        low, high = skill.extent_
        units = np.array(skill.units_)
        widths = [np.max((high - low)[units == unit]) for unit in units]
        self._centre = (low + high) / 2
        self._max_deviation = np.array(
            [
                max(_PLAUSIBLE_WIDTHS * width, _PLAUSIBLE.get(unit, 0.0)) or math.inf
                for width, unit in zip(widths, skill.units_, strict=True)
            ]
        )
        self._push_dwell = push_dwell
        self._plan_ticks = math.ceil(plan_seconds / player.tick_seconds - 1e-6)
        self._choice = choice
        self._soft_start = as_flag(soft_start, "soft_start", error=SystemsError)
        d = skill.n_channels_

        # Until the initialisation: the mean value of the likeliest component.
        rest = skill.synthesize(skill.components_[0].mean).mean(axis=0)
        start = player.start(rest)
        self._playback = [
            int(self.DeclareDiscreteState(array)) for array in start.to_arrays()
        ]
        # Times of the last event and of the start (minus infinity: never), start of the
        # present push (infinity: none), number of reactive re-mappings, and time of the
        # first of the present implausible measurements (infinity: none).
        events = np.array([-math.inf, -math.inf, math.inf, 0.0, math.inf])
        self._events = int(self.DeclareDiscreteState(events))
        # The last K measured positions, the newest last.
        measurements = start.history.ravel()
        self._measurements = int(self.DeclareDiscreteState(measurements))

        self._measured = self.DeclareVectorInputPort("measured_position", d)
        self._tempo = self.DeclareVectorInputPort("tempo", 1)
        self._sample = self.DeclareVectorInputPort("sample", 1)
        if choice is not None:
            self._ink = self.DeclareVectorInputPort("ink", choice.grid.num_cells)
        self._declare_outputs(d, len(start.weights))
        period = player.tick_seconds
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._update)

    def _declare_outputs(self, d: int, weights: int) -> None:
        state, now = {self.xd_ticket()}, {self.time_ticket(), self.xd_ticket()}

        self._segments = declare_cache(
            self, "segments until the next event", self._calc_segments, state
        )
        plan = declare_cache(self, "plan", self._calc_plan, state)
        declare = self.DeclareVectorOutputPort
        motion = declare("motion", 3 * d, self._calc_motion, now)
        for order, name in enumerate(("position", "velocity", "acceleration")):
            declare(name, d, self._calc_part_of(motion.Eval, order), now)
        player = self._player
        declare("covariance", d * d, self._calc_of(player.variation), now)
        declare("weights", weights, self._calc_of(player.weights), now)
        declare("component", 1, self._calc_of(lambda state: state.component), now)
        if player.skill.phase_model_ is not None:
            declare("phase", 1, self._calc_of(player.phase), now)
        points = self._plan_ticks + 1
        for order, (name, size) in enumerate((("plan", d), ("plan_covariance", d * d))):
            part = self._calc_part_of(partial(eval_cache, self, plan), order)
            declare(name, points * size, part, state)
        declare("remaps", 2, self._calc_remaps, now)
        declare("measurement_age", 1, self._calc_measurement_age, now)

    @property
    def player(self) -> Player:
        """The playback that this system adapts; it holds no values of a run."""
        return self._player

    # State --------------------------------------------------------------------

    def playback_state(self, context: Context) -> PlaybackState:
        """Return the state of the playback at the time of a context of this system.

        Where the time has been set back before the last event, it is that of this event.
        """
        self.ValidateContext(context)
        elapsed = max(context.get_time() - self._last_event(context), 0.0)
        return self._player.advance(self._read(context), elapsed)

    def set_playback_state(self, context: Context, state: PlaybackState) -> None:
        """Store a playback as of the time of a context of this system.

        A simulation continues it, also from its beginning. The motion does not jump where the
        state is one of `playback_state`, changed by the methods of `player`.

        Parameters
        ----------
        context : Context
        state : PlaybackState
            Of a player of the same skill.

        Raises
        ------
        SystemsError
            If its arrays do not have the sizes of the skill.
        """
        self.ValidateContext(context)
        PlaybackState.check(state)
        values = context.get_mutable_discrete_state()
        sizes = [array.size for array in state.to_arrays()]
        wanted = [values.value(index).size for index in self._playback]
        if sizes != wanted:
            raise SystemsError(
                f"{self.get_name()}: the arrays of the playback have the sizes {sizes}, those "
                f"of this skill {wanted}; give a playback of the same skill."
            )
        events = (context.get_time(), -math.inf, math.inf, 0.0, math.inf)
        self._store(values, state, events=events, measurements=state.history)

    def _last_event(self, context: Context) -> float:
        """Return the time of the last event, s; now where there was none."""
        last = float(context.get_discrete_state().value(self._events)[0])
        return context.get_time() if last == -math.inf else last

    def _read(self, context: Context) -> PlaybackState:
        """Return the playback at the last event."""
        values = context.get_discrete_state()
        return PlaybackState.from_arrays(
            [values.value(index) for index in self._playback],
            channels=self._player.skill.n_channels_,
        )

    def _store(
        self,
        values: DiscreteValues,
        state: PlaybackState,
        *,
        events: tuple[float, float, float, float, float],
        measurements: Array,
    ) -> None:
        for index, array in zip(self._playback, state.to_arrays(), strict=True):
            values.set_value(index, array)
        values.set_value(self._events, np.array(events))
        values.set_value(self._measurements, measurements.ravel())

    # Events -------------------------------------------------------------------

    def _initialize(self, context: Context, values: DiscreteValues) -> EventStatus:
        player, time = self._player, context.get_time()
        last, begin, *_ = context.get_discrete_state().value(self._events).tolist()
        if begin < time and 0 <= time - last <= player.tick_seconds * (1 + 1e-9):
            return EventStatus.DidNothing()  # The playback continues.
        measured: Any = self._measured.Eval(context)
        self._check_start(measured)
        tempo = 0.0 if self._soft_start else self._tempo_input(context)
        start = player.start(measured, tempo=tempo)
        start = replace(start, sample=self._sample_input(context))
        self._store(
            values,
            self._with_selected_sample(context, start),
            events=(time, time, math.inf, 0.0, math.inf),
            measurements=start.history,
        )
        return EventStatus.Succeeded()

    def _update(self, context: Context, values: DiscreteValues) -> EventStatus:
        """Advance the playback to now, read the inputs, store it."""
        player, time = self._player, context.get_time()
        last_event, begin, pushed_since, reactive, missing_since = (
            context.get_discrete_state().value(self._events).tolist()
        )
        # A Simulator of a cloned Context triggers an event of that time once more, and one that
        # does not begin at 0 an event of the time of initialization.
        if begin <= last_event and abs(time - last_event) < _SAME * max(abs(time), 1):
            return EventStatus.DidNothing()
        before = self._read(context)
        state = player.advance(before, max(time - self._last_event(context), 0.0))
        measurements = context.get_discrete_state().value(self._measurements)
        measurements = measurements.reshape(state.history.shape)
        tempo = self._tempo_input(context)
        state = replace(state, sample=self._sample_input(context))
        ratio = 0.0
        if self._push_threshold is not None:
            measured: Any = self._measured.Eval(context)
            is_missing = not self._is_plausible(measured)
            if is_missing:
                measured = measurements[-1]
            missing_since = min(missing_since, time) if is_missing else math.inf
            measurements = np.concatenate([measurements[1:], measured[None]])
            error = (measured - player.motion(state)[0])[self._lengths]
            ratio = float(np.linalg.norm(error)) / self._push_threshold
            is_pushed = ratio > 1 and not is_missing
            pushed_since = min(pushed_since, time) if is_pushed else math.inf
            tempo *= min(max(2 - 2 * ratio, 0.0), 1.0)
            if time - missing_since > _MEASUREMENT_EXPIRY - 1e-6:
                tempo = 0.0
            if time - pushed_since > self._push_dwell - 1e-6:
                state = player.remap(state, observed=measurements)
                blend_time = min(_PUSHED_BLEND_TIME, state.blend_time)
                state = replace(state, blend_time=blend_time)
                pushed_since, reactive = math.inf, reactive + 1
        if ratio < 0.5:
            state = replace(state, blend_time=player.blend_time_of(state))
        if state.remaps != before.remaps:
            state = self._with_selected_sample(context, state)
        rate = (tempo - state.tempo) / player.tick_seconds
        state = replace(state, tempo_rate=min(max(rate, -_TEMPO_RATE), _TEMPO_RATE))
        self._store(
            values,
            state,
            events=(time, begin, pushed_since, reactive, missing_since),
            measurements=measurements,
        )
        return EventStatus.Succeeded()

    def _is_plausible(self, measured: Array) -> bool:
        # NaN compares as false.
        return bool(np.all(np.abs(measured - self._centre) <= self._max_deviation))

    def _check_start(self, measured: Array) -> None:
        if not self._is_plausible(measured):
            lowest = self._centre - self._max_deviation
            highest = self._centre + self._max_deviation
            raise SystemsError(
                f"{self.get_name()}: the measured position is {measured}; it must be from "
                f"{lowest} to {highest}, near the demonstrations. Check the measurement, "
                "its frame and its unit."
            )

    def _with_selected_sample(
        self, context: Context, state: PlaybackState
    ) -> PlaybackState:
        """Return the state that tracks the sample of the choice, if there is a choice."""
        if self._choice is None or not state.sample:
            return state
        ink: Any = self._ink.Eval(context)
        ink = ink.reshape(self._choice.grid.shape)
        return self._choice.tracked(self._player, state, ink)

    def _tempo_input(self, context: Context) -> float:
        tempo = eval_number(self._tempo, context, 1.0)
        what = f"{self.get_name()}: the tempo"
        check_number(tempo, what, least=0, most=MAX_TEMPO, error=SystemsError)
        return tempo

    def _sample_input(self, context: Context) -> bool:
        sample = eval_number(self._sample, context, float(self._player.sample))
        check_number(sample, f"{self.get_name()}: the sample", error=SystemsError)
        return sample >= 0.5

    # Outputs ------------------------------------------------------------------

    def _calc_segments(self, context: Any, value: Any) -> None:
        """Find the time of the last event, and the segments until the next one."""
        player, state = self._player, self._read(context)
        segments: list[tuple[float, Segment]] = []
        begin = 0.0
        while True:
            segments.append((begin, player.segment(state)))
            wait = state.seconds_until(player.tick_seconds)
            begin += wait
            if begin > player.tick_seconds * (1 - 1e-6):
                break
            state = player.advance(state, wait)
        value.set_value((self._last_event(context), segments))

    def _calc_motion(self, context: Context, output: BasicVector) -> None:
        cached: Any = eval_cache(self, self._segments, context)
        last_event, segments = cached
        elapsed = context.get_time() - last_event
        # There may have been no event for longer than a tick.
        if not -1e-6 <= elapsed <= self._player.tick_seconds + 1e-6:
            motion = self._player.motion(self.playback_state(context))
            output.SetFromVector(motion.ravel())
            return
        begin, segment = segments[0]
        for later, candidate in segments[1:]:
            if later < elapsed:
                begin, segment = later, candidate
        output.SetFromVector(segment_motion(segment, elapsed - begin).ravel())

    def _calc_plan(self, context: Any, value: Any) -> None:
        value.set_value(self._player.plan(self._read(context), self._plan_ticks))

    @staticmethod
    def _calc_part_of(evaluate: Callable[[Context], Any], order: int) -> Calc:
        def calc(context: Context, output: BasicVector) -> None:
            value = evaluate(context)
            parts = value if isinstance(value, tuple) else value.reshape(3, -1)
            output.SetFromVector(np.ravel(parts[order]))

        return calc

    def _calc_of(self, what: Callable[[PlaybackState], Any]) -> Calc:
        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(np.ravel(what(self.playback_state(context))))

        return calc

    def _calc_remaps(self, context: Context, output: BasicVector) -> None:
        reactive = context.get_discrete_state().value(self._events)[3]
        remaps = self.playback_state(context).remaps
        output.SetFromVector(np.array([remaps, reactive]))

    def _calc_measurement_age(self, context: Context, output: BasicVector) -> None:
        missing_since = context.get_discrete_state().value(self._events)[4]
        age = max(context.get_time() - missing_since, 0.0)
        output.SetFromVector(np.array([age]))
