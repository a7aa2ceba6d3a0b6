"""Triangle meshes that show ink in Meshcat: shades and rectangles of cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat

from fmp_drake.compiled import compiled
from fmp_drake.systems.ink.colours import ink_colours
from fmp_drake.systems.ink.grid import InkGrid

type FloatArray = NDArray[np.float64]
type ShadeArray = NDArray[np.uint8]

LEVELS = 12
"""Number of shades of ink that are told apart; shade 0 is not drawn."""

LIFT = 0.0005
"""Height in metres at which the ink is drawn above the board."""

# Fraction of a cell by which rectangles reach into the next row: their corners do not
# meet those of that row, and the board would shine through along the edge.
_OVERLAP = 0.02

_COLOURS = ink_colours(np.arange(LEVELS + 1) / LEVELS).T


def corner_shades(ink: ArrayLike) -> ShadeArray:
    """Round the ink at the corners of the cells to shades from 0 to `LEVELS`.

    Parameters
    ----------
    ink : array_like, shape (ny, nx)
        Fraction of the ink that is left, from 0 to 1.

    Returns
    -------
    ndarray of uint8, shape (ny + 1, nx + 1)
        Mean of the shades of the cells that meet in a corner.
    """
    cells = (np.asarray(ink, dtype=float) * LEVELS + 0.5).astype(np.uint8)
    ny, nx = cells.shape
    wide = np.empty((ny + 2, nx + 2), dtype=np.uint8)
    wide[1:-1, 1:-1] = cells
    wide[0, 1:-1], wide[-1, 1:-1] = cells[0], cells[-1]
    wide[:, 0], wide[:, -1] = wide[:, 1], wide[:, -2]
    pairs = wide[:, 1:] + wide[:, :-1]
    mean: ShadeArray = (pairs[1:] + pairs[:-1] + np.uint8(2)) >> np.uint8(2)
    return mean


def ink_mesh(
    grid: InkGrid,
    corners: ArrayLike,
    *,
    origin: tuple[int, int] = (0, 0),
    cells: ArrayLike | None = None,
    lift: float = LIFT,
) -> tuple[FloatArray, NDArray[np.int32], FloatArray]:
    """Build a triangle mesh of inked cells in B, shaded between their corners.

    Neighbours in a row share one rectangle of two triangles where the shade does
    not change along the row.

    Parameters
    ----------
    grid : InkGrid
        Division of the surface into cells.
    corners : array_like of uint8, shape (m + 1, n + 1)
        Shades at the corners of m rows of n cells: all of them, or a part.
    origin : tuple of int
        Row and column of the part's first cell.
    cells : array_like of bool, shape (m, n), optional
        The cells to draw, by default all that have ink at a corner.
    lift : float
        Height above the board in metres.

    Returns
    -------
    vertices : ndarray, shape (3, 4 n)
        Corners of the n rectangles in B in metres.
    faces : ndarray of int32, shape (3, 2 n)
        Triangles as indices of vertices, counterclockwise seen from outside.
    colours : ndarray, shape (3, 4 n)
        Linear RGB of the vertices, from 0 to 1 (Meshcat takes vertex colours so).
    """
    shades = np.ascontiguousarray(corners)
    m, n = shades.shape[0] - 1, shades.shape[1] - 1
    chosen = np.ones((m, n), dtype=bool) if cells is None else np.asarray(cells)
    row, column = origin
    vertices, faces, tones = _rectangles(
        shades,
        chosen,
        grid.corner[0] + grid.pitch[0] * np.arange(column, column + n + 1),
        grid.corner[1] + grid.pitch[1] * np.arange(row, row + m + 1),
        _OVERLAP * grid.pitch[1],
        lift,
    )
    return vertices, faces, _COLOURS.take(tones, axis=1)


@compiled
def _rectangles(
    shades: ShadeArray,
    cells: NDArray[np.bool_],
    x: FloatArray,
    y: FloatArray,
    overlap: float,
    lift: float,
) -> tuple[FloatArray, NDArray[np.int32], ShadeArray]:
    """Return vertices, faces and shades of the rectangles; x and y are edges."""
    m, n = cells.shape
    found = np.empty((m * n, 3), dtype=np.int64)
    count = 0
    for row in range(m):
        extends = False
        for i in range(n):
            a, b = shades[row, i], shades[row, i + 1]
            c, d = shades[row + 1, i], shades[row + 1, i + 1]
            drawn = cells[row, i] and (a | b | c | d) != 0
            level = drawn and a == b and c == d
            if level and extends:
                found[count - 1, 2] = i + 1
            elif drawn:
                found[count] = row, i, i + 1
                count += 1
            extends = level
    vertices = np.full((3, 4 * count), lift)
    faces = np.empty((3, 2 * count), dtype=np.int32)
    tones = np.empty(4 * count, dtype=np.uint8)
    for k in range(count):
        row, begin, end = found[k]
        # Counterclockwise from the corner (-x, -y).
        for i, (j, high) in enumerate(((begin, 0), (end, 0), (end, 1), (begin, 1))):
            vertices[0, 4 * k + i] = x[j]
            vertices[1, 4 * k + i] = y[row + high] + high * overlap
            tones[4 * k + i] = shades[row + high, j]
        faces[:, 2 * k] = 4 * k, 4 * k + 1, 4 * k + 2
        faces[:, 2 * k + 1] = 4 * k, 4 * k + 2, 4 * k + 3
    return vertices, faces, tones


def draw_ink(
    meshcat: Meshcat,
    path: str,
    mesh: tuple[FloatArray, NDArray[np.int32], FloatArray],
) -> bool:
    """Put a mesh at a path, or delete what is there if the mesh is empty.

    Returns
    -------
    bool
        Whether there was anything to draw.
    """
    vertices, faces, colours = mesh
    if faces.shape[1]:
        meshcat.SetTriangleColorMesh(path, vertices, faces, colours)
        return True
    if meshcat.HasPath(path):
        meshcat.Delete(path)
    return False
