"""The Fourier movement primitive as a Drake system."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import (
    BasicVector,
    CacheEntry,
    Context,
    DiscreteValues,
    EventStatus,
    LeafSystem,
    ValueProducer,
)

from fmp_drake.errors import SkillError
from fmp_drake.primitives import (
    FourierMovementPrimitive,
    PlaybackState,
    Player,
    Tracker,
)
from fmp_drake.primitives.playback.live_playback import (
    LivePlayback,
    LiveState,
    remapped,
    retargeted,
)
from fmp_drake.systems.ink.coverage_choice import CoverageChoice
from fmp_drake.systems.playback_book import PlaybackBook

MAX_TEMPO = 4.0
"""Fastest tempo; 1 is as demonstrated."""

# The tempo changes at most by this, per second.
_TEMPO_RATE = 4.0
# How fast the desired motion comes to a robot that is led elsewhere, s.
_PUSHED_BLEND_TIME = 0.15


class FourierPrimitiveSystem(LeafSystem):
    """Plays a learned skill from the measured start, for any duration.

    The Fourier weights are discrete state. Events move them: at initialisation the
    measured position is mapped to weights (Algorithm 1); periodic ticks, at the
    rate of the skill, bring the weights closer to the mean (or a sample) of the
    active component (Algorithm 2), and every T - K ticks they are re-mapped: the last K
    desired positions become the start of a new window (section V-D of the paper).
    The outputs are exact at every time between ticks, and no re-mapping makes
    them jump.

    In the reactive mode the movement waits for a robot that is pushed off its path: it
    slows down from half of `push_threshold` on and stands still beyond it. And
    once that has lasted for `push_dwell`, the last K measured positions are mapped to a
    new window, so that the movement goes on from where the robot was led to.

    Input ports
    -----------
    measured_position : (D,)
        Where the robot is, in the frame of the skill; read at initialisation and, in
        the reactive mode, at every tick.
    tempo : (1,), optional
        How fast the movement is played, from 0 to `MAX_TEMPO`; 1 where unconnected.
        Read at every event; the tempo changes by at most 4 per second.
    ink : (ny nx,)
        What is left in the cells of the choice's grid; only where there is a choice.
    sample : (1,), optional
        From 0.5 on, what is tracked after the next re-mapping is a sample, below a
        mean; the parameter where unconnected.

    Output ports
    ------------
    position, velocity, acceleration : (D,)
        Desired, in the frame and units of the skill, per second and per second^2.
    jerk : (D,)
        How the desired acceleration goes on, per second^3: its mean change over the
        next `jerk_window`.
    covariance : (D*D,)
        Of the desired position (18), row by row.
    weights : (D*T,)
        The Fourier weights, channel by channel.
    component : (1,)
        Index of the active component j*.
    plan : (P*D,)
        Desired positions from the last event on, tick by tick: where the movement
        leads to if nothing interferes.
    plan_covariance : (P*D*D,)
        Of the plan (18).
    remaps : (2,)
        How many re-mappings there were, and how many of them were reactive.

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
        Distance between measured and desired position from which on the robot counts
        as pushed, in the units of the skill (m); None for no reactive mode.
    push_dwell : float
        How long it must have been pushed before its motion is mapped, s.
    plan_seconds : float
        Length of the plan, s.
    jerk_window : float
        What the jerk is a mean over, s: how long a controller holds it.
    event_period : float, optional
        Longest time between two periodic events, s. Each makes the ticks that are due,
        reads the inputs and stores the state; several ticks at once take less time.
        Where None, and in the reactive mode, it is a tick.
    choice : CoverageChoice, optional
        After each re-mapping, of several samples the one is tracked that passes over the
        most ink. For skills of 3 position channels in the frame of the board.
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
        jerk_window: float = 0.025,
        event_period: float | None = None,
        choice: CoverageChoice | None = None,
    ) -> None:
        super().__init__()
        self.set_name("fourier_primitive")
        player = Player(skill, tracker=tracker, sample=sample, seed=seed)
        self._player = player
        for name, value in {
            "push_threshold": push_threshold,
            "push_dwell": push_dwell,
            "plan_seconds": plan_seconds,
            "jerk_window": jerk_window,
            "event_period": event_period,
        }.items():
            if value is not None and not (math.isfinite(value) and value > 0):
                raise SkillError(f"{name} is {value}; it must be positive.")
        self._push_threshold = push_threshold
        self._push_dwell = push_dwell
        self._ticks_per_event = 1
        if event_period is not None and push_threshold is None:
            self._ticks_per_event = _ticks_within(player, event_period)
        self._jerk_window = jerk_window
        self._plan_ticks = math.ceil(plan_seconds / player.tick_seconds - 1e-6)
        d = skill.n_channels_
        start = player.start(self.resting_value(skill))
        self._weights = int(self.DeclareDiscreteState(start.weights))
        self._target = int(self.DeclareDiscreteState(start.target))
        self._history = int(self.DeclareDiscreteState(start.history.ravel()))
        self._offset = int(self.DeclareDiscreteState(start.offset.ravel()))
        self._measurements = int(self.DeclareDiscreteState(start.history.ravel()))
        self._book = int(
            self.DeclareDiscreteState(
                np.array(PlaybackBook(start.step, blend_time=player.blend_time))
            )
        )

        self._measured = self.DeclareVectorInputPort("measured_position", d)
        self._tempo = self.DeclareVectorInputPort("tempo", 1)
        self._sample = self.DeclareVectorInputPort("sample", 1)
        self._choice = choice
        if choice is not None:
            self._ink = self.DeclareVectorInputPort("ink", choice.grid.num_cells)
        self._declare_outputs(d, len(start.weights))
        self._period = period = self._ticks_per_event * player.tick_seconds
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._tick)

    def _declare_outputs(self, d: int, weights: int) -> None:
        state, now = {self.xd_ticket()}, {self.time_ticket(), self.xd_ticket()}
        self._playback = self.DeclareCacheEntry(
            description="playback from the last event on",
            value_producer=ValueProducer(
                allocate=Value[object], calc=self._calc_playback
            ),
            prerequisites_of_calc=state,
        )
        self._motion = self.DeclareCacheEntry(
            description="desired motion",
            value_producer=ValueProducer(
                allocate=Value[object], calc=self._calc_motion
            ),
            prerequisites_of_calc=now,
        )
        self._plan = self.DeclareCacheEntry(
            description="plan",
            value_producer=ValueProducer(allocate=Value[object], calc=self._calc_plan),
            prerequisites_of_calc=state,
        )
        declare = self.DeclareVectorOutputPort
        for order, name in enumerate(("position", "velocity", "acceleration", "jerk")):
            calc = self._calc_part_of(self._motion, order)
            declare(name, d, calc, prerequisites_of_calc=now)
        declare("covariance", d * d, self._calc_covariance, prerequisites_of_calc=now)
        declare("weights", weights, self._calc_weights, prerequisites_of_calc=now)
        declare("component", 1, self._calc_component, prerequisites_of_calc=now)
        points = self._plan_ticks + 1
        for order, (name, size) in enumerate(
            {"plan": d, "plan_covariance": d**2}.items()
        ):
            calc = self._calc_part_of(self._plan, order)
            declare(name, points * size, calc, prerequisites_of_calc=state)
        declare("remaps", 2, self._calc_remaps, prerequisites_of_calc=now)

    @staticmethod
    def resting_value(skill: FourierMovementPrimitive) -> NDArray[np.float64]:
        """Return the mean value of the likeliest component, shape (D,)."""
        first = skill.components_[0].mean
        return skill.synthesize(first).mean(axis=0)

    @property
    def player(self) -> Player:
        """The pure playback that this system adapts."""
        return self._player

    def playback_state(self, context: Context) -> PlaybackState:
        """Return the playback's state at the last tick, its offset of that time."""
        live, seconds = self._live(context)
        return replace(live.playback(seconds)[0], offset=live.state.offset)

    # State --------------------------------------------------------------------

    def _read_book(self, context: Context) -> PlaybackBook:
        return PlaybackBook(*context.get_discrete_state().value(self._book).tolist())

    def _read(self, context: Context) -> LiveState:
        values, book = context.get_discrete_state(), self._read_book(context)
        d = self._player.skill.n_channels_
        # `value` is a view of the context's memory, which a later event overwrites.
        return LiveState(
            playback=PlaybackState(
                weights=values.value(self._weights).copy(),
                target=values.value(self._target).copy(),
                component=int(book.component),
                step=int(book.step),
                history=values.value(self._history).reshape(-1, d).copy(),
                offset=np.zeros((2, d)),
                remaps=int(book.remaps),
            ),
            offset=values.value(self._offset).reshape(2, d).copy(),
            rest=book.rest,
            tempo=book.tempo,
            slope=book.slope,
            sample=book.sample > 0,
            blend_time=book.blend_time,
        )

    def _store(
        self,
        values: DiscreteValues,
        state: LiveState,
        measurements: NDArray[np.float64],
        book: PlaybackBook,
    ) -> None:
        playback = state.playback
        values.set_value(self._weights, playback.weights)
        values.set_value(self._target, playback.target)
        values.set_value(self._history, playback.history.ravel())
        values.set_value(self._offset, state.offset.ravel())
        values.set_value(self._measurements, measurements.ravel())
        book = book._replace(
            step=playback.step,
            component=playback.component,
            remaps=playback.remaps,
            rest=state.rest,
            tempo=state.tempo,
            slope=state.slope,
            sample=state.sample,
            blend_time=state.blend_time,
        )
        values.set_value(self._book, np.array(book, dtype=float))

    def _live(self, context: Context) -> tuple[LivePlayback, float]:
        """Return the playback from the last event on, and the seconds since."""
        cached: Any = self._playback.Eval(context)
        live, time = cached
        return live, context.get_time() - time

    # Events -------------------------------------------------------------------

    def _initialize(self, context: Context, values: DiscreteValues) -> EventStatus:
        player = self._player
        time = context.get_time()
        ticks = round(time / player.tick_seconds)
        if abs(ticks * player.tick_seconds - time) > 1e-9:
            raise SkillError(
                f"{self.get_name()}: the simulation starts at {time} s; it must start "
                f"at a multiple of the skill's tick of {player.tick_seconds} s."
            )
        first = player.skill.overlap - 1
        step = first + ticks % player.ticks_between_remaps
        measured: Any = self._measured.Eval(context)
        start = player.start(measured, step=step)
        tempo = self._wanted_tempo(context)
        # The start is at rest in real time: the weights' velocity is scaled.
        path = player.motion(replace(start, offset=np.zeros_like(start.offset)))
        state = LiveState(
            playback=replace(start, offset=np.zeros_like(start.offset)),
            offset=np.stack([measured - path[0], -tempo * path[1]]),
            tempo=tempo,
            sample=self._wanted_sample(context),
            blend_time=player.blend_time,
        )
        self._store(values, state, start.history, PlaybackBook(step, time=time))
        return EventStatus.Succeeded()

    def _tick(self, context: Context, values: DiscreteValues) -> EventStatus:
        live, seconds = self._live(context)
        before = self._read_book(context)
        state, measurements, book = self._ticked(context, live, seconds, before)
        if book.time - book.pushed_since > self._push_dwell - 1e-6:
            playback, offset = remapped(
                self._player,
                state.playback,
                state.offset,
                tempo=state.tempo,
                seconds=state.rest,
                observed=measurements,
                sample=state.sample,
            )
            state = replace(
                state,
                playback=playback,
                offset=offset,
                rest=0.0,
                blend_time=min(_PUSHED_BLEND_TIME, self._player.blend_time),
            )
            book = book._replace(pushed_since=math.inf, reactive=book.reactive + 1)
        is_new = state.playback.remaps != before.remaps
        if is_new and self._choice is not None and state.sample:
            state = self._chosen(context, state, self._choice)
        self._store(values, state, measurements, book)
        return EventStatus.Succeeded()

    def _chosen(
        self, context: Context, live: LiveState, choice: CoverageChoice
    ) -> LiveState:
        """Return the state that tracks the sample that wipes most."""
        ink: Any = self._ink.Eval(context)
        player = self._player
        targets = player.candidates(live.playback, choice.candidates)
        paths = player.skill.synthesize(targets)
        best = choice.best(ink.reshape(choice.grid.shape), paths)
        playback, offset = retargeted(
            player,
            live.playback,
            live.offset,
            target=targets[best],
            tempo=live.tempo,
            seconds=live.rest,
        )
        return replace(live, playback=playback, offset=offset)

    def _ticked(
        self,
        context: Context,
        live: LivePlayback,
        seconds: float,
        book: PlaybackBook,
    ) -> tuple[LiveState, NDArray[np.float64], PlaybackBook]:
        """Return state, measurements and book after the ticks that are due now."""
        state = live.after(seconds)
        d = self._player.skill.n_channels_
        measurements = context.get_discrete_state().value(self._measurements)
        measurements = measurements.reshape(-1, d).copy()
        wanted, since = self._wanted_tempo(context), math.inf
        if self._push_threshold is not None:
            measured: Any = self._measured.Eval(context)
            measurements = np.concatenate([measurements[1:], measured[None]])
            off = np.linalg.norm(measured - live.motion(seconds)[0])
            off = float(off) / self._push_threshold
            if off > 1:
                since = min(book.pushed_since, context.get_time())
            elif off < 0.5:
                state = replace(state, blend_time=self._player.blend_time)
            wanted *= min(max(2 - 2 * off, 0.0), 1.0)
        slope = (wanted - state.tempo) / self._period
        state = replace(
            state,
            slope=min(max(slope, -_TEMPO_RATE), _TEMPO_RATE),
            sample=self._wanted_sample(context),
        )
        book = book._replace(time=context.get_time(), pushed_since=since)
        return state, measurements, book

    def _wanted_tempo(self, context: Context) -> float:
        if not self._tempo.HasValue(context):
            return 1.0
        port: Any = self._tempo.Eval(context)
        tempo = float(port[0])
        if not 0 <= tempo <= MAX_TEMPO:
            raise SkillError(
                f"{self.get_name()}: the tempo is {tempo}; it must be from 0 to "
                f"{MAX_TEMPO:g}."
            )
        return tempo

    def _wanted_sample(self, context: Context) -> bool:
        if not self._sample.HasValue(context):
            return self._player.sample
        port: Any = self._sample.Eval(context)
        return bool(port[0] >= 0.5)

    # Outputs ------------------------------------------------------------------

    def _calc_playback(self, context: Any, value: Any) -> None:
        live = LivePlayback(
            self._player, self._read(context), ticks_at_once=self._ticks_per_event
        )
        value.set_value((live, self._read_book(context).time))

    def _calc_motion(self, context: Any, value: Any) -> None:
        live, seconds = self._live(context)
        value.set_value(live.motion_and_jerk(seconds, self._jerk_window))

    def _calc_plan(self, context: Any, value: Any) -> None:
        state = self._read(context)
        start = replace(state.playback, offset=state.offset)
        value.set_value(self._player.plan(start, self._plan_ticks, sample=state.sample))

    @staticmethod
    def _calc_part_of(
        cache: CacheEntry, order: int
    ) -> Callable[[Context, BasicVector], None]:
        def calc(context: Context, output: BasicVector) -> None:
            parts: Any = cache.Eval(context)
            output.SetFromVector(parts[order].ravel())

        return calc

    def _now(self, context: Context) -> tuple[PlaybackState, float]:
        live, seconds = self._live(context)
        return live.playback(seconds)

    def _calc_covariance(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._player.covariance(*self._now(context)).ravel())

    def _calc_weights(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._player.weights(*self._now(context)))

    def _calc_component(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._now(context)[0].component)

    def _calc_remaps(self, context: Context, output: BasicVector) -> None:
        book = self._read_book(context)
        output.SetFromVector(np.array([self._now(context)[0].remaps, book.reactive]))


def _ticks_within(player: Player, seconds: float) -> int:
    """Return how many ticks fit in some seconds, a divisor of those between re-maps."""
    most = max(math.floor(seconds / player.tick_seconds * (1 + 1e-9)), 1)
    divides = [n for n in range(1, most + 1) if player.ticks_between_remaps % n == 0]
    return max(divides)
