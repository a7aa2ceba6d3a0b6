"""Facts about the events of a run and their sentences."""

import numpy as np
import pytest

from fmp_drake.runs.events import Occurrences, RunEvents
from fmp_drake.runs.log import Samples
from fmp_drake.systems import StatusFlag
from fmp_drake.systems.impedance.joints import JointLimits

# Of three joints; the last one has no position limits.
LIMITS = JointLimits.between(
    np.array([-2.0, -1.0, -np.inf]),
    np.array([2.0, 3.0, np.inf]),
    speed=np.array([1.0, 2.0, 2.5]),
    lower_effort=np.full(3, -9.0),
    upper_effort=np.full(3, 9.0),
)


def recorded(seconds=8.0, *, touch=1.0, height=0.0):
    """Signals of a run in which nothing went wrong after the first contact."""
    fast, slow, path = (
        p * np.arange(round(seconds / p) + 1) for p in (0.001, 0.01, 0.005)
    )
    force = np.where(slow < touch, 0.0, 10.0)
    status = np.zeros((len(fast), 6))
    status[1:, 1:4] = 1.0  # At time 0 there was no update yet.
    status[:, 4] = height or 1e-4
    status[(fast > 0.5) & (fast < touch), 0] = StatusFlag.CONTACT_LOST
    desired = np.column_stack([np.sin(path), np.cos(path), 0 * path])
    return {
        "normal_force": Samples(slow, force[:, None]),
        "penetration": Samples(slow, np.zeros((len(slow), 1))),
        "status": Samples(fast, status),
        "desired_position": Samples(path, desired),
        "measured_position": Samples(path, desired + np.array([0, 0, height])),
    }


def mark(signals, start, end, flags):
    times, status = signals["status"]
    status[(times > start - 1e-6) & (times < end - 1e-6), 0] = float(flags)


def sentences(signals, *, until=(), most_force=80.0, limits=None):
    """Feed the signals in chunks that end at some times."""
    events, start = RunEvents(most_force, limits=limits), -1.0
    for end in (*until, 1e9):
        events.update(
            {
                name: Samples(*(each[(t > start) & (t <= end)] for each in (t, values)))
                for name, (t, values) in signals.items()
            }
        )
        start = end
    return [event.text for event in events.result()]


def test_run_without_faults_has_no_events():
    assert sentences(recorded()) == []


def test_lost_contact_is_reported_with_its_longest_time():
    signals = recorded()
    for start, end in ((2.0, 2.3), (4.0, 4.8), (6.0, 6.1)):
        mark(signals, start, end, StatusFlag.CONTACT_LOST)
    assert sentences(signals) == [
        "contact lost from 4.0 to 4.8 s (3 times in all, 1.2 s)"
    ]


@pytest.mark.parametrize("until", [(), (3.05, 3.3, 4.1)])
@pytest.mark.parametrize(("late", "expected"), [(0.4, []), (1.6, ["4.0 to 4.6"])])
def test_late_landing_after_a_lift_is_no_lost_contact(late, expected, until):
    signals = recorded()
    times, force = signals["normal_force"]
    force[(times >= 2.0) & (times < 3.0 + late)] = 0.0
    mark(signals, 3.0, 3.0 + late, StatusFlag.CONTACT_LOST)
    found = sentences(signals, until=until)
    assert found == [f"contact lost from {interval} s" for interval in expected]


@pytest.mark.parametrize("until", [(), (1.03,)])
@pytest.mark.parametrize(("late", "expected"), [(0.1, []), (1.4, ["2.0 to 2.4"])])
def test_contact_that_is_noticed_a_little_late_is_not_lost(late, expected, until):
    signals = recorded()
    times, status = signals["status"]
    status[times < 1.02, 0] = 0  # The eraser touches before the skill has come down.
    mark(signals, 1.02, 1.02 + late, StatusFlag.CONTACT_LOST)
    found = sentences(signals, until=until)
    assert found == [f"contact lost from {interval} s" for interval in expected]


@pytest.mark.parametrize("until", [(), (3.12, 3.4)])
def test_contact_that_is_lost_just_after_a_landing_is_reported(until):
    signals = recorded()
    times, force = signals["normal_force"]
    force[(times >= 2.0) & (times < 3.0)] = 0.0
    force[(times >= 3.1) & (times < 3.8)] = 0.0
    mark(signals, 3.16, 3.84, StatusFlag.CONTACT_LOST)
    found = sentences(signals, until=until)
    assert found == ["contact lost from 3.2 to 3.8 s"]


def test_contact_at_the_start_is_not_lost_before_it_is_reported():
    signals = recorded(touch=-1.0)
    mark(signals, 0.001, 0.02, StatusFlag.CONTACT_LOST)
    assert sentences(signals) == []


def test_protective_stop_is_reported_with_its_cause():
    signals = recorded()
    stop = StatusFlag.PROTECTIVE_STOP
    mark(signals, 7.2, 7.9, stop)
    mark(signals, 7.2, 7.201, stop | StatusFlag.JUMP)
    times, measured = signals["measured_position"]
    measured[times > 7.19, 0] += 0.23
    mark(signals, 3.0, 3.3, stop | StatusFlag.NOT_FOUND)
    assert sentences(signals) == [
        "protective stop from 3.0 to 3.3 s: no board was found within the search range",
        "protective stop from 7.2 to 7.9 s: the target was 23 cm away",
    ]


