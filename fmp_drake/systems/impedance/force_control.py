"""The normal force: where it is wanted, and its closed loop."""

from dataclasses import dataclass
from typing import NamedTuple

from fmp_drake.compiled import compiled


@dataclass(kw_only=True)
class ForceControlConfig:
    """A proportional-integral controller of the normal force, along −z of T.

    Attributes
    ----------
    enabled : bool
        Whether the measured force at the port `normal_force` is used.
    proportional_gain : float
        Newton of correction for a newton of error.
    integral_gain : float
        Rate at which the force is corrected, 1/s; with the proportional gain p, the
        bandwidth is this by 1 + p. On a stiff board the loop is stable below
        ``(1 + p) D / Λ``, with the damping D (the law's and the felt's) and the
        inertia Λ along the normal.
    max_correction : float
        Greatest correction, N.
    contact_force : float
        Measured force from which on there is contact, N.
    release_time : float
        Without contact for this long, the correction is taken back, s.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> config = ImpedanceConfig(force_control=ForceControlConfig(enabled=True))
    >>> config.check()
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
    """What is added to the wanted normal force in N, and why."""

    correction: float
    state: ForceState
    closed: bool
    lost: bool
    limited: bool


@compiled
def engagement(height: float, engage_height: float) -> float:
    """Return a smooth step of the height: 0 from `engage_height` on, 1 on the surface.

    Both are in m.
    """
    nearness = min(max(1 - height / engage_height, 0.0), 1.0)
    return nearness * nearness * (3 - 2 * nearness)


@compiled
def correct_normal_force(
    config: ForceControlConfig,
    state: ForceState,
    wanted: float,
    measured: float,
    saturated: bool,
    period: float,
) -> ForceCorrection:
    """Correct the normal force that is fed forward by what is measured of it.

    The integral stands still while the arm's torque is saturated and stops at
    `max_correction`. It is taken back, with `release_time` as time constant, when
    contact is lost for that long, or no force is wanted.

    Parameters
    ----------
    config : ForceControlConfig
        As `values_of` returns it.
    state : ForceState
        Of the update before.
    wanted, measured : float
        Force of the tool along −z of T, N; positive where it pushes.
    saturated : bool
        Whether the torque was limited at the update before.
    period : float
        Time between updates, s.

    Returns
    -------
    ForceCorrection
    """
    touching = measured > config.contact_force
    lost_time = 0.0 if touching else state.lost_time + period
    if wanted <= 0 or lost_time > config.release_time:
        integral = state.integral * max(1 - period / config.release_time, 0.0)
        lost = wanted > 0 and not touching
        return ForceCorrection(
            integral, ForceState(integral, lost_time), False, lost, False
        )
    error, integral = wanted - measured, state.integral
    if touching and not saturated:
        integral += config.integral_gain * period * error
    most = config.max_correction
    integral = min(max(integral, -most), most)
    # Pushing is never turned into pulling.
    total = max(integral + config.proportional_gain * error, -wanted)
    total = min(max(total, -most), most)
    return ForceCorrection(
        total, ForceState(integral, lost_time), True, False, abs(total) == most
    )
