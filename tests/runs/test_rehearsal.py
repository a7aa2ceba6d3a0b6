"""Facts about rehearsals: what the check cannot tell, a simulated run decides."""

from dataclasses import replace

import pytest

from fmp_drake.runs import rehearsal
from fmp_drake.runs.judging import Fault
from fmp_drake.runs.rehearsal import CheckWithRehearsal, rehearse
from fmp_drake.skills import scenario_skill
from fmp_drake.station import CheckFeasibility, LoadScenario
from fmp_drake.systems.scripted_disturbances import Disturbance


def table(*, tempo=1.0, x=0.5, force=10.0, torque_rate=None, push=0.0):
    scenario = LoadScenario("table_top")
    scenario.press.force = force
    scenario.impedance.max_torque_rate = torque_rate
    if push:
        off = Disturbance(start=2.0, duration=1.0, force=[0.0, 0.0, push])
        scenario.disturbances = [off]
    scenario.skill.tempo = tempo
    scenario.board.translation[0] = x
    return scenario


@pytest.fixture(scope="module")
def skill():
    return scenario_skill(LoadScenario("table_top"))[0]


@pytest.fixture
def rehearsed(monkeypatch):
    """The scenarios that are rehearsed, with the given faults, without simulating them."""
    scenarios, found = [], []

    def stub(scenario, _):
        scenarios.append(scenario)
        return found

    monkeypatch.setattr(rehearsal, "rehearse", stub)
    return scenarios, found


@pytest.mark.parametrize(
    ("scenario", "is_doubtful"),
    [
        (table(), False),  # Feasible.
        (table(tempo=2.0), True),  # Joints are braked on a third of the path.
        (table(x=0.35), True),  # Some of it is out of reach.
        (table(force=33.0), True),  # Friction holds the eraser back.
        (table(x=1.2), False),  # The start is out of reach.
        (table(torque_rate=80.0), False),  # The arm would oscillate.
        (table(tempo=2.0, push=60.0), False),  # It is also pushed off the board.
    ],
)
def test_only_predictions_of_the_motion_are_doubtful(scenario, skill, is_doubtful):
    feasibility = CheckFeasibility(scenario, skill, suggest=False)
    assert feasibility.is_doubtful == is_doubtful


@pytest.mark.parametrize(
    "scenario",
    [table(), table(x=1.2), table(x=0.8)],  # The last is doubtful, but too far off.
)
def test_certain_verdicts_are_not_rehearsed(scenario, skill, rehearsed):
    scenarios, _ = rehearsed
    feasibility = CheckWithRehearsal(scenario, skill)
    assert feasibility.verdict == CheckFeasibility(scenario, skill).verdict
    assert scenarios == []


@pytest.mark.parametrize(
    ("tempo", "frequency", "is_rehearsed"),
    [
        (1.0, 0.1, True),
        (0.0, 0.1, False),  # The arm would stay at the start.
        (0.25, 0.1, False),  # One window and a quarter.
        (1.0, 0.02, False),  # The board would not come back.
    ],
)
def test_prediction_decides_where_a_rehearsal_is_too_short(
    skill, rehearsed, tempo, frequency, is_rehearsed
):
    scenario = table(tempo=tempo, x=0.71)
    scenario.board.motion.axis = [1.0, 0.0, 0.0]
    scenario.board.motion.amplitude = 0.05
    scenario.board.motion.frequency = frequency
    predicted = CheckFeasibility(scenario, skill, suggest=False)
    assert predicted.is_doubtful
    feasibility = CheckWithRehearsal(scenario, skill, suggest=False)
    assert feasibility.is_feasible == is_rehearsed
    assert len(rehearsed[0]) == is_rehearsed


def test_rehearsal_that_goes_well_decides(skill, rehearsed):
    said = []
    feasibility = CheckWithRehearsal(table(tempo=2.0), skill, say=said.append)
    assert feasibility.is_feasible
    assert feasibility.suggestion == {}
    assert "of 30 s stays within all bounds" in feasibility.verdict
    assert feasibility.verdict.endswith(" % of the path.")
    assert len(said) == len(rehearsed[0]) == 1


