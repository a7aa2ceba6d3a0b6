"""Operational-space impedance law, in functions of arrays.

E is the end effector's frame, T the task frame, which may rotate. Twists and wrenches
are those of E in the world. Like the errors they have six elements, rotation first,
expressed in the current axes of T.
With the arm's equation of motion ``M v̇ + C v = τ + Jᵀ F_ext`` (gravity is
compensated elsewhere) the closed loop of the end effector is

    Λ (A_d − A) + D (V_d − V) + K e = −F_ff − F_ext,

where ``A_d``, ``V_d`` are the desired acceleration and twist, ``e`` the error,
``F_ff`` the feed-forward wrench and ``Λ = (J M⁻¹ Jᵀ)⁻¹`` the operational-space inertia.

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
from typing import NamedTuple

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array
from fmp_drake.systems.impedance.algebra import (
    TaskTarget,
    applied,
    cholesky,
    dot,
    eigen,
    inverse_left_jacobian,
    largest,
    norm,
    product,
    solve_lower,
    stacked,
)
from fmp_drake.systems.impedance.config import ImpedanceConfig

# Time constant with which a stopped tool's motion along the normal comes to rest, s.
_DAMPING_TIME = 0.01


class ArmDynamics(NamedTuple):
    """Equation of motion and task Jacobian of the arm at one state.

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


@compiled
def re_expressed(arm: ArmDynamics, rotation: Array) -> ArmDynamics:
    """Express Jacobian and bias acceleration in another frame, by a matrix (6, 6)."""
    return ArmDynamics(
        arm.v,
        arm.M,
        arm.Cv,
        product(rotation, arm.J),
        applied(rotation, arm.Jdot_v),
    )


class LawTorque(NamedTuple):
    """Result of the impedance law: the torque and its parts.

    Parameters
    ----------
    torque : array, shape (n,)
        Joint torque without gravity, not limited, Nm; NaN where the mass matrix is
        not positive definite.
    dissipation : float
        Power that the task's damping dissipates, W.
    normal_force : float
        Of spring, damping and feed-forward along −z of T, N.
    clipped : bool
        Whether an error was clipped.
    near_singular : bool
        Whether the inertia was bounded.
    """

    torque: Array
    dissipation: float
    normal_force: float
    clipped: bool
    near_singular: bool


class TaskModes(NamedTuple):
    """Modes of the end effector's motion, by double diagonalization [2]_.

    Parameters
    ----------
    B : array, shape (6, 6)
        Mode shapes: ``B Bᵀ = Λ`` and ``B diag(ω²) Bᵀ = K``.
    omega : array, shape (6,)
        Natural frequencies, rad/s; the damping matrix is ``D = B diag(2 ζ ω) Bᵀ``.
    bounded : bool
        Whether Λ was bounded because the arm is near a singularity.
    """

    B: Array
    omega: Array
    bounded: bool


@compiled
def mobility(M: Array, J: Array) -> Array:
    """Return ``Λ⁻¹ = J M⁻¹ Jᵀ``, shape (6, 6); NaN where M is not positive definite."""
    L, positive = cholesky(M)
    if not positive:
        L[0, 0] = math.nan
    Y = solve_lower(L, J.T)
    return product(Y.T, Y)


@compiled
def task_modes(
    mobility: Array,
    stiffness: Array,
    max_effective_mass: float,
    characteristic_length: float,
) -> TaskModes:
    """Diagonalize the operational-space inertia Λ and the stiffness K simultaneously.

    With ``K = L Lᵀ`` and ``Lᵀ Λ⁻¹ L = V diag(ω²) Vᵀ`` the modes are
    ``B = L V diag(1/ω)``. Near singularities Λ is unbounded. There the eigenvalues of
    ``Λ⁻¹``, with rotations scaled to displacements, are first raised to
    ``1 / max_effective_mass``.

    Parameters
    ----------
    mobility : array, shape (6, 6)
        Λ⁻¹, expressed in T, finite.
    stiffness : array, shape (6, 6)
        K, symmetric positive definite, in T.
    max_effective_mass : float
        Upper bound of Λ's eigenvalues, kg.
    characteristic_length : float
        Length that scales rotations, m.

    Returns
    -------
    TaskModes
    """
    length = characteristic_length
    scale = np.array((length, length, length, 1.0, 1.0, 1.0))
    L, _ = cholesky(stiffness)
    squared, V = eigen(product(L.T, product(mobility, L)))
    if squared[0] > 0:
        omega = np.sqrt(squared)
        B = product(L, V) / omega
        # The trace of the scaled Λ is more than its largest eigenvalue.
        trace = 0.0
        for i in range(6):
            for j in range(6):
                trace += (B[i, j] / scale[i]) ** 2
        if trace < max_effective_mass:
            return TaskModes(B, omega, False)
    scaled, W, H = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            scaled[i, j] = scale[i] * mobility[i, j] * scale[j]
    values, U = eigen(scaled)
    # Λ = W Wᵀ and Λ⁻¹ = H Hᵀ.
    for j in range(6):
        root = math.sqrt(max(values[j], 1 / max_effective_mass))
        for i in range(6):
            W[i, j] = U[i, j] / root * scale[i]
            H[i, j] = U[i, j] * root / scale[i]
    squared, V = eigen(product(H.T, product(stiffness, H)))
    omega = np.sqrt(np.maximum(squared, 0.0))
    return TaskModes(product(W, V), omega, values[0] * max_effective_mass < 1)


@compiled
def length_clipped(x: Array, limit: float) -> Array:
    """Return a vector of the same direction whose length is clipped to a limit."""
    return x * (limit / max(norm(x), limit))


