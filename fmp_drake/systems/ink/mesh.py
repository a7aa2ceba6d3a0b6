"""Colours of the ink, its triangle mesh for Meshcat, and its animation in a recording."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat
from scipy.ndimage import minimum_filter

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array, Mask
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.page.paths import show_during
from fmp_drake.systems.surface import surface

type ShadeArray = NDArray[np.uint8]

INK_COLOUR = (0.20, 0.38, 0.76)
"""Colour of full ink (linear RGB, 0 to 1): a pale blue marker. The green, orange and
violet of other drawings on the board are distinct from it."""

BOARD_COLOUR = (1.0, 1.0, 1.0)
"""Colour towards which the ink fades (linear RGB, 0 to 1)."""

LEVELS = 12
"""Number of distinct shades of ink; shade 0 is not drawn."""

LIFT = 0.0005
"""Height in metres at which the ink is drawn above the board."""

LAYERS_PER_SECOND = 2.0
"""Layers per second of a recording, unless there would be too many."""

MAX_LAYERS = 150
"""Largest number of layers of a recording."""

# Least visible loss of ink, in 255ths: half a shade.
_VISIBLE_LOSS = 255 / LEVELS / 2

# Longest rectangle on a curved board, m: at a radius of 0.1 m it deviates by 0.1 mm.
_LONGEST = 0.01

# Fraction of a cell by which rectangles overlap the next row. Their corners do not
# coincide with those of that row, so the board would be visible along the edge.
_OVERLAP = 0.02


def ink_colours(ink: ArrayLike, *, srgb: bool = False) -> Array:
    """Return the colours of fractions of ink, a mixture of ink and board.

    The mixture is linear in light intensity, like Meshcat's between vertices. To paint
    on a rendered board, multiply by it: `ink_colours(0)` is white.

    Parameters
    ----------
    ink : array_like
        Remaining fraction, from 0 to 1, of any shape, such as (ny, nx).
    srgb : bool
        Return sRGB, as in pictures, in place of linear RGB.

    Returns
    -------
    ndarray, shape (..., 3)
        Red, green and blue from 0 to 1.
    """
    fraction = np.clip(np.asarray(ink, dtype=float), 0.0, 1.0)[..., np.newaxis]
    board = np.array(BOARD_COLOUR)
    linear: Array = board + fraction * (np.array(INK_COLOUR) - board)
    if not srgb:
        return linear
    # IEC 61966-2-1.
    return np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055
    )


_COLOURS = ink_colours(np.arange(LEVELS + 1) / LEVELS).T


def corner_shades(ink: ArrayLike) -> ShadeArray:
    """Return the ink at the corners of the cells, rounded to shades from 0 to `LEVELS`.

    Parameters
    ----------
    ink : array_like, shape (ny, nx)
        Remaining fraction, from 0 to 1.

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
    return (pairs[1:] + pairs[:-1] + np.uint8(2)) >> np.uint8(2)


def ink_mesh(
    grid: InkGrid,
    corners: ArrayLike,
    *,
    origin: tuple[int, int] = (0, 0),
    cells: ArrayLike | None = None,
    lift: float = LIFT,
) -> tuple[Array, NDArray[np.int32], Array]:
    """Build a triangle mesh of inked cells in B, shaded between their corners.

    Neighbours in a row share one rectangle of two triangles where the shade does
    not change along the row. On a curved board the mesh is bent with it.

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
        n if grid.curvature.is_plane else max(1, int(_LONGEST / grid.pitch[0])),
    )
    if not grid.curvature.is_plane:
        vertices = surface.place(grid.curvature, vertices.T).T
    return vertices, faces, _COLOURS.take(tones, axis=1)


@compiled
def _rectangles(
    shades: ShadeArray,
    cells: Mask,
    x: Array,
    y: Array,
    overlap: float,
    lift: float,
    longest: int,
) -> tuple[Array, NDArray[np.int32], ShadeArray]:
    """Return vertices, faces and shades of rectangles of `longest` cells; x and y are edges."""
    m, n = cells.shape
    rectangles = np.empty((m * n, 3), dtype=np.int64)
    count = 0
    for row in range(m):
        extends = False
        for i in range(n):
            a, b = shades[row, i], shades[row, i + 1]
            c, d = shades[row + 1, i], shades[row + 1, i + 1]
            drawn = cells[row, i] and (a | b | c | d) != 0
            level = drawn and a == b and c == d
            if level and extends and i - rectangles[count - 1, 1] < longest:
                rectangles[count - 1, 2] = i + 1
            elif drawn:
                rectangles[count, 0] = row
                rectangles[count, 1], rectangles[count, 2] = i, i + 1
                count += 1
            extends = level
    vertices = np.full((3, 4 * count), lift)
    faces = np.empty((3, 2 * count), dtype=np.int32)
    tones = np.empty(4 * count, dtype=np.uint8)
    for k in range(count):
        row, begin, end = rectangles[k]
        # Counterclockwise from the corner (-x, -y).
        for i, (j, high) in enumerate(((begin, 0), (end, 0), (end, 1), (begin, 1))):
            vertices[0, 4 * k + i] = x[j]
            vertices[1, 4 * k + i] = y[row + high] + high * overlap
            tones[4 * k + i] = shades[row + high, j]
        for side in range(2):
            faces[0, 2 * k + side] = 4 * k
            faces[1, 2 * k + side] = 4 * k + 1 + side
            faces[2, 2 * k + side] = 4 * k + 2 + side
    return vertices, faces, tones


def draw_ink(
    meshcat: Meshcat,
    path: str,
    mesh: tuple[Array, NDArray[np.int32], Array],
) -> bool:
    """Draw a mesh at a path, or delete the one there if the new mesh is empty.

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


