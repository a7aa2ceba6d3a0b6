"""Targets of the end effector: filtered, blended, and in a frame that moves."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.systems.impedance.error import rotation_vector

Array = NDArray[np.float64]


class TaskTarget(NamedTuple):
    """Where the end effector shall be, and how it shall move.

    Parameters
    ----------
    R : array, shape (3, 3)
        R_TE.
    p : array, shape (3,)
        p_TE, m.
    V, A : array, shape (6,)
        Twist and its derivative, rotation first, in T: rad/s, m/s, rad/s², m/s².
    """

    R: Array
    p: Array
    V: Array
    A: Array


def rotation_of_quaternion(wxyz: Array) -> Array:
    """Return the rotation matrix, shape (3, 3), of a quaternion of any length.

    Both signs give the same matrix. A quaternion of length 0 gives NaN.
    """
    w, x, y, z = wxyz.tolist()
    squared = w * w + x * x + y * y + z * z
    s = 2 / squared if squared > 0 else float("nan")
    return np.array(
        (
            (1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
            (s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)),
            (s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)),
        )
    )


def rotation_of_vector(phi: Array) -> Array:
    """Return the rotation matrix, shape (3, 3), of a rotation vector in rad."""
    half = 0.5 * float(np.sqrt(np.dot(phi, phi)))
    scale = 0.5 * np.sinc(half / np.pi)
    return rotation_of_quaternion(np.array((np.cos(half), *(scale * phi))))


def low_pass(filtered: TaskTarget, target: TaskTarget, share: float) -> TaskTarget:
    """Let a filtered target follow by a share in (0, 1] of what is left.

    Position, twist and acceleration pass the same filter, so they stay each
    other's derivatives. The orientation goes the shorter way.
    """
    turn = share * rotation_vector(np.dot(target.R, filtered.R.T))
    return TaskTarget(
        np.dot(rotation_of_vector(turn), filtered.R),
        filtered.p + share * (target.p - filtered.p),
        filtered.V + share * (target.V - filtered.V),
        filtered.A + share * (target.A - filtered.A),
    )


def blend(
    target: TaskTarget, *, R_TE: Array, p_TE: Array, share: float, rate: float
) -> TaskTarget:
    """Mix a pose at rest and a target: the pose at share 0, the target at 1.

    Parameters
    ----------
    target : TaskTarget
    R_TE, p_TE : array, shape (3, 3) and (3,)
        The pose.
    share, rate : float
        The target's share and its derivative, 1/s.
    """
    turn = rotation_vector(np.dot(target.R, R_TE.T))
    shift = target.p - p_TE
    return TaskTarget(
        np.dot(rotation_of_vector(share * turn), R_TE),
        p_TE + share * shift,
        share * target.V + rate * np.concatenate((turn, shift)),
        share * target.A,
    )


def carried(
    target: TaskTarget, frame_twist: Array, frame_acceleration: Array
) -> TaskTarget:
    """Turn a motion relative to T into the motion in the world, in T's axes.

    Parameters
    ----------
    target : TaskTarget
        Relative to T.
    frame_twist : array, shape (6,)
        V_WT of T's origin, in T's axes, rad/s and m/s.
    frame_acceleration : array, shape (6,)
        A_WT, its derivative in W, in T's axes, rad/s² and m/s².
    """
    w, u = frame_twist[:3], frame_twist[3:]
    V, A = target.V.copy(), target.A.copy()
    turning = np.cross(w, target.p)
    V[:3] += w
    V[3:] += u + turning
    A += frame_acceleration
    A[:3] += np.cross(w, target.V[:3])
    A[3:] += np.cross(frame_acceleration[:3], target.p)
    A[3:] += np.cross(w, turning) + 2 * np.cross(w, target.V[3:])
    return TaskTarget(target.R, target.p, V, A)
