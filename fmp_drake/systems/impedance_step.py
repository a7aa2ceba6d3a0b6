"""One update of the impedance controller, as a function of arrays."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.systems.impedance_config import ImpedanceConfig
from fmp_drake.systems.impedance_error import continued, task_error
from fmp_drake.systems.impedance_force import ForceCorrection, ForceState, correct_press
from fmp_drake.systems.impedance_friction import SigmoidFriction
from fmp_drake.systems.impedance_gains import ImpedanceGains
from fmp_drake.systems.impedance_law import ArmDynamics, impedance_law
from fmp_drake.systems.impedance_limits import rate_scale, torque_scale
from fmp_drake.systems.impedance_memory import ImpedanceMemory, packed, unpacked
from fmp_drake.systems.impedance_status import StatusFlag
from fmp_drake.systems.impedance_stiffness import (
    is_covariance,
    spring_of,
    stiffness_from_covariance,
)
from fmp_drake.systems.impedance_tank import admit_stiffness, refill
from fmp_drake.systems.impedance_target import TaskTarget, blend, carried, low_pass
from fmp_drake.systems.impedance_walls import JointLimits, wall_torque
from fmp_drake.systems.impedance_watchdog import WatchdogMode, WatchdogState, watch

Array = NDArray[np.float64]

# Plain integers, because enumerations are slow to combine.
_CONTACT_LOST = int(StatusFlag.CONTACT_LOST)
_ERROR_CLIPPED = int(StatusFlag.ERROR_CLIPPED)
_FORCE_CONTROL = int(StatusFlag.FORCE_CONTROL)
_FORCE_LIMITED = int(StatusFlag.FORCE_LIMITED)
_HOLD = int(StatusFlag.HOLD)
_JOINT_WALL = int(StatusFlag.JOINT_WALL)
_JUMP = int(StatusFlag.JUMP)
_NEAR_SINGULAR = int(StatusFlag.NEAR_SINGULAR)
_NOT_FINITE = int(StatusFlag.NOT_FINITE)
_NO_STATE = int(StatusFlag.NO_STATE)
_RATE_LIMITED = int(StatusFlag.RATE_LIMITED)
_RECOVER = int(StatusFlag.RECOVER)
_SPEED_LIMITED = int(StatusFlag.SPEED_LIMITED)
_STALE = int(StatusFlag.STALE)
_STIFFNESS_REFUSED = int(StatusFlag.STIFFNESS_REFUSED)
_TANK_EMPTY = int(StatusFlag.TANK_EMPTY)
_TORQUE_LIMITED = int(StatusFlag.TORQUE_LIMITED)
# Slower targets, in m/s, may be constant up to rounding.
_STILL = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class StepSettings:
    """What stays the same from update to update.

    Attributes
    ----------
    config : ImpedanceConfig
        A copy of its own.
    gains : ImpedanceGains
        Made from it.
    limits : JointLimits
        The model's.
    lower, upper : array, shape (n,)
        Effort limits of the model, Nm.
    q_posture : array, shape (n,)
        rad.
    friction : SigmoidFriction or None
        What is compensated.
    """

    config: ImpedanceConfig
    gains: ImpedanceGains
    limits: JointLimits
    lower: Array
    upper: Array
    q_posture: Array
    friction: SigmoidFriction | None


class ArmMeasurement(NamedTuple):
    """The arm at one finite state.

    Attributes
    ----------
    q : array, shape (n,)
        rad.
    dynamics : ArmDynamics
    R_TE : array, shape (3, 3)
    p_TE : array, shape (3,)
        m.
    error : array, shape (6,)
        What `task_error` gives for the target as it comes in.
    """

    q: Array
    dynamics: ArmDynamics
    R_TE: Array
    p_TE: Array
    error: Array


class StepInputs(NamedTuple):
    """What came in at the ports; None where a port is not used.

    Attributes
    ----------
    target : TaskTarget
        Relative to T.
    wrench : array, shape (6,)
        Feed-forward, Nm and N, in T.
    finite : bool
        Whether every input besides the state is.
    turning : bool
        Whether the target's orientation may change.
    age : float or None
        Of the target, s.
    R_WT : array, shape (3, 3)
    p_WT : array, shape (3,)
        m.
    moving_frame : bool
        Whether T may move.
    frame_twist : array, shape (6,), or None
        V_WT in T's axes.
    frame_acceleration : array, shape (6,)
        A_WT in T's axes.
    stiffness : array, shape (6,) or (36,), or None
    covariance : array, shape (9,), or None
        m².
    normal_force : float or None
        N.
    """

    target: TaskTarget
    wrench: Array
    finite: bool
    turning: bool
    age: float | None
    R_WT: Array
    p_WT: Array
    moving_frame: bool
    frame_twist: Array | None
    frame_acceleration: Array
    stiffness: Array | None
    covariance: Array | None
    normal_force: float | None


class StepResult(NamedTuple):
    """What an update leaves behind: `status` is the vector of `ImpedanceStatus`."""

    torque: Array
    status: tuple[float, ...]
    memory: ImpedanceMemory


def impedance_step(
    settings: StepSettings,
    memory: ImpedanceMemory,
    *,
    arm: ArmMeasurement | None,
    inputs: StepInputs,
    previous: Array,
) -> StepResult:
    """Compute the next torque.

    Parameters
    ----------
    settings : StepSettings
    memory : ImpedanceMemory
        Of the update before; not changed.
    arm : ArmMeasurement or None
        None where the state is not finite: the torque goes to zero then.
    inputs : StepInputs
    previous : array, shape (n,)
        The torque of the update before, Nm.

    Returns
    -------
    StepResult
    """
    if arm is None:
        return _without_state(settings, memory, previous)
    config, gains = settings.config, settings.gains
    flags, last, frozen_time = _faults(config, memory, inputs)
    watchdog, hold = _watch(config, memory, arm, inputs, fault=flags != 0)
    share, rate = watchdog.blend()
    if watchdog.mode != WatchdogMode.TRACK:
        held = watchdog.mode == WatchdogMode.HOLD
        flags |= _HOLD if held else _RECOVER

    target, filtered = inputs.target, None
    error = arm.error
    if config.target_time_constant > 0:
        target, filtered = _filtered(config, memory, inputs)
    if inputs.frame_twist is not None and share > 0:
        target = carried(target, inputs.frame_twist, inputs.frame_acceleration)
    if share < 1:
        target = _held(target, inputs, hold, share=share, rate=rate)
    if share < 1 or filtered is not None:
        error = task_error(
            R_TE=arm.R_TE, p_TE=arm.p_TE, R_TE_desired=target.R, p_TE_desired=target.p
        )

    error = continued(error, memory.rotation_error)
    K, energy, stiffness_flags = _stiffness(settings, memory, inputs, error)
    flags |= stiffness_flags
    wrench = inputs.wrench
    press = _press(config, memory, inputs, share=share)
    if share < 1:
        wrench = share * wrench if share > 0 else np.zeros(6)
    if press.correction != 0:
        wrench = wrench.copy()
        wrench[5] -= press.correction
    law = impedance_law(
        gains,
        arm.dynamics,
        error=error,
        desired_twist=target.V,
        desired_acceleration=target.A,
        feedforward_wrench=wrench,
        posture_error=settings.q_posture - arm.q,
        stiffness=K,
    )
    torque = law.torque
    if settings.friction is not None:
        torque = torque + settings.friction.torque(arm.dynamics.v)
    if not math.isfinite(sum(torque.tolist())):
        return _without_state(settings, memory, previous)

    scale = torque_scale(torque, lower=settings.lower, upper=settings.upper)
    if scale < 1:
        torque = scale * torque
    wall = wall_torque(
        config.walls,
        settings.limits,
        q=arm.q,
        v=arm.dynamics.v,
        inertia=arm.dynamics.M.diagonal(),
    )
    if wall is not None:
        torque = np.clip(torque + wall.torque, settings.lower, settings.upper)
        flags |= _JOINT_WALL * wall.at_wall | _SPEED_LIMITED * wall.too_fast
    change = torque - previous
    slowness = rate_scale(
        change, max_change=config.max_torque_rate * config.control_period
    )
    if slowness < 1:
        torque = previous + slowness * change
        flags |= _RATE_LIMITED
    flags |= (
        _ERROR_CLIPPED * law.clipped
        | _NEAR_SINGULAR * law.near_singular
        | _TORQUE_LIMITED * (scale < 1)
        | _FORCE_CONTROL * press.closed
        | _CONTACT_LOST * press.lost
        | _FORCE_LIMITED * press.limited
    )
    return StepResult(
        torque,
        (float(flags), share, scale, slowness, press.correction, energy),
        ImpedanceMemory(
            watchdog,
            press.state,
            refill(
                config.tank,
                energy,
                dissipated=law.dissipation * config.control_period,
            ),
            frozen_time,
            scale < 1,
            last,
            hold,
            filtered,
            memory.stiffness if K is settings.gains.stiffness else K.ravel(),
            error[:3],
        ),
    )


def _without_state(
    settings: StepSettings, memory: ImpedanceMemory, previous: Array
) -> StepResult:
    """Bring the torque to zero: nothing can be said about the arm."""
    config = settings.config
    slowness = rate_scale(
        -previous, max_change=config.max_torque_rate * config.control_period
    )
    flags = _HOLD | _NO_STATE
    return StepResult(
        (1 - slowness) * previous,
        (float(flags), 0.0, 1.0, slowness, 0.0, memory.tank_energy),
        ImpedanceMemory(
            WatchdogState(WatchdogMode.LOST),
            ForceState(),
            memory.tank_energy,
            0.0,
            False,
            memory.last,
            memory.hold,
            None,
            memory.stiffness,
            np.zeros(3),
        ),
    )


def _faults(
    config: ImpedanceConfig, memory: ImpedanceMemory, inputs: StepInputs
) -> tuple[int, Array | None, float]:
    """Return the flags of what is wrong, the target to compare with, frozen time."""
    target, last = inputs.target, memory.last
    if not inputs.finite:
        return _NOT_FINITE, last, 0.0
    watchdog = config.watchdog
    p, R = target.p, target.R
    if inputs.moving_frame:
        p = np.dot(inputs.R_WT, p) + inputs.p_WT
        R = np.dot(inputs.R_WT, R)
    turns = inputs.turning or inputs.moving_frame
    present = np.concatenate((p, R.ravel())) if turns else p
    if last is None:
        return 0, present, 0.0
    flags, frozen_time = 0, 0.0
    dx, dy, dz = (p - last[:3]).tolist()
    x, y, z = target.V[3:].tolist()
    moved = math.sqrt(dx * dx + dy * dy + dz * dz)
    speed = math.sqrt(x * x + y * y + z * z)
    if moved > watchdog.max_jump + speed * config.control_period or (
        turns and _angle(R.ravel(), last[3:]) > watchdog.max_turn
    ):
        flags |= _JUMP
    if inputs.age is None:
        if moved == 0 and speed > _STILL:
            frozen_time = memory.frozen_time + config.control_period
        old = frozen_time > watchdog.max_age
    else:
        old = inputs.age > watchdog.max_age
    if old:
        flags |= _STALE
    return flags, present, frozen_time


def _angle(R: Array, S: Array) -> float:
    """Return the angle between two rotations, given by their nine elements."""
    return math.acos(min(max(0.5 * (float(np.dot(R, S)) - 1), -1.0), 1.0))


def _watch(
    config: ImpedanceConfig,
    memory: ImpedanceMemory,
    arm: ArmMeasurement,
    inputs: StepInputs,
    *,
    fault: bool,
) -> tuple[WatchdogState, Array]:
    """Return the watchdog's state and the pose that it holds."""
    state, hold = memory.watchdog, memory.hold
    if state.mode == WatchdogMode.TRACK and not fault:
        return state, hold
    distance = angle = 0.0
    if state.mode == WatchdogMode.HOLD and not fault:
        R_WE, p_WE = inputs.target.R, inputs.target.p
        R_WE, p_WE = np.dot(inputs.R_WT, R_WE), np.dot(inputs.R_WT, p_WE) + inputs.p_WT
        distance = float(np.linalg.norm(p_WE - hold[:3]))
        angle = _angle(R_WE.ravel(), hold[3:])
    state = watch(
        config.watchdog,
        state,
        fault=fault,
        distance=distance,
        angle=angle,
        period=config.control_period,
    )
    if state.mode == WatchdogMode.HOLD and memory.watchdog.mode != WatchdogMode.HOLD:
        R_WT, p_WT = inputs.R_WT, inputs.p_WT
        hold = np.empty(12)
        hold[:3] = np.dot(R_WT, arm.p_TE) + p_WT
        hold[3:] = np.dot(R_WT, arm.R_TE).ravel()
    return state, hold


