"""Normal force: engagement, search for the surface, closed-loop control.

The surface may be higher or lower than assumed. The state is the height at which it was
found: the target is raised by it, so that along the normal the law commands nothing but
the desired force. With a measured force the height follows from the force error. Without
one, the normal force of the law is that of the contact, in quasi-static balance. The
spring is then at rest under the desired force, so the height follows that of the tool.

That estimate is wrong by the friction of the joints (about 5 N at the tool of a Panda
without compensation), by the tool's inertia for 0.1 s after a jolt, and while the torque
is limited. It cannot distinguish a surface from a person: a person who lifts the tool by
less than half of `search_range` is taken for a surface, and the height slowly follows.

A tool that was pushed far from its target along the surface may be beside the surface.
Then the normal force and the search stop, and the tool is lifted until it is back.
Force controllers are disengaged likewise where the tool leaves the surface [1]_.

References
----------
.. [1] C. Schindlbeck, S. Haddadin, "Unified passivity-based Cartesian force/impedance
   control for rigid and flexible joint robots via task-energy tanks", ICRA 2015.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array
from fmp_drake.settings import bounded

CONTACT_FORCE = 0.5
"""Normal force above which the tool is in contact with the surface, N."""

# Without a sensor: the fraction of the desired force above which there is contact. In
# free air the joints' friction leaves about 3 of 10 N.
_CONTACT_FRACTION = 0.3
# A person who lifts the tool cannot be distinguished from a higher surface, which is
# therefore followed more slowly than a lower one.
_RISE_FRACTION = 0.25
# The speed of the approach falls with the height over the surface, with this time
# constant, s. It is about that of the arm's own braking, Λ / D.
_BRAKING_TIME = 0.15


@dataclass(kw_only=True)
class ForceControlConfig:
    """Control of the normal force, along −z of T, and search for the surface.

    Attributes
    ----------
    enabled : bool
        Whether the measured force at the port `normal_force` is used.
    proportional_gain : float
        Correction in newtons per newton of error of the measured force.
    integral_gain : float
        Rate at which the force is corrected, 1/s; with the proportional gain p, the
        bandwidth is this rate divided by 1 + p. On a stiff board the loop is stable
        below ``(1 + p) D / Λ``, with the damping D (the law's and the felt's) and the
        inertia Λ along the normal.
    contact_force : float
        Measured force above which there is contact, N.
    release_time : float
        Time without contact after which the contact is lost, s.
    search_speed : float
        Speed of the search below the assumed surface, m/s. Farther above the surface
        the tool approaches faster.
    search_range : float
        Greatest error of the assumed height of the surface, m. Where the surface is
        not found within it, there is a protective stop.
    rest_distance : float
        Distance of the tool from its target along the surface above which the normal
        force fades, m; at twice the distance it is zero. Both grow with the height
        above `lift_height`.
    lift_height : float
        Height to which the tool is lifted where the force has faded, m; higher where
        the error is clipped.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> config = ImpedanceConfig(force_control=ForceControlConfig(search_range=0.02))
    >>> config.force_control.search_speed
    0.03
    """

    enabled: bool = False
    proportional_gain: float = bounded(1.0, least=0)
    integral_gain: float = bounded(20.0, above=0)
    contact_force: float = bounded(CONTACT_FORCE, least=0)
    release_time: float = bounded(0.05, above=0)
    search_speed: float = bounded(0.03, above=0)
    search_range: float = bounded(0.03, above=0)
    rest_distance: float = bounded(0.1, above=0)
    lift_height: float = bounded(0.03, above=0)


class ForceState(NamedTuple):
    """State of the search for the surface.

    Attributes
    ----------
    surface : float
        Height of the surface that was found above the assumed one, m.
    force : float
        Normal force of the law along −z of T, low-pass filtered, N.
    lost_time : float
        Time since the last contact, s.
    """

    surface: float = 0.0
    force: float = 0.0
    lost_time: float = math.inf


class NormalForceDemand(NamedTuple):
    """Desired and measured normal force at one update, and the state of the tool.

    Attributes
    ----------
    desired, measured : float
        Force of the tool along −z of T, N; NaN where it is not measured.
    searching : bool
        Whether the target is at the surface, so that the search is active.
    away : bool
        Whether the tool is far from its target along the surface.
    height : float
        Of the tool over its target, m.
    stiffness : float
        Along z of T, N/m.
    saturated : bool
        Whether the torque was limited at the previous update.
    """

    desired: float
    measured: float
    searching: bool
    away: bool
    height: float
    stiffness: float
    saturated: bool


class ForceCorrection(NamedTuple):
    """Correction of the desired normal force in N, and flags that explain it."""

    correction: float
    state: ForceState
    closed: bool
    lost: bool
    limited: bool


class Contact(NamedTuple):
    """Desired normal force, and the position of the tool relative to the desired one.

    Parameters
    ----------
    height : float
        Of the tool above the desired position along T's z, m.
    near, engaged : float
        Fractions of the normal force, in [0, 1]: by the distance from the desired position
        along the surface, and by the height of the desired position.
    force : float
        Desired normal force times both fractions, N.
    searching : bool
        Whether the tool moves toward a surface that it has not found.
    """

    height: float
    near: float
    engaged: float
    force: float
    searching: bool


@compiled
def engagement(height: float, engage_height: float) -> float:
    """Return a smooth step of the height: 0 above `engage_height`, 1 on the surface.

    Both are in m.
    """
    nearness = min(max(1 - height / engage_height, 0.0), 1.0)
    return nearness * nearness * (3 - 2 * nearness)


@compiled
def contact_of(settings: Any, stopped: bool, inputs: np.record, p_TE: Array) -> Contact:
    """Return the desired contact of a tool.

    Parameters
    ----------
    settings : ImpedanceSettings
        Of the controller.
    stopped : bool
        Whether there is a protective stop.
    inputs : record
        Inputs of the controller, of the type `PACKED`.
    p_TE : array, shape (3,)
        Position of the tool, m.
    """
    config = settings.config.force_control
    height, rest = p_TE[2] - inputs.desired_position[2], config.rest_distance
    # A high tool descends while it returns, so that it does not get stuck in the air.
    high = max(height - config.lift_height, 0.0)
    beside = math.hypot(
        p_TE[0] - inputs.desired_position[0], p_TE[1] - inputs.desired_position[1]
    )
    near = engagement(beside - rest - high, rest)
    target_height = inputs.desired_position[2] - settings.contact_height
    engaged = engagement(target_height, settings.engage_height)
    force = max(inputs.desired_normal_force[0], 0.0) * engaged * near
    searching = (
        near == 1
        and not stopped
        and target_height < settings.engage_height
        and force - inputs.feedforward_wrench[5] > 0
        and (force > 0 or inputs.has_normal_force > 0)
    )
    return Contact(height, near, engaged, force, searching)


@compiled
def approach_factor(
    config: ForceControlConfig, surface: float, height: float, speed: float
) -> float:
    """Return the factor of the desired force that approaches the surface softly.

    It is 1 up to a height of the search range, and 2 above twice that height. Above the
    allowed speed it falls, to 0 at twice that speed. In contact the whole force acts.

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
    """Return whether there is no surface within the search range."""
    deepest = max(state.surface, height)
    return state.lost_time > config.release_time and deepest <= -config.search_range