@compiled
def spring_wrench(
    stiffness: Array, error: Array, max_rotation: float, max_translation: float
) -> tuple[Array, bool]:
    """Compute the wrench of the spring between measured and desired pose.

    Without clipping it is the gradient of ``½ eᵀ K e``: the spring is conservative for
    rotations of any size.

    Parameters
    ----------
    stiffness : array, shape (6, 6)
        K, in T.
    error : array, shape (6,)
        Rotation and translation from the measured to the desired pose, rad and m, in T.
    max_rotation, max_translation : float
        Limits of the lengths of the two halves of the error, rad and m.

    Returns
    -------
    wrench : array, shape (6,)
        Torque and force on E, Nm and N, in T.
    clipped : bool
        Whether the error was clipped.
    """
    rotation, translation = error[:3], error[3:]
    clipped = norm(rotation) > max_rotation or norm(translation) > max_translation
    wrench = applied(
        stiffness,
        stacked(
            length_clipped(rotation, max_rotation),
            length_clipped(translation, max_translation),
        ),
    )
    torque = inverse_left_jacobian(rotation, wrench[:3])
    return stacked(torque, wrench[3:]), clipped


@compiled
def normal_speed(arm: ArmDynamics, position: Array, frame_twist: Array) -> float:
    """Return the tool's speed relative to T, along z of T, m/s.

    Parameters
    ----------
    arm : ArmDynamics
        Expressed in T.
    position : array, shape (3,)
        p_TE, m.
    frame_twist : array, shape (6,)
        Twist of T in its own axes, rad/s and m/s.
    """
    w, p = frame_twist, position
    return dot(arm.J[5], arm.v) - w[5] - (w[0] * p[1] - w[1] * p[0])


@compiled
def normal_damping(
    config: ImpedanceConfig, arm: ArmDynamics, position: Array, frame_twist: Array
) -> float:
    """Return the force against the motion along z of T that stops the tool in 10 ms, N.

    It is ``m v / t``, with the effective mass of the tool along z and `normal_speed`.
    Parameters are those of `normal_speed`.
    """
    inverse_mass = mobility(arm.M, arm.J)[5, 5]
    mass = 1 / max(inverse_mass, 1 / config.max_effective_mass)
    return mass / _DAMPING_TIME * normal_speed(arm, position, frame_twist)


@compiled
def without_normal_feedforward(target: TaskTarget, fraction: float) -> TaskTarget:
    """Fade out the feed-forward of the motion along T's z, where a normal force acts.

    A tool in contact moves with the surface. The inertia and damping of another motion
    would act against the normal force.
    """
    V, A = target.V.copy(), target.A.copy()
    V[5] *= 1 - fraction
    A[5] *= 1 - fraction
    return TaskTarget(target.X, V, A)


@compiled
def impedance_law(
    config: ImpedanceConfig,
    arm: ArmDynamics,
    stiffness: Array,
    error: Array,
    desired_twist: Array,
    desired_acceleration: Array,
    feedforward_wrench: Array,
    posture_error: Array,
) -> LawTorque:
    """Compute the joint torque of the impedance law, without gravity and limits.

    ``τ = Jᵀ (Λ (A_d − J̇ v) + K e + D (V_d − J v) + F_ff) + C v + Nᵀ M a``
    where ``a = ω² (q_p − q) − 2 ζ ω v`` is the posture's acceleration and
    ``Nᵀ = I − Jᵀ Λ J M⁻¹`` the dynamically consistent projector [1]_.

    Parameters
    ----------
    config : ImpedanceConfig
        Damping ratios, posture frequency and clips, as `values_of` returns them.
    arm : ArmDynamics
        Of the current state.
    stiffness : array, shape (6, 6)
        K, symmetric and positive definite, in T.
    error : array, shape (6,)
        Of `task_error`, rad and m, in T.
    desired_twist : array, shape (6,)
        Desired twist of E in T, rad/s and m/s.
    desired_acceleration : array, shape (6,)
        Desired acceleration of E in T, rad/s² and m/s².
    feedforward_wrench : array, shape (6,)
        Torque and force to be applied at E, Nm and N, in T.
    posture_error : array, shape (n,)
        Desired posture minus joint positions, rad.

    Returns
    -------
    LawTorque
    """
    inverse_inertia = mobility(arm.M, arm.J)
    if not math.isfinite(largest(inverse_inertia)):
        return LawTorque(math.nan * arm.v, 0.0, 0.0, False, False)
    B, omega, bounded = task_modes(
        inverse_inertia,
        stiffness,
        config.max_effective_mass,
        config.characteristic_length,
    )
    posture = config.posture_frequency**2 * length_clipped(
        posture_error, config.max_posture_error
    )
    posture -= 2 * config.posture_damping_ratio * config.posture_frequency * arm.v
    # Jᵀ (Λ x + D y) = (Bᵀ J)ᵀ (Bᵀ x + d Bᵀ y); Nᵀ M a = M a − Jᵀ Λ J a.
    BJ = product(B.T, arm.J)
    y = applied(B.T, desired_twist) - applied(BJ, arm.v)
    damping = 2 * config.damping_ratio * omega * y
    x = applied(B.T, desired_acceleration - arm.Jdot_v) - applied(BJ, posture)
    spring, clipped = spring_wrench(
        stiffness, error, config.max_rotation_error, config.max_translation_error
    )
    wrench = spring + feedforward_wrench
    torque = applied(BJ.T, x + damping) + applied(arm.J.T, wrench)
    torque += applied(arm.M, posture) + arm.Cv
    normal_force = -float(wrench[5] + dot(B[5], damping))
    return LawTorque(torque, dot(y, damping), normal_force, clipped, bounded)
