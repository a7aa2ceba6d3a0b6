"""Facts about the metrics that are computed while a run goes."""

import itertools
import math

import numpy as np
import pytest

from fmp_drake.primitives.data.channels import ChannelRoles
from fmp_drake.runs.log import Samples
from fmp_drake.runs.metrics import (
    METRIC_SIGNALS,
    ForceMetrics,
    LimitMetrics,
    OrientationMetrics,
    RegionMetrics,
    RunMetrics,
    TrackingMetrics,
    ink_metrics,
    metric_signals,
)
from fmp_drake.station import Scenario
from fmp_drake.systems.impedance.controller_status import StatusFlag as Flag
from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.scripted_disturbances import Disturbance

LOWER, UPPER, TORQUE = -3 * np.ones(7), 2.5 * np.ones(7), np.full(7, 80.0)
LIMITS = JointLimits.between(
    LOWER,
    UPPER,
    speed=np.full(7, 2.0),
    lower_effort=-TORQUE,
    upper_effort=TORQUE,
)
PERIODS = {
    "normal_force": (1, 0.01),
    "desired_normal_force": (1, 0.01),
    "desired_position": (3, 0.005),
    "desired_velocity": (3, 0.005),
    "measured_position": (3, 0.005),
    "state": (14, 0.001),
    "actuation": (7, 0.001),
    "torque": (7, 0.001),
    "status": (6, 0.001),
    "penetration": (1, 0.01),
}


class Together:
    """All metrics of a run."""

    def __init__(self):
        limits = LimitMetrics(LIMITS, control_period=0.001)
        self.parts = ForceMetrics(10.0), TrackingMetrics(0.1), limits

    def update(self, chunk):
        for part in self.parts:
            part.update(chunk)

    def result(self):
        return {k: v for part in self.parts for k, v in part.result().items()}


@pytest.fixture(scope="module")
def samples():
    """Random signals of 7.3 s; the first contact is after 2.15 s."""
    rng = np.random.default_rng(0)
    signals = {}
    for name, (size, period) in PERIODS.items():
        times = period * np.arange(round(7.3 / period) + 1)
        signals[name] = Samples(times, rng.normal(size=(len(times), size)))
    signals["desired_normal_force"].values[:] = 10
    force = signals["normal_force"]
    force.values[:] = 10 + 3 * force.values
    force.values[force.times < 2.15] = 0.0
    status = signals["status"].values
    status[:, 0] = rng.choice(
        [0, *map(int, (Flag.PROTECTIVE_STOP, Flag.BELOW_SURFACE, Flag.ARM_TOUCHES))],
        len(status),
        p=[0.7, 0.1, 0.1, 0.1],
    )
    return signals


def chunk(samples, start, end):
    """Return the samples after a time until another."""
    return {
        name: Samples(*(part[(times > start) & (times <= end)] for part in signal))
        for name, signal in samples.items()
        for times in [signal.times]
    }


def metrics_in_chunks(samples, seconds):
    metrics = Together()
    edges = np.array([-1.0, *np.arange(seconds, 7.3, seconds), 7.3]) + 1e-9
    for start, end in itertools.pairwise(edges):
        metrics.update(chunk(samples, start, end))
    return metrics.result()


@pytest.mark.parametrize("seconds", [0.007, 0.1, 1.0, 2.0])
def test_chunks_of_any_length_give_the_same_metrics(samples, seconds):
    whole = metrics_in_chunks(samples, 10.0)
    assert metrics_in_chunks(samples, seconds) == pytest.approx(whole, rel=1e-12)


