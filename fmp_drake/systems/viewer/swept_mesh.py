"""Meshes along paths: rods for lines of some width, bands for covariances."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.compiled import compiled

type FloatArray = NDArray[np.float64]
type Mesh = tuple[FloatArray, NDArray[np.int32]]


def rod_mesh(points: ArrayLike, radius: ArrayLike, *, sides: int = 6) -> Mesh:
    """Sweep a circle along a path.

    Meshcat draws every line one pixel wide and opaque; a rod can be seen.

    Parameters
    ----------
    points : array_like, shape (N, 3)
        N of at least 2, m.
    radius : float or array_like, shape (N,)
        m.
    sides : int
        Of the polygon that is swept.

    Returns
    -------
    vertices : ndarray, shape (3, N sides)
        m.
    faces : ndarray of int32, shape (3, 2 (N - 1) sides)
        Triangles as indices of vertices.
    """
    path = np.ascontiguousarray(points, dtype=float)
    return _rod(path, np.full(len(path), radius, dtype=float), sides)


@compiled
def _rod(path: FloatArray, radii: FloatArray, sides: int) -> Mesh:
    n = len(path)
    vertices = np.empty((3, n * sides))
    faces = np.empty((3, 2 * (n - 1) * sides), dtype=np.int32)
    for i in range(n):
        along = path[min(i + 1, n - 1)] - path[max(i - 1, 0)]
        length = np.sqrt(np.sum(along * along))
        # Where the path is at rest, any direction will do.
        x, y, z = along / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
        # Two unit vectors across, the first level: z x along, or x on the way up.
        width = np.hypot(x, y)
        u, v = (-y / width, x / width) if width > 1e-3 else (1.0, 0.0)
        up = np.array([-z * v, z * u, x * v - y * u])
        for k in range(sides):
            angle = 2 * np.pi * k / sides
            cos, sin = radii[i] * np.cos(angle), radii[i] * np.sin(angle)
            a, b = i * sides + k, i * sides + (k + 1) % sides
            vertices[0, a] = path[i, 0] + cos * u + sin * up[0]
            vertices[1, a] = path[i, 1] + cos * v + sin * up[1]
            vertices[2, a] = path[i, 2] + sin * up[2]
            if i < n - 1:
                faces[:, 2 * a] = a, b, a + sides
                faces[:, 2 * a + 1] = b, b + sides, a + sides
    return vertices, faces


def covariance_band(
    points: ArrayLike,
    covariances: ArrayLike,
    *,
    deviations: float = 2.0,
    sides: int = 24,
    thinnest: float = 5e-4,
    descent: float = 3e-5,
) -> Mesh:
    """Sweep the ellipses of covariances along a path, flat in the plane of x and y.

    Each segment of the path gives the convex hull of the ellipses at its ends. It lies a
    little lower than the one before it: in a translucent mesh that is drawn in order,
    what overlaps does not become darker.

    Parameters
    ----------
    points : array_like, shape (N, 3)
        N of at least 2, m.
    covariances : array_like, shape (N, 3, 3)
        Of the points, m^2; the part of x and y is shown.
    deviations : float
        Size of the ellipses in standard deviations.
    sides : int
        Of the polygon that stands for a hull.
    thinnest : float
        Smallest semi-axis, m.
    descent : float
        From each segment to the next, m; the last one is as high as the path.

    Returns
    -------
    vertices : ndarray, shape (3, (N - 1) sides)
        m.
    faces : ndarray of int32, shape (3, (N - 1) (sides - 2))
        Triangles as indices of vertices, counterclockwise seen from above.
    """
    path = np.asarray(points, dtype=float)
    sigma = np.array(covariances, dtype=float).reshape(-1, 3, 3)[:, :2, :2]
    sigma[:, [0, 1], [0, 1]] += (thinnest / deviations) ** 2
    angle = 2 * np.pi * np.arange(sides) / sides
    way = np.stack([np.cos(angle), np.sin(angle)])
    # The farthest point of each ellipse in each direction, (N, sides).
    spread = sigma @ way
    reach = np.sqrt(np.sum(way * spread, axis=1))
    edge = path[:, :2, np.newaxis] + deviations * spread / reach[:, np.newaxis]
    distance = np.sum(way * edge, axis=1)
    edge = np.concatenate(
        [edge, np.broadcast_to(path[:, 2:, np.newaxis], (len(path), 1, sides))], axis=1
    )
    first = (distance[:-1] >= distance[1:])[:, np.newaxis]
    hull = np.where(first, edge[:-1], edge[1:])
    hull[:, 2] += descent * np.arange(len(hull) - 1, -1, -1)[:, np.newaxis]
    corner = np.arange(1, sides - 1, dtype=np.int32)
    fan = np.stack([np.zeros_like(corner), corner, corner + 1])
    offset = sides * np.arange(len(hull), dtype=np.int32)
    faces = (fan[:, np.newaxis] + offset[:, np.newaxis]).reshape(3, -1)
    return hull.transpose(1, 0, 2).reshape(3, -1), faces
