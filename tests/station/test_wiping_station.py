"""Facts about the whiteboard station: what a user would measure on the robot.

Ten seconds of wiping and six from outside are simulated once, and looked at from
many sides.
"""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.analysis import Simulator
from scipy.ndimage import gaussian_filter1d
from station_run import StationRun, check_limits

from fmp_drake.errors import StationError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    LqrTracker,
    modulate_skill,
)
from fmp_drake.station.robots.robot import AddRobot, LoadRobot
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.station.skill_motion import SkillMargin
from fmp_drake.station.station import MakeStation, MakeWipingStation
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.ink.grid import cleaned_fraction

pytestmark = pytest.mark.slow

PORTS = {
    "desired_position": 3,
    "desired_velocity": 3,
    "desired_acceleration": 3,
    "covariance": 9,
    "weights": 360,
    "component": 1,
    "phase": 1,
    "remaps": 2,
    "measured_position": 3,
    "measured_velocity": 3,
    "measured_pose": 7,
    "tracking_error": 6,
    "status": 6,
    "last_fault": 1,
    "torque": 7,
    "actuation": 7,
    "state": 14,
    "ink": 14000,
    "cleaned_fraction": 1,
    "normal_force": 1,
    "desired_normal_force": 1,
    "contact_area": 1,
    "penetration": 1,
}
SYSTEMS = {
    "plant",
    "scene_graph",
    "fourier_primitive",
    "desired_motion",
    "tempo",
    "desired_normal_force",
    "controller",
    "driver",
    "ink_board",
    "surface_monitor",
    "status",
}
FOOTPRINT = (0.12, 0.05)
# The tempo comes up at first, which takes 0.15 s of the first window.
REMAP_TIMES = (5.05, 9.95)
REMAPS, SECONDS = len(REMAP_TIMES), 10.5
ARRIVED = 4.0
FOLLOWED = (
    "desired_position",
    "desired_velocity",
    "measured_position",
    "tracking_error",
)
INK = ("ink", "cleaned_fraction")


def make_station(skill, **options):
    return MakeWipingStation(LoadScenario("table_top"), skill, **options)


def remaps(run):
    primitive = run.station.GetSubsystemByName("fourier_primitive")
    return primitive.playback_state(run.context_of("fourier_primitive")).remaps


@pytest.fixture(scope="module")
def wiped(bundled_skill):
    """Simulate what `fmp-drake wipe` does; count the re-mappings."""
    station = make_station(bundled_skill, sample=True, seed=0)
    run = StationRun(station, *FOLLOWED, *INK, "normal_force", "status")
    run.remaps = []
    for time in REMAP_TIMES:
        for before_or_after in (-0.0005, 0.0005):
            run.advance(time + before_or_after)
            run.remaps.append(remaps(run))
    return run.advance(SECONDS)


@pytest.fixture(scope="module")
def outside(bundled_demonstration):
    """Return a start 15 cm beside what was demonstrated, 3 cm above the board."""
    return np.array([0.0, bundled_demonstration.values[:, 1].max() + 0.15, 0.03])


@pytest.fixture(scope="module")
def from_outside(bundled_skill, outside):
    """Simulate six seconds from outside, and keep the context just before three."""
    station = make_station(bundled_skill, start=outside)
    run = StationRun(station, *FOLLOWED, "measured_velocity", "normal_force")
    run.advance(2.9995)
    run.before_three = run.simulator.get_context().Clone()
    return run.advance(6.0)


@pytest.fixture(params=["wiped", "from_outside"])
def run(request):
    return request.getfixturevalue(request.param)


# What is there.


def test_exported_ports_have_names_and_sizes(wiped):
    station = wiped.station
    outputs = [station.get_output_port(i) for i in range(station.num_output_ports())]
    assert {port.get_name(): port.size() for port in outputs} == PORTS
    inputs = [station.get_input_port(i) for i in range(station.num_input_ports())]
    assert [port.get_name() for port in inputs] == ["applied_spatial_force"]


