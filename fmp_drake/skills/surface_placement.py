"""Placement of recordings with poses and forces on a surface fitted to them."""

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Mask, runs
from fmp_drake.primitives import Demonstration
from fmp_drake.primitives.data.channels import (
    FORCE_CHANNEL,
    FORCE_COMPONENTS,
    POSITION_CHANNELS,
    ROTATION_CHANNELS,
    listed,
)
from fmp_drake.primitives.data.orientation import (
    mean_rotation,
    rotation_vectors,
    unit_quaternion,
)
from fmp_drake.primitives.data.reading.table import columns_option, count_text
from fmp_drake.primitives.data.windows import DEFAULT_RATE
from fmp_drake.skills.contact import (
    Contact,
    find_contact,
    recorded_rotations,
    touching_samples,
)
from fmp_drake.skills.surface_fit import RADII, FittedSurface, fit_surface
from fmp_drake.station import Scenario
from fmp_drake.station.models.eraser import FELT_DEPTH, FeltForceLimit
from fmp_drake.systems.surface import surface as surfaces

EXTRA_CHANNELS = {
    "orientation": (ROTATION_CHANNELS,),
    "force": ((FORCE_CHANNEL,), FORCE_COMPONENTS),
}
"""Channels that are placed beside the position, by the names of the options: alternatives."""

BORDER = 0.02
"""Free border around the eraser, m."""
# Least scale of a placement that makes sense; least samples of a bout.
_LEAST_SCALE, _LEAST_SAMPLES = 0.3, 4
# Ratio of residuals below which a curved surface is recommended instead of a plane.
_FAR_BETTER = 0.5
# Depth below the surface of a tool that touches, as a fraction of the height of its lifts: a
# model of few cycles mixes contact and lift, and would play a contact 1 or 2 mm too high.
_DEPTH = 0.01
# Fraction of the felt's depth by which tilting the tool may lift an edge, and fraction of
# `FeltForceLimit` that the simulated felt bears: its pressure is smaller at the edges.
_TILTED, _BORNE = 0.5, 0.7
# Fraction of the felt's depth by which a curved surface may be away from its edges.
_BENT = 0.5
# Tilt above which quaternions may have been read in the wrong order, degrees.
_LARGE_TILT = 20.0
# Single component of a force that may be the normal force, and names of measured forces.
_FORCE_Z = re.compile(r"(.*[_.])?f(orce)?[_.]?z")
_MEASURED = re.compile(
    r"(?!.*(des|target|cmd|command|ref|goal))(.*[_.])?(force|f[_.]?n)(?![_.]?[xyz]).*"
)
# Median deviation from its average of a force that vibrates, relative to its mean.
_VIBRATING = 0.05
ROTATIONAL_STIFFNESS = 60.0
"""Least rotational stiffness with which a recorded orientation is followed, Nm/rad."""
# Displacement of the tool by friction, m: with the default stiffness and 10 N it is 3.3 mm.
_FRICTION_LAG = 0.0033
# Additional height of a board on which the wrist tilts outwards, m.
_RAISED = {"cylinder": 0.10, "dome": 0.25}


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
    for demonstration in demonstrations:
        if not set(POSITION_CHANNELS) <= set(demonstration.channels):
            raise DemonstrationError(
                f"the channels are {listed(demonstration.channels)}; a surface needs x, y and "
                f"z: {columns_option(dict.fromkeys(POSITION_CHANNELS, 'NAME'))}"
            )
    fit, contacts = _fit(demonstrations, shape, **rhythm)
    remarks = _left_out(contacts)
    remarks += [
        f"{c.offset:.1f} N subtracted from the force: measured in the air, such as the "
        "weight of the tool"
        for c in contacts
        if c.offset > 0
    ]
    remarks.append(fit.describe())
    coordinates = [
        fit.coordinates(d.select(POSITION_CHANNELS).values) for d in demonstrations
    ]
    contacts = [
        replace(c, touching=touching_samples(c, uvh[:, 2]))
        for c, uvh in zip(contacts, coordinates, strict=True)
    ]
    scale, middle, notes = _set_board(scenario, fit, coordinates, contacts)
    fraction = np.mean(np.concatenate([c.touching[c.in_bout] for c in contacts]))
    remarks.append(
        f"placed on the {fit.shape} at {100 * scale:.0f} % of its size; the tool touches it "
        f"{100 * fraction:.0f} % of the time"
    )
    remarks += notes + _adapt_controller(scenario, extra)
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
            f"{100 * _LEAST_SCALE:.0f} % is needed. Give a board {_LEAST_SCALE / scale:.1f} times "
            f"as large (board.size in a scenario). {advice}"
        )


