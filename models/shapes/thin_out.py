"""Fewer triangles where a surface is nearly flat (NumPy only)."""

import numpy as np

MISS = 2.3e-4  # How far an edge may run under the surface, m.
LONGEST = 0.016  # m


def _edges(faces: np.ndarray) -> np.ndarray:
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0)


def _wanted(p: np.ndarray, n: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the edge length (N,) that each vertex' curvature allows, m."""
    a, b = edges.T
    length = np.linalg.norm(p[a] - p[b], axis=1)
    bend = np.linalg.norm(n[a] - n[b], axis=1) / np.maximum(length, 1e-9)
    most = np.zeros(len(p))
    for end in (a, b):
        np.maximum.at(most, end, bend)
    return np.clip(np.sqrt(8 * MISS / np.maximum(most, 1e-3)), 0, LONGEST)


def _neighbours(edges: np.ndarray, count: int) -> list[set[int]]:
    around: list[set[int]] = [set() for _ in range(count)]
    for a, b in edges.tolist():
        around[a].add(b)
        around[b].add(a)
    return around


def _chosen(
    order: np.ndarray, edges: np.ndarray, around: list[set[int]], forbidden: set[int]
) -> list[tuple[int, int]]:
    """Pick edges, first ones first, whose surroundings do not touch."""
    taken: set[int] = set()
    picked = []
    for a, b in edges[order].tolist():
        if a in taken or b in taken or a in forbidden or b in forbidden:
            continue
        if len(around[a] & around[b]) != 2:
            continue
        picked.append((a, b))
        taken |= around[a] | around[b]
    return picked


def _collapsed(
    faces: np.ndarray, count: int, picked: list[tuple[int, int]]
) -> np.ndarray:
    target = np.arange(count)
    for a, b in picked:
        target[b] = a
    faces = target[faces]
    distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return faces[distinct]


def _folded(p: np.ndarray, n: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (p[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-15)[:, None]
    along = np.einsum("fi,fji->fj", normal, n[faces])
    return along.min(axis=1) < 0.35


def thin_out(vertices, faces, *, normal, project, rounds=14):
    """Collapse edges that are shorter than the curvature needs.

    Parameters
    ----------
    vertices : ndarray, shape (N, 3)
    faces : ndarray of int, shape (M, 3)
        A closed surface.
    normal, project : callables
        The surface's unit normals at points, and points laid on the surface.
    rounds : int
        At most so many passes.
    """
    p, forbidden = vertices, set()
    for _ in range(rounds):
        n = normal(p)
        edges = _edges(faces)
        a, b = edges.T
        wanted = _wanted(p, n, edges)
        length = np.linalg.norm(p[a] - p[b], axis=1)
        ratio = length / np.maximum(np.minimum(wanted[a], wanted[b]), 1e-9)
        order = np.argsort(ratio, kind="stable")
        order = order[ratio[order] < 0.75]
        picked = _chosen(order, edges, _neighbours(edges, len(p)), forbidden)
        if len(picked) < 10:
            break
        for _ in range(4):
            keep = np.array(picked).reshape(-1, 2)
            moved = p.copy()
            moved[keep[:, 0]] = project((p[keep[:, 0]] + p[keep[:, 1]]) / 2)
            result = _collapsed(faces, len(p), picked)
            bad = set(result[_folded(moved, normal(moved), result)].ravel().tolist())
            if not bad & {x for x, _ in picked}:
                break
            forbidden |= {x for x, _ in picked if x in bad}
            picked = [(x, y) for x, y in picked if x not in bad]
        used, compact = np.unique(result, return_inverse=True)
        number = {old: new for new, old in enumerate(used.tolist())}
        forbidden = {number[v] for v in forbidden if v in number}
        p, faces = moved[used], compact.reshape(-1, 3)
    return p, faces