def _held(
    target: TaskTarget, inputs: StepInputs, hold: Array, *, share: float, rate: float
) -> TaskTarget:
    """Return the held pose, or what is between it and the target."""
    R_TW = inputs.R_WT.T
    R = np.dot(R_TW, hold[3:].reshape(3, 3))
    p = np.dot(R_TW, hold[:3] - inputs.p_WT)
    if share == 0 and rate == 0:
        return TaskTarget(R, p, np.zeros(6), np.zeros(6))
    return blend(target, R_TE=R, p_TE=p, share=share, rate=rate)


def _filtered(
    config: ImpedanceConfig, memory: ImpedanceMemory, inputs: StepInputs
) -> tuple[TaskTarget, Array | None]:
    """Return the filtered target, and it packed for the memory."""
    if not inputs.finite:
        return inputs.target, memory.filtered
    target = inputs.target
    if memory.filtered is not None:
        target = low_pass(
            unpacked(memory.filtered),
            target,
            _share(config.control_period, config.target_time_constant),
        )
    return target, packed(target)


def _share(period: float, time_constant: float) -> float:
    """Return the share of what is left that a filter goes in one period."""
    return 1 - math.exp(-period / time_constant) if time_constant > 0 else 1.0


def _stiffness(
    settings: StepSettings, memory: ImpedanceMemory, inputs: StepInputs, error: Array
) -> tuple[Array, float, int]:
    """Return K, the energy left in the tank, and flags."""
    config, K = settings.config, settings.gains.stiffness
    energy = memory.tank_energy
    varying = config.covariance_stiffness.enabled and inputs.covariance is not None
    if inputs.stiffness is None and not varying:
        return K, energy, 0
    present = memory.stiffness.reshape(6, 6)
    if not inputs.finite:
        return present, energy, 0
    flags = 0
    if inputs.stiffness is not None:
        given = spring_of(inputs.stiffness)
        if given is None:
            return present, energy, _STIFFNESS_REFUSED
        K = given
    if varying and inputs.covariance is not None:
        covariance = inputs.covariance.reshape(3, 3)
        if not is_covariance(covariance):
            return present, energy, _STIFFNESS_REFUSED
        K = stiffness_from_covariance(config.covariance_stiffness, covariance, K)
    share = _share(config.control_period, config.stiffness_time_constant)
    K, energy, held_back = admit_stiffness(
        present, present + share * (K - present), error=error, energy=energy
    )
    if held_back:
        flags |= _TANK_EMPTY
    return K, energy, flags


def _press(
    config: ImpedanceConfig,
    memory: ImpedanceMemory,
    inputs: StepInputs,
    *,
    share: float,
) -> ForceCorrection:
    """Return the correction of the press that is fed forward along −z."""
    if not config.force_control.enabled or inputs.normal_force is None:
        return _OPEN
    measured = inputs.normal_force if inputs.finite else 0.0
    return correct_press(
        config.force_control,
        memory.force,
        wanted=-float(inputs.wrench[5]) if share == 1 else 0.0,
        measured=measured,
        saturated=memory.saturated,
        period=config.control_period,
    )


_OPEN = ForceCorrection(0.0, ForceState(), False, False, False)