def extra_options(demonstration: Demonstration) -> str:
    """Return the options that learn its orientation and force, too; "" without these."""
    return " ".join(
        f"--extra {name}" for name in EXTRA_CHANNELS if _extra(demonstration, name)
    )


def with_extra(demonstration: Demonstration, extra: Sequence[str]) -> Demonstration:
    """Return only the position of a recording and the channels of `extra`, as recorded.

    Raises
    ------
    DemonstrationError
        Where there are none.
    """
    names = [*POSITION_CHANNELS]
    if not set(names) <= set(demonstration.channels):
        raise DemonstrationError(
            f"the channels are {listed(demonstration.channels)}; --extra adds to x, y and z, "
            "which are not among them. Leave it out to learn all channels."
        )
    for name in extra:
        if not (found := _extra(demonstration, name)):
            needed = ", or ".join(map(", ".join, EXTRA_CHANNELS[name]))
            raise DemonstrationError(
                f"the channels are {listed(demonstration.channels)}; --extra {name} needs "
                f"{needed}: name their columns with --columns, or leave out the option."
            )
        names += found
    return demonstration.select(names)


def _extra(demonstration: Demonstration, name: str) -> tuple[str, ...]:
    """Return the channels of one of `EXTRA_CHANNELS` in a recording, if there are any."""
    channels = set(demonstration.channels)
    return next((kind for kind in EXTRA_CHANNELS[name] if set(kind) <= channels), ())


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
    if fit.radius < RADII[0] * 1.1:
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
) -> tuple[FittedSurface, list[Contact]]:
    """Fit a surface to the contact of recordings."""
    points = [d.select(POSITION_CHANNELS).values for d in demonstrations]
    contacts = [find_contact(d, **rhythm) for d in demonstrations]
    touching = [c.touching for c in contacts]
    tools = [r for r in map(recorded_rotations, demonstrations) if r is not None]
    if len(tools) < len(points):
        tools = []
    return fit_surface(points, touching, tools=tools, shape=shape), contacts


def _left_out(contacts: Sequence[Contact]) -> list[str]:
    """Return remarks on the parts of recordings that are not their movement."""
    return [
        f"recording {number}: {line}" if len(contacts) > 1 else line
        for number, contact in enumerate(contacts, 1)
        if contact.rhythm is not None
        for line in contact.rhythm.describe()
        if "left out" in line
    ]


def _bouts(demonstration: Demonstration, in_bout: Mask) -> list[Demonstration]:
    """Return the bouts of a demonstration."""
    return [
        demonstration.rows(np.arange(a, b))
        for a, b in runs(in_bout)
        if b - a >= _LEAST_SAMPLES
    ]


def _set_board(
    scenario: Scenario,
    fit: FittedSurface,
    coordinates: Sequence[Array],
    contacts: Sequence[Contact],
) -> tuple[float, Array, list[str]]:
    """Give a scenario the fitted board; return scale, the path's middle (3,), m, and remarks."""
    learned = np.concatenate(
        [uvh[c.in_bout, :2] for uvh, c in zip(coordinates, contacts, strict=True)]
    )
    low, high = learned.min(axis=0), learned.max(axis=0)
    board, edges = scenario.board, np.array(scenario.board_footprint()) + BORDER
    extent = np.maximum(high - low, 1e-9)
    scale = float(min(1.0, np.min((np.array(board.size) - edges) / extent)))
    check_scale(scale, "Or check the unit (--unit).")
    board.shape, board.axis = fit.shape, "x"
    x, y, z = board.translation
    remarks = []
    if fit.shape != "plane":
        board.radius = float(scale * fit.radius)
        board.translation = [x, y, z + _RAISED.get(fit.shape, 0.0)]
        remarks = _adapt_eraser(scenario)
        edges = np.array(scenario.board_footprint()) + BORDER
        board.size = [float(size) for size in scale * extent + edges]
    scenario.check()
    return scale, np.array([*(low + high) / 2, 0.0]), remarks


