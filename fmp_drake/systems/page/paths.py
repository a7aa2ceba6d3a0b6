"""Paths in Meshcat: meshes along them, drawings, and animations."""

import math
from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, MeshcatAnimation, Rgba

from fmp_drake.compiled import compiled
from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, finite_array
from fmp_drake.systems.surface import surface as surfaces
from fmp_drake.systems.surface.surface import PLANE, Surface

type Mesh = tuple[Array, NDArray[np.int32]]

DEMONSTRATION_COLOR = Rgba(0.36, 0.38, 0.42, 1.0)
"""Colour of demonstrated paths."""

LIFT = 0.002
"""Offset along z of the drawing of a path, m."""

BAND_SIDES = 24
"""Number of sides of a polygon in the band of covariances."""

BAND_DESCENT = 3e-5
"""Descent from one segment of the band to the next, m."""

# Size of the ellipses of covariances in standard deviations, and their least semi-axis, m.
_DEVIATIONS, _LEAST_AXIS = 2.0, 5e-4
# Number of sides of a rod.
_ROD_SIDES = 6
# The longest part that appears at once, s, unless there would be too many parts.
_PART = 0.25
_MAX_PARTS = 300


def rod_mesh(points: ArrayLike, radius: ArrayLike) -> Mesh:
    """Sweep a hexagon along a path.

    Meshcat draws every line one pixel wide and opaque; a rod is visible from a
    distance.

    Parameters
    ----------
    points : array_like, shape (N, 3)
        N of at least 2, m.
    radius : float or array_like, shape (N,)
        m.

    Returns
    -------
    vertices : ndarray, shape (3, 6 N)
        m.
    faces : ndarray of int32, shape (3, 12 (N - 1))
        Triangles as indices of vertices.
    """
    path = np.ascontiguousarray(points, dtype=float)
    return _rod(path, np.full(len(path), radius, dtype=float))


@compiled
def _rod(path: Array, radii: Array) -> Mesh:
    n, sides = len(path), _ROD_SIDES
    vertices = np.empty((3, n * sides))
    faces = np.empty((3, 2 * (n - 1) * sides), dtype=np.int32)
    for i in range(n):
        before, after = max(i - 1, 0), min(i + 1, n - 1)
        x = path[after, 0] - path[before, 0]
        y = path[after, 1] - path[before, 1]
        z = path[after, 2] - path[before, 2]
        length = math.sqrt(x * x + y * y + z * z)
        # Where the path is at rest, any direction is suitable.
        along = length > 1e-9
        x, y, z = (x / length, y / length, z / length) if along else (1.0, 0.0, 0.0)
        # Two unit vectors across; the first is level: z x along, or x for a vertical path.
        width = math.hypot(x, y)
        u, v = (-y / width, x / width) if width > 1e-3 else (1.0, 0.0)
        for k in range(sides):
            angle = 2 * math.pi * k / sides
            cos, sin = radii[i] * math.cos(angle), radii[i] * math.sin(angle)
            a, b = i * sides + k, i * sides + (k + 1) % sides
            vertices[0, a] = path[i, 0] + cos * u - sin * (z * v)
            vertices[1, a] = path[i, 1] + cos * v + sin * (z * u)
            vertices[2, a] = path[i, 2] + sin * (x * v - y * u)
            if i < n - 1:
                for side, corners in enumerate(((a, b), (b, b + sides))):
                    faces[0, 2 * a + side] = corners[0]
                    faces[1, 2 * a + side] = corners[1]
                    faces[2, 2 * a + side] = a + sides
    return vertices, faces


def covariance_band(points: ArrayLike, covariances: ArrayLike) -> Mesh:
    """Sweep the ellipses of covariances along a path, flat in the plane of x and y.

    Their semi-axes are two standard deviations long.

    Each segment of the path gives the convex hull of the ellipses at its ends. It is a
    little lower than the one before it, and the last one is as high as the path: in a
    translucent mesh that is drawn in order, overlaps do not become darker.

    Parameters
    ----------
    points : array_like, shape (N, 3)
        N of at least 2, m.
    covariances : array_like, shape (N, 3, 3)
        Of the points, m^2; the part of x and y is shown.

    Returns
    -------
    vertices : ndarray, shape (3, 24 (N - 1))
        m.
    faces : ndarray of int32, shape (3, 22 (N - 1))
        Triangles as indices of vertices, counterclockwise seen from above.
    """
    path = np.asarray(points, dtype=float)
    sigma = np.array(covariances, dtype=float).reshape(-1, 3, 3)[:, :2, :2]
    sigma[:, [0, 1], [0, 1]] += (_LEAST_AXIS / _DEVIATIONS) ** 2
    angle = 2 * np.pi * np.arange(BAND_SIDES) / BAND_SIDES
    directions = np.stack([np.cos(angle), np.sin(angle)])
    # The farthest point of each ellipse in each direction, (N, sides).
    spread = sigma @ directions
    reach = np.sqrt(np.sum(directions * spread, axis=1))
    edge = path[:, :2, np.newaxis] + _DEVIATIONS * spread / reach[:, np.newaxis]
    distance = np.sum(directions * edge, axis=1)
    height = np.broadcast_to(path[:, 2:, np.newaxis], (len(path), 1, BAND_SIDES))
    edge = np.concatenate([edge, height], axis=1)
    first = (distance[:-1] >= distance[1:])[:, np.newaxis]
    hull = np.where(first, edge[:-1], edge[1:])
    hull[:, 2] += BAND_DESCENT * np.arange(len(hull) - 1, -1, -1)[:, np.newaxis]
    corner = np.arange(1, BAND_SIDES - 1, dtype=np.int32)
    fan = np.stack([np.zeros_like(corner), corner, corner + 1])
    offset = BAND_SIDES * np.arange(len(hull), dtype=np.int32)
    faces = (fan[:, np.newaxis] + offset[:, np.newaxis]).reshape(3, -1)
    return hull.transpose(1, 0, 2).reshape(3, -1), faces


