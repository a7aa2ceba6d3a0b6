"""Which target the impedance controller follows: checked, held, filtered."""

import math

import numpy as np
from numpy.typing import NDArray

from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.inputs import ArmMeasurement, StepInputs
from fmp_drake.systems.impedance.memory import ImpedanceMemory, packed, unpacked
from fmp_drake.systems.impedance.status import StatusFlag
from fmp_drake.systems.impedance.target import TaskTarget, blend, low_pass
from fmp_drake.systems.impedance.watchdog import WatchdogMode, WatchdogState, watch

Array = NDArray[np.float64]

# Plain integers, because enumerations are slow to combine.
_JUMP = int(StatusFlag.JUMP)
_NOT_FINITE = int(StatusFlag.NOT_FINITE)
_STALE = int(StatusFlag.STALE)
# Slower targets, in m/s, may be constant up to rounding.
_STILL = 0.01


def target_faults(
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
    if moved > watchdog.max_jump + speed * inputs.elapsed or (
        turns and _angle(R.ravel(), last[3:]) > watchdog.max_turn
    ):
        flags |= _JUMP
    if inputs.age is None:
        if moved == 0 and speed > _STILL:
            frozen_time = memory.frozen_time + inputs.elapsed
        old = frozen_time > watchdog.max_age
    else:
        old = inputs.age > watchdog.max_age
    if old:
        flags |= _STALE
    return flags, present, frozen_time


def _angle(R: Array, S: Array) -> float:
    """Return the angle between two rotations, given by their nine elements."""
    return math.acos(min(max(0.5 * (float(np.dot(R, S)) - 1), -1.0), 1.0))


def watched(
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
        period=inputs.elapsed,
    )
    if state.mode == WatchdogMode.HOLD and memory.watchdog.mode != WatchdogMode.HOLD:
        R_WT, p_WT = inputs.R_WT, inputs.p_WT
        hold = np.empty(12)
        hold[:3] = np.dot(R_WT, arm.p_TE) + p_WT
        hold[3:] = np.dot(R_WT, arm.R_TE).ravel()
    return state, hold


def held_target(
    target: TaskTarget, inputs: StepInputs, hold: Array, *, share: float, rate: float
) -> TaskTarget:
    """Return the held pose, or what is between it and the target."""
    R_TW = inputs.R_WT.T
    R = np.dot(R_TW, hold[3:].reshape(3, 3))
    p = np.dot(R_TW, hold[:3] - inputs.p_WT)
    if share == 0 and rate == 0:
        return TaskTarget(R, p, np.zeros(6), np.zeros(6))
    return blend(target, R_TE=R, p_TE=p, share=share, rate=rate)


def filtered_target(
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
            filter_share(inputs.elapsed, config.target_time_constant),
        )
    return target, packed(target)


def filter_share(period: float, time_constant: float) -> float:
    """Return the share of what is left that a filter goes in one period."""
    return 1 - math.exp(-period / time_constant) if time_constant > 0 else 1.0
