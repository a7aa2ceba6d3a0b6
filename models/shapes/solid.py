"""Signed distances of simple solids, and their combinations (NumPy only).

A solid is a function of points, shape (..., 3), m, that is negative inside, zero on
the surface and near it about the distance, m. Blends have a radius: the larger, the
softer.
"""

from collections.abc import Callable, Sequence

import numpy as np

Solid = Callable[[np.ndarray], np.ndarray]
Point = Sequence[float]


def _along(p: np.ndarray, a: Point, b: Point) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the fraction from a to b, the distance to that line, and |b - a|."""
    start, axis = np.asarray(a, dtype=float), np.subtract(b, a).astype(float)
    length = float(np.linalg.norm(axis))
    w = p - start
    share = w @ axis / length**2
    return share, np.linalg.norm(w - share[..., None] * axis, axis=-1), length


def cone(a: Point, b: Point, ra: float, rb: float) -> Solid:
    """Return a round bar from `a` to `b` whose radius goes from `ra` to `rb`."""

    def distance(p: np.ndarray) -> np.ndarray:
        share, radial, length = _along(p, a, b)
        s = np.clip(share, 0, 1)
        return np.hypot(radial, (share - s) * length) - (ra + (rb - ra) * s)

    return distance


def bar(a: Point, b: Point, r: float) -> Solid:
    """Return a bar with round ends."""
    return cone(a, b, r, r)


def drum(a: Point, b: Point, r: float, edge: float, *, dome: float = 0.0) -> Solid:
    """Return a cylinder from `a` to `b` with round edges; `b` may bulge by `dome`."""

    def distance(p: np.ndarray) -> np.ndarray:
        share, radial, length = _along(p, a, b)
        bulge = dome * (1 - np.minimum(radial / r, 1.2) ** 2)
        end = (share - 0.5) * length
        end = np.where(end > 0, end - bulge, -end) - length / 2
        q = np.stack([radial - r, end], axis=-1) + edge
        outside = np.linalg.norm(np.maximum(q, 0), axis=-1)
        return outside + np.minimum(q.max(axis=-1), 0) - edge

    return distance


def block(centre: Point, half: Point, edge: float) -> Solid:
    """Return a box with round edges along the axes."""

    def distance(p: np.ndarray) -> np.ndarray:
        q = np.abs(p - np.asarray(centre)) - np.asarray(half) + edge
        outside = np.linalg.norm(np.maximum(q, 0), axis=-1)
        return outside + np.minimum(q.max(axis=-1), 0) - edge

    return distance


def half_space(point: Point, normal: Point) -> Solid:
    """Return the half space behind a plane."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    return lambda p: (p - np.asarray(point)) @ n


def _soft_min(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
    overlap = np.maximum(k - np.abs(a - b), 0) / k
    return np.minimum(a, b) - overlap**2 * k / 4


def blend(k: float, *solids: Solid) -> Solid:
    """Return the union, its inner edges filled over a width of about `k`."""

    def distance(p: np.ndarray) -> np.ndarray:
        total = solids[0](p)
        for solid in solids[1:]:
            total = _soft_min(total, solid(p), k)
        return total

    return distance


def common(k: float, *solids: Solid) -> Solid:
    """Return the intersection of solids, its outer edges rounded."""
    joined = blend(k, *[lambda p, s=solid: -s(p) for solid in solids])
    return lambda p: -joined(p)


def carve(k: float, solid: Solid, *cutters: Solid) -> Solid:
    """Return a solid without its cutters, the new outer edges rounded."""
    return common(k, solid, *[lambda p, c=cutter: -c(p) for cutter in cutters])
