"""Facts about the verdict on a predicted motion, with predictions that a test makes up."""

import functools
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from posed_recordings import demonstration

from fmp_drake.primitives import FourierMovementPrimitive, transform_space
from fmp_drake.station import CheckFeasibility, Scenario
from fmp_drake.station.reach import board_reach
from fmp_drake.station.reach.board_reach import BoardReach, FollowingBounds
from fmp_drake.station.reach.deviation_prediction import Deviation, predict_lift
from fmp_drake.station.reach.tracking_prediction import PredictedMotion
from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel
from fmp_drake.systems.interface.arm_model import joint_limits
from fmp_drake.systems.scripted_disturbances import Disturbance

# Of the samples of a check; its paths are 51 of 10 samples.
COUNT = 510
# Of the joints' limits, the fastest and the most loaded one of a prediction.
SPEED, TORQUE = 0.4, 0.3
QUICK, LOADED = 2, 4
pytestmark = pytest.mark.usefixtures("skills_sampled_once")


@functools.cache
def limits():
    """Return the limits of the arm."""
    return joint_limits(
        MakeRobotModel(LoadRobot("panda"), Scenario().held_tool()).plant
    )


class Predictions:
    """Predictions in place of those of the arm, and what was asked for."""

    def __init__(self):
        self.asked = []

    def change(self, motion, **options):
        """Change a prediction in place; a test says how."""

    def follow(self, X_WB, paths, *, step, postures, **options):
        """Return a motion that every bound allows, as it is changed."""
        self.asked.append({"X_WB": X_WB, "step": step, "paths": paths, **options})
        shape, n = (len(X_WB) * len(paths), paths.shape[1]), postures.shape[1]
        q = np.broadcast_to(limits().middle, (*shape, n)).copy()
        v, torque = (np.zeros((*shape, n)) for _ in range(2))
        M, J = np.tile(np.eye(n), (*shape, 1, 1)), np.zeros((*shape, 6, n))
        v[..., QUICK] = -SPEED * limits().speed[QUICK]
        torque[..., LOADED] = -TORQUE * limits().upper_effort[LOADED]
        error, manipulability = np.zeros((*shape, 6)), np.full(shape, 0.1)
        motion = PredictedMotion(q, v, torque, M, J, error, manipulability)
        self.change(motion, step=step)
        return motion


def far_away(motion):
    """Return a clearance of 5 cm, and a link."""
    return np.full(motion.q.shape[:2], 0.05), "link5"


def lag_per_newton(found, *, stiffness=1500):
    """Return the lag by friction, m/N; the eraser presses at a part of the samples."""
    pressed = np.mean(found.paths[..., 2] < Scenario().press.engage_height)
    assert 0.9 < pressed < 1
    return np.sqrt(pressed) * Scenario().contact_friction() / stiffness


@pytest.fixture
def predicted(monkeypatch):
    """Predictions that a test changes; the clearance is 5 cm, the start bears any force."""
    predictions = Predictions()

    def follow(_reach, *args, **options):
        return predictions.follow(*args, **options)

    monkeypatch.setattr(BoardReach, "follow", follow)
    monkeypatch.setattr(BoardReach, "clearance", lambda *args: far_away(args[2]))
    monkeypatch.setattr(BoardReach, "start_force", lambda *_args: np.inf)
    return predictions


def deviation_of(motion, *, force=0.0, tilt=0.0, lag=0.0):
    """Return the same deviation from every sample of a motion."""
    shape = motion.q.shape[:2]
    pose = np.broadcast_to([0.0, tilt, 0.0, 0.0, lag, 0.0], (*shape, 6))
    return Deviation(pose, np.full(shape, force))


@pytest.fixture
def deviate(monkeypatch):
    """A function that sets the predicted deviation."""

    def set_to(**values):
        monkeypatch.setattr(
            board_reach,
            "predict_deviation",
            lambda _config, _limits, motion, *_, **__: deviation_of(motion, **values),
        )

    return set_to


def few(count, motion):
    """Return the index of some samples that are not the first ones, (B, T)."""
    out = np.zeros(motion.q.shape[:2], dtype=bool)
    out.reshape(-1)[7 : 7 + count] = True
    return out


@pytest.fixture(scope="module")
def stirring():
    """A skill with rotation channels, and its scenario."""
    shown = demonstration(height=0.1, tilt=0.1)
    skill = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4).fit(shown)
    return skill


