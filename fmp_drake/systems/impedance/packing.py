"""The inputs and the memory of the impedance controller as plain vectors."""

import math
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.systems.impedance.algebra import (
    Pose,
    rotation_from_quaternion,
    stacked,
    twist_rotation,
)
from fmp_drake.systems.impedance.force_control import ForceState
from fmp_drake.systems.impedance.settings import ImpedanceSettings
from fmp_drake.systems.impedance.supervision import LastTarget, WatchdogState
from fmp_drake.systems.impedance.target import TaskTarget

Array = NDArray[np.float64]

MEMORY_SIZE = 73

# Numbers that are larger are taken for an error.
_LARGEST = 1e12

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
# The values of all ports, and behind them 1 for each port that is used.
PACKED = np.dtype(
    [(name, float, (size,)) for name, size in PORTS.items()]
    + [(f"has_{name}", float) for name in PORTS]
)
PACKED_SIZE = PACKED.itemsize // 8
# Where each port's values are among the packed numbers, and where its flag is.
PLACES = {
    name: (slice(end - PORTS[name], end), sum(PORTS.values()) + k)
    for k, (name, end) in enumerate(zip(PORTS, accumulate(PORTS.values()), strict=True))
}


class StepInputs(NamedTuple):
    """What came in at the ports.

    Attributes
    ----------
    finite : bool
        Whether every value is finite, and far from an overflow.
    target : TaskTarget
        Relative to T.
    wrench : array, shape (6,)
        Feed-forward, Nm and N, in T.
    X_WT : Pose
    frame_twist, frame_acceleration : array, shape (6,)
        V_WT and A_WT in T's axes.
    age : float
        Of the target, s; NaN where it does not tell.
    stiffness : array, shape (6, 6)
    covariance : array, shape (3, 3)
        m².
    normal_force, desired_normal_force : float
        Measured and wanted along −z of T, N.
    has_stiffness, has_covariance, has_normal_force : bool
        Whether there is one.
    """

    finite: bool
    target: TaskTarget
    wrench: Array
    X_WT: Pose
    frame_twist: Array
    frame_acceleration: Array
    age: float
    stiffness: Array
    covariance: Array
    normal_force: float
    desired_normal_force: float
    has_stiffness: bool
    has_covariance: bool
    has_normal_force: bool


@compiled
def unpack(packed: Array, settings: ImpedanceSettings, time: float) -> StepInputs:
    """Read the packed inputs.

    Parameters
    ----------
    packed : array, shape (107,)
        A record of the type `PACKED` as numbers, zero where a port is not used.
    settings : ImpedanceSettings
        With the task frame where the port brings none, or none that is finite, and
        the desired orientation where the port brings none.
    time : float
        s.
    """
    X_WT = Pose(settings.X_WT.R.copy(), settings.X_WT.p.copy())
    R_TE = settings.R_TE.copy()
    ports, finite = packed.view(PACKED)[0], True
    for i in range(len(packed)):
        finite = finite and abs(packed[i]) < _LARGEST
    if ports["has_desired_orientation"]:
        R_TE = rotation_from_quaternion(ports["desired_orientation"].copy())
        finite = finite and math.isfinite(R_TE[0, 0])
    if ports["has_task_frame"]:
        pose = ports["task_frame"].copy()
        R_WT = rotation_from_quaternion(pose[:4])
        if math.isfinite(R_WT[0, 0] + pose[4] + pose[5] + pose[6]):
            X_WT = Pose(R_WT, pose[4:])
        else:
            finite = False
    rotation = twist_rotation(X_WT.R.T)
    # A frame that has no velocity stands still.
    frame_acceleration = ports["task_frame_acceleration"].copy()
    if not ports["has_task_frame_velocity"]:
        frame_acceleration = np.zeros(6)
    age = time - ports["target_time"][0]
    return StepInputs(
        finite,
        TaskTarget(
            Pose(R_TE, ports["desired_position"].copy()),
            stacked(ports["desired_angular_velocity"], ports["desired_velocity"]),
            stacked(
                ports["desired_angular_acceleration"], ports["desired_acceleration"]
            ),
        ),
        ports["feedforward_wrench"].copy(),
        X_WT,
        rotation @ ports["task_frame_velocity"].copy(),
        rotation @ frame_acceleration,
        age if ports["has_target_time"] else math.nan,
        ports["stiffness"].copy().reshape(6, 6),
        ports["covariance"].copy().reshape(3, 3),
        ports["normal_force"][0],
        max(ports["desired_normal_force"][0], 0.0),
        ports["has_stiffness"] > 0,
        ports["has_covariance"] > 0,
        ports["has_normal_force"] > 0,
    )


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
        That the spring saw last, rad, in T.
    """

    watchdog: WatchdogState
    force: ForceState
    tank_energy: float
    saturated: bool
    target: LastTarget
    held: Pose
    stiffness: Array
    rotation_error: Array


def initial_memory(stiffness: Array, *, tank_energy: float) -> ImpedanceMemory:
    """Make the memory of the start; the stiffness has shape (6, 6)."""
    nowhere = Pose(np.eye(3), np.zeros(3))
    return ImpedanceMemory(
        WatchdogState(),
        ForceState(),
        tank_energy,
        False,
        LastTarget(False, 0.0, nowhere),
        nowhere,
        stiffness,
        np.zeros(3),
    )


@compiled
def decode(vector: Array) -> ImpedanceMemory:
    """Read a memory from a vector, shape (73,), without copying it."""
    return ImpedanceMemory(
        WatchdogState(int(vector[0]), vector[1], vector[2]),
        ForceState(vector[3], vector[4], vector[5]),
        vector[6],
        vector[7] > 0,
        LastTarget(
            vector[8] > 0, vector[9], Pose(vector[10:19].reshape(3, 3), vector[19:22])
        ),
        Pose(vector[22:31].reshape(3, 3), vector[31:34]),
        vector[34:70].reshape(6, 6),
        vector[70:],
    )


@compiled
def encode(memory: ImpedanceMemory) -> Array:
    """Write a memory into a new vector, shape (73,)."""
    vector = np.empty(MEMORY_SIZE)
    vector[0] = memory.watchdog.mode
    vector[1] = memory.watchdog.clock
    vector[2] = memory.watchdog.duration
    vector[3] = memory.force.surface
    vector[4] = memory.force.force
    vector[5] = memory.force.lost_time
    vector[6] = memory.tank_energy
    vector[7] = memory.saturated
    vector[8] = memory.target.known
    vector[9] = memory.target.frozen_time
    _put(vector, 10, memory.target.X.R.ravel())
    _put(vector, 19, memory.target.X.p)
    _put(vector, 22, memory.held.R.ravel())
    _put(vector, 31, memory.held.p)
    _put(vector, 34, memory.stiffness.ravel())
    _put(vector, 70, memory.rotation_error)
    return vector


@compiled
def _put(vector: Array, begin: int, values: Array) -> None:
    for i in range(len(values)):
        vector[begin + i] = values[i]
