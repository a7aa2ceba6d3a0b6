"""Facts about the pure parts that keep the arm safe: watchdog, walls, limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from fmp_drake.systems.impedance.error import continued, task_error
from fmp_drake.systems.impedance.force_control import ForceState
from fmp_drake.systems.impedance.memory import MEMORY_SIZE, ImpedanceMemory
from fmp_drake.systems.impedance.status import (
    STATUS_SIZE,
    ImpedanceStatus,
    StatusFlag,
)
from fmp_drake.systems.impedance.walls import (
    JointLimits,
    JointWallConfig,
    wall_torque,
)
from fmp_drake.systems.impedance.watchdog import (
    WatchdogConfig,
    WatchdogMode,
    WatchdogState,
    watch,
)

WATCHDOG = WatchdogConfig()
WALLS = JointWallConfig()
ONE_JOINT = JointLimits.between(
    np.array([-1.0]), np.array([2.0]), speed=np.array([2.0]), effort=np.array([10.0])
)


def walk(state, faults, *, distance=0.0, angle=0.0):
    states = []
    for fault in faults:
        state = watch(
            WATCHDOG,
            state,
            fault=fault,
            distance=distance,
            angle=angle,
            period=0.001,
        )
        states.append(state)
    return states


# The watchdog.


def test_a_good_target_is_tracked():
    assert walk(WatchdogState(), [False] * 10)[-1] == WatchdogState()


def test_a_fault_holds_at_once_and_as_long_as_it_lasts():
    states = walk(WatchdogState(), [True] * 500)
    assert {state.mode for state in states} == {WatchdogMode.HOLD}
    assert states[-1].blend() == (0.0, 0.0)


def test_a_hold_ends_when_the_target_was_good_for_the_settle_time():
    held = walk(WatchdogState(), [True])[-1]
    modes = [state.mode for state in walk(held, [False] * 1000)]
    waited = modes.index(WatchdogMode.RECOVER)
    assert waited == pytest.approx(1000 * WATCHDOG.settle_time, abs=2)
    assert modes[-1] == WatchdogMode.TRACK


def test_a_fault_while_recovering_holds_again():
    held = walk(WatchdogState(), [True])[-1]
    recovering = walk(held, [False] * 250)[-1]
    assert recovering.mode == WatchdogMode.RECOVER
    assert walk(recovering, [True])[-1].mode == WatchdogMode.HOLD


@pytest.mark.parametrize(("distance", "angle"), [(0.5, 0.0), (0.1, 2.0), (0.0, 0.0)])
def test_a_recovery_keeps_to_its_speeds_and_is_smooth(distance, angle):
    held = walk(WatchdogState(), [True])[-1]
    states = walk(held, [False] * 6000, distance=distance, angle=angle)
    share, rate = np.array([state.blend() for state in states]).T
    assert np.all(np.diff(share) >= 0)
    assert share[-1] == 1
    assert rate.max() * distance <= WATCHDOG.recovery_speed * 1.001
    assert rate.max() * angle <= WATCHDOG.recovery_turn_rate * 1.001
    assert_allclose(np.gradient(share, 0.001)[:-2], rate[:-2], atol=0.05)


def test_a_lost_state_becomes_a_hold():
    lost = WatchdogState(WatchdogMode.LOST)
    assert walk(lost, [False])[-1].mode == WatchdogMode.HOLD


# The walls.


def wall(q, v, limits=ONE_JOINT):
    n = len(limits.middle)
    return wall_torque(
        WALLS, limits, q=np.full(n, q), v=np.full(n, v), inertia=np.full(n, 0.5)
    )


def test_there_is_no_wall_in_the_middle():
    assert wall(0.5, 1.0) is None


@pytest.mark.parametrize(("q", "sign"), [(1.95, -1), (-0.95, 1), (3.0, -1), (-2.0, 1)])
def test_a_wall_pushes_back_with_the_effort_of_the_joint(q, sign):
    found = wall(q, 0.0)
    assert found.at_wall
    assert sign * found.torque[0] >= 10 - 1e-9


@given(st.floats(-1.0, 2.0), st.floats(-4.0, 4.0))
def test_a_wall_takes_energy_but_for_its_spring(q, v):
    found = wall(q, v)
    if found is None:
        return
    spring = wall(q, 0.0)
    still = 0.0 if spring is None else spring.torque[0]
    assert (found.torque[0] - still) * v <= 1e-12


def test_the_spring_of_a_wall_grows_towards_the_limit():
    q = np.linspace(1.9, 2.05, 100)
    torque = np.array([0.0 if (w := wall(x, 0.0)) is None else w.torque[0] for x in q])
    assert np.all(np.diff(torque) <= 0)
    assert torque[-1] == pytest.approx(-20.0)


def test_a_joint_is_braked_before_the_wall_the_faster_it_is():
    assert wall(1.7, 0.5) is None
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
    free = JointLimits.between(
        np.array([-np.inf]),
        np.array([np.inf]),
        speed=np.array([np.inf]),
        effort=np.array([np.inf]),
    )
    with np.errstate(invalid="raise"):
        assert wall(100.0, 50.0, free) is None


def test_a_joint_without_an_effort_limit_still_has_a_wall():
    limits = JointLimits.between(
        np.array([-1.0]),
        np.array([1.0]),
        speed=np.array([np.inf]),
        effort=np.array([np.inf]),
    )
    found = wall(1.0, 0.0, limits)
    assert np.isfinite(found.torque).all()
    assert found.torque[0] < -100


# The rotation error through 180 degrees.


def test_an_error_goes_through_180_degrees_without_a_jump():
    axis = np.array([0.6, 0.0, 0.8])
    previous, seen = np.zeros(3), []
    for angle in np.radians(np.arange(0, 260)):
        error = task_error(
            R_TE=np.eye(3),
            p_TE=np.zeros(3),
            R_TE_desired=Rotation.from_rotvec(angle * axis).as_matrix(),
            p_TE_desired=np.ones(3),
        )
        error = continued(error, previous)
        assert_array_equal(error[3:], 1.0)
        previous = error[:3]
        seen.append(previous)
    steps = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    assert steps.max() < np.radians(1.001)
    assert np.linalg.norm(seen[-1]) == pytest.approx(np.radians(259))


def test_an_error_of_more_than_270_degrees_goes_the_short_way():
    previous = np.radians([269.9, 0, 0])
    error = np.array([*np.radians([-89.8, 0, 0]), 0, 0, 0])
    assert_array_equal(continued(error, previous), error)


@given(st.integers(0, 1000))
def test_a_continued_error_is_the_same_rotation(seed):
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=3)
    phi *= rng.uniform(0, np.pi) / np.linalg.norm(phi)
    found = continued(np.r_[phi, 0, 0, 0], 3 * rng.normal(size=3))[:3]
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
        watchdog=WatchdogState(2, 0.3, 1.5),
        force=ForceState(1.5, 0.02),
        tank_energy=0.7,
        frozen_time=0.05,
        saturated=used,
        last=rng.normal(size=12) if used else None,
        hold=rng.normal(size=12),
        filtered=rng.normal(size=24) if used else None,
        stiffness=rng.normal(size=36),
        rotation_error=rng.normal(size=3),
    )
    vector = memory.to_vector()
    assert vector.shape == (MEMORY_SIZE,)
    again = ImpedanceMemory.from_vector(vector)
    for name in ImpedanceMemory.__slots__:
        assert_array_equal(getattr(again, name), getattr(memory, name), err_msg=name)


def test_the_status_is_read_by_name():
    status = ImpedanceStatus.from_vector([65.0, 0.0, 0.5, 1.0, -2.0, 0.3])
    assert status.flags == StatusFlag.HOLD | StatusFlag.ERROR_CLIPPED
    assert status[1:] == (0.0, 0.5, 1.0, -2.0, 0.3)
    assert len(status) == STATUS_SIZE


def test_every_flag_is_one_bit_and_documented():
    values = [flag.value for flag in StatusFlag]
    assert values == [1 << k for k in range(len(values))]
    assert all(f"`{flag.name}`" in StatusFlag.__doc__ for flag in StatusFlag)
