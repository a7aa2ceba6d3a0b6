"""The disappearing ink of a whiteboard in a recording of Meshcat."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat

from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import LIFT, corner_shades, draw_ink, ink_mesh

LAYERS_PER_SECOND = 2.0
"""Layers per second of the recording, unless there would be too many."""

MAX_LAYERS = 150
"""Largest number of layers of a recording."""


def AddInkToRecording(
    meshcat: Meshcat,
    *,
    grid: InkGrid,
    initial_ink: ArrayLike,
    final_ink: ArrayLike,
    fade_time: ArrayLike,
    end_time: float,
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
    initial_ink, final_ink : array_like, shape (ny, nx) or (ny nx,)
        Ink at the start and at the end, from 0 to 1.
    fade_time : array_like, shape (ny, nx) or (ny nx,)
        Time in seconds at which a cell lost half of its ink, `inf` if it did not:
        the `fade_time` output of `InkBoard` at the end.
    end_time : float
        Last time of the recording in seconds.
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
    initial, final, times = (
        grid.cells(name, np.asarray(array, dtype=float))
        for name, array in (
            ("initial_ink", initial_ink),
            ("final_ink", final_ink),
            ("fade_time", fade_time),
        )
    )
    animation = meshcat.get_mutable_recording()
    start = animation.start_time()
    span = max(end_time - start, 1.0 / animation.frames_per_second())
    count = int(min(MAX_LAYERS, max(1.0, np.ceil(span * LAYERS_PER_SECOND))))
    width = span / count
    faded = np.isfinite(times)
    layer = np.full(grid.shape, -1)
    layer[faded] = np.clip((times[faded] - start) / width, 0, count - 1).astype(int)

    meshcat.Delete(f"{path}/live")
    meshcat.Delete(f"{path}/recorded")
    remains = ink_mesh(grid, corner_shades(final))
    draw_ink(meshcat, f"{path}/recorded/remains", remains)
    shades = corner_shades(initial)
    last = max(1, animation.frame(start + span))
    used = 0
    for k in range(count):
        name = f"{path}/recorded/layer_{k:03d}"
        mesh = ink_mesh(grid, shades, cells=layer == k, lift=2.0 * LIFT)
        if not draw_ink(meshcat, name, mesh):
            continue
        used += 1
        hide = min(max(1, animation.frame(start + (k + 0.5) * width)), last)
        animation.SetProperty(0, name, "visible", True)
        animation.SetProperty(hide, name, "visible", False)
        # Meshcat loops each path by itself: let all last equally long.
        animation.SetProperty(last, name, "visible", False)
    return used
