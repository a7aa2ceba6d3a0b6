"""Meshes along paths: rods for lines of some width, bands for covariances."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
    path = np.asarray(points, dtype=float)
    across, up = _section_axes(path)
    radii = np.broadcast_to(np.asarray(radius, dtype=float), len(path))[:, np.newaxis]
    return _sweep(path, radii * across, radii * up, sides)


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

    Each piece of the path gives the convex hull of the ellipses at its ends. It lies a
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
        From each piece to the next, m; the last one is as high as the path.

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


def _section_axes(path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (N, 3) across a path, the first in the plane of x and y.

    Together with the way along the path they are right-handed.
    """
    step = np.diff(path, axis=0)
    along = np.empty_like(path)
    along[0], along[-1] = step[0], step[-1]
    along[1:-1] = step[:-1] + step[1:]
    length = np.sqrt(np.sum(along * along, axis=1, keepdims=True))
    # Where the path rests, any way will do.
    along = np.where(length > 1e-9, along / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
    x, y, z = along.T
    width = np.hypot(x, y)
    level = width > 1e-3
    scale = np.where(level, 1 / np.maximum(width, 1e-3), 0.0)
    # z x along; a path along z has no side, and gets x.
    across = np.stack(
        [np.where(level, -y * scale, 1.0), x * scale, np.zeros_like(x)], axis=1
    )
    up = np.stack(
        [
            -z * across[:, 1],
            z * across[:, 0],
            x * across[:, 1] - y * across[:, 0],
        ],
        axis=1,
    )
    return across, up


def _sweep(path: FloatArray, first: FloatArray, second: FloatArray, sides: int) -> Mesh:
    """Join the ellipses with the conjugate semi-axes `first` and `second` (N, 3)."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = (
        path[:, np.newaxis]
        + np.cos(angle)[:, np.newaxis] * first[:, np.newaxis]
        + np.sin(angle)[:, np.newaxis] * second[:, np.newaxis]
    )
    corner = np.arange(sides, dtype=np.int32)
    following = np.roll(corner, -1)
    one = np.stack([corner, following, corner + sides])
    two = np.stack([following, following + sides, corner + sides])
    strip = np.concatenate([one, two], axis=1)
    offset = sides * np.arange(len(path) - 1, dtype=np.int32)
    faces = (strip[:, np.newaxis] + offset[:, np.newaxis]).reshape(3, -1)
    return ring.reshape(-1, 3).T, faces