def css_color(color: Rgba) -> str:
    """Return a colour as CSS.

    Examples
    --------
    >>> css_color(Rgba(1.0, 0.5, 0.0, 0.3))
    'rgb(255 128 0 / 0.3)'
    """
    red, green, blue = (round(255 * c) for c in (color.r(), color.g(), color.b()))
    return f"rgb({red} {green} {blue} / {color.a():g})"


def lifted(points: ArrayLike, lift: float = LIFT) -> Array:
    """Return points (N, 3) in B above the board, raised by `lift` (m) along z.

    Points below the surface of the board, which would hide them, are drawn on it.
    """
    raised = np.array(points, dtype=float)
    raised[:, 2] = np.maximum(raised[:, 2], 0.0) + lift
    return raised


def on_surface(vertices: Array, surface: Surface) -> Array:
    """Return the positions in B of vertices (3, N) in (u, v, h) over a surface, m."""
    return surfaces.place(surface, np.ascontiguousarray(vertices.T)).T


def draw_line(
    meshcat: Meshcat,
    path: str,
    points: Array,
    *,
    color: Rgba,
    surface: Surface = PLANE,
) -> None:
    """Draw points (N, 3) as a line, raised by `LIFT`, over a surface.

    Browsers draw every line opaque and one pixel wide; a rod is more visible.
    """
    if len(points) < 2:
        return
    meshcat.SetLine(path, on_surface(lifted(points).T, surface), 1.0, color)


def draw_rod(
    meshcat: Meshcat,
    path: str,
    points: Array,
    *,
    radius: float | Array,
    color: Rgba,
    lift: float = LIFT,
    surface: Surface = PLANE,
) -> None:
    """Draw points (N, 3) as a rod of some radius (m), raised by `lift` (m)."""
    if len(points) < 2:
        return
    vertices, faces = rod_mesh(lifted(points, lift), radius)
    meshcat.SetTriangleMesh(path, on_surface(vertices, surface), faces, color)


def draw_demonstrations(
    meshcat: Meshcat,
    path: str,
    demonstrations: Iterable[Array],
    *,
    surface: Surface = PLANE,
) -> None:
    """Draw demonstrated paths as thin lines, once.

    Parameters
    ----------
    meshcat : Meshcat
    path : str
        Meshcat path; the caller sets its transform to X_WB.
    demonstrations : iterable of ndarray, shape (N, 3)
        Points in B, or (u, v, h) over a curved board, m.
    surface : Surface
        Of the board.
    """
    meshcat.Delete(path)
    for i, points in enumerate(demonstrations):
        shape = ("N", 3) if np.size(points) else None
        draw_line(
            meshcat,
            f"{path}/{i}",
            finite_array(points, "a path", shape, error=SystemsError),
            color=DEMONSTRATION_COLOR,
            surface=surface,
        )


def AddPathToRecording(
    meshcat: Meshcat,
    path: str,
    *,
    times: ArrayLike,
    points: ArrayLike,
    color: Rgba,
    surface: Surface = PLANE,
) -> None:
    """Add a path to Meshcat's recording, whose parts appear one after another.

    Call it between `Meshcat.StopRecording()` and `Meshcat.PublishRecording()`.

    Parameters
    ----------
    meshcat : Meshcat
    path : str
        Meshcat path; the caller sets its transform to X_WB.
    times : array_like, shape (N,)
        Ascending, s.
    points : array_like, shape (N, 3)
        Points in B, or (u, v, h) over a curved board, m.
    color : Rgba
    surface : Surface
        Of the board.
    """
    meshcat.Delete(path)
    if np.size(times) < 2:
        return
    seconds = finite_array(times, "the times", ("N",), error=SystemsError)
    line = finite_array(points, "the points", (len(seconds), 3), error=SystemsError)
    animation = meshcat.get_mutable_recording()
    parts = int(np.clip(np.ceil((seconds[-1] - seconds[0]) / _PART), 1, _MAX_PARTS))
    edges = np.searchsorted(seconds, np.linspace(seconds[0], seconds[-1], parts + 1))
    for a, b in pairwise(edges):
        name = f"{path}/{a}"
        draw_line(meshcat, name, line[a : b + 1], color=color, surface=surface)
        show_during(animation, name, since=seconds[b], end=seconds[-1])


def show_during(
    animation: MeshcatAnimation,
    path: str,
    *,
    since: float = -math.inf,
    until: float = math.inf,
    end: float,
) -> None:
    """Show a path only in an interval, s, of an animation of finite duration."""
    # Meshcat loops each path separately, so all get the same duration.
    first, last = 0, max(1, animation.frame(end))
    for time, visible in ((since, True), (until, False)):
        if np.isfinite(time):
            frame = min(max(1, animation.frame(time)), last)
            animation.SetProperty(first, path, "visible", not visible)
            animation.SetProperty(frame, path, "visible", visible)
            animation.SetProperty(last, path, "visible", visible)
