"""Targets of the end effector: blended with a pose, and in a frame that moves."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.systems.impedance.algebra import (
    Pose,
    cross,
    rotation_from_vector,
    stacked,
)
from fmp_drake.systems.impedance.spring import task_error

Array = NDArray[np.float64]


class TaskTarget(NamedTuple):
    """Where the end effector shall be, and how it shall move.

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
def blended(target: TaskTarget, X_TE: Pose, fraction: float, rate: float) -> TaskTarget:
    """Mix a pose at rest and a target: the pose at fraction 0, the target at 1.

    Parameters
    ----------
    target : TaskTarget
    X_TE : Pose
        The pose at rest.
    fraction, rate : float
        How much of the target is followed, and its derivative in 1/s.
    """
    way = task_error(X_TE, target.X)
    X = Pose(
        rotation_from_vector(fraction * way[:3]) @ X_TE.R, X_TE.p + fraction * way[3:]
    )
    return TaskTarget(X, fraction * target.V + rate * way, fraction * target.A)


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
