"""The operational-space impedance law, as functions of arrays.

E is the end effector's frame, T the task frame, whose axes may turn. Twists and
wrenches are those of E in the world; like the errors they have six elements,
rotation first, and are expressed in T's present axes.
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
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from fmp_drake.systems.impedance.gains import ImpedanceGains
from fmp_drake.systems.impedance.spring import spring_wrench

Array = NDArray[np.float64]


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


class LawTorque(NamedTuple):
    """What the law commands, and what it tells of itself.

    Parameters
    ----------
    torque : array, shape (n,)
        Joint torque without gravity, not limited, Nm.
    dissipation : float
        Power that the task's damping takes out of the motion, W.
    clipped : bool
        Whether an error was shortened.
    near_singular : bool
        Whether the inertia was bounded.
    modes : array, shape (6, 6)
        B: ``Λ = B Bᵀ``, ``D = B diag(d) Bᵀ``.
    modal_damping : array, shape (6,)
        d, 1/s.
    modal_jacobian : array, shape (6, n)
        ``Bᵀ J``.
    posture_share : float
        By how much the posture's error was shortened, in (0, 1].
    """

    torque: Array
    dissipation: float
    clipped: bool
    near_singular: bool
    modes: Array
    modal_damping: Array
    modal_jacobian: Array
    posture_share: float


class TaskInertia(NamedTuple):
    """The operational-space inertia, factored: ``Λ = Wᵀ W`` and ``Λ⁻¹ = H Hᵀ``.

    Parameters
    ----------
    W, H : array, shape (6, 6)
        Inverse to each other; both map between T's axes and unit-mass axes.
    bounded : bool
        Whether an eigenvalue was bounded.
    """

    W: Array
    H: Array
    bounded: bool


def task_inertia(
    *, M: Array, J: Array, max_effective_mass: float, characteristic_length: float
) -> TaskInertia:
    """Compute the operational-space inertia Λ, bounded at singularities.

    The eigenvalues of ``J M⁻¹ Jᵀ``, with rotations scaled to displacements, are
    raised to ``1 / max_effective_mass`` where they are smaller.

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
    scale = _scale(characteristic_length)
    values, U, _ = lapack.dsyev(_mobility(M, scale[:, None] * J))
    root = np.sqrt(np.maximum(values, 1 / max_effective_mass))
    W = U.T * scale / root[:, None]
    H = U * root / scale[:, None]
    return TaskInertia(W, H, bool(values[0] * max_effective_mass < 1))


def _mobility(M: Array, J: Array) -> Array:
    """Return ``J M⁻¹ Jᵀ``."""
    factor, _ = lapack.dpotrf(M, lower=1)
    # Not dtrtrs: OpenBLAS starts threads for it, and waits milliseconds for them.
    Y: Array = blas.dtrsm(1.0, factor, J.T, lower=1)
    return Y.T.dot(Y)


@cache
def _scale(characteristic_length: float) -> Array:
    """Return what turns twists into velocities."""
    scale = np.array((characteristic_length,) * 3 + (1.0,) * 3)
    scale.setflags(write=False)
    return scale


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
    squared, V, _ = lapack.dsyev(H.T.dot(stiffness.dot(H)))
    d = 2 * damping_ratio * np.sqrt(np.maximum(squared, 0.0))
    return inertia.W.T.dot(V), d


def task_modes(
    gains: ImpedanceGains, *, M: Array, J: Array, stiffness: Array
) -> tuple[Array, Array, bool]:
    """Return B and d as `damping_modes` does, and whether the inertia was bounded.

    Away from singularities one generalized eigenvalue problem does: ``K Λ⁻¹ b = ω² b``
    with ``Bᵀ Λ⁻¹ B = 1``.
    """
    squared, B, info = lapack.dsygv(stiffness, _mobility(M, J), itype=2)
    if info == 0:
        scaled = B / _scale(gains.characteristic_length)[:, None]
        # The trace of the scaled Λ is more than its largest eigenvalue.
        if np.vdot(scaled, scaled) < gains.max_effective_mass:
            return B, 2 * gains.damping_ratio * np.sqrt(np.maximum(squared, 0)), False
    inertia = task_inertia(
        M=M,
        J=J,
        max_effective_mass=gains.max_effective_mass,
        characteristic_length=gains.characteristic_length,
    )
    B, d = damping_modes(
        inertia=inertia, stiffness=stiffness, damping_ratio=gains.damping_ratio
    )
    return B, d, inertia.bounded


def impedance_law(
    gains: ImpedanceGains,
    arm: ArmDynamics,
    *,
    error: Array,
    desired_twist: Array,
    desired_acceleration: Array,
    feedforward_wrench: Array,
    posture_error: Array,
    stiffness: Array | None = None,
) -> LawTorque:
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
    stiffness : array, shape (6, 6), optional
        In place of the gains' own; symmetric and positive definite.

    Returns
    -------
    LawTorque
    """
    v, M, Cv, J, Jdot_v = arm
    K = gains.stiffness if stiffness is None else stiffness
    omega = gains.posture_frequency
    length = math.sqrt(posture_error.dot(posture_error))
    share = gains.max_posture_error / max(length, gains.max_posture_error)
    posture = (omega * omega * share) * posture_error
    posture -= (2 * gains.posture_damping_ratio * omega) * v
    B, d, bounded = task_modes(gains, M=M, J=J, stiffness=K)
    # Jᵀ (Λ x + D y) = (Bᵀ J)ᵀ (Bᵀ x + d Bᵀ y); Nᵀ M a = M a − Jᵀ Λ J a.
    BJ = B.T.dot(J)
    y = B.T.dot(desired_twist) - BJ.dot(v)
    damping = d * y
    x = B.T.dot(desired_acceleration - Jdot_v) - BJ.dot(posture)
    spring, clipped = spring_wrench(gains, error, stiffness=K)
    torque: Array = BJ.T.dot(x + damping)
    torque += J.T.dot(spring + feedforward_wrench)
    torque += M.dot(posture)
    torque += Cv
    dissipation = float(y.dot(damping))
    return LawTorque(torque, dissipation, clipped, bounded, B, d, BJ, share)
