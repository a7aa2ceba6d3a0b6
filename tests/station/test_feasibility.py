"""Facts about the check before the start: can the arm follow the skill on the board?"""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.errors import StationError
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.station import CheckFeasibility, ListScenarios, LoadScenario, Scenario
from fmp_drake.station.parts.board_reach import BoardReach, FollowingBounds


def kinematics():
    """Return a scenario of each board, posture, motion and press."""
    known = {}
    for name in ListScenarios():
        s = LoadScenario(name)
        soft = s.impedance.covariance_stiffness.enabled
        known.setdefault(repr((s.board, s.posture, s.skill.tempo, soft)), name)
    return known.values()


def check(skill, *, x=0.55, tempo=1.0, press=10.0, start=(0.0, 0.0, 0.05)):
    scenario = Scenario()
    scenario.board.translation[0] = x
    scenario.skill.tempo = tempo
    scenario.press.force = press
    scenario.start = list(start)
    return CheckFeasibility(scenario, skill)


@pytest.mark.parametrize("name", kinematics())
def test_bundled_scenario_can_be_followed(bundled_skill, name):
    found = CheckFeasibility(LoadScenario(name), bundled_skill)
    assert found.is_feasible
    assert np.all(found.followed)
    assert found.values["reachable_fraction"] == 1
    assert found.values["largest_distance"] < 1e-3
    assert found.values["smallest_joint_margin"] > 0.13


@pytest.mark.parametrize(
    ("x", "reason"), [(0.80, "out of reach, by up to"), (0.35, "at a joint's wall")]
)
def test_board_too_far_or_too_near_is_refused_and_the_move_helps(
    bundled_skill, x, reason
):
    found = check(bundled_skill, x=x)
    assert not found.is_feasible
    assert reason in found.verdict
    assert not np.all(found.followed)
    far, way = re.search(r"board (\d+) cm (towards|away)", found.verdict).groups()
    moved = x + float(far) / 100 * (1 if way == "away" else -1)
    assert check(bundled_skill, x=moved).is_feasible


def test_skill_that_is_too_fast_is_refused_and_the_tempo_helps(bundled_skill):
    found = check(bundled_skill, tempo=3.0)
    assert not found.is_feasible
    tempo = float(re.search(r"slow down to tempo ([\d.]+)", found.verdict)[1])
    slower = check(bundled_skill, tempo=tempo)
    assert slower.is_feasible
    assert slower.values["largest_speed_ratio"] > 0.8


def test_press_whose_friction_drags_the_eraser_is_refused(bundled_skill):
    found = check(bundled_skill, press=34.0)
    assert not found.is_feasible
    # 0.5 * 34 N at 1500 N/m; a run of 10 s was 11.6 mm rms off its path.
    assert_allclose(found.values["drag"], 0.01133, rtol=1e-3)
    assert "press with at most 30 N" in found.verdict


def test_start_out_of_reach_is_said_and_not_raised(bundled_skill):
    found = check(bundled_skill, start=(0.0, 0.0, 1.2))
    assert not found.is_feasible
    assert "the start is out of reach" in found.verdict


def test_standstill_is_checked_as_a_slow_movement(bundled_skill):
    assert check(bundled_skill, tempo=0.0).is_feasible


def test_skill_without_three_channels_is_refused(small_skill):
    with pytest.raises(StationError, match="2 channels"):
        CheckFeasibility(Scenario(), small_skill)


def test_verdict_is_one_line_and_values_are_plain_numbers(bundled_skill):
    found = check(bundled_skill)
    assert "\n" not in found.verdict
    assert all(type(value) is float for value in found.values.values())
    assert found.margin.shape == (len(found.x), len(found.y))
    assert isinstance(bundled_skill, FourierMovementPrimitive)


def test_arm_that_cannot_reach_rests_where_its_springs_balance():
    scenario = Scenario()
    reach = BoardReach(scenario, FollowingBounds())
    board = [scenario.board.assumed_pose()]
    paths = np.zeros((1, 60, 3))
    paths[0, :, 0] = np.minimum(0.01 * np.arange(60), 0.35)
    posture = reach.start_posture()
    motion = reach.follow(board, paths, step=0.1, postures=posture[None])
    assert np.all(np.linalg.norm(motion.error[0, :10, 3:], axis=1) < 1e-4)
    wrench = scenario.impedance.stiffness() @ motion.error[0, -1]
    assert np.linalg.norm(motion.error[0, -1, 3:]) > 0.05
    # A board whose axes are the world's: the Jacobian is needed in no other frame.
    J = numeric_jacobian(reach, motion.q[0, -1])
    assert np.max(np.abs(J.T @ wrench)) < 0.05 * np.linalg.norm(wrench)


def numeric_jacobian(reach, q):
    arm, tip = reach._arm, reach._tip
    context = arm.CreateDefaultContext()
    columns = []
    for i in range(7):
        poses = []
        for sign in (-1, 1):
            at = q.copy()
            at[i] += sign * 1e-6
            arm.SetPositions(context, at)
            poses.append(tip.CalcPoseInWorld(context))
        turned = poses[1].rotation() @ poses[0].rotation().inverse()
        angle_axis = turned.ToAngleAxis()
        moved = poses[1].translation() - poses[0].translation()
        turn = angle_axis.angle() * angle_axis.axis()
        columns.append(np.concatenate([turn, moved]) / 2e-6)
    return np.array(columns).T