def test_every_system_has_a_name(wiped):
    assert wiped.station.get_name() == "wiping_station"
    names = [system.get_name() for system in wiped.station.GetSystems()]
    assert set(names) == SYSTEMS
    assert len(names) == len(SYSTEMS)


def test_documentation_names_every_port_and_system():
    words = re.findall(r"\w+", MakeStation.__doc__)
    assert set(PORTS) | SYSTEMS <= set(words)


def test_only_outputs_of_the_contact_follow_a_push_at_once(wiped):
    station = wiped.station
    outputs = range(station.num_output_ports())
    assert {
        station.get_output_port(i).get_name()
        for i in outputs
        if station.HasDirectFeedthrough(i)
    } == {"normal_force", "contact_area"}


# What the robot does.


def test_eraser_starts_exactly_at_the_start(wiped, from_outside, outside):
    starts = ((wiped, [0.0, 0.0, 0.05]), (from_outside, outside))
    for run, start in starts:
        assert_allclose(run.log("measured_position")[0], start, atol=5e-6)
        assert_allclose(run.log("desired_position")[0], start, atol=5e-6)
        assert_array_equal(run.log("state")[0, 7:], 0.0)
        assert_allclose(run.log("desired_velocity")[0], 0.0, atol=1e-9)


def test_desired_motion_converges_to_the_demonstrations(run, bundled_demonstration):
    low = bundled_demonstration.values.min(axis=0)
    high = bundled_demonstration.values.max(axis=0)
    desired = run.log("desired_position")[int(1000 * ARRIVED) :]
    beyond = np.maximum(low - desired, desired - high).max(axis=1)
    assert np.mean(beyond > 0.01) < 0.1
    assert np.max(beyond) < 0.08
    assert np.ptp(desired, axis=0)[:2].min() > 0.15


def test_desired_motion_from_outside_does_not_stay_there(from_outside, outside):
    distance = np.linalg.norm(from_outside.log("desired_position") - outside, axis=1)
    assert np.max(distance[:1000]) > 0.05
    # Sample after sample, no jump: at most 2 m/s.
    steps = np.diff(from_outside.log("desired_position"), axis=0)
    assert np.max(np.linalg.norm(steps, axis=1)) < 2e-3


def test_arm_follows_the_desired_motion(run):
    error = run.log("measured_position") - run.log("desired_position")
    distance = np.linalg.norm(error, axis=1)
    assert np.max(distance) < 0.02
    settled = distance[int(1000 * ARRIVED) :]
    assert np.sqrt(np.mean(settled**2)) < 0.005
    assert np.max(settled) < 0.01
    assert np.max(np.linalg.norm(run.log("tracking_error")[:, :3], axis=1)) < 0.2


def test_eraser_is_pressed_by_5_to_15_newtons(run):
    force = run.log("normal_force")[:, 0]
    since_contact = force[np.argmax(force > 0.5) :]
    assert len(since_contact) > 0.8 * len(force)
    inside = (since_contact > 5) & (since_contact < 15)
    assert np.mean(inside) > 0.9
    assert np.median(since_contact) == pytest.approx(10, abs=1)


def test_arm_keeps_its_limits(run):
    check_limits(run)


def test_actuation_is_torque_plus_gravity(from_outside):
    gravity = from_outside.log("actuation") - from_outside.log("torque")
    arm = MultibodyPlant(time_step=0.0)
    AddRobot(arm, LoadRobot("panda"))
    arm.Finalize()
    context = arm.CreateDefaultContext()
    for k in (0, 3000, 6000):
        arm.SetPositions(context, from_outside.log("state")[k, :7])
        assert_allclose(
            gravity[k], -arm.CalcGravityGeneralizedForces(context), atol=1e-9
        )


