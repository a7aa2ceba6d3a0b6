"""Gate for the torque that is sent to a real arm: its modes, faults and limits."""

import math
import struct
import zlib
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, check_number
from fmp_drake.settings import bounded
from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.panda.arm_status import (
    JOINTS,
    ArmReading,
    GateFault,
    StatusTrack,
    implausible,
    initial_track,
    track_status,
)

# Period at which the robot reads commands, s.
_ROBOT_PERIOD = 0.001
# Damping of each joint in a return and in a stop, Nm s/rad: that of drake-franka-driver
# for an arm without commands. Twice as much oscillates where messages are 5 ms late.
_DAMPING = np.array([37.5, 50, 37.5, 25, 5, 3.75, 2.5])
# Time without a new status after which the torque goes to zero, without a stop, s.
_BLIND_TIME = 0.02
# Longest time for which a stop is braked, s.
_BRAKE_TIME = 0.3
# Latest time that the stamp of a message, 64 bits of microseconds, can represent, s.
_LATEST = 9e12
# Velocity below which a joint is at rest, rad/s.
_AT_REST = 0.01
# After these faults no torque is computed from the measured velocity.
_UNTRUSTED = (
    GateFault.STALE | GateFault.OUT_OF_ORDER | GateFault.CORRUPT | GateFault.NOT_FINITE
    | GateFault.OUT_OF_RANGE | GateFault.JUMP | GateFault.INCONSISTENT | GateFault.FROZEN
    | GateFault.GAP | GateFault.CLOCK
)  # fmt: skip
# Age of a command above which the robot ignores it, s.
_COMMAND_EXPIRY = 0.1
# Number of own commands in memory.
_REMEMBERED = 128
# Greatest number of own commands that count as lost or late, and the time, s, after
# which they are no longer expected.
_MOST_MISSING, _MISSING_TIME = 4, 0.02
# Time for which the controller's torque must be small before the return ends, s.
_RETURN_TIME = 0.1

EXPIRED_AGE = 1.0
"""Age of the stamp of the command that ends a stop, s."""


@dataclass(kw_only=True)
class GateConfig:
    """Limits of the torque that is sent to an arm.

    Attributes
    ----------
    max_torque : list of 7 floats, or empty
        Largest magnitude of each joint's torque, without gravity, Nm; empty for the
        effort limits of the arm's model.
    max_rate : float
        Fastest change of any joint's torque, Nm per second of the wall clock. The default
        is a tenth below the 1000 Nm/s at which Franka's robots stop.
    period : float
        Time between two torques, and between two updates of the controller, s. The robot
        reads commands every millisecond: no torque differs from the previous one by more
        than ``max_rate`` allows in a millisecond, whatever the period.
    expiry : float
        Largest age of a status, s.
    max_gap : float
        Longest pause between two torques that does not stop the arm, s.
    return_speed : float
        Speed of the joints after the gate has opened, as a fraction of their limits,
        until the controller's torque is small; 1 skips this phase.
    dry : bool
        Compute every torque, but send zeros.

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

    max_torque: list[float] = bounded([], above=0)
    max_rate: float = bounded(900.0, above=0, most=1000.0)
    period: float = bounded(0.001, least=0.0005, most=0.002)
    expiry: float = bounded(0.05, above=0, most=0.1)
    max_gap: float = bounded(0.05, above=0, most=0.1)
    return_speed: float = bounded(0.1, above=0, most=1)
    dry: bool = False

    def completed(self, limits: JointLimits) -> "GateConfig":
        """Return the settings with the arm's limits where they have none.

        Raises
        ------
        SystemsError
            If a torque is larger than the arm's limit.
        """
        efforts = np.minimum(limits.upper_effort, -limits.lower_effort).tolist()
        for i, (torque, effort) in enumerate(
            zip(self.max_torque, efforts, strict=False)
        ):
            what, hint = f"max_torque[{i}]", "the limit of the arm"
            check_number(torque, what, most=effort, hint=hint, error=SystemsError)
        if len(self.max_torque) not in (0, len(efforts)):
            raise SystemsError(
                f"max_torque is {self.max_torque}; expected {len(efforts)} numbers."
            )
        return replace(self, max_torque=self.max_torque or efforts)


class GateMode(IntEnum):
    """Mode of the gate.

    - `WAITING`: no torque is sent until the operator enables the gate.
    - `OPEN`: the controller's torque is sent.
    - `STOPPED`: after a fault the torque brakes the joints while their measured velocity
      can be trusted, for 0.3 s at most. Then it is zero until the operator enables the
      gate again. Without a trusted velocity it goes to zero at once.
    - `RETURNING`: the gate has just opened. The torque is small and damped, so that the
      joints are slow, until the controller needs no larger one.

    Zero torque leaves the arm floating under gravity compensation. Without commands the
    robot damps its joints, so nothing is sent once the torque is zero. Where no status
    comes for 20 ms, an open gate brings the torque to zero until the next one.

    Examples
    --------
    >>> GateMode(2).name
    'STOPPED'
    """

    WAITING = 0
    OPEN = 1
    STOPPED = 2
    RETURNING = 3

    @property
    def is_enabled(self) -> bool:
        """Whether the controller's torque is sent, in full or small and damped."""
        return self in (GateMode.OPEN, GateMode.RETURNING)


