"""Settings, inputs, memory and status of the impedance controller, as arrays and records."""

import math
import sys
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled, inlined
from fmp_drake.numeric import Array
from fmp_drake.systems.impedance.algebra import (
    Pose,
    TaskTarget,
    applied,
    rotation_from_quaternion,
    twist_rotation,
)
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.impedance.force_control import ForceCorrection, ForceState
from fmp_drake.systems.impedance.joints import (
    FrictionConfig,
    JointLimits,
    LimitedTorque,
    SigmoidFriction,
)
from fmp_drake.systems.impedance.law import LawTorque
from fmp_drake.systems.impedance.supervision import (
    RECOVERING,
    STOPPED,
    ForceRecord,
    LastTarget,
    WatchdogState,
)

# Larger numbers count as errors.
_LARGEST = 1e12

# Settings.


@dataclass(frozen=True, eq=False, kw_only=True)
class ImpedanceSettings:
    """Settings of a controller that do not depend on the number of joints.

    Attributes
    ----------
    config : ImpedanceConfig
    stiffness : array, shape (6, 6)
        K without the port `stiffness`, in T.
    R_TE : array, shape (3, 3)
        The desired orientation without the port `desired_orientation`.
    X_WT : Pose
        The task frame without the port `task_frame`.
    max_torque_rate : float
        Nm/s; the largest number where there is no limit.
    engage_height, contact_height : float
        Heights of the target, m: the normal force acts below their sum and is whole below
        `contact_height`, over T's plane.
    """

    config: ImpedanceConfig
    stiffness: Array
    R_TE: Array
    X_WT: Pose
    max_torque_rate: float
    engage_height: float
    contact_height: float


def settings_of(
    config: ImpedanceConfig,
    *,
    X_WT: Pose,
    engage_height: float,
    contact_height: float,
) -> NDArray[Any]:
    """Check a configuration and complete it.

    Returns
    -------
    array, shape (1,)
        The values of `ImpedanceSettings`, of the type `LAYOUT`.

    Raises
    ------
    SystemsError
        If a value cannot be used.
    """
    rate = config.max_torque_rate
    max_torque_rate = sys.float_info.max if rate is None else rate
    settings = ImpedanceSettings(
        # The lists of the friction have a number for each joint: see `joint_settings`.
        config=replace(
            config,
            max_torque_rate=max_torque_rate,
            friction_compensation=FrictionConfig(),
        ),
        stiffness=config.stiffness(),
        R_TE=config.desired_rotation(),
        X_WT=X_WT,
        max_torque_rate=max_torque_rate,
        engage_height=engage_height,
        contact_height=contact_height,
    )
    return np.array([values_of(settings)])


class JointSettings(NamedTuple):
    """Settings of a controller for each joint of its arm.

    Attributes
    ----------
    limits : JointLimits
    friction : SigmoidFriction
        The compensated friction; zero where the compensation is not enabled.
    q_posture : array, shape (n,)
        rad.
    """

    limits: JointLimits
    friction: SigmoidFriction
    q_posture: Array


def joint_settings(
    config: ImpedanceConfig, *, limits: JointLimits, q_posture: Array
) -> Array:
    """Check a configuration for an arm of n joints, and return `JointSettings` as rows.

    Returns
    -------
    array, shape (9, n)

    Raises
    ------
    SystemsError
        If the friction to be compensated is not that of n joints.
    """
    n = len(q_posture)
    friction = SigmoidFriction(np.zeros(n), np.zeros(n), np.zeros(n))
    if config.friction_compensation.enabled:
        friction = SigmoidFriction.of(
            config.friction_compensation, n=n, name="friction_compensation"
        )
    return np.stack([*limits, *friction, q_posture])


@compiled
def of_joints(rows: Array) -> JointSettings:
    """Read the result of `joint_settings`."""
    return JointSettings(
        JointLimits(rows[0], rows[1], rows[2], rows[3], rows[4]),
        SigmoidFriction(rows[5], rows[6], rows[7]),
        rows[8],
    )


