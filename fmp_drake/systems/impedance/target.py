"""Target of the end effector, and its tracking error."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.systems.impedance.algebra import (
    Pose,
    cross,
    dot,
    norm,
    product,
    rotation_from_vector,
    rotation_vector,
    stacked,
)

Array = NDArray[np.float64]


class TaskTarget(NamedTuple):
    """Desired pose and motion of the end effector.

    Parameters
    ----------
    X : Pose
        X_TE.
    V, A : array, shape (6,)
        Twist and its derivative, rotation first, in T: rad/s, m/s, rad/s², m/s².
    """

    X: Pose
    V: Array
    A: Array


@compiled
def task_error(measured: Pose, desired: Pose) -> Array:
    """Compute the displacement from the measured to the desired pose.

    Parameters
    ----------
    measured, desired : Pose
        X_TE as it is and as it shall be.

    Returns
    -------
    array, shape (6,)
        ``(log(R_TE_desired R_TEᵀ), p_TE_desired − p_TE)``: rad and m, in T.
    """
    return stacked(
        rotation_vector(product(desired.R, measured.R.T)), desired.p - measured.p
    )


@compiled
def unwrapped(error: Array, previous: Array) -> Array:
    """Unwrap a rotation error at 180 degrees.

    The axis of the shortest rotation changes its sign at 180 degrees, and the torque of
    a spring with it. Of the two rotation vectors of one rotation, the one nearer to the
    previous error is returned, if it is shorter than 270 degrees.

    Parameters
    ----------
    error : array, shape (6,)
        What `task_error` returned, rad and m; not changed.
    previous : array, shape (3,)
        Rotation of the error before, as returned here, rad.

    Returns
    -------
    array, shape (6,)
    """
    phi = error[:3]
    angle = norm(phi)
    # Below 90 degrees the shortest rotation is the nearer one; NaN returns here, too.
    if not angle > 0.5 * math.pi or dot(phi, previous) >= 0:
        return error
    other = (1 - 2 * math.pi / angle) * phi
    this_way, other_way = phi - previous, other - previous
    if norm(other_way) < norm(this_way):
        return stacked(other, error[3:])
    return error


@compiled
def blended(target: TaskTarget, X_TE: Pose, fraction: float, rate: float) -> TaskTarget:
    """Mix a pose at rest and a target: the pose at fraction 0, the target at 1.

    Parameters
    ----------
    target : TaskTarget
    X_TE : Pose
        The pose at rest.
    fraction, rate : float
        Blend of pose and target, and its derivative in 1/s.
    """
    error = task_error(X_TE, target.X)
    R = product(rotation_from_vector(fraction * error[:3]), X_TE.R)
    X = Pose(R, X_TE.p + fraction * error[3:])
    return TaskTarget(X, fraction * target.V + rate * error, fraction * target.A)


@compiled
def motion_in_world(
    target: TaskTarget, frame_twist: Array, frame_acceleration: Array
) -> TaskTarget:
    """Turn a motion relative to T into the motion relative to W, in T's axes.

    Parameters
    ----------
    target : TaskTarget
        Relative to T.
    frame_twist : array, shape (6,)
        V_WT of T's origin, in T's axes, rad/s and m/s.
    frame_acceleration : array, shape (6,)
        A_WT, its derivative in W, in T's axes, rad/s² and m/s².
    """
    w, alpha, p = frame_twist[:3], frame_acceleration[:3], target.X.p
    velocity = cross(w, p)
    V = stacked(np.zeros(3), velocity)
    A = stacked(
        cross(w, target.V[:3]), cross(alpha, p) + cross(w, velocity + 2 * target.V[3:])
    )
    return TaskTarget(
        target.X, target.V + frame_twist + V, target.A + frame_acceleration + A
    )
