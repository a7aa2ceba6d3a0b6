"""Plausibility of an arm's statuses, each compared with the previous ones."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.panda.status import JOINTS, ArmReading, GateFault

Array = NDArray[np.float64]

# Position outside a joint's range, rad, and velocity above its limit, as a fraction.
_RANGE_MARGIN, _SPEED_MARGIN = 0.05, 0.05
# Step of a position beyond its greatest speed, rad: noise of encoder and stamp.
_STEP_MARGIN = 0.005
# Largest difference between a position and its integrated velocity, rad. The difference
# decays with the time constant, s, and a fraction of the velocity may be wrong: so a bias
# of 0.05 rad/s, and a wrong scale, are no fault.
_MISMATCH, _MISMATCH_TIME, _SCALE_ERROR = 0.01, 0.2, 0.05
# A state that stays the same to the last bit for this time, s, and so many statuses is
# frozen where a joint moves faster, rad/s, or a torque changes by more, Nm.
_FROZEN_TIME, _FROZEN_STATUSES = 0.005, 3
_MOVING, _TORQUE_CHANGE = 0.02, 0.1
# After a longer silence, s, nothing can be compared.
_COMPARABLE = 0.1


class StatusTrack(NamedTuple):
    """Memory for the comparison of statuses.

    Attributes
    ----------
    time : float
        Time stamp of the newest status, s; minus infinity before the first.
    robot_time : float
        Time stamp of the robot in it, s.
    since, robot_since : float
        Time stamps of the first statuses with its state, and with its robot time, s; the
        first restarts when a changed torque should move the arm.
    repeats, robot_repeats : float
        Numbers of statuses that repeated them.
    is_pushed : float
        1 where the torque that was sent has changed while the state has not.
    state : array, shape (14,)
        Positions and velocities in the newest status, rad and rad/s.
    mismatch : array, shape (7,)
        Decaying difference between the positions and the integrated velocities, rad.
    torque : array, shape (7,)
        Torque that was sent when the state was new, Nm.
    """

    time: float
    robot_time: float
    since: float
    robot_since: float
    repeats: float
    robot_repeats: float
    is_pushed: float
    state: Array
    mismatch: Array
    torque: Array

    @classmethod
    def from_vector(cls, values: ArrayLike) -> "StatusTrack":
        """Return the memory that `vector` describes."""
        vector = np.array(values, dtype=float)
        time, robot_time, since, robot_since = vector[:4].tolist()
        repeats, robot_repeats, is_pushed = vector[4:7].tolist()
        state, mismatch, torque = np.split(vector[7:], [2 * JOINTS, 3 * JOINTS])
        return cls(
            time, robot_time, since, robot_since, repeats, robot_repeats, is_pushed,
            state, mismatch, torque,
        )  # fmt: skip

    def vector(self) -> Array:
        """Return all values, shape (35,)."""
        return np.concatenate([self[:7], *self[7:]])


def initial_track() -> StatusTrack:
    """Return the memory before the first status."""
    nothing = np.zeros(JOINTS)
    return StatusTrack(
        -np.inf, 0.0, -np.inf, -np.inf, 0.0, 0.0, 0.0,
        np.zeros(2 * JOINTS), nothing, nothing,
    )  # fmt: skip


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
    since, repeats = track.since, track.repeats + 1
    is_pushed, start_torque, mismatch = track.is_pushed, track.torque, track.mismatch
    robot_since, robot_repeats = track.robot_since, track.robot_repeats + 1
    if elapsed > _COMPARABLE or not np.array_equal(reading.state, track.state):
        since, repeats, start_torque, is_pushed = reading.time, 0.0, torque, 0.0
    elif not is_pushed and np.any(np.abs(torque - start_torque) > _TORQUE_CHANGE):
        is_pushed = 1.0
        if not _is_moving(reading):
            # It has rested so far; now it must move.
            since, repeats = reading.time, 0.0
    if elapsed > _COMPARABLE or reading.robot_time != track.robot_time:
        robot_since, robot_repeats = reading.time, 0.0
    if elapsed > _COMPARABLE:
        mismatch = np.zeros(JOINTS)
    else:
        step = reading.state[:JOINTS] - track.state[:JOINTS]
        move = elapsed * 0.5 * (reading.state[JOINTS:] + track.state[JOINTS:])
        excess = np.maximum(np.abs(step - move) - _SCALE_ERROR * np.abs(move), 0.0)
        decay = math.exp(-elapsed / _MISMATCH_TIME)
        mismatch = decay * mismatch + np.sign(step - move) * excess
    return StatusTrack(
        reading.time,
        reading.robot_time,
        since,
        robot_since,
        repeats,
        robot_repeats,
        is_pushed,
        reading.state,
        mismatch,
        start_torque,
    )


def implausible(
    limits: JointLimits, before: StatusTrack, after: StatusTrack, reading: ArmReading
) -> GateFault:
    """Return what cannot be true of a status.

    A frozen measurement is told from an arm at rest by the noise of a real encoder: at
    rest, too, the last bits of 14 numbers differ from one status to the next. A
    simulated arm without noise may rest at one state. So a state that is the same to the
    last bit is a fault only where it has a velocity, or where the torque that is sent
    changes meanwhile. A robot's own time stamp that stands still is always one.

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
    elapsed = reading.time - before.time
    if elapsed == 0 and not np.array_equal(reading.state, before.state):
        faults |= GateFault.INCONSISTENT
    if 0 < elapsed <= _COMPARABLE:
        reachable = (1 + _SPEED_MARGIN) * elapsed * limits.speed + _STEP_MARGIN
        if np.any(np.abs(q - before.state[:JOINTS]) > reachable):
            faults |= GateFault.JUMP
    if np.any(np.abs(after.mismatch) > _MISMATCH):
        faults |= GateFault.INCONSISTENT
    is_constant = (
        after.repeats >= _FROZEN_STATUSES
        and after.time - after.since >= _FROZEN_TIME - 1e-6
    )
    must_change = _is_moving(reading) or after.is_pushed
    has_no_time = (
        after.robot_time > 0
        and after.robot_repeats >= _FROZEN_STATUSES
        and after.time - after.robot_since >= _FROZEN_TIME - 1e-6
    )
    if (is_constant and must_change) or has_no_time:
        faults |= GateFault.FROZEN
    return faults


def _is_moving(reading: ArmReading) -> bool:
    return bool(np.any(np.abs(reading.state[JOINTS:]) > _MOVING))
