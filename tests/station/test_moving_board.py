"""Facts about boards that move or are not where they are taken to be, and late sensors.

In a station the controller knows the assumed board (A), the ink the real one (B).
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder, EventStatus
from station_run import StationRun, check_limits

from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.station.scenario_parts import BoardMotion, PoseConfig, SensorConfig
from fmp_drake.station.station import MakeWipingStation
from fmp_drake.systems.impedance.controller_status import StatusFlag

pytestmark = pytest.mark.slow

FRAME = ("task_frame", "task_frame_velocity", "task_frame_acceleration")
LOGGED = (
    "measured_position",
    "desired_position",
    "normal_force",
    "status",
    "cleaned_fraction",
)
EVERY = 20  # ms
AMPLITUDE, FREQUENCY = 0.06, 0.2


class WatchedRun(StationRun):
    """Watches real poses and what the controller is told every 20 ms."""

    def __init__(self, scenario, skill):
        super().__init__(MakeWipingStation(scenario, skill), *LOGGED)
        self.plant = self.station.GetSubsystemByName("plant")
        self.times, self.X_WB, self.X_WE, self.told = [], [], [], []
        self.simulator.set_monitor(self._watch)

    def _watch(self, _):
        time = self.simulator.get_context().get_time()
        if time >= EVERY * 1e-3 * len(self.times) - 1e-9:
            context = self.context_of("plant")
            self.times.append(time)
            for poses, frame in ((self.X_WB, "surface"), (self.X_WE, "eraser_tip")):
                poses.append(self.plant.GetFrameByName(frame).CalcPoseInWorld(context))
            self.told.append(
                [
                    self.station.GetSubsystemByName(name)
                    .get_output_port()
                    .Eval(self.context_of(name))
                    for name in FRAME
                    if self.station.HasSubsystemNamed(name)
                ]
            )
        return EventStatus.DidNothing()

    def watched(self, name):
        """Return what was logged every millisecond, when the poses were watched."""
        return self.log(name)[np.rint(1e3 * np.array(self.times)).astype(int)]

    def p_WE(self):
        return np.array([X.translation() for X in self.X_WE])

    def p_BE(self):
        return np.array(
            [
                (X_WB.inverse() @ X_WE).translation()
                for X_WB, X_WE in zip(self.X_WB, self.X_WE, strict=True)
            ]
        )

    def rms_error(self, since=0.0):
        """Return how far the eraser was from where the skill wanted it on B, m."""
        error = (self.p_BE() - self.watched("desired_position"))[
            np.array(self.times) >= since
        ]
        return np.sqrt(np.mean(np.sum(error**2, axis=1)))


def assert_pressed(run):
    """Check that 5 to 15 N press in 95 % of the time since the first contact."""
    force = run.log("normal_force")[:, 0]
    first = np.argmax(force > 0.5)
    assert 0 < first < 200
    contact_force = force[first:]
    assert np.mean((contact_force > 5) & (contact_force < 15)) >= 0.95
    assert np.mean(contact_force > 0.5) > 0.99


def assert_told_where_the_board_is(run):
    """Check pose and velocity of the task frame against the poses of the plant."""
    pose, velocity, acceleration = (np.array(v) for v in zip(*run.told, strict=True))
    p_WB = np.array([X.translation() for X in run.X_WB])
    assert_allclose(pose[:, 4:], p_WB, atol=1e-9)
    for wxyz in pose[:, :4]:
        assert_allclose(np.abs(run.X_WB[0].rotation().ToQuaternion().wxyz() @ wxyz), 1)
    assert_array_equal(velocity[:, :3], 0.0)
    assert_array_equal(acceleration[:, :3], 0.0)
    # From one look to the next.
    seconds = np.diff(run.times)[:, None]
    speed = np.diff(p_WB, axis=0) / seconds
    between = (velocity[1:, 3:] + velocity[:-1, 3:]) / 2
    settled = np.array(run.times)[1:] > 0.2
    largest_error = np.max(np.abs(speed - between)[settled], axis=1)
    # Where the eraser lands, the speed changes more quickly than somebody looks.
    assert np.quantile(largest_error, 0.99) < 5e-4
    assert np.max(largest_error) < 5e-3
    # As planned, without what the eraser's friction does to the board.
    gained = np.cumsum(seconds * (acceleration[1:, 3:] + acceleration[:-1, 3:]), axis=0)
    largest_error = np.max(np.abs(velocity[1:, 3:] - gained / 2)[settled], axis=1)
    assert np.quantile(largest_error, 0.99) < 5e-3
    assert np.max(largest_error) < 1e-2


# A board on a rail ------------------------------------------------------------


@pytest.fixture(scope="module")
def moved(bundled_skill):
    """Five seconds on a board that slides by 6 cm to both sides along y."""
    scenario = LoadScenario("moving_board")
    scenario.board.motion = BoardMotion(
        axis=[0.0, 2.0, 0.0], amplitude=AMPLITUDE, frequency=FREQUENCY
    )
    return WatchedRun(scenario, bundled_skill).advance(5.0)


def wanted_shift(run):
    """Return where the board shall be along its rail, m: from rest at one end."""
    return -AMPLITUDE * np.cos(2 * np.pi * FREQUENCY * np.array(run.times))


def test_board_slides_as_desired(moved):
    shift = np.array([X.translation()[1] for X in moved.X_WB])
    assert_allclose(shift, wanted_shift(moved), atol=1e-3)
    rail = moved.plant.GetJointByName("rail")
    assert rail.get_default_translation() == -AMPLITUDE
    assert_allclose(rail.get_translation(moved.context_of("plant")), shift[-1])


def test_eraser_presses_on_the_sliding_board(moved):
    assert_pressed(moved)


def test_eraser_follows_on_the_sliding_board(moved):
    assert moved.rms_error() < 0.006
    # The controller measures in the frame of the board that moves, and a step ago.
    assert_allclose(moved.watched("measured_position"), moved.p_BE(), atol=1.5e-3)


def test_eraser_moves_in_the_world_with_the_board(moved):
    X_WM = LoadScenario("moving_board").board.pose()
    unmoved = np.array([X_WM @ p for p in moved.watched("desired_position")])
    shifted = (moved.p_WE() - unmoved)[:, 1]
    assert np.ptp(shifted) > 1.8 * AMPLITUDE
    assert np.sqrt(np.mean((shifted - wanted_shift(moved)) ** 2)) < 0.006


def test_sliding_board_is_wiped_within_the_limits(moved):
    check_limits(moved)
    assert moved.log("cleaned_fraction")[-1, 0] > 0.2
    flags = moved.log("status")[:, 0].astype(int)
    assert not np.any(flags & int(StatusFlag.PROTECTIVE_STOP | StatusFlag.STALE))


def test_controller_receives_the_motion_of_the_board(moved):
    assert_told_where_the_board_is(moved)
    for name in (*FRAME, "rail", "rail_state"):
        assert moved.station.HasSubsystemNamed(name)


def started(skill, t0):
    """Return half a second of a run on a moving board that begins at a time."""
    run = StationRun(MakeWipingStation(LoadScenario("moving_board"), skill), *LOGGED)
    run.simulator.get_mutable_context().SetTime(t0)
    return run.advance(t0 + 0.5)


def test_run_on_a_sliding_board_begins_at_any_time(restless_skill):
    expected, run = started(restless_skill, 0.0), started(restless_skill, 5.0)
    for name in ("measured_position", "desired_position"):
        difference = run.log(name)[:501] - expected.log(name)[:501]
        assert np.max(np.abs(difference)) < 1e-6
    flags = run.log("status")[:, 0].astype(int)
    assert not np.any(flags & int(StatusFlag.PROTECTIVE_STOP))


def test_run_on_a_sliding_board_continues_from_a_clone(restless_skill):
    run = started(restless_skill, 5.0)
    clone = run.simulator.get_context().Clone()
    run.advance(5.7)
    other = run.from_context(clone).advance(5.7)
    for name in ("state", "measured_position"):
        assert_array_equal(other.log(name)[-1], run.log(name)[-1])


@pytest.mark.parametrize("name", ["table_top", "wrong_height"])
def test_fixed_board_needs_no_task_frame(name, restless_skill):
    station = MakeWipingStation(LoadScenario(name), restless_skill)
    for part in (*FRAME, "rail", "rail_state"):
        assert not station.HasSubsystemNamed(part)
    assert not station.GetSubsystemByName("driver").HasSubsystemNamed("sensors")


def test_rail_may_lie_across_a_tilted_board(bundled_skill):
    scenario = LoadScenario("tilted")
    scenario.board.motion = BoardMotion(
        axis=[1.0, 1.0, 0.0], amplitude=0.03, frequency=0.6
    )
    run = WatchedRun(scenario, bundled_skill).advance(2.0)
    assert_told_where_the_board_is(run)
    moves = np.array([run.X_WB[0].inverse() @ X.translation() for X in run.X_WB])
    assert_allclose(moves[:, 0], moves[:, 1], atol=1e-9)
    assert_allclose(moves[:, 2], 0.0, atol=1e-9)
    assert np.ptp(moves[:, 0]) == pytest.approx(0.06 / np.sqrt(2), abs=1e-3)
    assert run.rms_error() < 0.006
    assert_pressed(run)


# A board that is not where it is taken to be ------------------------------------


def scene_of(scenario):
    return AddBoardScene(DiagramBuilder(), scenario, start=scenario.start)


def poses(scene):
    """Return X_WB and X_WE in the plant's default context."""
    context = scene.plant.CreateDefaultContext()
    return (f.CalcPoseInWorld(context) for f in (scene.surface, scene.robot.tip))


