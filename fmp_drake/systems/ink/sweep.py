"""The pressure that a patch of polygons brings on a grid of cells as it travels.

Pure NumPy. B is the board frame, see `InkGrid`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import StationError
from fmp_drake.systems.ink.grid import InkGrid

type FloatArray = NDArray[np.float64]
type IntArray = NDArray[np.intp]

# Cell centres are moved by this share of a cell, so that none lies on an edge
# between two polygons: symmetric scenes put whole rows of them there.
_ASIDE = 1.37e-7
_SMALLEST_AREA = 1e-12  # m^2
_LEAST_PRESSURE = 1e-6  # Pa


class Sweep(NamedTuple):
    """Mean pressure on a rectangle of cells.

    Attributes
    ----------
    rows, columns : slice
        The rectangle, as slices of an array of shape (ny, nx).
    pressure : ndarray, shape (num_rows, num_columns)
        Mean over the places of the pressure at the cells' centres in Pa.
    """

    rows: slice
    columns: slice
    pressure: FloatArray


def sweep(
    grid: InkGrid,
    p_BV: ArrayLike,
    pressure: ArrayLike,
    polygon: ArrayLike,
    *,
    offsets: ArrayLike = ((0.0, 0.0),),
) -> Sweep:
    """Find the mean pressure on cells over which a patch of polygons travels.

    A cell is under a polygon if its centre is; the pressure is linear on each
    polygon. Polygons seen edge-on and cells outside the grid are left out.

    Parameters
    ----------
    grid : InkGrid
        The cells.
    p_BV : array_like, shape (num_vertices, 2)
        Vertices projected on B's plane in metres, polygon by polygon and around
        each. The polygons do not overlap.
    pressure : array_like, shape (num_vertices,)
        Pressure at the vertices in Pa, linear on each polygon.
    polygon : array_like, shape (num_vertices,)
        A number for each vertex, the same within a polygon, another in the next.
    offsets : array_like, shape (num_places, 2)
        Where the patch comes by: it is moved by each of these in B, in metres.

    Returns
    -------
    Sweep
        The rectangle around the patch and the pressure on its cells.

    Notes
    -----
    Each line of cell centres is crossed with the polygons' edges. An edge on the
    low side of a polygon adds the polygon's linear pressure from there on, one on
    its high side takes it away, and the sum along the line is the pressure.
    """
    vertices = np.asarray(p_BV, dtype=float).reshape(-1, 2)
    values = np.asarray(pressure, dtype=float).ravel()
    number = np.asarray(polygon).ravel()
    if not len(values) == len(number) == len(vertices):
        raise StationError(
            f"sweep got {len(values)} pressures and {len(number)} numbers of polygons "
            f"for {len(vertices)} vertices: give one per vertex."
        )
    empty = Sweep(slice(0, 0), slice(0, 0), np.zeros((0, 0)))
    if not len(vertices):
        return empty
    ny, nx = grid.shape
    # In units of cells, with whole numbers at the cells' centres.
    scale = 1.0 / grid.pitch
    x, y = (vertices * scale - (grid.corner * scale + (0.5 - _ASIDE))).T
    shift_x, shift_y = np.ascontiguousarray((np.asarray(offsets) * scale).T)
    column_0 = max(math.ceil(x.min() + shift_x.min()), 0)
    column_1 = min(math.floor(x.max() + shift_x.max()) + 1, nx)
    row_0 = max(math.ceil(y.min() + shift_y.min()), 0)
    row_1 = min(math.floor(y.max() + shift_y.max()) + 1, ny)
    width, height = column_1 - column_0, row_1 - row_0
    if width <= 0 or height <= 0:
        return empty
    x, y = x - column_0, y - row_0

    # Edges go from each vertex to the next, from the last of a polygon to its first.
    begins = np.ones(len(number), dtype=bool)
    begins[1:] = number[1:] != number[:-1]
    starts = begins.nonzero()[0]
    owner = begins.cumsum() - 1
    following = np.arange(1, len(number) + 1)
    following[starts - 1] = np.concatenate([starts[-1:], starts[:-1]])
    x0, y0, p0 = corners = np.array([x, y, values])
    x1, y1, p1 = corners.take(following, axis=1)
    ex, ey = x1 - x0, y1 - y0
    # Area, and by the divergence theorem the gradient, of each polygon.
    twice_mean = p0 + p1
    area, slope_x, slope_y = 0.5 * np.add.reduceat(
        np.array([x0 * y1 - x1 * y0, twice_mean * ey, -twice_mean * ex]), starts, axis=1
    )
    solid = np.abs(area) > _SMALLEST_AREA * scale[0] * scale[1]
    area[~solid] = np.inf
    slope_x /= area
    slope_y /= area
    level = p0[starts] - slope_x * x0[starts] - slope_y * y0[starts]
    # Taken positive where the edge is on the low side of its polygon along x.
    sign = -np.copysign(1.0, area)[owner] * np.sign(ey) * solid[owner]
    signed = np.array([slope_x, slope_y, level]).take(owner, axis=1) * sign
    lean = ex / np.where(ey == 0.0, np.inf, ey)
    of_edge = np.array([x0 - lean * y0, lean, *signed])

    # Pairs of an edge and a line of cells that crosses it, step by step.
    reach = np.array([np.minimum(y0, y1), np.maximum(y0, y1)])[:, np.newaxis]
    reach = np.ceil(reach + shift_y[:, np.newaxis])
    begin, end = np.minimum(np.maximum(reach, 0.0), height).reshape(2, -1)
    count = (end - begin).astype(np.intp)
    pair = np.repeat(np.arange(len(count)), count)
    row = np.arange(len(pair)) + (begin + (count - count.cumsum()))[pair]
    step, edge = np.divmod(pair, len(number))
    back_x, back_y = shift_x[step], shift_y[step]
    at_zero, lean, rise, climb, base = of_edge.take(edge, axis=1)
    line = row - back_y
    column = np.ceil(at_zero + lean * line + back_x)
    column = np.minimum(np.maximum(column, 0.0), width)
    base += climb * line - rise * back_x
    cell = (row * (width + 1) + column).astype(np.intp)
    size, shape = height * (width + 1), (height, width + 1)
    if not len(cell):
        return empty
    # What is added on a line is taken away on it: one sum runs over all lines.
    total = np.bincount(cell, base, size).cumsum().reshape(shape)[:, :width]
    slope = np.bincount(cell, rise, size).cumsum().reshape(shape)[:, :width]
    total += slope * np.arange(width)
    total /= len(shift_x)
    total[total < _LEAST_PRESSURE] = 0.0
    return Sweep(slice(row_0, row_1), slice(column_0, column_1), total)
