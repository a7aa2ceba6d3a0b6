"""The closed loop of the normal force, around the press that is fed forward."""

from dataclasses import dataclass
from typing import NamedTuple


@dataclass(kw_only=True)
class ForceControlConfig:
    """A proportional-integral controller of the force along T's z axis.

    Attributes
    ----------
    enabled : bool
        Whether the port `normal_force` is used.
    proportional_gain : float
        Newton of correction for a newton of error.
    integral_gain : float
        Rate at which the press is corrected, 1/s; with the proportional gain p, the
        bandwidth is this by 1 + p. On a stiff board the loop is stable below
        ``(1 + p) D / Λ``, with the damping D (the law's and the felt's) and the
        inertia Λ along the normal.
    max_correction : float
        Greatest correction, N.
    contact_force : float
        Measured force from which on there is contact, N.
    release_time : float
        Without contact for this long, the correction is taken back, s.
    """

    enabled: bool = False
    proportional_gain: float = 1.0
    integral_gain: float = 20.0
    max_correction: float = 10.0
    contact_force: float = 0.5
    release_time: float = 0.05


class ForceState(NamedTuple):
    """The integral in N, and for how long nothing was touched in s."""

    integral: float = 0.0
    lost_time: float = float("inf")


class ForceCorrection(NamedTuple):
    """What is added to the press in N, and why."""

    correction: float
    state: ForceState
    closed: bool
    lost: bool
    limited: bool


def correct_press(
    config: ForceControlConfig,
    state: ForceState,
    *,
    wanted: float,
    measured: float,
    saturated: bool,
    period: float,
) -> ForceCorrection:
    """Correct a press by what is measured of it.

    The integral stands still while the arm's torque is saturated and stops at
    `max_correction`. It is taken back, with `release_time` as time constant, when
    contact is lost for that long, or no press is wanted.

    Parameters
    ----------
    config : ForceControlConfig
    state : ForceState
        Of the update before.
    wanted, measured : float
        Press, N; positive where the tool pushes along −z of T.
    saturated : bool
        Whether the torque was limited at the update before.
    period : float
        Time between updates, s.

    Returns
    -------
    ForceCorrection
    """
    integral, lost_time = state
    touching = measured > config.contact_force
    lost_time = 0.0 if touching else lost_time + period
    if wanted <= 0 or lost_time > config.release_time:
        integral *= max(1 - period / config.release_time, 0.0)
        return ForceCorrection(
            integral,
            ForceState(integral, lost_time),
            False,
            wanted > 0 and not touching,
            False,
        )
    error = wanted - measured
    if touching and not saturated:
        integral += config.integral_gain * period * error
    most = config.max_correction
    integral = min(max(integral, -most), most)
    # The press is never turned into a pull.
    total = max(integral + config.proportional_gain * error, -wanted)
    total = min(max(total, -most), most)
    return ForceCorrection(
        total, ForceState(integral, lost_time), True, False, abs(total) == most
    )
