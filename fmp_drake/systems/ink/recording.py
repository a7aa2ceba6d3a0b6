"""Animation of the disappearing ink in a Meshcat recording."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat
from scipy.ndimage import minimum_filter

from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import LEVELS, LIFT, corner_shades, draw_ink, ink_mesh
from fmp_drake.systems.page.paths import show_during

LAYERS_PER_SECOND = 2.0
"""Layers per second of the recording, unless there would be too many."""

MAX_LAYERS = 150
"""Largest number of layers of a recording."""

# Least visible loss of ink, in 255ths: half a shade.
_SEEN = 255 / LEVELS / 2


def AddInkToRecording(
    meshcat: Meshcat,
    *,
    grid: InkGrid,
    times: ArrayLike,
    ink: ArrayLike,
    path: str = "ink",
) -> int:
    """Add the disappearing ink to Meshcat's recording.

    A Meshcat animation can move, show and hide objects but not change a mesh. So
    the final ink is drawn on the board, and over it the initial ink in layers of the
    cells that fade at about the same time; the animation hides one layer after the
    other. All of it is at `path`/recorded and replaces what `InkVisualizer` has
    drawn. Call it between `Meshcat.StopRecording()` and
    `Meshcat.PublishRecording()`.

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
    initial, final, fade_time = (
        grid.cells(name, cells)
        for name, cells in (
            ("the first ink", inks[0] / 255),
            ("the last ink", inks[-1] / 255),
            ("ink", _fade_times(sample_times, inks)),
        )
    )
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


def _fade_times(
    times: NDArray[np.float64], ink: NDArray[np.uint8]
) -> NDArray[np.float64]:
    """Return the time at which half of a cell's loss is over, s; `inf` without a loss."""
    first, last = ink[0].astype(int), ink[-1].astype(int)
    faded = np.argmax(ink <= ((first + last) // 2).astype(np.uint8), axis=0)
    return np.where(first - last >= _SEEN, times[faded], np.inf)
