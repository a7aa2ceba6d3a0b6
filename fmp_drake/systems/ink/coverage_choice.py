"""Choice among sampled movements by the ink that they remove."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number
from fmp_drake.primitives import PlaybackState, Player
from fmp_drake.systems.ink.grid import InkGrid


@dataclass(frozen=True, kw_only=True)
class CoverageChoice:
    """Selects the sample of a skill that would remove most ink.

    Attributes
    ----------
    grid : InkGrid
        The board.
    footprint : tuple of float
        Edges of the eraser along x and y of B, m.
    candidates : int
        Number of samples that are drawn.
    margin : float
        Width along each edge of the eraser that is not counted, m: the pressure is lower
        there, and the arm follows its path to 5 mm.
    height : float
        Greatest height at which the eraser counts as on the board, m.
    area : ndarray of bool, shape (ny, nx), optional
        The cells whose ink counts; all where None.
    position : tuple of 3 ints
        Indices of x, y and z among the channels of the skill.

    Examples
    --------
    The left half of a board is clean: the stroke on the right wipes more.

    >>> grid = InkGrid(size=(0.4, 0.3), cell=0.01)
    >>> ink = grid.full()
    >>> ink[:, :20] = 0.0
    >>> strokes = np.array([[[x, -0.1, 0.0], [x, 0.1, 0.0]] for x in (-0.1, 0.1)])
    >>> choice = CoverageChoice(grid=grid, footprint=(0.05, 0.05), candidates=2)
    >>> choice.wiped(ink, strokes)
    array([ 0., 18.])
    """

    grid: InkGrid
    footprint: tuple[float, float]
    candidates: int
    margin: float = 0.01
    height: float = 0.01
    area: NDArray[np.bool_] | None = None
    position: tuple[int, int, int] = (0, 1, 2)

    def __post_init__(self) -> None:
        """Check the values."""
        what = "the number of candidates"
        check_number(self.candidates, what, least=1, whole=True, error=SystemsError)

    def wiped(
        self, ink: NDArray[np.float64], paths: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the ink that each path would remove, in cells.

        Parameters
        ----------
        ink : ndarray, shape (ny, nx)
        paths : ndarray, shape (S, T, D)
            Channels of a skill, of which `position` are p_BE, m.

        Returns
        -------
        ndarray, shape (S,)
        """
        ink = np.array(ink) if self.area is None else ink * self.area
        pitch = self.grid.pitch
        half = np.maximum(np.array(self.footprint) / 2 - self.margin, 0.0)
        reach = np.floor(half / pitch + 1e-9).astype(np.intp)
        p_BE = self.grid.on_all_turns(paths[..., list(self.position)])
        cells = np.floor((p_BE[..., :2] - self.grid.corner) / pitch).astype(np.intp)
        return _passed_over(ink, cells, p_BE[..., 2] <= self.height, reach)

    def tracked(
        self, player: Player, state: PlaybackState, ink: NDArray[np.float64]
    ) -> PlaybackState:
        """Return the state that tracks the best sample; see `Player.track_sample`.

        Parameters
        ----------
        player : Player
        state : PlaybackState
        ink : ndarray, shape (ny, nx)
        """
        return player.track_sample(
            state, count=self.candidates, score=lambda paths: self.wiped(ink, paths)
        )


@compiled
def _passed_over(
    ink: NDArray[np.float64],
    cells: NDArray[np.intp],
    down: NDArray[np.bool_],
    reach: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Return the ink under each path, every cell counted once.

    Parameters
    ----------
    ink : ndarray, shape (ny, nx)
    cells : ndarray, shape (S, T, 2)
        Column and row of the eraser, which may be outside the grid.
    down : ndarray, shape (S, T)
        Whether it is on the board.
    reach : ndarray, shape (2,)
        Columns and rows that it covers to each side of its middle.
    """
    total = np.zeros(len(cells))
    last = np.full(ink.shape, -1)  # The last path that a cell was counted for.
    for i in range(len(cells)):
        for k in np.flatnonzero(down[i]):
            column, row = cells[i, k]
            for y in range(max(row - reach[1], 0), min(row + reach[1] + 1, len(ink))):
                for x in range(
                    max(column - reach[0], 0), min(column + reach[0] + 1, ink.shape[1])
                ):
                    if last[y, x] != i:
                        last[y, x] = i
                        total[i] += ink[y, x]
    return total
