"""Showing the ink of a whiteboard in Meshcat, live and in recordings."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    DiscreteValues,
    LeafSystem,
    OutputPort,
)

from fmp_drake.errors import StationError
from fmp_drake.systems.ink_grid import InkGrid

type FloatArray = NDArray[np.float64]

LEVELS = 12
"""Number of shades of ink that are told apart; shade 0 is not drawn."""

INK_COLOUR = (0.01, 0.04, 0.45)
"""Colour of full ink (linear RGB, 0 to 1): a blue marker."""

BOARD_COLOUR = (1.0, 1.0, 1.0)
"""Colour towards which the ink fades (linear RGB, 0 to 1)."""

LIFT = 0.0005
"""Height in metres at which the ink is drawn above the board."""


class InkVisualizer(LeafSystem):
    """Draw the ink of a whiteboard in Meshcat whenever its shades change.

    .. code-block:: none

        ink -> InkVisualizer

    Input ports:

    - `ink`, size ny nx: fraction of the ink left in each cell, row-major.

    The shades drawn last are discrete state. The mesh is at `path`/live; what
    else is under `path` is deleted when a simulation is initialised.

    Parameters
    ----------
    meshcat : Meshcat
        Where to draw.
    grid : InkGrid
        Division of the surface into cells.
    X_WB : RigidTransform
        Pose of the board frame B.
    path : str
        Meshcat path of the ink. Keep it outside the path of `MeshcatVisualizer`,
        which deletes everything under its own.
    rate : float
        Highest rate of drawing in Hz.

    Raises
    ------
    StationError
        If the rate is not positive.
    """

    def __init__(
        self,
        *,
        meshcat: Meshcat,
        grid: InkGrid,
        X_WB: RigidTransform,
        path: str = "ink",
        rate: float = 15.0,
    ) -> None:
        """Declare the port, the state and the events."""
        super().__init__()
        self.set_name("ink_visualizer")
        if not (np.isfinite(rate) and rate > 0.0):
            raise StationError(f"InkVisualizer rate is {rate}: give a positive rate.")
        self._meshcat = meshcat
        self._grid = grid
        self._X_WB = X_WB
        self._path = path
        self._ink = self.DeclareVectorInputPort("ink", grid.num_cells)
        self._drawn_index = int(self.DeclareDiscreteState(grid.num_cells))
        # A publish event may not write state, so each one has an update beside
        # it. At one time publish comes first, and both see the same input.
        period = 1.0 / rate
        self.DeclareInitializationDiscreteUpdateEvent(self._remember)
        self.DeclareInitializationPublishEvent(self._redraw)
        self.DeclareForcedPublishEvent(self._redraw)
        self.DeclarePeriodicPublishEvent(period, period, self._draw_if_changed)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._remember)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        ink: OutputPort,
        *,
        meshcat: Meshcat,
        grid: InkGrid,
        X_WB: RigidTransform,
        path: str = "ink",
        rate: float = 15.0,
    ) -> InkVisualizer:
        """Add an `InkVisualizer` to a builder and connect it to an ink output.

        Takes the builder, the output port and the constructor's parameters.
        """
        visualizer = InkVisualizer(
            meshcat=meshcat, grid=grid, X_WB=X_WB, path=path, rate=rate
        )
        builder.AddSystem(visualizer)
        builder.Connect(ink, visualizer.GetInputPort("ink"))
        return visualizer

    def _shades(self, context: Context) -> NDArray[np.intp]:
        ink = cast(FloatArray, self._ink.Eval(context))
        return shades(ink).reshape(self._grid.shape)

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        drawn = self._shades(context).ravel().astype(float)
        values.set_value(self._drawn_index, drawn)

    def _redraw(self, context: Context) -> None:
        self._meshcat.Delete(self._path)
        self._meshcat.SetTransform(self._path, self._X_WB)
        _draw(self._meshcat, f"{self._path}/live", self._grid, self._shades(context))

    def _draw_if_changed(self, context: Context) -> None:
        new = self._shades(context)
        drawn = context.get_discrete_state(self._drawn_index).value()
        if not np.array_equal(new.ravel(), drawn):
            _draw(self._meshcat, f"{self._path}/live", self._grid, new)


def AddInkToRecording(
    meshcat: Meshcat,
    *,
    grid: InkGrid,
    X_WB: RigidTransform,
    initial_ink: ArrayLike,
    erase_time: ArrayLike,
    end_time: float,
    path: str = "ink",
    layers_per_second: float = 2.0,
    max_layers: int = 150,
) -> int:
    """Add the disappearing ink to Meshcat's recording.

    A Meshcat animation can move, show and hide objects but not change a mesh. So
    the ink is drawn as layers of the cells that are erased at about the same
    time, and the animation hides one layer after the other. The layers replace
    the mesh of `InkVisualizer`. Call it between `Meshcat.StopRecording()` and
    `Meshcat.PublishRecording()`.

    Parameters
    ----------
    meshcat : Meshcat
        The Meshcat that has recorded the simulation.
    grid : InkGrid
        Division of the surface into cells.
    X_WB : RigidTransform
        Pose of the board frame B.
    initial_ink : array_like, shape (ny, nx)
        Ink at the start, from 0 to 1.
    erase_time : array_like, shape (ny nx,)
        Time in seconds at which a cell was erased, `inf` if it was not: the
        `erase_time` output of `InkBoard` at the end.
    end_time : float
        Last time of the recording in seconds.
    path : str
        Meshcat path of the ink, the same as the visualizer's.
    layers_per_second : float
        Layers per second of the recording, unless there would be too many.
    max_layers : int
        Largest number of layers.

    Returns
    -------
    int
        Number of layers that the animation hides.

    Raises
    ------
    StationError
        If the arrays do not fit the grid.
    """
    ink = np.asarray(initial_ink, dtype=float).ravel()
    times = np.asarray(erase_time, dtype=float).ravel()
    for name, array in (("initial_ink", ink), ("erase_time", times)):
        if array.size != grid.num_cells:
            raise StationError(
                f"AddInkToRecording got {array.size} values of {name}, but the "
                f"grid has {grid.num_cells} cells."
            )
    animation = meshcat.get_mutable_recording()
    start = animation.start_time()
    span = max(end_time - start, 1.0 / animation.frames_per_second())
    count = int(min(max_layers, max(1.0, np.ceil(span * layers_per_second))))
    width = span / count
    erased = np.isfinite(times)
    layer = np.full(grid.num_cells, -1)
    layer[erased] = np.clip((times[erased] - start) / width, 0, count - 1).astype(int)

    meshcat.Delete(path)
    meshcat.SetTransform(path, X_WB)
    initial = shades(ink)
    last = max(1, animation.frame(start + span))
    used = 0
    for k in range(-1, count):
        chosen = np.where(layer == k, initial, 0).reshape(grid.shape)
        if not chosen.any():
            continue
        name = f"{path}/remains" if k < 0 else f"{path}/layer_{k:03d}"
        _draw(meshcat, name, grid, chosen)
        if k >= 0:
            used += 1
            hide = min(max(1, animation.frame(start + (k + 0.5) * width)), last)
            animation.SetProperty(0, name, "visible", True)
            animation.SetProperty(hide, name, "visible", False)
            # Meshcat loops each path by itself: let all last equally long.
            animation.SetProperty(last, name, "visible", False)
    return used


def shades(ink: ArrayLike) -> NDArray[np.intp]:
    """Round ink from 0 to 1 to shades from 0 (not drawn) to `LEVELS`, same shape."""
    return np.rint(np.asarray(ink, dtype=float) * LEVELS).astype(np.intp)


def ink_mesh(
    grid: InkGrid, shade: ArrayLike
) -> tuple[FloatArray, NDArray[np.int32], FloatArray]:
    """Build a triangle mesh of the inked cells, in B at the height `LIFT`.

    Neighbours of one shade in a row share one rectangle of two triangles.

    Parameters
    ----------
    grid : InkGrid
        Division of the surface into cells.
    shade : array_like of int, shape (ny, nx)
        Shades from 0 (not drawn) to `LEVELS`.

    Returns
    -------
    vertices : ndarray, shape (3, 4 n)
        Corners of the n rectangles in B in metres.
    faces : ndarray of int32, shape (3, 2 n)
        Triangles as indices of vertices, counterclockwise seen from outside.
    colours : ndarray, shape (3, 4 n)
        Linear RGB of the vertices, from 0 to 1 (Meshcat takes vertex colours so).
    """
    rows = np.asarray(shade)
    ny = rows.shape[0]
    # Runs of one shade: they begin and end where it changes, edges included.
    fence = np.full((ny, 1), -1)
    change = np.diff(np.hstack([fence, rows, fence]), axis=1) != 0
    row, edge = np.nonzero(change)
    same_row = row[:-1] == row[1:]
    row, begin, end = row[:-1][same_row], edge[:-1][same_row], edge[1:][same_row]
    value = rows[row, begin]
    inked = value > 0
    row, begin, end, value = row[inked], begin[inked], end[inked], value[inked]

    x0, x1 = (grid.corner[0] + grid.pitch[0] * i for i in (begin, end))
    y0, y1 = (grid.corner[1] + grid.pitch[1] * i for i in (row, row + 1))
    z = np.full(len(row), LIFT)
    corners = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
    vertices = np.array(corners).transpose(1, 2, 0).reshape(3, -1)
    first = 4 * np.arange(len(row), dtype=np.int32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    faces = (first[:, np.newaxis, np.newaxis] + triangles).reshape(-1, 3).T
    strength = np.repeat(value / LEVELS, 4)
    board = np.array(BOARD_COLOUR)[:, np.newaxis]
    colours = board + strength * (np.array(INK_COLOUR)[:, np.newaxis] - board)
    return vertices, np.ascontiguousarray(faces), colours


def _draw(meshcat: Meshcat, path: str, grid: InkGrid, shade: NDArray[np.intp]) -> None:
    """Put the mesh of some shades at a path, or delete it if nothing is inked."""
    vertices, faces, colours = ink_mesh(grid, shade)
    if faces.shape[1]:
        meshcat.SetTriangleColorMesh(path, vertices, faces, colours)
    else:
        meshcat.Delete(path)
