"""What the impedance controller remembers from one update to the next."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.systems.impedance.force_control import ForceState
from fmp_drake.systems.impedance.poses import Pose
from fmp_drake.systems.impedance.supervision import LastTarget, WatchdogState

Array = NDArray[np.float64]

MEMORY_SIZE = 72


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
    """Read a memory from a vector, shape (72,), without copying it."""
    return ImpedanceMemory(
        WatchdogState(int(vector[0]), vector[1], vector[2]),
        ForceState(vector[3], vector[4]),
        vector[5],
        vector[6] > 0,
        LastTarget(
            vector[7] > 0, vector[8], Pose(vector[9:18].reshape(3, 3), vector[18:21])
        ),
        Pose(vector[21:30].reshape(3, 3), vector[30:33]),
        vector[33:69].reshape(6, 6),
        vector[69:],
    )


@compiled
def encode(memory: ImpedanceMemory) -> Array:
    """Write a memory into a new vector, shape (72,)."""
    vector = np.empty(MEMORY_SIZE)
    vector[0] = memory.watchdog.mode
    vector[1] = memory.watchdog.clock
    vector[2] = memory.watchdog.duration
    vector[3] = memory.force.integral
    vector[4] = memory.force.lost_time
    vector[5] = memory.tank_energy
    vector[6] = memory.saturated
    vector[7] = memory.target.known
    vector[8] = memory.target.frozen_time
    _put(vector, 9, memory.target.X.R.ravel())
    _put(vector, 18, memory.target.X.p)
    _put(vector, 21, memory.held.R.ravel())
    _put(vector, 30, memory.held.p)
    _put(vector, 33, memory.stiffness.ravel())
    _put(vector, 69, memory.rotation_error)
    return vector


@compiled
def _put(vector: Array, begin: int, values: Array) -> None:
    for i in range(len(values)):
        vector[begin + i] = values[i]
