"""Limits of the torque and its change, and walls at the limits of the joints."""

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled

Array = NDArray[np.float64]

# The part of the efforts that is used, because the weight changes until the next
# update, and the part that is left where the weight alone needs all.
_USED, _LEFT = 0.99, 0.01


@dataclass(kw_only=True)
class JointWallConfig:
    """How the joints are kept within the limits of position and speed.

    The limits themselves, and with them the walls' strength, are the model's.

    Attributes
    ----------
    width : float
        Length of the spring in front of a limit, rad. It is as strong as the
        joint's effort limit in the middle of it.
    braking_acceleration : float
        A joint on its way to a wall may be as fast as it can be stopped at with
        this, rad/s².
    speed_fraction : float
        Part of the model's velocity limit from which on a joint is braked.
    braking_time : float
        Time constant at which speed above what is allowed goes, s.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> config = ImpedanceConfig(walls=JointWallConfig(width=0.05))
    >>> config.check()
    """

    width: float = 0.1
    braking_acceleration: float = 5.0
    speed_fraction: float = 0.85
    braking_time: float = 0.01


class JointLimits(NamedTuple):
    """The joints' ranges, infinite where there is no limit.

    Parameters
    ----------
    middle, half_range : array, shape (n,)
        Of the position, rad; the middle is 0 where there is no limit.
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
    def between(
        cls,
        lower: Array,
        upper: Array,
        *,
        speed: Array,
        lower_effort: Array,
        upper_effort: Array,
    ) -> Self:
        """Make them from a lower and an upper limit of the position, rad."""
        two_sided = np.isfinite(lower) & np.isfinite(upper)
        middle = np.zeros(len(lower))
        middle[two_sided] = 0.5 * (lower[two_sided] + upper[two_sided])
        half_range = np.minimum(upper - middle, middle - lower)
        return cls(middle, half_range, speed, lower_effort, upper_effort)


class WallTorque(NamedTuple):
    """The torque of the walls in Nm, shape (n,), and which kind there is of it."""

    torque: Array
    at_wall: bool
    too_fast: bool


@compiled
def wall_torque(
    config: JointWallConfig, limits: JointLimits, q: Array, v: Array, inertia: Array
) -> WallTorque:
    """Compute what keeps the joints within their limits; zero where none is near.

    Each joint gets ``−k depth`` in the last `width` of its range, and is braked by
    ``−(m / t) (v − v_allowed)``, where ``v_allowed² = 2 a room``: the nearer the
    limit, the slower. Inside the wall both directions are damped: it is a spring and
    a damper, and generates no energy.

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
        room = limits.half_range[i] - abs(x)
        depth = min(max(config.width - room, 0.0), config.width) / config.width
        strength = min(limits.upper_effort[i], -limits.lower_effort[i])
        if not math.isfinite(strength):
            strength = inertia[i] / config.braking_time**2
        # The speed towards the limit, and what is too much of it.
        speed = side * v[i]
        most = config.speed_fraction * limits.speed[i]
        stoppable = math.sqrt(
            2 * config.braking_acceleration * max(room - config.width, 0.0)
        )
        excess = max(speed - min(most, stoppable), 0.0) + min(speed + most, 0.0)
        # The wall gives back little of what it took.
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
        Wanted minus previous joint torque, Nm.
    max_change : float
        Greatest change of any joint, Nm.
    """
    greatest = max_change
    for i in range(len(change)):
        greatest = max(greatest, abs(change[i]))
    return max_change / greatest


class LimitedTorque(NamedTuple):
    """A torque that may be commanded, and what limited it.

    Attributes
    ----------
    torque : array, shape (n,)
        Nm.
    torque_scale, rate_scale : float
        Factors by which the torque and its change were shortened.
    at_wall, too_fast : bool
        Whether a joint is near its limit, and whether one is braked.
    """

    torque: Array
    torque_scale: float
    rate_scale: float
    at_wall: bool
    too_fast: bool


@compiled
def limited_torque(
    config: JointWallConfig,
    limits: JointLimits,
    torque: Array,
    previous: Array,
    max_change: float,
    q: Array,
    v: Array,
    inertia: Array,
    weight: Array,
) -> LimitedTorque:
    """Keep a torque within the efforts, the joints off their limits, its change small.

    The motors bear the weight besides: the torque and the sum stay within the efforts.

    Parameters
    ----------
    config, limits, q, v, inertia
        As for `wall_torque`.
    torque, previous : array, shape (n,)
        Wanted, and of the update before, Nm.
    max_change : float
        As for `rate_scale`.
    weight : array, shape (n,)
        Generalized force of gravity, which the motors counter, Nm.
    """
    lower, upper = limits.lower_effort, limits.upper_effort
    lower = np.maximum(np.minimum(_USED * lower + weight, _LEFT * lower), lower)
    upper = np.minimum(np.maximum(_USED * upper + weight, _LEFT * upper), upper)
    scale = torque_scale(torque, lower, upper)
    torque = scale * torque
    wall = wall_torque(config, limits, q, v, inertia)
    if wall.at_wall or wall.too_fast:
        torque = np.minimum(np.maximum(torque + wall.torque, lower), upper)
    change = torque - previous
    slowness = rate_scale(change, max_change)
    # The box has moved with the arm since the previous torque.
    torque = np.minimum(np.maximum(previous + slowness * change, lower), upper)
    return LimitedTorque(torque, scale, slowness, wall.at_wall, wall.too_fast)
