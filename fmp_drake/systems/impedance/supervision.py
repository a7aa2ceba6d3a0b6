"""Watchdog of target and normal force: faults, protective stop and recovery."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array
from fmp_drake.settings import bounded
from fmp_drake.systems.impedance.algebra import Pose, TaskTarget, norm, rotation_angle
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.impedance.stiffness import filter_fraction

# Modes of the watchdog. LOST is a stop at an unknown pose, after an unknown state.
TRACKING, STOPPED, RECOVERING, LOST = range(4)

# Speed below which the position of a target may be constant up to rounding, m/s.
_MIN_SPEED = 0.01
# A target that moves by less than this fraction of its claimed velocity stands still.
_MOVING_FRACTION = 0.1
# Time constants of the band from 5 to 50 Hz in which a force oscillates, and of the mean
# of its square, s.
_BAND_SLOW, _BAND_FAST = 1 / (2 * math.pi * 5), 1 / (2 * math.pi * 50)
_MEAN_TIME = 0.3


@dataclass(kw_only=True)
class WatchdogConfig:
    """Limits of target and force, and speed of the recovery after a protective stop.

    Attributes
    ----------
    max_jump, max_rotation : float
        Greatest motion of the target from one update to the next, m and rad. The
        target's positions may differ from its integrated velocity by `max_jump`, over
        the time `max_age`.
    max_start_distance : float
        Greatest distance from the tool to the first target, m. A farther one begins
        with a protective stop, from which the arm recovers slowly.
    max_speed, max_angular_speed : float
        Greatest speed of the target in the world, m/s and rad/s.
    max_acceleration, max_angular_acceleration : float
        Greatest acceleration of the target in the world, m/s² and rad/s².
    max_stiffness, max_rotational_stiffness : float
        Greatest stiffness at the port `stiffness`, N/m and Nm/rad. Larger ones are
        refused, and the stiffness stays as it is.
    max_age : float
        Greatest age of the target, s, by the port `target_time` where it is connected.
        Otherwise the age is the time for which the position is constant although the
        velocity is not zero. A time in the future by more than this is a fault.
    max_excess_force : float
        Normal force beyond twice the desired one that causes a stop, N.
    max_force_oscillation : float
        Root mean square of the error of the normal force between 5 and 50 Hz that
        causes a stop, N. An excess is judged by the measured force only; an oscillation
        also by that of the law where no force is measured.
    settle_time : float
        Time without a fault after which the recovery begins, s.
    recovery_speed, recovery_angular_speed : float
        Greatest speed from the pose of the stop to the target, m/s, rad/s.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> config = ImpedanceConfig(watchdog=WatchdogConfig(max_jump=0.02))
    >>> config.watchdog.max_rotation
    0.3
    """

    max_jump: float = bounded(0.05, above=0)
    max_rotation: float = bounded(0.3, above=0)
    max_start_distance: float = bounded(0.6, above=0)
    max_speed: float = bounded(3.0, above=0)
    max_angular_speed: float = bounded(10.0, above=0)
    max_acceleration: float = bounded(50.0, above=0)
    max_angular_acceleration: float = bounded(200.0, above=0)
    max_stiffness: float = bounded(10_000.0, above=0)
    max_rotational_stiffness: float = bounded(500.0, above=0)
    max_age: float = bounded(0.1, above=0)
    max_excess_force: float = bounded(60.0, above=0)
    max_force_oscillation: float = bounded(12.0, above=0)
    settle_time: float = bounded(0.2, above=0)
    recovery_speed: float = bounded(0.2, above=0)
    recovery_angular_speed: float = bounded(0.8, above=0)


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
        Time for which it is constant although its velocity is not zero, s.
    X : Pose
        X_WE.
    drift : array, shape (3,)
        Recent motion that its velocity does not explain, in W, m.
    """

    known: bool
    frozen_time: float
    X: Pose
    drift: Array


class ForceRecord(NamedTuple):
    """Error of the normal force in the recent past, to detect excess and oscillation.

    Attributes
    ----------
    slow, fast : float
        Measured minus desired force, low-pass filtered at 5 and 50 Hz, N.
    power : float
        Mean square of their difference, N².
    """

    slow: float = 0.0
    fast: float = 0.0
    power: float = 0.0


