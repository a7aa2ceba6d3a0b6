"""Placement of recordings with poses and forces on a surface fitted to them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Mask, runs
from fmp_drake.primitives import Demonstration, find_rhythm
from fmp_drake.primitives.data.channels import (
    FORCE_CHANNEL,
    FORCE_COMPONENTS,
    POSITION_CHANNELS,
    ROTATION_CHANNELS,
)
from fmp_drake.primitives.data.orientation import (
    mean_rotation,
    rotation_vectors,
    rotations_of,
    unit_quaternion,
)
from fmp_drake.primitives.data.windows import DEFAULT_RATE, cut_demonstrations
from fmp_drake.skills.surface_fit import RADII, FittedSurface, fit_surface
from fmp_drake.station import Scenario
from fmp_drake.station.models.eraser import FELT_DEPTH, FeltForceLimit
from fmp_drake.systems.surface import surface as surfaces

EXTRA_CHANNELS = ("orientation", "force")
"""Names of the channels that are placed beside the position."""

# Force above which the tool touches, relative to its 95 % quantile; height without a force, m.
_PRESSED, _TOUCH = 0.3, 0.01
_LEAST_FORCE = 1.0  # N; with a smaller quantile nothing was touched.
BORDER = 0.02
"""Free border around the eraser, m."""
# Least scale of a placement that makes sense.
_LEAST_SCALE = 0.3
_LEAST_SAMPLES = 4  # Of a bout.
# An offset of the force: distance from the movement at which the tool is in the air, m, greatest
# spread relative to its mean, and least mean relative to the force of the movement.
_FAR, _STEADY, _WEIGHT = 0.03, 0.3, 0.1
# Ratio of residuals below which a curved surface is recommended instead of a plane.
_FAR_BETTER = 0.5
# Depth below the surface of a tool that touches, as a fraction of the height of its lifts: a
# model of few cycles mixes contact and lift, and would play a contact 1 or 2 mm too high.
_DEPTH = 0.01
# Fraction of the felt's depth by which tilting the tool may lift an edge, and fraction of
# `FeltForceLimit` that the simulated felt bears: its pressure is smaller at the edges.
_TILTED, _BORNE = 0.5, 0.7
# Tilt above which quaternions may have been read in the wrong order, degrees.
_LARGE_TILT = 20.0
# Least rotational stiffness with which a recorded orientation is followed, Nm/rad.
_ROTATIONAL_STIFFNESS = 60.0
# Displacement of the tool by friction, m: with the default stiffness and 10 N it is 3.3 mm.
_FRICTION_LAG = 0.0033
# Additional height of a board on which the wrist tilts outwards, m.
_RAISED = {"cylinder": 0.10, "dome": 0.25}


@dataclass(frozen=True, kw_only=True, eq=False)
class _Contact:
    """Samples in contact, samples in bouts, and the force (N, 1 or 3), if any.

    `offset` is the magnitude of a constant force that was subtracted, N.
    """

    touching: Mask
    in_bout: Mask
    force: Array | None
    offset: float = 0.0


def place_on_fitted_surface(
    demonstrations: Sequence[Demonstration],
    *,
    scenario: Scenario,
    shape: str | None = None,
    extra: Sequence[str] = (),
    **rhythm: float | None,
) -> tuple[list[Demonstration], list[str]]:
    """Fit a surface to recordings, make it the scenario's board, and place them on it.

    Contact is detected by the distance to the surface and, if there is one, by the force,
    and only in the bouts of the movement. In contact the height becomes constant,
    because the real surface differs from the fitted one: 0, or lower by 1 % of the
    height of lifts, which a learned motion blurs. With a force it is lower by the
    compression of the felt; elsewhere the force is 0. A path that is too large for
    the board is scaled down, with the surface's radius. Orientations are relative to
    the local normal; in contact, their mean is that of the eraser flat on the surface.

    Parameters
    ----------
    demonstrations : sequence of Demonstration
        Of one movement on one surface, in one frame D: x, y, z in m; optionally rx, ry, rz with
        their reference, and `force` or the components `force_x`, `force_y`, `force_z` in N, of
        the tool or of D.
    scenario : Scenario
        Its board is changed. With an orientation its rotational stiffness is at least 60
        Nm/rad. With a force its force control is enabled, and its translational stiffness
        is such that friction displaces the tool by at most 3.3 mm.
    shape : str, optional
        plane, cylinder, dome or bowl instead of the choice by the residuals.
    extra : sequence of str
        `orientation` and `force`, to be placed with the position.
    **rhythm : float, optional
        start_time, end_time and period, as for `find_rhythm`.

    Returns
    -------
    demonstrations : list of Demonstration
        One for each bout; x, y and z are (u, v, h) on the board.
    remarks : list of str

    Raises
    ------
    DemonstrationError
        Where no surface fits, the path is too large for the board, or a channel is missing.
    StationError
        Where the board is not allowed.
    """
    for name in extra:
        if name not in EXTRA_CHANNELS:
            raise DemonstrationError(
                f"{name!r} cannot be placed; choose from: {', '.join(EXTRA_CHANNELS)}."
            )
    fit, contacts = _fit(demonstrations, shape, **rhythm)
    remarks = [
        f"{c.offset:.1f} N subtracted from the force: it is that of the air, such as the "
        "weight of the tool"
        for c in contacts
        if c.offset > 0
    ]
    remarks.append(fit.describe())
    coordinates = [
        fit.coordinates(d.select(POSITION_CHANNELS).values) for d in demonstrations
    ]
    contacts = [
        replace(c, touching=_touching(c, uvh[:, 2]))
        for c, uvh in zip(contacts, coordinates, strict=True)
    ]
    scale, middle = _set_board(scenario, fit, coordinates, contacts)
    fraction = np.mean(np.concatenate([c.touching[c.in_bout] for c in contacts]))
    remarks.append(
        f"placed on the {fit.shape} at {100 * scale:.0f} % of its size; the tool touches it "
        f"{100 * fraction:.0f} % of the time"
    )
    remarks += _adapt_controller(scenario, extra)
    placed = []
    for demonstration, contact, uvh in zip(
        demonstrations, contacts, coordinates, strict=True
    ):
        columns = [_on_board(demonstration.time, uvh - middle, contact, scale)]
        channels, units = [*POSITION_CHANNELS], ["m"] * 3
        reference, lift = None, 0.0
        if "orientation" in extra:
            vectors = _orientation(demonstration, fit, uvh, contact)
            lift, note = _flatten(vectors, contact.touching, scenario)
            columns.append(vectors)
            channels += ROTATION_CHANNELS
            units += ["rad"] * 3
            nominal = scenario.eraser_orientation().matrix()
            reference = unit_quaternion(Rotation.from_matrix(nominal))
            remarks.append(note)
        if "force" in extra:
            force, note = _normal_force(
                demonstration, fit, uvh, contact, scenario, lift
            )
            columns.append(force[:, None])
            remarks += _adapt_to_force(scenario, columns[0], force[contact.touching])
            channels.append(FORCE_CHANNEL)
            units.append("N")
            remarks.append(note)
        whole = replace(
            demonstration,
            values=np.concatenate(columns, axis=1),
            channels=tuple(channels),
            units=tuple(units),
            frame="board",
            rotation_reference=reference,
        )
        placed += _bouts(whole, contact.in_bout)
    return placed, remarks


def check_scale(scale: float, advice: str) -> None:
    """Refuse a scale at which a movement makes no sense.

    Raises
    ------
    DemonstrationError
        Where it is less than 30 %.
    """
    if scale < _LEAST_SCALE:
        raise DemonstrationError(
            f"it would fit onto the board at {100 * scale:.0f} % of its size; at least "
            f"{100 * _LEAST_SCALE:.0f} % is needed. {advice}"
        )


def curved_surface_remark(
    demonstrations: Sequence[Demonstration], **rhythm: float | None
) -> str:
    """Return a remark where a curved surface fits the contact far better than a plane.

    Parameters
    ----------
    demonstrations, **rhythm
        As for `place_on_fitted_surface`.

    Returns
    -------
    str
        Empty where a plane is as good, or nothing fits.
    """
    try:
        fit, _ = _fit(demonstrations, None, **rhythm)
    except DemonstrationError:
        return ""
    plane = fit.residuals["plane"]
    if fit.shape == "plane" or fit.residual > _FAR_BETTER * plane:
        return ""
    if not RADII[0] * 1.1 < fit.radius < RADII[1] / 1.1:
        return ""  # The radius is that of no surface: the contact is not what it seems.
    return (
        f"its contact is {1e3 * plane:.1f} mm from a plane and {1e3 * fit.residual:.1f} mm "
        f"from a {fit.shape} of radius {fit.radius:.2f} m: add --surface fitted to this "
        "command"
    )


def _fit(
    demonstrations: Sequence[Demonstration],
    shape: str | None,
    **rhythm: float | None,
) -> tuple[FittedSurface, list[_Contact]]:
    """Fit a surface to the contact of recordings."""
    points = [d.select(POSITION_CHANNELS).values for d in demonstrations]
    contacts = [_contact(d, **rhythm) for d in demonstrations]
    touching = [c.touching for c in contacts]
    tools = [r for r in map(_recorded_rotations, demonstrations) if r is not None]
    if len(tools) < len(points):
        tools = []
    return fit_surface(points, touching, tools=tools, shape=shape), contacts


def _bouts(demonstration: Demonstration, in_bout: Mask) -> list[Demonstration]:
    """Return the bouts of a demonstration."""
    return [
        demonstration.rows(np.arange(a, b))
        for a, b in runs(in_bout)
        if b - a >= _LEAST_SAMPLES
    ]


def _touching(contact: _Contact, heights: Array) -> Mask:
    """Return where the tool touches, by its force and its heights (N,) over the surface, m.

    A force that was low-pass filtered rises while the tool is still high. Where it is weak
    but the tool is not lifted, the tool touches.
    """
    is_low = heights <= _TOUCH
    if contact.force is None:
        return contact.in_bout & is_low
    touching = np.zeros_like(is_low)
    for a, b in runs(contact.touching):
        low = a + np.flatnonzero(is_low[a:b])
        if len(low):
            touching[low[0] : low[-1] + 1] = True
    for a, b in runs(contact.in_bout & ~touching):
        touching[a:b] = np.all(is_low[a:b])
    return touching


def samples_in_bouts(
    path: Demonstration,
    *,
    start_time: float | None = None,
    end_time: float | None = None,
    period: float | None = None,
) -> Mask:
    """Return which samples of a path are in bouts of its movement.

    The options are those of `find_rhythm`. Without a rhythm all samples between the times
    are.
    """
    (part,) = cut_demonstrations([path], start_time, end_time, DEFAULT_RATE)
    try:
        rhythm = find_rhythm(
            path, start_time=start_time, end_time=end_time, period=period
        )
    except DemonstrationError:
        return np.isin(path.time, part.time)
    in_bout = np.zeros(len(path.time), dtype=bool)
    time = path.time - path.time[0]
    for bout in rhythm.bouts:
        in_bout |= (time >= bout.start) & (time <= bout.end)
    return in_bout


def _contact(demonstration: Demonstration, **rhythm: float | None) -> _Contact:
    """Find where the tool touches, by the force and by the bouts of the movement."""
    path = demonstration.select(POSITION_CHANNELS)
    in_bout = samples_in_bouts(path, **rhythm)
    channels = set(demonstration.channels)
    forces = (FORCE_COMPONENTS, (FORCE_CHANNEL,))
    names = next((f for f in forces if set(f) <= channels), None)
    if names is None:
        return _Contact(touching=in_bout, in_bout=in_bout, force=None)
    force = demonstration.select(names).values
    offset = _offset(path.values, in_bout, force)
    force = force - offset
    magnitude = np.linalg.norm(force, axis=1)
    pressed = float(np.percentile(magnitude, 95))
    if pressed < _LEAST_FORCE:
        raise DemonstrationError(
            f"the force is at most {pressed:.2g} N, so the tool touches nothing; check its "
            "column and unit (--columns)."
        )
    touching = in_bout & (magnitude > _PRESSED * pressed)
    return _Contact(
        touching=touching,
        in_bout=in_bout,
        force=force,
        offset=float(np.linalg.norm(offset)),
    )


def _offset(points: Array, in_bout: Mask, force: Array) -> Array:
    """Return the force (1 or 3) in the air far from the movement; 0 where it varies.

    The weight of a tool that is not compensated, or a sensor's offset, looks like contact.
    """
    is_far = KDTree(points[in_bout]).query(points)[0] > _FAR
    in_air = force[is_far & ~in_bout]
    pressed = float(np.percentile(np.linalg.norm(force[in_bout], axis=1), 95))
    if len(in_air) < _LEAST_SAMPLES or pressed < _LEAST_FORCE:
        return np.zeros(force.shape[1])
    mean = in_air.mean(axis=0)
    size, spread = np.linalg.norm(mean), np.linalg.norm(in_air.std(axis=0))
    is_constant = spread < _STEADY * size and size > _WEIGHT * pressed
    return mean if is_constant else np.zeros(force.shape[1])


def _set_board(
    scenario: Scenario,
    fit: FittedSurface,
    coordinates: Sequence[Array],
    contacts: Sequence[_Contact],
) -> tuple[float, Array]:
    """Give a scenario the fitted board; return the scale and the path's middle (3,), m."""
    learned = np.concatenate(
        [uvh[c.in_bout, :2] for uvh, c in zip(coordinates, contacts, strict=True)]
    )
    low, high = learned.min(axis=0), learned.max(axis=0)
    board, edges = scenario.board, np.array(scenario.board_footprint()) + BORDER
    extent = np.maximum(high - low, 1e-9)
    scale = float(min(1.0, np.min((np.array(board.size) - edges) / extent)))
    check_scale(scale, "Use a larger board, or check the unit (--unit).")
    board.shape, board.axis = fit.shape, "x"
    x, y, z = board.translation
    if fit.shape != "plane":
        board.radius = scale * fit.radius
        board.size = [float(size) for size in scale * extent + edges]
        board.translation = [x, y, z + _RAISED.get(fit.shape, 0.0)]
    scenario.check()
    return scale, np.array([*(low + high) / 2, 0.0])


