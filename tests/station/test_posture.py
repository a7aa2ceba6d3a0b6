"""Facts about the posture that the arm takes for a pose of the eraser."""

import math
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant

from fmp_drake.errors import StationError
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.reach.posture import (
    FindLevelReach,
    SolvePosture,
    SolveStartPosture,
)
from fmp_drake.station.robots.robot import AddRobot, LoadRobot, MakeRobotModel
from fmp_drake.station.scenario import LoadScenario, Scenario
from fmp_drake.station.scenario_parts import PoseConfig

DOWN = RotationMatrix(np.diag([1.0, -1.0, -1.0]))
PREFERRED = np.array(Scenario().preferred_posture())
MIDDLE = (0.5, 0.0, 0.2)


@pytest.fixture(scope="module")
def arm():
    plant = MultibodyPlant(0.0)
    AddRobot(plant, LoadRobot("panda"))
    plant.Finalize()
    return plant


def solve(arm, X_WE, preferred=PREFERRED, **options):
    frame = arm.GetFrameByName("eraser_tip")
    return SolvePosture(arm, frame=frame, X_WE=X_WE, q_preferred=preferred, **options)


def limit_margin(arm, q):
    lower, upper = arm.GetPositionLowerLimits(), arm.GetPositionUpperLimits()
    return np.min(np.minimum(q - lower, upper - q))


def pose(arm, q):
    context = arm.CreateDefaultContext()
    arm.SetPositions(context, q)
    return arm.GetFrameByName("eraser_tip").CalcPoseInWorld(context)


@pytest.mark.parametrize("x", [0.35, 0.55, 0.7])
@pytest.mark.parametrize("y", [-0.3, 0.0, 0.3])
@pytest.mark.parametrize("z", [0.1, 0.3])
def test_eraser_reaches_its_pose_exactly(arm, x, y, z):
    q = solve(arm, RigidTransform(DOWN, [x, y, z]))
    X_WE = pose(arm, q)
    assert_allclose(X_WE.translation(), [x, y, z], atol=5e-6)
    assert_allclose(X_WE.rotation().matrix(), DOWN.matrix(), atol=2e-4)
    assert np.all(q >= arm.GetPositionLowerLimits() + 0.03 - 1e-9)
    assert np.all(q <= arm.GetPositionUpperLimits() - 0.03 + 1e-9)


def test_tilted_eraser_is_reached(arm):
    tilted = RotationMatrix.MakeYRotation(0.4) @ DOWN
    X_WE = pose(arm, solve(arm, RigidTransform(tilted, MIDDLE)))
    assert_allclose(X_WE.rotation().matrix(), tilted.matrix(), atol=2e-4)


def test_posture_that_fits_already_is_kept(arm):
    q = np.array([0, -math.pi / 4, 0, -3 * math.pi / 4, 0, math.pi / 2, math.pi / 4])
    assert_allclose(solve(arm, pose(arm, q), q), q, atol=1e-4)


def test_search_that_ends_at_a_limit_begins_elsewhere(arm):
    preferred = np.array([-1.8, 1.4, -1.9, -1.5, -1.9, 2.1, -1.2])
    X_WE = RigidTransform(RollPitchYaw(np.pi, 0.0, -1.5), [0.32, -0.26, 0.18])
    q = solve(arm, X_WE, preferred)
    assert limit_margin(arm, q) > 0.1
    assert np.linalg.norm(q - preferred) < 5.0  # It is 7.6 at the limit.
    assert_allclose(pose(arm, q).translation(), X_WE.translation(), atol=5e-6)


def test_redundant_arm_stays_near_the_preferred_posture(arm):
    X_WE = RigidTransform(DOWN, MIDDLE)
    for first in (-0.5, 0.5):
        preferred = PREFERRED.copy()
        preferred[0] = first
        assert np.sign(solve(arm, X_WE, preferred)[0]) == np.sign(first)


def test_same_pose_gives_the_same_posture(arm):
    X_WE = RigidTransform(DOWN, MIDDLE)
    assert_array_equal(solve(arm, X_WE), solve(arm, X_WE))


@pytest.mark.parametrize(
    "p", [(1.2, 0.0, 0.1), (0.05, 0.0, 0.1), (0.5, 0.0, -0.9), (0.6, 0.6, 0.1)]
)
def test_pose_out_of_reach_is_refused_with_its_place(arm, p):
    x, y, z = p
    place = rf"bring eraser_tip to \({x:.3f}, {y:.3f}, {z:.3f}\) m.*the base of the arm"
    with pytest.raises(StationError, match=place):
        solve(arm, RigidTransform(DOWN, p))


