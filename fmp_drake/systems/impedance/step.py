"""One update of the impedance controller, as a function of arrays."""

import math

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled, inlined
from fmp_drake.systems.impedance.adaptation import next_stiffness
from fmp_drake.systems.impedance.algebra import Pose, compose, relative, twist_rotation
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.force_control import (
    ForceState,
    Press,
    approach_factor,
    correct_normal_force,
    engagement,
    is_beyond,
    with_force,
)
from fmp_drake.systems.impedance.friction import friction_torque
from fmp_drake.systems.impedance.law import ArmDynamics, impedance_law
from fmp_drake.systems.impedance.limits import limited_torque, rate_scale
from fmp_drake.systems.impedance.packing import (
    ImpedanceMemory,
    StepInputs,
    decode,
    encode,
    unpack,
)
from fmp_drake.systems.impedance.settings import (
    LAYOUT,
    ImpedanceSettings,
    JointSettings,
    of_joints,
)
from fmp_drake.systems.impedance.status import StatusFlag
from fmp_drake.systems.impedance.stiffness import (
    refill,
)
from fmp_drake.systems.impedance.supervision import (
    LOST,
    RECOVERING,
    STOPPED,
    LastTarget,
    WatchdogState,
    supervised,
    target_faults,
    target_fraction,
)
from fmp_drake.systems.impedance.target import (
    TaskTarget,
    blended,
    motion_in_world,
    task_error,
    unwrapped,
)

Array = NDArray[np.float64]

# Plain integers, because compiled functions take no enumerations.
_CONTACT_LOST = int(StatusFlag.CONTACT_LOST)
_ERROR_CLIPPED = int(StatusFlag.ERROR_CLIPPED)
_FORCE_CONTROL = int(StatusFlag.FORCE_CONTROL)
_FORCE_LIMITED = int(StatusFlag.FORCE_LIMITED)
_JOINT_WALL = int(StatusFlag.JOINT_WALL)
_NEAR_SINGULAR = int(StatusFlag.NEAR_SINGULAR)
_NOT_FOUND = int(StatusFlag.NOT_FOUND)
_NO_STATE = int(StatusFlag.NO_STATE)
_NOT_FINITE = int(StatusFlag.NOT_FINITE)
_PROTECTIVE_STOP = int(StatusFlag.PROTECTIVE_STOP)
_RATE_LIMITED = int(StatusFlag.RATE_LIMITED)
_RECOVER = int(StatusFlag.RECOVER)
_SPEED_LIMITED = int(StatusFlag.SPEED_LIMITED)
_TORQUE_LIMITED = int(StatusFlag.TORQUE_LIMITED)


@compiled
def impedance_step(
    settings: NDArray[np.uint8],
    joints: Array,
    packed: Array,
    time: float,
    previous: Array,
    memory: Array,
    known: bool,
    state: Array,
    M: Array,
    Cv: Array,
    X_WE: Array,
    J_WE: Array,
    A_WE_bias: Array,
    weight: Array,
) -> tuple[Array, Array, Array]:
    """Compute the next torque.

    It takes only numbers and arrays of them, because that is fastest, and the same types
    for every arm: it is compiled once.

    Parameters
    ----------
    settings : array of bytes
        What `settings_of` returned.
    joints : array, shape (9, n)
        What `joint_settings` returned.
    packed : array, shape (107,)
        The inputs, see `unpack`.
    time : float
        s.
    previous : array, shape (n,)
        The torque of the update before, Nm.
    memory : array, shape (73,)
        The vector of `ImpedanceMemory`, of the update before; not changed.
    known : bool
        Whether the state is finite; where it is not, the torque goes to zero.
    state : array, shape (2n,)
        ``[q, v]``, rad and rad/s.
    M : array, shape (n, n)
        Mass matrix, kg m².
    Cv : array, shape (n,)
        Coriolis and centrifugal torque, Nm.
    X_WE : array, shape (4, 3)
        Transposed R_WE, and below it p_WE in m.
    J_WE : array, shape (n, 6)
        Transposed Jacobian of V_WE.
    A_WE_bias : array, shape (6,)
        ``J̇ v``, rad/s² and m/s².
    weight : array, shape (n,)
        Generalized force of gravity, Nm; it is compensated elsewhere.

    Returns
    -------
    torque : array, shape (n,)
        Nm.
    status : array, shape (6,)
        The vector of `ImpedanceStatus`.
    memory : array, shape (73,)
        The vector of `ImpedanceMemory`.
    """
    every = settings.view(LAYOUT)[0]
    measured = Pose(np.ascontiguousarray(X_WE[:3].T), X_WE[3])
    arm = ArmDynamics(state[len(previous) :], M, Cv, J_WE.T, A_WE_bias)
    remembered = decode(memory)
    if not known:
        return _without_state(every.config, remembered, previous)
    return _next_torque(
        every,
        of_joints(joints),
        remembered,
        unpack(packed, every, time),
        measured,
        arm,
        state[: len(previous)],
        previous,
        weight,
    )


