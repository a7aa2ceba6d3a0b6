"""Facts about people who push and grasp the arm while it wipes."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput
from station_run import SELDOM, StationRun, check_limits

from fmp_drake.primitives.model.phase.period import fundamental_period
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.station.station import MakeWipingStation
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.scripted_disturbances import Disturbance

pytestmark = pytest.mark.slow

FIRST, APART, DURATION = 1.5, 2.8, 0.7
LOGGED = ("measured_position", "desired_position", "disturbance", "status")
PUSHES = {
    "away from the base": [36.0, 0.0, 0.0],
    "to the base": [-36.0, 0.0, 0.0],
    "to the left": [0.0, 36.0, 0.0],
    "to the right": [0.0, -36.0, 0.0],
    "off the board": [0.0, 0.0, 36.0],
}


@pytest.fixture(scope="module")
def period(bundled_demonstration):
    """Period of a stroke, s."""
    strokes = bundled_demonstration.select(["y"])
    return fundamental_period([strokes.values]) / 20


@pytest.fixture(scope="module")
def pushed(bundled_skill):
    """A run in which 36 N push for 0.7 s in five directions, one after the other."""
    scenario = LoadScenario("table_top")
    scenario.skill.sample = False
    scenario.disturbances = [
        Disturbance(start=FIRST + APART * i, duration=DURATION, force=force)
        for i, force in enumerate(PUSHES.values())
    ]
    run = StationRun(MakeWipingStation(scenario, bundled_skill), *LOGGED)
    return run.advance(FIRST + APART * len(PUSHES))


@pytest.fixture(scope="module")
def outside(pushed):
    """When, of every 50 ms, the arm is more than 1 cm beside the desired motion.

    In the plane of the board: along its normal the force is controlled.
    """
    away = pushed.log("measured_position") - pushed.log("desired_position")
    return np.linalg.norm(away[::50, :2], axis=1) > 0.01


@pytest.mark.parametrize("number", range(len(PUSHES)), ids=list(PUSHES))
def test_arm_is_back_on_its_path_within_a_period(pushed, outside, period, number):
    assert 1.4 < period < 2.0
    begin = FIRST + APART * number
    force = pushed.log("disturbance")
    direction = list(PUSHES.values())[number]
    assert np.array_equal(force[round(1e3 * (begin + 0.5))], direction)
    released = begin + DURATION
    assert not force[round(1e3 * released) + 1].any()
    back = slice(round((released + period) / SELDOM), round((begin + APART) / SELDOM))
    assert not outside[back].any()


def test_pushes_move_the_arm_off_its_path(outside):
    # Otherwise nothing would have to come back.
    during = [
        outside[round((FIRST + APART * i) / SELDOM) :][:20].any()
        for i in range(len(PUSHES))
    ]
    assert sum(during) >= 3


def test_pushes_break_no_limit(pushed):
    check_limits(pushed)
    flags = pushed.log("status")[:, 0].astype(int)
    broken = (
        StatusFlag.PROTECTIVE_STOP | StatusFlag.JOINT_WALL | StatusFlag.TORQUE_LIMITED
    )
    assert not np.any(flags & int(broken))


def test_a_wrist_that_80_N_overload_swings_back_within_its_limits(bundled_skill):
    scenario = LoadScenario("table_top")
    push = Disturbance(start=1.5, duration=1.0, force=[80 / np.sqrt(3)] * 3)
    scenario.disturbances = [push]
    run = StationRun(MakeWipingStation(scenario, bundled_skill), "status").advance(2.8)
    flags = run.log("status")[:, 0].astype(int)
    assert np.any(flags & int(StatusFlag.TORQUE_LIMITED))
    check_limits(run)


# A person who leads the arm to a point and keeps it there -----------------------

START, RELEASE = 1.2, 4.7

GRASP = Disturbance(
    kind="grasp",
    start=START,
    duration=RELEASE - START,
    position=[0.05, 0.12, 0.0],
    stiffness=1000.0,
    max_force=80.0,
)


def ms(seconds):
    return round(1000 * seconds)


@pytest.fixture(scope="module")
def grasped(bundled_skill):
    """Runs of the periodic and of the reactive mode."""
    runs = {}
    for name, threshold in (("periodic", None), ("reactive", 0.015)):
        scenario = LoadScenario("table_top")
        scenario.skill.push_threshold = threshold
        scenario.disturbances = [GRASP]
        station = MakeWipingStation(scenario, bundled_skill)
        run = StationRun(station, *LOGGED, "remaps")
        runs[name] = run.advance(RELEASE + 1.5)
    return runs


def pull(run):
    """Return the force of the person during the grasp, N."""
    return np.linalg.norm(run.log("disturbance"), axis=1)[ms(START) : ms(RELEASE)]


def error(run):
    return np.linalg.norm(
        run.log("measured_position") - run.log("desired_position"), axis=1
    )


def test_reactive_mode_maps_again_only_while_the_arm_is_held(grasped):
    assert grasped["periodic"].log("remaps")[-1, 1] == 0
    reactive = grasped["reactive"].log("remaps")[:, 1]
    assert reactive[ms(START)] == 0
    assert reactive[ms(RELEASE)] > 5
    assert reactive[-1] <= reactive[ms(RELEASE)] + 1


def test_reactive_mode_pulls_less_at_the_person(grasped):
    periodic, reactive = pull(grasped["periodic"]), pull(grasped["reactive"])
    assert reactive.mean() < 0.85 * periodic.mean()
    # Once the arm is where the person wants it, it hardly pulls.
    assert reactive[3000:].mean() < 0.5 * periodic[3000:].mean()


def test_reactive_mode_returns_sooner(grasped):
    released = {name: error(run)[ms(RELEASE) :] for name, run in grasped.items()}
    for away in released.values():
        assert away[-500:].max() < 0.01
    back = {
        name: int(np.flatnonzero(away > 0.01)[-1]) if away.max() > 0.01 else 0
        for name, away in released.items()
    }
    assert back["reactive"] < 0.7 * back["periodic"]
    assert released["reactive"].max() < 0.5 * released["periodic"].max()


def test_reactive_mode_makes_no_jump(grasped):
    for run in grasped.values():
        desired = run.log("desired_position")
        step = np.linalg.norm(np.diff(desired, axis=0), axis=1)
        assert step.max() < 1.5e-3  # 1.5 m/s
        bend = np.linalg.norm(np.diff(desired, n=2, axis=0), axis=1)
        assert bend.max() < 5e-5  # No step of more than 0.05 m/s.
        check_limits(run)


def test_movement_continues_after_the_grasp(grasped):
    for run in grasped.values():
        after = run.log("measured_position")[ms(RELEASE + 0.5) :]
        assert np.ptp(after[:, 1]) > 0.15


# Drawing conclusions from one station is fair: the same disturbance in another
# simulator gives the same forces.
def test_disturbances_repeat(bundled_skill):
    scenario = LoadScenario("table_top")
    scenario.disturbances = [Disturbance(start=0.1, duration=0.2, force=[0, 0, -5.0])]
    logs = []
    for _ in range(2):
        builder = DiagramBuilder()
        station = builder.AddSystem(MakeWipingStation(scenario, bundled_skill))
        log = LogVectorOutput(station.GetOutputPort("state"), builder, 0.01)
        diagram = builder.Build()
        simulator = Simulator(diagram)
        simulator.AdvanceTo(0.4)
        logs.append(log.FindLog(simulator.get_context()).data().copy())
    assert np.array_equal(*logs)
