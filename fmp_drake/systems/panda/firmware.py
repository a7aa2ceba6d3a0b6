"""What a robot's side does with the torque that is sent to it, to simulate one."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_panda_command, lcmt_panda_status
from numpy.typing import NDArray

from fmp_drake.settings import bounded
from fmp_drake.systems.panda.gating import limited_change
from fmp_drake.systems.panda.reading import JOINTS

Array = NDArray[np.float64]


@dataclass(kw_only=True)
class FirmwareConfig:
    """How a robot treats commands.

    Attributes
    ----------
    expiry : float
        Greatest difference of a command's stamp from the wall clock, s.
    damping : list of 7 floats
        Of the joints when there is no command, Nm s/rad; as of drake-franka-driver.
    max_rate : float
        Greatest change of a torque, Nm/s.
    cutoff : float
        Of the low-pass filter of the torque, Hz.

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
    """What a robot did with the last command: followed it, damped, or gave up."""

    FOLLOWED = 0
    DAMPED = 1
    REFLEX = 2


class FirmwareState(NamedTuple):
    """The limited and the filtered torque, Nm, and what was done with the command."""

    limited: Array
    torque: Array
    obeyed: Obeyed = Obeyed.DAMPED


def torque_command(torque: Array, wall_time: float) -> Any:
    """Return an ``lcmt_panda_command`` of a torque, Nm, stamped with a wall time, s."""
    message = lcmt_panda_command()
    message.utime = round(1e6 * wall_time)
    message.num_joint_torque = JOINTS
    message.joint_torque = torque.tolist()
    message.control_mode_expected = lcmt_panda_status.CONTROL_MODE_TORQUE
    return message


def firmware_step(
    config: FirmwareConfig,
    state: FirmwareState,
    *,
    command: Any,
    wall_time: float,
    velocity: Array,
    period: float,
) -> FirmwareState:
    """Return the torque of the motors, without gravity, a period later.

    Parameters
    ----------
    config : FirmwareConfig
    state : FirmwareState
    command : lcmt_panda_command
        The last; one without a stamp is none.
    wall_time : float
        s.
    velocity : array, shape (7,)
        Of the joints, rad/s.
    period : float
        s.
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
        state.limited, wanted, config.max_rate * period, np.full(JOINTS, 87.0)
    )
    blend = 1 - np.exp(-2 * np.pi * config.cutoff * period)
    torque = state.torque + blend * (limited - state.torque)
    return FirmwareState(limited, torque, obeyed)
