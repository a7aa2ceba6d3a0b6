"""Prediction of the arm's motion along paths of the eraser, by kinematics only."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame

from fmp_drake.numeric import Array, Mask
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.impedance.algebra import rotation_vectors
from fmp_drake.systems.interface.arm_model import ArmModel

# Damping of the inverse at singularities, as a multiple of the springs' compliance,
# (rad/s)². Elsewhere the corrections leave an error of less than 0.5 mm.
_DAMPING = 6.0
_CORRECTIONS, _LONGEST_STEP = 5, 0.15  # rad
# Shortest correction that another one follows, rad.
_CONVERGED = 1e-5
# Number of lengths of a correction that are tried, each half of the one before, and factor by
# which it may load the springs more: the Jacobian, with which they are in equilibrium, is not
# exactly the gradient of the rotations.
_LENGTHS, _MORE = 4, 1.001
# Samples from the arm's posture to the start of a path, and at rest there.
_LEAD_IN, _SETTLE = 16, 12

RESIDUAL = 2e-4
"""Error along the normal that the prediction may leave near a singularity, m."""


class PredictedMotion(NamedTuple):
    """Predicted motion of the arm along B paths of T samples.

    Attributes
    ----------
    q, v : array, shape (B, T, n)
        rad and rad/s.
    torque : array, shape (B, T, n)
        For motion and weight of the arm with its eraser, Nm.
    M : array, shape (B, T, n, n)
        Mass matrix, kg m².
    J : array, shape (B, T, 6, n)
        Jacobian of the eraser's twist in the board's axes, rotation first.
    error : array, shape (B, T, 6)
        From the predicted to the desired pose, in the board's axes: rotation in rad, then
        translation in m.
    manipulability : array, shape (B, T)
        ``sqrt(det(J Jᵀ))``, m³.
    """

    q: Array
    v: Array
    torque: Array
    M: Array
    J: Array
    error: Array
    manipulability: Array

    @property
    def force_torque(self) -> Array:
        """Joint torque per newton of normal force on the board, m, shape (B, T, n)."""
        return -self.J[..., 5, :]


class FeltContact(NamedTuple):
    """Desired contact of the felt with a board.

    Attributes
    ----------
    force : float
        Desired normal force, N.
    stiffness : float
        Of the felt along the normal, N/m.
    """

    force: float
    stiffness: float


NO_CONTACT = FeltContact(0.0, 0.0)
"""Contact in free space."""


class TrackingPredictor:
    """Prediction of the arm's motion under impedance control along a path.

    Differential inverse kinematics: the dynamically consistent (minimum kinetic energy)
    inverse resolves the joint motion, with the posture's spring and damper in the
    nullspace. The springs' compliance distributes an error that cannot be removed; in
    contact the felt is far stiffer along the normal. The joints do not enter the springs at
    their limits, which are far stiffer; other joints compensate for a joint there.

    Parameters
    ----------
    arm : MultibodyPlant
        Model of the controller: the arm and its eraser.
    tip : Frame
        E.
    config : ImpedanceConfig
    contact : FeltContact
        With the board, on the pressed parts of a path.
    """

    def __init__(
        self,
        arm: MultibodyPlant,
        tip: Frame,
        config: ImpedanceConfig,
        contact: FeltContact = NO_CONTACT,
    ) -> None:
        self._arm, self._tip, self._config = arm, tip, config
        self._contact = contact
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
        pressed: Mask | None = None,
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
        pressed : array of bool, shape (B, T), optional
            Whether the desired position is in contact with the board. Contact is lost where
            the eraser is too high for the desired normal force.
        """
        config, width = self._config, self._config.walls.width
        lower = self._arm.GetPositionLowerLimits() + width
        upper = self._arm.GetPositionUpperLimits() - width
        pull = step * config.posture_frequency**2
        brake = 2 * step * config.posture_damping_ratio * config.posture_frequency
        stiffness = np.tile(np.diagonal(config.stiffness()), (len(p_WE), 1))
        contact, normal = self._contact, stiffness[:, 5].copy()
        q, u, v = q_posture, np.zeros_like(q_posture), np.zeros_like(q_posture)
        M, Cv, X, J = self._read(q, v)
        lead_in = np.linspace(X[..., 3], p_WE[:, 0], _LEAD_IN, axis=1)
        begin = np.repeat(p_WE[:, :1], _SETTLE, axis=1)
        path = np.concatenate([lead_in, begin, p_WE], axis=1)
        before, samples = q, []
        arm = _linearized(M, J, stiffness, R_WB[:, 0])
        for k in range(path.shape[1]):
            i = min(max(k - _LEAD_IN - _SETTLE, 0), R_WB.shape[1] - 1)
            posture_error = shortened(q_posture - q, config.max_posture_error)
            u = (u + pull * posture_error) / (1 + brake + step * pull)
            u -= times(arm.inverse, times(arm.J, u))
            q = np.clip(q + step * u, lower, upper)
            q = self._corrected(q, path[:, k], R_WE[:, i], arm, lower, upper)
            v, before = (q - before) / step, q
            M, Cv, X, J = self._read(q, v)
            error = _errors(X, path[:, k], R_WE[:, i]).reshape(-1, 2, 3) @ R_WB[:, i]
            if pressed is not None:
                is_low = contact.stiffness * error[:, 1, 2] > -contact.force
                is_closed = is_low & pressed[:, max(k - _LEAD_IN - _SETTLE, 0)]
                stiffness[:, 5] = normal + contact.stiffness * is_closed
            arm = _linearized(M, J, stiffness, R_WB[:, i])
            J_B = R_WB[:, i, None].mT @ J.reshape(len(J), 2, 3, -1)
            squared = np.maximum(np.linalg.det(J @ J.mT), 0.0)
            samples.append((q, v, M, Cv, J_B.reshape(J.shape), error, np.sqrt(squared)))
        parts = zip(*samples[-p_WE.shape[1] :], strict=True)
        q, v, M, Cv, J, error, size = (np.stack(p, axis=1) for p in parts)
        v[:, :1] = v[:, 1:2]  # A window starts in the middle of a motion.
        torque = times(M, np.diff(v, axis=1, prepend=v[:, :1]) / step) + Cv
        error = error.reshape(*error.shape[:2], 6)
        return PredictedMotion(q, v, torque, M, J, error, size)

    def _corrected(
        self,
        q: Array,
        p_WE: Array,
        R_WE: Array,
        arm: "_Linearization",
        lower: Array,
        upper: Array,
    ) -> Array:
        """Return configurations (B, n) nearer to poses, p_WE (B, 3) and R_WE (B, 3, 3).

        A correction that would load the springs more is halved: near a singularity, a full one
        goes far beyond it, and the next one back.
        """
        q, rows = q.copy(), np.arange(len(q))
        error = _errors(self._poses(q), p_WE, R_WE)
        for _ in range(_CORRECTIONS):
            load = _load(error[rows], arm.rows(rows))
            dq = _correction(q[rows], error[rows], arm.rows(rows), lower, upper)
            worse = np.arange(len(rows))
            for _ in range(_LENGTHS):
                i = rows[worse]
                found = _errors(self._poses(q[i] + dq[worse]), p_WE[i], R_WE[i])
                is_worse = _load(found, arm.rows(i)) > _MORE * load[worse]
                error[i[~is_worse]] = found[~is_worse]
                worse = worse[is_worse]
                if not len(worse):
                    break
                dq[worse] /= 2
            dq[worse] = 0.0
            q[rows] += dq
            rows = rows[np.linalg.norm(dq, axis=-1) > _CONVERGED]
        return q

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


