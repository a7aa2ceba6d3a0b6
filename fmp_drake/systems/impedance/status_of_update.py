"""Status of one update of the impedance controller, as a function of arrays."""

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import inlined
from fmp_drake.systems.impedance.force_control import ForceCorrection
from fmp_drake.systems.impedance.joints import LimitedTorque
from fmp_drake.systems.impedance.law import LawTorque
from fmp_drake.systems.impedance.status import StatusFlag
from fmp_drake.systems.impedance.supervision import RECOVERING, STOPPED, WatchdogState

# Plain integers, because compiled functions take no enumerations.
_CONTACT_LOST = int(StatusFlag.CONTACT_LOST)
_ERROR_CLIPPED = int(StatusFlag.ERROR_CLIPPED)
_FORCE_CONTROL = int(StatusFlag.FORCE_CONTROL)
_FORCE_LIMITED = int(StatusFlag.FORCE_LIMITED)
_JOINT_WALL = int(StatusFlag.JOINT_WALL)
_NEAR_SINGULAR = int(StatusFlag.NEAR_SINGULAR)
_OVERSPEED = int(StatusFlag.OVERSPEED)
_PROTECTIVE_STOP = int(StatusFlag.PROTECTIVE_STOP)
_RATE_LIMITED = int(StatusFlag.RATE_LIMITED)
_RECOVER = int(StatusFlag.RECOVER)
_SPEED_LIMITED = int(StatusFlag.SPEED_LIMITED)
_TORQUE_LIMITED = int(StatusFlag.TORQUE_LIMITED)


@inlined
def status_of_update(
    flags: int,
    fraction: float,
    watchdog: WatchdogState,
    law: LawTorque,
    limited: LimitedTorque,
    force: ForceCorrection,
    energy: float,
) -> NDArray[np.float64]:
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
        _PROTECTIVE_STOP * (watchdog.mode == STOPPED)
        | _RECOVER * (watchdog.mode == RECOVERING)
        | _ERROR_CLIPPED * law.clipped
        | _NEAR_SINGULAR * law.near_singular
        | _TORQUE_LIMITED * (limited.torque_scale < 1)
        | _RATE_LIMITED * (limited.rate_scale < 1)
        | _OVERSPEED * limited.overspeed
        | _JOINT_WALL * limited.at_wall
        | _SPEED_LIMITED * limited.too_fast
        | _FORCE_CONTROL * force.closed
        | _CONTACT_LOST * force.lost
        | _FORCE_LIMITED * force.limited
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