def test_metrics_match_their_names(samples):
    found = metrics_in_chunks(samples, 1.0)
    force = samples["normal_force"].values[:, 0]
    since = force[np.argmax(force > 0.5) :]
    pressed = since[since > 0.5]
    state, torque = samples["state"].values, samples["torque"].values
    desired, velocity, measured = (
        samples[name].values
        for name in ("desired_position", "desired_velocity", "measured_position")
    )
    away = np.linalg.norm(desired - measured, axis=1)
    # Forces are known at every other position.
    touches = np.repeat(force > 0.5, 2)[: len(away)] & (desired[:, 2] < 0.1)
    on_board = np.where(touches, np.hypot(*(desired - measured)[:, :2].T), away)
    # Contact is desired below 0.1 m, and counts from the first one on.
    asked = (desired[:, 2] < 0.1)[np.argmax(touches) :]
    jumps = np.diff(desired, axis=0) - 0.005 * (velocity[1:] + velocity[:-1]) / 2
    wanted = (pressed >= 5) & (pressed <= 15)
    precise = (pressed >= 9) & (pressed <= 11)
    assert 0.1 < precise.mean() < 0.9 * wanted.mean()
    assert found == pytest.approx(
        {
            "normal_force_mean_n": pressed.mean(),
            "normal_force_p05_n": np.percentile(pressed, 5),
            "normal_force_p95_n": np.percentile(pressed, 95),
            "normal_force_wanted_fraction": wanted.mean(),
            "normal_force_undisturbed_fraction": wanted.mean(),
            "normal_force_precise_fraction": precise.mean(),
            "normal_force_max_n": force.max(),
            "contact_fraction": len(pressed) / len(since),
            "tracking_rms_m": np.sqrt(np.mean(away**2)),
            "tracking_on_board_rms_m": np.sqrt(np.mean(on_board**2)),
            "tracking_max_m": away.max(),
            "desired_position_jump_max_m": np.linalg.norm(jumps, axis=1).max(),
            "desired_contact_fraction": touches.sum() / asked.sum(),
            "torque_ratio_max": np.abs(samples["actuation"].values).max() / 80,
            "torque_rate_max_nm_per_s": np.abs(np.diff(torque, axis=0)).max() / 1e-3,
            "joint_limit_margin_min_rad": min(
                np.min(state[:, :7] + 3), np.min(2.5 - state[:, :7])
            ),
            "joint_speed_ratio_max": np.abs(state[:, 7:]).max() / 2,
            "penetration_max_m": samples["penetration"].values.max(),
            "arm_on_board_s": 0.001
            * np.sum(samples["status"].values[:, 0] == Flag.ARM_TOUCHES),
            "protective_stop_s": 0.001
            * np.sum(samples["status"].values[:, 0] == Flag.PROTECTIVE_STOP),
            "fault_fraction": np.mean(samples["status"].values[:, 0] > 0),
        },
        abs=0.005,
        rel=1e-9,
    )


def test_jumps_between_two_chunks_are_seen():
    times = 0.005 * np.arange(20)
    signals = {
        name: Samples(period * np.arange(20), np.zeros((20, size)))
        for name, (size, period) in PERIODS.items()
    }
    desired = np.zeros((20, 3))
    desired[10:, 1] = 0.02
    signals["desired_position"] = Samples(times, desired)
    signals["torque"].values[10:, 3] = 1.5
    metrics = Together()
    for part in (slice(10), slice(10, 20)):
        metrics.update({n: Samples(t[part], v[part]) for n, (t, v) in signals.items()})
    assert metrics.result()["desired_position_jump_max_m"] == pytest.approx(0.02)
    assert metrics.result()["torque_rate_max_nm_per_s"] == pytest.approx(1500)


def test_motion_with_its_velocity_is_not_a_jump():
    """x moves at 1 m/s, y at -2 m/s, z jumps by 10 mm at once."""
    times = 0.005 * np.arange(20)
    velocity = np.tile([1.0, -2.0, 0.0], (20, 1))
    desired = times[:, None] * velocity
    desired[12:, 2] = 0.01
    signals = {
        name: Samples(period * np.arange(20), np.zeros((20, size)))
        for name, (size, period) in PERIODS.items()
    }
    signals["desired_position"] = Samples(times, desired)
    signals["desired_velocity"] = Samples(times, velocity)
    metrics = TrackingMetrics(0.1)
    metrics.update(signals)
    jump = metrics.result()["desired_position_jump_max_m"]
    assert jump == pytest.approx(0.01)


def test_orientation_errors_are_those_of_the_rotation_alone():
    """0.3 rad about x and 0.4 rad about y, then nothing; and 5 m beside the path."""
    error = np.zeros((8, 6))
    error[:4, :2], error[:, 3:] = (0.3, 0.4), 5.0
    metrics = OrientationMetrics()
    for part in (error[:3], error[3:]):
        metrics.update({"tracking_error": Samples(np.arange(len(part)), part)})
    assert metrics.result() == {
        "orientation_rms_deg": pytest.approx(np.rad2deg(0.5 / np.sqrt(2))),
        "orientation_max_deg": pytest.approx(np.rad2deg(0.5)),
    }


