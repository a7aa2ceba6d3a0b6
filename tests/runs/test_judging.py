"""Facts about the faults of a run: what is judged, at which limits, and in which words."""

import math
from dataclasses import replace

import pytest
from pydrake.common.yaml import yaml_dump_typed
from trials_stub import GOOD

from fmp_drake.runs.judging import (
    LEAST_CONTACT,
    MOST_EXCESS,
    RunResult,
    faults,
    largest_push,
    misses_by_height,
    on_board_rms,
    pushes,
    undisturbed_force_fraction,
)
from fmp_drake.station import ParseScenario
from fmp_drake.systems.surface_monitor import TOLERANCE

PRESSED = "press: {force: 9.0}"


def result(scenario=PRESSED, **metrics):
    """A run in which all is well, but for the given metrics."""
    text = yaml_dump_typed(ParseScenario(scenario))
    return RunResult(scenario=text, metrics=GOOD | metrics)


def kinds(judged, *time):
    return [fault.kind for fault in faults(judged, *time)]


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"penetration_max_m": 0.02}, "through", "20.0 mm below the surface"),
        ({"contact_fraction": float("nan")}, "nan", "NaN in contact_fraction"),
        ({"torque_ratio_max": 1.2}, "limit", "torque reaches 1.2 of its limit"),
        ({"torque_rate_max_nm_per_s": 1500.0}, "limit", "reaches 1500 Nm/s"),
        ({"joint_speed_ratio_max": 1.1}, "limit", "speed reaches 1.1 of its limit"),
        ({"joint_limit_margin_min_rad": -0.1}, "limit", "0.100 rad beyond its limit"),
        ({"tracking_rms_m": 0.034}, "path", "34.0 mm rms, 10 mm at most"),
        (
            {"normal_force_wanted_fraction": 0.5},
            "press",
            "for 50.0 % of the time in contact (90 % from 8.0 to 11.0 N)",
        ),
        (
            {"contact_fraction": 0.0, "normal_force_wanted_fraction": 0.0},
            "press",
            "never touches the board",
        ),
        (
            {"normal_force_error_rms_n": 0.65},
            "press",
            "0.65 N rms off the force of the skill, above 0.5",
        ),
        (
            {"orientation_rms_deg": 0.55},
            "tilt",
            "0.55 degrees rms off its orientation, above 0.5",
        ),
        ({"arm_on_board_s": 0.06}, "touch", "touches the board for 0.06 s"),
        ({"desired_contact_fraction": 0.9}, "press", "for 90.0 % of the desired time"),
        ({"normal_force_max_n": 78.1}, "force", "up to 78 N, above 78 N"),
        ({"protective_stop_s": 0.2}, "stop", "in a protective stop for 0.20 s"),
    ],
)
def test_every_kind_of_fault_is_described(changes, kind, words):
    (fault,) = faults(result(**changes))
    assert fault.kind == kind
    assert words in fault.text
    assert faults(result()) == []


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("penetration_max_m", TOLERANCE),
        ("torque_ratio_max", 1.0),
        ("joint_speed_ratio_max", 1.0),
        ("torque_rate_max_nm_per_s", 900.0),
        ("tracking_rms_m", 0.010),
        ("normal_force_wanted_fraction", -0.95),
        ("normal_force_error_rms_n", 0.5),
        ("orientation_rms_deg", 0.5),
        ("desired_contact_fraction", -LEAST_CONTACT),
        ("joint_limit_margin_min_rad", -1e-9),
        ("normal_force_max_n", 2 * 9.0 + MOST_EXCESS),
        ("protective_stop_s", 1e-9),
        ("arm_on_board_s", 1e-9),
    ],
)
def test_every_fault_begins_at_its_limit(name, limit):
    sign = -1 if limit < 0 else 1
    good, bad = (abs(limit) * (1 + sign * change) for change in (-0.001, 0.001))
    if abs(limit) == 1e-9:
        good, bad = 0.0, sign * 0.01
    assert faults(result(**{name: good})) == []
    (fault,) = faults(result(**{name: bad}))
    assert fault.severity > 1


def test_most_severe_fault_is_the_first():
    found = faults(result(torque_ratio_max=1.1, penetration_max_m=0.5))
    assert [fault.kind for fault in found] == ["through", "limit"]
    assert found[0].severity > 10
    assert found[1].severity == pytest.approx(1.1)


def test_run_that_broke_off_has_no_other_fault():
    broken = replace(result(torque_ratio_max=2.0), error="StationError: no posture")
    (fault,) = faults(broken)
    assert (fault.kind, fault.text) == (
        "exception",
        "stopped with StationError: no posture",
    )