def test_a_motion_within_all_bounds_is_accepted_with_its_values(
    predicted, restless_skill
):
    def change(motion, **_):
        motion.error[few(1, motion), 3:5] = [0.003, -0.004]
        motion.q[..., 0] = limits().middle[0] + limits().half_range[0] - 0.2
        motion.manipulability[few(1, motion)] = 0.07

    predicted.change = change
    scenario = Scenario()
    scenario.skill.tempo = 1.5
    found = CheckFeasibility(scenario, restless_skill)
    assert found.is_feasible
    assert found.paths.shape[0] * found.paths.shape[1] == COUNT
    assert np.all(found.followed)
    assert (
        "stays 0.20 rad from its joint limits and needs up to 40 % of the speed limits "
        "and 30 % of the torque limits" in found.verdict
    )
    values = found.values
    assert values["reachable_fraction"] == 1
    assert values["largest_distance"] == pytest.approx(0.005)
    assert values["smallest_joint_margin"] == pytest.approx(0.2)
    assert values["wall_fraction"] == 0
    assert values["smallest_manipulability"] == pytest.approx(0.07)
    assert values["smallest_clearance"] == pytest.approx(0.05)
    assert values["largest_speed_ratio"] == pytest.approx(SPEED)
    assert values["largest_torque_ratio"] == pytest.approx(TORQUE)
    assert values["deviation"] == values["force_error"] == 0
    # Joints are braked above 85 % of their speed.
    assert values["largest_tempo"] == pytest.approx(1.5 * 0.85 / SPEED)
    assert "largest_angle" not in values
    # The friction of 10 N at 1500 N/m where the eraser presses, and the rms distance.
    lag = lag_per_newton(found) * 10
    assert values["friction_lag"] == pytest.approx(lag)
    expected = np.hypot(lag, 0.005 / np.sqrt(COUNT))
    assert values["tracking_error"] == pytest.approx(expected)


# Reach -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "distance", "is_feasible"),
    [
        (1, 1.0, True),  # One sample of 510 is less than 0.2 %.
        (5, 0.015, True),
        (5, 0.045, False),  # Farther than 40 mm.
        (400, 0.009, True),
        (400, 0.011, False),  # 9.7 mm rms.
    ],
)
def test_distances_for_moments_are_judged_by_rms_and_largest(
    predicted, restless_skill, count, distance, is_feasible
):
    def change(motion, **_):
        motion.error[few(count, motion), 4] = distance

    predicted.change = change
    bounds = FollowingBounds(tracking_error=5.0 if count == 1 else 0.75)
    found = CheckFeasibility(Scenario(), restless_skill, bounds=bounds)
    assert found.is_feasible == is_feasible
    missed = count / COUNT if distance > 0.010 else 0.0
    assert found.values["reachable_fraction"] == pytest.approx(1 - missed)
    assert np.mean(found.followed) == pytest.approx(1 - missed)
    if not is_feasible:
        expected = f"{100 * missed:.1f} % of the path is out of reach, by up to "
        assert f"{expected}{1e3 * distance:.0f} mm." in found.verdict


@pytest.mark.parametrize(
    ("count", "tilt", "is_feasible"),
    [
        (1, 0.7, True),
        (5, 0.15, True),
        (5, 0.25, False),
        (400, 0.09, True),
        (100, 0.11, False),  # 0.049 rad rms.
    ],
)
def test_tilts_for_moments_are_judged_by_rms_and_largest(
    predicted, restless_skill, count, tilt, is_feasible
):
    def change(motion, **_):
        motion.error[few(count, motion), 0] = tilt

    predicted.change = change
    found = CheckFeasibility(Scenario(), restless_skill)
    assert found.is_feasible == is_feasible
    expected = f"is out of reach, by up to 0 mm and {np.rad2deg(tilt):.0f} degrees"
    assert (expected in found.verdict) != is_feasible


def test_a_joint_at_its_spring_is_named_only_where_the_path_is_missed(
    predicted, restless_skill
):
    for missed, named in ((7, True), (9, False)):

        def change(motion, missed=missed, **_):
            motion.error[:, missed : missed + 1, 3] = 0.05
            motion.q[:, 7:8, 5] = limits().middle[5] - limits().half_range[5] + 0.05

        predicted.change = change
        found = CheckFeasibility(Scenario(), restless_skill)
        text = ", where joint 6 is at a joint-limit spring"
        assert (text in found.verdict) == named
        assert found.values["wall_fraction"] == pytest.approx(0.1)
        assert found.values["smallest_joint_margin"] == pytest.approx(0.05)


def test_rotation_channels_are_judged_about_the_normal_too(predicted, stirring):
    def change(motion, **_):
        # The normal is the third axis; of the others alone it would be 5 mm and 0.06 rad.
        motion.error[:, 1] = [0.04, 0.05, 0.29, 0.005, 0.0, 0.0]

    predicted.change = change
    found = CheckFeasibility(Scenario(), stirring)
    assert not found.is_feasible
    angle = np.sqrt(0.04**2 + 0.05**2 + 0.29**2)
    assert found.values["largest_angle"] == pytest.approx(angle)
    assert "out of reach, by up to 5 mm and 17 degrees" in found.verdict
    assert predicted.asked[0]["R_TE"].shape == (*found.paths.shape, 3)


