"""The displacement between two poses, as six numbers."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_vector(R: Array) -> Array:
    """Compute the logarithm of a rotation, accurate at 0 and at 180 degrees.

    Parameters
    ----------
    R : array, shape (3, 3)
        A rotation matrix.

    Returns
    -------
    array, shape (3,)
        Axis times angle in rad, the angle in [0, π].

    Notes
    -----
    The quaternion is read from its largest element (Shepperd, "Quaternion from
    rotation matrix", J. Guidance and Control 1(3), 1978), up to a factor that
    `atan2` does not see. At 180 degrees either axis is right; one is returned.
    """
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    largest = max(a + e + i, a, e, i)
    if largest == a + e + i:
        w, x, y, z = 1 + a + e + i, h - f, c - g, d - b
    elif largest == a:
        w, x, y, z = h - f, 1 + a - e - i, b + d, c + g
    elif largest == e:
        w, x, y, z = c - g, b + d, 1 - a + e - i, f + h
    else:
        w, x, y, z = d - b, c + g, f + h, 1 - a - e + i
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2 * math.atan2(sine, w) / sine if sine > 0 else 0.0
    return np.array((scale * x, scale * y, scale * z))


def task_error(
    *, R_TE: Array, p_TE: Array, R_TE_desired: Array, p_TE_desired: Array
) -> Array:
    """Compute the displacement that is left from the measured to the desired pose.

    Parameters
    ----------
    R_TE, R_TE_desired : array, shape (3, 3)
        Measured and desired orientation of E in T.
    p_TE, p_TE_desired : array, shape (3,)
        Measured and desired position of E's origin in T, m.

    Returns
    -------
    array, shape (6,)
        ``(log(R_TE_desired R_TEᵀ), p_TE_desired − p_TE)``: rad and m, in T.
    """
    error = np.empty(6)
    error[:3] = rotation_vector(R_TE_desired.dot(R_TE.T))
    error[3:] = p_TE_desired - p_TE
    return error


def shorten(x: Array, limit: float) -> Array:
    """Shorten a vector to a length at most, keeping its direction.

    Parameters
    ----------
    x : array, shape (k,)
        Any vector.
    limit : float
        The greatest length, in the unit of `x`.

    Returns
    -------
    array, shape (k,)
        `x` itself where it is short enough.
    """
    length = math.sqrt(x.dot(x))
    return x * (limit / length) if length > limit else x


def continued(error: Array, previous: Array) -> Array:
    """Carry an error through 180 degrees: go on turning the way it turned before.

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
    x, y, z = error[:3].tolist()
    squared = x * x + y * y + z * z
    # Up to 90 degrees nothing but the shortest way is near; NaN ends here as well.
    if not squared > 0.25 * math.pi**2:
        return error
    a, b, c = previous.tolist()
    if x * a + y * b + z * c >= 0:
        return error
    angle = math.sqrt(squared)
    other = error.copy()
    other[:3] *= 1 - 2 * math.pi / angle
    near = np.linalg.norm(other[:3] - previous) < np.linalg.norm(error[:3] - previous)
    return other if near and 2 * math.pi - angle < 1.5 * math.pi else error
