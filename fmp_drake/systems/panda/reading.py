"""What a Panda says of itself in a message, checked."""

import struct
from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_panda_status
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOINTS = 7
# Nothing that an arm measures is as large.
_GREATEST = 1000.0


class GateFault(IntFlag):
    """Why the torque of an arm goes to zero; any of them together.

    Of the arm's status:

    - `STALE`: it is older than its expiry, from the future, or never came.
    - `OUT_OF_ORDER`: it is older than the one before.
    - `CORRUPT`: the message cannot be decoded, or has not seven joints.
    - `NOT_FINITE`: a number in it is NaN, infinite or above 1000 (rad, rad/s, Nm).
    - `WRONG_MODE`: the arm is not moving, or says that it is not controlled by torque.

    Of the controller:

    - `GAP`: it did nothing for longer than the largest gap.
    - `CLOCK`: its clock ran backwards or is no number.
    - `NO_TORQUE`: its torque is NaN or infinite.
    - `STOPPED`: somebody asked for a stop.

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


class ArmReading(NamedTuple):
    """A status of the arm.

    Attributes
    ----------
    time : float
        When it was stamped, s of the wall clock; minus infinity for never.
    state : array, shape (14,)
        Angles and speeds of the joints, rad and rad/s.
    torque : array, shape (7,)
        Measured, with gravity, Nm.
    torque_external : array, shape (7,)
        Of what touches the arm, on the arm, Nm.
    faults : GateFault
        What is wrong with it alone.
    """

    time: float
    state: Array
    torque: Array
    torque_external: Array
    faults: GateFault

    @property
    def is_finite(self) -> bool:
        """Whether its numbers can be used, in whatever mode the arm is."""
        return not self.faults & (GateFault.CORRUPT | GateFault.NOT_FINITE)


def decode(message_type: Any, data: bytes) -> Any:
    """Return a message of LCM, or an empty one where the bytes are none."""
    try:
        return message_type.decode(data)
    except (ValueError, struct.error):
        return message_type()


def read_status(message: Any) -> ArmReading:
    """Check an ``lcmt_panda_status`` and return its numbers.

    Any object will do: what is not as it must be is a fault, not an error. The
    message's external torque is that of the arm on what it touches.

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
        moves = message.robot_mode == lcmt_panda_status.kMove
        # A driver that leaves the mode out checks the one that a command expects.
        modes = int(message.control_mode)
        by_torque = not modes or modes & lcmt_panda_status.CONTROL_MODE_TORQUE
    except (AttributeError, TypeError, ValueError, OverflowError):
        return corrupt
    if rows.shape != (4, JOINTS) or message.num_joints != JOINTS:
        return corrupt
    faults = GateFault(0)
    # NaN compares with nothing.
    if not np.all(np.abs(rows) < _GREATEST):
        faults |= GateFault.NOT_FINITE
    if not (moves and by_torque):
        faults |= GateFault.WRONG_MODE
    return ArmReading(time, rows[:2].ravel(), rows[2], -rows[3], faults)