class CommandTrack(NamedTuple):
    """Memory of the commands that were sent and heard.

    Attributes
    ----------
    heard : float
        Number of commands that were heard.
    unheard : float
        Number of own commands sent after the newest one that was heard.
    missing : float
        Number of own commands that were skipped: lost, or delayed by a changed order.
        Negative where more commands have come than are explained so far.
    missing_time : float
        Time at which one was last skipped, s of the wall clock.
    sent : array, shape (128,)
        Fingerprints of the last own commands, the newest last.
    """

    heard: float = 0.0
    unheard: float = 0.0
    missing: float = 0.0
    missing_time: float = 0.0
    sent: Array = np.full(_REMEMBERED, -1.0)

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> "CommandTrack":
        """Return the memory that `vector` describes."""
        numbers = np.array(vector, dtype=float)
        heard, unheard, missing, missing_time = numbers[:4].tolist()
        return cls(heard, unheard, missing, missing_time, numbers[4:])

    def vector(self) -> Array:
        """Return all values, shape (132,)."""
        return np.concatenate([self[:4], self.sent])

    def after(self, stamp: float, torque: ArrayLike) -> "CommandTrack":
        """Return the memory after a command was sent.

        Parameters
        ----------
        stamp : float
            Of the command, s.
        torque : array_like, shape (7,)
            Nm.
        """
        fingerprint = command_fingerprint(command_utime(stamp), torque)
        return self._replace(
            unheard=min(self.unheard + 1, _REMEMBERED),
            sent=np.append(self.sent[1:], fingerprint),
        )


class GateState(NamedTuple):
    """State of a gate.

    Attributes
    ----------
    torque : array, shape (7,)
        Last torque, Nm.
    mode : GateMode
    faults : GateFault
        Reasons of the last stop, or of the refusal of the last enable request.
    status_time : float
        Time stamp of the newest status, s of the wall clock; minus infinity before the
        first.
    wall_time : float
        Time of the last step, s of the wall clock; NaN before the first.
    go : float
        Operator command: number of enable requests; a negative number requests a stop.
    stamp : float
        Time stamp of the last torque that was sent, s of the wall clock; 0 before the
        first.
    timer : float
        In a return: time for which the controller's torque has been small, s. In a stop:
        time since it began, s.
    arrival : float
        Time at which the newest status came, s of the wall clock.
    track : StatusTrack
        Memory of the statuses.
    commands : CommandTrack
        Memory of the commands.
    """

    torque: Array
    mode: GateMode = GateMode.WAITING
    faults: GateFault = GateFault(0)
    status_time: float = -np.inf
    wall_time: float = np.nan
    go: float = 0.0
    stamp: float = 0.0
    timer: float = 0.0
    arrival: float = -np.inf
    track: StatusTrack = initial_track()
    commands: CommandTrack = CommandTrack()

    @classmethod
    def from_vectors(
        cls, torque: Array, numbers: Array, track: Array, commands: Array
    ) -> "GateState":
        """Return the state that `vectors` describes."""
        mode, faults, *times = numbers.tolist()
        first = torque.copy(), GateMode(int(mode)), GateFault(int(faults))
        tracks = StatusTrack.from_vector(track), CommandTrack.from_vector(commands)
        return cls._make((*first, *times, *tracks))

    @property
    def is_live(self) -> bool:
        """Return whether the torque must be sent."""
        return self.stamp == self.wall_time

    @property
    def command_time(self) -> float:
        """Time stamp of the command, s of the wall clock.

        The command that ends a stop has expired: the robot then damps its joints by its
        own measurement at once, instead of after the previous command has expired.
        """
        is_last = self.mode is GateMode.STOPPED and not self.torque.any()
        return self.stamp - EXPIRED_AGE * is_last

    def vectors(self) -> tuple[Array, Array, Array, Array]:
        """Return torque (7,), numbers (7,), track (44,) and commands (132,)."""
        numbers = np.array(self[1:-2], dtype=float)
        return self.torque, numbers, self.track.vector(), self.commands.vector()


