"""Facts about randomised scenarios that once failed, for some seconds each."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from fmp_drake.experiments.trials import TrialSpec
from fmp_drake.experiments.trials.running import as_stored, make_run
from fmp_drake.runs.judging import faults
from fmp_drake.runs.station_run import MakeRun
from fmp_drake.skills.learning import scenario_skill
from fmp_drake.station import CheckFeasibility, LoadScenario

pytestmark = pytest.mark.slow

WORST = yaml.safe_load(Path(__file__).with_name("worst_worlds.yaml").read_text())
NEVER = {"through", "nan", "limit"}
# Worlds that several tests run, each for longer than the one before.
SHARED = (86, 106, 283, 445)


@pytest.fixture(scope="module")
def spec():
    return TrialSpec.load("default")


@pytest.fixture(scope="module")
def run_of(spec):
    """The function that makes the run of a world; later tests continue a shared one."""
    runs = {}

    def get(number):
        run = runs.get(number)
        if run is None:
            run = make_run(spec.draw(seed=WORST["seed"], number=number).scenario)
        if number in SHARED:
            runs[number] = run
        return run

    return get


@pytest.mark.parametrize("number", WORST["numbers"])
def test_no_limit_is_broken_in_one_of_the_worst_worlds(spec, run_of, number):
    # Also those that are refused in advance.
    drawn, run = spec.draw(seed=WORST["seed"], number=number), run_of(number)
    run.advance_to(WORST["seconds"])
    trial = replace(drawn, metrics=as_stored(run.metrics()))
    assert [fault.text for fault in faults(trial) if fault.kind in NEVER] == []


def test_the_last_joint_of_an_iiwa_stays_below_its_speed_limit_at_its_range():
    # 69 times the limit where the model had no motors' inertia.
    drawn = TrialSpec.load("surfaces").draw(seed=4040, number=54)
    assert drawn.fields["robot"] == "iiwa14"
    run = make_run(drawn.scenario)
    run.advance_to(5.0)
    assert 0.5 < run.metrics()["joint_speed_ratio_max"] < 1.0


def test_a_start_at_a_limit_does_not_drive_a_joint_above_its_speed_limit():
    # 104 % of it where the spring at the limit pushed on.
    scenario = LoadScenario("vertical", robot="iiwa14")
    scenario.board.translation = [0.41, -0.12, 0.89]
    scenario.board.rpy = [0.235, -1.714, -0.034]
    scenario.start = [-0.04, 0.07, 0.16]
    skill, demonstrations, _ = scenario_skill(scenario)
    q = [-2.015, 1.16, 2.937, -1.958, -1.215, 0.842, 0.616]
    run = MakeRun(scenario, skill, demonstrations=demonstrations, q=q)
    run.advance_to(0.3)
    found = run.metrics()
    assert found["joint_limit_margin_min_rad"] < 0.031
    assert 0.5 < found["joint_speed_ratio_max"] < 1.0
    assert found["protective_stop_s"] == 0.0


def metrics(run, seconds):
    run.advance_to(seconds)
    return run.metrics()


@pytest.mark.usefixtures("no_remedy")
@pytest.mark.parametrize(
    ("number", "why"),
    [(283, "panda_link4 touches the board")],
)
def test_failures_are_predicted_by_the_check(run_of, number, why):
    run = run_of(number)
    feasibility = CheckFeasibility(run.scenario, run.skill)
    assert not feasibility.is_feasible
    assert why in feasibility.verdict


def test_a_joint_that_contact_accelerates_stays_below_its_speed_limit(run_of):
    # 104 % of it at 4.85 s where the brake counted on all of the limit.
    run = run_of(445)
    feasibility = CheckFeasibility(run.scenario, run.skill)
    assert feasibility.is_feasible
    assert feasibility.values["largest_speed_ratio"] > 0.85
    run.advance_to(5.2)
    assert 0.9 < run.metrics()["joint_speed_ratio_max"] < 1.0


def test_an_elbow_that_hits_the_board_is_reported(run_of):
    run = run_of(283)
    run.advance_to(3.2)
    assert run.metrics()["arm_on_board_s"] > 0.02
    assert any("the arm touches the board" in event.text for event in run.events())


def test_without_force_control_a_quick_movement_is_pressed_evenly(run_of):
    assert metrics(run_of(86), 8.0)["normal_force_wanted_fraction"] > 0.95


def test_where_the_elbow_is_nearly_straight_the_eraser_stays_on_the_board(run_of):
    assert metrics(run_of(106), 7.0)["contact_fraction"] > 0.95
