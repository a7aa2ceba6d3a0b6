"""The Fourier movement primitive as a Drake system."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    EventStatus,
    LeafSystem,
    State,
    ValueProducer,
)

from fmp_drake.errors import SkillError
from fmp_drake.primitives import (
    FourierMovementPrimitive,
    PlaybackState,
    Player,
    Tracker,
)


class FourierPrimitiveSystem(LeafSystem):
    """Plays a learned skill from the measured start, for any duration.

    The Fourier weights are discrete state. Three events move them: at
    initialisation the measured position is mapped to weights (Algorithm 1); a periodic
    tick, at the rate of the skill, brings the weights closer to the mean (or a
    sample) of the active component (Algorithm 2); a periodic re-mapping, every T
    - K ticks, maps the last K desired positions to the start of a new window
    (section V-D of the paper). The outputs are exact at every time between ticks.

    Input ports
    -----------
    measured_position : (D,)
        Where the robot is, in the frame of the skill; read at initialisation.

    Output ports
    ------------
    position, velocity, acceleration : (D,)
        Desired, in the frame and units of the skill, per second and per second^2.
    covariance : (D*D,)
        Of the desired position (18), row by row.
    weights : (D*T,)
        The Fourier weights, channel by channel.
    component : (1,)
        Index of the active component j*.

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

    Notes
    -----
    A tick and a re-mapping fall on the same instant. Drake runs the unrestricted update
    (the re-mapping) first; it makes the tick that is due itself, and the discrete update
    (the tick) then finds nothing to do.
    """

    def __init__(
        self,
        skill: FourierMovementPrimitive,
        *,
        tracker: Tracker | None = None,
        sample: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.set_name("fourier_primitive")
        player = Player(skill, tracker=tracker, sample=sample, seed=seed)
        self._player = player
        d = skill.n_channels_
        start = player.start(self.resting_value(skill))
        self._weights = int(self.DeclareDiscreteState(start.weights))
        self._target = int(self.DeclareDiscreteState(start.target))
        self._history = int(self.DeclareDiscreteState(start.history.ravel()))
        self._offset = int(self.DeclareDiscreteState(start.offset.ravel()))
        # time of the last tick (s), step, component, number of re-mappings
        self._book = int(self.DeclareDiscreteState(_book(start, 0.0)))

        self._measured = self.DeclareVectorInputPort("measured_position", d)

        now = {self.time_ticket(), self.xd_ticket()}
        self._segment_cache = self.DeclareCacheEntry(
            description="desired motion of a tick",
            value_producer=ValueProducer(
                allocate=Value[object], calc=self._calc_segment
            ),
            prerequisites_of_calc={self.xd_ticket()},
        )
        self._motion_cache = self.DeclareCacheEntry(
            description="desired motion",
            value_producer=ValueProducer(
                allocate=Value[object], calc=self._calc_motion
            ),
            prerequisites_of_calc=now,
        )
        for order, name in enumerate(("position", "velocity", "acceleration")):
            self.DeclareVectorOutputPort(
                name, d, self._calc_of_motion(order), prerequisites_of_calc=now
            )
        self.DeclareVectorOutputPort(
            "covariance", d * d, self._calc_covariance, prerequisites_of_calc=now
        )
        self.DeclareVectorOutputPort(
            "weights",
            len(start.weights),
            self._calc_weights,
            prerequisites_of_calc=now,
        )
        self.DeclareVectorOutputPort(
            "component",
            1,
            self._calc_component,
            prerequisites_of_calc={self.xd_ticket()},
        )

        tick = player.tick_seconds
        remap = player.ticks_between_remaps * tick
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(tick, tick, self._tick)
        self.DeclarePeriodicUnrestrictedUpdateEvent(remap, remap, self._remap)

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
        """Return a copy of the playback's state at the last tick."""
        values = context.get_discrete_state()
        _, step, component, remaps = values.value(self._book)
        d = self._player.skill.n_channels_
        # `value` is a view of the context's memory, which a later event overwrites.
        return PlaybackState(
            weights=values.value(self._weights).copy(),
            target=values.value(self._target).copy(),
            component=int(component),
            step=int(step),
            history=values.value(self._history).reshape(-1, d).copy(),
            offset=values.value(self._offset).reshape(2, d).copy(),
            remaps=int(remaps),
        )

    def _seconds(self, context: Context) -> float:
        book = context.get_discrete_state().value(self._book)
        return float(context.get_time() - book[0])

    def _store(self, state: PlaybackState, time: float, values: DiscreteValues) -> None:
        values.set_value(self._weights, state.weights)
        values.set_value(self._target, state.target)
        values.set_value(self._history, state.history.ravel())
        values.set_value(self._offset, state.offset.ravel())
        values.set_value(self._book, _book(state, time))

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
        self._store(player.start(measured, step=step), time, values)
        return EventStatus.Succeeded()

    def _ticked(self, context: Context) -> PlaybackState | None:
        """Return the state after the tick that is due now, None where it was made."""
        if self._seconds(context) < 0.5 * self._player.tick_seconds:
            return None
        return self._player.tick(self.playback_state(context))

    def _tick(self, context: Context, values: DiscreteValues) -> EventStatus:
        state = self._ticked(context)
        if state is None:
            return EventStatus.DidNothing()
        self._store(state, context.get_time(), values)
        return EventStatus.Succeeded()

    def _remap(self, context: Context, state: State) -> EventStatus:
        playback = self._ticked(context) or self.playback_state(context)
        if playback.step != self._player.skill.n_steps - 1:
            return EventStatus.DidNothing()
        self._store(
            self._player.remap(playback),
            context.get_time(),
            state.get_mutable_discrete_state(),
        )
        return EventStatus.Succeeded()

    def _calc_segment(self, context: Any, value: Any) -> None:
        value.set_value(self._player.segment(self.playback_state(context)))

    def _calc_motion(self, context: Any, value: Any) -> None:
        segment: Any = self._segment_cache.Eval(context)
        value.set_value(segment.motion(self._seconds(context)))

    def _calc_of_motion(self, order: int) -> Callable[[Context, BasicVector], None]:
        def calc(context: Context, output: BasicVector) -> None:
            motion: Any = self._motion_cache.Eval(context)
            output.SetFromVector(motion[order])

        return calc

    def _calc_covariance(self, context: Context, output: BasicVector) -> None:
        covariance = self._player.covariance(
            self.playback_state(context), self._seconds(context)
        )
        output.SetFromVector(covariance.ravel())

    def _calc_weights(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(
            self._player.weights(self.playback_state(context), self._seconds(context))
        )

    def _calc_component(self, context: Context, output: BasicVector) -> None:
        _, _, component, _ = context.get_discrete_state().value(self._book)
        output.SetAtIndex(0, component)


def _book(state: PlaybackState, time: float) -> NDArray[np.float64]:
    return np.array([time, state.step, state.component, state.remaps], dtype=float)
