"""Facts about what can be true of an arm's statuses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.panda.arm_status import (
    ArmReading,
    GateFault,
    StatusTrack,
    implausible,
    initial_track,
    track_status,
)

# Ranges from -1 to 3 rad, 2 rad/s.
LIMITS = JointLimits(
    np.ones(7), np.full(7, 2.0), np.full(7, 2.0), np.full(7, -80.0), np.full(7, 80.0)
)
NOTHING = GateFault(0)


def reading(time, q, v, robot_time=0.0):
    state = np.r_[np.broadcast_to(q, 7), np.broadcast_to(v, 7)].astype(float)
    return ArmReading(time, state, np.zeros(7), np.zeros(7), NOTHING, robot_time)


def faults_of(statuses, torques=None):
    """Return the faults of each status, of which each has time, q, v (and more)."""
    track, faults = initial_track(), []
    for i, values in enumerate(statuses):
        status = reading(*values)
        torque = np.broadcast_to(0.0 if torques is None else torques[i], 7)
        after = track_status(track, status, torque)
        faults.append(implausible(LIMITS, track, after, status))
        track = after
    return faults


def moving(*, rate=1000, speed=1.5, amplitude=0.2, seconds=0.5, noise=0.0, skip=()):
    """A sine of all joints, as statuses."""
    random = np.random.default_rng(0)
    times = np.arange(0, seconds, 1 / rate)
    times = np.delete(times, [i for i in skip if i < len(times)])
    w = speed / amplitude
    return [
        (
            1.0 + t,
            1 + amplitude * np.sin(w * t) + noise * 1e-2 * random.normal(size=7),
            speed * np.cos(w * t) + noise * random.normal(size=7),
        )
        for t in times
    ]


@pytest.mark.parametrize("rate", [200, 1000])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_fast_arm_with_noise_is_plausible(rate, noise):
    assert not any(faults_of(moving(rate=rate, noise=noise)))
    assert not any(faults_of(moving(rate=rate, noise=noise, skip=(7, 20, 21, 50))))


@pytest.mark.parametrize("rate", [200, 1000])
def test_an_arm_at_rest_is_plausible_while_no_torque_changes(rate):
    assert not any(faults_of([(1.0 + i / rate, 1.0, 0.0) for i in range(100)]))


@pytest.mark.parametrize(
    ("q", "v", "fault"),
    [
        (3.04, 0.0, NOTHING),
        (3.06, 0.0, GateFault.OUT_OF_RANGE),
        (-1.04, 0.0, NOTHING),
        (-1.06, 0.0, GateFault.OUT_OF_RANGE),
        (1.0, 2.09, NOTHING),
        (1.0, 2.11, GateFault.TOO_FAST),
        (1.0, -2.09, NOTHING),
        (1.0, -2.11, GateFault.TOO_FAST),
    ],
)
def test_ranges_and_speeds_have_a_margin_of_5_hundredths(q, v, fault):
    one = np.zeros(7)
    one[4] = 1.0
    assert faults_of([(1.0, 1 + (q - 1) * one, v * one)]) == [fault]


@pytest.mark.parametrize("elapsed", [0.001, 0.005, 0.04])
def test_no_joint_moves_farther_than_its_speed_allows(elapsed):
    largest = 0.005 + 1.05 * 2.0 * elapsed
    for sign in (-1, 1):
        for step, is_jump in ((0.99 * largest, False), (1.01 * largest, True)):
            before, after = (1.0, 1.0, 0.0), (1.0 + elapsed, 1.0 + sign * step, 0.0)
            fault = faults_of([before, after])[1]
            assert bool(fault & GateFault.JUMP) == is_jump


@pytest.mark.parametrize("bias", [-1.0, 1.0])
def test_a_velocity_must_be_that_of_the_positions(bias):
    false = [(t, q, v + bias) for t, q, v in moving(speed=0.5)]
    first = next(i for i, fault in enumerate(faults_of(false)) if fault)
    assert first <= 10
    assert faults_of(false)[first] is GateFault.INCONSISTENT
    # A scale error of 5 % is a real sensor's, and so is a bias of 0.04 rad/s.
    for speed in (0.5, 1.8):
        assert not any(faults_of([(t, q, 1.05 * v) for t, q, v in moving(speed=speed)]))
    assert not any(faults_of([(t, q, v + 0.04) for t, q, v in moving(speed=0.5)]))


def test_a_velocity_that_is_10_percent_too_large_is_found():
    times = np.arange(0, 0.5, 1e-3)
    # No encoder gives the same velocity again and again.
    noise = 1e-9 * np.arange(len(times))
    false = [(1 + t, 1 + 1.8 * t, 1.98 + e) for t, e in zip(times, noise, strict=True)]
    assert GateFault.INCONSISTENT in faults_of(false)


@pytest.mark.parametrize("drift", [-0.1, 0.1])
@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_a_position_that_drifts_is_found_before_three_quarters_of_a_degree(
    drift, speed
):
    true = moving(speed=speed, amplitude=0.2, noise=1e-9)
    false = [(t, q + drift * (t - 1), v) for t, q, v in true]
    first = next(i for i, fault in enumerate(faults_of(false)) if fault)
    assert faults_of(false)[first] is GateFault.INCONSISTENT
    assert abs(drift) * (false[first][0] - 1) < np.radians(0.75)


def test_one_time_has_one_state():
    assert faults_of([(1.0, 1.0, 0.0), (1.0, 1.0, 0.0)])[1] is NOTHING
    assert faults_of([(1.0, 1.0, 0.0), (1.0, 1.1, 0.0)])[1] is GateFault.INCONSISTENT


@pytest.mark.parametrize("rate", [200, 1000])
def test_a_frozen_state_that_moves_is_found_within_20_ms(rate):
    faults = faults_of([(1.0 + i / rate, 1.0, 0.1) for i in range(rate // 20)])
    first = next(i for i, fault in enumerate(faults) if fault & GateFault.FROZEN)
    assert first >= 3
    assert 0.005 <= first / rate <= 0.02
    assert all(fault & GateFault.FROZEN for fault in faults[first:])


@pytest.mark.parametrize("rate", [200, 1000])
@pytest.mark.parametrize("part", [1, 2])
def test_positions_or_velocities_that_are_frozen_alone_are_found_within_20_ms(
    rate, part
):
    statuses = [list(status) for status in moving(rate=rate, speed=0.3)]
    for status in statuses[rate // 10 :]:
        status[part] = statuses[rate // 10][part]
    faults = faults_of(statuses)
    first = next(i for i, fault in enumerate(faults) if fault)
    assert faults[first] is GateFault.FROZEN
    assert 0.005 <= (first - rate // 10) / rate <= 0.02


def test_a_velocity_of_zero_beside_the_noise_of_an_encoder_is_plausible():
    noise = np.random.default_rng(0).uniform(-4e-5, 4e-5, 200)
    assert not any(faults_of([(1 + 1e-3 * i, 1 + e, 0.0) for i, e in enumerate(noise)]))


@pytest.mark.parametrize("rate", [200, 1000])
def test_a_state_that_does_not_respond_to_torque_is_frozen(rate):
    statuses = [(1.0 + i / rate, 1.0, 0.0) for i in range(100)]
    torques = [0.05] * 50 + [0.3] * 50
    faults = faults_of(statuses, torques)
    assert not any(faults[:52])
    first = next(i for i, fault in enumerate(faults) if fault) - 50
    # Three statuses, and 5 ms.
    assert first == max(3, rate // 200)
    # So is one joint that does not answer.
    one = [[0.0] * 7] * 50 + [[0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0]] * 50
    assert faults_of(statuses, one).index(GateFault.FROZEN) == first + 50
    # The last bit of one number is enough.
    noisy = [(t, q + 1e-15 * (i % 2), v) for i, (t, q, v) in enumerate(statuses)]
    assert not any(faults_of(noisy, torques))


def test_a_robot_whose_own_time_stands_still_is_frozen():
    statuses = moving(seconds=0.02)
    still = [(*status, 5.0) for status in statuses]
    assert faults_of(still)[-1] is GateFault.FROZEN
    running = [(*status, 5.0 + 1e-3 * i) for i, status in enumerate(statuses)]
    assert not any(faults_of(running))


def test_after_a_silence_nothing_is_compared():
    assert not any(faults_of([(1.0, 1.0, 0.0), (1.11, 1.5, 0.3), (1.3, 1.0, -0.5)]))


@given(st.lists(st.floats(-10, 10), min_size=44, max_size=44))
def test_a_memory_is_a_vector(values):
    track = StatusTrack.from_vector(values)
    assert_array_equal(track.vector(), values)
    assert_array_equal(
        StatusTrack.from_vector(initial_track().vector()).vector(),
        initial_track().vector(),
    )
