"""The ink of a whiteboard in Meshcat while it is simulated."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import (
    Context,
    DiscreteValues,
    LeafSystem,
)

from fmp_drake.numeric import Mask
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import ShadeArray, corner_shades, draw_ink, ink_mesh
from fmp_drake.systems.interface.callbacks import declare_cache, eval_cache

TILE = 32
"""Edge of a tile in cells; only tiles whose shades change are drawn again."""

# Time between two pictures, s.
_PERIOD = 0.128


class InkVisualizer(LeafSystem):
    """Draw the ink of a whiteboard in Meshcat where its shades change.

    .. code-block:: none

        ink -> InkVisualizer

    Input ports:

    - `ink`, size ny nx: fraction of the ink left in each cell, row-major.

    The shades of the last picture are discrete state. The ink is drawn at Meshcat's path
    `path`, whose transform the caller sets to X_WB. This system and `AddInkToRecording` own
    `path`/live and `path`/recorded and change nothing else. An initialisation deletes both
    and draws the ink again without a change of the state.

    Parameters
    ----------
    meshcat : Meshcat
        Where to draw.
    grid : InkGrid
        Division of the surface into cells.
    path : str
        Meshcat path that the caller has put at the board frame B.

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> from fmp_drake.systems import InkGrid
    >>> grid, meshcat = InkGrid(size=(0.5, 0.7)), Meshcat()
    >>> visualizer = InkVisualizer(meshcat=meshcat, grid=grid, path="board/ink")
    >>> context = visualizer.CreateDefaultContext()
    >>> _ = visualizer.get_input_port().FixValue(context, grid.full().ravel())
    >>> visualizer.ForcedPublish(context)
    >>> meshcat.HasPath("board/ink")
    True
    """

    def __init__(
        self,
        *,
        meshcat: Meshcat,
        grid: InkGrid,
        path: str = "ink",
    ) -> None:
        """Declare the port, the state and the events."""
        super().__init__()
        self.set_name("ink_visualizer")
        self._meshcat = meshcat
        self._grid = grid
        self._path = path
        self._ink = self.DeclareVectorInputPort("ink", grid.num_cells)
        self._shades = declare_cache(
            self,
            "shades at the corners of the cells",
            self._calc_shades,
            {self._ink.ticket()},
        )
        ny, nx = grid.shape
        self._drawn_index = int(self.DeclareDiscreteState((ny + 1) * (nx + 1)))
        # A publish event may not write state, so there is an update beside it. At the same
        # time the publish event comes first, and both see the same input.
        self.DeclareInitializationPublishEvent(self._redraw)
        self.DeclareForcedPublishEvent(self._redraw)
        self.DeclarePeriodicPublishEvent(_PERIOD, 0.0, self._draw_changes)
        self.DeclarePeriodicDiscreteUpdateEvent(_PERIOD, 0.0, self._remember)

    def _calc_shades(self, context: Any, value: Any) -> None:
        ink: Any = self._ink.Eval(context)
        value.set_value(corner_shades(ink.reshape(self._grid.shape)))

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        shades: Any = eval_cache(self, self._shades, context)
        values.get_mutable_value(self._drawn_index)[:] = shades.ravel()

    def _redraw(self, context: Context) -> None:
        for name in ("live", "recorded"):
            self._meshcat.Delete(f"{self._path}/{name}")
        shades: Any = eval_cache(self, self._shades, context)
        self._draw(shades, np.ones(shades.shape, dtype=bool))

    def _draw_changes(self, context: Context) -> None:
        shades: Any = eval_cache(self, self._shades, context)
        drawn = context.get_discrete_state(self._drawn_index).value()
        self._draw(shades, shades != drawn.reshape(shades.shape))

    def _draw(self, shades: ShadeArray, changed: Mask) -> None:
        """Draw the tiles that have a changed corner."""
        for row, column in _tiles(changed):
            part = shades[row : row + TILE + 1, column : column + TILE + 1]
            mesh = ink_mesh(self._grid, part, origin=(row, column))
            draw_ink(self._meshcat, f"{self._path}/live/tile_{row}_{column}", mesh)


def _tiles(changed: Mask) -> Iterator[tuple[int, int]]:
    """Yield the first cell of each tile that has a changed corner."""
    rows, columns = (range(0, n - 1, TILE) for n in changed.shape)
    # A corner between two tiles belongs to both.
    by_row = np.array([changed[row : row + TILE + 1].any(axis=0) for row in rows])
    for row, line in zip(rows, by_row, strict=True):
        for column in columns:
            if line[column : column + TILE + 1].any():
                yield row, column
