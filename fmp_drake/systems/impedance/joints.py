"""Torques joint by joint: limits of torque, position and speed, and friction."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array
from fmp_drake.settings import bounded, check_settings
from fmp_drake.systems.impedance.algebra import applied, cholesky, solve_lower

# Fraction of the effort limits that is used, because the weight changes until the next
# update, and the fraction that remains for control where the weight alone needs all.
_EFFORT_FRACTION, _EFFORT_RESERVE = 0.99, 0.01
# Time constant with which a joint that would be too fast comes to rest, s.
_STOPPING_TIME = 0.05
# Fraction of the speed limits that a torque may lead to. Contact and friction, which
# are unknown here, may accelerate a joint further.
_SPEED_FRACTION = 0.95
# Distance of the other limit of a joint that has only one, rad.
_FAR = 1e3


@dataclass(kw_only=True)
class JointWallConfig:
    """Springs at the joint limits, and braking of fast joints.

    The limits and efforts are the model's.

    Attributes
    ----------
    width : float
        Width of the spring at a limit, rad, or m for a prismatic joint; less than half the
        range of every joint. At half of it the spring's torque is the joint's effort limit;
        without an effort limit the spring is critically damped.
    braking_acceleration : float
        Deceleration, rad/s², that bounds the speed towards a joint-limit spring.
    speed_fraction : float
        Fraction of the model's velocity limit above which a joint is braked.
    braking_time : float
        Time constant of the excess speed, s.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> config = ImpedanceConfig(walls=JointWallConfig(width=0.05))
    >>> config.walls.speed_fraction
    0.85
    """

    width: float = bounded(0.1, above=0)
    braking_acceleration: float = bounded(5.0, above=0)
    speed_fraction: float = bounded(0.85, above=0, most=1)
    braking_time: float = bounded(0.01, above=0)


class JointLimits(NamedTuple):
    """Joint limits; infinite where a joint has none.

    Parameters
    ----------
    middle, half_range : array, shape (n,)
        Of the position, rad. The middle is 0 for a joint without limits, and 500 rad from
        the limit of a joint that has only one.
    speed : array, shape (n,)
        rad/s.
    lower_effort, upper_effort : array, shape (n,)
        ``lower < 0 < upper``, Nm.
    """

    middle: Array
    half_range: Array
    speed: Array
    lower_effort: Array
    upper_effort: Array

    @classmethod
    def between(cls, lower: Array, upper: Array, **others: Array) -> Self:
        """Make limits from lower and upper position limits, rad, and the other fields."""
        # A joint with one limit has the other one far away.
        has_lower, has_upper = np.isfinite(lower), np.isfinite(upper)
        lower = np.where(has_upper & ~has_lower, upper - _FAR, lower)
        upper = np.where(has_lower & ~has_upper, lower + _FAR, upper)
        middle = np.zeros(len(lower))
        is_limited = has_lower | has_upper
        middle[is_limited] = 0.5 * (lower[is_limited] + upper[is_limited])
        half_range = np.minimum(upper - middle, middle - lower)
        return cls(middle, half_range, **others)


class WallTorque(NamedTuple):
    """Torque at the joint limits in Nm, shape (n,), and whether it limits position or speed."""

    torque: Array
    at_wall: bool
    too_fast: bool


@compiled
def wall_torque(
    config: JointWallConfig, limits: JointLimits, q: Array, v: Array, inertia: Array
) -> WallTorque:
    """Compute the torque that keeps the joints within their limits; zero far from them.

    Each joint gets ``−k depth`` in the last `width` of its range, and is braked by
    ``−(m / t) (v − v_allowed)``, where ``v_allowed² = 2 a (margin − width)`` up to a
    fraction of the speed limit. Inside the spring both directions are damped, so it
    generates no energy.

    Parameters
    ----------
    config : JointWallConfig
        As `values_of` returns it.
    limits : JointLimits
    q, v : array, shape (n,)
        Positions and velocities, rad and rad/s.
    inertia : array, shape (n,)
        Diagonal of the mass matrix, kg m².

    Returns
    -------
    WallTorque
    """
    torque = np.zeros(len(q))
    at_wall = too_fast = False
    for i in range(len(q)):
        x = q[i] - limits.middle[i]
        side = -1.0 if x < 0 else 1.0
        margin = limits.half_range[i] - abs(x)
        depth = min(max(config.width - margin, 0.0), config.width) / config.width
        strength = min(limits.upper_effort[i], -limits.lower_effort[i])
        if not math.isfinite(strength):
            # The spring for which the damping below is critical.
            strength = inertia[i] * config.width / (8 * config.braking_time**2)
        # Speed towards the limit, and its excess.
        speed = side * v[i]
        most = config.speed_fraction * limits.speed[i]
        stoppable = math.sqrt(
            2 * config.braking_acceleration * max(margin - config.width, 0.0)
        )
        excess = max(speed - min(most, stoppable), 0.0) + min(speed + most, 0.0)
        # The spring returns little of the stored energy.
        excess += min(speed, 0.0) * min(2 * depth, 1.0)
        torque[i] = -side * (
            2 * depth * strength + inertia[i] / config.braking_time * excess
        )
        at_wall = at_wall or depth > 0
        too_fast = too_fast or excess != 0
    return WallTorque(torque, at_wall, too_fast)


@compiled
def torque_scale(torque: Array, lower: Array, upper: Array) -> float:
    """Return the factor, at most 1, that scales a torque into the box of limits.

    Parameters
    ----------
    torque : array, shape (n,)
        Joint torque, Nm.
    lower, upper : array, shape (n,)
        Limits, ``lower < 0 < upper``, Nm; infinite where there is none.
    """
    excess = 1.0
    for i in range(len(torque)):
        excess = max(excess, torque[i] / upper[i], torque[i] / lower[i])
    return 1 / excess


@compiled
def rate_scale(change: Array, max_change: float) -> float:
    """Return the factor, at most 1, by which a change of torque is shortened.

    Parameters
    ----------
    change : array, shape (n,)
        Desired minus previous joint torque, Nm.
    max_change : float
        Greatest change of any joint, Nm.
    """
    greatest = max_change
    for i in range(len(change)):
        greatest = max(greatest, abs(change[i]))
    return max_change / greatest


@compiled
def rate_limited(change: Array, wall: Array, max_change: float) -> Array:
    """Limit a change of torque to `max_change` at every joint, shape (n,), in Nm.

    It is shortened without a change of direction, except for joints with a torque at
    their limits: their changes are not delayed by other joints.

    Parameters
    ----------
    change : array, shape (n,)
        Desired minus previous joint torque, Nm.
    wall : array, shape (n,)
        Of `wall_torque`, Nm.
    max_change : float
        As for `rate_scale`.
    """
    limited = rate_scale(change, max_change) * change
    for i in range(len(change)):
        if wall[i] != 0:
            limited[i] = min(max(change[i], -max_change), max_change)
    return limited


@compiled
def clipped(torque: Array, lower: Array, upper: Array) -> Array:
    """Return a torque within limits of each joint; all have shape (n,), in Nm."""
    result = np.empty(len(torque))
    for i in range(len(torque)):
        result[i] = min(max(torque[i], lower[i]), upper[i])
    return result


class LimitedTorque(NamedTuple):
    """Torque within all limits, and the limits that were active.

    Attributes
    ----------
    torque : array, shape (n,)
        Nm.
    torque_scale, rate_scale : float
        Factors by which the torque and its change were shortened.
    at_wall, too_fast : bool
        Whether a joint is near its limit, and whether one is braked.
    overspeed : bool
        See `speed_limited`.
    """

    torque: Array
    torque_scale: float
    rate_scale: float
    at_wall: bool
    too_fast: bool
    overspeed: bool


@compiled
def speed_limited(
    limits: JointLimits,
    torque: Array,
    previous: Array,
    max_change: float,
    period: float,
    v: Array,
    M: Array,
    Cv: Array,
    wall: Array,
) -> tuple[Array, bool]:
    """Replace a torque after which no torque could keep the joints' speed limits.

    The torque changes by at most `max_change` an update. An acceleration therefore lasts
    until the torque has returned to ``C v``, the torque without acceleration. Where a
    joint would exceed 95 % of its speed limit by then, the torque returns at once, and
    then damps the joints; the other 5 % are a margin for contact and friction. A torque
    is thus applied only where the next update can still return from it. The torque at
    the joint limits remains where it brakes.

    Parameters
    ----------
    limits : JointLimits
    torque, previous, max_change
        As for `limited_torque`; the torque is within its limits.
    period : float
        Time between updates, s.
    v : array, shape (n,)
        Joint velocities, rad/s.
    M : array, shape (n, n)
        Mass matrix, kg m².
    Cv : array, shape (n,)
        Coriolis and centrifugal torque, Nm.
    wall : array, shape (n,)
        Of `wall_torque`, Nm.

    Returns
    -------
    torque : array, shape (n,)
        Nm.
    overspeed : bool
        Whether a joint exceeds its limit now, or would have done so.
    """
    L, _ = cholesky(M)
    root = solve_lower(L, np.eye(len(v)))
    effort = torque - Cv
    acceleration = applied(root.T, applied(root, effort))
    greatest = 0.0
    for i in range(len(v)):
        greatest = max(greatest, abs(effort[i]))
    duration = period * (1 + 0.5 * greatest / max_change)
    overspeed = unavoidable = False
    for i in range(len(v)):
        # A torque that already slows the joint down is not changed.
        predicted_v = v[i] + duration * acceleration[i]
        most = _SPEED_FRACTION * limits.speed[i]
        unavoidable |= abs(predicted_v) > most and predicted_v * acceleration[i] > 0
        overspeed |= abs(v[i]) > limits.speed[i]
    if not unavoidable:
        return torque, overspeed
    change = Cv - previous
    for i in range(len(v)):
        if wall[i] * v[i] < 0:
            change[i] += wall[i]
        # Keep a torque that brakes more: a contact may accelerate the joint as well.
        if wall[i] != 0 and v[i] * (torque[i] - previous[i] - change[i]) < 0:
            change[i] = torque[i] - previous[i]
    if rate_scale(change, max_change) == 1:
        change -= applied(M, v) / _STOPPING_TIME
    return previous + rate_limited(change, wall, max_change), True


@compiled
def limited_torque(
    config: JointWallConfig,
    limits: JointLimits,
    torque: Array,
    previous: Array,
    max_change: float,
    period: float,
    q: Array,
    v: Array,
    M: Array,
    Cv: Array,
    weight: Array,
) -> LimitedTorque:
    """Limit a torque and its change, and add the torque at the joint limits.

    Both the torque and its sum with the weight stay within the effort limits.

    Parameters
    ----------
    config, limits, q, v
        As for `wall_torque`.
    torque, previous : array, shape (n,)
        Desired, and of the previous update, Nm.
    max_change : float
        As for `rate_scale`.
    period, M, Cv
        As for `speed_limited`.
    weight : array, shape (n,)
        Generalized force of gravity, which the motors counter, Nm.
    """
    lower, upper = limits.lower_effort.copy(), limits.upper_effort.copy()
    inertia = np.empty(len(q))
    for i in range(len(q)):
        low = min(_EFFORT_FRACTION * lower[i] + weight[i], _EFFORT_RESERVE * lower[i])
        high = max(_EFFORT_FRACTION * upper[i] + weight[i], _EFFORT_RESERVE * upper[i])
        lower[i], upper[i] = max(low, lower[i]), min(high, upper[i])
        inertia[i] = M[i, i]
    scale = torque_scale(torque, lower, upper)
    torque = scale * torque
    wall = wall_torque(config, limits, q, v, inertia)
    if wall.at_wall or wall.too_fast:
        torque = clipped(torque + wall.torque, lower, upper)
    change = torque - previous
    rate_factor = rate_scale(change, max_change)
    # The limits have changed with the weight since the previous torque.
    change = rate_limited(change, wall.torque, max_change)
    torque = clipped(previous + change, lower, upper)
    torque, overspeed = speed_limited(
        limits, torque, previous, max_change, period, v, M, Cv, wall.torque
    )
    if overspeed:
        torque = clipped(torque, lower, upper)
    return LimitedTorque(
        torque, scale, rate_factor, wall.at_wall, wall.too_fast, overspeed
    )


# Friction.


@dataclass(kw_only=True)
class FrictionConfig:
    """Friction of joints, a sigmoid of their velocities.

    Its form is that of [1]_. A station replaces an empty list by the values of its robot.

    Attributes
    ----------
    enabled : bool
    gain : float
        Factor of the friction: 1 to simulate it, somewhat less to compensate for it,
        because overcompensation makes the joints run away.
    height : list of floats
        φ1 of each joint, Nm.
    slope : list of floats
        φ2, s/rad.
    shift : list of floats
        φ3, rad/s.

    References
    ----------
    .. [1] C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, "Dynamic
       identification of the Franka Emika Panda robot with retrieval of feasible
       parameters using penalty-based optimization", IEEE RA-L 4(4), 2019.

    Examples
    --------
    >>> robot = FrictionConfig(height=[0.5, 0.3], slope=[5.0, 9.0], shift=[0.0, 0.0])
    >>> FrictionConfig(enabled=True, gain=0.9).completed(robot).height
    [0.5, 0.3]
    """

    enabled: bool = False
    gain: float = bounded(1.0, least=0)
    height: list[float] = bounded([], least=0)
    slope: list[float] = bounded([], least=0)
    shift: list[float] = bounded([])

    def completed(self, robot: Self) -> Self:
        """Return a copy with the numbers of a robot in place of empty lists."""
        names = ("height", "slope", "shift")
        lists = {name: getattr(self, name) or getattr(robot, name) for name in names}
        return replace(self, **lists)


class SigmoidFriction(NamedTuple):
    """The parameters of the joints' friction, see `friction_torque`.

    Attributes
    ----------
    height, slope, shift : array, shape (n,)
        φ1 in Nm, φ2 in s/rad and φ3 in rad/s.
    """

    height: Array
    slope: Array
    shift: Array

    @classmethod
    def of(cls, config: FrictionConfig, *, n: int, name: str = "friction") -> Self:
        """Check a configuration, called `name` in errors, for an arm of n joints.

        Raises
        ------
        SystemsError
            If a list does not have n finite numbers, or one has the wrong sign.
        """
        check_settings(config, SystemsError, f"{name}.")
        lists = (config.height, config.slope, config.shift)
        for part, values in zip(("height", "slope", "shift"), lists, strict=True):
            if len(values) != n:
                raise SystemsError(
                    f"{name}.{part} must be {n} numbers, one per joint, got {values}"
                )
        height, slope, shift = np.array(lists, dtype=float)
        return cls(config.gain * height, slope, shift)


@compiled
def friction_torque(friction: SigmoidFriction, v: Array) -> Array:
    """Return the friction torque, shape (n,) in Nm, at velocities in rad/s.

    ``τ = φ1 / (1 + exp(−φ2 (v + φ3))) − φ1 / (1 + exp(−φ2 φ3))``: zero at rest,
    against the motion where it is subtracted, and bounded by φ1.
    """
    # 1 / (1 + exp(−x)) = (1 + tanh(x / 2)) / 2, which does not overflow.
    half = 0.5 * friction.slope
    moving = np.tanh(half * (v + friction.shift))
    return 0.5 * friction.height * (moving - np.tanh(half * friction.shift))
