"""What the impedance controller remembers from one update to the next."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fmp_drake.systems.impedance.force_control import ForceState
from fmp_drake.systems.impedance.target import TaskTarget
from fmp_drake.systems.impedance.watchdog import WatchdogState

Array = NDArray[np.float64]

_HEAD = 10
_LAST = slice(10, 22)
_HOLD = slice(22, 34)
_FILTERED = slice(34, 58)
_STIFFNESS = slice(58, 94)
_ROTATION = slice(94, 97)
MEMORY_SIZE = 97


@dataclass(slots=True, eq=False)
class ImpedanceMemory:
    """The controller's memory, kept as a vector in the discrete state.

    Attributes
    ----------
    watchdog : WatchdogState
    force : ForceState
    tank_energy : float
        J.
    frozen_time : float
        How long the target has stood still although it has a velocity, s.
    saturated : bool
        Whether the torque was limited.
    last : array, shape (12,) or (3,), or None
        The position (m) and, where it may change, the rows of the orientation of
        the last finite target, in T or, where T may move, in the world.
    hold : array, shape (12,)
        The pose that the watchdog holds, in the world.
    filtered : array, shape (24,), or None
        p, R, V and A of the filtered target, in T.
    stiffness : array, shape (36,)
        K, its rows, in T.
    rotation_error : array, shape (3,)
        That the spring saw last, rad, in T.
    """

    watchdog: WatchdogState
    force: ForceState
    tank_energy: float
    frozen_time: float
    saturated: bool
    last: Array | None
    hold: Array
    filtered: Array | None
    stiffness: Array
    rotation_error: Array

    @classmethod
    def initial(cls, stiffness: Array, *, tank_energy: float) -> Self:
        """Make the memory of the start; the stiffness has shape (6, 6)."""
        return cls(
            watchdog=WatchdogState(),
            force=ForceState(),
            tank_energy=tank_energy,
            frozen_time=0.0,
            saturated=False,
            last=None,
            hold=np.zeros(12),
            filtered=None,
            stiffness=stiffness.ravel(),
            rotation_error=np.zeros(3),
        )

    @classmethod
    def from_vector(cls, vector: Array) -> Self:
        """Read a vector, shape (97,), without copying it."""
        mode, clock, duration, i, lost, tank, frozen, sat, last, filtered = vector[
            :_HEAD
        ].tolist()
        return cls(
            WatchdogState(int(mode), clock, duration),
            ForceState(i, lost),
            tank,
            frozen,
            sat > 0,
            vector[_LAST] if last > 0 else None,
            vector[_HOLD],
            vector[_FILTERED] if filtered > 0 else None,
            vector[_STIFFNESS],
            vector[_ROTATION],
        )

    def to_vector(self) -> Array:
        """Return a new vector, shape (97,)."""
        vector = np.zeros(MEMORY_SIZE)
        vector[:_HEAD] = (
            *self.watchdog,
            *self.force,
            self.tank_energy,
            self.frozen_time,
            self.saturated,
            self.last is not None,
            self.filtered is not None,
        )
        if self.last is not None:
            vector[_LAST.start : _LAST.start + self.last.size] = self.last
        vector[_HOLD] = self.hold
        if self.filtered is not None:
            vector[_FILTERED] = self.filtered
        vector[_STIFFNESS] = self.stiffness
        vector[_ROTATION] = self.rotation_error
        return vector


def packed(target: TaskTarget) -> Array:
    """Put a target into a vector, shape (24,)."""
    return np.concatenate((target.p, target.R.ravel(), target.V, target.A))


def unpacked(vector: Array) -> TaskTarget:
    """Take a target out of a vector, shape (24,)."""
    return TaskTarget(
        vector[3:12].reshape(3, 3), vector[:3], vector[12:18], vector[18:]
    )
