"""The spring of the impedance law: its displacement, its clip and its wrench."""

import math

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.systems.impedance.poses import (
    Pose,
    inverse_left_jacobian,
    rotation_vector,
)

Array = NDArray[np.float64]


@compiled
def task_error(measured: Pose, desired: Pose) -> Array:
    """Compute the displacement that is left from the measured to the desired pose.

    Parameters
    ----------
    measured, desired : Pose
        X_TE as it is and as it shall be.

    Returns
    -------
    array, shape (6,)
        ``(log(R_TE_desired R_TEᵀ), p_TE_desired − p_TE)``: rad and m, in T.
    """
    error = np.empty(6)
    error[:3] = rotation_vector(desired.R @ measured.R.T)
    error[3:] = desired.p - measured.p
    return error


@compiled
def unwrapped(error: Array, previous: Array) -> Array:
    """Let an error go on through 180 degrees in the way it rotated before.

    The shortest rotation changes its axis from one side to the other at 180
    degrees, and a spring would pull the other way at once. Of the two ways round,
    the one nearer to the previous error is taken, as long as it is shorter than 270
    degrees.

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
    angle = math.sqrt(phi @ phi)
    # Up to 90 degrees nothing but the shortest way is near; NaN ends here as well.
    if not angle > 0.5 * math.pi or phi @ previous >= 0:
        return error
    other = error.copy()
    other[:3] *= 1 - 2 * math.pi / angle
    near = np.linalg.norm(other[:3] - previous) < np.linalg.norm(phi - previous)
    return other if near and 2 * math.pi - angle < 1.5 * math.pi else error


@compiled
def shortened(x: Array, limit: float) -> Array:
    """Return a copy of a vector, shortened to a length at most in its direction."""
    return x * (limit / max(math.sqrt(x @ x), limit))


@compiled
def spring_wrench(
    stiffness: Array, error: Array, max_rotation: float, max_translation: float
) -> tuple[Array, bool]:
    """Compute the wrench of the spring between measured and desired pose.

    Where nothing is clipped it is the gradient of ``½ eᵀ K e``, so the spring
    gives back the work that was put in, however far it was rotated.

    Parameters
    ----------
    stiffness : array, shape (6, 6)
        K, in T.
    error : array, shape (6,)
        The rotation and translation left, rad and m, in T.
    max_rotation, max_translation : float
        Lengths to which the halves of the error are shortened, rad and m.

    Returns
    -------
    wrench : array, shape (6,)
        Torque and force on E, Nm and N, in T.
    clipped : bool
        Whether the error was shortened.
    """
    rotation, translation = error[:3], error[3:]
    clipped = (
        math.sqrt(rotation @ rotation) > max_rotation
        or math.sqrt(translation @ translation) > max_translation
    )
    seen = np.empty(6)
    seen[:3] = shortened(rotation, max_rotation)
    seen[3:] = shortened(translation, max_translation)
    wrench = stiffness @ seen
    wrench[:3] = inverse_left_jacobian(rotation, wrench[:3])
    return wrench, clipped