@pytest.mark.parametrize("suggest", [False, True])
def test_rehearsal_that_fails_gives_its_reason(skill, rehearsed, suggest):
    rehearsed[1].append(Fault("path", 1.2, "follows its path to 12 mm rms"))
    scenario = table(tempo=2.0)
    feasibility = CheckWithRehearsal(scenario, skill, suggest=suggest)
    assert not feasibility.is_feasible
    reason = "A rehearsal agrees: follows its path to 12 mm rms."
    assert reason in feasibility.verdict
    assert ("What would help: slow down" in feasibility.verdict) == suggest
    assert bool(feasibility.suggestion) == suggest


@pytest.mark.parametrize("goes_well", [True, False])
@pytest.mark.parametrize(
    "disturbed",
    [
        {"unsteady_fraction": 5e-4},  # Braked joints disturb the force for a moment.
        {"force_error": 0.6},  # N; a nearly singular arm.
        {"tracking_error": 9.2e-3},  # m; friction on the board.
        {"push_deviation": 7.1e-2},  # m; the bound is 7.7 cm.
    ],
)
def test_errors_close_to_their_bounds_are_rehearsed_though_the_check_passes(
    skill, rehearsed, monkeypatch, disturbed, goes_well
):
    feasibility = CheckFeasibility(table(), skill)
    assert all(
        feasibility.values[name] < value / 2 for name, value in disturbed.items()
    )
    close = replace(feasibility, values=feasibility.values | disturbed)
    monkeypatch.setattr(rehearsal, "CheckFeasibility", lambda *_, **__: close)
    if not goes_well:
        rehearsed[1].append(Fault("press", 1.1, "presses too little"))
    feasibility = CheckWithRehearsal(table(), skill)
    assert len(rehearsed[0]) == 1
    assert feasibility.is_feasible == goes_well
    text = "A rehearsal of 30 s agrees." if goes_well else "shows: presses too little."
    assert text in feasibility.verdict
    assert "The arm can follow" in feasibility.verdict or not goes_well


@pytest.mark.parametrize(
    ("force", "start", "is_rehearsed"),
    [
        ([30.0, -30.0, 0.0], 2.0, True),  # N; 42 N along the board.
        ([-25.0, 25.0, -40.0], 2.0, False),  # 35 N.
        ([45.0, 0.0, 0.0], 31.0, False),  # Later than a rehearsal.
    ],
)
def test_strong_push_along_the_board_is_rehearsed(
    skill, rehearsed, force, start, is_rehearsed
):
    scenario = table()
    scenario.disturbances = [Disturbance(start=start, force=force)]
    assert CheckWithRehearsal(scenario, skill).is_feasible
    assert len(rehearsed[0]) == is_rehearsed


def test_rehearsal_simulates_other_samples(skill, monkeypatch):
    monkeypatch.setattr(rehearsal, "_ENDS", (2.0, 3.0))
    made, make = [], rehearsal.MakeRun

    def make_run(*args, **options):
        made.append(make(*args, **options))
        return made[-1]

    monkeypatch.setattr(rehearsal, "MakeRun", make_run)
    assert rehearse(table(), skill) == []
    (run,) = made
    assert run.seed == run.scenario.skill.seed + 1
    assert run.simulator.get_context().get_time() == pytest.approx(3.0)
    (fault, *_) = rehearse(table(tempo=4.0), skill)
    assert fault.kind == "path"
    assert made[1].simulator.get_context().get_time() == pytest.approx(2.0)


def test_run_that_breaks_off_is_a_fault(skill):
    (fault,) = rehearse(table(x=1.2), skill)
    assert fault.kind == "exception"
    assert "StationError" in fault.text


@pytest.mark.parametrize(("severity", "is_mended"), [(1.4, True), (1.6, False)])
def test_rehearsal_ends_early_only_where_the_rest_cannot_mend_it(
    skill, monkeypatch, severity, is_mended
):
    # All of the fault is in the first 0.2 s of 0.3 s: two thirds of it remain.
    early = Fault("path", severity, "follows its path badly")
    monkeypatch.setattr(rehearsal, "_ENDS", (0.2, 0.3))
    monkeypatch.setattr(
        rehearsal, "faults", lambda _, time: [early] if time < 0.3 else []
    )
    assert rehearse(table(), skill) == ([] if is_mended else [early])