def initial_gate() -> GateState:
    """Return the state of a gate before its first step."""
    return GateState(np.zeros(JOINTS))


class GateInputs(NamedTuple):
    """Inputs of a gate at one step.

    Attributes
    ----------
    reading : ArmReading
        The last status.
    command : lcmt_panda_command
        The newest command on the bus, of this gate or of another program.
    command_count : float
        Number of commands on the bus so far.
    torque : array, shape (7,)
        Torque of the controller, Nm.
    wall_time : float
        Present time, s.
    go : float
        Operator command: number of enable requests; a negative number requests a stop.
    """

    reading: ArmReading
    command: Any
    command_count: float
    torque: Array
    wall_time: float
    go: float


def gate_faults(
    config: GateConfig,
    state: GateState,
    inputs: GateInputs,
    *,
    limits: JointLimits,
    track: StatusTrack,
    is_foreign: bool,
) -> GateFault:
    """Return the present faults.

    Parameters are those of `gate_step`; `track` is the memory after this status, and
    `is_foreign` is whether another program commands the arm.
    """
    reading, _, _, torque, wall_time, go = inputs
    faults = reading.faults
    if reading.is_finite:
        faults |= implausible(limits, state.track, track, reading)
    if is_foreign:
        faults |= GateFault.OTHER_CONTROLLER
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
    config: GateConfig, state: GateState, inputs: GateInputs, *, limits: JointLimits
) -> GateState:
    """Return the state of the gate after its next torque.

    Parameters
    ----------
    config : GateConfig
        With torque limits: see `GateConfig.completed`.
    state : GateState
    inputs : GateInputs
    limits : JointLimits
        Of the arm.
    """
    reading, command, count, torque, wall_time, go = inputs
    is_time = abs(wall_time) <= _LATEST
    # Reject a stamp from the future: every later status would be out of order.
    in_time = (
        is_time
        and state.status_time <= reading.time <= wall_time + config.expiry
        and math.isfinite(reading.time)
    )
    track = state.track
    if in_time and reading.is_finite:
        track = track_status(track, reading, state.torque)
    commands, is_foreign = track_commands(state.commands, command, count, wall_time)
    faults = gate_faults(
        config, state, inputs, limits=limits, track=track, is_foreign=is_foreign
    )
    was_active = state.mode.is_enabled or bool(state.torque.any())
    mode, reasons, timer = state.mode, state.faults, state.timer
    elapsed = wall_time - state.wall_time
    if mode.is_enabled:
        if faults:
            mode, reasons, timer = GateMode.STOPPED, faults, 0.0
    elif go > max(state.go, 0.0):
        # A request counts at this step only, and only without a fault and at zero torque.
        reasons = faults
        if not (faults or state.torque.any()):
            mode, timer = GateMode.RETURNING, 0.0
            if config.return_speed == 1:
                mode = GateMode.OPEN
    elif faults and mode is GateMode.STOPPED:
        reasons |= faults
    desired = torque if mode.is_enabled else np.zeros(JOINTS)
    if mode is GateMode.RETURNING:
        desired, is_small = return_torque(config, limits, reading, torque)
        timer = timer + max(elapsed, 0.0) if is_small else 0.0
        if timer > _RETURN_TIME:
            mode = GateMode.OPEN
    elif mode is GateMode.STOPPED:
        timer += max(elapsed, 0.0) if math.isfinite(elapsed) else _BRAKE_TIME
        # Once a stop has brought the torque to zero, nothing more is sent.
        if was_active and timer < _BRAKE_TIME and not reasons & _UNTRUSTED:
            desired = brake_torque(limits, reading)
    is_new = in_time and reading.time > state.status_time
    arrival = wall_time if is_new else state.arrival
    if config.dry or (mode.is_enabled and wall_time - arrival > _BLIND_TIME):
        desired = np.zeros(JOINTS)
    sent = limited_change(
        state.torque,
        desired,
        largest_change(config, elapsed),
        np.array(config.max_torque),
    )
    is_live = is_time and (mode.is_enabled or was_active)
    next_state = GateState(
        sent,
        mode,
        reasons,
        reading.time if in_time else state.status_time,
        wall_time if is_time else state.wall_time,
        state.go if math.isnan(go) else max(go, state.go),
        wall_time if is_live else state.stamp,
        timer,
        arrival,
        track,
        commands,
    )
    if not is_live:
        return next_state
    commands = commands.after(next_state.command_time, sent)
    return next_state._replace(commands=commands)


