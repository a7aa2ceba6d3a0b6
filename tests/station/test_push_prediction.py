"""Facts about the predicted height to which a push lifts the eraser, against mechanics."""

import math

import numpy as np
import pytest

from fmp_drake.station import Scenario
from fmp_drake.station.reach.deviation_prediction import (
    normal_mass,
    predict_lift,
    predict_lifts,
)
from fmp_drake.station.reach.tracking_prediction import PredictedMotion
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.scripted_disturbances import Disturbance

MASS = 4.0
STIFF = ImpedanceConfig(translational_stiffness=[1500.0, 1500.0, 800.0])


def lift(z, duration=0.5, *, force=10.0, config=STIFF, xy=0.0):
    push = Disturbance(duration=duration, force=[xy, -xy, z])
    return predict_lift([push], config, force=force, mass=MASS)


@pytest.mark.parametrize("duration", [0.1, 0.3])
def test_a_push_moves_a_critically_damped_mass(duration):
    # From 14 N on 10 N and 800 N/m: up to 5 mm, where the controller presses by 10 N.
    config = ImpedanceConfig(translational_stiffness=STIFF.translational_stiffness)
    omega = math.sqrt(800 / MASS)
    t = omega * duration
    z = 4 / 800 * (1 - (1 + t) * math.exp(-t))
    # With this speed it goes on after the push, against the normal force.
    assert lift(14.0, duration, config=config) == pytest.approx(z, rel=0.15)
    assert lift(14.0, duration, config=config) > 0.99 * z


def test_a_long_push_ends_in_balance_with_spring_and_normal_force():
    # Farther than 6 cm from the board the controller presses with twice the force.
    assert lift(14.0, 5.0) == pytest.approx(4 / 800, rel=0.01)
    assert lift(80.0, 5.0) == pytest.approx(60 / 800, rel=0.01)


def test_the_normal_force_withstands_pushes_below_it():
    assert lift(9.9, 5.0) == 0
    assert lift(-40.0, 5.0) == 0
    assert lift(0.0, 5.0, xy=40.0) == 0


def test_a_push_of_35_newtons_lifts_the_eraser_by_9_centimetres():
    # As in a run with 7.1 N of normal force, in which it is off its path by more than 10 mm.
    soft = ImpedanceConfig()
    assert lift(35.1, 0.58, force=7.1, config=soft) == pytest.approx(0.09, abs=0.012)


def pushed(*pushes, force):
    """Return the prediction for pushes of a mass of 4 kg that 2 cm are allowed."""
    scenario = Scenario(impedance=STIFF, disturbances=list(pushes))
    return predict_lifts(scenario, along_normal([0.5]), force=force, allowed=0.02)


def push(z, kind="push", start=0.0, duration=0.5):
    return Disturbance(kind=kind, start=start, duration=duration, force=[0, 0, z])


def test_the_withstanding_force_is_the_smallest_one():
    pushes = push(20.0), push(40.0, start=9.0), push(30.0, start=5.0)
    found = pushed(*pushes, push(60.0, "grasp"), force=10.0)
    assert found.lift == pytest.approx(lift(40.0), rel=0.01)
    assert found.push == 40
    force = found.withstanding
    assert lift(40.0, force=force) <= 0.02 < lift(40.0, force=force - 0.2)


def test_forces_of_pushes_at_the_same_time_add_up():
    # As in a run in which 32 and 35 N together lifted the eraser by 33 cm.
    both = pushed(push(18.0, start=2.0), push(22.0, start=2.0), force=10.0)
    assert both.lift == pytest.approx(lift(40.0), rel=0.01)
    assert both.push == 40
    assert lift(40.0, force=both.withstanding) <= 0.021
    # One that ends holds the eraser down no longer.
    held = pushed(push(50.0), push(-45.0, duration=0.3), force=10.0)
    assert held.push == 50
    assert held.lift == pytest.approx(lift(50.0, 0.2), rel=0.02)
    # The second one begins while the eraser is still up.
    later = pushed(push(30.0), push(30.0, start=0.45), force=10.0)
    assert lift(30.0) < later.lift < lift(60.0)


def test_a_normal_force_that_withstands_is_enough():
    assert pushed(push(30.0), force=25.0).withstanding == 25
    assert pushed(force=5.0) == (0.0, 0.0, 5.0)


def along_normal(elements):
    """Return a motion through states with an element of the Jacobian along the normal."""
    J = np.zeros((1, len(elements), 6, 7))
    J[0, :, 5, 2] = elements
    M = np.tile(np.eye(7), (1, len(elements), 1, 1))
    nothing = np.zeros((1, len(elements), 7))
    return PredictedMotion(nothing, nothing, nothing, M, J, nothing[..., :6], nothing)


def test_mass_along_the_normal_is_that_of_the_jacobian():
    motion = along_normal([0.5, 1.0, 0.25])
    motion.M[:] *= 2
    assert normal_mass(motion) == pytest.approx(2.0 / 0.5**2)
