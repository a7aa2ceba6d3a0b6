"""Decoding and checks of a Panda's status message."""

import struct
from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_panda_status
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOINTS = 7
# Every measurement of an arm is smaller, in rad, rad/s and Nm.
_LARGEST = 1000.0


class GateFault(IntFlag):
    """Reasons for which the torque of an arm goes to zero; they can be combined.

    Of the arm's status:

    - `STALE`: it is older than its expiry, from the future, or was never received.
    - `OUT_OF_ORDER`: it is older than the previous one.
    - `CORRUPT`: the message cannot be decoded, or does not have seven joints.
    - `NOT_FINITE`: a number in it is NaN, infinite or above 1000 (rad, rad/s, Nm).
    - `WRONG_MODE`: the arm is not in motion mode, or does not report torque control.
    - `OUT_OF_RANGE`: a joint's position is outside its range by a margin.
    - `TOO_FAST`: a joint's velocity is above its limit by a margin.
    - `JUMP`: a position moved farther than its greatest speed allows.
    - `INCONSISTENT`: positions do not follow from velocities, or one time has two states.
    - `FROZEN`: the state stays the same to the last bit, although the arm must move.

    Of the controller:

    - `GAP`: it paused for longer than the largest gap.
    - `CLOCK`: its clock ran backwards, or its time is not finite.
    - `NO_TORQUE`: its torque is NaN or infinite.
    - `STOPPED`: the operator requested a stop.
    - `OTHER_CONTROLLER`: another program sends commands to the arm.

    Examples
    --------
    >>> GateFault(3)
    <GateFault.STALE|OUT_OF_ORDER: 3>
    """

    STALE = 1
    OUT_OF_ORDER = 2
    CORRUPT = 4
    NOT_FINITE = 8
    WRONG_MODE = 16
    GAP = 32
    CLOCK = 64
    NO_TORQUE = 128
    STOPPED = 256
    OUT_OF_RANGE = 512
    TOO_FAST = 1024
    JUMP = 2048
    INCONSISTENT = 4096
    FROZEN = 8192
    OTHER_CONTROLLER = 16384


class ArmReading(NamedTuple):
    """Decoded status of the arm.

    Attributes
    ----------
    time : float
        Time stamp, s of the wall clock; minus infinity before the first status.
    state : array, shape (14,)
        Angles and velocities of the joints, rad and rad/s.
    torque : array, shape (7,)
        Measured joint torques, with gravity, Nm.
    torque_external : array, shape (7,)
        Joint torques of the contacts on the arm, Nm.
    faults : GateFault
        Faults of this message alone.
    robot_time : float
        Time stamp of the robot itself, s; 0 where its driver leaves it out.
    """

    time: float
    state: Array
    torque: Array
    torque_external: Array
    faults: GateFault
    robot_time: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Return whether its numbers can be used, regardless of the arm's mode."""
        return not self.faults & (GateFault.CORRUPT | GateFault.NOT_FINITE)


def decode(message_type: Any, data: bytes) -> Any:
    """Decode an LCM message; return an empty one where the bytes are not a message."""
    try:
        return message_type.decode(data)
    except (ValueError, struct.error):
        return message_type()


def read_status(message: Any) -> ArmReading:
    """Check an ``lcmt_panda_status`` and return its numbers.

    Any object is accepted: a missing or wrong field is a fault, not an error. The
    message's external torque is that of the arm on its contacts.

    Examples
    --------
    >>> read_status(lcmt_panda_status()).faults
    <GateFault.CORRUPT: 4>
    """
    nothing = np.zeros(JOINTS)
    corrupt = ArmReading(
        -np.inf, np.zeros(2 * JOINTS), nothing, nothing, GateFault.CORRUPT
    )
    try:
        rows = np.array(
            [
                message.joint_position,
                message.joint_velocity,
                message.joint_torque,
                message.joint_torque_external,
            ],
            dtype=float,
        )
        time = 1e-6 * float(message.utime)
        robot_time = 1e-6 * float(message.robot_utime)
        is_moving = message.robot_mode == lcmt_panda_status.kMove
        # Torque on an arm that expects positions is dangerous: no mode is not trusted.
        is_torque = message.control_mode == lcmt_panda_status.CONTROL_MODE_TORQUE
    except (AttributeError, TypeError, ValueError, OverflowError):
        return corrupt
    if rows.shape != (4, JOINTS) or message.num_joints != JOINTS:
        return corrupt
    faults = GateFault(0)
    # Comparisons with NaN are false.
    if not np.all(np.abs(rows) < _LARGEST):
        faults |= GateFault.NOT_FINITE
    if not (is_moving and is_torque):
        faults |= GateFault.WRONG_MODE
    return ArmReading(time, rows[:2].ravel(), rows[2], -rows[3], faults, robot_time)