def values_of[C](settings: C) -> C:
    """Return a NumPy record with the fields of a dataclass of numbers.

    It is a copy. Numbers become floats, lists arrays, dataclasses and named tuples
    records, so that compiled functions see the same types every time. Empty lists are
    left out.

    Examples
    --------
    >>> from fmp_drake.systems.impedance.supervision import WatchdogConfig
    >>> float(values_of(WatchdogConfig(max_age=1)).max_age)
    1.0
    """
    record: Any = np.array([_contents(settings)], _dtype(settings))
    return record.view(np.recarray)[0]


def _parts(value: Any) -> dict[str, Any] | None:
    """Return the fields of a dataclass or named tuple; None for other values."""
    if is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in fields(value)}
        return {name: part for name, part in parts.items() if not _is_empty(part)}
    return value._asdict() if hasattr(value, "_asdict") else None


def _is_empty(value: Any) -> bool:
    return isinstance(value, list) and not value


def _contents(value: Any) -> Any:
    parts = _parts(value)
    return value if parts is None else tuple(map(_contents, parts.values()))


def _dtype(value: Any) -> np.dtype[Any]:
    parts = _parts(value)
    if parts is not None:
        return np.dtype([(name, _dtype(part)) for name, part in parts.items()])
    kind = bool if isinstance(value, bool) else float
    return np.dtype((kind, np.shape(value)))


LAYOUT = settings_of(
    ImpedanceConfig(),
    X_WT=Pose(np.eye(3), np.zeros(3)),
    engage_height=1.0,
    contact_height=0.0,
).dtype
"""Type of the result of `settings_of`."""

# Inputs.

# Ports and their sizes, in the order of the packed vector.
REQUIRED = {"desired_position": 3, "desired_velocity": 3, "desired_acceleration": 3}
OPTIONAL = {
    "feedforward_wrench": 6,
    "desired_orientation": 4,
    "desired_angular_velocity": 3,
    "desired_angular_acceleration": 3,
    "task_frame": 7,
    "task_frame_velocity": 6,
    "task_frame_acceleration": 6,
    "target_time": 1,
    "stiffness": 36,
    "covariance": 9,
    "normal_force": 1,
    "desired_normal_force": 1,
}
PORTS = REQUIRED | OPTIONAL
SHAPES = {"stiffness": (6, 6), "covariance": (3, 3)}
PACKED = np.dtype(
    (
        np.record,
        [
            *((name, float, SHAPES.get(name, (size,))) for name, size in PORTS.items()),
            *((f"has_{name}", float) for name in PORTS),
            ("finite", float),
            ("R_TE", float, (3, 3)),
            ("V", float, (6,)),
            ("A", float, (6,)),
            ("R_WT", float, (3, 3)),
            ("p_WT", float, (3,)),
            ("frame_twist", float, (6,)),
            ("frame_acceleration", float, (6,)),
            ("age", float),
        ],
    )
)
"""The inputs as a structured type.

It holds the values of all ports, 1 for each port that is used, and what `unpack` computes:
whether every value is finite and far from an overflow (1), the desired orientation, the
twist of the target and its derivative relative to T, X_WT, its twist and its derivative in
T's axes, and the age of the target in s (NaN where `target_time` is not connected).
"""
PACKED_SIZE = PACKED.itemsize // 8
_GIVEN_SIZE = sum(PORTS.values()) + len(PORTS)
# Indices of each port's values among the packed numbers, and of its flag.
PLACES = {
    name: (slice(end - PORTS[name], end), sum(PORTS.values()) + k)
    for k, (name, end) in enumerate(zip(PORTS, accumulate(PORTS.values()), strict=True))
}


# Compiled functions pass a record as one pointer; a tuple of arrays takes them hundreds
# of instructions.


@compiled
def target_of(inputs: np.record) -> TaskTarget:
    """Return the target relative to T, as views."""
    pose = Pose(inputs.R_TE[:], inputs.desired_position[:])
    return TaskTarget(pose, inputs.V[:], inputs.A[:])


