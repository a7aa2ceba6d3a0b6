"""Prediction of deviations: of braked or damped joints, near singularities, by pushes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fmp_drake.numeric import Array, Mask
from fmp_drake.station.reach.tracking_prediction import (
    FeltContact,
    PredictedMotion,
    shortened,
    times,
)
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.impedance.force_control import approach_factor
from fmp_drake.systems.impedance.joints import JointLimits, JointWallConfig
from fmp_drake.systems.impedance.records import values_of
from fmp_drake.systems.scripted_disturbances import Disturbance

# Iterations of the set of braked joints at a sample, and of the contact.
_ITERATIONS = 3
# Smallest mobility, 1/kg; it is zero at singularities. Limit of a joint without limits, rad.
_LEAST, _FAR = 1e-9, 1e9
# Of a push: step of the integration, s, and precision of a normal force, N.
_STEP, _PRECISION = 0.002, 0.1


class Deviation(NamedTuple):
    """Deviation of B paths of T samples from their predicted motion.

    Attributes
    ----------
    pose : array, shape (B, T, 6)
        From the actual to the predicted pose, in the board's axes: rotation in rad, then
        translation in m.
    force : array, shape (B, T)
        Actual minus desired normal force, N. The board cannot pull: where it is less than
        minus the desired force, contact is lost.
    hindrance : str
        What keeps the arm from following the motion, in words; empty where nothing does.
    """

    pose: Array
    force: Array
    hindrance: str = ""


def predict_deviation(
    config: ImpedanceConfig,
    limits: JointLimits,
    motion: PredictedMotion,
    contact: FeltContact,
    *,
    q_posture: Array,
    step: float,
    joint_damping: Array | float = 0.0,
) -> Deviation:
    """Predict pose and normal force where the law cannot follow the motion.

    The deviations δ, predicted minus actual positions of the joints, obey the closed loop,
    ``M δ̈ + (Jᵀ D J + 2 ζ ω N) δ̇ + (Jᵀ K J + ω² N) δ = τ + N (q̈ − a)`` with
    ``N = M − Jᵀ Λ J``. τ is the torque of `wall_torque` that brakes a joint above its
    allowed speed and keeps it out of its limits, and of the damping of the joints. Near a
    singularity the law bounds Λ and accelerates the eraser too little, which is the term
    N (q̈ − a): q is the predicted motion, and a the acceleration of the posture. The same
    holds where other joints should compensate for one at its limit. K contains the felt
    along the normal, as long as there is contact. It is integrated by one implicit Euler
    step per sample. The controller of the normal force reduces the error, if enabled, and
    is assumed to keep the contact.

    Parameters
    ----------
    config : ImpedanceConfig
    limits : JointLimits
    motion : PredictedMotion
        B paths of T samples on a board.
    contact : FeltContact
    q_posture : array, shape (n,)
        The controller's posture, rad.
    step : float
        Time from sample to sample, s.
    joint_damping : array, shape (n,), or float
        Viscous damping of the joints, for which nothing compensates, Nm s/rad.
    """
    shape, walls = motion.q.shape[:2], config.walls
    deviation = Deviation(np.zeros((*shape, 6)), np.zeros(shape))
    slowest, fastest = _allowed_speeds(walls, limits, motion.q)
    is_braked = (motion.v < slowest) | (motion.v > fastest)
    # As in `task_modes`: the trace of the scaled Λ is more than its largest eigenvalue.
    scale = _scale(config)
    mobility = motion.J @ np.linalg.solve(motion.M, motion.J.mT) * scale * scale.T
    inertia = np.trace(np.linalg.inv(mobility + _LEAST * np.eye(6)), axis1=-2, axis2=-1)
    x = motion.q - limits.middle
    edge = np.minimum(limits.half_range, _FAR) - walls.width
    at_wall = np.abs(x) >= edge - 1e-6
    is_singular = inertia > config.max_effective_mass
    is_hindered = np.any(is_braked | at_wall, axis=-1) | is_singular
    paths = np.any(is_hindered, axis=1) | np.any(joint_damping)
    if not np.any(paths):
        return deviation
    deviation = deviation._replace(
        hindrance=_hindrance(is_braked, at_wall, is_singular)
    )
    M, J, v, q = motion.M[paths], motion.J[paths], motion.v[paths], motion.q[paths]
    x, slowest, fastest = x[paths], slowest[paths], fastest[paths]
    damping, stiffness, N = _closed_loop(config, M, J, mobility[paths])
    missing = np.gradient(v, step, axis=1) - _posture(config, q_posture - q, v)
    missing = times(N, missing) + joint_damping * v
    damping = damping + np.eye(v.shape[-1]) * joint_damping
    brake = np.diagonal(M, axis1=-2, axis2=-1) / walls.braking_time
    # As in `wall_torque`: at its end a spring has twice the strength of the motor.
    strength = np.minimum(limits.upper_effort, -limits.lower_effort)
    critical = brake * walls.width / (8 * walls.braking_time)
    spring = np.where(np.isfinite(strength), strength, critical) * 2 / walls.width
    keeps_contact = config.force_control.enabled
    delta, speed = np.zeros((2, *v[:, 0].shape))
    is_closed = np.ones(len(v), dtype=bool)
    forces, poses = [], []
    for k in range(v.shape[1]):
        inertia, viscous = M[:, k] / step**2, damping[:, k] / step
        A = inertia + viscous + stiffness[:, k]
        b = times(inertia, delta + step * speed) + times(viscous, delta) + missing[:, k]
        normal = J[:, k, 5]
        felt = contact.stiffness * normal[..., None] * normal[:, None]
        before = delta
        for _ in range(_ITERATIONS):
            actual = v[:, k] - speed
            allowed = np.clip(actual, slowest[:, k], fastest[:, k])
            braked = np.where(allowed != actual, brake[:, k], 0.0)
            torque = braked * (v[:, k] - allowed + before / step)
            torque += np.where(is_closed, 0.0, contact.force)[:, None] * normal
            depth = np.maximum(np.abs(x[:, k] - delta) - edge, 0.0)
            wall = np.where(depth > 0, spring[:, k], 0.0)
            torque += wall * (x[:, k] - np.sign(x[:, k]) * edge)
            diagonal = np.eye(v.shape[-1]) * (braked / step + wall)[:, None]
            diagonal += is_closed[:, None, None] * felt
            delta = np.linalg.solve(A + diagonal, (b + torque)[..., None])[..., 0]
            speed = (delta - before) / step
            force = contact.stiffness * np.sum(normal * delta, axis=-1)
            is_closed = (force >= -contact.force) | keeps_contact
        forces.append(force)
        poses.append(times(J[:, k], delta))
    deviation.force[paths] = _controlled(config, np.stack(forces, axis=1), step)
    deviation.pose[paths] = np.stack(poses, axis=1)
    return deviation


def _hindrance(is_braked: Mask, at_wall: Mask, is_singular: Mask) -> str:
    """Return the joints that are most often braked and at a limit, and singularities."""
    words = []
    for what, mask in (("braked", is_braked), ("at its limit", at_wall)):
        fractions = np.mean(mask, axis=(0, 1))
        joint = int(np.argmax(fractions))
        if fractions[joint] > 0:
            on = f"on {100 * fractions[joint]:.1f} % of the path"
            words.append(f"joint {joint + 1} is {what} {on}")
    if np.any(is_singular):
        on = f"on {100 * np.mean(is_singular):.1f} % of the path"
        words.append(f"the arm is nearly singular {on}")
    return ", ".join(words)


def _allowed_speeds(
    walls: JointWallConfig, limits: JointLimits, q: Array
) -> tuple[Array, Array]:
    """Return the velocities between which a joint is not braked, shape (B, T, n), rad/s."""
    most = walls.speed_fraction * limits.speed
    x = q - limits.middle
    ahead, behind = (
        np.minimum(
            most,
            np.sqrt(
                2
                * walls.braking_acceleration
                * np.maximum(limits.half_range - side * x - walls.width, 0.0)
            ),
        )
        for side in (1.0, -1.0)
    )
    return -behind, ahead


def _scale(config: ImpedanceConfig) -> Array:
    """Return the lengths that make rotations comparable to translations, shape (6, 1)."""
    length = config.characteristic_length
    return np.array([[length]] * 3 + [[1.0]] * 3)


def _posture(config: ImpedanceConfig, error: Array, v: Array) -> Array:
    """Return the acceleration towards the posture, shape (B, T, n), rad/s²."""
    omega, error = config.posture_frequency, shortened(error, config.max_posture_error)
    return omega**2 * error - 2 * config.posture_damping_ratio * omega * v


def _closed_loop(
    config: ImpedanceConfig, M: Array, J: Array, mobility: Array
) -> tuple[Array, Array, Array]:
    """Return the damping and the stiffness of the joints in free air, and N, (B, T, n, n).

    The modes are those of `task_modes`. Rotations of the mobility are scaled.
    """
    K, scale = np.diagonal(config.stiffness())[:, None], _scale(config)
    values, U = np.linalg.eigh(mobility)
    root = np.sqrt(np.maximum(values, 1 / config.max_effective_mass))[..., None, :]
    H = U * root / scale
    squared, V = np.linalg.eigh(H.mT @ (K * H))
    omega = np.sqrt(np.maximum(squared, 0.0))[..., None]
    BJ = (scale * U / root @ V).mT @ J
    N = M - BJ.mT @ BJ
    posture = config.posture_frequency
    damping = 2 * config.damping_ratio * BJ.mT @ (omega * BJ)
    damping += 2 * config.posture_damping_ratio * posture * N
    return damping, J.mT @ (K * J) + posture**2 * N, N


def _controlled(config: ImpedanceConfig, forces: Array, step: float) -> Array:
    """Return the errors of the normal force (B, T) that remain under force control, N.

    The error e of the disturbance d obeys ``(1 + p) ė + i e = ḋ`` with its gains p and i.
    """
    control = config.force_control
    if not control.enabled:
        return forces
    p, i = control.proportional_gain, control.integral_gain
    error, errors = np.zeros(len(forces)), []
    for change in np.diff(forces, axis=1, prepend=0.0).T:
        error = ((1 + p) * error + change) / (1 + p + step * i)
        errors.append(error)
    return np.stack(errors, axis=1)


def normal_mass(motion: PredictedMotion) -> float:
    """Return the median effective mass of the eraser along the board's normal, kg."""
    M, J = motion.M[0], motion.J[0]
    mobility = J @ np.linalg.solve(M, J.mT)
    return float(1 / np.median(mobility[:, 5, 5]))


