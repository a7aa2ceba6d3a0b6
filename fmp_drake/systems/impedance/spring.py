"""The spring of the impedance law: its displacement, its clip and its wrench."""

import math

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.systems.impedance.algebra import (
    Pose,
    inverse_left_jacobian,
    rotation_vector,
    stacked,
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
    return stacked(rotation_vector(desired.R @ measured.R.T), desired.p - measured.p)


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
    other = (1 - 2 * math.pi / angle) * phi
    this_way, other_way = phi - previous, other - previous
    if other_way @ other_way < this_way @ this_way:
        return stacked(other, error[3:])
    return error


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
    wrench = stiffness @ stacked(
        shortened(rotation, max_rotation), shortened(translation, max_translation)
    )
    torque = inverse_left_jacobian(rotation, wrench[:3])
    return stacked(torque, wrench[3:]), clipped