@pytest.mark.parametrize(("at_spring", "named"), [(7, True), (9, False)])
def test_an_orientation_out_of_reach_is_not_blamed_on_a_fast_joint(
    predicted, stirring, at_spring, named
):
    """As in a run on a fender: 0.6 degrees of a joint at its limit, another at 114 %."""

    def change(motion, **_):
        motion.error[:, 7:8, 2] = 0.05
        motion.q[:, at_spring : at_spring + 1, 5] = -limits().half_range[5] + (
            limits().middle[5] + 0.05
        )
        motion.v[..., 3] = 0.96 * limits().speed[3]

    predicted.change = change
    found = CheckFeasibility(Scenario(), stirring)
    spring = ", where joint 6 is at a joint-limit spring" if named else ""
    text = f"skill: the tool is off its orientation by 0.9 degrees rms{spring}. "
    assert text in found.verdict
    assert found.suggested_tempo is None


@pytest.mark.parametrize(
    ("damping", "tolerance"), [(10.0, 0.0059), (10.0, 0.0061), (0.5, 0.0059)]
)
def test_damping_holds_the_eraser_back_in_the_direction_of_friction(
    restless_skill, monkeypatch, damping, tolerance
):
    """The lags of both add up, as runs with damped arms of six and seven joints do."""
    monkeypatch.setattr(board_reach, "joint_damping", lambda _: np.full(7, damping))
    monkeypatch.setattr(
        board_reach,
        "predict_deviation",
        lambda _config, _limits, motion, *_, **__: deviation_of(motion, lag=0.00275),
    )
    scenario = Scenario(tolerance=tolerance)
    found = CheckFeasibility(scenario, restless_skill, suggest=False)
    lag, friction = 0.00275, found.values["friction_lag"]
    assert_allclose(friction, 0.00323, atol=0.00002)
    expected = lag + friction if damping > 0.5 else np.hypot(lag, friction)
    assert_allclose(found.values["tracking_error"], expected, rtol=0.01)
    assert found.is_feasible == (expected < tolerance)


@pytest.mark.usefixtures("predicted")
@pytest.mark.parametrize(("count", "is_feasible"), [(1, True), (40, False)])
def test_links_that_come_near_the_board_are_named(
    restless_skill, monkeypatch, count, is_feasible
):
    def near(motion):
        return np.where(few(count, motion), 0.015, 0.03), "link7"

    monkeypatch.setattr(BoardReach, "clearance", lambda *args: near(args[2]))
    found = CheckFeasibility(Scenario(), restless_skill)
    assert found.is_feasible == is_feasible
    assert found.values["smallest_clearance"] == pytest.approx(0.015)
    assert np.sum(~found.followed) == count
    if not is_feasible:
        text = (
            "on 7.8 % of the path link7 touches the board, or comes nearer than 20 mm"
        )
        assert text in found.verdict


