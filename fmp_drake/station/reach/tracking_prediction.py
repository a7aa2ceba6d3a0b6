"""Prediction of the arm's motion along paths of the eraser, by kinematics only."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame

from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.impedance.algebra import rotation_vector
from fmp_drake.systems.interface.arm_model import ArmModel

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Damping of the inverse at singularities, as a multiple of the springs' compliance,
# (rad/s)². Elsewhere the corrections leave an error of less than 0.5 mm.
_DAMPING = 6.0
_CORRECTIONS, _LONGEST_STEP = 5, 0.15  # rad
# Samples from the arm's posture to the start of a path, and at rest there.
_LEAD_IN, _SETTLE = 16, 12


class PredictedMotion(NamedTuple):
    """Predicted motion of the arm along B paths of T samples.

    Attributes
    ----------
    q, v : array, shape (B, T, n)
        rad and rad/s.
    torque : array, shape (B, T, n)
        For motion and weight of the arm with its eraser, Nm.
    force_torque : array, shape (B, T, n)
        Joint torque per newton of normal force on the board, m.
    error : array, shape (B, T, 6)
        From the predicted to the desired pose, in the board's axes: rotation in rad, then
        translation in m.
    manipulability : array, shape (B, T)
        ``sqrt(det(J Jᵀ))``, m³.
    """

    q: Array
    v: Array
    torque: Array
    force_torque: Array
    error: Array
    manipulability: Array


class TrackingPredictor:
    """Prediction of the arm's motion under impedance control along a path.

    Differential inverse kinematics: the dynamically consistent (minimum kinetic energy)
    inverse resolves the joint motion, with the posture's spring and damper in the
    nullspace. The springs' compliance distributes an error that cannot be removed. The
    joints do not enter the springs at their limits, which are far stiffer; other joints
    compensate for a joint there.

    Parameters
    ----------
    arm : MultibodyPlant
        Model of the controller: the arm and its eraser.
    tip : Frame
        E.
    config : ImpedanceConfig
    """

    def __init__(
        self, arm: MultibodyPlant, tip: Frame, config: ImpedanceConfig
    ) -> None:
        self._arm, self._tip, self._config = arm, tip, config
        self._model = ArmModel(arm, tip)
        self._context = arm.CreateDefaultContext()

    def follow(
        self,
        p_WE: Array,
        R_WE: Array,
        R_WB: Array,
        *,
        q_posture: Array,
        step: float,
    ) -> PredictedMotion:
        """Predict the motion along paths, after a straight motion to the start of each.

        Parameters
        ----------
        p_WE : array, shape (B, T, 3)
            Positions of the eraser in the world, m.
        R_WE, R_WB : array, shape (B, T, 3, 3) or (B, 1, 3, 3)
            Orientation of the eraser, and of the board: z is its normal.
        q_posture : array, shape (B, n)
            The controller's posture and initial posture of the arm, rad.
        step : float
            Time from sample to sample, s.
        """
        config, width = self._config, self._config.walls.width
        lower = self._arm.GetPositionLowerLimits() + width
        upper = self._arm.GetPositionUpperLimits() - width
        pull = step * config.posture_frequency**2
        brake = 2 * step * config.posture_damping_ratio * config.posture_frequency
        damping = np.zeros((*R_WB.shape[:2], 6, 6))
        compliance = _DAMPING / np.diagonal(config.stiffness())
        for half in (slice(3), slice(3, 6)):
            damping[..., half, half] = (R_WB * compliance[half]) @ R_WB.mT
        q, u, v = q_posture, np.zeros_like(q_posture), np.zeros_like(q_posture)
        M, Cv, X, J = self._read(q, v)
        lead_in = np.linspace(X[..., 3], p_WE[:, 0], _LEAD_IN, axis=1)
        begin = np.repeat(p_WE[:, :1], _SETTLE, axis=1)
        path = np.concatenate([lead_in, begin, p_WE], axis=1)
        before, samples = q, []
        inverse = _inverse(M, J, damping[:, 0])
        for k in range(path.shape[1]):
            at = min(max(k - _LEAD_IN - _SETTLE, 0), R_WB.shape[1] - 1)
            posture_error = _limited(q_posture - q, config.max_posture_error)
            u = (u + pull * posture_error) / (1 + brake + step * pull)
            u -= _times(inverse, _times(J, u))
            q = q + step * u
            for _ in range(_CORRECTIONS):
                pose_error = _errors(self._poses(q), path[:, k], R_WE[:, at])
                dq = _limited(_times(inverse, pose_error), _LONGEST_STEP)
                # Other joints compensate for a joint at its limit.
                is_free = (lower <= q + dq) & (q + dq <= upper)
                is_constrained = ~np.all(is_free, axis=-1)
                if np.any(is_constrained):
                    constrained_inverse = _inverse(
                        M[is_constrained],
                        J[is_constrained],
                        damping[is_constrained, at],
                        is_free[is_constrained],
                    )
                    dq[is_constrained] = _limited(
                        _times(constrained_inverse, pose_error[is_constrained]),
                        _LONGEST_STEP,
                    )
                q = np.clip(q + dq, lower, upper)
            v, before = (q - before) / step, q
            M, Cv, X, J = self._read(q, v)
            inverse = _inverse(M, J, damping[:, at])
            error = _errors(X, path[:, k], R_WE[:, at]).reshape(-1, 2, 3) @ R_WB[:, at]
            force_torque = _times(J[:, 3:].mT, -R_WB[:, at, :, 2])
            squared = np.maximum(np.linalg.det(J @ J.mT), 0.0)
            samples.append((q, v, M, Cv, force_torque, error, np.sqrt(squared)))
        parts = zip(*samples[-p_WE.shape[1] :], strict=True)
        q, v, M, Cv, force_torque, error, size = (np.stack(p, axis=1) for p in parts)
        v[:, :1] = v[:, 1:2]  # A window starts in the middle of a motion.
        torque = _times(M, np.diff(v, axis=1, prepend=v[:, :1]) / step) + Cv
        error = error.reshape(*error.shape[:2], 6)
        return PredictedMotion(q, v, torque, force_torque, error, size)

    def braking_lag(self, q: Array, speed: Array, step: float) -> Array:
        """Return the eraser's lag by joints with a limited speed, shape (B, T, 2).

        It is a distance in m, and an angle in rad. Each joint follows its predicted path at
        its own speed limit. Unlike in a run, no other joint compensates for it.

        Parameters
        ----------
        q : array, shape (B, T, n)
            Of a `PredictedMotion`, rad.
        speed : array, shape (n,)
            rad/s.
        step : float
            Time from sample to sample, s.
        """
        limited_q, largest_step = q.copy(), speed * step
        for k in range(1, q.shape[1]):
            last = limited_q[:, k - 1]
            limited_q[:, k] = np.clip(q[:, k], last - largest_step, last + largest_step)
        is_late = np.any(limited_q != q, axis=-1)
        lag = np.zeros((*q.shape[:2], 2))
        if np.any(is_late):
            X = self._poses(q[is_late])
            error = _errors(self._poses(limited_q[is_late]), X[..., 3], X[..., :3])
            error = error.reshape(-1, 2, 3)[:, ::-1]
            lag[is_late] = np.linalg.norm(error, axis=-1)
        return lag

    def _read(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Return M (B, n, n), Cv - g (B, n), X_WE (B, 3, 4) and J (B, 6, n) in W."""
        values = []
        for state in np.concatenate([q, v], axis=1):
            _, _, M, Cv, X, J, _, weight = self._model.read(self._context, state)
            values.append((M, Cv - weight, X.T, J.T))
        M, C, X, J = (np.array(column) for column in zip(*values, strict=True))
        return M, C, X, J

    def _poses(self, q: Array) -> Array:
        """Return X_WE, shape (B, 3, 4)."""
        X = np.empty((len(q), 3, 4))
        for i in range(len(q)):
            self._arm.SetPositions(self._context, q[i])
            X[i] = self._tip.CalcPoseInWorld(self._context).GetAsMatrix34()
        return X


def _errors(X_WE: Array, p_WE: Array, R_WE: Array) -> Array:
    """Return the errors from poses (B, 3, 4) to desired ones, in W, shape (B, 6)."""
    rotations = [rotation_vector(R) for R in R_WE @ X_WE[..., :3].mT]
    return np.concatenate([rotations, p_WE - X_WE[..., 3]], axis=1)


def _inverse(M: Array, J: Array, damping: Array, is_free: Flags | None = None) -> Array:
    """Return the damped, dynamically consistent inverse of the Jacobian, (B, n, 6).

    Joints that are not free, of shape (B, n), do not move.
    """
    if is_free is not None:
        J = J * is_free[:, None]
        M = np.where(is_free[:, None] & is_free[..., None], M, np.eye(M.shape[-1]))
    MJ = np.linalg.solve(M, J.mT)
    return MJ @ np.linalg.inv(J @ MJ + damping)


def _limited(x: Array, longest: float) -> Array:
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    return x * (longest / np.maximum(length, longest))


def _times(A: Array, x: Array) -> Array:
    return (A @ x[..., None])[..., 0]
