"""The spring of the impedance law, with its clip."""

import math

import numpy as np
from numpy.typing import NDArray

from fmp_drake.systems.impedance.error import shorten
from fmp_drake.systems.impedance.gains import ImpedanceGains

Array = NDArray[np.float64]


def spring_wrench(
    gains: ImpedanceGains, error: Array, *, stiffness: Array | None = None
) -> tuple[Array, bool]:
    """Compute the wrench of the spring between measured and desired pose.

    Where nothing is clipped it is the gradient of ``½ eᵀ K e``, so the spring
    gives back the work that was put in, however far it was turned.

    Parameters
    ----------
    gains : ImpedanceGains
        The stiffness and the clips.
    error : array, shape (6,)
        The rotation and translation left, rad and m, in T.
    stiffness : array, shape (6, 6), optional
        In place of the gains' own.

    Returns
    -------
    wrench : array, shape (6,)
        Torque and force on E, Nm and N, in T.
    clipped : bool
        Whether the error was shortened.
    """
    K = gains.stiffness if stiffness is None else stiffness
    a, b, c, x, y, z = error.tolist()
    clipped = (
        a * a + b * b + c * c > gains.max_rotation_error**2
        or x * x + y * y + z * z > gains.max_translation_error**2
    )
    seen = error
    if clipped:
        seen = np.concatenate(
            (
                shorten(error[:3], gains.max_rotation_error),
                shorten(error[3:], gains.max_translation_error),
            )
        )
    wrench: Array = K.dot(seen)
    wrench[:3] = _unturn((a, b, c), wrench[:3].tolist())
    return wrench, clipped


def _unturn(
    phi: tuple[float, float, float], t: list[float]
) -> tuple[float, float, float]:
    """Multiply by the inverse left Jacobian of SO(3) at `phi`.

    ``t − ½ φ × t + c φ × (φ × t)`` with ``c = 1/θ² − cot(θ/2) / (2 θ)``: it maps
    a gradient with respect to the rotation vector to a torque.
    """
    x, y, z = phi
    theta2 = x * x + y * y + z * z
    if theta2 > 1e-4:
        theta = math.sqrt(theta2)
        c = 1 / theta2 - 0.5 / (theta * math.tan(0.5 * theta))
    else:
        c = 1 / 12 + theta2 / 720
    a, b, d = t
    u0, u1, u2 = y * d - z * b, z * a - x * d, x * b - y * a
    return (
        a - 0.5 * u0 + c * (y * u2 - z * u1),
        b - 0.5 * u1 + c * (z * u0 - x * u2),
        d - 0.5 * u2 + c * (x * u1 - y * u0),
    )