@pytest.mark.parametrize(
    ("roles", "extra"),
    [
        ({}, ()),
        ({"rotation": (3, 4, 5)}, ("tracking_error",)),
        ({"force": 3}, ()),
    ],
)
def test_signals_follow_from_the_roles_of_the_channels(roles, extra):
    found = metric_signals(ChannelRoles(position=(0, 1, 2), **roles))
    assert found == (*METRIC_SIGNALS, *extra)


@pytest.mark.parametrize(("shape", "events"), [("flat", True), ("none", False)])
def test_force_counts_on_a_board_only(shape, events):
    scenario = Scenario()
    scenario.board.shape = shape
    signals = {}
    for name, (size, period) in PERIODS.items():
        times = period * np.arange(round(2 / period))
        signals[name] = Samples(times, np.zeros((len(times), size)))
    force, status = signals["normal_force"].values, signals["status"].values
    force[:100] = 10.0
    status[:, 2] = 10.0
    status[1000:, 0] = int(Flag.CONTACT_LOST)
    metrics = RunMetrics(scenario, None, LIMITS, control_period=0.001)
    metrics.update(signals)
    assert ("contact_fraction" in metrics.result()) == events
    assert any("contact" in event.text for event in metrics.events()) == events


@pytest.mark.parametrize(
    ("force", "channel", "is_event"),
    [
        (79.0, None, False),
        (81.0, None, True),
        (81.0, 3, False),
    ],
)
def test_force_beyond_twice_the_desired_one_and_60_newtons_is_an_event(
    force, channel, is_event
):
    signals = {
        name: Samples(np.arange(2.0), np.zeros((2, size)))
        for name, (size, _) in PERIODS.items()
    }
    signals["desired_normal_force"] = Samples(np.arange(2.0), np.zeros((2, 1)))
    signals["normal_force"].values[1] = force
    roles = ChannelRoles(position=(0, 1, 2), force=channel)
    metrics = RunMetrics(Scenario(), None, LIMITS, control_period=0.001, roles=roles)
    metrics.update(signals)
    assert any("too large" in event.text for event in metrics.events()) == is_event


@pytest.mark.parametrize("control_period", [0.0005, 0.001, 0.002, 0.005])
def test_torque_rate_is_per_period_of_the_controller(control_period):
    """A torque that rises by 900 Nm/s in steps has that rate, however long they are."""
    times = 0.001 * np.arange(101)
    updates = np.floor(times / control_period + 1e-6)
    torque = np.outer(900 * control_period * updates, np.eye(7)[2])
    signals = {
        name: Samples(times, np.zeros((101, size)))
        for name, (size, _) in PERIODS.items()
    }
    metrics = LimitMetrics(LIMITS, control_period=control_period)
    metrics.update({**signals, "torque": Samples(times, torque)})
    assert metrics.result()["torque_rate_max_nm_per_s"] == pytest.approx(900)


def test_the_largest_force_counts_below_the_contact_threshold_too():
    metrics = ForceMetrics(10.0)
    metrics.update(
        {"normal_force": Samples(np.arange(3.0), np.array([[0.0], [0.3], [0.1]]))}
    )
    assert metrics.result()["normal_force_max_n"] == 0.3


def test_a_run_without_contact_has_no_force():
    metrics = Together()
    none = {n: Samples(np.zeros(1), np.zeros((1, s))) for n, (s, _) in PERIODS.items()}
    metrics.update(none)
    found = metrics.result()
    assert found["contact_fraction"] == 0
    assert found["normal_force_mean_n"] == found["normal_force_p95_n"] == 0
    assert found["normal_force_wanted_fraction"] == 0


@pytest.mark.parametrize("seconds", [0.03, 0.25, 9.0])
def test_error_of_a_changing_force_counts_from_a_second_after_the_first_contact(
    seconds,
):
    times = 0.01 * np.arange(501)
    force, desired = np.zeros((501, 1)), np.full((501, 1), 10.0)
    force[times >= 0.995] = 3.0  # It lands, and rises.
    force[times >= 1.995] = 12.0
    metrics = ForceMetrics(10.0, has_channel=True)
    signals = {
        "normal_force": Samples(times, force),
        "desired_normal_force": Samples(times, desired),
    }
    edges = np.array([-1.0, *np.arange(seconds, 5.1, seconds), 5.1])
    for start, end in itertools.pairwise(edges):
        metrics.update(chunk(signals, start, end))
        if end < 1.9:
            assert "normal_force_error_rms_n" not in metrics.result()
    assert metrics.result()["normal_force_error_rms_n"] == pytest.approx(2.0)


