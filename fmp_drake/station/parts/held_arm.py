"""How the controller would hold the arm along paths of the eraser: kinematics only."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame

from fmp_drake.systems.impedance.algebra import rotation_vector
from fmp_drake.systems.impedance.arm import ArmModel
from fmp_drake.systems.impedance.config import ImpedanceConfig

Array = NDArray[np.float64]

# Damps the inverse where the arm is singular, as a multiple of the springs' compliance,
# (rad/s)². Elsewhere the corrections come closer than 0.5 mm to what is wanted.
_DAMPING = 6.0
_CORRECTIONS, _LONGEST_STEP = 5, 0.15  # rad
# Samples of the way from where the arm is to where a path begins, and of waiting there.
_LEAD_IN, _SETTLE = 16, 12


class HeldMotion(NamedTuple):
    """How the arm moves along B paths of T samples.

    Attributes
    ----------
    q, v : array, shape (B, T, n)
        rad and rad/s.
    torque : array, shape (B, T, n)
        That moves and carries the arm with its eraser, Nm.
    press_torque : array, shape (B, T, n)
        For each newton with which the eraser presses on the board, m.
    error : array, shape (B, T, 6)
        What is left to the wanted pose, in the board's axes: rotation in rad, then
        translation in m.
    manipulability : array, shape (B, T)
        ``sqrt(det(J Jᵀ))``, m³.
    """

    q: Array
    v: Array
    torque: Array
    press_torque: Array
    error: Array
    manipulability: Array


class HeldArm:
    """The arm on a path of the eraser, as the impedance controller would hold it.

    Differential inverse kinematics: the joints' way is that of least kinetic energy
    (dynamically consistent), with the posture's spring and damper in the nullspace. An
    error that cannot be removed is divided, nearly, by the springs' compliance. The joints
    stay within their limits, and do not feel their walls.

    Parameters
    ----------
    arm : MultibodyPlant
        What the controller knows: the arm and its eraser.
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
    ) -> HeldMotion:
        """Move along paths, each from its posture, straight to where the path begins.

        Parameters
        ----------
        p_WE : array, shape (B, T, 3)
            Positions of the eraser in the world, m.
        R_WE, R_WB : array, shape (B, 3, 3)
            How it is held, and the board's axes.
        q_posture : array, shape (B, n)
            The controller's posture, in which the arm is at first, rad.
        step : float
            Time from sample to sample, s.
        """
        config, lower = self._config, self._arm.GetPositionLowerLimits()
        upper = self._arm.GetPositionUpperLimits()
        pull = step * config.posture_frequency**2
        brake = 2 * step * config.posture_damping_ratio * config.posture_frequency
        damping = np.zeros((len(p_WE), 6, 6))
        compliance = _DAMPING / np.diagonal(config.stiffness())
        for half in (slice(3), slice(3, 6)):
            damping[:, half, half] = (R_WB * compliance[half]) @ R_WB.mT
        q, u, v = q_posture, np.zeros_like(q_posture), np.zeros_like(q_posture)
        M, Cv, X, J = self._read(q, v)
        lead_in = np.linspace(X[..., 3], p_WE[:, 0], _LEAD_IN, axis=1)
        begin = np.repeat(p_WE[:, :1], _SETTLE, axis=1)
        way = np.concatenate([lead_in, begin, p_WE], axis=1)
        before, found = q, []
        inverse = _inverse(M, J, damping)
        for k in range(way.shape[1]):
            off = _shortened(q_posture - q, config.max_posture_error)
            u = (u + pull * off) / (1 + brake + step * pull)
            u -= _times(inverse, _times(J, u))
            q = q + step * u
            for _ in range(_CORRECTIONS):
                left = _errors(self._poses(q), way[:, k], R_WE)
                dq = _shortened(_times(inverse, left), _LONGEST_STEP)
                q = np.clip(q + dq, lower, upper)
            M, Cv, X, J = self._read(q, v)
            inverse = _inverse(M, J, damping)
            v, before = (q - before) / step, q
            error = _errors(X, way[:, k], R_WE).reshape(-1, 2, 3) @ R_WB
            press_torque = _times(J[:, 3:].mT, -R_WB[..., 2])
            squared = np.maximum(np.linalg.det(J @ J.mT), 0.0)
            found.append((q, v, M, Cv, press_torque, error, np.sqrt(squared)))
        parts = zip(*found[-p_WE.shape[1] :], strict=True)
        q, v, M, Cv, press_torque, error, size = (np.stack(p, axis=1) for p in parts)
        v[:, :1] = v[:, 1:2]  # A window begins in the middle of a motion.
        torque = _times(M, np.diff(v, axis=1, prepend=v[:, :1]) / step) + Cv
        error = error.reshape(*error.shape[:2], 6)
        return HeldMotion(q, v, torque, press_torque, error, size)

    def _read(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Return M (B, n, n), Cv - g (B, n), X_WE (B, 3, 4) and J (B, 6, n) in W."""
        read = []
        for state in np.concatenate([q, v], axis=1):
            _, _, M, Cv, X, J, _, weight = self._model.read(self._context, state)
            read.append((M, Cv - weight, X.T, J.T))
        M, C, X, J = (np.array(each) for each in zip(*read, strict=True))
        return M, C, X, J

    def _poses(self, q: Array) -> Array:
        """Return X_WE, shape (B, 3, 4)."""
        X = np.empty((len(q), 3, 4))
        for i in range(len(q)):
            self._arm.SetPositions(self._context, q[i])
            X[i] = self._tip.CalcPoseInWorld(self._context).GetAsMatrix34()
        return X


def _errors(X_WE: Array, p_WE: Array, R_WE: Array) -> Array:
    """Return what is left from poses (B, 3, 4) to wanted ones, in W, shape (B, 6)."""
    turned = [rotation_vector(R) for R in R_WE @ X_WE[..., :3].mT]
    return np.concatenate([turned, p_WE - X_WE[..., 3]], axis=1)


def _inverse(M: Array, J: Array, damping: Array) -> Array:
    """Return the damped, dynamically consistent inverse of the Jacobian, (B, n, 6)."""
    MJ = np.linalg.solve(M, J.mT)
    return MJ @ np.linalg.inv(J @ MJ + damping)


def _shortened(x: Array, longest: float) -> Array:
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    return x * (longest / np.maximum(length, longest))


def _times(A: Array, x: Array) -> Array:
    return (A @ x[..., None])[..., 0]