def test_a_sample_is_followed_if_it_is_on_the_assumed_and_on_the_actual_board(
    predicted, restless_skill
):
    def change(motion, **_):
        motion.error[[3, len(motion.error) // 2 + 5], 4, 3] = 0.02

    predicted.change = change
    scenario = Scenario()
    scenario.board.error.translation = [0.0, 0.01, 0.0]  # One number is enough.
    found = CheckFeasibility(scenario, restless_skill)
    assumed, actual = predicted.asked[0]["X_WB"]
    assert_allclose(actual.translation() - assumed.translation(), [0, 0.01, 0])
    assert np.argwhere(~found.followed).tolist() == [[3, 4], [5, 4]]


# Speed -------------------------------------------------------------------


@pytest.mark.parametrize(("count", "ratio"), [(1, SPEED), (60, 0.9)])
def test_speed_ratio_leaves_out_what_is_hardly_ever_played(
    predicted, restless_skill, count, ratio
):
    def change(motion, **_):
        motion.v[few(count, motion), 1] = 0.9 * limits().speed[1]

    predicted.change = change
    found = CheckFeasibility(Scenario(), restless_skill)
    assert found.is_feasible
    assert found.values["largest_speed_ratio"] == pytest.approx(ratio)


def test_speed_at_which_a_joint_is_braked_is_said(predicted, restless_skill):
    def change(motion, **_):
        motion.v[few(60, motion), 1] = 1.1 * limits().speed[1]

    predicted.change = change
    verdict = CheckFeasibility(Scenario(), restless_skill).verdict
    assert "up to 110 % of the speed limits, at which joints are braked, and" in verdict


def fast(ratio, count):
    """Return a change: a joint at a ratio of its speed at tempo 1, in some samples."""

    def change(motion, *, step, **_):
        v = -ratio * limits().speed[5] * 0.1 / step
        motion.v[few(count, motion), 5] = v

    return change


def test_a_fifth_of_the_samples_may_be_too_fast(predicted, restless_skill):
    predicted.change = fast(1.2, 100)
    assert CheckFeasibility(Scenario(), restless_skill).is_feasible
    predicted.change = fast(1.2, 110)
    found = CheckFeasibility(Scenario(), restless_skill)
    expected = (
        "joint 6 needs 120 % of its greatest speed, and more than 100 % on 21.6 % of"
    )
    assert expected in found.verdict


@pytest.mark.parametrize("tempo", [1.0, 1.7])
def test_the_slower_tempo_is_the_fastest_one_below_which_no_joint_is_braked(
    predicted, restless_skill, tempo
):
    predicted.change = fast(1.3, 200)
    scenario = Scenario()
    scenario.skill.tempo = tempo
    found = CheckFeasibility(scenario, restless_skill)
    largest = found.values["largest_tempo"]
    assert largest == pytest.approx(0.85 / 1.3)
    named = float(re.search(r"slow down to tempo (\d\.\d\d)\.", found.verdict)[1])
    assert named == pytest.approx(found.suggested_tempo)
    assert largest - 0.05 < named <= largest


@pytest.mark.parametrize("possible", [0.95, 0.8])
def test_slower_tempi_are_tried_where_the_first_one_does_not_help(
    predicted, restless_skill, possible
):
    """As of an arm whose speed does not scale with the tempo."""
    slowest = 0.1 / (0.85 / 1.2) / possible

    def change(motion, *, step, **_):
        motion.v[..., 5] = (1.2 if step < slowest else 0.5) * limits().speed[5]

    predicted.change = change
    tempo = CheckFeasibility(Scenario(), restless_skill).suggested_tempo
    assert 0.85 * possible < tempo / (0.85 / 1.2) <= possible


def test_a_tempo_that_helps_is_never_zero(predicted, restless_skill):
    def change(motion, *, step, **_):
        motion.v[..., 5] = (60 if step < 0.11 else 0.5) * limits().speed[5]

    predicted.change = change
    found = CheckFeasibility(Scenario(), restless_skill)
    named = float(re.search(r"slow down to tempo (\d\.\d\d)\.", found.verdict)[1])
    assert named == found.suggested_tempo > 0


def test_samples_are_as_far_apart_as_they_are_played(predicted, restless_skill):
    for tempo, slowest in ((2.0, 2.0), (0.5, 0.5), (0.01, 0.25)):
        scenario = Scenario()
        scenario.skill.tempo = tempo
        found = CheckFeasibility(scenario, restless_skill)
        steps = restless_skill.n_steps / found.paths.shape[1]
        expected = steps / (slowest * restless_skill.rate)
        assert predicted.asked[-1]["step"] == pytest.approx(expected)


def test_what_joints_cannot_follow_adds_to_the_tracking_error(
    predicted, restless_skill, deviate
):
    def change(motion, **_):
        motion.error[..., 3:] = [0.002, 0.0, 0.001]

    predicted.change = change
    deviate(lag=0.005)
    values = CheckFeasibility(Scenario(), restless_skill).values
    assert values["deviation"] == pytest.approx(0.005)
    squares = [0.002**2 + 0.001**2, 0.005**2, values["friction_lag"] ** 2]
    assert values["tracking_error"] == pytest.approx(np.sqrt(sum(squares)))
    assert values["largest_distance"] == pytest.approx(np.hypot(0.002, 0.001))


@pytest.mark.usefixtures("predicted")
@pytest.mark.parametrize(
    ("lag", "tilt", "words"),
    [
        (0.012, 0.02, "by 12.4 mm and 1.1 degrees rms"),
        (0.001, 0.12, "by 3.4 mm and 6.9 degrees rms"),
        (0.001, 0.02, None),
    ],
)
def test_a_tool_that_joints_take_off_its_path_is_refused(
    restless_skill, deviate, lag, tilt, words
):
    deviate(lag=lag, tilt=tilt)
    found = CheckFeasibility(Scenario(), restless_skill)
    assert found.is_feasible == (words is None)
    if words:
        assert f"this skill: the tool is off its path {words}" in found.verdict


@pytest.mark.parametrize("damping", [10.0, 0.5])
def test_joints_that_are_damped_are_named_and_a_tempo_by_their_lag(
    predicted, restless_skill, monkeypatch, damping
):
    """As of an arm whose lag is proportional to its tempo, 17 mm as demonstrated."""
    monkeypatch.setattr(board_reach, "joint_damping", lambda _: np.full(7, damping))

    def lagging(_config, _limits, motion, *_, joint_damping, **__):
        assert_allclose(joint_damping, damping if damping > 0.5 else 0.0)
        return deviation_of(motion, lag=0.0017 / predicted.asked[-1]["step"])

    monkeypatch.setattr(board_reach, "predict_deviation", lagging)
    found = CheckFeasibility(Scenario(), restless_skill)
    words = "joints are damped by up to 10 Nm s/rad in the robot's model, and the tool"
    assert (words in found.verdict) == (damping > 0.5)
    assert found.suggested_tempo == (0.35 if damping > 0.5 else None)


def test_joints_whose_damping_disturbs_the_force_are_slowed_down(
    predicted, restless_skill, monkeypatch
):
    """As of an arm that presses 10 N too hard as demonstrated, and less at a lower tempo."""
    monkeypatch.setattr(board_reach, "joint_damping", lambda _: np.full(7, 10.0))

    def pressing(_config, _limits, motion, *_, **__):
        return deviation_of(motion, force=1.0 / predicted.asked[-1]["step"])

    monkeypatch.setattr(board_reach, "predict_deviation", pressing)
    found = CheckFeasibility(Scenario(), restless_skill)
    assert "the normal force is off by more than 5 N" in found.verdict
    assert found.suggested_tempo == 0.35


@pytest.mark.usefixtures("predicted")
@pytest.mark.parametrize(("lag", "is_feasible"), [(0.0025, False), (0.0023, True)])
def test_deviation_and_friction_share_the_tolerance(
    restless_skill, deviate, lag, is_feasible
):
    scenario = Scenario(tolerance=0.005)
    deviate(lag=lag, tilt=0.0)
    # Runs are up to 1.5 times as far off by joints as predicted, but not by friction.
    found = CheckFeasibility(scenario, restless_skill)
    friction_lag = lag_per_newton(found) * 10
    assert (np.hypot(lag / 0.65, friction_lag) < 0.005) == is_feasible
    assert found.is_feasible == is_feasible


def test_distance_from_the_path_is_compared_with_the_tolerance(
    predicted, restless_skill
):
    def change(motion, **_):
        motion.error[..., 4] = 0.004

    predicted.change = change
    scenario = Scenario()
    assert CheckFeasibility(scenario, restless_skill).is_feasible
    scenario.tolerance = 0.0039
    verdict = CheckFeasibility(scenario, restless_skill).verdict
    assert "100.0 % of the path is out of reach, by up to 4 mm" in verdict


def test_speed_and_torque_of_an_arm_out_of_reach_are_not_judged(
    predicted, restless_skill
):
    def change(motion, **_):
        motion.error[..., 3] = 0.05
        motion.v[..., 3] = 3 * limits().speed[3]
        motion.torque[..., 1] = 2 * limits().upper_effort[1]

    predicted.change = change
    found = CheckFeasibility(Scenario(), restless_skill)
    assert "100.0 % of the path is out of reach" in found.verdict
    assert "speed" not in found.verdict
    assert "torque" not in found.verdict
    assert found.suggested_tempo is None


# Force -------------------------------------------------------------------


def pressed_without_friction(scenario):
    """Let neither friction nor the felt limit the normal force."""
    scenario.board.friction, scenario.eraser.modulus = 1e-3, 1e7


def loads(per_newton, torque, joint=1):
    """Return a change: torque of a joint, Nm, and of a newton of normal force, m."""

    def change(motion, **_):
        motion.torque[..., joint] = torque
        motion.J[..., 5, joint] = -per_newton

    return change


@pytest.mark.parametrize(
    ("per_newton", "torque"), [(0.5, 10.0), (0.5, -10.0), (-0.5, 10.0), (-0.5, -10.0)]
)
def test_the_largest_press_leaves_the_joints_a_tenth_of_their_torque(
    predicted, restless_skill, per_newton, torque
):
    predicted.change = loads(per_newton, torque)
    scenario = Scenario()
    pressed_without_friction(scenario)
    effort = limits().upper_effort[1]
    for force in (20.0, 100.0):
        scenario.press.force = force
        values = CheckFeasibility(scenario, restless_skill).values
        ratio = max(abs(torque + force * per_newton) / effort, TORQUE)
        assert values["largest_torque_ratio"] == pytest.approx(ratio)
        expected = (0.9 * effort - np.sign(per_newton) * torque) / 0.5
        assert values["largest_press"] == pytest.approx(expected)


def test_too_much_torque_is_refused_and_a_smaller_press_helps(
    predicted, restless_skill
):
    predicted.change = loads(-0.5, 30.0)
    scenario = Scenario()
    pressed_without_friction(scenario)
    scenario.press.force = 250.0
    found = CheckFeasibility(scenario, restless_skill)
    # 95 of 87 Nm.
    words = "joint 2 needs 109 % of its greatest torque. What would help: press"
    assert words in found.verdict
    largest = (0.9 * 87 + 30) / 0.5
    assert found.values["largest_press"] == pytest.approx(largest)
    assert f"press with at most {int(largest)} N." in found.verdict
    assert found.suggested_tempo is None


def test_friction_limits_the_press_as_well(predicted, restless_skill):
    predicted.change = loads(-0.1, 0.0)
    scenario = Scenario()
    scenario.impedance.translational_stiffness = [1500.0, 1000.0, 3000.0]
    scenario.press.force = 40.0
    found = CheckFeasibility(scenario, restless_skill)
    # The softer direction counts.
    per_newton = lag_per_newton(found, stiffness=1000)
    assert found.values["friction_lag"] == pytest.approx(40 * per_newton)
    assert found.values["largest_press"] == pytest.approx(0.010 / per_newton)
    lag = 40e3 * per_newton
    assert (
        f"at a normal force of 40 N friction holds the eraser {lag:.1f} mm rms behind its "
        f"path. What would help: press with at most {int(0.010 / per_newton)} N."
        in found.verdict
    )


def test_both_a_slower_tempo_and_a_smaller_press_are_named(predicted, restless_skill):
    predicted.change = fast(1.3, 200)
    scenario = Scenario()
    scenario.press.force = 36.0
    found = CheckFeasibility(scenario, restless_skill)
    assert re.search(
        r"help: slow down to tempo 0\.65 and press with at most 30 N\.", found.verdict
    )
    assert found.suggestion == {"tempo": pytest.approx(0.65), "press_force": 30.0}
    assert found.suggested_tempo is None  # It alone would not do.


def test_torques_of_the_press_count_with_their_signs_in_each_sample(
    predicted, restless_skill
):
    """Joints with opposite signs: none of them bears the sum of the absolute values."""

    def change(motion, **_):
        motion.torque[..., :2] = [-40.0, 40.0]
        motion.J[..., 5, :2] = [-0.4, 0.4]

    predicted.change = change
    scenario = Scenario()
    pressed_without_friction(scenario)
    scenario.press.force = 100.0
    found = CheckFeasibility(scenario, restless_skill)
    assert found.is_feasible
    assert found.values["largest_torque_ratio"] == pytest.approx(TORQUE)


@pytest.mark.parametrize("count", [1, 60])
def test_torques_that_are_hardly_ever_needed_do_not_count(
    predicted, restless_skill, count
):
    effort = limits().upper_effort[1]

    def change(motion, **_):
        motion.torque[few(count, motion), 1] = 0.8 * effort
        motion.J[few(count, motion), 5, 1] = -0.02 * effort
        motion.J[few(COUNT, motion), 5, 3] = -0.01 * effort

    predicted.change = change
    scenario = Scenario()
    pressed_without_friction(scenario)
    scenario.press.force = 2.0
    values = CheckFeasibility(scenario, restless_skill).values
    expected = TORQUE if count == 1 else 0.84
    assert values["largest_torque_ratio"] == pytest.approx(expected)
    # At 5 N that joint has 90 % of its torque; without it the other one has at 90 N.
    expected = 90.0 if count == 1 else 5.0
    assert values["largest_press"] == pytest.approx(expected)


def test_force_of_a_skill_counts_between_none_and_its_largest_one(predicted):
    shown = demonstration(height=-0.004, force=(10.0, 12.0))
    skill = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4).fit(shown)
    effort = limits().upper_effort[1]
    predicted.change = loads(-0.5, 0.5 * effort)
    scenario = Scenario()
    scenario.press.force = 1.0
    scenario.board.error.translation = [0.0, 0.01, 0.0]  # Two boards.
    values = CheckFeasibility(scenario, skill).values
    # The eraser cannot pull: where the hand did, the torque is that without a press.
    assert values["largest_torque_ratio"] == pytest.approx(0.5, abs=1e-4)
    rms = values["friction_lag"] * 1500 / scenario.contact_friction()
    force = np.clip(10 + 12 * np.cos(np.linspace(0, 2 * np.pi, 100)), 0, None)
    assert rms == pytest.approx(np.sqrt(np.mean(force**2)), rel=0.05)
    assert values["tracking_error"] == pytest.approx(values["friction_lag"])


@pytest.mark.parametrize(("count", "is_feasible"), [(0, True), (1, False)])
def test_normal_force_that_braked_joints_disturb_is_refused(
    predicted, restless_skill, monkeypatch, count, is_feasible
):
    def error(_config, _limits, motion, contact, *, q_posture, step, joint_damping):
        assert contact.force == 10.0
        assert not np.any(joint_damping)  # The Panda's is slight.
        # The felt of 0.12 by 0.05 m² has its modulus at half of its thickness of 0.03 m.
        assert contact.stiffness == pytest.approx(1.25e4 * 0.006 / 0.015)
        assert q_posture.shape == motion.q.shape[2:]
        assert step == pytest.approx(predicted.asked[-1]["step"])
        out = deviation_of(motion, force=1.9)._replace(hindrance="joint 1 is braked")
        if step < 0.12:  # Slower than tempo 0.83 nothing is braked.
            out.force[few(count, motion)] = -5.1
        return out

    monkeypatch.setattr(board_reach, "predict_deviation", error)
    predicted.change = fast(1.05, 40)
    found = CheckFeasibility(Scenario(), restless_skill)
    assert found.is_feasible == is_feasible
    assert found.values["unsteady_fraction"] == pytest.approx(count / COUNT)
    if not is_feasible:
        assert found.verdict == (
            "The arm cannot follow this skill: joint 1 is braked, and on 0.2 % of the path "
            "the normal force is off by more than 5 N. What would help: slow down to tempo "
            "0.80."
        )
        assert found.suggested_tempo == pytest.approx(0.8)


@pytest.mark.usefixtures("predicted")
@pytest.mark.parametrize(
    ("force", "error", "is_off"),
    [(3.0, -3.1, 1), (3.0, -2.9, 0), (8.0, -4.9, 0), (8.0, -5.1, 1), (3.0, 5.1, 1)],
)
def test_contact_that_is_lost_counts_as_a_normal_force_that_is_off(
    restless_skill, deviate, force, error, is_off
):
    deviate(force=error)
    scenario = Scenario()
    scenario.press.force = force
    values = CheckFeasibility(scenario, restless_skill).values
    assert values["unsteady_fraction"] == is_off
    assert values["force_error"] == pytest.approx(abs(error))


@pytest.mark.usefixtures("predicted")
@pytest.mark.parametrize(
    ("has_force", "error", "is_feasible"),
    [
        (False, 3.9, True),
        (False, -4.1, False),
        (True, -0.24, True),
        (True, 0.26, False),
    ],
)
def test_a_normal_force_that_is_off_in_all_samples_is_refused(
    restless_skill, deviate, has_force, error, is_feasible
):
    shown = demonstration(height=0.0, force=(12.0, 4.0))
    pulsing = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4).fit(shown)
    deviate(force=error)
    found = CheckFeasibility(Scenario(), pulsing if has_force else restless_skill)
    assert found.is_feasible == is_feasible
    if not is_feasible:
        assert f"the normal force is off by {abs(error):.1f} N rms" in found.verdict


