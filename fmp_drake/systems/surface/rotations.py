"""Rotation vectors and their derivatives, for compiled functions.

Source: J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in
robotics", arXiv:1812.01537 (exponential and left Jacobian of SO(3)).
"""

import math

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled

Array = NDArray[np.float64]


@compiled
def cross(a: Array, b: Array) -> Array:
    """Return ``a × b``, shape (3,)."""
    return np.array(
        (
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        )
    )


@compiled
def coefficients(phi: Array) -> tuple[float, float, float, float]:
    """Return the coefficients of the left Jacobian and their derivatives.

    With a = |phi| they are b = (1 - cos a)/a², c = (a - sin a)/a³, (db/da)/a and (dc/da)/a;
    below 0.01 rad their power series.

    Parameters
    ----------
    phi : array, shape (3,)
        rad.
    """
    s = float(phi @ phi)
    if s < 1e-4:
        return (
            1 / 2 - s / 24 + s * s / 720,
            1 / 6 - s / 120 + s * s / 5040,
            -1 / 12 + s / 180 - s * s / 6720,
            -1 / 60 + s / 1260 - s * s / 60480,
        )
    a = math.sqrt(s)
    b = 2 * math.sin(a / 2) ** 2 / s
    c = (a - math.sin(a)) / (a * s)
    return b, c, (math.sin(a) / a - 2 * b) / s, (b - 3 * c) / s


@compiled
def rotation_matrix(phi: Array) -> Array:
    """Return exp([phi]x), shape (3, 3), of a rotation vector, rad."""
    b, _, _, _ = coefficients(phi)
    s = phi @ phi
    a = math.sqrt(s)
    sinc = math.sin(a) / a if a > 1e-4 else 1 - s / 6
    x, y, z = phi
    K = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.eye(3) + sinc * K + b * (K @ K)


@compiled
def quaternion(phi: Array) -> Array:
    """Return the unit quaternion (w, x, y, z) of a rotation vector, rad."""
    half = 0.5 * math.sqrt(phi @ phi)
    sinc = 0.5 * math.sin(half) / half if half > 1e-8 else 0.5
    return np.array((math.cos(half), sinc * phi[0], sinc * phi[1], sinc * phi[2]))


@compiled
def quaternion_product(p: Array, q: Array) -> Array:
    """Return the Hamilton product of two quaternions (w, x, y, z)."""
    return np.array(
        (
            p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
            p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
            p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
            p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
        )
    )


@compiled
def angular_motion(phi: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
    """Return angular velocity and acceleration of exp([phi]x), in the fixed frame.

    Parameters
    ----------
    phi, rate, acceleration : array, shape (3,)
        Rotation vector and its time derivatives: rad, rad/s, rad/s².

    Returns
    -------
    omega, alpha : array, shape (3,)
        rad/s and rad/s².
    """
    b, c, b_derivative, c_derivative = coefficients(phi)
    first = cross(phi, rate)
    second = cross(phi, first)
    omega = rate + b * first + c * second
    along = phi @ rate
    onward = cross(phi, acceleration)
    alpha = acceleration + b * onward + c * cross(phi, onward)
    alpha += along * (b_derivative * first + c_derivative * second)
    return omega, alpha + c * cross(rate, first)
