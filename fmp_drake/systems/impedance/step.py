"""One update of the impedance controller, as a function of arrays."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.error import continued, task_error
from fmp_drake.systems.impedance.force_control import (
    ForceCorrection,
    ForceState,
    correct_press,
)
from fmp_drake.systems.impedance.friction import SigmoidFriction
from fmp_drake.systems.impedance.gains import ImpedanceGains
from fmp_drake.systems.impedance.hold import HeldModel, ModelHold, linearized, reach_of
from fmp_drake.systems.impedance.inputs import ArmMeasurement, StepInputs
from fmp_drake.systems.impedance.law import impedance_law
from fmp_drake.systems.impedance.limits import rate_scale, torque_scale
from fmp_drake.systems.impedance.memory import ImpedanceMemory
from fmp_drake.systems.impedance.status import StatusFlag
from fmp_drake.systems.impedance.stiffness import (
    is_covariance,
    spring_of,
    stiffness_from_covariance,
)
from fmp_drake.systems.impedance.supervision import (
    filter_share,
    filtered_target,
    held_target,
    target_faults,
    watched,
)
from fmp_drake.systems.impedance.tank import admit_stiffness, refill
from fmp_drake.systems.impedance.target import carried
from fmp_drake.systems.impedance.walls import JointLimits, wall_torque
from fmp_drake.systems.impedance.watchdog import WatchdogMode, WatchdogState

Array = NDArray[np.float64]

# Plain integers, because enumerations are slow to combine.
_CONTACT_LOST = int(StatusFlag.CONTACT_LOST)
_ERROR_CLIPPED = int(StatusFlag.ERROR_CLIPPED)
_FORCE_CONTROL = int(StatusFlag.FORCE_CONTROL)
_FORCE_LIMITED = int(StatusFlag.FORCE_LIMITED)
_HOLD = int(StatusFlag.HOLD)
_JOINT_WALL = int(StatusFlag.JOINT_WALL)
_NEAR_SINGULAR = int(StatusFlag.NEAR_SINGULAR)
_NO_STATE = int(StatusFlag.NO_STATE)
_RATE_LIMITED = int(StatusFlag.RATE_LIMITED)
_RECOVER = int(StatusFlag.RECOVER)
_SPEED_LIMITED = int(StatusFlag.SPEED_LIMITED)
_STIFFNESS_REFUSED = int(StatusFlag.STIFFNESS_REFUSED)
_TANK_EMPTY = int(StatusFlag.TANK_EMPTY)
_TORQUE_LIMITED = int(StatusFlag.TORQUE_LIMITED)
# With no other flag the law may be held.
_ORDINARY = _FORCE_CONTROL | _CONTACT_LOST | _FORCE_LIMITED


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
    hold : ModelHold
        Between full updates.
    """

    config: ImpedanceConfig
    gains: ImpedanceGains
    limits: JointLimits
    lower: Array
    upper: Array
    q_posture: Array
    friction: SigmoidFriction | None
    hold: ModelHold


class StepResult(NamedTuple):
    """What an update leaves behind: `status` is the vector of `ImpedanceStatus`.

    `model` serves until the next full update; None where something is out of the
    ordinary, so that the next update is a full one.
    """

    torque: Array
    status: tuple[float, ...]
    memory: ImpedanceMemory
    model: HeldModel | None


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
    flags, last, frozen_time = target_faults(config, memory, inputs)
    watchdog, hold = watched(config, memory, arm, inputs, fault=flags != 0)
    share, rate = watchdog.blend()
    if watchdog.mode != WatchdogMode.TRACK:
        held = watchdog.mode == WatchdogMode.HOLD
        flags |= _HOLD if held else _RECOVER

    target, filtered = inputs.target, None
    error = arm.error
    if config.target_time_constant > 0:
        target, filtered = filtered_target(config, memory, inputs)
    if inputs.frame_twist is not None and share > 0:
        target = carried(target, inputs.frame_twist, inputs.frame_acceleration)
    if share < 1:
        target = held_target(target, inputs, hold, share=share, rate=rate)
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
    # Where there is room to a joint's limits there is no wall.
    q, v = arm.q, arm.dynamics.v
    reach = reach_of(config.walls, settings.limits, q=q, v=v)
    wall = None
    if reach is None:
        inertia = arm.dynamics.M.diagonal()
        wall = wall_torque(config.walls, settings.limits, q=q, v=v, inertia=inertia)
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
    model = None
    if settings.hold.used and reach is not None and not flags & ~_ORDINARY:
        model = HeldModel(
            law.torque,
            *linearized(
                gains,
                arm.dynamics,
                law,
                desired_twist=target.V,
                desired_acceleration=target.A,
                desired_jerk=inputs.jerk if filtered is None else None,
            ),
            np.concatenate((q, v)),
            np.array(reach),
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
                dissipated=law.dissipation * inputs.elapsed,
            ),
            frozen_time,
            scale < 1,
            last,
            hold,
            filtered,
            memory.stiffness if K is settings.gains.stiffness else K.ravel(),
            error[:3],
        ),
        model,
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
        None,
    )


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
    share = filter_share(inputs.elapsed, config.stiffness_time_constant)
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
        period=inputs.elapsed,
    )


_OPEN = ForceCorrection(0.0, ForceState(), False, False, False)