@pytest.mark.parametrize(
    ("height", "error", "is_off"),
    [(0.0, 0.0011, 0), (0.0, 0.0013, 1), (0.0, -0.0013, 1), (0.02, 0.0013, 0)],
)
def test_the_felt_bears_the_errors_of_poses_that_are_pressed(
    predicted, restless_skill, height, error, is_off
):
    # It has 5 N/mm; 0.2 mm may be an error of the prediction.
    def change(motion, **_):
        motion.error[..., 5] = error

    predicted.change = change
    scenario = Scenario()
    scenario.board.error.translation = [0.0, 0.0, 0.001]  # Two boards.
    skill = transform_space(restless_skill, translation=[0.0, 0.0, height])
    values = CheckFeasibility(scenario, skill).values
    assert values["unsteady_fraction"] == pytest.approx(is_off, abs=0.06)


@pytest.mark.usefixtures("predicted")
@pytest.mark.parametrize("shape", ["none", "plane"])
@pytest.mark.parametrize(("tilt", "is_feasible"), [(0.24, True), (0.26, False)])
def test_a_tool_that_joints_turn_is_refused(
    stirring, deviate, shape, tilt, is_feasible
):
    deviate(tilt=np.deg2rad(tilt))
    scenario = Scenario()
    scenario.board.shape = shape
    found = CheckFeasibility(scenario, stirring)
    assert found.is_feasible == is_feasible
    if not is_feasible:
        assert "the tool is off its orientation by 0.3 degrees rms" in found.verdict