def predict_lift(
    pushes: Sequence[Disturbance], config: ImpedanceConfig, *, force: float, mass: float
) -> float:
    """Predict how far pushes lift the eraser off the board.

    The eraser is a mass on the spring and the damper along the normal,
    ``m z̈ + D ż + K z = f − F``, above the board at z = 0. f is the sum of the pushes at
    that time. The normal force F of the controller is that of an approach: up to twice the
    desired one far from the board.

    Parameters
    ----------
    pushes : sequence of Disturbance
        Each counts once, without its repetitions.
    config : ImpedanceConfig
    force : float
        Desired normal force, N.
    mass : float
        Of `normal_mass`, kg.

    Returns
    -------
    float
        Greatest height, m; zero for pushes that the normal force withstands.
    """
    control = values_of(config.force_control)
    stiffness = config.translational_stiffness[2]
    damping = 2 * config.damping_ratio * math.sqrt(stiffness * mass)
    end = max(push.start + push.duration for push in pushes)
    time = z = speed = highest = 0.0
    while time < end or speed > 0:
        active = _active(pushes, time)
        if not active and z == 0:  # On the board until the next push.
            time = min(push.start for push in pushes if push.start > time)
            continue
        total = sum(active) - force * approach_factor(control, 0.0, z, -speed)
        speed += _STEP * (total - damping * speed - stiffness * z) / mass
        z += _STEP * speed
        if z < 0:
            z = speed = 0.0
        highest = max(highest, z)
        time += _STEP
    return highest