@pytest.mark.parametrize("amplitude", [0.0, 0.05])
def test_error_moves_the_real_board_and_not_the_assumed_one(amplitude):
    scenario = LoadScenario("tilted")
    assumed = scenario.board.pose()
    scenario.board.error = PoseConfig(translation=[0.01, -0.02, 0.03], rpy=[0, 0, 0.1])
    scenario.board.motion.amplitude = amplitude
    error = RigidTransform(RollPitchYaw(0, 0, 0.1), [0.01, -0.02, 0.03])
    begin = RigidTransform([0.0, -amplitude, 0.0])
    scene = scene_of(scenario)
    assert scene.X_WA.IsNearlyEqualTo(assumed @ begin, 1e-12)
    assert scene.X_WB.IsNearlyEqualTo(assumed @ error @ begin, 1e-12)
    X_WB, X_WE = poses(scene)
    assert X_WB.IsNearlyEqualTo(scene.X_WB, 1e-9)
    # The arm starts where the controller takes the start to be.
    start = scene.X_WA.inverse() @ X_WE
    assert_allclose(start.translation(), scenario.start, atol=5e-6)


def test_without_an_error_the_assumed_board_is_the_real_one():
    scene = scene_of(LoadScenario("moving_board"))
    assert scene.X_WA.IsExactlyEqualTo(scene.X_WB)