@compiled
def correct_normal_force(
    config: ForceControlConfig,
    state: ForceState,
    demand: NormalForceDemand,
    period: float,
) -> ForceCorrection:
    """Search for the surface, and correct the normal force by the measured one.

    The height of the surface is constant while the arm's torque is saturated or the tool
    is far from its target, and is limited to `search_range`. Without a search it returns
    to zero at `search_speed`.

    Parameters
    ----------
    config : ForceControlConfig
        As `values_of` returns it.
    state : ForceState
        Of the previous update.
    demand : NormalForceDemand
    period : float
        Time between updates, s.

    Returns
    -------
    ForceCorrection
    """
    surface, is_measured = state.surface, not math.isnan(demand.measured)
    above = demand.height - surface
    if is_measured:
        touching = demand.measured > config.contact_force
    else:
        touching = (
            state.force > _CONTACT_FRACTION * demand.desired
            and above < config.search_range / 2
        )
    lost_time = 0.0 if touching and demand.desired > 0 else state.lost_time + period
    closed = is_measured and demand.desired > 0 and lost_time <= config.release_time
    error, speed = demand.desired - demand.measured, 0.0
    if closed:
        if touching:
            speed = -config.integral_gain * error / demand.stiffness
    elif demand.searching:
        max_rise = 0.0
        if not is_measured and above < config.search_range:
            max_rise = _RISE_FRACTION * config.search_speed
        speed = min(config.integral_gain * above, max_rise)
    else:
        speed = min(max(-surface / period, -config.search_speed), config.search_speed)
    search_range = config.search_range
    if not (demand.saturated or demand.away):
        surface = min(max(surface + period * speed, -search_range), search_range)
    # The correction never turns pushing into pulling.
    correction = (
        max(config.proportional_gain * error, -demand.desired) if closed else 0.0
    )
    lost = demand.desired > 0 and lost_time > config.release_time
    return ForceCorrection(
        correction,
        ForceState(surface, state.force, lost_time),
        closed,
        lost and (is_measured or demand.searching),
        (closed or demand.searching) and abs(surface) == search_range,
    )