def _active(pushes: Sequence[Disturbance], time: float) -> list[float]:
    """Return the forces along the normal of the pushes at a time, N."""
    return [p.force[2] for p in pushes if p.start <= time < p.start + p.duration]


class LiftPrediction(NamedTuple):
    """Lift of the eraser by several pushes.

    Attributes
    ----------
    lift : float
        Greatest height, m.
    push : float
        Largest sum of the pushes along the normal at one time, N.
    withstanding : float
        Smallest normal force at which no push lifts the eraser higher than allowed, N.
    """

    lift: float
    push: float
    withstanding: float


def predict_lifts(
    scenario: Scenario, motion: PredictedMotion, *, force: float, allowed: float
) -> LiftPrediction:
    """Predict how far a scenario's pushes lift the eraser, and what force withstands them.

    Parameters
    ----------
    scenario : Scenario
    motion : PredictedMotion
    force : float
        Desired normal force, N.
    allowed : float
        Allowed height, m.
    """
    pushes = [push for push in scenario.disturbances if push.kind == "push"]
    if not pushes:
        return LiftPrediction(0.0, 0.0, force)
    mass = normal_mass(motion)

    def lift(force: float) -> float:
        return predict_lift(pushes, scenario.impedance, force=force, mass=mass)

    highest, low, high = lift(force), force, force
    changes = [p.start + seconds for p in pushes for seconds in (0.0, p.duration)]
    largest = max(sum(_active(pushes, time)) for time in changes)
    if highest > allowed:
        high = largest
    while high - low > _PRECISION:
        middle = (low + high) / 2
        low, high = (middle, high) if lift(middle) > allowed else (low, middle)
    return LiftPrediction(highest, largest, high)
