"""Facts about stations that run away: each stops, says so, and is judged for it."""

from dataclasses import replace

import numpy as np
import pytest

from fmp_drake.experiments.trials import TrialSpec
from fmp_drake.experiments.trials.running import as_stored
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.runs import WipingRun
from fmp_drake.runs.judging import faults
from fmp_drake.station import LoadScenario
from fmp_drake.systems import StatusFlag
from fmp_drake.systems.impedance.controller_status import STOP_REASONS
from fmp_drake.systems.page.page_status import mode_in_words
from fmp_drake.systems.scripted_disturbances import Disturbance

# Disturbances of an arm that measures the normal force: a push along the board, one into
# it, and one into it 17 times a second.
CASES = {
    StatusFlag.SPEED_EXCEEDED: (
        Disturbance(start=1.0, duration=0.15, force=[0.0, 200.0, 0.0]),
        "a joint was faster than its limit",
    ),
    StatusFlag.EXCESS_FORCE: (
        Disturbance(start=1.0, duration=0.2, force=[0.0, 0.0, -150.0]),
        "the normal force was far above the desired one",
    ),
    StatusFlag.FORCE_OSCILLATION: (
        Disturbance(start=1.0, duration=0.03, every=0.06, force=[0.0, 0.0, -90.0]),
        "the normal force oscillated",
    ),
}


@pytest.mark.parametrize("flag", CASES)
def test_an_arm_that_runs_away_is_stopped_shown_reported_and_judged(wiping_skill, flag):
    disturbance, reason = CASES[flag]
    scenario = LoadScenario("table_top")
    scenario.skill.candidates = 1
    scenario.impedance.force_control.enabled = True
    scenario.disturbances = [disturbance]
    run = WipingRun(scenario, wiping_skill, start=(0, 0, 0.01), keep=("status",))
    run.advance_to(1.5)
    status = run.log("status")
    flags = status[:, 0].astype(int)
    assert not np.any(flags[:1000] & StatusFlag.PROTECTIVE_STOP)
    first = np.flatnonzero(flags & flag)[0]
    assert flags[first] & StatusFlag.PROTECTIVE_STOP
    assert np.all(status[first : first + 150, 1] == 0)

    # The fault is short; the stop and the return after it are longer.
    faults_seen = flags & int(sum(STOP_REASONS))
    last_fault = int(run.output("last_fault")[0])
    assert faults_seen[-1] == 0
    assert last_fault == faults_seen[faults_seen > 0][-1]
    level, mode, detail = mode_in_words(flags[first], flag, 20.0, desired=10.0)
    assert (level, mode, detail) == ("bad", "protective stop", reason)
    stops = [e.text for e in run.events() if e.kind == "protective stop"]
    assert any(reason in text for text in stops)
    drawn = TrialSpec.load("default").draw(seed=0, number=0)
    trial = replace(drawn, metrics=as_stored(run.metrics()))
    assert "stop" in {fault.kind for fault in faults(trial)}


@pytest.mark.parametrize(
    ("disturbance", "largest"),
    [
        (Disturbance(start=1.0, duration=0.2, force=[0.0, 0.0, -120.0]), 200.0),
        # Without the retreat it is 124 N.
        (CASES[StatusFlag.FORCE_OSCILLATION][0], 110.0),
    ],
)
def test_a_stopped_tool_is_not_thrown_against_the_board(
    wiping_demonstration, disturbance, largest
):
    skill = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4)
    skill.fit(wiping_demonstration)
    scenario = LoadScenario("table_top")
    scenario.skill.candidates = 1
    scenario.impedance.force_control.enabled = True
    scenario.disturbances = [disturbance]
    run = WipingRun(scenario, skill, start=(0, 0, 0.01))
    run.advance_to(1.0)
    forces, is_stopped = [], False
    for k in range(500):
        run.advance_to(1.001 + 1e-3 * k)
        flags = int(run.output("status")[0])
        is_stopped |= bool(flags & StatusFlag.PROTECTIVE_STOP)
        forces.append(run.output("normal_force")[0])
    assert is_stopped
    assert max(forces) < largest