@compiled
def frame_of(inputs: np.record) -> TaskTarget:
    """Return X_WT, V_WT and A_WT in T's axes, as views."""
    pose = Pose(inputs.R_WT[:], inputs.p_WT[:])
    return TaskTarget(pose, inputs.frame_twist[:], inputs.frame_acceleration[:])


@compiled
def unpack(packed: Array, settings: ImpedanceSettings, time: float) -> np.record:
    """Complete the packed inputs, in place, and return them as a record: a view.

    Parameters
    ----------
    packed : array, shape (153,)
        A record of the type `PACKED` as numbers, zero where a port is not used.
    settings : ImpedanceSettings
        Source of the task frame where the port has no finite one, and of the desired
        orientation where the port has none.
    time : float
        s.
    """
    ports, finite = packed.view(PACKED)[0], True
    for i in range(_GIVEN_SIZE):
        finite = finite and abs(packed[i]) < _LARGEST
    R_TE, R_WT, p_WT = settings.R_TE[:], settings.X_WT.R[:], settings.X_WT.p[:]
    if ports.has_desired_orientation:
        R_TE = rotation_from_quaternion(ports.desired_orientation[:])
        finite = finite and math.isfinite(R_TE[0, 0])
    if ports.has_task_frame:
        pose = ports.task_frame[:]
        given = rotation_from_quaternion(pose[:4])
        if math.isfinite(given[0, 0] + pose[4] + pose[5] + pose[6]):
            R_WT, p_WT = given, pose[4:]
        else:
            finite = False
    ports.finite = 1.0 if finite else 0.0
    for i in range(3):
        ports.p_WT[i] = p_WT[i]
        for j in range(3):
            ports.R_TE[i, j], ports.R_WT[i, j] = R_TE[i, j], R_WT[i, j]
        ports.V[i] = ports.desired_angular_velocity[i]
        ports.V[3 + i] = ports.desired_velocity[i]
        ports.A[i] = ports.desired_angular_acceleration[i]
        ports.A[3 + i] = ports.desired_acceleration[i]
    rotation = twist_rotation(R_WT.T)
    twist = applied(rotation, ports.task_frame_velocity[:])
    acceleration = applied(rotation, ports.task_frame_acceleration[:])
    for i in range(6):
        ports.frame_twist[i] = twist[i]
        # A frame without a given velocity stands still.
        ports.frame_acceleration[i] = (
            acceleration[i] if ports.has_task_frame_velocity else 0.0
        )
    age = time - ports.target_time[0]
    ports.age = age if ports.has_target_time else math.nan
    return ports


# Memory.


class ImpedanceMemory(NamedTuple):
    """The controller's memory; in the discrete state it is a vector.

    Attributes
    ----------
    watchdog : WatchdogState
    force : ForceState
    tank_energy : float
        J.
    saturated : bool
        Whether the torque was limited.
    target : LastTarget
    held : Pose
        X_WE where the arm was stopped.
    stiffness : array, shape (6, 6)
        K, in T.
    rotation_error : array, shape (3,)
        Of the previous update, rad, in T.
    force_record : ForceRecord
    """

    watchdog: WatchdogState
    force: ForceState
    tank_energy: float
    saturated: bool
    target: LastTarget
    held: Pose
    stiffness: Array
    rotation_error: Array
    force_record: ForceRecord


# All fields are numbers of 8 bytes, so that one array of floats holds them.
MEMORY = np.dtype(
    (
        np.record,
        [
            ("mode", float),
            ("clock", float),
            ("duration", float),
            ("surface", float),
            ("force", float),
            ("lost_time", float),
            ("tank_energy", float),
            ("saturated", float),
            ("target_known", float),
            ("frozen_time", float),
            ("target_R", float, (3, 3)),
            ("target_p", float, (3,)),
            ("held_R", float, (3, 3)),
            ("held_p", float, (3,)),
            ("stiffness", float, (6, 6)),
            ("rotation_error", float, (3,)),
            ("target_drift", float, (3,)),
            ("slow_force", float),
            ("fast_force", float),
            ("force_power", float),
        ],
    )
)
"""The controller's memory as a structured type: the fields of `ImpedanceMemory`."""