def test_force_is_kept_on_a_board_at_the_wrong_height(bundled_skill):
    scenario = LoadScenario("wrong_height")
    assert scenario.board.error.translation[2] >= 0.01
    run = WatchedRun(scenario, bundled_skill).advance(3.5)
    assert_pressed(run)
    check_limits(run)
    settled = run.log("normal_force")[300:, 0]
    assert np.mean(settled) == pytest.approx(10.0, abs=1.0)
    flags = run.log("status")[2000:, 0].astype(int)
    assert np.all(flags & int(StatusFlag.FORCE_CONTROL))
    # What is wiped is the real board, 1 cm above the assumed one.
    assert np.mean(run.watched("measured_position")[150:, 2]) > 0.007
    assert np.mean(run.p_BE()[150:, 2]) < 0.001


# Sensors ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sensed(bundled_skill):
    """Three seconds of wiping with joints that are measured late and with noise."""
    scenario = LoadScenario("table_top")
    scenario.sensors = SensorConfig(
        rate=1000.0, delay=0.002, position_noise=1e-5, velocity_noise=2e-3
    )
    return WatchedRun(scenario, bundled_skill).advance(3.0)


def test_arm_wipes_with_late_and_noisy_sensors(sensed):
    assert_pressed(sensed)
    check_limits(sensed)
    assert sensed.rms_error(since=1.0) < 0.006
    assert sensed.log("cleaned_fraction")[-1, 0] > 0.1


def test_controller_sees_the_measured_state(sensed):
    driver = sensed.station.GetSubsystemByName("driver")
    controller = sensed.station.GetSubsystemByName("controller")
    port = controller.GetInputPort("state")
    sensed_state, real = (
        port.Eval(sensed.context_of("controller")),
        sensed.log("state")[-1],
    )
    measured = driver.GetOutputPort("state").Eval(sensed.context_of("driver"))
    assert_array_equal(sensed_state, measured)
    # The last sample was taken a millisecond ago, and comes 2 ms late.
    late = sensed.log("state")[-1 - 3]
    assert_allclose(sensed_state[:7], late[:7], atol=6e-5)
    assert_allclose(sensed_state[7:], late[7:], atol=0.012)
    assert np.all(sensed_state != real)
    # The arm's own gravity compensation is not part of what is measured.
    compensation = driver.GetSubsystemByName("gravity_compensation")
    root = sensed.simulator.get_context()
    own = compensation.GetInputPort("estimated_state")
    assert_array_equal(own.Eval(compensation.GetMyContextFromRoot(root)), real)
