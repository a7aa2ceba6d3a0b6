"""Facts about the station where a simulated hand guides the arm."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.geometry import Meshcat
from station_run import MILLISECOND, StationRun, check_limits

from fmp_drake.errors import StationError
from fmp_drake.primitives.data.windows import DEFAULT_RATE
from fmp_drake.station.external_forces import (
    DemonstrationFromRecorder,
    MouseOnPage,
    SimulatedHand,
)
from fmp_drake.station.scenario import LoadScenario, Scenario
from fmp_drake.station.station import MakeStation
from fmp_drake.systems.teaching.hand_motion import HandMotion

pytestmark = pytest.mark.slow

TASKS = ("wiping", "polishing", "eight")
SETTLE = 1.0
SECONDS = 4.0
SYSTEMS = {
    "plant",
    "scene_graph",
    "controller",
    "driver",
    "human_hand",
    "is_guided",
    "recorder",
    "rest",
}


def teach(task, *, seed=0, seconds=SECONDS):
    motion = HandMotion.make(task, duration=SECONDS + 1, seed=seed)
    run = StationRun(MakeStation(LoadScenario("table_top"), SimulatedHand(motion)))
    run.motion = motion
    return run.advance(seconds)


def recorded(run, skip=SETTLE):
    context = run.simulator.get_context()
    return DemonstrationFromRecorder(run.station, context, skip=skip, note="a test")


@pytest.fixture(scope="module")
def lessons():
    return {task: teach(task) for task in TASKS}


@pytest.fixture(params=TASKS)
def lesson(request, lessons):
    return lessons[request.param]


def test_exported_ports_have_names_and_sizes(lesson):
    station = lesson.station
    ports = [station.get_output_port(i) for i in range(station.num_output_ports())]
    assert {p.get_name(): p.size() for p in ports} == {
        "position": 3,
        "is_guided": 1,
        "state": 14,
        "torque": 7,
        "actuation": 7,
    }
    assert station.num_input_ports() == 0


def test_every_system_has_a_name(lesson):
    assert lesson.station.get_name() == "teaching_station"
    assert {system.get_name() for system in lesson.station.GetSystems()} == SYSTEMS


def test_documentation_names_every_port_and_system():
    words = re.findall(r"\w+", MakeStation.__doc__)
    ports = {"position", "is_guided", "state", "torque", "actuation"}
    assert ports | SYSTEMS <= set(words)


def test_recording_is_uniform_at_20_hertz(lesson):
    demonstration = recorded(lesson)
    assert DEFAULT_RATE == 20
    assert demonstration.is_uniform(20)
    assert demonstration.time[0] == 0
    assert demonstration.duration == pytest.approx(SECONDS - SETTLE)
    assert len(demonstration.time) == 20 * (SECONDS - SETTLE) + 1


def test_recording_describes_itself(lesson):
    demonstration = recorded(lesson)
    assert demonstration.channels == ("x", "y", "z")
    assert demonstration.units == ("m", "m", "m")
    assert demonstration.frame == "board"
    assert demonstration.note == "a test"


def test_recording_equals_the_output_port(lesson):
    expected = lesson.log("position")[int(1000 * SETTLE) :: 50]
    # The recorder's and the plant's event of one instant come in either order.
    assert_allclose(recorded(lesson).values, expected, atol=2e-3)
    assert np.median(np.abs(recorded(lesson).values - expected)) == 0
    assert len(recorded(lesson, skip=0.0).time) == 20 * SECONDS + 1


def test_eraser_stays_on_the_board(lesson):
    x, y, z = recorded(lesson).values.T
    reach = (np.array([0.50, 0.70]) - [0.12, 0.05]) / 2
    assert np.max(np.abs(x)) < reach[0]
    assert np.max(np.abs(y)) < reach[1]
    # Pressed into the felt; where the hand turns fast, the eraser tips on an edge.
    assert -0.01 < np.min(z)
    assert np.max(z) < 0.006
    assert np.mean(z < 0) > 0.7


def test_arm_follows_the_hand(lesson):
    demonstration = recorded(lesson)
    desired_path = np.array(
        [lesson.motion.at(t + SETTLE)[0] for t in demonstration.time]
    )
    distance = np.linalg.norm(demonstration.values[:, :2] - desired_path, axis=1)
    # A hand is soft: it lags and cuts corners, by a few centimetres.
    assert np.sqrt(np.mean(distance**2)) < 0.03
    assert np.max(distance) < 0.06
    assert np.ptp(demonstration.values, axis=0)[:2].min() > 0.08


def test_arm_keeps_its_limits(lesson):
    check_limits(lesson)
    assert lesson.log("position").shape[0] == SECONDS / MILLISECOND + 1


def test_one_seed_gives_one_recording(lessons):
    again = recorded(teach("eight", seconds=2.0)).values
    assert len(again) >= 20
    assert_array_equal(again, recorded(lessons["eight"]).values[: len(again)])


def test_other_seed_gives_another_recording(lessons):
    other = recorded(teach("eight", seed=1, seconds=2.0)).values
    difference = other - recorded(lessons["eight"]).values[: len(other)]
    assert np.max(np.linalg.norm(difference, axis=1)) > 0.02


def test_restarted_simulator_records_the_same(lessons):
    run = teach("eight", seconds=0.5)
    assert_array_equal(
        run.restart().advance(1.0).log("position"),
        lessons["eight"].log("position")[:1001],
    )


def test_recording_begins_above_the_beginning_of_the_motion(lesson):
    first, _ = lesson.motion.at(0.0)
    assert_allclose(lesson.log("position")[0], [*first, 0.005], atol=5e-6)


def test_board_out_of_reach_is_refused():
    scenario = Scenario()
    scenario.board.translation = [1.5, 0.0, 0.1]
    motion = HandMotion.make("eight", duration=1, seed=0)
    with pytest.raises(StationError, match="cannot bring the eraser to"):
        MakeStation(scenario, SimulatedHand(motion))


def test_a_board_that_moves_is_not_taught_on_by_the_simulated_hand():
    scenario = LoadScenario("moving_board")
    hand = SimulatedHand(HandMotion.make("eight", duration=5, seed=0))
    with pytest.raises(StationError, match=r"amplitude is 0\.06 m; .* Set it to 0"):
        MakeStation(scenario, hand)


def test_a_curved_board_that_moves_is_not_taught_on():
    scenario = LoadScenario("polish_pipe")
    scenario.board.motion.amplitude = 0.02
    with pytest.raises(StationError, match=r"amplitude is 0\.02 m; .* Set it to 0"):
        MakeStation(scenario, MouseOnPage(Meshcat()))