_MEMORY_SIZE = MEMORY.itemsize // 8


def initial_memory(stiffness: Array, *, tank_energy: float) -> Array:
    """Return the initial memory; the stiffness has shape (6, 6)."""
    memory = np.zeros(1, MEMORY)
    memory["lost_time"] = math.inf
    memory["tank_energy"] = tank_energy
    memory["target_R"] = memory["held_R"] = np.eye(3)
    memory["stiffness"] = stiffness
    return memory.view(np.float64)


@compiled
def held_pose(memory: np.record) -> Pose:
    """Return the held pose of a record of the type `MEMORY`, as views."""
    return Pose(memory.held_R[:], memory.held_p[:])


@compiled
def last_target(memory: np.record) -> LastTarget:
    """Return the target of a record of the type `MEMORY`, as views."""
    pose = Pose(memory.target_R[:], memory.target_p[:])
    known, drift = memory.target_known > 0, memory.target_drift[:]
    return LastTarget(known, memory.frozen_time, pose, drift)


@compiled
def encode(memory: ImpedanceMemory) -> Array:
    """Write a memory into the numbers of a new `MEMORY`."""
    vector = np.empty(_MEMORY_SIZE)
    m = vector.view(MEMORY)[0]
    m.mode, m.clock, m.duration = memory.watchdog
    m.surface, m.force, m.lost_time = memory.force
    m.tank_energy, m.saturated = memory.tank_energy, memory.saturated
    m.target_known, m.frozen_time = memory.target.known, memory.target.frozen_time
    target, held = memory.target, memory.held
    for i in range(3):
        m.target_p[i], m.held_p[i] = target.X.p[i], held.p[i]
        m.rotation_error[i] = memory.rotation_error[i]
        m.target_drift[i] = target.drift[i]
        for j in range(3):
            m.target_R[i, j], m.held_R[i, j] = target.X.R[i, j], held.R[i, j]
    for i in range(6):
        for j in range(6):
            m.stiffness[i, j] = memory.stiffness[i, j]
    m.slow_force, m.fast_force, m.force_power = memory.force_record
    return vector


@inlined
def status_of_update(
    flags: int,
    fraction: float,
    watchdog: WatchdogState,
    law: LawTorque,
    limited: LimitedTorque,
    force: ForceCorrection,
    energy: float,
) -> Array:
    """Return the vector of `ImpedanceStatus`.

    Parameters
    ----------
    flags : int
        Those of the inputs, the stiffness and the supervision of the force.
    fraction : float
        Fraction of the target in the motion that was followed, in [0, 1].
    watchdog : WatchdogState
    law : LawTorque
    limited : LimitedTorque
    force : ForceCorrection
    energy : float
        Of the tank, J.

    Returns
    -------
    array, shape (6,)
    """
    flags |= (
        StatusFlag.PROTECTIVE_STOP.value * (watchdog.mode == STOPPED)
        | StatusFlag.RECOVER.value * (watchdog.mode == RECOVERING)
        | StatusFlag.ERROR_CLIPPED.value * law.clipped
        | StatusFlag.NEAR_SINGULAR.value * law.near_singular
        | StatusFlag.TORQUE_LIMITED.value * (limited.torque_scale < 1)
        | StatusFlag.RATE_LIMITED.value * (limited.rate_scale < 1)
        | StatusFlag.OVERSPEED.value * limited.overspeed
        | StatusFlag.JOINT_WALL.value * limited.at_wall
        | StatusFlag.SPEED_LIMITED.value * limited.too_fast
        | StatusFlag.FORCE_CONTROL.value * force.closed
        | StatusFlag.CONTACT_LOST.value * force.lost
        | StatusFlag.FORCE_LIMITED.value * force.limited
    )
    return np.array(
        (
            float(flags),
            fraction,
            limited.torque_scale,
            limited.rate_scale,
            force.state.surface,
            energy,
        )
    )
