"""The watchdog: whether the target is followed, and how it is returned to."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from fmp_drake.compiled import compiled
from fmp_drake.systems.impedance.algebra import Pose, rotation_angle
from fmp_drake.systems.impedance.status import StatusFlag

# What the watchdog does. In a stop of which the pose is not known, because the state
# was not, the arm is lost.
TRACKING, STOPPED, RECOVERING, LOST = range(4)

_JUMP = int(StatusFlag.JUMP)
_STALE = int(StatusFlag.STALE)
# Slower targets, in m/s, may be constant up to rounding.
_STILL = 0.01


@dataclass(kw_only=True)
class WatchdogConfig:
    """When the target is not to be followed, and how it is returned to.

    Attributes
    ----------
    max_jump, max_rotation : float
        Farthest that the target may move from one update to the next, m and rad.
    max_age : float
        Oldest target, s: by the port `target_time` where it is connected, and else
        by how long the position has stood still although it has a velocity.
    settle_time : float
        How long the target must be good before it is followed again, s.
    recovery_speed, recovery_angular_speed : float
        Greatest speed at which the arm is led from where it was stopped to where the
        target is, m/s, rad/s.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> config = ImpedanceConfig(watchdog=WatchdogConfig(max_jump=0.02))
    >>> config.check()
    """

    max_jump: float = 0.05
    max_rotation: float = 0.3
    max_age: float = 0.1
    settle_time: float = 0.2
    recovery_speed: float = 0.2
    recovery_angular_speed: float = 0.8


class WatchdogState(NamedTuple):
    """The mode, the seconds spent in it, and the seconds that a recovery takes."""

    mode: int = TRACKING
    clock: float = 0.0
    duration: float = 0.0


class LastTarget(NamedTuple):
    """The last finite target, with which the next one is compared.

    Attributes
    ----------
    known : bool
        Whether there was one.
    frozen_time : float
        How long it has stood still although it has a velocity, s.
    X : Pose
        X_WE.
    """

    known: bool
    frozen_time: float
    X: Pose


@compiled
def target_faults(
    config: WatchdogConfig,
    last: LastTarget,
    X_WE: Pose,
    speed: float,
    age: float,
    period: float,
) -> tuple[int, LastTarget]:
    """Look for jumps and for old age in a finite target.

    Parameters
    ----------
    config : WatchdogConfig
        As `values_of` returns it.
    last : LastTarget
        Of the update before.
    X_WE : Pose
        The target in the world.
    speed : float
        That the target says it has, m/s.
    age : float
        Of the target, s; NaN where it does not tell.
    period : float
        Time between updates, s.

    Returns
    -------
    flags : int
        `StatusFlag.JUMP` and `StatusFlag.STALE`.
    last : LastTarget
        For the next update.
    """
    if not last.known:
        return 0, LastTarget(True, 0.0, X_WE)
    flags, frozen_time = 0, 0.0
    shift = X_WE.p - last.X.p
    moved = math.sqrt(shift @ shift)
    if (
        moved > config.max_jump + speed * period
        or rotation_angle(X_WE.R, last.X.R) > config.max_rotation
    ):
        flags |= _JUMP
    if math.isnan(age):
        if moved == 0 and speed > _STILL:
            frozen_time = last.frozen_time + period
        age = frozen_time
    if age > config.max_age:
        flags |= _STALE
    return flags, LastTarget(True, frozen_time, X_WE)


@compiled
def watch(
    config: WatchdogConfig,
    state: WatchdogState,
    fault: bool,
    distance: float,
    angle: float,
    period: float,
) -> WatchdogState:
    """Decide what to do at one update.

    Parameters
    ----------
    config : WatchdogConfig
        As `values_of` returns it.
    state : WatchdogState
        Of the update before.
    fault : bool
        Whether something is wrong with the target now.
    distance, angle : float
        From where the arm was stopped to the target, m and rad; used in a stop.
    period : float
        Time between updates, s.

    Returns
    -------
    WatchdogState
        Of this update.
    """
    if fault or state.mode == LOST:
        return WatchdogState(STOPPED, 0.0, 0.0)
    if state.mode == TRACKING:
        return state
    clock = state.clock + period
    if state.mode == STOPPED and clock >= config.settle_time:
        # A smooth step is 1.5 times as fast in its middle as on average.
        duration = 1.5 * max(
            distance / config.recovery_speed, angle / config.recovery_angular_speed
        )
        return WatchdogState(RECOVERING, 0.0, max(duration, config.settle_time))
    if state.mode == RECOVERING and clock >= state.duration:
        return WatchdogState(TRACKING, 0.0, 0.0)
    return WatchdogState(state.mode, clock, state.duration)


@compiled
def target_fraction(state: WatchdogState) -> tuple[float, float]:
    """Return how much of the target is followed, and its rate in 1/s.

    A smooth step over the time of a recovery, from 0 in a stop to 1.
    """
    if state.mode == TRACKING:
        return 1.0, 0.0
    if state.mode != RECOVERING:
        return 0.0, 0.0
    x = state.clock / state.duration
    return x * x * (3 - 2 * x), 6 * x * (1 - x) / state.duration


@compiled
def supervised(
    config: WatchdogConfig,
    state: WatchdogState,
    held: Pose,
    measured: Pose,
    target: Pose,
    fault: bool,
    period: float,
) -> tuple[WatchdogState, Pose]:
    """Return the watchdog's next state and the held pose.

    Parameters
    ----------
    config : WatchdogConfig
        As `values_of` returns it.
    state : WatchdogState
        Of the update before.
    held, measured, target : Pose
        X_WE where the arm was stopped, where it is, and where it is wanted.
    fault : bool
        Whether something is wrong with the target now.
    period : float
        Time between updates, s.
    """
    shift = target.p - held.p
    distance, angle = math.sqrt(shift @ shift), rotation_angle(target.R, held.R)
    watched = watch(config, state, fault, distance, angle, period)
    stopped_now = watched.mode == STOPPED and state.mode != STOPPED
    return watched, measured if stopped_now else held