def brake_torque(limits: JointLimits, reading: ArmReading) -> Array:
    """Return the torque that damps the joints, shape (7,), Nm; zero at rest."""
    velocity = np.clip(reading.state[JOINTS:], -limits.speed, limits.speed)
    if np.all(np.abs(velocity) < _AT_REST):
        return np.zeros(JOINTS)
    return -_DAMPING * velocity


def return_torque(
    config: GateConfig, limits: JointLimits, reading: ArmReading, torque: Array
) -> tuple[Array, bool]:
    """Return a small and damped torque, and whether the controller needs no larger one.

    Joint i gets ``s tau_i - b_i v_i`` with one factor s, so that ``|s tau_i|`` is at most
    ``b_i`` times the allowed speed: at that speed the damping balances the torque,
    whatever the controller's torque is.

    Parameters
    ----------
    config : GateConfig
    limits : JointLimits
    reading : ArmReading
        Without faults.
    torque : array, shape (7,)
        Torque of the controller, Nm.
    """
    velocity, allowed = reading.state[JOINTS:], config.return_speed * limits.speed
    factor = float(np.max(np.abs(torque) / (_DAMPING * allowed)))
    is_small = factor <= 1 and bool(np.all(np.abs(velocity) <= allowed))
    return torque / max(factor, 1.0) - _DAMPING * velocity, is_small


def largest_change(config: GateConfig, elapsed: float) -> float:
    """Return the largest change of any torque, Nm, after an elapsed time, s.

    Zero where the time is not finite, and never more than for a millisecond, the period
    at which the robot reads commands.
    """
    if not math.isfinite(elapsed):
        return 0.0
    return config.max_rate * min(max(elapsed, 0.0), _ROBOT_PERIOD)


def limited_change(
    previous: Array, desired: Array, max_change: float, limit: Array
) -> Array:
    """Return a torque with limited change, on the straight line to the desired one.

    Parameters
    ----------
    previous, desired : array, shape (n,)
        Nm.
    max_change : float
        Largest change of any joint's torque, Nm.
    limit : array, shape (n,)
        Largest magnitude of each torque, Nm.
    """
    desired = np.minimum(np.maximum(desired, -limit), limit)
    change = desired - previous
    largest = float(np.abs(change).max())
    if largest <= max_change:
        return desired
    sent = previous + max_change / largest * change
    return np.minimum(np.maximum(sent, -limit), limit)


def command_utime(stamp: float) -> int:
    """Return the time stamp of a command, us, for a time of the wall clock, s."""
    return int((stamp + 0.5e-6) * 1e6)


def command_fingerprint(utime: int, torque: ArrayLike) -> float:
    """Return a checksum that identifies a torque command."""
    return float(zlib.crc32(struct.pack("<8d", utime, *np.asarray(torque).tolist())))


def track_commands(
    track: CommandTrack, command: Any, count: float, wall_time: float
) -> tuple[CommandTrack, bool]:
    """Return the memory after reading the bus, and whether another program commands.

    The gate's own commands are on the bus, too. If the newest one is the gate's own, at
    most as many came since the last reading as the gate has sent in the meantime. One more
    is another program's, in whatever order they came, and even if it copies the gate's
    own. A newest command that the gate has not sent is another program's: it counts when
    it comes, and until it is so old that the robot ignores it.

    Parameters
    ----------
    track : CommandTrack
    command : lcmt_panda_command
        The newest one on the bus.
    count : float
        Number of commands on the bus so far.
    wall_time : float
        Present time, s.
    """
    heard = count - track.heard
    track = track._replace(heard=count)
    torque = command.joint_torque
    is_own = np.zeros(_REMEMBERED, dtype=bool)
    if len(torque) == JOINTS:
        is_own = track.sent == command_fingerprint(command.utime, torque)
    if not is_own.any():
        is_fresh = abs(wall_time - 1e-6 * command.utime) <= _COMMAND_EXPIRY
        return track, heard > 0 or is_fresh
    if heard <= 0:
        return track, False
    later = float(np.argmax(is_own[::-1]))
    passed = max(track.unheard - later, 0.0)
    unheard = min(track.unheard, later)
    missing, missing_time = track.missing, track.missing_time
    if not wall_time - missing_time <= _MISSING_TIME:
        missing = min(missing, 0.0)
    if passed > heard:
        missing_time = wall_time
    missing += passed - heard
    # Commands of the gate that were sent later may have come before the newest.
    is_foreign = missing + unheard < 0
    missing = min(max(missing, -unheard), _MOST_MISSING)
    track = track._replace(unheard=unheard, missing=missing, missing_time=missing_time)
    return track, is_foreign