def test_force_is_compared_with_what_is_desired_at_that_time():
    times = 0.01 * np.arange(400)
    desired = np.where(times < 2, 10.0, 2.0)[:, None]
    metrics = ForceMetrics(10.0)
    metrics.update(
        {
            "normal_force": Samples(times, desired + 0.1),
            "desired_normal_force": Samples(times, desired),
        }
    )
    found = metrics.result()
    assert found["normal_force_wanted_fraction"] == 1
    assert found["normal_force_precise_fraction"] == 1
    assert "normal_force_error_rms_n" not in found


@pytest.mark.parametrize(
    ("push", "fraction"),
    [
        # With the 2 s after it, 1.5 to 4 s are not judged.
        (Disturbance(start=1.5, duration=0.5), 0.6),
        (Disturbance(start=0.0, duration=10.0), None),
        (Disturbance(start=2.0, duration=0.5, every=5.0), 0.8),
        (Disturbance(start=1.0, duration=0.5, every=2.5), 1.0),
        (Disturbance(start=30.0), 0.8),
    ],
)
def test_force_is_judged_without_disturbances_and_their_effect(push, fraction):
    times = 0.01 * np.arange(1000)
    force = np.where((times >= 6) & (times < 8), 2.0, 10.0)
    if fraction == 0.6:
        force[times < 1] = 2.0
        force[(times >= 1.5) & (times < 4)] = 70.0
    metrics = ForceMetrics(10.0, disturbances=[push])
    for part in (slice(0, 333), slice(333, None)):
        metrics.update({"normal_force": Samples(times[part], force[part, None])})
    found = metrics.result()["normal_force_undisturbed_fraction"]
    assert found == (None if fraction is None else pytest.approx(fraction))


def test_every_signal_of_the_metrics_is_tested():
    assert set(METRIC_SIGNALS) == set(PERIODS)


class FlatRegion:
    """Stands in for a region: the distance is the height."""

    margin = 0.02

    def distance(self, values):
        return np.abs(values[:, 2])


def off_paths(heights, chunks):
    metrics = RegionMetrics(FlatRegion())
    for part in np.array_split(np.asarray(heights, dtype=float), chunks):
        values = np.column_stack([0 * part, 0 * part, part])
        samples = Samples(0 * part, values)
        still = Samples(0 * part, 0 * values)
        metrics.update({"desired_position": still, "measured_position": samples})
    return metrics.result()


@pytest.mark.parametrize("chunks", [1, 2, 5])
def test_distance_to_the_paths_counts_from_when_they_were_reached(chunks):
    found = off_paths([0.5, 0.1, 0.02, 0.01, 0.03, 0.025], chunks)
    rms = math.sqrt((0.02**2 + 0.01**2 + 0.03**2 + 0.025**2) / 4)
    assert found["measured_off_paths_rms_m"] == pytest.approx(rms)
    assert found["desired_off_paths_rms_m"] == 0.0
    assert off_paths([0.5, 0.1], chunks)["measured_off_paths_rms_m"] is None


def test_distance_without_paths_is_none():
    metrics, far = RegionMetrics(None), Samples(np.zeros(1), np.ones((1, 3)))
    metrics.update({"desired_position": far, "measured_position": far})
    assert set(metrics.result().values()) == {None}


def test_ink_counts_where_there_was_some_and_on_the_demonstrated_area():
    """Eight cells of 1 cm^2 with ink and two without; six of them all were shown."""
    grid = InkGrid(size=(0.10, 0.01), cell=0.01)
    initial, ink = np.ones((1, 10)), np.zeros((1, 10))
    initial[0, :2] = 0.05
    erased = np.array([[0.0, 0.0, 1.0, 1.1, 1.2, 1.3, 2.98, 9, np.inf, np.inf]])
    ink[0, 8:] = 1.0
    found = ink_metrics(
        ink=ink,
        initial_ink=initial,
        erase_time=erased,
        area=np.arange(10)[np.newaxis] % 9 > 0,
        grid=grid,
        seconds=10.0,
    )
    assert found == {
        "cleaned_fraction": pytest.approx(6 / 8),
        "cleaned_fraction_of_demonstrated_area": pytest.approx(6 / 7),
        "seconds_to_50_percent": pytest.approx(1.3),
        "seconds_to_90_percent": None,
        "seconds_to_99_percent": None,
        "missed_spots": 1,
        "missed_area_cm2": pytest.approx(1.0),
        "missed_largest_cm2": pytest.approx(1.0),
    }