def test_orientation_has_a_larger_limit_with_joint_friction():
    rough = f"{{{PRESSED}, friction: {{enabled: true}}}}"
    for error, found in ((0.59, []), (0.61, ["tilt"])):
        assert kinds(result(rough, orientation_rms_deg=error)) == found


def test_disturbed_runs_are_judged_by_their_force_outside_the_disturbances():
    pushed = f"{{{PRESSED}, disturbances: [{{force: [0.0, 20.0, 0.0]}}]}}"
    metrics = {
        "normal_force_wanted_fraction": 0.5,
        "desired_contact_fraction": 0.5,
        "normal_force_error_rms_n": 3.0,
        "orientation_rms_deg": 2.0,
    }
    assert kinds(result(pushed, **metrics)) == []
    # Twice the desired 9 N, the push of 20 N, and 60 N.
    for force, found in ((97.9, []), (98.1, ["force"])):
        assert kinds(result(pushed, **metrics, normal_force_max_n=force)) == found
    name = "normal_force_undisturbed_fraction"
    for fraction, found in ((None, []), (0.96, []), (0.9, ["press"])):
        judged = result(pushed, **metrics | {name: fraction})
        assert kinds(judged) == found
    assert (
        "90.0 % of the time in contact without disturbances" in faults(judged)[0].text
    )
    lost = {name: None, "normal_force_wanted_fraction": None, "contact_fraction": 0.0}
    (fault,) = faults(result(pushed, **metrics | lost))
    assert (fault.kind, fault.text) == ("press", "never touches the board")


def test_push_after_the_end_of_a_run_does_not_count():
    text = "disturbances: [{start: 2.0, force: [0.0, 20.0, 0.0]}]"
    pushed = result(text, desired_contact_fraction=0.5)
    assert [len(pushes(pushed, time)) for time in (1.9, 2.1)] == [0, 1]
    assert [largest_push(pushed, time) for time in (1.9, 2.1)] == [0.0, 20.0]
    assert kinds(pushed, 1.9) == ["press"]
    assert faults(pushed, 2.1) == []
    assert not pushes(result())


def test_largest_of_several_pushes_counts():
    text = """
    disturbances:
    - {force: [3.0, 4.0, 0.0]}
    - {kind: grasp, force: [50.0, 0.0, 0.0], max_force: 12.0}
    - {force: [0.0, 0.0, -8.0]}
    """
    assert largest_push(result(text)) == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("force", "found"), [(0.0, []), (0.5, ["press"]), (9.0, ["press"])]
)
@pytest.mark.parametrize(
    "name", ["normal_force_wanted_fraction", "desired_contact_fraction"]
)
def test_contact_is_judged_where_a_normal_force_is_desired(force, found, name):
    assert kinds(result(f"press: {{force: {force}}}", **{name: 0.5})) == found


def test_path_is_missed_only_by_height_if_the_distance_on_the_board_is_small():
    for whole, on_board, misses in (
        (0.011, 0.009, True),
        (0.009, 0.008, False),
        (0.012, 0.011, False),
    ):
        judged = result(tracking_rms_m=whole, tracking_on_board_rms_m=on_board)
        assert misses_by_height(judged) == misses
    assert not misses_by_height(replace(result(), metrics=None))


def test_metrics_of_older_versions_stand_in_for_newer_ones():
    older = result(tracking_rms_m=0.007)
    assert on_board_rms(older) == 0.007
    assert on_board_rms(result(tracking_on_board_rms_m=0.005)) == 0.005
    assert undisturbed_force_fraction(older) == 0.99
    newer = result(normal_force_undisturbed_fraction=0.97)
    assert undisturbed_force_fraction(newer) == 0.97
    assert undisturbed_force_fraction(result(contact_fraction=0)) == 0.0
    unknown = result(normal_force_wanted_fraction=None)
    assert math.isnan(undisturbed_force_fraction(unknown))
    assert faults(unknown) == []
    no_run = replace(older, metrics=None)
    assert on_board_rms(no_run) == 0.0
    assert math.isnan(undisturbed_force_fraction(no_run))


def test_results_of_an_older_version_have_its_tolerance():
    assert RunResult(scenario="press: {force: 8.0}").tolerance == 0.01
    assert result("tolerance: 0.004").tolerance == 0.004


def test_free_space_has_no_fault_of_contact():
    free = "board: {shape: none}"
    assert faults(result(free, contact_fraction=0.0)) == []
    assert kinds(result(free, normal_force_max_n=61.0)) == ["force"]