def test_a_skill_in_free_space_has_no_normal_force(predicted, restless_skill):
    scenario = Scenario()
    scenario.board.shape = "none"
    predicted.change = fast(1.0, 40)
    values = CheckFeasibility(scenario, restless_skill).values
    forces = {"unsteady_fraction", "force_error", "push_deviation"}
    assert not forces & set(values)


@pytest.mark.parametrize(
    ("wanted", "arm", "remedy"),
    [
        (6.0, 0.1, "press with at least"),
        (6.0, 10.0, "none of the tested"),
        (14.0, 0.1, ""),
    ],
)
def test_a_push_that_lifts_the_eraser_is_refused_and_a_normal_force_helps(
    predicted, restless_skill, wanted, arm, remedy
):
    def change(motion, **_):
        motion.J[..., 5, 5] = 0.5  # 4 kg along the normal.
        # Torque of joint 2, whose inertia is so large that it does not yield.
        motion.J[..., 5, 1], motion.M[..., 1, 1] = -arm, 1e9

    predicted.change = change
    scenario = Scenario()
    scenario.press.force = wanted
    push = Disturbance(duration=0.6, force=[9.0, 0, 36.0])
    nudge = Disturbance(start=5.0, duration=0.6, force=[9.0, 0, 12.0])
    grasp = Disturbance(kind="grasp", duration=0.6, force=[0, 0, 80.0])
    scenario.disturbances = [nudge, push, grasp]
    found = CheckFeasibility(scenario, restless_skill)
    lift = predict_lift([push], scenario.impedance, force=wanted, mass=4.0)
    assert found.values["push_deviation"] == pytest.approx(lift)
    assert found.is_feasible == (remedy == "")
    if remedy:
        force = int(
            re.search(
                r"board; a normal force of (\d+) N withstands it. What", found.verdict
            )[1]
        )
        assert wanted < force < 14
        bound = FollowingBounds().lift * scenario.tolerance
        lifts = [
            predict_lift([push], scenario.impedance, force=force - less, mass=4.0)
            for less in (0, 1)
        ]
        assert lifts[0] <= bound < lifts[1]
        assert (
            f"a push of 36 N lifts the eraser by {100 * lift:.0f} cm" in found.verdict
        )
        assert f"help: {remedy}" in found.verdict
        if "press" in remedy:
            assert f"{remedy} {force} N." in found.verdict


