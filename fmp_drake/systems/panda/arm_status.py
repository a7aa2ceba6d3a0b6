"""Decoding and plausibility checks of a Panda's status messages."""

import math
import struct
from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_panda_status
from numpy.typing import ArrayLike

from fmp_drake.numeric import Array, Mask
from fmp_drake.systems.impedance.joints import JointLimits

JOINTS = 7
# Bound of every measurement of an arm, in rad, rad/s and Nm.
_LARGEST = 1000.0
# Tolerated position outside a joint's range, rad, and velocity above its limit, a fraction.
_RANGE_MARGIN, _SPEED_MARGIN = 0.05, 0.05
# Step of a position beyond its greatest speed, rad: noise of encoder and stamp.
_STEP_MARGIN = 0.005
# Largest difference between a position and its integrated velocity, rad. The difference
# decays with the time constant, s, and a fraction of the velocity may be wrong: so a
# bias of 0.05 rad/s, and a wrong scale, are not faults.
_MISMATCH, _MISMATCH_TIME, _SCALE_ERROR = 0.005, 0.1, 0.05
# Time, s, and number of statuses with identical bits after which a value is constant.
_CONSTANT_TIME, _CONSTANT_STATUSES = 0.005, 3
# A joint with more than this velocity, rad/s, or distance, rad, moves: it is above the noise
# of an encoder. A greater change of torque than the third value, Nm, moves an arm at rest.
_MOVING, _MOVED, _TORQUE_CHANGE = 0.02, 1e-4, 0.1
# Parts of a status that may be constant.
_POSITIONS, _VELOCITIES, _ROBOT_TIME = range(3)
# Greatest time between statuses that are compared, s.
_COMPARABLE = 0.1


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
    - `FROZEN`: the state is identical to the last bit although the arm must move.

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


FAULTS = {
    GateFault.STALE: "no recent status, or the clocks of the two computers differ",
    GateFault.OUT_OF_ORDER: "a status is older than the previous one: the network reorders "
    "messages",
    GateFault.CORRUPT: "a message that is not a status of seven joints: another program "
    "uses the channel",
    GateFault.NOT_FINITE: "a status with NaN, or with impossibly large numbers",
    GateFault.WRONG_MODE: "the robot is idle, guided by hand, stopped by its button, in "
    "reflex, or not in torque control",
    GateFault.OUT_OF_RANGE: "a joint is outside its range: another arm's model, or a wrong "
    "message",
    GateFault.TOO_FAST: "a joint is above its speed limit",
    GateFault.JUMP: "a joint moved farther than its speed limit allows",
    GateFault.INCONSISTENT: "positions that do not follow from the velocities, or two "
    "states at one time",
    GateFault.FROZEN: "the same state to the last bit while it has a velocity or the torque "
    "changes",
    GateFault.OTHER_CONTROLLER: "another program sends commands on the channel: end it",
    GateFault.GAP: "this program was paused: the computer is busy",
    GateFault.CLOCK: "the clock ran backwards",
    GateFault.NO_TORQUE: "the controller's torque was NaN: please report it",
    GateFault.STOPPED: "the operator pressed Enter",
}
"""Words for the reasons of a stop, as in the manual."""


def faults_in_words(faults: GateFault) -> str:
    """Describe the reasons of a stop, each with its code.

    Examples
    --------
    >>> faults_in_words(GateFault.GAP | GateFault.CLOCK)
    'this program was paused: the computer is busy (GAP); the clock ran backwards (CLOCK)'
    """
    return "; ".join(
        f"{text} ({fault.name})" for fault, text in FAULTS.items() if fault in faults
    )


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
        unusable = GateFault.STALE | GateFault.CORRUPT | GateFault.NOT_FINITE
        return not self.faults & unusable


def no_status() -> ArmReading:
    """Return the reading before the first status."""
    nothing = np.zeros(JOINTS)
    return ArmReading(-np.inf, np.zeros(2 * JOINTS), nothing, nothing, GateFault.STALE)


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
    corrupt = no_status()._replace(faults=GateFault.CORRUPT)
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
        # Torque on an arm that expects positions is dangerous: a status without a mode
        # is not trusted.
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


class StatusTrack(NamedTuple):
    """Memory for the comparison of statuses.

    Attributes
    ----------
    time : float
        Time stamp of the newest status, s; minus infinity before the first.
    robot_time : float
        Time stamp of the robot in it, s.
    is_pushed : float
        1 where the torque that was sent has changed while the state has not.
    since : array, shape (3,)
        Time stamps of the first statuses with its positions, its velocities and its robot
        time, s; the first two restart when a changed torque should move the arm.
    repeats : array, shape (3,)
        Numbers of statuses that repeated them.
    state : array, shape (14,)
        Positions and velocities in the newest status, rad and rad/s.
    mismatch : array, shape (7,)
        Decaying difference between the positions and the integrated velocities, rad.
    torque : array, shape (7,)
        Torque that was sent when the state was new, Nm.
    origin : array, shape (7,)
        Positions when the velocities were new, rad.
    """

    time: float
    robot_time: float
    is_pushed: float
    since: Array
    repeats: Array
    state: Array
    mismatch: Array
    torque: Array
    origin: Array

    @classmethod
    def from_vector(cls, values: ArrayLike) -> "StatusTrack":
        """Return the memory that `vector` describes."""
        vector = np.array(values, dtype=float)
        sizes = [3, 3, 3, 2 * JOINTS, JOINTS, JOINTS]
        numbers, *arrays = np.split(vector, np.cumsum(sizes))
        return cls(*numbers.tolist(), *arrays)

    def vector(self) -> Array:
        """Return all values, shape (44,)."""
        return np.concatenate([self[:3], *self[3:]])

    @property
    def is_constant(self) -> Mask:
        """Whether positions, velocities and robot time have stood still, shape (3,)."""
        duration = self.time - self.since
        is_long = duration >= _CONSTANT_TIME - 1e-6
        return is_long & (self.repeats >= _CONSTANT_STATUSES)