@compiled
def task_wrench(
    settings: Any,
    memory: np.record,
    state: ForceState,
    inputs: np.record,
    contact: Contact,
    fraction: float,
    rising: float,
) -> tuple[Array, ForceCorrection, float, float]:
    """Compute the feed-forward wrench on the tool, with the normal force.

    Parameters
    ----------
    settings : ImpedanceSettings
        Of the controller.
    memory, inputs : record
        Of the types `MEMORY` and `PACKED`.
    state : ForceState
        Of the previous update.
    contact : Contact
        Result of `contact_of`.
    fraction : float
        Fraction of the target in the motion that is followed, in [0, 1].
    rising : float
        `normal_speed` of the tool, m/s.

    Returns
    -------
    wrench : array, shape (6,)
        Torque and force in T, Nm and N.
    force : ForceCorrection
    desired, measured : float
        Normal force, N; NaN where it is not measured.
    """
    config, height = settings.config.force_control, contact.height
    stiffness = memory.stiffness[5, 5]
    wrench, lifting = np.zeros(6), 0.0
    pressing, searching = 0.0, False
    if fraction > 0:
        pressing, searching = contact.force, contact.searching
        for i in range(6):
            wrench[i] += inputs.feedforward_wrench[i]
        wrench[5] -= pressing
        if inputs.desired_normal_force[0] > 0:
            # From below the surface the tool rises before it returns.
            lift = config.lift_height + max(-height, 0.0)
            lifting = contact.engaged * (1 - contact.near) * stiffness * lift
    measured = math.nan
    if inputs.has_normal_force:
        measured = inputs.normal_force[0] if inputs.finite else 0.0
    desired = -wrench[5] if fraction == 1 else 0.0
    force = correct_normal_force(
        config,
        state,
        NormalForceDemand(
            desired,
            measured,
            searching,
            contact.near < 1,
            height,
            stiffness,
            memory.saturated > 0,
        ),
        settings.config.control_period,
    )
    factor = approach_factor(config, memory.surface, height, -rising)
    factor *= engagement(-height - config.search_range, settings.engage_height)
    wrench[5] += pressing * (1 - factor) + lifting
    for i in range(6):
        wrench[i] *= fraction
    wrench[5] -= force.correction
    return wrench, force, desired, measured


@compiled
def with_force(
    config: ForceControlConfig, state: ForceState, force: float, period: float
) -> ForceState:
    """Return the state with the filtered normal force of the law, N."""
    fraction = min(period / config.release_time, 1.0)
    return ForceState(
        state.surface, state.force + fraction * (force - state.force), state.lost_time
    )