def AddInkToRecording(
    meshcat: Meshcat,
    *,
    grid: InkGrid,
    times: ArrayLike,
    ink: ArrayLike,
    path: str = "ink",
) -> int:
    """Add the disappearing ink to Meshcat's recording.

    A Meshcat animation can move, show and hide objects but not change a mesh. Therefore
    the final ink is drawn on the board, and over it the initial ink in layers of the
    cells that fade at about the same time; the animation hides the layers one after the
    other. All of it is at `path`/recorded and replaces the drawing of `InkVisualizer`.
    Call it between `Meshcat.StopRecording()` and `Meshcat.PublishRecording()`.

    Parameters
    ----------
    meshcat : Meshcat
        The Meshcat that has recorded the simulation.
    grid : InkGrid
        Division of the surface into cells.
    times : array_like, shape (K,)
        Times of the samples of the ink, from the start to the end of the recording, s.
    ink : array_like of uint8, shape (K, ny nx)
        Remaining ink at these times, 0 for none to 255 for all.
    path : str
        Meshcat path at the board frame B, the same as the visualizer's.

    Returns
    -------
    int
        Number of layers that the animation hides.

    Raises
    ------
    SystemsError
        If the arrays do not fit the grid.
    """
    sample_times, inks = np.asarray(times, dtype=float), np.asarray(ink)
    initial = grid.cells("the first ink", inks[0] / 255)
    final = grid.cells("the last ink", inks[-1] / 255)
    fade_time = grid.cells("ink", _fade_times(sample_times, inks))
    animation = meshcat.get_mutable_recording()
    start = animation.start_time()
    span = max(sample_times[-1] - start, 1.0 / animation.frames_per_second())
    count = int(min(MAX_LAYERS, max(1.0, np.ceil(span * LAYERS_PER_SECOND))))
    width = span / count
    # The shades of corners also change beside the fading cells. An oblique view shows
    # them under the edge of a layer.
    neighbours = minimum_filter(fade_time, 5, mode="nearest")
    fading = np.where(np.isfinite(fade_time), fade_time, neighbours)
    faded = np.isfinite(fading)
    layer = np.full(grid.shape, -1)
    layer[faded] = np.clip((fading[faded] - start) / width, 0, count - 1).astype(int)

    meshcat.Delete(f"{path}/live")
    meshcat.Delete(f"{path}/recorded")
    remains = ink_mesh(grid, corner_shades(final))
    draw_ink(meshcat, f"{path}/recorded/remains", remains)
    shades = corner_shades(initial)
    used = 0
    for k in range(count):
        name = f"{path}/recorded/layer_{k:03d}"
        mesh = ink_mesh(grid, shades, cells=layer == k, lift=2.0 * LIFT)
        if draw_ink(meshcat, name, mesh):
            used += 1
            hide = start + (k + 0.5) * width
            show_during(animation, name, until=hide, end=start + span)
    return used


def _fade_times(times: Array, ink: NDArray[np.uint8]) -> Array:
    """Return the time at which half of a cell's loss is over, s; `inf` without a loss."""
    first, last = ink[0].astype(int), ink[-1].astype(int)
    faded = np.argmax(ink <= ((first + last) // 2).astype(np.uint8), axis=0)
    return np.where(first - last >= _VISIBLE_LOSS, times[faded], np.inf)