def initial_track() -> StatusTrack:
    """Return the memory before the first status."""
    nothing, state = np.zeros(JOINTS), np.zeros(2 * JOINTS)
    return StatusTrack(
        -np.inf, 0.0, 0.0, np.zeros(3), np.zeros(3), state, nothing, nothing, nothing
    )


def track_status(track: StatusTrack, reading: ArmReading, torque: Array) -> StatusTrack:
    """Return the memory after a status.

    Parameters
    ----------
    track : StatusTrack
    reading : ArmReading
        Finite. One that is not newer than the last changes nothing.
    torque : array, shape (7,)
        The last torque that was sent, Nm.
    """
    elapsed = reading.time - track.time
    if not elapsed > 0:
        return track
    can_compare = elapsed <= _COMPARABLE
    step = reading.state - track.state
    is_same = np.array(
        [
            not step[:JOINTS].any(),
            not step[JOINTS:].any(),
            reading.robot_time == track.robot_time,
        ]
    )
    is_pushed, start_torque = track.is_pushed, track.torque
    has_state = can_compare and bool(is_same[:_ROBOT_TIME].all())
    is_restarted = np.full(3, not can_compare)
    if not has_state:
        start_torque, is_pushed = torque, 0.0
    elif not is_pushed and np.any(np.abs(torque - start_torque) > _TORQUE_CHANGE):
        is_pushed = 1.0
        # An arm that has been at rest must move now.
        is_restarted[:_ROBOT_TIME] = not _is_moving(reading)
    is_new = ~is_same | is_restarted
    mismatch = np.zeros(JOINTS)
    if can_compare:
        move = elapsed * 0.5 * (reading.state[JOINTS:] + track.state[JOINTS:])
        error = step[:JOINTS] - move
        excess = np.maximum(np.abs(error) - _SCALE_ERROR * np.abs(move), 0.0)
        decay = math.exp(-elapsed / _MISMATCH_TIME)
        mismatch = decay * track.mismatch + np.sign(error) * excess
    return StatusTrack(
        reading.time,
        reading.robot_time,
        is_pushed,
        np.where(is_new, reading.time, track.since),
        np.where(is_new, 0.0, track.repeats + 1),
        reading.state,
        mismatch,
        start_torque,
        reading.state[:JOINTS] if is_new[_VELOCITIES] else track.origin,
    )


def implausible(
    limits: JointLimits, before: StatusTrack, after: StatusTrack, reading: ArmReading
) -> GateFault:
    """Return the faults of implausible values in a status.

    A frozen measurement is distinguished from an arm at rest by the noise of a real
    encoder: even at rest, the last bits of 14 numbers differ from one status to the
    next. A simulated arm without noise may rest at one state. Therefore an identical
    state is a fault only where it has a velocity, or where the torque that is sent
    changes meanwhile. Further faults are constant positions with a velocity, constant
    velocities with changing positions, and a robot's own time stamp that stands still.

    Parameters
    ----------
    limits : JointLimits
    before, after : StatusTrack
        Before and after `track_status` for this status.
    reading : ArmReading
        Finite.
    """
    faults = GateFault(0)
    q, v = reading.state[:JOINTS], reading.state[JOINTS:]
    if np.any(np.abs(q - limits.middle) > limits.half_range + _RANGE_MARGIN):
        faults |= GateFault.OUT_OF_RANGE
    if np.any(np.abs(v) > (1 + _SPEED_MARGIN) * limits.speed):
        faults |= GateFault.TOO_FAST
    elapsed, step = reading.time - before.time, q - before.state[:JOINTS]
    if elapsed == 0 and not np.array_equal(reading.state, before.state):
        faults |= GateFault.INCONSISTENT
    if 0 < elapsed <= _COMPARABLE:
        reachable = (1 + _SPEED_MARGIN) * elapsed * limits.speed + _STEP_MARGIN
        if np.any(np.abs(step) > reachable):
            faults |= GateFault.JUMP
    if np.any(np.abs(after.mismatch) > _MISMATCH):
        faults |= GateFault.INCONSISTENT
    is_constant = after.is_constant
    is_moving = _is_moving(reading)
    has_moved = np.any(np.abs(q - after.origin) > _MOVED)
    if (
        (is_constant[_POSITIONS] and is_moving)
        or (is_constant[_VELOCITIES] and has_moved)
        or (is_constant[:_ROBOT_TIME].all() and after.is_pushed)
        or (is_constant[_ROBOT_TIME] and after.robot_time > 0)
    ):
        faults |= GateFault.FROZEN
    return faults


def _is_moving(reading: ArmReading) -> bool:
    return bool(np.any(np.abs(reading.state[JOINTS:]) > _MOVING))
