"""The operational-space impedance law, as functions of arrays.

The task frame T is fixed in the world; E is the end effector's frame. Twists,
wrenches and errors have six elements, rotation first, and are expressed in T.
With the arm's equation of motion ``M v̇ + C v = τ + Jᵀ F_ext`` (gravity is
compensated elsewhere) the law makes the end effector obey

    Λ (A_d − A) + D (V_d − V) + K e = −F_ff − F_ext,

where ``A_d``, ``V_d`` are the desired acceleration and twist, ``e`` the error,
``F_ff`` the wrench that the robot shall apply and ``Λ = (J M⁻¹ Jᵀ)⁻¹``.

References
----------
.. [1] O. Khatib, "A unified approach for motion and force control of robot
   manipulators: the operational space formulation", IEEE J. Robotics and
   Automation 3(1), 1987.
.. [2] A. Albu-Schäffer, C. Ott, U. Frese, G. Hirzinger, "Cartesian impedance
   control of redundant robots: recent results with the DLR-light-weight-arms",
   ICRA 2003 (double diagonalization).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from fmp_drake.errors import StationError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class ImpedanceGains:
    """Everything that the law needs besides the arm's state and the target.

    Parameters
    ----------
    stiffness : array, shape (6, 6)
        K, symmetric and positive definite: Nm/rad, N/m and, in the blocks that
        couple them, Nm/m = N/rad. Expressed in T. A copy is kept, read-only.
    damping_ratio : float
        ζ of every mode of the end effector.
    posture_frequency : float
        Natural frequency of the motion inside the nullspace, in rad/s: the
        posture's stiffness is ``M ω²``. Zero leaves damping out as well.
    posture_damping_ratio : float
        ζ of the motion inside the nullspace.
    max_rotation_error, max_translation_error, max_posture_error : float
        Lengths, in rad, m and rad, to which the errors are shortened before the
        stiffness sees them.
    max_effective_mass : float
        Largest eigenvalue of Λ that is used, in kg; rotations are made
        comparable by `characteristic_length`. It bounds Λ at singularities.
    characteristic_length : float
        The length in m that turns a rotation into a displacement.
    """

    stiffness: Array
    damping_ratio: float
    posture_frequency: float
    posture_damping_ratio: float
    max_rotation_error: float
    max_translation_error: float
    max_posture_error: float
    max_effective_mass: float
    characteristic_length: float

    def __post_init__(self) -> None:
        """Refuse a stiffness that is no spring, and keep a read-only copy."""
        K = np.array(self.stiffness, dtype=float)
        if K.shape != (6, 6) or not np.all(np.isfinite(K)):
            raise StationError(
                f"stiffness must be finite numbers of shape (6, 6), got shape "
                f"{K.shape}:\n{K}"
            )
        asymmetry = np.abs(K - K.T).max()
        smallest = np.linalg.eigvalsh(K)[0]
        if asymmetry > 1e-9 * np.abs(K).max() or smallest <= 0:
            raise StationError(
                "stiffness must be symmetric and positive definite, got smallest "
                f"eigenvalue {smallest:g} and asymmetry {asymmetry:g}"
            )
        K.setflags(write=False)
        object.__setattr__(self, "stiffness", K)


class ArmDynamics(NamedTuple):
    """The arm's equation of motion and task map at one state.

    Parameters
    ----------
    v : array, shape (n,)
        Joint velocities, rad/s.
    M : array, shape (n, n)
        Mass matrix, kg m².
    Cv : array, shape (n,)
        Coriolis and centrifugal torque, Nm.
    J : array, shape (6, n)
        Jacobian of E's twist: ``V = J v``, expressed in T.
    Jdot_v : array, shape (6,)
        Bias acceleration ``J̇ v``, rad/s² and m/s², expressed in T.
    """

    v: Array
    M: Array
    Cv: Array
    J: Array
    Jdot_v: Array


class TaskInertia(NamedTuple):
    """The operational-space inertia, factored: ``Λ = Wᵀ W`` and ``Λ⁻¹ = H Hᵀ``.

    Parameters
    ----------
    W, H : array, shape (6, 6)
        Inverse to each other; both map between T's axes and unit-mass axes.
    """

    W: Array
    H: Array


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
    error[:3] = rotation_vector(np.dot(R_TE_desired, R_TE.T))
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
    length = math.sqrt(np.dot(x, x))
    return x * (limit / length) if length > limit else x


def spring_wrench(gains: ImpedanceGains, error: Array) -> Array:
    """Compute the wrench of the spring between measured and desired pose.

    Where nothing is clipped it is the gradient of ``½ eᵀ K e``, so the spring
    gives back the work that was put in, however far it was turned.

    Parameters
    ----------
    gains : ImpedanceGains
        The stiffness and the clips.
    error : array, shape (6,)
        The rotation and translation left, rad and m, in T.

    Returns
    -------
    array, shape (6,)
        Torque and force on E, Nm and N, in T.
    """
    clipped = np.empty(6)
    clipped[:3] = shorten(error[:3], gains.max_rotation_error)
    clipped[3:] = shorten(error[3:], gains.max_translation_error)
    wrench: Array = np.dot(gains.stiffness, clipped)
    wrench[:3] = _unturn(error[:3].tolist(), wrench[:3].tolist())
    return wrench


def _unturn(phi: list[float], t: list[float]) -> tuple[float, float, float]:
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


def task_inertia(
    *, M: Array, J: Array, max_effective_mass: float, characteristic_length: float
) -> TaskInertia:
    """Compute the operational-space inertia Λ, bounded at singularities.

    ``J M⁻¹ Jᵀ`` is diagonalized with rotations scaled to displacements; its
    eigenvalues are raised to ``1 / max_effective_mass`` where they are smaller.
    Away from singularities the result is exact.

    Parameters
    ----------
    M : array, shape (n, n)
        Mass matrix, kg m².
    J : array, shape (6, n)
        Jacobian of E's twist, expressed in T.
    max_effective_mass : float
        Upper bound of Λ's eigenvalues, kg.
    characteristic_length : float
        Length that scales rotations, m.

    Returns
    -------
    TaskInertia
        Both factors of Λ.
    """
    scale = np.array((characteristic_length,) * 3 + (1.0,) * 3)
    factor, _ = lapack.dpotrf(M, lower=1)
    # Not dtrtrs: OpenBLAS starts threads for it, and waits milliseconds for them.
    Y = blas.dtrsm(1.0, factor, (scale[:, None] * J).T, lower=1)
    mobility, U, _ = lapack.dsyev(np.dot(Y.T, Y))
    root = np.sqrt(np.maximum(mobility, 1 / max_effective_mass))
    W = U.T * scale / root[:, None]
    H = U * root / scale[:, None]
    return TaskInertia(W, H)


def damping_modes(
    *, inertia: TaskInertia, stiffness: Array, damping_ratio: float
) -> tuple[Array, Array]:
    """Design the damping by double diagonalization of Λ and K [2]_.

    Parameters
    ----------
    inertia : TaskInertia
        Λ, factored.
    stiffness : array, shape (6, 6)
        K, symmetric positive definite, in T.
    damping_ratio : float
        ζ of every mode.

    Returns
    -------
    B : array, shape (6, 6)
        Mode shapes: ``B Bᵀ = Λ`` and ``B diag(ω²) Bᵀ = K``.
    d : array, shape (6,)
        ``2 ζ ω`` of each mode, 1/s; the damping matrix is ``D = B diag(d) Bᵀ``.
    """
    H = inertia.H
    squared, V, _ = lapack.dsyev(np.dot(H.T, np.dot(stiffness, H)))
    d = 2 * damping_ratio * np.sqrt(np.maximum(squared, 0.0))
    return np.dot(inertia.W.T, V), d


def impedance_torque(
    gains: ImpedanceGains,
    arm: ArmDynamics,
    *,
    error: Array,
    desired_twist: Array,
    desired_acceleration: Array,
    feedforward_wrench: Array,
    posture_error: Array,
) -> Array:
    """Compute the joint torque of the impedance law, without gravity, unlimited.

    ``τ = Jᵀ (Λ (A_d − J̇ v) + K e + D (V_d − J v) + F_ff) + C v + Nᵀ M a``
    where ``a = ω² (q_p − q) − 2 ζ ω v`` is the posture's acceleration and
    ``Nᵀ = I − Jᵀ Λ J M⁻¹`` the dynamically consistent projector [1]_.

    Parameters
    ----------
    gains : ImpedanceGains
        Stiffness, damping ratios and clips.
    arm : ArmDynamics
        The arm at its present state.
    error : array, shape (6,)
        What `task_error` returned, rad and m, in T.
    desired_twist : array, shape (6,)
        Desired twist of E in T, rad/s and m/s.
    desired_acceleration : array, shape (6,)
        Desired acceleration of E in T, rad/s² and m/s².
    feedforward_wrench : array, shape (6,)
        Torque and force that the robot shall apply at E, Nm and N, in T.
    posture_error : array, shape (n,)
        Desired posture minus joint positions, rad.

    Returns
    -------
    array, shape (n,)
        Joint torque, Nm.
    """
    v, M, Cv, J, Jdot_v = arm
    omega = gains.posture_frequency
    posture = (omega * omega) * shorten(posture_error, gains.max_posture_error)
    posture -= (2 * gains.posture_damping_ratio * omega) * v
    inertia = task_inertia(
        M=M,
        J=J,
        max_effective_mass=gains.max_effective_mass,
        characteristic_length=gains.characteristic_length,
    )
    B, d = damping_modes(
        inertia=inertia,
        stiffness=gains.stiffness,
        damping_ratio=gains.damping_ratio,
    )
    # Λ x + D y = B (Bᵀ x + d Bᵀ y); Nᵀ M a = M a − Jᵀ Λ J a.
    x = desired_acceleration - Jdot_v - np.dot(J, posture)
    y = desired_twist - np.dot(J, v)
    wrench = np.dot(B, np.dot(B.T, x) + d * np.dot(B.T, y))
    wrench += spring_wrench(gains, error)
    wrench += feedforward_wrench
    torque: Array = np.dot(J.T, wrench)
    torque += np.dot(M, posture)
    torque += Cv
    return torque


def limit_torque(torque: Array, *, lower: Array, upper: Array) -> Array:
    """Scale a torque into the box of limits, keeping its direction.

    Parameters
    ----------
    torque : array, shape (n,)
        Joint torque, Nm.
    lower, upper : array, shape (n,)
        Limits, ``lower < 0 < upper``, Nm; infinite where there is none.

    Returns
    -------
    array, shape (n,)
        Limited joint torque, Nm.
    """
    excess = max((torque / upper).max(), (torque / lower).max())
    return torque / excess if excess > 1 else torque


def limit_torque_rate(torque: Array, *, previous: Array, max_change: float) -> Array:
    """Scale the change since the previous torque, keeping its direction.

    Parameters
    ----------
    torque, previous : array, shape (n,)
        Wanted and previous joint torque, Nm.
    max_change : float
        Greatest change of any joint, Nm.

    Returns
    -------
    array, shape (n,)
        Limited joint torque, Nm.
    """
    change = torque - previous
    largest = np.abs(change).max()
    return (
        previous + change * (max_change / largest) if largest > max_change else torque
    )
