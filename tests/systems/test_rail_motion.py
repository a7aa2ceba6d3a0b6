"""Facts about the desired motion of a board on a rail."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import SystemsError
from fmp_drake.systems.rail_motion import RailMotion

PORTS = ("position", "velocity", "acceleration")
AMPLITUDE, FREQUENCY = 0.06, 0.4


@pytest.fixture
def rail():
    return RailMotion(amplitude=AMPLITUDE, frequency=FREQUENCY)


def values(rail, context):
    return np.concatenate([rail.GetOutputPort(name).Eval(context) for name in PORTS])


def started(rail, t0):
    """Return a simulator of a simulation that begins at a time."""
    simulator = Simulator(rail)
    simulator.get_mutable_context().SetTime(t0)
    simulator.Initialize()
    return simulator


def test_ports_have_names(rail):
    assert rail.get_name() == "rail"
    names = [rail.get_output_port(i).get_name() for i in range(3)]
    assert names == [*PORTS]
    assert [rail.GetOutputPort(name).size() for name in PORTS] == [1, 1, 1]
    assert rail.num_input_ports() == 0


@pytest.mark.parametrize("t0", [0.0, 5.0, 0.0133, -3.0])
def test_motion_begins_at_rest_at_the_negative_end_at_any_time(rail, t0):
    simulator = started(rail, t0)
    at_rest = [-AMPLITUDE, 0.0, AMPLITUDE * (2 * np.pi * FREQUENCY) ** 2]
    assert_allclose(values(rail, simulator.get_context()), at_rest, atol=1e-12)
    simulator.AdvanceTo(t0 + 0.5 / FREQUENCY)
    at_end = [AMPLITUDE, 0.0, -at_rest[2]]
    assert_allclose(values(rail, simulator.get_context()), at_end, atol=1e-12)


def test_board_is_at_the_beginning_before_the_initialisation(rail):
    context = rail.CreateDefaultContext()
    expected = values(rail, context)
    context.SetTime(5.0)
    assert_array_equal(values(rail, context), expected)


@pytest.mark.parametrize("caching", [True, False])
def test_velocity_and_acceleration_are_derivatives(rail, caching):
    context = started(rail, 2.0).get_mutable_context()
    if not caching:
        context.DisableCaching()
    step = 1e-5
    for time in np.linspace(2.0, 5.0, 13):
        sampled = []
        for shift in (-step, 0.0, step):
            context.SetTime(time + shift)
            sampled.append(values(rail, context))
        before, now, after = sampled
        assert_allclose((after - before)[:2] / (2 * step), now[1:], atol=1e-8)


def test_a_clone_continues_the_motion_and_the_original_is_independent(rail):
    simulator = started(rail, 5.0)
    simulator.AdvanceTo(5.7)
    clone = simulator.get_context().Clone()
    follower = Simulator(rail, clone)
    follower.Initialize()
    assert_array_equal(
        values(rail, follower.get_context()), values(rail, simulator.get_context())
    )
    follower.AdvanceTo(6.1)
    assert_allclose(values(rail, simulator.get_context())[0], position_after(0.7))
    assert_allclose(values(rail, follower.get_context())[0], position_after(1.1))


def position_after(seconds):
    return -AMPLITUDE * np.cos(2 * np.pi * FREQUENCY * seconds)


@pytest.mark.parametrize(
    ("amplitude", "frequency", "words"),
    [(-0.1, 1.0, "amplitude is -0.1"), (0.1, 0.0, "frequency is 0")],
)
def test_wrong_numbers_are_refused(amplitude, frequency, words):
    with pytest.raises(SystemsError, match=words):
        RailMotion(amplitude=amplitude, frequency=frequency)
