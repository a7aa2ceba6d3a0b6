"""Facts about a board that is not where it is said to be, and an arm that is pushed.

The force that the board feels is read where no controller looks.
"""

import numpy as np
import pytest

from fmp_drake.apps.run_report import report_rows
from fmp_drake.runs import WipingRun
from fmp_drake.station import LoadScenario
from fmp_drake.systems import StatusFlag
from fmp_drake.systems.scripted_disturbances import Disturbance

WANTED = 10.0


def wiped(skill, seconds, *, name="table_top", height=0.0, force=WANTED, push=None):
    """Return times and values of force and status; the eraser starts on the board."""
    scenario = LoadScenario(name)
    scenario.board.error.translation = [0.0, 0.0, height]
    scenario.press.force = force
    scenario.skill.candidates = 1
    if push:
        scenario.disturbances = [Disturbance(start=1.0, duration=1.0, force=push)]
    keep = ("normal_force", "status", "measured_position")
    run = WipingRun(scenario, skill, start=(0, 0, 0.01 + max(height, 0)), keep=keep)
    run.advance_to(seconds)
    return run, run.log("normal_force")[:, 0], run.log("status")


@pytest.mark.parametrize("height", [-0.009, 0.009])
def test_a_board_that_is_lower_or_higher_is_pressed_as_desired(wiping_skill, height):
    run, force, status = wiped(wiping_skill, 2.5, height=height)
    assert not run.scenario.impedance.force_control.enabled
    last_forces = force[-100:]  # The last second.
    assert last_forces.mean() == pytest.approx(WANTED, abs=1.5)
    assert last_forces.min() > WANTED - 5
    assert force.max() < WANTED + 5
    assert not np.any(status[:, 0].astype(int) & StatusFlag.PROTECTIVE_STOP)
    assert "contact lost" not in {event.kind for event in run.events()}
    found = run.metrics()["board_height_error_m"]
    assert found == pytest.approx(height, abs=0.001)
    # It is a result, and nothing that went wrong.
    times = {"simulated_seconds": 2.5, "wall_seconds": 1.0, "real_time_factor": 2.5}
    events = [event._asdict() for event in run.events()]
    rows = report_rows({**times, **run.metrics(), "events": events})
    side = "lower" if height < 0 else "higher"
    assert f"{1e3 * abs(found):.0f} mm {side} than assumed" in rows["surface"]
    assert "than assumed" not in rows["what went wrong"]


def test_a_felt_that_is_compressed_by_half_is_not_a_lower_board(wiping_skill):
    """Its pressure decreases towards the edges, so it is compressed more than in proportion."""
    run, force, _ = wiped(wiping_skill, 2.5, force=40.0)
    assert force[-100:].mean() == pytest.approx(40.0, abs=3.0)
    assert abs(run.metrics()["board_height_error_m"]) < 0.002


def test_missing_board_is_reported_by_a_protective_stop(wiping_skill):
    run, force, status = wiped(wiping_skill, 3.5, height=-0.15)
    assert force.max() == 0
    flags = status[:, 0].astype(int)
    stops = np.flatnonzero(flags & StatusFlag.NOT_FOUND)
    assert len(stops) >= 1
    assert flags[stops[0]] & StatusFlag.PROTECTIVE_STOP
    assert np.all(flags[1200 : stops[0]] & StatusFlag.CONTACT_LOST)
    settings = run.scenario.impedance.force_control
    z = run.log("measured_position")[:, 2]
    # As far as is searched below the path, and as the force takes to fade.
    assert -0.015 > z.min() > -settings.search_range - 0.015
    # It comes up again before it is led back to the path.
    led = np.flatnonzero(flags & StatusFlag.RECOVER)
    assert np.all(status[led[:1], 4] == 0)
    texts = {event.kind: event.text for event in run.events()}
    assert "no board was found" in texts["protective stop"]


@pytest.mark.parametrize(
    ("name", "push", "soon"), [("table_top", 20.0, 1.0), ("vertical", 80.0, 2.0)]
)
def test_the_search_recovers_after_a_person_has_lifted_the_eraser(
    wiping_skill, name, push, soon
):
    run, force, status = wiped(
        wiping_skill, 2.2 + soon, name=name, push=[0.0, 0.0, push]
    )
    flags = status[:, 0].astype(int)
    assert np.all(flags[1500:2000] & StatusFlag.CONTACT_LOST)
    assert force[150:200].max() == 0
    back = force[200 + round(100 * soon) :]
    assert back.min() > WANTED - 5
    # 15 N after 20 N, 22 N after 80 N from 0.5 m above the board.
    assert force[200:].max() < WANTED + 0.3 * push
    lost = next(event for event in run.events() if event.kind == "contact lost")
    assert 1.0 < lost.start < 1.4
    assert 2.0 < lost.end < 2.0 + soon


def test_eraser_pushed_off_the_board_returns_to_it(wiping_skill):
    """The push is more than the arm can hold; before, it hooked behind the frame."""
    push = [-80.0, 0.0, 0.0]
    run, force, _ = wiped(wiping_skill, 4.5, name="vertical", push=push)
    x, _, z = run.log("measured_position").T
    assert x.min() < -0.3  # The board ends at -0.25 m.
    assert z.min() > -0.01
    assert force[-50:] == pytest.approx(WANTED, abs=5)  # From 2 s after it.
    assert "a hard part below the board" not in {e.kind for e in run.events()}
    # It was stopped while it was pushed faster than its joints may move.
    stops = [e.text for e in run.events() if e.kind == "protective stop"]
    assert all("a joint was faster than its limit" in text for text in stops)


def test_the_torque_does_not_jump_where_the_board_is_found(wiping_skill):
    _, force, status = wiped(wiping_skill, 1.5, height=-0.009)
    first_contact = np.argmax(force > 1)
    assert first_contact > 10
    assert np.all(
        status[10 * first_contact - 100 :, 3] == 1
    )  # Never at the rate limit.