def _on_board(time: Array, uvh: Array, contact: _Contact, scale: float) -> Array:
    """Return (u, v, h) on the board, with a constant height in contact."""
    on = contact.touching
    floor = np.interp(time, time[on], uvh[on, 2])
    out = scale * uvh
    out[:, 2] = np.where(on, 0.0, scale * np.maximum(uvh[:, 2] - floor, 0.0))
    out[:, 2] -= _DEPTH * np.percentile(out[contact.in_bout, 2], 95)
    return out


def _adapt_controller(scenario: Scenario, extra: Sequence[str]) -> list[str]:
    """Adapt a scenario's controller to an orientation and a force; return remarks."""
    impedance, remarks = scenario.impedance, []
    stiffness = [max(k, _ROTATIONAL_STIFFNESS) for k in impedance.rotational_stiffness]
    if "orientation" in extra and stiffness != impedance.rotational_stiffness:
        impedance.rotational_stiffness = stiffness
        remarks.append(
            f"rotational stiffness raised to {_ROTATIONAL_STIFFNESS:g} Nm/rad to follow "
            "the orientation"
        )
    if "force" in extra and not impedance.force_control.enabled:
        impedance.force_control.enabled = True
        remarks.append("force control enabled to follow the force")
    return remarks


def _adapt_to_force(scenario: Scenario, uvh: Array, force: Array) -> list[str]:
    """Lower a path, in place, by the compression of the felt; stiffen the controller.

    Friction displaces the tool from its path by its force over the stiffness. The greatest
    force of the spring does not change.

    Parameters
    ----------
    scenario : Scenario
    uvh : array, shape (N, 3)
        m.
    force : array, shape (C,)
        Normal force in contact, N.
    """
    # The felt at a relative depth x bears x (1 - 0.3 x) of the force on a whole felt.
    edges, ratio = 1 - _BORNE, np.mean(force) / FeltForceLimit(scenario.eraser)
    depth = (1 - np.sqrt(1 - 4 * edges * ratio)) / (2 * edges)
    uvh[:, 2] -= FELT_DEPTH * depth
    impedance = scenario.impedance
    friction = scenario.contact_friction() * float(np.percentile(force, 95))
    before = impedance.translational_stiffness
    needed = round(friction / _FRICTION_LAG, -2)
    stiffness = [*(max(k, needed) for k in before[:2]), before[2]]
    if stiffness == before:
        return []
    impedance.translational_stiffness = stiffness
    clip = impedance.max_translation_error * max(before) / max(stiffness)
    impedance.max_translation_error = round(clip, 4)
    remark = (
        f"translational stiffness raised to {needed:g} N/m: friction of {friction:.0f} N "
        f"displaces the tool by at most {1e3 * _FRICTION_LAG:g} mm"
    )
    return [remark]


