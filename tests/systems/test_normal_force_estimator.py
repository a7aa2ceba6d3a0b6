"""Facts about the normal force that an arm's external torque tells."""

import numpy as np
import pytest
from arm_loop import X_WT_TILTED, configurations, jacobian, make_arm

from fmp_drake.errors import SystemsError
from fmp_drake.systems import NormalForceEstimator


def estimator(plant):
    return NormalForceEstimator(
        plant,
        end_effector=plant.GetFrameByName("eraser_tip"),
        R_WT=X_WT_TILTED.rotation(),
    )


def estimate(system, state, torque):
    context = system.CreateDefaultContext()
    system.GetInputPort("state").FixValue(context, state)
    system.GetInputPort("torque_external").FixValue(context, torque)
    return system.GetOutputPort("normal_force").Eval(context)[0]


def test_ports():
    system = estimator(make_arm())
    assert system.GetInputPort("state").size() == 14
    assert system.GetInputPort("torque_external").size() == 7
    assert system.GetOutputPort("normal_force").size() == 1
    assert system.HasDirectFeedthrough(0, 0)
    assert system.HasDirectFeedthrough(1, 0)


def test_a_pose_in_place_of_a_rotation_is_refused_with_the_expected_type():
    plant = make_arm()
    with pytest.raises(SystemsError, match=r"R_WT is .*type must be RotationMatrix"):
        NormalForceEstimator(
            plant, end_effector=plant.GetFrameByName("eraser_tip"), R_WT=X_WT_TILTED
        )


@pytest.mark.parametrize("q", configurations(5))
def test_the_normal_part_of_any_wrench_on_the_tool_is_found(q):
    plant = make_arm()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    rng = np.random.default_rng(0)
    system = estimator(plant)
    for _ in range(5):
        wrench_T = rng.uniform(-1, 1, 6) * [5, 5, 5, 50, 50, 50]
        # The board presses the tool along z, as the tool does the board along -z.
        torque = jacobian(plant, context, X_WT_TILTED).T @ wrench_T
        state = np.concatenate([q, rng.uniform(-1, 1, 7)])
        assert estimate(system, state, torque) == pytest.approx(wrench_T[5], abs=1e-9)


def test_force_of_inputs_that_are_not_finite_is_nan():
    system = estimator(make_arm())
    state, torque = np.full(14, 0.1), np.zeros(7)
    for broken in (state, torque):
        broken[2] = np.nan
        assert np.isnan(estimate(system, state, torque))
        broken[2] = 0.0


def test_a_straight_arm_raises_no_error():
    assert np.isfinite(estimate(estimator(make_arm()), np.zeros(14), np.ones(7)))
