"""Commands on the bus of an arm: the gate's own, and those of another controller."""

import struct
import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.systems.panda.arm_status import JOINTS

Array = NDArray[np.float64]

# Age of a command above which the robot ignores it, s.
_COMMAND_EXPIRY = 0.1
# Number of own commands in memory.
_REMEMBERED = 128
# Own commands that may be missing or late for so long, s, before they no longer make up
# for others.
_MOST_MISSING, _MISSING_TIME = 4, 0.02


class CommandTrack(NamedTuple):
    """Memory of the commands that were sent and heard.

    Attributes
    ----------
    heard : float
        Number of commands that were heard.
    unheard : float
        Number of own commands sent after the newest one that was heard.
    missing : float
        Number of own commands that were skipped: lost, or late by a changed order. It
        is negative after more commands than have been explained so far.
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


def command_utime(stamp: float) -> int:
    """Return the time stamp of a command, us, for a time of the wall clock, s."""
    return int((stamp + 0.5e-6) * 1e6)


def command_fingerprint(utime: int, torque: ArrayLike) -> float:
    """Return a number that tells one torque command from another."""
    return float(zlib.crc32(struct.pack("<8d", utime, *np.asarray(torque).tolist())))


def track_commands(
    track: CommandTrack, command: Any, count: float, wall_time: float
) -> tuple[CommandTrack, bool]:
    """Return the memory after a look at the bus, and whether another program commands.

    The gate's own commands are on the bus, too. If the newest one is the gate's own, at
    most as many came since the last look as the gate has sent in the meantime. One more is
    another program's, in whatever order they came, and even if it copies the gate's
    own. A newest command that the gate has not sent is another program's: when it comes,
    and until it is so old that the robot ignores it.

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
