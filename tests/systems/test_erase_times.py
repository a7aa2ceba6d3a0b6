"""Facts about when the cells of a board became clean.

The ink is a clock's: it changes at multiples of 0.05 s, as an `InkBoard`'s does.
"""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.systems.erase_times import NEVER, EraseTimes

PERIOD = 0.05
# Each cell's ink at the start, and the number of the update that cleans it.
INITIAL = np.array([1.0, 0.05, 0.3, 1.0, 0.1])
CLEANED_AT = np.array([3, 0, 1, 1000, 7])


class Ink(LeafSystem):
    """Ink of five cells, as state; the update that cleans a cell leaves 0.04."""

    def __init__(self):
        super().__init__()
        self.DeclareStateOutputPort("ink", self.DeclareDiscreteState(INITIAL))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, self._update)

    def _update(self, context, values):
        count = round(context.get_time() / PERIOD)
        values.set_value(0, np.where(count >= CLEANED_AT, 0.04, INITIAL))


@pytest.fixture(scope="module")
def watched():
    builder = DiagramBuilder()
    ink = builder.AddSystem(Ink())
    times = builder.AddSystem(EraseTimes(initial_ink=INITIAL, period=PERIOD))
    builder.Connect(ink.get_output_port(), times.get_input_port())
    builder.ExportOutput(times.get_output_port(), "erase_time")
    return builder.Build()


def erase_time(simulator):
    diagram = simulator.get_system()
    return diagram.get_output_port().Eval(simulator.get_context())


def test_a_cell_is_clean_from_the_update_on_that_cleaned_it(watched):
    simulator = Simulator(watched)
    assert_array_equal(erase_time(simulator), np.full(5, NEVER))
    # Before, at and after an update; the one at a time is made when time goes on.
    for until, clean in (
        (0.049, []),
        (0.051, [2]),
        (0.12, [2]),
        (0.151, [0, 2]),
        (0.34, [0, 2]),
        (2.0, [0, 2, 4]),
    ):
        simulator.AdvanceTo(until)
        expected = np.full(5, NEVER)
        expected[clean] = PERIOD * CLEANED_AT[clean]
        np.testing.assert_allclose(erase_time(simulator), expected)


def test_continued_clone_has_the_same_erase_times(watched):
    simulator = Simulator(watched)
    simulator.AdvanceTo(0.163)
    other = Simulator(watched, simulator.get_context().Clone())
    for each in (simulator, other):
        each.AdvanceTo(0.41)
    assert_array_equal(erase_time(other), erase_time(simulator))
    assert np.count_nonzero(erase_time(other) < NEVER) == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"initial_ink": "full", "period": 0.05}, "initial_ink: 'full' cannot be read"),
        ({"initial_ink": [1.0], "period": 0.0}, "period is 0.0"),
    ],
)
def test_invalid_ink_or_period_is_refused(options, message):
    with pytest.raises(SystemsError, match=message):
        EraseTimes(**options)
