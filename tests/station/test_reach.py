"""Facts about the predicted motion of the arm over a board, and what it misses."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.math import RigidTransform, RollPitchYaw

from fmp_drake.station import Scenario
from fmp_drake.station.reach.board_reach import BoardReach, FollowingBounds
from fmp_drake.station.reach.tracking_prediction import PredictedMotion
from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel

STEP = 0.05
TILTED = RigidTransform(RollPitchYaw(0.1, -0.3, 0.4), [0.5, 0.1, 0.2])
# Along the rail of a moving board, in its frame, m.
ALONG = np.array([0.02, 0.05, 0.0])


@pytest.fixture(scope="module")
def reach():
    return BoardReach(Scenario(), FollowingBounds())


@pytest.fixture(scope="module")
def model():
    """The arm with its eraser."""
    return MakeRobotModel(LoadRobot("panda"), Scenario().held_tool())


def stroke(count=12, speed=0.2):
    """Return a path (1, count, 3) along x of the board, in contact with it, m."""
    path = np.zeros((1, count, 3))
    path[0, :, 0] = speed * STEP * np.arange(count) - 0.05
    return path


@pytest.fixture(scope="module")
def motion(reach):
    """The arm's motion along a stroke on the tilted board."""
    (posture,) = reach.near_postures([TILTED])
    return reach.follow([TILTED], stroke(), step=STEP, postures=posture[None])


def test_eraser_is_where_and_as_fast_as_the_path(motion, model):
    context = model.plant.CreateDefaultContext()
    positions = []
    for q in motion.q[0]:
        model.plant.SetPositions(context, q)
        positions.append(model.tip.CalcPoseInWorld(context).translation())
    expected = TILTED.multiply(stroke()[0].T).T
    assert_allclose(positions, expected, atol=5e-4)
    moved = motion.q[0, 1:] - motion.q[0, :-1]
    assert_allclose(motion.v[0, 1:], moved / STEP, atol=1e-9)
    assert np.max(np.linalg.norm(motion.error[0, :, 3:], axis=1)) < 5e-4


def test_error_is_from_the_predicted_to_the_desired_pose_in_the_boards_axes(reach):
    path = np.zeros((1, 4, 3))
    path[..., 0] = 2.0  # Out of reach.
    (posture,) = reach.near_postures([TILTED])
    motion = reach.follow([TILTED], path, step=STEP, postures=posture[None])
    context = reach._model.plant.CreateDefaultContext()
    reach._model.plant.SetPositions(context, motion.q[0, -1])
    p_BE = TILTED.inverse() @ reach._model.tip.CalcPoseInWorld(context).translation()
    assert_allclose(motion.error[0, -1, 3:], path[0, -1] - p_BE, atol=1e-9)


def test_torque_is_that_of_weight_and_acceleration(motion, model):
    context = model.plant.CreateDefaultContext()
    k = 6
    model.plant.SetPositionsAndVelocities(
        context, np.r_[motion.q[0, k], motion.v[0, k]]
    )
    acceleration = (motion.v[0, k] - motion.v[0, k - 1]) / STEP
    expected = (
        model.plant.CalcMassMatrix(context) @ acceleration
        + model.plant.CalcBiasTerm(context)
        - model.plant.CalcGravityGeneralizedForces(context)
    )
    assert_allclose(motion.torque[0, k], expected, atol=1e-6)


def test_pressing_takes_the_torque_of_a_newton_into_the_board(motion, model):
    """The power of the joints is that of the force at the eraser."""
    context = model.plant.CreateDefaultContext()
    rng = np.random.default_rng(0)
    q, dq = motion.q[0, 3], 1e-6 * rng.standard_normal(7)
    heights = []
    for at in (q, q + dq):
        model.plant.SetPositions(context, at)
        p = model.tip.CalcPoseInWorld(context).translation()
        heights.append((TILTED.inverse() @ p)[2])
    lowered = heights[0] - heights[1]
    assert motion.force_torque[0, 3] @ dq == pytest.approx(lowered, rel=1e-3)


def test_manipulability_is_the_volume_of_the_velocity_ellipsoid(motion, model):
    context = model.plant.CreateDefaultContext()
    J = np.empty((6, 7))
    for i in range(7):
        model.plant.SetPositionsAndVelocities(
            context, np.r_[motion.q[0, 5], np.eye(7)[i]]
        )
        V = model.tip.CalcSpatialVelocityInWorld(context)
        J[:, i] = np.r_[V.rotational(), V.translational()]
    volume = np.prod(np.linalg.svd(J, compute_uv=False))
    assert motion.manipulability[0, 5] == pytest.approx(volume, rel=1e-6)


