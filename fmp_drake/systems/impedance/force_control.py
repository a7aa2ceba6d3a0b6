"""The normal force: how it comes in, where the surface is found, its closed loop.

A normal force is wanted at a surface that may not be where it is said to be. The
height at which the surface was found is the one memory of it: the target is as much
higher, so that along the normal nothing but the wanted force is left of the law. It
follows the measured force where there is one. Where there is none, what the law commands
along the normal is the force of the contact, in quasi-static balance; the wanted force
is left when the spring is at rest, so the height follows that of the tool.

That estimate is wrong by the friction of the joints (about 5 N at a Panda's tool where
it is not compensated), by the tool's inertia for 0.1 s after a jolt, and while the torque
is limited. It cannot tell a surface from a person: who lifts the tool by less than half
of `search_range` is taken for one, and who holds it there is slowly believed.

A tool that was pushed far from its target along the surface may be beside what it shall
press on. There the press and the search rest, and the tool is lifted until it is back.
Force controllers are let go likewise where the tool is lifted off the surface [1]_.

References
----------
.. [1] C. Schindlbeck, S. Haddadin, "Unified passivity-based Cartesian force/impedance
   control for rigid and flexible joint robots via task-energy tanks", ICRA 2015.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from fmp_drake.compiled import compiled

# Without a sensor: the fraction of the wanted force from which on there is contact. In
# free air the friction of the joints is left of the force, about 3 of 10 N.
_CONTACT_FRACTION = 0.3
# A person who lifts the tool cannot be told from a surface that is higher: that is
# believed more slowly than a lower one.
_RISE_FRACTION = 0.25
# The speed of the approach falls with the height over the surface, with this time
# constant, s. It is about that of the arm's own braking, Λ / D.
_BRAKING_TIME = 0.15


@dataclass(kw_only=True)
class ForceControlConfig:
    """How the normal force, along −z of T, is brought to the surface and kept there.

    Attributes
    ----------
    enabled : bool
        Whether the measured force at the port `normal_force` is used.
    proportional_gain : float
        Newton of correction for a newton of error of the measured force.
    integral_gain : float
        Rate at which the force is corrected, 1/s; with the proportional gain p, the
        bandwidth is this by 1 + p. On a stiff board the loop is stable below
        ``(1 + p) D / Λ``, with the damping D (the law's and the felt's) and the
        inertia Λ along the normal.
    contact_force : float
        Measured force from which on there is contact, N.
    release_time : float
        Without contact for this long, it is lost, s.
    search_speed : float
        At which the tool looks for the surface below where it is said to be, m/s.
        Where it is farther above, it approaches faster.
    search_range : float
        How much lower or higher the surface may be, m. Where it is not found, there
        is a protective stop.
    rest_distance : float
        Distance of the tool from its target along the surface from which on the press
        fades; from twice as much on it rests, m. Both grow with the height over
        `lift_height`.
    lift_height : float
        To which the tool is lifted there, m; higher where the target is farther away
        than the stiffness sees.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> config = ImpedanceConfig(force_control=ForceControlConfig(search_range=0.02))
    >>> config.check()
    """

    enabled: bool = False
    proportional_gain: float = 1.0
    integral_gain: float = 20.0
    contact_force: float = 0.5
    release_time: float = 0.05
    search_speed: float = 0.03
    search_range: float = 0.03
    rest_distance: float = 0.1
    lift_height: float = 0.03


class ForceState(NamedTuple):
    """What is remembered of the surface.

    Attributes
    ----------
    surface : float
        Height at which it was found, over where it is said to be, m.
    force : float
        That the law commands along −z of T, low-pass filtered, N.
    lost_time : float
        For how long nothing was touched, s.
    """

    surface: float = 0.0
    force: float = 0.0
    lost_time: float = math.inf


class Press(NamedTuple):
    """What is wanted and known of the normal force at one update.

    Attributes
    ----------
    wanted, measured : float
        Force of the tool along −z of T, N; NaN where it is not measured.
    searching : bool
        Whether the target is at the surface, which is to be found.
    away : bool
        Whether the tool is far from its target along the surface.
    height : float
        Of the tool over its target, m.
    stiffness : float
        Along z of T, N/m.
    saturated : bool
        Whether the torque was limited at the update before.
    """

    wanted: float
    measured: float
    searching: bool
    away: bool
    height: float
    stiffness: float
    saturated: bool


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
def approach_factor(
    config: ForceControlConfig, surface: float, height: float, speed: float
) -> float:
    """Return the factor of the wanted force that brings the tool back soon and softly.

    It is 2 where the tool is higher than the surface may be, 1 at the surface, and 0
    from twice the allowed speed on. What is touched is pressed with the whole force.

    Parameters
    ----------
    config : ForceControlConfig
        As `values_of` returns it.
    surface, height : float
        Of the surface that was found and of the tool, over the target, m.
    speed : float
        Of the tool towards the surface, m/s.
    """
    above = max(height - surface, 0.0)
    allowed = config.search_speed + above / _BRAKING_TIME
    far = 1 - engagement(above - config.search_range, config.search_range)
    return (1 + far) * min(max(2 - speed / allowed, 0.0), 1.0)


@compiled
def is_beyond(config: ForceControlConfig, state: ForceState, height: float) -> bool:
    """Tell whether nothing was found as deep as is searched."""
    deepest = max(state.surface, height)
    return state.lost_time > config.release_time and deepest <= -config.search_range


@compiled
def correct_normal_force(
    config: ForceControlConfig, state: ForceState, press: Press, period: float
) -> ForceCorrection:
    """Find the surface, and correct the normal force by what is measured of it.

    The height of the surface stands still while the arm's torque is saturated or the
    tool is far from its target, and stops at `search_range`. What was found is forgotten, at `search_speed`, when
    nothing is looked for any more.

    Parameters
    ----------
    config : ForceControlConfig
        As `values_of` returns it.
    state : ForceState
        Of the update before.
    press : Press
    period : float
        Time between updates, s.

    Returns
    -------
    ForceCorrection
    """
    surface, known = state.surface, not math.isnan(press.measured)
    above = press.height - surface
    if known:
        touching = press.measured > config.contact_force
    else:
        touching = (
            state.force > _CONTACT_FRACTION * press.wanted
            and above < config.search_range / 2
        )
    lost_time = 0.0 if touching and press.wanted > 0 else state.lost_time + period
    closed = known and press.wanted > 0 and lost_time <= config.release_time
    error, speed = press.wanted - press.measured, 0.0
    if closed:
        if touching:
            speed = -config.integral_gain * error / press.stiffness
    elif press.searching:
        highest = 0.0
        if not known and above < config.search_range:
            highest = _RISE_FRACTION * config.search_speed
        speed = min(config.integral_gain * above, highest)
    else:
        speed = min(max(-surface / period, -config.search_speed), config.search_speed)
    most = config.search_range
    if not (press.saturated or press.away):
        surface = min(max(surface + period * speed, -most), most)
    # Pushing is never turned into pulling.
    correction = max(config.proportional_gain * error, -press.wanted) if closed else 0.0
    lost = press.wanted > 0 and lost_time > config.release_time
    return ForceCorrection(
        correction,
        ForceState(surface, state.force, lost_time),
        closed,
        lost and (known or press.searching),
        (closed or press.searching) and abs(surface) == most,
    )


@compiled
def with_force(
    config: ForceControlConfig, state: ForceState, force: float, period: float
) -> ForceState:
    """Remember the force that the law commands along −z of T, N."""
    passed = min(period / config.release_time, 1.0)
    return ForceState(
        state.surface, state.force + passed * (force - state.force), state.lost_time
    )
