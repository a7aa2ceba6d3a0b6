"""The watchdog of the impedance controller: hold, wait, lead back to the target."""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple


@dataclass(kw_only=True)
class WatchdogConfig:
    """When the target is not to be followed, and how it is returned to.

    Attributes
    ----------
    max_jump, max_turn : float
        Farthest that the target may move from one update to the next, m and rad.
    max_age : float
        Oldest target, s: by the port `target_time` where it is connected, and else
        by how long the position has stood still although it has a velocity.
    settle_time : float
        How long the target must be good before it is followed again, s.
    recovery_speed, recovery_turn_rate : float
        Greatest speed at which the hold is led to where the target is, m/s, rad/s.
    """

    max_jump: float = 0.05
    max_turn: float = 0.3
    max_age: float = 0.1
    settle_time: float = 0.2
    recovery_speed: float = 0.2
    recovery_turn_rate: float = 0.8


class WatchdogMode(IntEnum):
    """What the watchdog does.

    `LOST` is a hold whose pose is not known, because the state was not.
    """

    TRACK = 0
    HOLD = 1
    RECOVER = 2
    LOST = 3


class WatchdogState(NamedTuple):
    """The mode, the seconds spent in it, and the seconds that a recovery takes."""

    mode: int = WatchdogMode.TRACK
    clock: float = 0.0
    duration: float = 0.0

    def blend(self) -> tuple[float, float]:
        """Return the target's share and its rate in 1/s: a smooth step over time."""
        if self.mode == WatchdogMode.TRACK:
            return 1.0, 0.0
        if self.mode != WatchdogMode.RECOVER:
            return 0.0, 0.0
        x = self.clock / self.duration
        return x * x * (3 - 2 * x), 6 * x * (1 - x) / self.duration


def watch(
    config: WatchdogConfig,
    state: WatchdogState,
    *,
    fault: bool,
    distance: float,
    angle: float,
    period: float,
) -> WatchdogState:
    """Decide what to do at one update.

    Parameters
    ----------
    config : WatchdogConfig
    state : WatchdogState
        Of the update before.
    fault : bool
        Whether something is wrong with the target now.
    distance, angle : float
        From where the arm is held to the target, m and rad; used in a hold.
    period : float
        Time between updates, s.

    Returns
    -------
    WatchdogState
        Of this update.
    """
    mode, clock, duration = state
    clock += period
    if fault or mode == WatchdogMode.LOST:
        return WatchdogState(WatchdogMode.HOLD)
    if mode == WatchdogMode.HOLD and clock >= config.settle_time:
        # A smooth step is 1.5 times as fast in its middle as on average.
        duration = 1.5 * max(
            distance / config.recovery_speed, angle / config.recovery_turn_rate
        )
        return WatchdogState(
            WatchdogMode.RECOVER, 0.0, max(duration, config.settle_time)
        )
    if mode == WatchdogMode.RECOVER and clock >= duration:
        return WatchdogState()
    if mode == WatchdogMode.TRACK:
        return state
    return WatchdogState(mode, clock, duration)
