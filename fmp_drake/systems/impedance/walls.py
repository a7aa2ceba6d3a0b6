"""Walls at the joints' limits: springs, dampers, and brakes in front of them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    speed_share : float
        Part of the model's velocity limit from which on a joint is braked.
    braking_time : float
        Time constant at which speed above what is allowed goes, s.
    """

    width: float = 0.1
    braking_acceleration: float = 5.0
    speed_share: float = 0.85
    braking_time: float = 0.02


class JointLimits(NamedTuple):
    """The joints' ranges, infinite where there is no limit.

    Parameters
    ----------
    middle, half_range : array, shape (n,)
        Of the position, rad; the middle is 0 where there is no limit.
    speed : array, shape (n,)
        rad/s.
    effort : array, shape (n,)
        Nm.
    numbers : list of n tuples
        Middle, half range and speed of each joint.
    """

    middle: Array
    half_range: Array
    speed: Array
    effort: Array
    numbers: list[tuple[float, float, float]]

    @classmethod
    def between(
        cls, lower: Array, upper: Array, *, speed: Array, effort: Array
    ) -> "JointLimits":
        """Make them from a lower and an upper limit of the position, rad."""
        two_sided = np.isfinite(lower) & np.isfinite(upper)
        middle = np.zeros(len(lower))
        middle[two_sided] = 0.5 * (lower[two_sided] + upper[two_sided])
        half_range = np.minimum(upper - middle, middle - lower)
        speed = np.array(speed)
        numbers = list(
            zip(middle.tolist(), half_range.tolist(), speed.tolist(), strict=True)
        )
        return cls(middle, half_range, speed, np.array(effort), numbers)


class WallTorque(NamedTuple):
    """The torque of the walls in Nm, shape (n,), and which kind there is of it."""

    torque: Array
    at_wall: bool
    too_fast: bool


def wall_torque(
    config: JointWallConfig,
    limits: JointLimits,
    *,
    q: Array,
    v: Array,
    inertia: Array,
) -> WallTorque | None:
    """Compute what keeps the joints within their limits.

    Each joint gets ``−k depth`` in the last `width` of its range, and is braked by
    ``−(m / t) (v − v_allowed)``, where ``v_allowed² = 2 a room``: the nearer the
    limit, the slower. Inside the wall both directions are damped: it is a spring and
    a damper, and generates no energy.

    Parameters
    ----------
    config : JointWallConfig
    limits : JointLimits
    q, v : array, shape (n,)
        Positions and velocities, rad and rad/s.
    inertia : array, shape (n,)
        Diagonal of the mass matrix, kg m².

    Returns
    -------
    WallTorque or None
        None where no joint is near a limit.
    """
    a = config.braking_acceleration
    # Plain numbers are faster than arrays here, and mostly this is all.
    half_a, share = 0.5 / a, config.speed_share
    for x, speed, (middle, half, most) in zip(
        q.tolist(), v.tolist(), limits.numbers, strict=True
    ):
        if (
            abs(x - middle) + half_a * speed * speed > half - config.width
            or abs(speed) > share * most
        ):
            break
    else:
        return None
    top = share * limits.speed
    x = q - limits.middle
    room = limits.half_range - np.abs(x)
    side = np.where(x < 0, -1.0, 1.0)
    depth = np.clip(config.width - room, 0.0, config.width)
    at_wall = depth > 0
    strength = np.where(
        np.isfinite(limits.effort), limits.effort, inertia / config.braking_time**2
    )
    torque = -side * (2 / config.width) * depth * strength
    outwards = np.minimum(top, np.sqrt(2 * a * np.maximum(room - config.width, 0.0)))
    speed = side * v
    excess = np.maximum(speed - outwards, 0.0) + np.minimum(speed + top, 0.0)
    # The wall gives back little of what it took.
    excess += np.minimum(speed, 0.0) * np.minimum((2 / config.width) * depth, 1.0)
    torque -= side * (inertia / config.braking_time) * excess
    return WallTorque(torque, bool(at_wall.any()), bool((excess != 0).any()))