@compiled
def target_faults(
    config: WatchdogConfig,
    last: LastTarget,
    measured: Pose,
    target: TaskTarget,
    age: float,
    period: float,
) -> tuple[int, LastTarget]:
    """Check a finite target for jumps, for its age, and for implausible motion.

    Parameters
    ----------
    config : WatchdogConfig
        As `values_of` returns it.
    last : LastTarget
        Of the previous update.
    measured : Pose
        X_WE of the tool, with which the first target is compared.
    target : TaskTarget
        Pose, velocity and acceleration of the target in the world, in W's axes.
    age : float
        Of the target, s; NaN where `target_time` is not connected.
    period : float
        Time between updates, s.

    Returns
    -------
    flags : int
        `StatusFlag.JUMP`, `StatusFlag.STALE` and `StatusFlag.IMPLAUSIBLE`.
    last : LastTarget
        For the next update.
    """
    V, A = target.V, target.A
    speed = norm(V[3:])
    flags, frozen_time, drift = 0, 0.0, np.zeros(3)
    if (
        speed > config.max_speed
        or norm(V[:3]) > config.max_angular_speed
        or norm(A[3:]) > config.max_acceleration
        or norm(A[:3]) > config.max_angular_acceleration
    ):
        flags |= StatusFlag.IMPLAUSIBLE.value
    if last.known:
        shift = target.X.p - last.X.p
        moved = norm(shift)
        if (
            moved > config.max_jump + speed * period
            or rotation_angle(target.X.R, last.X.R) > config.max_rotation
        ):
            flags |= StatusFlag.JUMP.value
        else:
            drift += max(1 - period / config.max_age, 0.0) * last.drift
            drift += shift - period * V[3:]
        if norm(drift) > config.max_jump:
            flags |= StatusFlag.IMPLAUSIBLE.value
        if math.isnan(age):
            if speed > _MIN_SPEED:
                frozen_time = last.frozen_time + period
                frozen_time -= moved / (_MOVING_FRACTION * speed)
                frozen_time = min(max(frozen_time, 0.0), config.max_age + 2 * period)
            age = frozen_time
    else:
        shift = target.X.p - measured.p
        if norm(shift) > config.max_start_distance:
            flags |= StatusFlag.JUMP.value
    if age > config.max_age:
        flags |= StatusFlag.STALE.value
    if age < -config.max_age:
        flags |= StatusFlag.IMPLAUSIBLE.value
    return flags, LastTarget(True, frozen_time, target.X, drift)


@compiled
def force_faults(
    config: WatchdogConfig,
    record: ForceRecord,
    error: float,
    desired: float,
    period: float,
) -> tuple[int, ForceRecord]:
    """Check the normal force for an excess, and for an oscillation from 5 to 50 Hz.

    Parameters
    ----------
    config : WatchdogConfig
        As `values_of` returns it.
    record : ForceRecord
        Of the previous update.
    error : float
        Normal force minus the desired one, N.
    desired : float
        Desired normal force, N; infinite where an excess is not judged.
    period : float
        Time between updates, s.

    Returns
    -------
    flags : int
        `StatusFlag.EXCESS_FORCE` and `StatusFlag.FORCE_OSCILLATION`.
    record : ForceRecord
        For the next update.
    """
    slow = record.slow + filter_fraction(period, _BAND_SLOW) * (error - record.slow)
    fast = record.fast + filter_fraction(period, _BAND_FAST) * (error - record.fast)
    power = (fast - slow) ** 2
    power = record.power + filter_fraction(period, _MEAN_TIME) * (power - record.power)
    flags = 0
    if fast > desired + config.max_excess_force:
        flags |= StatusFlag.EXCESS_FORCE.value
    if power > config.max_force_oscillation**2:
        flags |= StatusFlag.FORCE_OSCILLATION.value
    return flags, ForceRecord(slow, fast, power)


@compiled
def next_watchdog_state(
    config: WatchdogConfig,
    state: WatchdogState,
    fault: bool,
    distance: float,
    angle: float,
    period: float,
) -> WatchdogState:
    """Return the state of the watchdog after one update.

    Parameters
    ----------
    config : WatchdogConfig
        As `values_of` returns it.
    state : WatchdogState
        Of the previous update.
    fault : bool
        Whether there is a fault now.
    distance, angle : float
        From the pose at the stop to the target, m and rad; used in a stop.
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
    """Return the blend of held pose (0) and target (1), and its rate in 1/s.

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
        Of the previous update.
    held, measured, target : Pose
        X_WE at the stop, measured, and desired.
    fault : bool
        Whether there is a fault now.
    period : float
        Time between updates, s.
    """
    shift = target.p - held.p
    distance, angle = norm(shift), rotation_angle(target.R, held.R)
    next_state = next_watchdog_state(config, state, fault, distance, angle, period)
    stops_now = next_state.mode == STOPPED and state.mode != STOPPED
    return next_state, measured if stops_now else held
