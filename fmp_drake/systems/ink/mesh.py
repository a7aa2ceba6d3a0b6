"""Triangle meshes that show ink in Meshcat: shades and rectangles of cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat

from fmp_drake.systems.ink.colours import ink_colours
from fmp_drake.systems.ink.grid import InkGrid

type FloatArray = NDArray[np.float64]
type ShadeArray = NDArray[np.uint8]

LEVELS = 12
"""Number of shades of ink that are told apart; shade 0 is not drawn."""

LIFT = 0.0005
"""Height in metres at which the ink is drawn above the board."""

# Share of a cell by which rectangles reach into the next row: their corners do not
# meet those of that row, and the board would shine through along the edge.
_OVERLAP = 0.02

_COLOURS = ink_colours(np.arange(LEVELS + 1) / LEVELS).T


def corner_shades(ink: ArrayLike) -> ShadeArray:
    """Round the ink at the corners of the cells to shades from 0 to `LEVELS`.

    Parameters
    ----------
    ink : array_like, shape (ny, nx)
        Share of the ink that is left, from 0 to 1.

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
    shade = np.asarray(corners)
    drawn = (shade[:, 1:] | shade[:, :-1]) != 0
    drawn = drawn[1:] | drawn[:-1]
    if cells is not None:
        drawn &= np.asarray(cells, dtype=bool)
    # Whether a cell is level along x, at both of its edges.
    even = shade[:, 1:] == shade[:, :-1]
    even = even[1:] & even[:-1] & drawn
    begins = drawn.copy()
    begins[:, 1:] &= ~(even[:, 1:] & even[:, :-1])
    ends = drawn.copy()
    ends[:, :-1] = begins[:, 1:] | (drawn[:, :-1] & ~drawn[:, 1:])
    ends &= drawn
    row, begin = np.nonzero(begins)
    end = np.nonzero(ends)[1] + 1

    x0, x1 = (grid.corner[0] + grid.pitch[0] * (i + origin[1]) for i in (begin, end))
    y0, y1 = (
        grid.corner[1] + grid.pitch[1] * (j + origin[0])
        for j in (row, row + 1.0 + _OVERLAP)
    )
    z = np.full(len(row), lift)
    places = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
    vertices = np.array(places).transpose(1, 2, 0).reshape(3, -1)
    first = 4 * np.arange(len(row), dtype=np.int32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    faces = (first[:, np.newaxis, np.newaxis] + triangles).reshape(-1, 3).T
    of_corner = np.array(
        [shade[row, begin], shade[row, end], shade[row + 1, end], shade[row + 1, begin]]
    )
    colours = _COLOURS.take(of_corner.T.ravel(), axis=1)
    return vertices, np.ascontiguousarray(faces), colours


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