@inlined
def _next_torque(
    settings: ImpedanceSettings,
    joints: JointSettings,
    memory: ImpedanceMemory,
    inputs: StepInputs,
    X_WE: Pose,
    arm: ArmDynamics,
    q: Array,
    previous: Array,
    weight: Array,
) -> tuple[Array, Array, Array]:
    """Compute the next torque, status and memory; the arm is expressed in W."""
    config = settings.config
    period = config.control_period
    X_WT = inputs.X_WT
    X_TE = relative(X_WT, X_WE)
    rotation = twist_rotation(X_WT.R.T)
    arm_T = ArmDynamics(arm.v, arm.M, arm.Cv, rotation @ arm.J, rotation @ arm.Jdot_v)

    # Which target is followed, and how far.
    target = inputs.target
    target_W = compose(X_WT, target.X)
    flags, last = _NOT_FINITE, LastTarget(memory.target.known, 0.0, memory.target.X)
    if inputs.finite:
        speed = math.sqrt(target.V[3:] @ target.V[3:])
        flags, last = target_faults(
            config.watchdog, memory.target, target_W, speed, inputs.age, period
        )
    surface, offset = memory.force.surface, X_TE.p - target.X.p
    height, rest = offset[2], config.force_control.rest_distance
    # A tool that is high comes down while it comes back, and hooks behind nothing.
    high = max(height - config.force_control.lift_height, 0.0)
    near = engagement(math.hypot(offset[0], offset[1]) - rest - high, rest)
    engaged = engagement(target.X.p[2], settings.engage_height)
    pressing = inputs.desired_normal_force * engaged * near
    if inputs.desired_normal_force > 0:
        target = _pressed(target, engaged * near)
    searching = (
        near == 1
        and memory.watchdog.mode != STOPPED
        and target.X.p[2] < settings.engage_height
        and pressing - inputs.wrench[5] > 0
        and (pressing > 0 or inputs.has_normal_force)
    )
    if searching and is_beyond(config.force_control, memory.force, height):
        flags |= _NOT_FOUND
    # A tool that was below the surface comes up in the stop, slowly, and that long it
    # lasts; the surface that was found is forgotten meanwhile.
    below = memory.watchdog.mode == STOPPED and surface < 0
    watchdog, held = supervised(
        config.watchdog,
        memory.watchdog,
        memory.held,
        Pose(X_WE.R, X_WE.p - min(surface, 0.0) * X_WT.R[:, 2]),
        target_W,
        flags != 0 or below,
        period,
    )
    flags |= _PROTECTIVE_STOP * (watchdog.mode == STOPPED)
    flags |= _RECOVER * (watchdog.mode == RECOVERING)
    fraction, rate = target_fraction(watchdog)
    wrench, lifting = np.zeros(6), 0.0
    if fraction > 0:
        wrench += inputs.wrench
        wrench[5] -= pressing
        if inputs.desired_normal_force > 0:
            # From below the surface the tool comes up before it comes back.
            lift = config.force_control.lift_height + max(-height, 0.0)
            lifting = engaged * (1 - near) * memory.stiffness[5, 5] * lift
        target = motion_in_world(target, inputs.frame_twist, inputs.frame_acceleration)
        if fraction < 1:
            target = blended(target, relative(X_WT, held), fraction, rate)
    else:
        pressing, searching = 0.0, False
        target = TaskTarget(relative(X_WT, held), np.zeros(6), np.zeros(6))
    measured = math.nan
    if inputs.has_normal_force:
        measured = inputs.normal_force if inputs.finite else 0.0
    force = correct_normal_force(
        config.force_control,
        memory.force,
        Press(
            -wrench[5] if fraction == 1 else 0.0,
            measured,
            searching,
            near < 1,
            height,
            memory.stiffness[5, 5],
            memory.saturated,
        ),
        period,
    )
    # The tool's speed relative to T, along z.
    w, p = inputs.frame_twist, X_TE.p
    rising = arm_T.J[5] @ arm.v - w[5] - (w[0] * p[1] - w[1] * p[0])
    factor = approach_factor(config.force_control, surface, height, -rising)
    factor *= engagement(
        -height - config.force_control.search_range, settings.engage_height
    )
    wrench[5] += pressing * (1 - factor) + lifting
    wrench *= fraction
    wrench[5] -= force.correction

    # The law.
    error = unwrapped(task_error(X_TE, target.X), memory.rotation_error)
    error[5] += force.state.surface
    K, energy, stiffness_flags = next_stiffness(settings, memory, inputs, error)
    law = impedance_law(
        config, arm_T, K, error, target.V, target.A, wrench, joints.q_posture - q
    )
    torque = law.torque + friction_torque(joints.friction, arm.v)
    if not math.isfinite(np.sum(torque)):
        return _without_state(config, memory, previous)

    limited = limited_torque(
        config.walls,
        joints.limits,
        torque,
        previous,
        config.max_torque_rate * period,
        q,
        arm.v,
        np.diag(arm.M).copy(),
        weight,
    )
    flags |= (
        stiffness_flags
        | _ERROR_CLIPPED * law.clipped
        | _NEAR_SINGULAR * law.near_singular
        | _TORQUE_LIMITED * (limited.torque_scale < 1)
        | _RATE_LIMITED * (limited.rate_scale < 1)
        | _JOINT_WALL * limited.at_wall
        | _SPEED_LIMITED * limited.too_fast
        | _FORCE_CONTROL * force.closed
        | _CONTACT_LOST * force.lost
        | _FORCE_LIMITED * force.limited
    )
    return (
        limited.torque,
        np.array(
            (
                float(flags),
                fraction,
                limited.torque_scale,
                limited.rate_scale,
                force.state.surface,
                energy,
            )
        ),
        encode(
            ImpedanceMemory(
                watchdog,
                with_force(config.force_control, force.state, law.normal_force, period),
                refill(config.tank, energy, law.dissipation * period),
                limited.torque_scale < 1,
                last,
                held,
                K,
                error[:3],
            )
        ),
    )