def _orientation(
    demonstration: Demonstration, fit: FittedSurface, uvh: Array, contact: _Contact
) -> Array:
    """Return rotation vectors relative to the local normal, about their mean in contact."""
    recorded = _recorded_rotations(demonstration)
    if recorded is None:
        raise DemonstrationError(
            f"the channels are {', '.join(demonstration.channels)}; an orientation needs a "
            "quaternion (--columns qx=NAME,qy=NAME,qz=NAME,qw=NAME)."
        )
    R_DT = fit.rotation @ surfaces.rotations(fit.curvature, uvh)
    relative = Rotation.from_matrix(R_DT).inv() * recorded
    mean = mean_rotation(relative[contact.touching])
    return rotation_vectors(relative, mean)


def _recorded_rotations(demonstration: Demonstration) -> Rotation | None:
    """Return the orientations R_DT of a demonstration, if it has any."""
    reference = demonstration.rotation_reference
    if reference is None:
        return None
    return rotations_of(demonstration.select(ROTATION_CHANNELS).values, reference)


def _flatten(vectors: Array, touching: Mask, scenario: Scenario) -> tuple[float, str]:
    """Scale the tilt, in place, to the limit of the felt; return an edge's lift, m.

    The tool of the recording was a different or a soft one, and the real surface
    differs from the fitted one: an eraser that is tilted more would rub with its hard
    core.
    """
    x, y = scenario.eraser.footprint
    tilt = np.abs(vectors[touching, :2])
    lift = float(np.percentile(tilt @ [y / 2, x / 2], 95))
    scale = min(1.0, _TILTED * FELT_DEPTH / max(lift, 1e-9))
    vectors[:, :2] *= scale
    degrees = np.degrees(np.percentile(np.linalg.norm(tilt, axis=1), 95))
    remark = f"the tool tilts by up to {degrees:.0f} degrees while it touches (95 % of the time)"
    if scale < 1:
        remark += f", scaled to {100 * scale:.0f} % of it, the limit of the felt"
    if degrees > _LARGE_TILT:
        remark += "; if it never did, give the order of its quaternions (--quaternions)"
    return scale * lift, remark


