"""Model of a Panda's own treatment of torque commands, to simulate one."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_panda_status
from numpy.typing import NDArray

from fmp_drake.settings import bounded
from fmp_drake.systems.panda.gate import limited_change
from fmp_drake.systems.panda.status import JOINTS

Array = NDArray[np.float64]


@dataclass(kw_only=True)
class FirmwareConfig:
    """Treatment of commands by a robot.

    Attributes
    ----------
    expiry : float
        Largest difference between a command's stamp and the wall clock, s.
    damping : list of 7 floats
        Damping of the joints without a command, Nm s/rad; that of drake-franka-driver.
    max_rate : float
        Fastest change of a torque, Nm/s.
    cutoff : float
        Cutoff frequency of the torque's low-pass filter, Hz.

    Examples
    --------
    >>> FirmwareConfig().expiry
    0.05
    """

    expiry: float = bounded(0.05, above=0)
    damping: list[float] = bounded([37.5, 50, 37.5, 25, 5, 3.75, 2.5], least=0)
    max_rate: float = bounded(1000.0, above=0)
    cutoff: float = bounded(30.0, above=0)


class Obeyed(IntEnum):
    """Reaction of a robot to the last command: it followed, damped, or stopped."""

    FOLLOWED = 0
    DAMPED = 1
    REFLEX = 2


class FirmwareState(NamedTuple):
    """Limited and filtered torque, Nm, and the reaction to the last command."""

    limited: Array
    torque: Array
    obeyed: Obeyed = Obeyed.DAMPED


def firmware_step(
    config: FirmwareConfig,
    state: FirmwareState,
    *,
    command: Any,
    wall_time: float,
    velocity: Array,
    period: float,
) -> FirmwareState:
    """Return the torque of the motors, without gravity, after a period.

    Parameters
    ----------
    config : FirmwareConfig
    state : FirmwareState
    command : lcmt_panda_command
        The last command; its stamp is 0 before the first.
    wall_time : float
        Present time, s.
    velocity : array, shape (7,)
        Of the joints, rad/s.
    period : float
        Time between two steps, s.
    """
    obeyed = Obeyed.FOLLOWED
    if abs(wall_time - 1e-6 * command.utime) > config.expiry:
        obeyed = Obeyed.DAMPED
    elif (
        len(command.joint_torque) != JOINTS
        or command.control_mode_expected != lcmt_panda_status.CONTROL_MODE_TORQUE
        or not np.all(np.isfinite(command.joint_torque))
    ):
        obeyed = Obeyed.REFLEX
    if state.obeyed is Obeyed.REFLEX:
        obeyed = Obeyed.REFLEX
    if obeyed is Obeyed.FOLLOWED:
        wanted = np.array(command.joint_torque)
    else:
        wanted = -np.array(config.damping) * velocity
    limited = limited_change(
        state.limited, wanted, config.max_rate * period, np.full(JOINTS, np.inf)
    )
    blend = 1 - np.exp(-2 * np.pi * config.cutoff * period)
    torque = state.torque + blend * (limited - state.torque)
    return FirmwareState(limited, torque, obeyed)
