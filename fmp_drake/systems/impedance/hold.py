"""The model hold: the impedance law between two of its full updates.

A full update computes the law from the arm's dynamics. Around the state x and the
time t that it saw, the law is nearly

    τ(t + dt, x + dx) = τ_0 + G dx + r dt + c dt²,

with ``G`` the stiffness and the damping in joint space, both symmetric, and ``r`` and
``c`` what the target's motion changes. In the control periods in between this model is
evaluated at the measured state: the feedback stays as fast as the control, only its
gains and the target's motion are held.

What the model leaves out (the change of the Jacobian, the inertia and the Coriolis
torque along the motion) is slow. At each full update it is known how far the last
model was off; ``r`` goes on to drift at that rate.

References
----------
.. [1] O. Khatib, "A unified approach for motion and force control of robot
   manipulators: the operational space formulation", IEEE J. Robotics and
   Automation 3(1), 1987: the dynamic parameters may be updated at a lower rate than
   the control.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.systems.impedance.friction import SigmoidFriction
from fmp_drake.systems.impedance.gains import ImpedanceGains
from fmp_drake.systems.impedance.law import ArmDynamics, LawTorque
from fmp_drake.systems.impedance.walls import JointLimits, JointWallConfig

Array = NDArray[np.float64]

# How far the joints may move, rad, and change their speed, rad/s, on one model. Its
# error grows with the square: 0.05 rad turn the tool by less than 3 degrees.
_REACH = 0.05
_SPEED_CHANGE = 0.3
# A model that was off by more, Nm/s, has met a jump, which does not go on.
_DRIFT = 300.0
_NEVER = -float("inf")


class HeldModel(NamedTuple):
    """A first-order model of the law, and where it may be used.

    Attributes
    ----------
    torque : array, shape (n,)
        τ_0, without friction compensation, Nm.
    slope : array, shape (2n, n)
        G transposed: by q, Nm/rad, then by v, Nms/rad.
    rate : array, shape (n,)
        r, Nm/s.
    curve : array, shape (n,)
        c, Nm/s².
    state : array, shape (2n,)
        x, rad and rad/s.
    reach : array, shape (2n,)
        Half axes of the ellipsoid of states around x where it is used.
    """

    torque: Array
    slope: Array
    rate: Array
    curve: Array
    state: Array
    reach: Array


def linearized(
    gains: ImpedanceGains,
    arm: ArmDynamics,
    law: LawTorque,
    *,
    desired_twist: Array,
    desired_acceleration: Array,
    desired_jerk: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Return G transposed, shape (2n, n), r and c, shape (n,), of the law.

    ``G_q = −(Jᵀ K J + ω² Nᵀ M)``, ``G_v = −(Jᵀ D J + 2 ζ ω Nᵀ M)``,
    ``r = Jᵀ (K V_d + D A_d + Λ j_d)`` and ``c = Jᵀ (K A_d + D j_d) / 2``, where ``K``,
    ``D`` and Λ are diagonal in the modes.

    Parameters
    ----------
    gains : ImpedanceGains
    arm : ArmDynamics
        What the law was computed from.
    law : LawTorque
        Its result, with no error clipped and no inertia bounded.
    desired_twist, desired_acceleration : array, shape (6,)
        As for the law.
    desired_jerk : array, shape (3,), optional
        j_d of the translation, m/s³, in T.
    """
    d, BJ, B_t = law.modal_damping, law.modal_jacobian, law.modes.T
    n = len(arm.M)
    k = d * d
    k *= 0.25 / gains.damping_ratio**2
    omega = gains.posture_frequency
    spring = omega * omega * law.posture_share
    damper = 2 * gains.posture_damping_ratio * omega
    weights = np.empty((2, 1, 6))
    np.subtract(spring, k, out=weights[0, 0])
    np.subtract(damper, d, out=weights[1, 0])
    slope: Array = np.dot((weights * BJ.T).reshape(2 * n, 6), BJ)
    slope.reshape(2, n, n)[:] -= np.multiply.outer((spring, damper), arm.M)
    V, A = B_t.dot(desired_twist), B_t.dot(desired_acceleration)
    rate, curve = k * V + d * A, 0.5 * k * A
    if desired_jerk is not None:
        j = B_t[:, 3:].dot(desired_jerk)
        rate += j
        curve += 0.5 * d * j
    return slope, BJ.T.dot(rate), BJ.T.dot(curve)


def reach_of(
    walls: JointWallConfig, limits: JointLimits, *, q: Array, v: Array
) -> list[float] | None:
    """Return how far q and v may go on one model: less than to a wall or a brake.

    Returns
    -------
    list of 2n floats, or None
        None where there is no room.
    """
    half_a, share = 0.5 / walls.braking_acceleration, walls.speed_share
    positions, speeds = [], []
    for x, speed, (middle, half, most) in zip(
        q.tolist(), v.tolist(), limits.numbers, strict=True
    ):
        fast = abs(speed)
        change = min(_SPEED_CHANGE, share * most - fast)
        fast += change
        room = half - walls.width - abs(x - middle) - half_a * fast * fast
        if not (change > 0 and room > 0):
            return None
        positions.append(min(_REACH, room))
        speeds.append(change)
    return positions + speeds


