"""Facts about the press of the tool on the board."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, Sine

from fmp_drake.errors import StationError
from fmp_drake.systems.normal_press import NormalPress, press_share

INPUTS = ("desired_position", "measured_position")
HEIGHT = 0.01


@pytest.fixture
def press():
    return NormalPress(force=8.0, engage_height=HEIGHT)


def wrench(system, desired, measured, context=None):
    context = system.CreateDefaultContext() if context is None else context
    for name, height in zip(INPUTS, (desired, measured), strict=True):
        system.GetInputPort(name).FixValue(context, [0.3, -0.2, height])
    return system.GetOutputPort("wrench").Eval(context).copy()


def test_ports_have_names_and_sizes(press):
    assert press.get_name() == "normal_press"
    assert press.num_input_ports() == len(INPUTS) + 1
    assert press.GetInputPort("force").size() == 1
    assert press.num_output_ports() == 1
    assert [press.GetInputPort(name).size() for name in INPUTS] == [3, 3]
    assert press.GetOutputPort("wrench").size() == 6


def test_wrench_follows_all_inputs_at_once(press):
    assert [press.HasDirectFeedthrough(i, 0) for i in range(3)] == [True] * 3


def test_port_replaces_the_force(press):
    context = press.CreateDefaultContext()
    for force in (3.0, 0.0, 12.5):
        press.GetInputPort("force").FixValue(context, force)
        assert wrench(press, -0.001, -0.001, context)[5] == -force
    press.GetInputPort("force").FixValue(context, -2.0)
    assert wrench(press, -0.001, -0.001, context)[5] == 0


def test_system_has_no_state(press):
    assert press.CreateDefaultContext().is_stateless()


def test_share_is_a_smooth_step():
    heights = np.linspace(-HEIGHT, 2 * HEIGHT, 3001)
    share = np.array([press_share(z, HEIGHT) for z in heights])
    assert_array_equal(share[heights <= 0], 1.0)
    assert_array_equal(share[heights >= HEIGHT], 0.0)
    assert np.all(np.diff(share) <= 0)
    assert press_share(HEIGHT / 2, HEIGHT) == pytest.approx(0.5)
    slope = np.gradient(share, heights)
    # A cubic step: steepest in the middle, flat at both ends, no kink.
    assert np.min(slope) == pytest.approx(-1.5 / HEIGHT, rel=1e-3)
    assert np.max(np.abs(np.diff(slope))) < 0.02 / HEIGHT


@given(
    desired=st.floats(-0.05, 0.05),
    measured=st.floats(-0.05, 0.05),
    force=st.floats(0, 50),
)
def test_wrench_is_the_share_of_the_higher_of_both(desired, measured, force):
    system = NormalPress(force=force, engage_height=HEIGHT)
    share = press_share(max(desired, measured), HEIGHT)
    assert_array_equal(
        wrench(system, desired, measured), [0, 0, 0, 0, 0, -force * share]
    )


def test_nothing_is_pressed_in_free_air(press):
    for desired, measured in product((-0.01, 0.02), repeat=2):
        pressing = wrench(press, desired, measured)[5] < 0
        assert pressing == (desired < 0 and measured < 0)


def test_two_contexts_stay_independent(press):
    one, two = press.CreateDefaultContext(), press.CreateDefaultContext()
    on_board = wrench(press, -0.001, -0.001, one)
    in_air = wrench(press, 0.05, 0.05, two)
    assert_array_equal(press.GetOutputPort("wrench").Eval(one), on_board)
    assert_array_equal(press.GetOutputPort("wrench").Eval(two), in_air)
    assert on_board[5] == -8.0
    assert in_air[5] == 0.0


def test_caching_changes_nothing(press):
    for caching in (True, False):
        context = press.CreateDefaultContext()
        if not caching:
            context.DisableCaching()
        seen = [wrench(press, z, 0.0, context)[5] for z in (0.02, 0.005, -0.001, 0.02)]
        assert_allclose(seen, [0.0, -4.0, -8.0, 0.0])


def test_two_simulations_are_identical():
    logs = []
    builder = DiagramBuilder()
    press = builder.AddSystem(NormalPress(force=8.0, engage_height=HEIGHT))
    for i, name in enumerate(INPUTS):
        sine = builder.AddSystem(
            Sine(
                amplitudes=[0, 0, HEIGHT],
                frequencies=[0, 0, 5 + i],
                phases=[0, 0, i],
            )
        )
        builder.Connect(sine.get_output_port(0), press.GetInputPort(name))
    logger = LogVectorOutput(press.GetOutputPort("wrench"), builder, 0.01)
    diagram = builder.Build()
    for _ in range(2):
        simulator = Simulator(diagram)
        simulator.AdvanceTo(2.0)
        logs.append(logger.FindLog(simulator.get_context()).data().copy())
    assert_array_equal(*logs)
    assert np.ptp(logs[0][5]) > 7


@pytest.mark.parametrize("forgotten", INPUTS)
def test_forgotten_input_is_named(press, forgotten):
    context = press.CreateDefaultContext()
    for name in set(INPUTS) - {forgotten}:
        press.GetInputPort(name).FixValue(context, np.zeros(3))
    with pytest.raises((RuntimeError, ValueError), match=rf"{forgotten}.*normal_press"):
        press.GetOutputPort("wrench").Eval(context)


@pytest.mark.parametrize("force", [-1.0, np.nan, np.inf])
def test_force_that_is_no_press_is_refused(force):
    with pytest.raises(StationError, match=f"force is {force}"):
        NormalPress(force=force)


@pytest.mark.parametrize("height", [0.0, -0.01, np.nan, np.inf])
def test_engage_height_that_is_not_positive_is_refused(height):
    with pytest.raises(StationError, match=f"engage_height is {height}"):
        NormalPress(force=1.0, engage_height=height)