def test_outputs_agree_with_each_other(from_outside):
    error = from_outside.log("tracking_error")[:, 3:]
    difference = from_outside.log("desired_position") - from_outside.log(
        "measured_position"
    )
    assert_allclose(error, difference, atol=1e-12)
    velocity = from_outside.log("measured_velocity")
    slope = np.gradient(from_outside.log("measured_position"), 0.001, axis=0)
    assert_allclose(velocity[1:-1], slope[1:-1], atol=0.02)
    desired_velocity = from_outside.log("desired_velocity")
    slope = np.gradient(from_outside.log("desired_position"), 0.001, axis=0)
    assert_allclose(desired_velocity[1:-1], slope[1:-1], atol=0.02)


# What becomes of the ink.


def test_most_of_the_demonstrated_area_is_erased(wiped, bundled_demonstration):
    grid = wiped.station.GetSubsystemByName("ink_board").grid
    ink = wiped.log("ink")[-1].reshape(grid.shape)
    area = grid.swept_area(bundled_demonstration.values, FOOTPRINT)
    assert cleaned_fraction(ink, area) > 0.8
    assert wiped.log("cleaned_fraction")[-1, 0] == cleaned_fraction(ink)


def test_ink_only_goes_and_only_where_the_eraser_has_been(wiped):
    grid = wiped.station.GetSubsystemByName("ink_board").grid
    ink = wiped.log("ink")
    assert np.all(np.diff(ink, axis=0) <= 0)
    been = grid.swept_area(
        wiped.log("measured_position")[::10], np.array(FOOTPRINT) + 0.03
    )
    assert_array_equal(ink[-1][~been.ravel()], 1.0)
    assert np.all(np.diff(wiped.log("cleaned_fraction"), axis=0) >= 0)


# Re-mapping.


def test_remapping_happens_every_window_less_its_overlap(wiped):
    before_and_after = np.repeat(np.arange(REMAPS + 1), 2)[1:-1]
    assert wiped.remaps == before_and_after.tolist()
    assert remaps(wiped) == REMAPS


def test_remapping_does_not_make_the_motion_jump(wiped):
    position = wiped.log("desired_position")
    velocity = wiped.log("desired_velocity")
    for time in REMAP_TIMES:
        i = round(1000 * time)
        around = slice(i - 2, i + 3)
        explained = 0.001 * (velocity[around][1:] + velocity[around][:-1]) / 2
        jump = np.diff(position[around], axis=0) - explained
        assert np.max(np.linalg.norm(jump, axis=1)) < 1e-4
        assert np.max(np.abs(np.diff(velocity[around], axis=0))) < 0.05


# The same again.


def seeded(skill, seed):
    station = make_station(skill, sample=True, seed=seed)
    return StationRun(station, *FOLLOWED, "weights", "normal_force", "cleaned_fraction")


@pytest.fixture(scope="module")
def alone(restless_skill):
    """Simulate a second, with a re-mapping, for two seeds."""
    return [seeded(restless_skill, seed).advance(1.0) for seed in (3, 4)]


def assert_same_logs(one, two):
    for name in one.names:
        assert_array_equal(one.log(name), two.log(name), err_msg=name)


def test_other_seed_gives_other_motion(alone):
    one, two = (run.log("measured_position") for run in alone)
    assert_array_equal(one[0], two[0])
    assert np.max(np.linalg.norm(one - two, axis=1)) > 0.005


def test_restarted_simulator_repeats_the_run(alone, restless_skill):
    run = seeded(restless_skill, 3).advance(0.3)
    assert_same_logs(alone[0], run.restart().advance(1.0))


def test_one_seed_gives_one_run_beside_other_processes(alone, restless_skill):
    assert remaps(alone[0]) == 1
    pair = [seeded(restless_skill, seed) for seed in (3, 4)]
    for time in (0.1, 0.35, 0.5, 0.8, 1.0):
        for run in pair:
            run.advance(time)
    for run, expected in zip(pair, alone, strict=True):
        assert_same_logs(run, expected)


