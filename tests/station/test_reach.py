"""Facts about the predicted motion of the arm over a board, and what it misses."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.common.yaml import yaml_dump_typed
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.spatial.transform import Rotation

from fmp_drake.station import Scenario
from fmp_drake.station.reach.board_reach import (
    LONGEST_MOVE,
    BoardReach,
    FollowingBounds,
)
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
    middle = (lower + upper) / 2
    # The spring begins at 0.1 rad, and 0.03 rad before it a joint counts as being at it.
    one = np.where(np.arange(7) == 2, upper - 0.12, middle)
    *_, at_spring, margin = reach.missed(at(middle, upper - 0.2, lower + 0.12, one))
    assert at_spring.tolist() == [[False, False, True, True]]
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


def test_cells_of_a_large_board_are_larger_and_not_more():
    scenario = Scenario()
    scenario.board.size = [1.5, 0.3]
    reach = BoardReach(scenario, FollowingBounds())
    x, y, margin = reach.cells(reach.start_posture())
    assert_allclose([x[0], x[-1], y[0], y[-1]], [-0.75, 0.75, -0.15, 0.15])
    assert len(x) <= 41
    assert np.all(np.isnan(margin[-1]))  # 1.3 m from the arm.
    assert np.isfinite(margin[len(x) // 2, len(y) // 2])


# Several boards ----------------------------------------------------------


def test_paths_on_several_boards_are_as_each_of_them_alone(reach):
    boards = [TILTED, RigidTransform([0.45, -0.1, 0.1])]
    paths = np.concatenate([stroke(), stroke()[:, ::-1] + [0.02, 0.03, 0.01]])
    turns = 0.1 * np.arange(24).reshape(2, 12) / 12
    R_TE = Rotation.from_euler(
        "xz", np.stack([0 * turns + np.pi, turns], -1).reshape(-1, 2)
    )
    R_TE, moved = R_TE.as_matrix().reshape(2, 12, 3, 3), paths[..., ::-1] * 0.3
    postures = reach.near_postures(boards)
    options = {"step": STEP, "R_TE": R_TE, "moved": moved}
    together = reach.follow(boards, paths, postures=postures, **options)
    gaps, nearest = reach.clearance(boards, together, moved)
    assert gaps.shape == (4, 12)
    alone_gaps = {}
    for i, (X_WB, posture) in enumerate(zip(boards, postures, strict=True)):
        for j in range(2):
            own = {"step": STEP, "R_TE": R_TE[j : j + 1], "moved": moved[j : j + 1]}
            path = paths[j : j + 1]
            alone = reach.follow([X_WB], path, postures=posture[None], **own)
            for a, b in zip(together, alone, strict=True):
                assert_allclose(a[2 * i + j], b[0], atol=1e-7)
            gap, link = reach.clearance([X_WB], alone, moved[j : j + 1])
            assert_allclose(gaps[2 * i + j], gap[0], atol=1e-7)
            alone_gaps[np.min(gap)] = link
    assert nearest == alone_gaps[min(alone_gaps)]


def test_postures_begin_where_the_rail_does(model):
    scenario = Scenario()
    scenario.start = [0.05, -0.1, 0.08]
    scenario.board.motion.amplitude, scenario.board.motion.axis = 0.1, [0, 1, 0]
    reach = BoardReach(scenario, FollowingBounds())
    context = model.plant.CreateDefaultContext()
    (near,) = reach.near_postures([scenario.board.assumed_pose()])
    # The eraser is over a board at one end of its rail.
    start = np.array(scenario.start) - [0, 0.1, 0]
    expected = scenario.board.assumed_pose() @ start
    for q, tolerance in ((reach.start_posture(), 1e-5), (near, 1e-3)):
        model.plant.SetPositions(context, q)
        p = model.tip.CalcPoseInWorld(context).translation()
        assert_allclose(p, expected, atol=tolerance)


def test_eraser_follows_the_normal_of_a_pipe(model):
    scenario = Scenario()
    scenario.board.shape, scenario.board.radius = "cylinder", 0.3
    scenario.board.axis = "x"
    reach = BoardReach(scenario, FollowingBounds())
    X_WB = scenario.board.assumed_pose()
    paths = np.zeros((2, 8, 3))
    paths[0, :, 1] = np.linspace(0.0, 0.1, 8)
    paths[1, :, 0] = np.linspace(0.0, 0.1, 8)
    paths[..., 2] = 0.01
    motion = reach.follow(
        [X_WB], paths, step=STEP, postures=reach.near_postures([X_WB])
    )
    context = model.plant.CreateDefaultContext()
    for path, qs in zip(paths, motion.q, strict=True):
        for (u, v, h), q in zip(path, qs, strict=True):
            model.plant.SetPositions(context, q)
            X_BE = X_WB.inverse() @ model.tip.CalcPoseInWorld(context)
            a = v / 0.3
            normal = np.array([0, np.sin(a), np.cos(a)])
            expected = [u, *((0.3 + h) * normal - [0, 0, 0.3])[1:]]
            assert_allclose(X_BE.translation(), expected, atol=1e-3)
            assert_allclose(X_BE.rotation().matrix()[:, 2], -normal, atol=5e-3)


# Clearance ---------------------------------------------------------------


def at(*postures):
    """Return a motion of one path through postures, for its clearance."""
    q = np.array(postures)[None]
    nothing = np.zeros((*q.shape[:2], 6))
    return PredictedMotion(q, q, q, q, q, nothing, nothing[..., 0])


def small_board(position):
    """Return a reach over a board of 2 cm, and the pose of the board."""
    scenario = Scenario()
    scenario.board.size = [0.02, 0.02]
    return BoardReach(scenario, FollowingBounds()), RigidTransform(position)


def test_the_nearest_link_of_all_samples_is_named(model):
    raised = np.array([0.0, -0.5, 0.0, -1.5, 0.0, 1.5, 0.8])
    lowered = np.array([0.0, 0.9, 0.0, -1.5, 0.0, 1.5, 0.8])
    context = model.plant.CreateDefaultContext()
    for q, name, other in ((raised, "link6", lowered), (lowered, "link3", raised)):
        model.plant.SetPositions(context, q)
        body = model.plant.GetBodyByName(f"panda_{name}")
        reach, X_WB = small_board(body.EvalPoseInWorld(context).translation())
        still = np.zeros((1, 2, 3))
        gaps, link = reach.clearance([X_WB], at(q, other), still)
        assert link == f"panda_{name}"
        assert gaps[0, 0] < 0.0 < gaps[0, 1]
        swapped, link = reach.clearance([X_WB], at(other, q), still)
        assert_allclose(swapped, gaps[:, ::-1])
        assert link == f"panda_{name}"


def test_clearance_from_a_distant_board_is_that_of_the_outermost_part():
    q = np.array([0.0, -0.5, 0.0, -1.5, 0.0, 1.5, 0.8])
    still = np.zeros((1, 1, 3))
    distances = []
    for far in (3.0, 4.0):
        reach, X_WB = small_board([far, 0.0, 0.4])
        distances.append(reach.clearance([X_WB], at(q), still)[0][0, 0])
    assert distances[1] - distances[0] == pytest.approx(1.0, abs=0.02)
    # The board's edge is at 2.99 m, and no link is in front of 0.8 m.
    assert 2.1 < distances[0] < 2.9


def test_without_a_board_nothing_is_near():
    scenario = Scenario()
    scenario.board.shape = "none"
    reach = BoardReach(scenario, FollowingBounds())
    gaps, link = reach.clearance([TILTED], at(np.zeros(7)), np.zeros((1, 1, 3)))
    assert gaps.tolist() == [[np.inf]]
    assert link == ""


# Moves into reach --------------------------------------------------------


def moves(scenario, paths, **options):
    """Return the moves of the board that bring paths into reach."""
    reach = BoardReach(scenario, FollowingBounds())
    return reach.moves_into_reach(paths, np.zeros_like(paths), STEP, **options)


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """An arm that stands somewhere, and a board in front of it."""
    panda = LoadRobot("panda")
    panda.base_pose.translation, panda.base_pose.rpy = [0.3, -0.4, 0.2], [0, 0, 2.0]
    file = tmp_path_factory.mktemp("robots") / "panda.yaml"
    file.write_text(yaml_dump_typed(panda), encoding="utf-8")
    scenario = Scenario(robot=str(file))
    base = np.array(panda.base_pose.translation)
    away = np.array([np.cos(2.0), np.sin(2.0), 0.0])
    scenario.board.translation = [*(base + 0.5 * away + [0, 0, 0.15])]
    scenario.board.rpy = [0, 0, 2.0]
    return scenario, away


def test_moves_are_told_from_where_the_arm_stands(elsewhere):
    scenario, away = elsewhere
    left = np.array([-away[1], away[0], 0.0])
    up = np.array([0.0, 0.0, 1.0])
    ways = {"towards the arm": -away, "away from the arm": away, "up": up}
    ways |= {"down": -up, "to the arm's left": left, "to the arm's right": -left}
    found = moves(scenario, stroke(4))
    told = []
    for words, move in found:
        far, way = re.fullmatch(r"move the board (\d+) cm (.*)", words).groups()
        told.append((way, int(far)))
        assert_allclose(move, 0.01 * int(far) * ways[way], atol=1e-9)
    # In each direction at least the smallest one, of 5 cm; the shortest ones first.
    assert {way for way, _ in told} == set(ways)
    assert len(set(told)) == len(told)
    lengths = [far for _, far in told]
    assert lengths == sorted(lengths)
    assert lengths.count(5) == 6
    assert max(lengths) <= 100 * LONGEST_MOVE + 1e-9 < 42


def test_moves_that_are_named_bring_the_path_into_reach_and_others_do_not():
    path = stroke(5) + np.array([0.1, 0.0, 0.0])
    scenario = Scenario()
    scenario.board.translation = [0.85, 0.0, 0.1]
    named = [
        m for words, m in moves(scenario, path) if words.endswith("towards the arm")
    ]
    shortest = -named[0][0]
    for by, is_reached in ((shortest, True), (shortest - 0.05, False)):
        there = Scenario()
        there.board.translation = [0.85 - by, 0.0, 0.1]
        reach = BoardReach(there, FollowingBounds())
        X_WB = [there.board.assumed_pose()]
        postures = reach.near_postures(X_WB)
        motion = reach.follow(X_WB, path, step=STEP, postures=postures)
        far, tilted, *_ = reach.missed(motion)
        assert np.any(far | tilted) != is_reached


@pytest.mark.parametrize("side", [[0, 2.0], [0, -2.0], [2.0, 0], [-2.0, 0]])
def test_no_move_helps_where_one_path_goes_far_to_any_side(side):
    paths = np.zeros((6, 4, 3))
    paths[3, 2, :2] = side
    assert moves(Scenario(), paths) == []


def test_the_first_path_counts_as_it_begins_at_the_start():
    # It is not the outermost one to any side.
    paths = np.zeros((6, 4, 3))
    for i, (x, y) in enumerate([(0.1, 0), (-0.1, 0), (0, 0.1), (0, -0.1)]):
        paths[2 + i, :, :2] = x, y
    assert moves(Scenario(), paths)
    paths[0, :, 2] = 1.5
    assert moves(Scenario(), paths) == []


def test_a_board_that_an_arm_would_touch_is_not_moved_there():
    scenario = Scenario()
    scenario.board.translation = [0.55, 0.0, 0.1]
    free = Scenario()
    free.board.shape = "none"
    free.board.translation = scenario.board.translation
    scenario.board.size = [1.0, 0.7]
    near, any_move = (
        {m.removeprefix(p) for m, _ in moves(s, stroke(4))}
        for s, p in (
            (scenario, "move the board "),
            (free, "move the motion (board.translation) "),
        )
    )
    assert near < any_move


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.0, 0.0, 1.2], [1.5, 0.0, 0.0]])
def test_moves_are_for_the_tool_as_it_is_held(turn):
    """A tool that jumps from one orientation to another cannot be followed."""
    scenario = Scenario()
    scenario.board.shape = "none"
    level = RollPitchYaw(np.pi, 0, 0).ToRotationMatrix().matrix()
    turned = RollPitchYaw(turn).ToRotationMatrix().matrix() @ level
    R_TE = np.array([[level, level, turned, turned, level, level]])
    assert bool(moves(scenario, stroke(6), R_TE=R_TE)) == (not any(turn))