def test_arm_on_a_ceiling_is_solved_with_the_posture_of_one_on_a_table():
    config = LoadRobot("panda")
    config.base_pose = PoseConfig(translation=[0.1, 0.0, 0.9], rpy=[math.pi, 0.0, 0.0])
    robot = MakeRobotModel(config)
    X_WE = RigidTransform(DOWN, [0.55, 0.0, 0.12])
    q = solve(robot.plant, X_WE)
    assert_allclose(pose(robot.plant, q).translation(), [0.55, 0.0, 0.12], atol=5e-6)
    assert limit_margin(robot.plant, q) > 0.1


def test_joints_are_outside_the_springs_at_their_limits_where_they_can_be():
    robot = MakeRobotModel(LoadRobot("iiwa14"))
    plant = robot.plant
    # The posture nearest to the preferred one is 0.03 rad from the limit of joint 6.
    X_WE = pose(plant, np.array([-2.015, 1.16, 2.937, -1.958, -1.215, 0.842, 0.616]))
    q = solve(plant, X_WE, robot.default_posture)
    assert_allclose(pose(plant, q).translation(), X_WE.translation(), atol=5e-6)
    assert limit_margin(plant, q) > 0.1
    near = solve(plant, X_WE, robot.default_posture, spring_width=0.01)
    assert limit_margin(plant, near) == pytest.approx(0.03)


def test_a_joint_without_limits_starts_within_half_a_revolution(tmp_path):
    folder = models_dir() / "ur5e"
    urdf = (folder / "ur5e.urdf").read_text().replace('"revolute"', '"continuous"')
    (tmp_path / "ur5e.urdf").write_text(re.sub(' (lower|upper)="[^"]*"', "", urdf))
    (tmp_path / "ur5e.yaml").write_text((folder / "ur5e.yaml").read_text())
    scenario = LoadScenario("wipe_dome", robot=tmp_path / "ur5e.yaml")
    scenario.posture = [1.08, -1.19, 3.39, -3.56, -1.25, -0.62]
    model = MakeRobotModel(LoadRobot(scenario.robot))
    q = SolveStartPosture(scenario, model, scenario.start)
    assert np.max(np.abs(q)) <= np.pi  # They were 4.85 and -6.31 rad.
    board = scenario.board.assumed_pose() @ scenario.board.start_displacement()
    X_WE = board @ scenario.eraser_pose(scenario.start)
    assert_allclose(pose(model.plant, q).translation(), X_WE.translation(), atol=5e-6)


def test_reach_is_that_from_the_base():
    config = LoadRobot("ur5e")
    at_origin = FindLevelReach(MakeRobotModel(config))
    config.base_pose.translation = [0.4, -0.3, 0.0]
    assert FindLevelReach(MakeRobotModel(config)) == pytest.approx(at_origin, abs=0.011)


def test_frame_of_another_plant_is_refused(arm):
    frame = MakeRobotModel(LoadRobot("ur5e")).tip
    with pytest.raises(StationError, match="is a frame of another plant"):
        SolvePosture(
            arm,
            frame=frame,
            X_WE=RigidTransform(DOWN, MIDDLE),
            q_preferred=PREFERRED,
        )


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"frame": "eraser_tip"}, "frame is 'eraser_tip'; its type must be Frame"),
        ({"X_WE": np.eye(4)}, "X_WE is .*; its type must be RigidTransform"),
    ],
)
def test_argument_of_another_type_is_refused_with_the_expected_one(arm, wrong, words):
    right = {
        "frame": arm.GetFrameByName("eraser_tip"),
        "X_WE": RigidTransform(DOWN, MIDDLE),
        "q_preferred": PREFERRED,
    }
    with pytest.raises(StationError, match=words):
        SolvePosture(arm, **(right | wrong))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_place_that_is_not_finite_is_refused(arm, bad):
    with pytest.raises(StationError, match="infinite numbers in the eraser's position"):
        solve(arm, RigidTransform(DOWN, [0.5, bad, 0.1]))


@pytest.mark.parametrize(
    ("preferred", "complaint"),
    [
        (np.zeros(6), r"the posture of shape \(6,\); expected \(7,\)"),
        (np.full(7, np.nan), "infinite numbers in the posture"),
    ],
)
def test_preferred_posture_of_another_arm_is_refused(arm, preferred, complaint):
    with pytest.raises(StationError, match=complaint):
        solve(arm, RigidTransform(DOWN, MIDDLE), preferred)


def test_a_posture_in_degrees_is_refused_with_its_joint_and_range():
    scenario = Scenario(posture=[0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0])
    model = MakeRobotModel(LoadRobot("panda"), scenario.held_tool())
    with pytest.raises(
        StationError, match=r"posture has -45 for panda_joint2, whose range is -1\.76"
    ):
        SolveStartPosture(scenario, model, scenario.start)
    scenario.posture = np.deg2rad(scenario.posture).tolist()
    assert SolveStartPosture(scenario, model, scenario.start).shape == (7,)
