"""Facts about the pure parts that keep the arm safe: watchdog, walls, limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SystemsError
from fmp_drake.systems.impedance.algebra import Pose, TaskTarget, task_error, unwrapped
from fmp_drake.systems.impedance.controller_status import (
    STATUS_SIZE,
    ImpedanceStatus,
    StatusFlag,
)
from fmp_drake.systems.impedance.force_control import ForceState
from fmp_drake.systems.impedance.joints import (
    JointLimits,
    JointWallConfig,
    rate_limited,
    speed_limited,
    wall_torque,
)
from fmp_drake.systems.impedance.records import (
    MEMORY,
    ImpedanceMemory,
    encode,
    held_pose,
    last_target,
    values_of,
)
from fmp_drake.systems.impedance.supervision import (
    LOST,
    RECOVERING,
    STOPPED,
    TRACKING,
    ForceRecord,
    LastTarget,
    WatchdogConfig,
    WatchdogState,
    force_faults,
    next_watchdog_state,
    supervised,
    target_faults,
    target_fraction,
)

WATCHDOG = WatchdogConfig()
WALLS = JointWallConfig()


def one_joint(lower, upper, *, speed, effort):
    """The limits of an arm of one joint."""
    effort = np.array([effort])
    return JointLimits.between(
        np.array([lower]),
        np.array([upper]),
        speed=np.array([speed]),
        lower_effort=-effort,
        upper_effort=effort,
    )


ONE_JOINT = one_joint(-1.0, 2.0, speed=2.0, effort=10.0)


def walk(state, faults, *, distance=0.0, angle=0.0):
    states = []
    for fault in faults:
        state = next_watchdog_state(
            values_of(WATCHDOG), state, fault, float(distance), float(angle), 0.001
        )
        states.append(state)
    return states


# The watchdog.


def test_a_good_target_is_tracked():
    assert walk(WatchdogState(), [False] * 10)[-1] == WatchdogState()


def test_a_fault_stops_at_once_and_as_long_as_it_lasts():
    states = walk(WatchdogState(), [True] * 500)
    assert {state.mode for state in states} == {STOPPED}
    assert target_fraction(states[-1]) == (0.0, 0.0)


def test_a_stop_ends_when_the_target_was_good_for_the_settle_time():
    held = walk(WatchdogState(), [True])[-1]
    modes = [state.mode for state in walk(held, [False] * 1000)]
    waited = modes.index(RECOVERING)
    assert waited == pytest.approx(1000 * WATCHDOG.settle_time, abs=2)
    assert modes[-1] == TRACKING


def test_an_arm_is_held_where_a_stop_began_and_recovers_from_there():
    def pose(x, angle):
        c, s = np.cos(angle), np.sin(angle)
        return Pose(
            np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]),
            np.array([x, 0.0, 0.0]),
        )

    start, stop, target = pose(0.0, 0.0), pose(0.3, 0.0), pose(1.5, 0.0)
    for faults, held, x in (([False], start, 0.0), ([True, True], stop, 0.3)):
        state, found = WatchdogState(), start
        for i, fault in enumerate(faults):
            # It moves on while it is stopped.
            measured = stop if i == 0 else pose(0.4, 0.0)
            state, found = supervised(
                values_of(WATCHDOG), state, found, measured, target, fault, 0.001
            )
        assert found.p[0] == held.p[0] == x
    # From 0.3 m to 1.5 m, and back by 1.2 rad, with smooth steps.
    for there, duration in (
        (target, 1.5 * 1.2 / 0.2),
        (pose(0.3, 1.2), 1.5 * 1.2 / 0.8),
    ):
        stopped = WatchdogState(STOPPED, 1.0, 0.0)
        state, found = supervised(
            values_of(WATCHDOG), stopped, stop, start, there, False, 0.001
        )
        assert state.mode == RECOVERING
        assert state.duration == pytest.approx(duration)
        assert found.p[0] == 0.3


def test_a_fault_while_recovering_stops_again():
    held = walk(WatchdogState(), [True])[-1]
    recovering = walk(held, [False] * 250)[-1]
    assert recovering.mode == RECOVERING
    assert walk(recovering, [True])[-1].mode == STOPPED


@pytest.mark.parametrize(("distance", "angle"), [(0.5, 0.0), (0.1, 2.0), (0.0, 0.0)])
def test_a_recovery_keeps_to_its_speeds_and_is_smooth(distance, angle):
    held = walk(WatchdogState(), [True])[-1]
    states = walk(held, [False] * 6000, distance=distance, angle=angle)
    fraction, rate = np.array([target_fraction(state) for state in states]).T
    assert np.all(np.diff(fraction) >= 0)
    assert fraction[-1] == 1
    assert rate.max() * distance <= WATCHDOG.recovery_speed * 1.001
    assert rate.max() * angle <= WATCHDOG.recovery_angular_speed * 1.001
    if distance or angle:  # Nor is it slower than they allow.
        ratios = (
            distance / WATCHDOG.recovery_speed,
            angle / WATCHDOG.recovery_angular_speed,
        )
        assert rate.max() * max(ratios) > 0.99
    assert_allclose(np.gradient(fraction, 0.001)[:-2], rate[:-2], atol=0.05)


def test_lost_state_is_followed_by_a_stop():
    lost = WatchdogState(LOST, 0.0, 0.0)
    assert walk(lost, [False])[-1].mode == STOPPED


# The walls.


def wall(q, v, limits=ONE_JOINT):
    n = len(limits.middle)
    return wall_torque(
        values_of(WALLS), limits, np.full(n, q), np.full(n, v), np.full(n, 0.5)
    )


def pushes(found):
    return found.at_wall or found.too_fast or bool(found.torque.any())


def test_there_is_no_wall_in_the_middle():
    assert not pushes(wall(0.5, 1.0))


@pytest.mark.parametrize(("q", "sign"), [(1.95, -1), (-0.95, 1), (3.0, -1), (-2.0, 1)])
def test_a_wall_pushes_back_with_the_effort_of_the_joint(q, sign):
    found = wall(q, 0.0)
    assert found.at_wall
    assert sign * found.torque[0] >= 10 - 1e-9


@given(st.floats(-1.0, 2.0), st.floats(-4.0, 4.0))
def test_a_joint_limit_only_dissipates_energy_beyond_that_of_its_spring(q, v):
    assert (wall(q, v).torque[0] - wall(q, 0.0).torque[0]) * v <= 1e-12


def test_the_spring_of_a_wall_grows_towards_the_limit():
    q = np.linspace(1.9, 2.05, 100)
    torque = np.array([wall(x, 0.0).torque[0] for x in q])
    assert np.all(np.diff(torque) <= 0)
    assert torque[-1] == pytest.approx(-20.0)


def test_a_joint_is_braked_before_the_wall_the_faster_it_is():
    assert not pushes(wall(1.7, 0.5))
    found = wall(1.7, 1.5)
    assert found.too_fast
    assert not found.at_wall
    assert found.torque[0] < 0


@pytest.mark.parametrize("v", [1.9, -1.9])
def test_a_joint_too_fast_for_the_model_is_braked_anywhere(v):
    found = wall(0.5, v)
    assert found.too_fast
    assert found.torque[0] * v < 0


def test_a_joint_without_limits_has_no_wall():
    free = one_joint(-np.inf, np.inf, speed=np.inf, effort=np.inf)
    assert not pushes(wall(100.0, 50.0, free))


@pytest.mark.parametrize(("inside", "outward"), [(0.7, -1), (-2.3, 1)])
def test_a_joint_with_one_limit_has_one_wall(inside, outward):
    ends = (0.5, np.inf) if outward < 0 else (-np.inf, -2.1)
    limits = one_joint(*ends, speed=2.0, effort=10.0)
    assert not pushes(wall(inside, 0.0, limits))
    assert not pushes(wall(inside - 40.0 * outward, -1.5 * outward, limits))
    found = wall(inside + 0.15 * outward, 0.0, limits)
    assert found.at_wall
    assert -outward * found.torque[0] == pytest.approx(10.0)


def test_a_joint_without_an_effort_limit_still_has_a_wall():
    limits = one_joint(-1.0, 1.0, speed=np.inf, effort=np.inf)
    found = wall(1.0, 0.0, limits)
    assert np.isfinite(found.torque).all()
    assert found.torque[0] < -100


# The rotation error through 180 degrees.


def test_error_passes_180_degrees_without_a_jump():
    axis = np.array([0.6, 0.0, 0.8])
    previous, seen = np.zeros(3), []
    for angle in np.radians(np.arange(0, 260)):
        desired = Pose(Rotation.from_rotvec(angle * axis).as_matrix(), np.ones(3))
        error = task_error(Pose(np.eye(3), np.zeros(3)), desired)
        error = unwrapped(error, previous)
        assert_array_equal(error[3:], 1.0)
        previous = error[:3]
        seen.append(previous)
    steps = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    assert steps.max() < np.radians(1.001)
    assert np.linalg.norm(seen[-1]) == pytest.approx(np.radians(259))


def test_error_of_more_than_270_degrees_takes_the_short_way():
    previous = np.radians([269.9, 0, 0])
    error = np.array([*np.radians([-89.8, 0, 0]), 0, 0, 0])
    assert_array_equal(unwrapped(error, previous), error)


@given(st.integers(0, 1000))
def test_an_unwrapped_error_is_the_same_rotation(seed):
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=3)
    phi *= rng.uniform(0, np.pi) / np.linalg.norm(phi)
    found = unwrapped(np.r_[phi, 0, 0, 0], 3 * rng.normal(size=3))[:3]
    assert_allclose(
        Rotation.from_rotvec(found).as_matrix(),
        Rotation.from_rotvec(phi).as_matrix(),
        atol=1e-12,
    )


# Memory and status.


@pytest.mark.parametrize("used", [False, True])
def test_the_memory_survives_its_vector(used):
    rng = np.random.default_rng(0)
    memory = ImpedanceMemory(
        watchdog=WatchdogState(2, 0.3, 1.1),
        force=ForceState(0.015, 7.0, 0.02),
        tank_energy=0.7,
        saturated=used,
        target=LastTarget(used, 0.05, random_pose(rng), rng.normal(size=3)),
        held=random_pose(rng),
        stiffness=rng.normal(size=(6, 6)),
        rotation_error=rng.normal(size=3),
        force_record=ForceRecord(7.0, 8.0, 2.0),
    )
    vector = encode(memory)
    assert vector.shape == (MEMORY.itemsize // 8,)
    record = vector.view(MEMORY)[0]
    names = MEMORY.names
    rows = [*memory.watchdog, *memory.force, memory.tank_energy, used, used, 0.05]
    assert [record[name] for name in names[: len(rows)]] == rows
    target = last_target(record)
    assert target.known == used
    assert_array_equal(target.drift, memory.target.drift)
    poses = (target.X, memory.target.X), (held_pose(record), memory.held)
    for found, kept in poses:
        assert_array_equal(found.R, kept.R)
        assert_array_equal(found.p, kept.p)
    assert_array_equal(record.stiffness, memory.stiffness)
    assert_array_equal(record.rotation_error, memory.rotation_error)
    assert [record[name] for name in names[-3:]] == [*memory.force_record]


def random_pose(rng):
    return Pose(rng.normal(size=(3, 3)), rng.normal(size=3))


# The target.


HERE = Pose(np.eye(3), np.zeros(3))
NOWHERE = LastTarget(False, 0.0, HERE, np.zeros(3))


def faults(
    p, *, R=None, last=None, speed=0.0, age=np.nan, V=None, A=None, measured=HERE
):
    last = LastTarget(True, 0.0, HERE, np.zeros(3)) if last is None else last
    V = np.array([0.0, 0, 0, speed, 0, 0]) if V is None else np.array(V, float)
    A = np.zeros(6) if A is None else np.array(A, float)
    target = TaskTarget(Pose(np.eye(3) if R is None else R, np.array(p, float)), V, A)
    return target_faults(values_of(WATCHDOG), last, measured, target, age, 0.001)


def test_the_first_target_may_not_be_far_from_the_tool():
    flags, last = faults([0.0, 0.0, 0.59], last=NOWHERE)
    assert flags == 0
    assert last.known
    assert_array_equal(last.X.p, [0.0, 0.0, 0.59])
    assert faults([0.0, 0.0, 0.61], last=NOWHERE)[0] == StatusFlag.JUMP
    there = Pose(np.eye(3), np.array([0.4, -0.5, 0.3]))
    assert faults([0.5, -0.5, 0.3], last=NOWHERE, measured=there)[0] == 0
    far = faults([-0.4, 0.5, -0.3], last=NOWHERE, measured=there)[0]
    assert far == StatusFlag.JUMP


def test_a_target_may_jump_no_farther_than_allowed():
    assert faults([0.051, 0.0, 0.0])[0] == StatusFlag.JUMP
    assert faults([0.051, 0.0, 0.0], speed=2.0)[0] == 0
    half = Rotation.from_rotvec([0.0, 0.0, 0.31]).as_matrix()
    assert faults([0.0, 0.0, 0.0], R=half)[0] == StatusFlag.JUMP


@pytest.mark.parametrize(
    ("index", "limit"), [(0, 10.0), (2, 10.0), (3, 3.0), (5, 3.0), (6, 200), (11, 50)]
)
def test_a_target_may_be_no_faster_than_allowed(index, limit):
    for factor, flag in ((0.99, 0), (-1.01, StatusFlag.IMPLAUSIBLE)):
        motion = np.zeros(12)
        motion[index] = factor * limit
        assert faults([0.0] * 3, V=motion[:6], A=motion[6:])[0] == flag


def test_a_claimed_velocity_excuses_no_jump():
    flags, _ = faults([1.0, 0.0, 0.0], speed=1000.0)
    assert flags == StatusFlag.IMPLAUSIBLE


def test_a_target_of_the_future_is_implausible():
    assert faults([0.0] * 3, age=-0.09)[0] == 0
    assert faults([0.0] * 3, age=-0.11)[0] == StatusFlag.IMPLAUSIBLE


def test_target_whose_motion_contradicts_its_velocity_is_implausible():
    def flags(path, speed, n=300):
        last, found = None, []
        for k in range(n):
            flag, last = faults([path(0.001 * k), 0.0, 0.0], last=last, speed=speed)
            found.append(flag)
        return found

    assert not any(flags(lambda t: 2.0 * t, 2.0))
    # As by samples at 50 Hz, with noise, or without any velocity.
    assert not any(flags(lambda t: 0.02 * (t // 0.02), 1.0))
    assert not any(flags(lambda t: 0.001 * np.sin(1e4 * t), 0.0))
    assert not any(flags(lambda t: 0.4 * t, 0.0))
    # 50 mm of difference at 3 m/s.
    still = flags(lambda t: 1e-9 * (round(1000 * t) % 2), 3.0)
    assert still.index(StatusFlag.IMPLAUSIBLE) == pytest.approx(18, abs=2)
    assert all(flag & StatusFlag.IMPLAUSIBLE for flag in still[20:])
    assert any(flags(lambda t: 0.02 * t, -3.0))


def test_target_is_old_by_its_time_stamp_or_without_a_change():
    assert faults([0.0] * 3, age=0.11)[0] == StatusFlag.STALE
    assert faults([0.0] * 3, age=0.09, speed=0.3)[0] == 0
    # It stands still also where it dithers.
    for step in (0.0, 1e-9, 1e-6):
        last, flags = None, []
        for k in range(110):
            found, last = faults([step * (k % 2), 0.0, 0.0], last=last, speed=0.3)
            flags.append(found)
        assert flags.index(StatusFlag.STALE) == pytest.approx(100, abs=4)
        assert faults([0.0] * 3, last=last, speed=0.0)[0] == 0


# The normal force.


def force_flags(force, *, desired=10.0, duration=2.0):
    record, found = ForceRecord(), []
    for k in range(round(1000 * duration)):
        value = float(force(0.001 * k))
        flag, record = force_faults(
            values_of(WATCHDOG), record, value - desired, desired, 0.001
        )
        found.append(flag)
    return found


@pytest.mark.parametrize("frequency", [8, 20, 40])
def test_a_force_that_oscillates_is_a_fault(frequency):
    def wave(rms):
        return lambda t: 10 + np.sqrt(2) * rms * np.sin(2 * np.pi * frequency * t)

    assert not any(force_flags(wave(8.0)))
    found = force_flags(wave(20.0))
    assert found.index(StatusFlag.FORCE_OSCILLATION) < 400


def test_rising_or_rubbing_force_is_not_an_oscillation():
    assert not any(force_flags(lambda t: 15.0 * (t > 0.1)))
    assert not any(force_flags(lambda t: 10 + 8 * np.sin(2 * np.pi * t)))
    # Noise above the band, from sample to sample.
    assert not any(force_flags(lambda t: 10 + 20 * (-1) ** round(1000 * t)))


def test_a_force_far_above_the_desired_one_is_a_fault():
    assert not any(force_flags(lambda t: 79.0 * min(t, 1.0)))
    found = force_flags(lambda t: 100.0 * min(t, 1.0))
    assert found.index(StatusFlag.EXCESS_FORCE) == pytest.approx(800, abs=10)
    assert not any(force_flags(lambda t: 100.0 * min(t, 1.0), desired=30.0))


# Joint speeds.


def limited(v, torque, wall=0.0):
    """Limit the torque of one joint of 0.1 kg m², which was zero before."""
    M, rest = np.array([[0.1]]), np.zeros(1)
    v, torque, wall = np.array([v]), np.array([torque]), np.array([wall])
    return speed_limited(ONE_JOINT, torque, rest, 1.0, 0.001, v, M, rest, wall)


def test_a_torque_is_applied_only_where_its_acceleration_ends_in_time():
    """10 Nm on 0.1 kg m² add 0.6 rad/s until they end; 95 % of the limit are 1.9."""
    torque, overspeed = limited(1.29, 10.0)
    assert (torque[0], overspeed) == (10.0, False)
    torque, overspeed = limited(1.31, 10.0)
    assert overspeed
    assert torque[0] == -1.0
    assert limited(-1.31, -10.0)[1]
    assert limited(-1.31, 10.0) == (10.0, False)
    # Too fast already: braked, and a fault.
    assert limited(2.01, -10.0) == (-10.0, True)


def test_a_joint_that_is_braked_does_not_wait_for_the_others():
    # 9 Nm of change for the first joint, 0.4 Nm for the last; at most 0.9 Nm an update.
    change = np.array([9.0, -4.5, -0.4])
    free = rate_limited(change, np.zeros(3), 0.9)
    np.testing.assert_allclose(free, [0.9, -0.45, -0.04])
    braked = rate_limited(change, np.array([0.0, -3.0, -0.4]), 0.9)
    np.testing.assert_allclose(braked, [0.9, -0.9, -0.4])


def test_a_limit_spring_does_not_drive_a_joint_above_its_speed():
    assert limited(1.31, 10.0, wall=10.0) == (-1.0, True)
    assert limited(1.31, -10.0, wall=-10.0) == (-10.0, False)


def test_a_contact_that_drives_a_joint_is_still_countered():
    # By the masses alone the second joint would accelerate: by M⁻¹ τ, 5 rad/s².
    limits = ONE_JOINT._replace(
        **{n: np.tile(v, 2) for n, v in ONE_JOINT._asdict().items()}
    )
    M = np.array([[1.0, 0.1], [0.1, 0.02]])
    rest, v, wall = np.zeros(2), np.array([0.0, 1.999]), np.array([0.0, -0.02])
    torque, overspeed = speed_limited(
        limits, np.array([-1.0, -0.05]), rest, 2.0, 0.001, v, M, rest, wall
    )
    assert overspeed
    # Both come to rest, and the second with at least what it had asked for.
    assert torque[1] <= -0.05


def test_the_status_is_read_by_name():
    values = [65.0, 0.0, 0.5, 1.0, -2.0, 0.3]
    status = ImpedanceStatus.from_vector(values)
    assert ImpedanceStatus.from_vector(np.array(values)) == status
    with pytest.raises(SystemsError, match=r"status of shape \(2,\); expected \(6,\)"):
        ImpedanceStatus.from_vector([1.0, 2.0])
    for flags in (np.nan, np.inf, -1.0, 2.5):
        with pytest.raises(SystemsError, match=f"are {flags}; they must be a whole"):
            ImpedanceStatus.from_vector([flags, *values[1:]])
    assert status.flags == StatusFlag.PROTECTIVE_STOP | StatusFlag.ERROR_CLIPPED
    assert status[1:] == (0.0, 0.5, 1.0, -2.0, 0.3)
    assert len(status) == STATUS_SIZE


def test_every_flag_is_one_bit_and_documented():
    values = [flag.value for flag in StatusFlag]
    assert len(set(values)) == len(values)
    assert all(value.bit_count() == 1 for value in values)
    assert all(f"`{flag.name}`" in StatusFlag.__doc__ for flag in StatusFlag)