def lengths(error: Array, *, has_rotation: bool) -> tuple[Array, Array]:
    """Return distances (m) and angles (rad) of errors (..., 6) in the board's axes.

    Without rotation channels, rotations about the normal do not count.
    """
    rotation = error[..., : 3 if has_rotation else 2]
    return np.linalg.norm(error[..., 3:], axis=-1), np.linalg.norm(rotation, axis=-1)


def _errors(X_WE: Array, p_WE: Array, R_WE: Array) -> Array:
    """Return the errors from poses (B, 3, 4) to desired ones, in W, shape (B, 6)."""
    rotations = rotation_vectors(R_WE @ X_WE[..., :3].mT)
    return np.concatenate([rotations, p_WE - X_WE[..., 3]], axis=1)


class _Linearization(NamedTuple):
    """Arms at B configurations: M, J in W, and the damping of `_inverse` with the inverse."""

    M: Array
    J: Array
    damping: Array
    inverse: Array

    def rows(self, rows: NDArray[Any]) -> "_Linearization":
        return _Linearization(*(values[rows] for values in self))


def _linearized(M: Array, J: Array, stiffness: Array, R_WB: Array) -> _Linearization:
    """Return the linearization with the damping by the stiffness (B, 6) in the board's axes."""
    damping = np.zeros((len(R_WB), 6, 6))
    for half in (slice(3), slice(3, 6)):
        damping[:, half, half] = (
            R_WB * (_DAMPING / stiffness[:, None, half])
        ) @ R_WB.mT
    return _Linearization(M, J, damping, _inverse(M, J, damping))


def _load(error: Array, arm: _Linearization) -> Array:
    """Return a multiple of the energy of the springs at pose errors (B, 6), shape (B,)."""
    return np.sum(
        error * np.linalg.solve(arm.damping, error[..., None])[..., 0], axis=-1
    )


def _correction(
    q: Array, error: Array, arm: _Linearization, lower: Array, upper: Array
) -> Array:
    """Return the step (B, n) that reduces pose errors (B, 6), within the joints' limits.

    Other joints compensate for a joint at its limit.
    """
    dq = shortened(times(arm.inverse, error), _LONGEST_STEP)
    limited = np.clip(q + dq, lower, upper)
    is_free = limited == q + dq
    rows = ~np.all(is_free, axis=-1)
    if np.any(rows):
        M, J, damping, _ = arm.rows(rows)
        free = is_free[rows]
        fixed = np.where(free, 0.0, (limited - q)[rows])
        rest = error[rows] - times(J, fixed)
        inverse = _inverse(M, J, damping, free)
        dq[rows] = fixed + shortened(times(inverse, rest), _LONGEST_STEP)
    return np.clip(q + dq, lower, upper) - q


def _inverse(M: Array, J: Array, damping: Array, is_free: Mask | None = None) -> Array:
    """Return the damped, dynamically consistent inverse of the Jacobian, (B, n, 6).

    Joints that are not free, of shape (B, n), do not move.
    """
    if is_free is not None:
        J = J * is_free[:, None]
        M = np.where(is_free[:, None] & is_free[..., None], M, np.eye(M.shape[-1]))
    MJ = np.linalg.solve(M, J.mT)
    return MJ @ np.linalg.inv(J @ MJ + damping)


def shortened(x: Array, longest: float) -> Array:
    """Return vectors (..., n) of the same directions that are at most this long."""
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    return x * (longest / np.maximum(length, longest))


def times(A: Array, x: Array) -> Array:
    """Return the products of matrices (..., m, n) and vectors (..., n), shape (..., m)."""
    return (A @ x[..., None])[..., 0]
