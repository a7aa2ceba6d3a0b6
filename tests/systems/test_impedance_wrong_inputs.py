"""Facts about an arm with invalid inputs: its joint speeds, and its protective stop."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fmp_drake.runs.events import _STOPS
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.controller_status import STOP_REASONS, StatusFlag
from fmp_drake.systems.page.page_status import mode_in_words
from tests.arm_loop import Q_START, X_WT_FLAT, ArmLoop, make_arm, pose_in_task

X_START = pose_in_task(make_arm(), Q_START, X_WT_FLAT)
P = X_START.translation()
BEGIN, END = 0.05, 0.6
SPEED_LIMIT = make_arm().GetVelocityUpperLimits()
# Of a limit, with what the prediction of a joint's speed neglects.
ALLOWED = 1.05
SOFT = np.diag([30.0, 30, 30, 500, 500, 500])
X_FRAME = np.r_[1.0, 0, 0, 0, X_WT_FLAT.translation()]


def along(size, axis, n=3):
    vector = np.zeros(n)
    vector[axis] = size
    return vector


def stepped(value, before=None):
    value = np.array(value, dtype=float)
    before = np.zeros_like(value) if before is None else np.array(before, dtype=float)
    return lambda t: value if t >= BEGIN else before


def dithering(t):
    return P + along(1e-9 * (round(1000 * t) % 2), 0)


def jumping(t):
    return P - along(1.0 if t >= BEGIN else 0.0, 0)


def running(t):
    """40 m/s, in steps that are no jumps."""
    return P + along(0.04 * max(0, round(1000 * (t - BEGIN))), 0)


def spinning(t):
    rotation = Rotation.from_matrix(X_START.rotation().matrix())
    turned = Rotation.from_rotvec(along(5 * max(0, t - BEGIN), 0)) * rotation
    return np.roll(turned.as_quat(), 1)


def stiffness(translational, rotational=30.0):
    stiff = np.diag([rotational] * 3 + [translational] * 3)
    return {
        "stiffness": stepped(stiff.ravel(), SOFT.ravel()),
        "desired_position": lambda t: P + along(0.03 * np.sin(9 * t), 0),
        "desired_velocity": lambda t: along(0.27 * np.cos(9 * t), 0),
    }


FLAG = StatusFlag
# Signals, and the flag that says what is wrong, or 0 where the arm may go on.
CASES = {
    "acceleration of 1e3 m/s^2": (
        {"desired_acceleration": stepped([1e3, 0, 0])},
        FLAG.IMPLAUSIBLE,
    ),
    "acceleration of 45 m/s^2": (
        {"desired_acceleration": stepped([45, 0, 0])},
        FLAG.OVERSPEED,
    ),
    "3 m/s, the position dithers by 1 nm": (
        {"desired_velocity": stepped([3, 0, 0]), "desired_position": dithering},
        FLAG.IMPLAUSIBLE,
    ),
    "0.4 m/s, the position dithers by 1 nm": (
        {"desired_velocity": stepped([0.4, 0, 0]), "desired_position": dithering},
        FLAG.STALE,
    ),
    "stiffness of 1e7 N/m": (stiffness(1e7), FLAG.STIFFNESS_REFUSED),
    "stiffness of 1e5 N/m": (stiffness(1e5), FLAG.STIFFNESS_REFUSED),
    "stiffness of 1e4 N/m": (stiffness(1e4), 0),
    "stiffness of 1e7 Nm/rad": (stiffness(500.0, 1e7), FLAG.STIFFNESS_REFUSED),
    "a jump of 1 m, excused by a velocity": (
        {
            "desired_position": jumping,
            "desired_velocity": lambda t: along(
                -1e3 if abs(t - BEGIN) < 5e-4 else 0.0, 0
            ),
        },
        FLAG.IMPLAUSIBLE,
    ),
    "40 m/s without a velocity": ({"desired_position": running}, FLAG.IMPLAUSIBLE),
    "a target of the future, 3 m/s": (
        {
            "target_time": lambda t: np.array([t + 1e6]),
            "desired_velocity": stepped([3, 0, 0]),
        },
        FLAG.IMPLAUSIBLE,
    ),
    "a first target 1 m away": (
        {"desired_position": lambda _t: P - along(1.0, 0)},
        FLAG.JUMP,
    ),
    "force of 1000 N": ({"feedforward_wrench": stepped(along(1e3, 3, 6))}, 0),
    "torque of 1000 Nm": ({"feedforward_wrench": stepped(along(1e3, 0, 6))}, 0),
    "normal force of 1e4 N in the air": (
        {
            "desired_normal_force": stepped([1e4]),
            "desired_position": lambda _t: P * [1, 1, 0],
        },
        FLAG.PROTECTIVE_STOP,
    ),
    "angular acceleration of 1e4 rad/s^2": (
        {"desired_angular_acceleration": stepped([1e4, 0, 0])},
        FLAG.IMPLAUSIBLE,
    ),
    "angular velocity of 20 rad/s": (
        {"desired_angular_velocity": stepped([20, 0, 0])},
        FLAG.IMPLAUSIBLE,
    ),
    "rotation by 5 rad/s": (
        {
            "desired_orientation": spinning,
            "desired_angular_velocity": stepped([5, 0, 0]),
        },
        0,
    ),
    "a frame at rest with 3 m/s": (
        {
            "task_frame": lambda _t: X_FRAME,
            "task_frame_velocity": stepped(along(3, 3, 6)),
        },
        FLAG.IMPLAUSIBLE,
    ),
    "a frame with 1e3 m/s^2": (
        {
            "task_frame": lambda _t: X_FRAME,
            "task_frame_velocity": lambda _t: np.zeros(6),
            "task_frame_acceleration": stepped(along(1e3, 3, 6)),
        },
        FLAG.IMPLAUSIBLE,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_no_input_makes_a_joint_exceed_its_speed_limit(case):
    signals, flag = CASES[case]
    logs = ArmLoop(signals).run(END)
    ratio = np.max(np.abs(logs["state"][:, 7:]) / SPEED_LIMIT)
    assert ratio <= ALLOWED
    flags = logs["status"][:, 0].astype(int)
    seen = int(np.bitwise_or.reduce(flags))
    assert seen & flag == flag
    if flag in STOP_REASONS:
        first = np.flatnonzero(flags & flag)[0]
        assert flags[first] & FLAG.PROTECTIVE_STOP
        assert logs["status"][first, 1] == 0.0
        assert flags[first : first + 150].min() & FLAG.PROTECTIVE_STOP


@pytest.mark.parametrize(("ratio", "stops"), [(0.97, False), (1.02, True)])
def test_a_joint_that_is_moved_too_fast_is_braked_and_above_its_limit_stopped(
    ratio, stops
):
    v = np.zeros(7)
    v[6] = ratio * SPEED_LIMIT[6]
    logs = ArmLoop().run(0.2, v=v)
    flags = logs["status"][:, 0].astype(int)
    expected = FLAG.PROTECTIVE_STOP | FLAG.SPEED_EXCEEDED if stops else 0
    assert flags[1] & (FLAG.PROTECTIVE_STOP | FLAG.SPEED_EXCEEDED) == expected
    assert bool(logs["status"][1, 1] == 0) == stops
    assert np.abs(logs["state"][-1, 7:]).max() < 0.25 * SPEED_LIMIT[6]
    assert mode_in_words(FLAG.OVERSPEED, 0, 0.0, desired=9.0)[1] == "braking"


@pytest.mark.parametrize(
    ("force", "flag"),
    [
        (lambda t: 10 + 30 * np.sin(2 * np.pi * 20 * t), FLAG.FORCE_OSCILLATION),
        (lambda t: 10.0 if t < 0.2 else 120.0, FLAG.EXCESS_FORCE),
        (lambda _t: 12.0, 0),
    ],
)
def test_a_measured_force_that_runs_away_stops_the_arm(force, flag):
    config = ImpedanceConfig()
    config.force_control.enabled = True
    signals = {
        "desired_normal_force": lambda _t: np.array([10.0]),
        "normal_force": lambda t: np.array([force(t)]),
    }
    logs = ArmLoop(signals, config=config, engage_height=10.0).run(0.5)
    flags = logs["status"][:, 0].astype(int)
    seen = int(np.bitwise_or.reduce(flags))
    assert bool(seen & FLAG.PROTECTIVE_STOP) == bool(flag)
    assert seen & flag == flag


@pytest.mark.parametrize("flag", STOP_REASONS)
def test_each_reason_of_a_stop_is_shown_and_listed(flag):
    _, mode, detail = mode_in_words(FLAG.PROTECTIVE_STOP, flag, 0.0, desired=9.0)
    assert (mode, detail) == ("protective stop", STOP_REASONS[flag])
    assert flag in _STOPS
