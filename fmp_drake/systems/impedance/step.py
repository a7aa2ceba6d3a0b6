"""One update of the impedance controller, and its measurements, as functions of arrays."""

import math

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled, inlined
from fmp_drake.numeric import Array
from fmp_drake.systems.impedance.algebra import (
    Pose,
    TaskTarget,
    applied,
    blended,
    compose,
    cross,
    has_finite_sum,
    motion_in_world,
    raised,
    relative,
    task_error,
    twist_rotation,
    unwrapped,
)
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.impedance.force_control import (
    Contact,
    ForceState,
    contact_of,
    is_beyond,
    task_wrench,
    with_force,
)
from fmp_drake.systems.impedance.joints import (
    friction_torque,
    limited_torque,
    rate_scale,
)
from fmp_drake.systems.impedance.law import (
    ArmDynamics,
    impedance_law,
    normal_damping,
    normal_speed,
    re_expressed,
    without_normal_feedforward,
)
from fmp_drake.systems.impedance.records import (
    LAYOUT,
    MEMORY,
    ImpedanceMemory,
    ImpedanceSettings,
    encode,
    frame_of,
    held_pose,
    last_target,
    of_joints,
    status_of_update,
    target_of,
    unpack,
)
from fmp_drake.systems.impedance.stiffness import next_stiffness, refill
from fmp_drake.systems.impedance.supervision import (
    LOST,
    STOPPED,
    ForceRecord,
    LastTarget,
    WatchdogState,
    force_faults,
    supervised,
    target_faults,
    target_fraction,
)

STEP_TYPES = (
    "(u1[::1], f8[:,::1], f8[::1], f8, f8[::1], f8[::1], b1, f8[::1], f8[:,::1], f8[::1], "
    "f8[:,::1], f8[:,::1], f8[::1], f8[::1])"
)
"""Types of the arguments of `impedance_step`."""

