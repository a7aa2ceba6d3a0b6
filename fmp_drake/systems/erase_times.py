"""Times at which the cells of a board became clean."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    LeafSystem,
)

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, as_floats, check_number
from fmp_drake.systems.ink.grid import CLEAN_BELOW

NEVER = math.inf
"""Erase time of a cell that has not been erased."""


class EraseTimes(LeafSystem):
    """Times at which the ink of the cells fell below 10 %.

    An `InkBoard` does not depend on it, so it is not part of a station; runs add it to
    their diagram.

    Input port ``ink`` (N,): of an `InkBoard`, or any ink that changes once in a period.
    Output port ``erase_time`` (N,): time in seconds at which the cell became clean;
    `inf` before that, and for cells that were clean from the start.

    Parameters
    ----------
    initial_ink : array_like, N numbers
        Ink at the start, from 0 to 1.
    period : float
        Time between two changes of the ink, s.

    Raises
    ------
    SystemsError
        If a number is out of range or not finite.

    Examples
    --------
    >>> from pydrake.systems.analysis import Simulator
    >>> from pydrake.systems.framework import DiagramBuilder
    >>> from pydrake.systems.primitives import ConstantVectorSource
    >>> builder = DiagramBuilder()
    >>> ink = builder.AddSystem(ConstantVectorSource([0.02, 0.5]))
    >>> times = builder.AddSystem(EraseTimes(initial_ink=[1.0, 1.0], period=0.05))
    >>> _ = builder.Connect(ink.get_output_port(), times.get_input_port())
    >>> simulator = Simulator(builder.Build())
    >>> _ = simulator.AdvanceTo(0.2)
    >>> times.get_output_port().Eval(times.GetMyContextFromRoot(simulator.get_context()))
    array([ 0., inf])
    """

    def __init__(self, *, initial_ink: ArrayLike, period: float) -> None:
        super().__init__()
        self.set_name("erase_times")
        check_number(period, "period", above=0, unit="s", error=SystemsError)
        ink = as_floats(initial_ink, "initial_ink", error=SystemsError).ravel()
        self._inked = ink >= CLEAN_BELOW
        self._ink = self.DeclareVectorInputPort("ink", ink.size)
        times = self.DeclareDiscreteState(np.full(ink.size, NEVER))
        # Time of the last change of the ink.
        since = self.DeclareDiscreteState(1)
        self._times, self._since = int(times), int(since)
        self.DeclareVectorOutputPort("erase_time", ink.size, self._calc_erase_time)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._update)

    def _erase_times(self, context: Context) -> Array:
        ink: Any = self._ink.Eval(context)
        state = context.get_discrete_state()
        times: Array = state.value(self._times)
        is_new = self._inked & (ink < CLEAN_BELOW) & (times == NEVER)
        return np.where(is_new, state.value(self._since), times)

    def _calc_erase_time(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._erase_times(context))

    def _update(self, context: Context, values: DiscreteValues) -> None:
        """Store the times of the last period, before the next change of the ink."""
        values.set_value(self._times, self._erase_times(context))
        values.set_value(self._since, np.array([context.get_time()]))