def test_the_felt_limits_the_normal_force_that_withstands_a_push(
    predicted, restless_skill
):
    def change(motion, **_):
        motion.J[..., 5, 5] = 0.5

    predicted.change = change
    scenario = Scenario()
    scenario.press.force = 3.0
    scenario.eraser.modulus = 1e3  # It bears 4.8 N.
    scenario.disturbances = [Disturbance(duration=0.6, force=[0, 0, 40.0])]
    found = CheckFeasibility(scenario, restless_skill)
    assert "What would help: none of the tested changes" in found.verdict


# Paths -------------------------------------------------------------------


def test_paths_see_the_board_all_along_its_rail(predicted, restless_skill):
    scenario = Scenario()
    motion = scenario.board.motion
    motion.amplitude, motion.frequency = 0.06, 0.2
    found = CheckFeasibility(scenario, restless_skill)
    (asked,) = predicted.asked
    rail = BoardReach(scenario, FollowingBounds()).rail
    assert np.linalg.norm(rail) == pytest.approx(0.06)
    moved = asked["moved"] @ rail / 0.06**2
    assert_allclose(asked["moved"], moved[..., None] * rail, atol=1e-12)
    # The start, for which the posture is found, is at one end of the rail.
    assert moved[0, 0] == pytest.approx(-1)
    assert len(np.unique(np.round(moved[:, 0], 9))) > len(found.paths) // 2
    assert np.max(np.abs(moved)) == pytest.approx(1, abs=0.01)
    # Places are spread evenly over a period, so that their mean is the middle.
    assert_allclose(np.mean(moved, axis=0), 0, atol=1e-9)
    assert_allclose(np.mean(moved**2, axis=0), 0.5, atol=1e-9)
    # A sine of 0.2 Hz.
    cosine = np.cos(2 * np.pi * 0.2 * asked["step"])
    assert_allclose(moved[:, 2:] + moved[:, :-2], 2 * cosine * moved[:, 1:-1])


@pytest.mark.usefixtures("predicted")
def test_first_paths_are_those_of_runs_from_the_start(bundled_skill):
    scenario = Scenario()
    scenario.skill.tempo = 2.0
    found = CheckFeasibility(scenario, bundled_skill)
    beginnings, rest = found.paths[:3], found.paths[3:]
    assert_allclose(beginnings[:, 0], np.tile(scenario.start, (3, 1)), atol=0.01)
    # Each with a seed of its own.
    apart = np.linalg.norm(beginnings[1:] - beginnings[:-1], axis=-1)
    assert np.all(np.max(apart, axis=1) > 0.01)

    def length(paths):
        steps = np.linalg.norm(np.diff(paths[..., :2], axis=1), axis=-1)
        return np.mean(np.sum(steps, axis=1))

    # In the time of a window they get as far as any other.
    assert 0.6 < length(beginnings) / length(rest) < 1.3


@pytest.mark.usefixtures("predicted")
def test_long_windows_are_fewer(bundled_demonstration):
    skill = FourierMovementPrimitive(n_steps=300, overlap=10, n_components=4)
    skill.fit([bundled_demonstration])
    found = CheckFeasibility(Scenario(), skill)
    assert len(found.paths) == 3 + 6000 // 300