class ModelHold:
    """Keeps a `HeldModel` in a vector and evaluates it.

    The vector holds two times, the drift and a matrix that maps
    ``z = (x, previous torque, 1, dt, dt²)`` to ``y``: the torque, and parts of all
    limits: of the model's reach, the efforts and the torques' rates. So one product and
    the length of ``y`` behind the torque are all that is to be computed.

    Parameters
    ----------
    lower, upper : array, shape (n,)
        Effort limits, Nm.
    max_change : float
        Greatest change of any joint's torque at one update, Nm.
    control_period, model_period : float
        Time between updates and between full updates, s; the second is rounded to a
        whole number of the first.
    friction : SigmoidFriction or None
        What is compensated: it is computed at every update.
    """

    def __init__(
        self,
        *,
        lower: Array,
        upper: Array,
        max_change: float,
        control_period: float,
        model_period: float,
        friction: SigmoidFriction | None = None,
    ) -> None:
        n = len(lower)
        self._n = n
        self._per_limit = 1 / np.minimum(upper, -lower)
        self._max_change = max_change
        self._period = control_period
        self._friction = friction
        self._updates = max(round(model_period / control_period), 1)
        self._head = 2 + n
        rows, columns = self._shape = (5 * n, 3 * n + 3)
        # Diagonals of the matrix: of the reach by the state, of the change by z's
        # previous torque.
        begin = self._head + n * columns
        self._reach = slice(begin, begin + 2 * n * columns, columns + 1)
        begin = self._head + (rows - n) * columns + 2 * n
        self._change = slice(begin, None, columns + 1)
        self.size = self._head + math.prod(self._shape)
        self.used = self._updates > 1

    def empty(self, time: float = _NEVER) -> Array:
        """Return the vector of no model, after a full update at a time in s."""
        vector = np.zeros(self.size)
        vector[:2] = time, _NEVER
        return vector

    def pack(self, model: HeldModel | None, *, time: float, before: Array) -> Array:
        """Return the vector of the model of a full update.

        Parameters
        ----------
        model : HeldModel or None
            None where the next update is to be a full one.
        time : float
            Of the full update, s.
        before : array
            What was returned at the full update before.
        """
        vector = self.empty(time)
        if model is None:
            return vector
        n, slope = self._n, model.slope
        vector[1] = time + (self._updates - 0.5) * self._period
        vector[2 : self._head] = drift = self._missed(model, time, before)
        rows = self._matrix(vector)
        torque = rows[:n]
        torque[:, : 2 * n] = slope.T
        torque[:, -3] = model.torque - model.state.dot(slope)
        torque[:, -2] = model.rate + drift
        torque[:, -1] = model.curve
        per_reach = 1 / model.reach
        vector[self._reach] = per_reach
        rows[n : 3 * n, -3] = -per_reach * model.state
        np.multiply(torque, self._per_limit[:, None], out=rows[3 * n : 4 * n])
        np.multiply(torque, 1 / self._max_change, out=rows[4 * n :])
        vector[self._change] = -1 / self._max_change
        return vector

    def _matrix(self, vector: Array) -> Array:
        """Return the matrix in a vector, a view."""
        return vector[self._head :].reshape(self._shape)

    def _missed(self, model: HeldModel, time: float, before: Array) -> Array | float:
        """Return the rate in Nm/s at which the model before went off without drift."""
        start, end = before[:2].tolist()
        if not start < time < end + self._period:
            return 0.0
        z = self._input(model.state, model.torque, time - start)
        rate: Array = model.torque - self._matrix(before)[: self._n].dot(z)
        rate /= time - start
        rate += before[2 : self._head]
        return rate if rate.dot(rate) < _DRIFT * _DRIFT else 0.0

    def _input(self, state: Array, previous: Array, time: float) -> Array:
        """Return z."""
        n = self._n
        z = np.empty(3 * n + 3)
        z[: 2 * n] = state
        z[2 * n : -3] = previous
        z[-3] = 1.0
        z[-2] = time
        z[-1] = time * time
        return z

    def elapsed(self, vector: Array, *, time: float) -> float:
        """Return the seconds since the last full update, whole control periods."""
        periods = (time - float(vector[0])) / self._period
        if 0.5 < periods < self._updates + 0.5:
            return round(periods) * self._period
        return self._period

    @staticmethod
    def serves(vector: Array, time: float) -> bool:
        """Tell whether there is a model, and it is not too old, at a time in s."""
        return vector.item(0) <= time < vector.item(1)

    def torque(
        self, vector: Array, *, time: float, state: Array, previous: Array
    ) -> Array | None:
        """Return the model's torque, or None where a full update is due.

        It is due when the state has left the model's reach or is not finite, and when
        an effort or a rate is near its limit.

        Parameters
        ----------
        vector : array
            What `pack` returned, while it `serves`.
        time : float
            s.
        state : array, shape (2n,)
            rad and rad/s.
        previous : array, shape (n,)
            The torque of the update before, Nm.
        """
        n, friction = self._n, self._friction
        if friction is not None:
            extra = friction.torque(state[n:])
            previous = previous - extra
        z = self._input(state, previous, time - vector.item(0))
        y: Array = vector[self._head :].reshape(self._shape).dot(z)
        torque, limits = y[:n], y[n:]
        if not limits.dot(limits) < 1:  # NaN is refused as well.
            return None
        if friction is not None:
            torque += extra  # Not in the matrix's part of the efforts.
            if not np.abs(torque * self._per_limit).max() < 1:
                return None
        return torque