@pytest.mark.parametrize("height", [-0.008, 0.012])
def test_error_of_the_height_of_the_board_is_measured_without_a_fault(height):
    events = RunEvents()
    events.update(recorded(height=height))
    assert events.board_height_error == pytest.approx(height)
    assert events.result() == []


def test_height_of_a_board_that_was_never_touched_is_unknown():
    events = RunEvents()
    events.update(recorded(touch=99.0))
    assert events.board_height_error is None


@pytest.mark.parametrize("until", [(), (4.05, 4.15)])
def test_a_joint_too_fast_is_named_with_its_limit(until):
    signals = recorded()
    mark(signals, 4.0, 4.2, StatusFlag.OVERSPEED)
    times = signals["status"].times
    state = np.zeros((len(times), 6))
    state[:, 3] = 0.5  # Half of its limit.
    state[(times > 4.09) & (times < 4.11), 5] = -2.4
    state[times > 6, 4] = 9.0  # After the event.
    signals["state"] = Samples(times, state)
    (sentence,) = sentences(signals, until=until, limits=LIMITS)
    assert sentence == (
        "a joint near its speed limit from 4.0 to 4.2 s: joint 3, at up to 96 % of its limit of "
        "2.5 rad/s"
    )


@pytest.mark.parametrize("until", [(), (4.05, 4.15)])
@pytest.mark.parametrize(
    ("angle", "detail"),
    [
        (-0.94, "0.06 rad from"),
        (-1.02, "0.02 rad beyond"),
        (-1.0 - 1e-6, "less than 0.01 rad from"),
    ],
)
def test_a_joint_at_its_limit_is_named_with_its_distance(until, angle, detail):
    signals = recorded()
    mark(signals, 4.0, 4.2, StatusFlag.JOINT_WALL)
    times = signals["status"].times
    state = np.zeros((len(times), 6))
    state[:, 0] = 1.9
    state[:, 2] = -6.0
    state[(times > 4.09) & (times < 4.11), 1] = angle
    state[times > 6, 0] = 2.5  # After the event.
    signals["state"] = Samples(times, state)
    (sentence,) = sentences(signals, until=until, limits=LIMITS)
    assert sentence == (f"a joint at its limit from 4.0 to 4.2 s: joint 2, {detail} it")


def test_a_joint_that_was_too_fast_is_named_in_the_stop_because_of_it():
    signals = recorded()
    stop = StatusFlag.PROTECTIVE_STOP
    mark(signals, 3.0, 3.3, stop)
    mark(signals, 3.0, 3.01, stop | StatusFlag.SPEED_EXCEEDED)
    mark(signals, 5.0, 5.2, stop | StatusFlag.NOT_FOUND)
    times = signals["status"].times
    state = np.zeros((len(times), 6))
    state[(times > 2.995) & (times < 3.02), 4] = 2.1
    signals["state"] = Samples(times, state)
    fast, lost = sentences(signals, limits=LIMITS)
    assert fast == (
        "protective stop from 3.0 to 3.3 s: a joint was faster than its limit: joint 2, at up "
        "to 105 % of its limit of 2 rad/s"
    )
    assert lost.endswith("search range")


def test_arm_on_the_board_is_reported():
    signals = recorded()
    mark(signals, 5.0, 5.02, StatusFlag.ARM_TOUCHES)
    mark(signals, 6.0, 6.2, StatusFlag.ARM_TOUCHES)
    assert sentences(signals) == [
        "the arm touches the board from 6.0 to 6.2 s (2 times in all, 0.2 s)"
    ]


def test_fault_that_lasts_until_the_end_is_reported():
    signals = recorded()
    mark(signals, 5.0, 99.0, StatusFlag.JOINT_WALL)
    assert sentences(signals) == ["a joint at its limit from 5.0 to 8.0 s"]


def test_sentences_do_not_depend_on_the_chunks():
    signals = recorded(height=-0.004)
    rng = np.random.default_rng(3)
    flags = [0, StatusFlag.CONTACT_LOST, StatusFlag.JOINT_WALL, 1, 9, 17]
    status = signals["status"].values
    status[1000:, 0] = np.repeat(rng.choice(flags, 70), 101)[: len(status) - 1000]
    whole = sentences(signals)
    assert len(whole) == 4
    for ends in (np.arange(0.0, 8.0, 0.037), [0.2, 0.9995, 1.0, 5.5, 5.5], [7.9]):
        assert sentences(signals, until=tuple(ends)) == whole


def test_penetration_is_reported_with_its_depth():
    signals = recorded()
    times, depth = signals["penetration"]
    depth[(times > 2.0) & (times < 2.5)] = 0.0125
    assert sentences(signals) == [
        "a hard part below the board from 2.0 to 2.5 s: up to 12.5 mm deep"
    ]


def test_normal_force_far_too_large_is_reported_with_its_peak():
    signals = recorded()
    times, force = signals["normal_force"]
    force[(times > 2.0) & (times < 2.5)] = 79.0
    force[(times > 3.0) & (times < 3.045)] = 91.2
    assert sentences(signals) == ["a normal force far too large at 3.0 s: up to 91 N"]
    assert sentences(signals, most_force=np.inf) == []


def test_occurrences_of_any_signal_are_counted():
    deep = Occurrences("a hard part below the board", "up to {:.1f} mm deep")
    deep.update(np.arange(6.0), np.array([0, 0.5, 0, 0, 3.25, 1]))
    assert deep.events()[0].text == (
        "a hard part below the board from 1.0 to 2.0 s (2 times in all, 2.0 s): "
        "up to 3.2 mm deep"
    )
