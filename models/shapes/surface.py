"""Triangles with smooth normals of implicit solids and of turned parts (NumPy only)."""

from dataclasses import dataclass

import numpy as np
from solid import Point, Solid
from thin_out import thin_out

AROUND = 44  # Corners of a turned part.
Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]  # vertices, normals (N, 3), faces


def _gradient(solid: Solid, p: np.ndarray) -> np.ndarray:
    """Return unit outward normals, shape (N, 3)."""
    step = 2e-5
    shifts = np.eye(3) * step
    g = np.stack([solid(p + s) - solid(p - s) for s in shifts], axis=-1)
    return g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-12)


def _project(solid: Solid, p: np.ndarray, steps: int) -> np.ndarray:
    for _ in range(steps):
        p = p - solid(p)[:, None] * _gradient(solid, p)
    return p


def skin(solid: Solid, low: Point, high: Point, *, step: float) -> Mesh:
    """Triangulate a solid's surface.

    One vertex in each cube of a grid that the surface crosses (surface nets), spread
    out evenly and laid on the surface by Newton's method.

    Parameters
    ----------
    solid : Solid
    low, high : array_like, shape (3,)
        A box around the surface, m.
    step : float
        The side of the grid's cubes, m.

    Returns
    -------
    vertices, normals : ndarray, shape (N, 3)
    faces : ndarray of int, shape (M, 3)
        Counterclockwise from outside.
    """
    axes = [
        np.arange(a - step, b + 2 * step, step) for a, b in zip(low, high, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    value = solid(grid)
    inside = value < 0
    corner = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    shape = np.array(value.shape) - 1
    count = sum(
        inside[tuple(slice(c, c + n) for c, n in zip(d, shape, strict=True))]
        for d in corner
    )
    cells = np.argwhere((count > 0) & (count < 8))
    number = np.full(shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))

    total, hits = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for a in corner:
        for b in corner:
            if (b - a).min() < 0 or (b - a).sum() != 1:
                continue
            ia, ib = tuple((cells + a).T), tuple((cells + b).T)
            crossed = inside[ia] != inside[ib]
            va, vb = value[ia][crossed], value[ib][crossed]
            share = (va / (va - vb))[:, None]
            total[crossed] += (
                grid[ia][crossed] * (1 - share) + grid[ib][crossed] * share
            )
            hits += crossed
    vertices = total / hits[:, None]

    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        a = tuple(slice(1, -1) if i != axis else slice(0, -1) for i in range(3))
        b = tuple(slice(1, -1) if i != axis else slice(1, None) for i in range(3))
        for sign in (True, False):
            at = np.argwhere((inside[a] == sign) & (inside[b] != sign))
            at[:, [u, v]] += 1
            ring = [(0, 0), (-1, 0), (-1, -1), (0, -1)]
            if not sign:
                ring.reverse()
            shifts = np.zeros((4, 3), dtype=int)
            shifts[:, [u, v]] = ring
            quads.append(number[tuple((at[:, None] + shifts).transpose(2, 0, 1))])
    quad = np.concatenate(quads)

    edges = np.concatenate([quad[:, [i, (i + 1) % 4]] for i in range(4)])
    vertices = _project(solid, vertices, 2)
    for _ in range(6):
        mean, degree = np.zeros_like(vertices), np.zeros(len(vertices))
        np.add.at(mean, edges[:, 0], vertices[edges[:, 1]])
        np.add.at(degree, edges[:, 0], 1)
        vertices = vertices + 0.6 * (mean / degree[:, None] - vertices)
        vertices = _project(solid, vertices, 1)
    vertices, faces = thin_out(
        _project(solid, vertices, 2),
        _split(vertices, quad),
        normal=lambda p: _gradient(solid, p),
        project=lambda p: _project(solid, p, 2),
    )
    return vertices, _gradient(solid, vertices), faces


def _split(vertices: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """Cut quadrilaterals along their shorter diagonal."""
    d = np.linalg.norm(vertices[quad[:, [0, 1]]] - vertices[quad[:, [2, 3]]], axis=-1)
    first = (d[:, 0] <= d[:, 1])[:, None]
    one = np.where(first, quad[:, [0, 1, 2]], quad[:, [0, 1, 3]])
    two = np.where(first, quad[:, [0, 2, 3]], quad[:, [1, 2, 3]])
    return np.concatenate([one, two])


@dataclass(frozen=True)
class Disc:
    """A flat round area, m."""

    centre: Point
    axis: Point
    radius: float


def without(mesh: Mesh, hidden: list[Disc]) -> Mesh:
    """Leave out the triangles within 2.5 mm of a disc, which are hidden."""
    vertices, normals, faces = mesh
    gone = np.zeros(len(faces), dtype=bool)
    for disc in hidden:
        axis = np.asarray(disc.axis, dtype=float) / np.linalg.norm(disc.axis)
        w = vertices - np.asarray(disc.centre)
        height = w @ axis
        radial = np.linalg.norm(w - height[:, None] * axis, axis=-1)
        gone |= ((np.abs(height) < 2.5e-3) & (radial < disc.radius))[faces].all(axis=1)
    faces = faces[~gone]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], normals[used], faces.reshape(-1, 3)


def turned(
    centre: Point,
    axis: Point,
    profile: list[tuple[float, float]],
    *,
    smooth: float = 30.0,
) -> Mesh:
    """Turn a profile of (height, radius) about an axis.

    Heights must not fall and the outside is away from the axis. Where the profile
    turns by more than `smooth` degrees it has an edge.
    """
    z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    x = np.cross(z, [0, 0, 1] if abs(z[2]) < 0.9 else [0, 1, 0])
    x /= np.linalg.norm(x)
    angle = np.arange(AROUND) * 2 * np.pi / AROUND
    out = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * np.cross(z, x)
    line = np.asarray(profile, dtype=float)
    across = np.diff(line, axis=0) / np.hypot(*np.diff(line, axis=0).T)[:, None]
    across = across[:, ::-1] * [-1, 1]  # (along z, outwards), unit length
    soft = np.sum(across[:-1] * across[1:], axis=1) > np.cos(np.radians(smooth))
    joined = across[:-1] + across[1:]
    joined /= np.maximum(np.linalg.norm(joined, axis=1), 1e-9)[:, None]
    i = np.arange(AROUND)
    j = (i + 1) % AROUND
    vertices, normals, faces = [], [], []
    for k, n in enumerate(across):
        ends = (
            joined[k - 1] if k > 0 and soft[k - 1] else n,
            joined[k] if k < len(soft) and soft[k] else n,
        )
        if abs(n[0]) > 0.9:  # On the axis the surface lies across it.
            ends = tuple(
                np.sign(n) * [1, 0] if line[k + e, 1] == 0 else ends[e] for e in (0, 1)
            )
        base = 2 * AROUND * k
        for (h, r), (along, outwards) in zip(line[k : k + 2], ends, strict=True):
            vertices.append(np.asarray(centre) + h * z + r * out)
            normals.append(along * z + outwards * out)
        if line[k, 1] > 0:
            faces.append(np.stack([base + i, base + j, base + AROUND + j], axis=1))
        if line[k + 1, 1] > 0:
            faces.append(
                np.stack([base + i, base + AROUND + j, base + AROUND + i], axis=1)
            )
    return np.concatenate(vertices), np.concatenate(normals), np.concatenate(faces)


def plate(
    circles: list[tuple[float, float, float]], *, top: float, edge: float
) -> Mesh:
    """Return a flat plate on z = 0 with a round upper edge and no underside.

    Its outline is a belt around circles (x, y, radius).
    """
    angle = np.arange(2 * AROUND) * np.pi / AROUND
    u = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    centre = np.array([(x, y, 0) for x, y, _ in circles])
    radius = np.array([r for _, _, r in circles])
    widest = np.argmax(u @ centre.T + radius, axis=1)
    outline = centre[widest] + radius[widest, None] * u
    bend = np.linspace(0, np.pi / 2, 5)
    rows = [(0.0, 0.0, 0.0)]  # height, inset, slope of the normal
    rows += [(top - edge * (1 - np.sin(b)), edge * (1 - np.cos(b)), b) for b in bend]
    rows += [(top, 0.030, np.pi / 2)]
    z = np.array([0, 0, 1.0])
    vertices = np.concatenate([outline - i * u + h * z for h, i, _ in rows])
    normals = np.concatenate([np.cos(b) * u + np.sin(b) * z for _, _, b in rows])
    n = len(angle)
    i = np.arange(n)
    j = (i + 1) % n
    faces = []
    for k in range(len(rows) - 1):
        a, b = k * n, (k + 1) * n
        faces.append(np.stack([a + i, a + j, b + j], axis=1))
        faces.append(np.stack([a + i, b + j, b + i], axis=1))
    return vertices, normals, np.concatenate(faces)