# Faults of the target, of which its frame may be the cause.
_TARGET_FAULTS = int(
    StatusFlag.NOT_FINITE | StatusFlag.JUMP | StatusFlag.STALE | StatusFlag.IMPLAUSIBLE
)
# Distance by which the tool retreats from the surface after a stop because of its force, m.
_RETREAT = 0.02
# Desired normal force below which the feed-forward along the normal fades in, N: a tool that is
# to lift has to leave the surface with the velocity of its target.
_LEAST_PRESSING = 3.0


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

    Its arguments are numbers and arrays, which are passed fastest. Their types are the
    same for every arm, so it is compiled once.

    Parameters
    ----------
    settings : array of bytes
        Result of `settings_of`.
    joints : array, shape (9, n)
        Result of `joint_settings`.
    packed : array, shape (153,)
        The inputs, which `unpack` completes.
    time : float
        s.
    previous : array, shape (n,)
        The torque of the previous update, Nm.
    memory : array, shape (79,)
        The numbers of a `MEMORY`, of the previous update; not changed.
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
    memory : array, shape (79,)
        The numbers of a `MEMORY`.
    """
    record = settings.view(LAYOUT)[0]
    measured = Pose(np.ascontiguousarray(X_WE[:3].T), X_WE[3])
    arm = ArmDynamics(state[len(previous) :], M, Cv, J_WE.T, A_WE_bias)
    if not known:
        return _without_state(record, memory, previous)
    return _next_torque(
        record,
        joints,
        memory,
        unpack(packed, record, time),
        measured,
        arm,
        state[: len(previous)],
        previous,
        weight,
    )


@inlined
def _next_torque(
    settings: ImpedanceSettings,
    rows: Array,
    packed_memory: Array,
    inputs: np.record,
    X_WE: Pose,
    arm: ArmDynamics,
    q: Array,
    previous: Array,
    weight: Array,
) -> tuple[Array, Array, Array]:
    """Compute the next torque, status and memory; the arm is expressed in W."""
    config, memory = settings.config, packed_memory.view(MEMORY)[0]
    period, joints = config.control_period, of_joints(rows)
    X_WT, target_T = frame_of(inputs).X, target_of(inputs)
    watchdog = WatchdogState(int(memory.mode), memory.clock, memory.duration)
    state = ForceState(memory.surface, memory.force, memory.lost_time)
    X_TE = relative(X_WT, X_WE)
    if not inputs.finite:
        _discard_target(inputs, X_TE.p)
    rotation = twist_rotation(X_WT.R.T)
    arm_T = re_expressed(arm, rotation)

    target_W = compose(X_WT, target_T.X)
    flags, last = _checked_target(config, memory, inputs, X_WE, target_W, rotation)
    control, stopped = config.force_control, watchdog.mode == STOPPED
    contact = contact_of(settings, stopped, inputs, X_TE.p)
    if contact.searching and is_beyond(control, state, contact.height):
        flags |= StatusFlag.NOT_FOUND.value
    for i in range(len(arm.v)):
        if abs(arm.v[i]) > joints.limits.speed[i]:
            flags |= StatusFlag.SPEED_EXCEEDED.value
    # In a stop, a tool below the assumed surface rises slowly to it, and the stop lasts
    # until it is there. The height that was found is reset meanwhile.
    surface = memory.surface
    below = stopped and surface < 0
    stop_pose = raised(X_WE, X_WT, -min(surface, 0.0))
    watchdog, held = supervised(
        config.watchdog,
        watchdog,
        held_pose(memory),
        stop_pose,
        target_W,
        flags != 0 or below,
        period,
    )
    fraction, rate = target_fraction(watchdog)
    target = _followed_target(inputs, contact, held, fraction, rate)
    frame_twist = frame_of(inputs).V
    rising = normal_speed(arm_T, X_TE.p, frame_twist)
    wrench, force, desired, measured = task_wrench(
        settings, memory, state, inputs, contact, fraction, rising
    )

    if watchdog.mode == STOPPED:
        # Else the push that caused the stop could throw the tool against the surface. The
        # velocity of a frame that may be the fault is not followed.
        followed = np.zeros(6) if flags & _TARGET_FAULTS else frame_twist
        wrench[5] -= normal_damping(config, arm_T, X_TE.p, followed)
    error = unwrapped(task_error(X_TE, target.X), memory.rotation_error[:])
    error[5] += force.state.surface
    K, energy, stiffness_flags = next_stiffness(settings, memory, inputs, error)
    law = impedance_law(
        config, arm_T, K, error, target.V, target.A, wrench, joints.q_posture - q
    )
    torque = law.torque + friction_torque(joints.friction, arm.v)
    if not has_finite_sum(torque):
        return _without_state(settings, packed_memory, previous)
    limited = limited_torque(
        config.walls,
        joints.limits,
        torque,
        previous,
        settings.max_torque_rate * period,
        period,
        q,
        arm.v,
        arm.M,
        arm.Cv,
        weight,
    )

    # Supervision of the force: a fault now stops the arm at the next update. Without a
    # sensor, a person who lifts the tool cannot be distinguished from a contact: only
    # an oscillation is judged then.
    excess = (measured if inputs.has_normal_force else law.normal_force) - desired
    force_flags, force_record = force_faults(
        config.watchdog,
        ForceRecord(memory.slow_force, memory.fast_force, memory.force_power),
        excess if desired > 0 else 0.0,
        desired if inputs.has_normal_force > 0 else math.inf,
        period,
    )
    if force_flags != 0:
        if watchdog.mode != STOPPED:
            held = raised(stop_pose, X_WT, _RETREAT)
        watchdog, fraction = WatchdogState(STOPPED, 0.0, 0.0), 0.0
    flags |= force_flags | stiffness_flags
    status = status_of_update(flags, fraction, watchdog, law, limited, force, energy)
    after = ImpedanceMemory(
        watchdog,
        with_force(config.force_control, force.state, law.normal_force, period),
        refill(config.tank, energy, law.dissipation * period),
        limited.torque_scale < 1,
        last,
        held,
        K,
        error[:3],
        force_record,
    )
    return limited.torque, status, encode(after)


@compiled
def _discard_target(inputs: np.record, p_TE: Array) -> None:
    """Replace inputs that are not finite, in place, by those of a tool at rest without force."""
    inputs.desired_normal_force[0] = 0.0
    for i in range(3):
        inputs.desired_position[i] = p_TE[i]
    for i in range(6):
        inputs.feedforward_wrench[i] = inputs.frame_twist[i] = 0.0


@inlined
def _checked_target(
    config: ImpedanceConfig,
    memory: np.record,
    inputs: np.record,
    X_WE: Pose,
    target_W: Pose,
    rotation: Array,
) -> tuple[int, LastTarget]:
    """Return the flags of the target's faults, and the target to store.

    `rotation` expresses twists of W in T.
    """
    flags, before = StatusFlag.NOT_FINITE.value, last_target(memory)
    last = LastTarget(before.known, 0.0, before.X, np.zeros(3))
    if inputs.finite:
        frame = frame_of(inputs)
        moving = motion_in_world(target_of(inputs), frame.V, frame.A)
        flags, last = target_faults(
            config.watchdog,
            before,
            X_WE,
            TaskTarget(
                target_W,
                applied(rotation.T, moving.V),
                applied(rotation.T, moving.A),
            ),
            inputs.age,
            config.control_period,
        )
    return flags, last


@inlined
def _followed_target(
    inputs: np.record, contact: Contact, held: Pose, fraction: float, rate: float
) -> TaskTarget:
    """Return the motion to follow: a fraction of the target, the rest the held pose."""
    frame, target = frame_of(inputs), target_of(inputs)
    if inputs.desired_normal_force[0] > 0:
        pressing = min(inputs.desired_normal_force[0] / _LEAST_PRESSING, 1.0)
        target = without_normal_feedforward(
            target, contact.engaged * contact.near * pressing
        )
    if fraction > 0:
        target = motion_in_world(target, frame.V, frame.A)
        if fraction < 1:
            target = blended(target, relative(frame.X, held), fraction, rate)
    else:
        target = TaskTarget(relative(frame.X, held), np.zeros(6), np.zeros(6))
    return target


@compiled
def _without_state(
    settings: ImpedanceSettings, memory: Array, previous: Array
) -> tuple[Array, Array, Array]:
    """Reduce the torque to zero: the state of the arm is unknown."""
    period = settings.config.control_period
    rate_factor = rate_scale(-previous, settings.max_torque_rate * period)
    after = memory.copy()
    record = after.view(MEMORY)[0]
    record.mode, record.clock, record.duration = LOST, 0.0, 0.0
    record.surface, record.force, record.lost_time = 0.0, 0.0, math.inf
    record.saturated = record.frozen_time = 0.0
    for i in range(3):
        record.rotation_error[i] = record.target_drift[i] = 0.0
    record.slow_force = record.fast_force = record.force_power = 0.0
    flags = float(StatusFlag.PROTECTIVE_STOP.value | StatusFlag.NO_STATE.value)
    status = np.array((flags, 0.0, 1.0, rate_factor, 0.0, record.tank_energy))
    return (1 - rate_factor) * previous, status, after


@compiled
def measured_motion(
    settings: NDArray[np.uint8], packed: Array, X_WE: Array, V_WE: Array
) -> Array:
    """Return position, velocity and tracking error of the end effector in T.

    Parameters
    ----------
    settings : array of bytes
        Result of `settings_of`.
    packed : array, shape (153,)
        The inputs, which `unpack` completes.
    X_WE : array, shape (4, 3)
        Transposed R_WE, and below it p_WE in m.
    V_WE : array, shape (6,)
        Rotation first, rad/s and m/s.

    Returns
    -------
    array, shape (12,)
        p_TE in m, its derivative in T in m/s, and `task_error`.
    """
    inputs = unpack(packed, settings.view(LAYOUT)[0], 0.0)
    (X_WT, frame, _), target = frame_of(inputs), target_of(inputs)
    X_TE = relative(X_WT, Pose(np.ascontiguousarray(X_WE[:3].T), X_WE[3]))
    motion = np.empty(12)
    velocity = applied(X_WT.R.T, V_WE[3:]) - frame[3:] - cross(frame[:3], X_TE.p)
    error = task_error(X_TE, target.X)
    for i in range(3):
        motion[i], motion[3 + i] = X_TE.p[i], velocity[i]
        motion[6 + i], motion[9 + i] = error[i], error[3 + i]
    return motion