def test_one_station_serves_two_simulators(alone, restless_skill):
    run = seeded(restless_skill, 3)
    other = Simulator(run.diagram)
    plant = run.station.GetSubsystemByName("plant")
    context = plant.GetMyMutableContextFromRoot(other.get_mutable_context())
    q = plant.GetPositions(context)
    q[0] += 0.1
    plant.SetPositions(context, q)
    for time in (0.25, 0.5, 0.75, 1.0):
        run.advance(time)
        other.AdvanceTo(time)
    assert_same_logs(alone[0], run)


# Disturbances.


def push(run, force_B):
    """Fix what pushes on the eraser's tip, in the frame of the board, N."""
    plant = run.station.GetSubsystemByName("plant")
    context = run.station.GetMyMutableContextFromRoot(
        run.simulator.get_mutable_context()
    )
    forces = []
    if force_B is not None:
        tip = plant.GetFrameByName("eraser_tip")
        force = ExternallyAppliedSpatialForce()
        force.body_index = tip.body().index()
        force.p_BoBq_B = tip.GetFixedPoseInBodyFrame().translation()
        force.F_Bq_W = SpatialForce(np.zeros(3), np.asarray(force_B, dtype=float))
        forces.append(force)
    run.station.GetInputPort("applied_spatial_force").FixValue(
        context, Value[list[ExternallyAppliedSpatialForce]](forces)
    )


@pytest.mark.parametrize("force", [(20.0, 0.0, 0.0), (0.0, -20.0, 0.0)])
def test_push_moves_the_arm_and_it_returns(from_outside, force):
    run = from_outside.from_context(from_outside.before_three.Clone())
    push(run, force)
    run.advance(3.5)
    push(run, None)
    run.advance(4.3)
    moved = (
        run.log("measured_position")[:4301]
        - from_outside.log("measured_position")[:4301]
    )
    assert_array_equal(moved[:3000], 0.0)
    along = moved @ np.array(force) / 20
    # A spring of 1500 N/m gives way by 13 mm, less what friction holds.
    assert 0.006 < np.max(along[3000:3500]) < 0.016
    assert np.max(np.linalg.norm(moved[4000:], axis=1)) < 0.001
    # The skill is not a spring to a point in time: what is desired is as before.
    assert_allclose(
        run.log("desired_position"), from_outside.log("desired_position")[:4301]
    )
    check_limits(run)


# Options and errors.


def test_tracker_and_start_are_passed_on(restless_skill):
    station = make_station(
        restless_skill, tracker=LqrTracker(), start=[0.05, -0.1, 0.02]
    )
    run = StationRun(station, "measured_position").advance(0.01)
    assert_allclose(run.log("measured_position")[0], [0.05, -0.1, 0.02], atol=5e-6)


def test_margin_of_the_scenario_bounds_the_samples(restless_skill):
    scenario = LoadScenario("table_top")
    scenario.skill.margin = 0.03
    without_paths = modulate_skill(restless_skill, harmonics=[1], gain=1.0)
    regions = [
        MakeWipingStation(scenario, skill)
        .GetSubsystemByName("fourier_primitive")
        .player.region
        for skill in (restless_skill, without_paths)
    ]
    assert regions[0].margin == 0.03
    assert regions[1] is None


def test_margin_reaches_the_mean_of_cycles_that_differ(bundled_skill):
    # Otherwise all samples would be reduced to the mean, which is no cycle of them.
    time = np.arange(240) / 20
    radius = np.where(time < 6, 0.12, 0.2) - 0.01 * np.cos(np.pi * time / 3)
    circles = radius * np.array([np.cos(np.pi * time), np.sin(np.pi * time), 0 * time])
    recording = Demonstration(time=time, values=gaussian_filter1d(circles.T, 4, axis=0))
    skill = FourierMovementPrimitive().fit(recording)
    assert skill.model_ == "phase"
    margins = [
        MakeWipingStation(LoadScenario("table_top"), each)
        .GetSubsystemByName("fourier_primitive")
        .player.region.margin
        for each in (bundled_skill, skill)
    ]
    assert margins[0] == 0.02
    assert 0.022 < margins[1] < 0.05


