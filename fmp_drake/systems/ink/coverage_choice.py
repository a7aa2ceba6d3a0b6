"""Which of several movements passes over the most ink."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number
from fmp_drake.primitives import PlaybackState, Player
from fmp_drake.primitives.playback.sampling import track_sample
from fmp_drake.systems.ink.grid import InkGrid


@dataclass(frozen=True, kw_only=True)
class CoverageChoice:
    """Chooses among samples of a skill by the ink that they would wipe.

    Attributes
    ----------
    grid : InkGrid
        The board.
    footprint : tuple of float
        Edges of the eraser along x and y of B, m.
    candidates : int
        How many samples are drawn.
    margin : float
        At each edge of the eraser, m: what only the edge touches is not counted. The
        felt presses less there, and the arm follows its path to 5 mm.
    height : float
        Up to which the eraser counts as on the board, m.
    area : ndarray of bool, shape (ny, nx), optional
        The cells whose ink counts; all where None.

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

    def __post_init__(self) -> None:
        """Check the values."""
        what = "the number of candidates"
        check_number(self.candidates, what, least=1, whole=True, error=SystemsError)

    def wiped(
        self, ink: NDArray[np.float64], paths: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how much ink each path would wipe, in cells.

        Parameters
        ----------
        ink : ndarray, shape (ny, nx)
        paths : ndarray, shape (S, T, 3)
            p_BE, m.

        Returns
        -------
        ndarray, shape (S,)
        """
        ink = np.array(ink) if self.area is None else ink * self.area
        pitch = self.grid.pitch
        half = np.maximum(np.array(self.footprint) / 2 - self.margin, 0.0)
        reach = np.floor(half / pitch + 1e-9).astype(np.intp)
        cells = np.floor((paths[..., :2] - self.grid.corner) / pitch).astype(np.intp)
        return _passed_over(ink, cells, paths[..., 2] <= self.height, reach)

    def tracked(
        self, player: Player, state: PlaybackState, ink: NDArray[np.float64]
    ) -> PlaybackState:
        """Return the state that tracks the sample that wipes most; see `track_sample`.

        Parameters
        ----------
        player : Player
        state : PlaybackState
        ink : ndarray, shape (ny, nx)
        """
        return track_sample(
            player,
            state,
            count=self.candidates,
            worth=lambda paths: self.wiped(ink, paths),
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
        Column and row of the eraser; they may lie beyond the grid.
    down : ndarray, shape (S, T)
        Whether it is on the board.
    reach : ndarray, shape (2,)
        How many columns and rows it reaches to each side.
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