def _normal_force(
    demonstration: Demonstration,
    fit: FittedSurface,
    uvh: Array,
    contact: _Contact,
    scenario: Scenario,
    lift: float,
) -> tuple[Array, str]:
    """Return the normal force, N, scaled to the limit of the felt, with a remark.

    A tilt lifts an edge of the felt, as a curvature does: the felt is compressed less
    there.

    Three components are projected on their mean direction in contact (for the tool's
    frame) or on the surface's normal (for the frame D), whichever explains more of
    them.
    """
    if contact.force is None:
        raise DemonstrationError(
            f"the channels are {', '.join(demonstration.channels)}; a force needs the channel "
            "force, or force_x, force_y and force_z (--columns)."
        )
    force, on, source = contact.force, contact.touching, "as recorded"
    normal = np.abs(force[:, 0])
    if force.shape[1] == 3:
        mean = np.mean(force[on], axis=0)
        along_mean = force @ (mean / np.linalg.norm(mean))
        R_DT = fit.rotation @ surfaces.rotations(fit.curvature, uvh)
        along_normal = np.einsum("ij,ij->i", force, R_DT[:, :, 2])
        along_normal *= np.sign(np.mean(along_normal[on]))
        normal, source = along_mean, "along its mean direction in contact"
        if np.sum(along_normal[on] ** 2) > np.sum(along_mean[on] ** 2):
            normal, source = along_normal, "along the surface's normal"
    sagitta = scenario.board.curvature().sagitta(scenario.board_footprint())
    limit = _BORNE * FeltForceLimit(scenario.eraser, sagitta=max(sagitta, lift))
    highest = float(np.percentile(normal[on], 95))
    scale = min(1.0, limit / max(highest, 1e-9))
    remark = (
        f"normal force {source}: {np.mean(normal[on]):.1f} N on average, "
        f"{np.std(normal[on]):.1f} N standard deviation"
    )
    if scale < 1:
        remark += f", scaled to {100 * scale:.0f} % of it, the limit of the felt: {limit:.0f} N"
    return np.where(on, np.clip(scale * normal, 0.0, limit), 0.0), remark