def _adapt_eraser(scenario: Scenario) -> list[str]:
    """Shorten an eraser whose felt does not bear the normal force on a curved board.

    Where that is not enough, the force is lowered. Returns remarks.
    """
    eraser, surface, press = scenario.eraser, scenario.board.curvature(), scenario.press
    given, remarks = eraser.footprint, list[str]()

    def sagitta(footprint: list[float]) -> float:
        """Return the sagitta under an eraser, which gets a footprint, m."""
        eraser.footprint = footprint
        return surface.sagitta(scenario.board_footprint())

    footprint, bent = given, sagitta(given)
    if FeltForceLimit(eraser, sagitta=bent) >= press.force:
        return remarks
    while (
        bent > _BENT * FELT_DEPTH
        and _BORNE * FeltForceLimit(eraser, sagitta=bent) < press.force
    ):
        x, y = footprint
        shorter = ([round(0.95 * x, 4), y], [x, round(0.95 * y, 4)])
        footprint = min(shorter, key=sagitta)
        bent = sagitta(footprint)
    if footprint != given:
        x, y = footprint
        remarks.append(
            f"eraser shortened to {1e3 * x:.0f} mm x {1e3 * y:.0f} mm: a longer one does not "
            "fit the curvature"
        )
    limit = math.floor(_BORNE * FeltForceLimit(eraser, sagitta=bent))
    if 1 <= limit < press.force:
        press.force = float(limit)
        remarks.append(f"normal force lowered to {limit} N, which the felt bears")
    return remarks


def _on_board(time: Array, uvh: Array, contact: Contact, scale: float) -> Array:
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
    stiffness = [max(k, ROTATIONAL_STIFFNESS) for k in impedance.rotational_stiffness]
    if "orientation" in extra and stiffness != impedance.rotational_stiffness:
        impedance.rotational_stiffness = stiffness
        remarks.append(
            f"rotational stiffness raised to {ROTATIONAL_STIFFNESS:g} Nm/rad to follow "
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
    demonstration: Demonstration, fit: FittedSurface, uvh: Array, contact: Contact
) -> Array:
    """Return rotation vectors relative to the local normal, about their mean in contact."""
    recorded = recorded_rotations(demonstration)
    if recorded is None:
        raise DemonstrationError(
            f"the channels are {listed(demonstration.channels)}; an orientation needs a "
            "quaternion (qx, qy, qz, qw), a rotation vector in rad (rx, ry, rz), or Euler "
            "angles (roll, pitch, yaw): --columns qx=NAME,qy=NAME,qz=NAME,qw=NAME"
            f"{_read_as(demonstration)}"
        )
    R_DT = fit.rotation @ surfaces.rotations(fit.curvature, uvh)
    relative = Rotation.from_matrix(R_DT).inv() * recorded
    mean = mean_rotation(relative[contact.touching])
    return rotation_vectors(relative, mean)


def _read_as(demonstration: Demonstration) -> str:
    """Return the remarks on how a recording was read, in brackets."""
    return f" ({demonstration.note})" if demonstration.note else ""


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
    remark = (
        f"the tool tilts by up to {count_text(round(degrees), 'degree')} while it touches (95 % "
        "of the time), from its mean orientation, at which the eraser is flat"
    )
    if scale < 1:
        remark += f"; scaled to {100 * scale:.0f} % of it, the limit of the felt"
    if degrees > _LARGE_TILT:
        remark += (
            "; if it never did, the orientation is misread: its columns (--columns) or the "
            "order of its quaternions (--quaternions)"
        )
    return scale * lift, remark


def _normal_force(
    demonstration: Demonstration,
    fit: FittedSurface,
    uvh: Array,
    contact: Contact,
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
        names = [
            name
            for form in (_FORCE_Z, _MEASURED)
            for name in demonstration.channels
            if form.fullmatch(name.lower())
        ]
        raise DemonstrationError(
            f"the channels are {listed(demonstration.channels)}; a force needs force, the "
            "normal force, or force_x, force_y and force_z: "
            f"{columns_option({FORCE_CHANNEL: (names or ['NAME'])[0]})}"
            f"{_read_as(demonstration)}"
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
    normal = _without_vibration(demonstration.time, normal, on)
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


def _without_vibration(time: Array, normal: Array, on: Mask) -> Array:
    """Return a normal force (N,), in contact averaged over a sample of a skill if it vibrates.

    A skill does not play vibrations: their peaks are not to be limited.
    """
    count = max(1, round(1 / DEFAULT_RATE / float(np.median(np.diff(time)))))
    weight = uniform_filter1d(on.astype(float), count)
    average = uniform_filter1d(np.where(on, normal, 0.0), count) / np.fmax(weight, 1e-9)
    deviation = np.median(np.abs(normal - average)[on])
    return average if deviation > _VIBRATING * np.mean(normal[on]) else normal
