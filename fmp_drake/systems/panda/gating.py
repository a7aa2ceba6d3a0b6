"""What torque may be sent to a real arm, whatever was asked and whatever was missed."""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.settings import bounded
from fmp_drake.systems.panda.reading import JOINTS, ArmReading, GateFault

Array = NDArray[np.float64]

_MILLISECOND = 0.001
_FRANKA = [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0]


@dataclass(kw_only=True)
class GateConfig:
    """Limits of the torque that is sent to an arm.

    Attributes
    ----------
    max_torque : list of 7 floats
        Of each joint, either way, without gravity, Nm.
    max_rate : float
        Greatest change of any joint's torque per second of the wall clock, Nm/s. The
        default keeps a tenth below the 1000 Nm/s at which Franka's robots stop.
    period : float
        Between two torques, s; of the law, too. However much time passed, no torque
        differs from the one before by more than ``max_rate`` makes of a millisecond.
    expiry : float
        Greatest age of a status, s.
    max_gap : float
        Greatest time between two torques after which the arm goes on, s.
    dry : bool
        Compute everything, send zeros.

    Examples
    --------
    >>> from fmp_drake.errors import SystemsError
    >>> from fmp_drake.settings import check_settings
    >>> check_settings(GateConfig(max_rate=2000.0), SystemsError)
    Traceback (most recent call last):
    ...
    fmp_drake.errors.SystemsError: max_rate is 2000.0; it must be positive and at most \
1000.0.
    """

    max_torque: list[float] = bounded(_FRANKA, above=0, most=87.0)
    max_rate: float = bounded(900.0, above=0, most=1000.0)
    period: float = bounded(0.001, above=0, most=0.002)
    expiry: float = bounded(0.05, above=0, most=0.1)
    max_gap: float = bounded(0.05, above=0, most=0.1)
    dry: bool = False


class GateMode(IntEnum):
    """Whether torque goes to the arm.

    `WAITING`: none, until the operator says go. `OPEN`: the controller's. `STOPPED`:
    after a fault it goes to zero, and stays there until the operator says go. An arm
    that gets zeros is afloat, one that gets nothing is damped: it gets nothing then.

    Examples
    --------
    >>> GateMode(2).name
    'STOPPED'
    """

    WAITING = 0
    OPEN = 1
    STOPPED = 2


class GateState(NamedTuple):
    """Where a gate stands.

    Attributes
    ----------
    torque : array, shape (7,)
        Sent at last, Nm.
    mode : GateMode
    faults : GateFault
        Why it stopped, or why the last go was refused.
    status_time : float
        Of the newest status, s of the wall clock; minus infinity before the first.
    wall_time : float
        Of the last step, s; NaN before the first.
    go : float
        The last word of the operator: a count of gos; less than 0 is a stop.
    stamp : float
        Of the last torque to be sent, s of the wall clock; 0 before the first.
    """

    torque: Array
    mode: GateMode = GateMode.WAITING
    faults: GateFault = GateFault(0)
    status_time: float = -np.inf
    wall_time: float = np.nan
    go: float = 0.0
    stamp: float = 0.0

    @classmethod
    def from_vectors(cls, torque: ArrayLike, rest: ArrayLike) -> "GateState":
        """Read what `vectors` returned."""
        mode, faults, *times = np.asarray(rest).tolist()
        sent = np.array(torque, dtype=float)
        return cls(sent, GateMode(int(mode)), GateFault(int(faults)), *times)

    @property
    def is_live(self) -> bool:
        """Whether the torque is to be sent."""
        return self.stamp == self.wall_time

    def vectors(self) -> tuple[Array, Array]:
        """Return the torque and the rest, shapes (7,) and (6,)."""
        return self.torque, np.array(self[1:], dtype=float)


def initial_gate() -> GateState:
    """Return a gate that has sent nothing but zeros."""
    return GateState(np.zeros(JOINTS))


def gate_faults(
    config: GateConfig,
    state: GateState,
    *,
    reading: ArmReading,
    torque: Array,
    wall_time: float,
    go: float,
) -> GateFault:
    """Return what is wrong now: parameters as for `gate_step`."""
    faults = reading.faults
    if reading.time < state.status_time:
        faults |= GateFault.OUT_OF_ORDER
    if not abs(wall_time - reading.time) <= config.expiry:
        faults |= GateFault.STALE
    elapsed = wall_time - state.wall_time
    if not math.isfinite(wall_time) or elapsed < 0:
        faults |= GateFault.CLOCK
    if elapsed > config.max_gap:
        faults |= GateFault.GAP
    if not np.isfinite(torque).all():
        faults |= GateFault.NO_TORQUE
    if not go >= 0:
        faults |= GateFault.STOPPED
    return faults


def gate_step(
    config: GateConfig,
    state: GateState,
    *,
    reading: ArmReading,
    torque: Array,
    wall_time: float,
    go: float,
) -> GateState:
    """Return the gate after one more torque.

    Parameters
    ----------
    config : GateConfig
    state : GateState
    reading : ArmReading
        The last status.
    torque : array, shape (7,)
        Wanted, Nm.
    wall_time : float
        Now, s.
    go : float
        How many times the operator has said go; less than 0 for a stop.
    """
    faults = gate_faults(
        config, state, reading=reading, torque=torque, wall_time=wall_time, go=go
    )
    mode, reasons = state.mode, state.faults
    if mode is GateMode.OPEN:
        if faults:
            mode, reasons = GateMode.STOPPED, faults
    elif go > max(state.go, 0.0):
        # A go is of the moment: with a fault, or still on the way to zero, it is void.
        reasons = faults
        if not (faults or state.torque.any()):
            mode = GateMode.OPEN
    elif faults and mode is GateMode.STOPPED:
        reasons |= faults
    wanted = np.zeros(JOINTS)
    if mode is GateMode.OPEN and not config.dry:
        wanted = torque
    is_time = math.isfinite(wall_time)
    in_order = math.isfinite(reading.time) and reading.time > state.status_time
    # A stamp from the future would make all that follow seem late.
    plausible = is_time and reading.time <= wall_time + config.expiry
    sent = limited_change(
        state.torque,
        wanted,
        greatest_change(config, wall_time - state.wall_time),
        np.array(config.max_torque),
    )
    is_live = is_time and (mode is GateMode.OPEN or bool(state.torque.any()))
    return GateState(
        sent,
        mode,
        reasons,
        reading.time if in_order and plausible else state.status_time,
        wall_time if is_time else state.wall_time,
        state.go if math.isnan(go) else max(go, state.go),
        wall_time if is_live else state.stamp,
    )


def greatest_change(config: GateConfig, elapsed: float) -> float:
    """Return how much any torque may change after a time, s; Nm.

    Nothing where the clock is none, and never more than in a millisecond: that is how
    often a robot looks at what was sent.
    """
    if not math.isfinite(elapsed):
        return 0.0
    return config.max_rate * min(max(elapsed, 0.0), _MILLISECOND)


def limited_change(
    previous: Array, wanted: Array, max_change: float, limit: Array
) -> Array:
    """Return a torque on the straight way from one to another, as far as it may change.

    Parameters
    ----------
    previous, wanted : array, shape (n,)
        Nm.
    max_change : float
        Of any joint, Nm.
    limit : array, shape (n,)
        The torque stays within plus and minus it, Nm.
    """
    wanted = np.minimum(np.maximum(wanted, -limit), limit)
    change = wanted - previous
    greatest = float(np.abs(change).max())
    if greatest <= max_change:
        return wanted
    sent = previous + max_change / greatest * change
    return np.minimum(np.maximum(sent, -limit), limit)