@inlined
def _pressed(target: TaskTarget, fraction: float) -> TaskTarget:
    """Leave the motion along T's z out of what is fed forward, where force is wanted.

    What is pressed on a surface moves with it. The inertia and damping of a motion that
    cannot be would be taken off the force.
    """
    V, A = target.V.copy(), target.A.copy()
    V[5] *= 1 - fraction
    A[5] *= 1 - fraction
    return TaskTarget(target.X, V, A)


@compiled
def _without_state(
    config: ImpedanceConfig, memory: ImpedanceMemory, previous: Array
) -> tuple[Array, Array, Array]:
    """Bring the torque to zero: nothing can be said about the arm."""
    slowness = rate_scale(-previous, config.max_torque_rate * config.control_period)
    flags = float(_PROTECTIVE_STOP | _NO_STATE)
    return (
        (1 - slowness) * previous,
        np.array((flags, 0.0, 1.0, slowness, 0.0, memory.tank_energy)),
        encode(
            ImpedanceMemory(
                WatchdogState(LOST, 0.0, 0.0),
                ForceState(0.0, 0.0, math.inf),
                memory.tank_energy,
                False,
                LastTarget(memory.target.known, 0.0, memory.target.X),
                memory.held,
                memory.stiffness,
                np.zeros(3),
            )
        ),
    )
