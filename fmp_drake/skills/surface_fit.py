"""Plane, cylinder or sphere fitted to the contact of a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Mask
from fmp_drake.systems.surface import surface as surfaces
from fmp_drake.systems.surface.surface import Surface

SHAPES = ("plane", "cylinder", "dome", "bowl")
"""Shapes of a surface, the simplest first."""

# Scale of the robust loss, m.
_SCALE = 0.005
# Standard deviation of a normal distribution, in medians of its absolute values.
_TO_SIGMA = 1.4826
# Ratio of residuals below which the less simple shape is taken, and the least gain, m: smaller
# ones are within the error of a recorded contact. The same of tilts, the least gain in rad.
_BETTER, _LEAST_GAIN = 0.8, 3e-4
_LESS_TILT, _LEAST_TILT = 0.5, 0.05
RADII = (0.05, 5.0)
"""Range of the radii of cylinders, domes and bowls, m."""

# Initial radii of the search, m.
_STARTS = (0.15, 0.5, 2.0)
_SAMPLES, _LEAST_SAMPLES = 1000, 20
# Largest residual relative to the extent of the contact, and that of a remark, m.
_MOST_RESIDUAL, _LARGE_RESIDUAL = 0.2, 0.01
# Least height of a lift, in m beyond a number of residuals.
_LIFTED, _ERRORS = 0.01, 3.0
# Distance from the contact within which lifts tell the side best, m; samples that are needed.
_NEAR, _LEAST_LIFTED = 0.1, 4
# Least cosine between the tool's axis and the normal; greatest one between z of D and the
# normal of a wall.
_ALONG, _LEVEL = 0.7, 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedSurface:
    """Surface that a recording touches, in the frame D of the recording.

    S is the frame of the surface: its origin is the middle of the contact, z the normal towards
    the tool, and x of a cylinder its axis.

    Attributes
    ----------
    shape : str
        One of `SHAPES`.
    radius : float
        m; infinite for a plane.
    rotation : ndarray, shape (3, 3)
        R_DS.
    origin : ndarray, shape (3,)
        p_DS, m.
    residuals : mapping from str to float
        Robust standard deviation of the distance from every shape that was tried, m: 1.48 times
        its median; infinite where the shape does not fit from this side.
    side : str
        How it is known on which side the tool is: `lifts`, `up` (z of D), or, at a wall,
        `tool` (its z axis is taken to point into the surface).
    """

    shape: str
    radius: float
    rotation: Array
    origin: Array
    residuals: Mapping[str, float]
    side: str = "up"

    @property
    def residual(self) -> float:
        """Robust standard deviation of the distance from the surface, m."""
        return self.residuals[self.shape]

    @property
    def curvature(self) -> Surface:
        """Curvatures along x and y of S, 1/m."""
        return _surface(self.shape, 1 / self.radius)

    def coordinates(self, points: Array) -> Array:
        """Return (u, v, h) of points in D, shape (N, 3), m, in the order of time."""
        surface, near = self.curvature, np.zeros(2)
        out = np.empty((len(points), 3))
        for i, p_S in enumerate((points - self.origin) @ self.rotation):
            out[i] = surfaces.project(surface, p_S, near)
            near = out[i, :2]
        return out

    def tilt(self, points: Array, tool: Rotation) -> float:
        """Return how much a tool at points (N, 3) tilts, rms from its mean direction, rad.

        Its rotation R_DT about the normal does not count.
        """
        uvh = self.coordinates(points)
        normals = self.rotation @ surfaces.rotations(self.curvature, uvh)[:, :, 2:]
        in_tool = tool.apply(normals[:, :, 0], inverse=True)
        return float(np.sqrt(np.sum(np.var(in_tool, axis=0))))

    def describe(self) -> str:
        """Return in words the shape, the residuals, and what is uncertain about it."""
        radius = "" if self.shape == "plane" else f" of radius {self.radius:.3f} m"
        found = {k: r for k, r in self.residuals.items() if np.isfinite(r)}
        tried = ", ".join(f"{k} {1e3 * r:.1f}" for k, r in found.items())
        remarks, z = "", self.rotation[2, 2]
        if self.side != "lifts":
            place = "a side" if abs(z) < _LEVEL else "above" if z > 0 else "below"
            remarks = "; the tool is never lifted: "
            if self.side == "tool":
                remarks += "its z axis is taken to point into the surface, and "
            remarks += (
                f"the surface is taken to be touched from {place} (z of the recording), so "
                "record an approach, too"
            )
            if self.shape in ("dome", "bowl"):
                remarks += ", or choose --surface dome or bowl"
        if self.residual > _LARGE_RESIDUAL:
            remarks += (
                "; this is far: the contact may contain lifts, which a recorded force or "
                "orientation would show; or choose a part with --start-time and --end-time"
            )
        return f"{self.shape}{radius} fitted to the contact (residuals in mm: {tried}){remarks}"


def fit_surface(
    points: Sequence[Array],
    touching: Sequence[Mask],
    *,
    tools: Sequence[Rotation] = (),
    shape: str | None = None,
) -> FittedSurface:
    """Fit a surface to the points of recordings that touch it.

    A plane is chosen unless the residual of a cylinder is smaller by a fifth; the same
    applies to a cylinder and a sphere. Where shapes fit about equally, because the path is
    a line on each of them, that over which the tool tilts far less is chosen. The loss is
    robust, so a few of the points may be lifts.

    The normal points to the side of lifts, approach and retreat. Without these it points up
    (z of D). That of a wall points against the tool's z axis, which is taken to point into the
    surface if it is about normal to it, or else to the side from which a shape fits better.

    Parameters
    ----------
    points : sequence of ndarray, shape (N, 3)
        Of each recording, in one frame D, m.
    touching : sequence of ndarray of bool, shape (N,)
        Whether the tool touches.
    tools : sequence of Rotation, optional
        Orientations R_DT of the tool at the points (N).
    shape : str, optional
        One of `SHAPES`, instead of the choice.

    Raises
    ------
    DemonstrationError
        Where fewer than 20 points touch, they lie on a line, or no surface fits.
    """
    if shape is not None and shape not in SHAPES:
        raise DemonstrationError(
            f"the surface is {shape!r}; choose one of: {', '.join(SHAPES)}."
        )
    contact = np.concatenate([p[m] for p, m in zip(points, touching, strict=True)])
    others = np.concatenate([p[~m] for p, m in zip(points, touching, strict=True)])
    if len(contact) < _LEAST_SAMPLES:
        raise DemonstrationError(
            f"the tool touches in {len(contact)} samples; at least {_LEAST_SAMPLES} are "
            "needed to fit a surface."
        )
    extents = np.linalg.svd(contact - contact.mean(axis=0), compute_uv=False)
    if extents[1] <= 0.02 * extents[0]:
        raise DemonstrationError(
            "the contact is a point or a line, so its surface is not determined; give the "
            "transform to the board instead."
        )
    step = len(contact) // _SAMPLES + 1
    sample = contact[::step]
    tool = None
    if tools:
        held = [r[m] for r, m in zip(tools, touching, strict=True)]
        tool = Rotation.concatenate(held)[::step]
    lifted = _lifted(contact, others)
    frame = _upwards(sample, lifted)
    chosen, residuals = _choose(sample, frame, shape, tool)
    # The sphere of a dome is a bowl's from the other side: a given shape tells it, too. A wall
    # has no upper side, so the tool or its shape tells it.
    is_given, is_wall = shape not in (None, "plane"), abs(frame[2, 2]) < _LEVEL
    pointing = tool if is_wall and not is_given else None
    by_shape = is_given or is_wall
    side, evidence = _side(chosen, lifted, pointing)
    if evidence < 0 or (evidence == 0 and (by_shape or len(lifted))):
        other, their = _choose(sample, frame * [1.0, -1.0, -1.0], shape, tool)
        of_other, opposite = _side(other, lifted, pointing)
        is_other = opposite > 0
        if evidence == opposite == 0:
            is_other = _is_better(other, chosen) if by_shape else frame[2, 2] < 0
        if is_other:
            chosen, residuals, side = other, their, of_other
    limit = _MOST_RESIDUAL * 2 * extents[1] / np.sqrt(len(contact))
    if chosen.residual > limit:
        raise DemonstrationError(
            f"no surface fits: {chosen.shape}, the best, leaves {1e3 * chosen.residual:.1f} "
            f"mm; {1e3 * limit:.1f} mm are allowed for a contact of this size. Cut "
            "the recording to the part that touches one surface, or learn it in free space "
            "(--as-recorded)."
        )
    return _centred(replace(chosen, side=side), contact, residuals)


def front_axis(normal: Array) -> Array:
    """Return the x axis (3,) of a board with a normal, both in the frame of a recording.

    It is the projection of the recording's x axis, or where that is nearly normal to the
    board, of its z axis: upwards, if the board faces -x.
    """
    is_steep = abs(normal[0]) > 0.9
    forward = -np.sign(normal[0]) * np.eye(3)[2] if is_steep else np.eye(3)[0]
    x: Array = forward - (forward @ normal) * normal
    return x / np.linalg.norm(x)


def _choose(
    points: Array, up: Array, shape: str | None, tool: Rotation | None
) -> tuple[FittedSurface, dict[str, float]]:
    """Return the surface that fits from the side of z of a frame R_DS, and all residuals."""
    tried = [_fit(points, s, up) for s in SHAPES if shape in (None, s) or s == "plane"]
    residuals = {candidate.shape: candidate.residual for candidate in tried}
    if shape is not None:
        return tried[-1], residuals
    # A radius at the end of the range is that of a plane with other errors.
    chosen = tried[0]
    tried = [chosen, *(c for c in tried[1:] if c.radius < RADII[1] / 1.1)]
    for candidate in tried[1:]:
        if _is_better(candidate, chosen):
            chosen = candidate
    if tool is not None:
        chosen = _least_tilted(chosen, tried, points, tool)
    return chosen, residuals


def _lifted(contact: Array, others: Array) -> Array:
    """Return those of the other points that are lifted, and preferably near the contact."""
    if len(others) < _LEAST_LIFTED:
        return others[:0]
    others = others[:: len(others) // _SAMPLES + 1]
    distance = KDTree(contact).query(others)[0]
    is_lifted = distance > _LIFTED
    is_near = is_lifted & (distance < _NEAR)
    return others[is_near if is_near.sum() >= _LEAST_LIFTED else is_lifted]


def _side(
    fit: FittedSurface, lifted: Array, tool: Rotation | None
) -> tuple[str, float]:
    """Return what tells the side of the tool, and a number that is negative for the other."""
    heights = fit.coordinates(lifted)[:, 2]
    heights = heights[np.abs(heights) > _LIFTED + _ERRORS * fit.residual]
    if len(heights) >= _LEAST_LIFTED:
        return "lifts", float(np.mean(heights))
    if tool is not None:
        along = float(tool.apply([0.0, 0.0, 1.0]).mean(axis=0) @ fit.rotation[:, 2])
        if abs(along) > _ALONG:
            return "tool", -along
    return "up", 0.0


def _least_tilted(
    chosen: FittedSurface,
    tried: Sequence[FittedSurface],
    points: Array,
    tool: Rotation,
) -> FittedSurface:
    """Return a surface that fits as well and tilts the tool far less, or the chosen one."""
    equal = [c for c in tried if c is chosen or not _is_better(chosen, c)]
    tilts = {c.shape: c.tilt(points, tool) for c in equal}
    least = min(equal, key=lambda c: tilts[c.shape])
    known = tilts[chosen.shape]
    is_less = tilts[least.shape] < min(_LESS_TILT * known, known - _LEAST_TILT)
    return least if is_less else chosen


def _is_better(fit: FittedSurface, other: FittedSurface) -> bool:
    """Return whether the residual of a fit is smaller beyond the error of a contact."""
    known = other.residual
    return fit.residual < min(_BETTER * known, known - _LEAST_GAIN)


def _surface(shape: str, k: float) -> Surface:
    """Return the curvatures of a shape; x of S is the axis of a cylinder."""
    k = -k if shape == "bowl" else k
    return Surface(kx=0.0 if shape in ("plane", "cylinder") else k, ky=k)


def _upwards(contact: Array, others: Array) -> Array:
    """Return a frame R_DS whose z is normal to a plane, on the side of the other points."""
    centre = contact.mean(axis=0)
    _, axes = np.linalg.eigh((contact - centre).T @ (contact - centre))
    heights = (others - centre) @ axes[:, 0] if len(others) else axes[2:, 0]
    z = axes[:, 0] * (1.0 if np.mean(heights) >= 0 else -1.0)
    return np.column_stack([axes[:, 2], np.cross(z, axes[:, 2]), z])


def _fit(points: Array, shape: str, up: Array) -> FittedSurface:
    """Fit one shape, from several radii and directions of a cylinder's axis."""
    centre = points.mean(axis=0)
    local = (points - centre) @ up
    # Axes along which the distance from the centre of curvature counts.
    is_curved = np.array([shape in ("dome", "bowl"), shape != "plane", 1.0])
    sign = -1.0 if shape == "bowl" else 1.0

    def heights(x: Array) -> Array:
        # The height h solves g = h + k h^2 / 2; this is the numerically stable root.
        q = local @ surfaces.rotation_matrix(x[:3]).T
        q[:, 2] -= x[3]
        k = sign * x[4]
        g = q[:, 2] + k / 2 * (q**2 @ is_curved)
        root: Array = np.sqrt(np.maximum(1 + 2 * k * g, 0.0))
        return 2 * g / (1 + root)

    least, most = 1 / RADII[1], 1 / RADII[0]
    yaws = np.arange(4) * np.pi / 4 if shape == "cylinder" else [0.0]
    starts = [[0.0, 0.0, yaw, 0.0, 1 / r] for yaw in yaws for r in _STARTS]
    bounds = np.array([[-1.2, -1.2, -4, -1, least], [1.2, 1.2, 4, 1, most]])
    if shape == "plane":
        starts, bounds[:, 4] = [[0.0, 0.0, 0.0, 0.0, 0.0]], (-1e-9, 1e-9)
    fits = [
        least_squares(heights, x, loss="cauchy", f_scale=_SCALE, bounds=bounds)
        for x in starts
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    R = surfaces.rotation_matrix(best.x[:3])
    residual = float(_TO_SIGMA * np.median(np.abs(heights(best.x))))
    fit = FittedSurface(
        shape=shape,
        radius=np.inf if shape == "plane" else 1 / best.x[4],
        rotation=up @ R.T,
        origin=centre + up @ R.T @ [0.0, 0.0, best.x[3]],
        residuals={shape: residual},
    )
    # A dome also lies on a bowl seen from below, the far half of its sphere.
    local = surfaces.rotations(fit.curvature, fit.coordinates(points))
    normal = np.mean(fit.rotation @ local, axis=0)[:, 2]
    return fit if normal @ up[:, 2] > 0 else replace(fit, residuals={shape: np.inf})


def _centred(
    fit: FittedSurface, contact: Array, residuals: Mapping[str, float]
) -> FittedSurface:
    """Return a surface whose origin is the middle of the contact.

    Its x axis is that of `front_axis`, on a cylinder the cylinder's axis.
    """
    for _ in range(5):
        uvh = fit.coordinates(contact)
        u, v = (uvh[:, :2].min(axis=0) + uvh[:, :2].max(axis=0)) / 2
        R_ST = surfaces.rotation(fit.curvature, u, v)
        p_ST = surfaces.point(fit.curvature, u, v)
        rotation, origin = fit.rotation @ R_ST, fit.origin + fit.rotation @ p_ST
        z = rotation[:, 2]
        x = front_axis(z)
        if fit.shape == "cylinder":
            axis = rotation[:, 0]
            x = axis * (1.0 if axis @ x + 1e-6 * axis[1] >= 0 else -1.0)
            x /= np.linalg.norm(x)
        rotation = np.column_stack([x, np.cross(z, x), z])
        fit = replace(fit, rotation=rotation, origin=origin, residuals=residuals)
    return fit