def test_margin_is_small_where_the_mean_is_far_from_all_movements(restless_skill):
    assert SkillMargin(LoadScenario("table_top"), restless_skill) == 0.02


def test_scenario_moves_the_board(restless_skill):
    scenario = LoadScenario("table_top")
    scenario.board.translation = [0.5, 0.1, 0.25]
    scenario.board.rpy = [0.05, -0.1, 0.3]
    station = MakeWipingStation(scenario, restless_skill)
    run = StationRun(station, *FOLLOWED, "normal_force").advance(2.0)
    assert_allclose(run.log("measured_position")[0], scenario.start, atol=5e-6)
    force = run.log("normal_force")[-50:, 0]
    assert 5 < np.mean(force) < 15
    error = run.log("measured_position") - run.log("desired_position")
    assert np.max(np.linalg.norm(error, axis=1)) < 0.02


def test_start_out_of_reach_is_refused(restless_skill):
    with pytest.raises(StationError, match="cannot bring the eraser to"):
        make_station(restless_skill, start=[0.5, 0.0, 0.05])


def test_skill_without_a_height_is_refused(bundled_demonstration):
    flat = bundled_demonstration.select(["x", "y"])
    skill = FourierMovementPrimitive(n_components=2).fit([flat])
    with pytest.raises(StationError, match="a robot needs z as well"):
        make_station(skill)


def test_skill_that_is_not_fitted_is_refused():
    with pytest.raises(ValueError, match="fit"):
        make_station(FourierMovementPrimitive())


@pytest.mark.parametrize("start", [(0.15, 0.0, 0.01), (-0.15, 0.3, 0.01)])
def test_start_close_above_the_board_is_as_good_as_any(bundled_skill, start):
    station = make_station(bundled_skill, start=start)
    run = StationRun(station, *FOLLOWED).advance(1.5)
    assert np.all(np.abs(run.log("measured_position")[:, :2]) < [0.25, 0.35])
    error = run.log("measured_position") - run.log("desired_position")
    assert np.max(np.linalg.norm(error, axis=1)) < 0.02
    check_limits(run)


def test_controller_has_no_protective_stop_while_it_wipes(wiped):
    flags = wiped.log("status")[:, 0].astype(int)
    bad = (
        StatusFlag.PROTECTIVE_STOP
        | StatusFlag.STALE
        | StatusFlag.JUMP
        | StatusFlag.NOT_FINITE
    )
    assert not np.any(flags & int(bad))
    # It does say something: the torque's rate is limited when the arm starts.
    assert np.any(flags)


def test_force_control_may_use_the_arms_external_torque(bundled_skill):
    scenario = LoadScenario("table_top")
    scenario.impedance.force_control.enabled = True
    scenario.press.by_torque = True
    station = MakeWipingStation(scenario, bundled_skill, start=[0.0, 0.0, 0.005])
    simulator = Simulator(station)
    simulator.AdvanceTo(1.0)
    context = simulator.get_context()
    estimator = station.GetSubsystemByName("normal_force_estimator")
    estimated_force = estimator.GetOutputPort("normal_force").Eval(
        estimator.GetMyContextFromRoot(context)
    )
    force = station.GetOutputPort("normal_force").Eval(context)
    assert force[0] == pytest.approx(scenario.press.force, abs=1.0)
    assert estimated_force[0] == pytest.approx(force[0], abs=1e-3)
    status = station.GetOutputPort("status").Eval(context)
    assert int(status[0]) & StatusFlag.FORCE_CONTROL
