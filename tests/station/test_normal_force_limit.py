"""Facts about the greatest normal force of an arm."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.skills import scenario_skill
from fmp_drake.station import AddBoardScene, CheckFeasibility, LoadScenario
from fmp_drake.station.reach.posture import ArmForceLimit
from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel
from fmp_drake.station.station import CheckNormalForce


def statics(robot, q, force_W):
    """Return the torques that hold an arm on whose tip a force acts, Nm."""
    plant = robot.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    forces = MultibodyForces(plant)
    plant.CalcForceElementsContribution(context, forces)
    body, tip = robot.tip.body(), robot.tip
    R_WBody = body.EvalPoseInWorld(context).rotation()
    offset = tip.CalcPose(context, body.body_frame()).translation()
    body.AddInForce(
        context, offset, SpatialForce(np.zeros(3), R_WBody.inverse() @ force_W),
        body.body_frame(), forces,
    )  # fmt: skip
    return plant.CalcInverseDynamics(context, np.zeros(plant.num_velocities()), forces)


@pytest.mark.parametrize("name", ["panda", "ur5e", "iiwa14"])
@pytest.mark.parametrize(("rpy", "friction"), [((0, 0, 0), 0.5), ((0.3, -0.4, 1), 0.2)])
def test_at_the_greatest_normal_force_a_joint_has_80_percent_of_its_torque(
    name, rpy, friction
):
    robot = MakeRobotModel(LoadRobot(name), LoadScenario("table_top").held_tool())
    q = np.array(robot.config.posture)
    R_WB = RotationMatrix(RollPitchYaw(*rpy))
    limit = ArmForceLimit(robot, q=q, R_WB=R_WB, friction=friction)
    x, y, z = R_WB.matrix().T
    # The board pushes back along its normal, and rubs in any direction.
    largest = max(
        np.max(
            np.abs(statics(robot, q, limit * (z + friction * t)))
            / robot.plant.GetEffortUpperLimits()
        )
        for t in (x, -x, y, -y)
    )
    assert limit > 10
    assert largest == pytest.approx(0.8, abs=1e-6)


def test_a_normal_force_above_the_limit_at_the_start_is_refused():
    scenario = LoadScenario("tilted")
    scene = AddBoardScene(DiagramBuilder(), scenario, start=scenario.start)
    limit = ArmForceLimit(
        scene.model,
        q=scene.robot.default_posture,
        R_WB=scene.X_WB.rotation(),
        friction=scenario.contact_friction(),
    )
    scenario.press.force = 0.999 * limit
    CheckNormalForce(scene)
    scenario.press.force = 1.001 * limit
    words = f"press.force is {1.001 * limit:g} N; .* {limit:.1f} N .* 80 % of its"
    with pytest.raises(StationError, match=words):
        CheckNormalForce(scene)


def test_the_check_suggests_a_normal_force_that_the_arm_has_at_the_start():
    scenario = LoadScenario("vertical")
    skill, _, _ = scenario_skill(scenario)
    scenario.press.force = 57.0
    # Friction does not hold the eraser back.
    scenario.impedance.translational_stiffness = [15000.0, 15000.0, 200.0]
    scenario.impedance.control_period = 0.0002
    found = CheckFeasibility(scenario, skill)
    assert "it can press with 55.6 N at the start" in found.verdict
    scenario.press.force = found.suggestion["press_force"]
    assert scenario.press.force <= 55
    scene = AddBoardScene(DiagramBuilder(), scenario, start=scenario.start)
    CheckNormalForce(scene)


def test_greatest_normal_force_falls_with_friction_to_less_than_a_newton():
    robot = MakeRobotModel(LoadRobot("panda"), LoadScenario("table_top").held_tool())
    first, second = (
        ArmForceLimit(
            robot, q=robot.config.posture, R_WB=RotationMatrix(), friction=friction
        )
        for friction in (1e3, 2e3)
    )
    assert 0 < first < 1
    assert first == pytest.approx(2 * second, rel=1e-2)
