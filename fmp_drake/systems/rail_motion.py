"""Desired motion of a board on a rail."""

import math
from functools import partial

import numpy as np
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    EventStatus,
    LeafSystem,
)

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number


class RailMotion(LeafSystem):
    """Oscillation along a rail, from rest at its negative end.

    The discrete state is the time at which the simulation began, so the motion begins at
    rest whatever that time is. The initialisation of a Context that was saved or cloned
    leaves it. Before the initialisation the board is at the beginning of its motion.

    Output ports
    ------------
    position, velocity, acceleration : (1,)
        m, and per second and second^2.

    Parameters
    ----------
    amplitude : float
        m.
    frequency : float
        Hz.

    Examples
    --------
    >>> from pydrake.systems.analysis import Simulator
    >>> rail = RailMotion(amplitude=0.1, frequency=0.5)
    >>> simulator = Simulator(rail)
    >>> context = simulator.get_mutable_context()
    >>> context.SetTime(7.0)
    >>> _ = simulator.AdvanceTo(8.0)
    >>> rail.GetOutputPort("position").Eval(context)
    array([0.1])
    """

    def __init__(self, *, amplitude: float, frequency: float) -> None:
        super().__init__()
        self.set_name("rail")
        check_number(amplitude, "amplitude", least=0, unit="m", error=SystemsError)
        check_number(frequency, "frequency", above=0, unit="Hz", error=SystemsError)
        self._amplitude, self._omega = amplitude, 2 * math.pi * frequency
        # Minus infinity before the initialisation.
        self._begin = int(self.DeclareDiscreteState(np.array([-math.inf])))
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        now = {self.time_ticket(), self.xd_ticket()}
        for order, name in enumerate(("position", "velocity", "acceleration")):
            self.DeclareVectorOutputPort(name, 1, partial(self._calc, order), now)

    def _initialize(self, context: Context, values: DiscreteValues) -> EventStatus:
        if math.isfinite(context.get_discrete_state().value(self._begin)[0]):
            return EventStatus.DidNothing()
        values.set_value(self._begin, np.array([context.get_time()]))
        return EventStatus.Succeeded()

    def _calc(self, order: int, context: Context, output: BasicVector) -> None:
        begin = float(context.get_discrete_state().value(self._begin)[0])
        elapsed = context.get_time() - begin if math.isfinite(begin) else 0.0
        phase = self._omega * elapsed - math.pi / 2
        value = (
            self._amplitude * math.sin(phase),
            self._amplitude * self._omega * math.cos(phase),
            -self._amplitude * self._omega**2 * math.sin(phase),
        )[order]
        output.SetFromVector(np.array([value]))
