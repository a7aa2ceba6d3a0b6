"""Prediction of the normal force on a board where joints are braked."""

import numpy as np

from fmp_drake.numeric import Array
from fmp_drake.station.reach.tracking_prediction import PredictedMotion, times
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.impedance.joints import JointLimits, JointWallConfig

# Stiffness of the board, N/m: far above that of the springs.
_BOARD = 1e5
# Smallest natural frequency of the end effector's modes, rad/s; it is zero at singularities.
_SLOWEST_MODE = 0.1
# Iterations of the set of braked joints at a sample.
_ITERATIONS = 3


def predict_force_error(
    config: ImpedanceConfig,
    limits: JointLimits,
    motion: PredictedMotion,
    *,
    step: float,
) -> Array:
    """Predict the error of the normal force where the controller brakes joints.

    The deviations δ of the joints from the predicted motion obey the closed loop about it,
    ``M δ̈ + (Jᵀ D J + 2 ζ ω N) δ̇ + (Jᵀ K J + ω² N) δ = τ`` with ``N = M − Jᵀ Λ J``. K
    contains the board, which is stiff along its normal; τ is the torque of `wall_torque`
    that brakes a joint above its allowed speed. An implicit Euler step leads from sample
    to sample. The controller of the normal force reduces the error, if enabled.

    Parameters
    ----------
    config : ImpedanceConfig
    limits : JointLimits
    motion : PredictedMotion
        B paths of T samples on a board.
    step : float
        Time from sample to sample, s.

    Returns
    -------
    array, shape (B, T)
        Actual minus desired normal force, N. The board cannot pull, so that contact is
        lost where the error is less than minus the desired force.
    """
    error = np.zeros(motion.q.shape[:2])
    slowest, fastest = _allowed_speeds(config.walls, limits, motion.q)
    paths = np.any((motion.v < slowest) | (motion.v > fastest), axis=(1, 2))
    if not np.any(paths):
        return error
    M, J, v = motion.M[paths], motion.J[paths], motion.v[paths]
    slowest, fastest = slowest[paths], fastest[paths]
    damping, stiffness = _closed_loop(config, M, J)
    brake = np.diagonal(M, axis1=-2, axis2=-1) / config.walls.braking_time
    delta, speed = np.zeros((2, *v[:, 0].shape))
    forces = []
    for k in range(v.shape[1]):
        inertia, viscous = M[:, k] / step**2, damping[:, k] / step
        A = inertia + viscous + stiffness[:, k]
        b = times(inertia, delta + step * speed) + times(viscous, delta)
        before, braked = delta, np.zeros_like(delta)
        for _ in range(_ITERATIONS):
            actual = v[:, k] - speed
            allowed = np.clip(actual, slowest[:, k], fastest[:, k])
            braked = np.where(allowed != actual, brake[:, k], 0.0)
            excess = braked * (v[:, k] - allowed + before / step)
            diagonal = np.eye(v.shape[-1]) * (braked / step)[:, None]
            delta = np.linalg.solve(A + diagonal, (b + excess)[..., None])[..., 0]
            speed = (delta - before) / step
        forces.append(_BOARD * np.sum(J[:, k, 5] * delta, axis=-1))
    error[paths] = _controlled(config, np.stack(forces, axis=1), step)
    return error


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


def _closed_loop(config: ImpedanceConfig, M: Array, J: Array) -> tuple[Array, Array]:
    """Return the damping and the stiffness of the joints on a board, (B, T, n, n)."""
    K = np.diagonal(config.stiffness())
    # Modes of the end effector, as in `task_modes`.
    root = np.sqrt(K)[:, None]
    values, U = np.linalg.eigh(root * (J @ np.linalg.solve(M, J.mT)) * root.T)
    omega = np.sqrt(np.maximum(values, _SLOWEST_MODE**2))[..., None]
    BJ = (root * U / omega.mT).mT @ J
    N = M - BJ.mT @ BJ
    posture = config.posture_frequency
    damping = 2 * config.damping_ratio * BJ.mT @ (omega * BJ)
    damping += 2 * config.posture_damping_ratio * posture * N
    board = K + np.array([0.0, 0.0, 0.0, 0.0, 0.0, _BOARD])
    return damping, J.mT @ (board[:, None] * J) + posture**2 * N


def _controlled(config: ImpedanceConfig, forces: Array, step: float) -> Array:
    """Return what the controller of the normal force leaves of errors (B, T), N.

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