def test_a_board_that_has_moved_along_its_rail_is_the_board_there(reach, motion):
    there = TILTED @ RigidTransform(ALONG)
    (posture,) = reach.near_postures([TILTED])
    moved, still = (
        reach.follow([X], stroke(), step=STEP, postures=posture[None], moved=by)
        for X, by in ((TILTED, ALONG), (there, 0.0))
    )
    assert_allclose(moved.q, still.q, atol=1e-9)
    shape = (1, motion.q.shape[1], 3)
    low = RigidTransform(RollPitchYaw(0.1, -0.3, 0.4), [0.4, 0.1, 0.6])
    rails = np.broadcast_to(10 * ALONG, shape), np.zeros(shape)
    found = [
        reach.clearance([X], motion, rail)
        for X, rail in zip((low, low @ RigidTransform(10 * ALONG)), rails, strict=True)
    ]
    assert_allclose(found[0][0], found[1][0], atol=1e-9)
    assert found[0][1] == found[1][1]
    assert not np.allclose(found[0][0], reach.clearance([low], motion, rails[1])[0])


@pytest.mark.parametrize(
    ("error", "has_rotation", "far", "tilted"),
    [
        ([0, 0, 0, 0.009, 0, 0], False, False, False),
        ([0, 0, 0, 0.007, 0, -0.008], False, True, False),
        ([0.08, -0.05, 0, 0, 0, 0], False, False, False),
        ([0.08, -0.07, 0, 0, 0, 0], False, False, True),
        ([0, 0, 0.2, 0, 0, 0], False, False, False),
        ([0, 0, 0.2, 0, 0, 0], True, False, True),
    ],
)
def test_a_sample_is_missed_by_more_than_10_mm_or_a_tenth_of_a_radian(
    reach, motion, error, has_rotation, far, tilted
):
    given = motion._replace(error=np.broadcast_to(error, motion.error.shape))
    found = reach.missed(given, has_rotation=has_rotation)
    assert np.all(found[0] == far)
    assert np.all(found[1] == tilted)


def test_margins_are_to_the_nearer_limit_of_each_joint(reach, model):
    lower = model.plant.GetPositionLowerLimits()
    upper = model.plant.GetPositionUpperLimits()
    middle, nothing = (lower + upper) / 2, np.zeros((1, 3, 7))
    # The spring begins at 0.1 rad, and 0.03 rad before it a joint counts as being at it.
    q = np.array([[middle, upper - 0.2, lower + 0.12]])
    given = PredictedMotion(
        q, nothing, nothing, nothing, np.zeros((1, 3, 6)), np.zeros((1, 3))
    )
    *_, at_spring, margin = reach.missed(given)
    assert at_spring.tolist() == [[False, False, True]]
    assert_allclose(margin[0, 0], (upper - lower) / 2)
    assert_allclose(margin[0, 1], np.minimum(0.2, upper - lower - 0.2))
    assert_allclose(margin[0, 2], np.minimum(0.12, upper - lower - 0.12))


def test_cells_cover_the_board_and_show_the_margin_of_their_place():
    scenario = Scenario()
    scenario.board.translation = [0.5, 0.15, 0.1]  # Neither side is like the other.
    scenario.board.size = [0.3, 0.5]
    reach = BoardReach(scenario, FollowingBounds())
    posture = reach.start_posture()
    x, y, margin = reach.cells(posture)
    for edges, size in ((x, 0.3), (y, 0.5)):
        assert_allclose(edges[[0, -1]], [-size / 2, size / 2])
        assert np.all(np.diff(edges) > 0)
        assert np.max(np.diff(edges)) <= 0.02 + 1e-9
    assert margin.shape == (len(x), len(y))
    X_WB = scenario.board.assumed_pose()
    walls = scenario.impedance.walls.width
    corners = [(2, 3), (2, -4), (-3, 3), (-3, -4)]
    paths = np.array([np.linspace([0, 0, 0], [x[i], y[j], 0], 20) for i, j in corners])
    straight = reach.follow([X_WB], paths, step=0.2, postures=posture[None])
    direct = np.min(reach.missed(straight)[3][:, -1], axis=1) - walls
    found = np.array([margin[i, j] for i, j in corners])
    assert_allclose(found, direct, atol=0.02)
    assert np.ptp(direct) > 0.1
