"""Facts about the friction of the arm's joints."""

from dataclasses import replace

import numpy as np
import pytest
from arm_loop import PANDA, PANDA_FRICTION, make_arm
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.multibody.plant import MultibodyPlant

from fmp_drake.errors import SystemsError
from fmp_drake.station import AddRobot
from fmp_drake.systems.impedance.joints import (
    FrictionConfig,
    SigmoidFriction,
    friction_torque,
)
from fmp_drake.systems.joint_friction import JointFriction


def panda_friction(**values):
    return SigmoidFriction.of(replace(PANDA_FRICTION, **values), n=7)


def test_friction_is_the_published_sigmoid():
    config = PANDA_FRICTION
    a, b, c = map(np.array, (config.height, config.slope, config.shift))
    for v in np.random.default_rng(0).normal(size=(5, 7)):
        expected = a / (1 + np.exp(-b * (v + c))) - a / (1 + np.exp(-b * c))
        assert_allclose(friction_torque(panda_friction(), v), expected, atol=1e-12)


def test_friction_acts_against_every_motion_and_not_at_rest():
    friction = panda_friction()
    assert_array_equal(friction_torque(friction, np.zeros(7)), 0.0)
    for v in np.random.default_rng(1).normal(size=(20, 7)):
        assert np.all(friction_torque(friction, v) * v > 0)


def test_friction_is_bounded_at_any_speed():
    friction = panda_friction()
    for v in (1e9, -1e9):
        assert np.all(
            np.abs(friction_torque(friction, np.full(7, v))) < friction.height
        )


def test_the_gain_scales_it():
    v = np.ones(7)
    assert_allclose(
        friction_torque(panda_friction(gain=0.5), v),
        0.5 * friction_torque(panda_friction(), v),
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"height": [1.0] * 6}, "friction.height must be 7 .* one per joint"),
        ({"height": []}, r"friction.height must be 7 .* got \[\]"),
        ({"slope": [-1.0] * 7}, r"friction.slope\[0\] is -1.0; it must be at least 0"),
        ({"shift": [np.nan] * 7}, r"friction.shift\[0\] is nan; it must be a finite"),
        ({"gain": -1.0}, "friction.gain is -1.0; it must be at least 0"),
    ],
)
def test_invalid_friction_parameters_are_refused(values, message):
    with pytest.raises(SystemsError, match=message):
        panda_friction(**values)


def test_robot_completes_missing_values():
    config = FrictionConfig(enabled=True, gain=0.9, height=[2.0])
    robot = FrictionConfig(gain=0.5, height=[1.0], slope=[5.0], shift=[0.1])
    assert config.completed(robot) == FrictionConfig(
        enabled=True, gain=0.9, height=[2.0], slope=[5.0], shift=[0.1]
    )


def test_the_system_gives_the_friction_as_a_generalized_force():
    plant = make_arm()
    arm = plant.GetModelInstanceByName("panda")
    system = JointFriction(plant, arm=arm, config=PANDA_FRICTION)
    assert system.get_name() == "joint_friction"
    assert system.GetInputPort("state").size() == 14
    assert system.HasDirectFeedthrough(0, 0)
    context = system.CreateDefaultContext()
    assert context.is_stateless()
    for disabled in (False, True):
        if disabled:
            context.DisableCaching()
        for v in np.random.default_rng(2).normal(size=(3, 7)):
            system.GetInputPort("state").FixValue(context, np.r_[np.ones(7), v])
            force = system.GetOutputPort("generalized_force").Eval(context)
            assert_allclose(force, -friction_torque(panda_friction(), v))


def test_a_plant_that_is_not_finalized_is_refused():
    plant = MultibodyPlant(1e-3)
    arm = AddRobot(plant, PANDA).arm
    with pytest.raises(SystemsError, match=r"not finalized; call Finalize\(\)"):
        JointFriction(plant, arm=arm, config=PANDA_FRICTION)


def test_a_forgotten_state_is_named():
    plant = make_arm()
    arm = plant.GetModelInstanceByName("panda")
    system = JointFriction(plant, arm=arm, config=PANDA_FRICTION)
    with pytest.raises(RuntimeError, match=r"state.*joint_friction"):
        system.GetOutputPort("generalized_force").Eval(system.CreateDefaultContext())
