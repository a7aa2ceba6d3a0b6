"""Grid of ink cells on a whiteboard: geometry, coverage, choice by ink, metrics of cleaning.

B is the board frame: origin at the centre of the wiping surface, x
and y along its edges, z the outward normal.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from fmp_drake.compiled import compiled
from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, Indices, Mask, as_floats, check_number, read_only
from fmp_drake.primitives import PlaybackState, Player
from fmp_drake.primitives.model.region import densified
from fmp_drake.systems.surface.surface import PLANE, Surface

CLEAN_BELOW = 0.1
"""Fraction of ink left below which a cell counts as clean."""

# Cells that touch at an edge or a corner belong to one spot.
_ALL_NEIGHBOURS = np.ones((3, 3))


@dataclass(frozen=True)
class InkGrid:
    """A rectangle of the board, centred on B, divided into ink cells.

    Ink arrays have shape `shape` = (ny, nx), row-major: row j lies at the j-th y
    and column i at the i-th x, both ascending from the corner (-x, -y). Values
    are the fraction of the ink that is left, from 0 to 1. Flat indices run along
    x first.

    Parameters
    ----------
    size : tuple of float
        Edge lengths of the rectangle along B's x and y in metres.
    cell : float
        Desired edge length of a cell in metres. The cells fill the rectangle
        exactly, so `pitch` can differ a little from it.
    curvature : Surface
        Of the board; on a curved one x and y are the coordinates (u, v) along it. A grid
        as wide as the circumference of a cylinder encloses it.

    Raises
    ------
    SystemsError
        If a length is not positive and finite.

    Examples
    --------
    >>> grid = InkGrid(size=(0.4, 0.3), cell=0.01)
    >>> grid.shape
    (30, 40)
    >>> stroke = [[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]
    >>> swept = grid.swept_area(stroke, footprint=(0.05, 0.12))
    >>> round(float(swept.mean()), 2)
    0.26
    """

    size: tuple[float, float] = (0.7, 0.5)
    cell: float = 0.005
    curvature: Surface = PLANE

    def __post_init__(self) -> None:
        """Check the lengths."""
        as_floats(self.size, "InkGrid.size", (2,), error=SystemsError)
        for i, edge in enumerate(self.size):
            check_number(edge, f"InkGrid.size[{i}]", above=0, error=SystemsError)
        check_number(self.cell, "InkGrid.cell", above=0, unit="m", error=SystemsError)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Number of cells (ny, nx)."""
        nx, ny = (max(1, round(edge / self.cell)) for edge in self.size)
        return ny, nx

    @cached_property
    def num_cells(self) -> int:
        """Number of cells, ny nx."""
        return self.shape[0] * self.shape[1]

    @cached_property
    def pitch(self) -> Array:
        """Actual edge lengths of a cell along B's x and y, shape (2,), in metres."""
        return read_only(np.array(self.size) / self.shape[::-1])

    @cached_property
    def corner(self) -> Array:
        """Corner (-x, -y) of the rectangle in B, shape (2,), in metres."""
        return read_only(-0.5 * np.array(self.size))

    @cached_property
    def x(self) -> Array:
        """Cell centres along x of B, shape (nx,), in metres; read-only."""
        index = np.arange(self.shape[1])
        return read_only(self.corner[0] + (index + 0.5) * self.pitch[0])

    @cached_property
    def y(self) -> Array:
        """Cell centres along y of B, shape (ny,), in metres; read-only."""
        index = np.arange(self.shape[0])
        return read_only(self.corner[1] + (index + 0.5) * self.pitch[1])

    @cached_property
    def centres(self) -> Array:
        """Cell centres in B, shape (ny nx, 2), in metres; read-only."""
        x, y = np.meshgrid(self.x, self.y)
        return read_only(np.column_stack([x.ravel(), y.ravel()]))

    def is_wound(self, axis: int) -> bool:
        """Return whether the grid encloses a pipe along x (0) or y (1)."""
        return self.size[axis] > self.curvature.circumference[axis] - self.cell

    def on_all_turns(self, p_BE: Array) -> Array:
        """Return paths (..., T, 3) with copies one revolution around a pipe before and after.

        Where the grid encloses a pipe, they have 3 T points, m; else they are unchanged.
        """
        for axis in (0, 1):
            if self.is_wound(axis):
                length = self.curvature.circumference[axis]
                p_BE = p_BE.copy()
                p_BE[..., axis] -= length * np.round(p_BE[..., axis] / length)
                turn = length * np.eye(3)[axis]
                p_BE = np.concatenate([p_BE - turn, p_BE, p_BE + turn], axis=-2)
        return p_BE

    def cells[T: np.generic](self, name: str, values: NDArray[T]) -> NDArray[T]:
        """Return one value per cell in shape (ny, nx); refuse any other size."""
        if values.size != self.num_cells:
            raise SystemsError(
                f"{name} has {values.size} values, but the grid has {self.num_cells} "
                "cells: give one value per cell."
            )
        return values.reshape(self.shape)

    def full(self) -> Array:
        """Return the ink of a full board, ones of shape (ny, nx)."""
        return np.ones(self.shape)

    def swept_by(
        self, paths: Iterable[ArrayLike], footprint: tuple[float, float]
    ) -> Mask:
        """Return the cells that any of several paths passes over; see `swept_area`."""
        area = np.zeros(self.shape, dtype=bool)
        for p_BE in paths:
            area |= self.swept_area(p_BE, footprint)
        return area

    def swept_area(
        self,
        p_BE: ArrayLike,
        footprint: tuple[float, float],
        *,
        height: float = 1e-3,
    ) -> Mask:
        """Return the cells that an eraser passes over while it is on the board.

        The path is interpolated linearly in steps of half a cell or less; a step
        counts if it is on the board.

        Parameters
        ----------
        p_BE : array_like, shape (num_points, 3)
            Path of the centre of the eraser's face in B, in metres.
        footprint : tuple of float
            Edge lengths of the eraser's face along B's x and y, in metres.
        height : float
            The eraser counts as on the board where z <= height, in metres; pressing
            makes z negative.

        Returns
        -------
        ndarray of bool, shape (ny, nx)
            True where the footprint passes over the centre of the cell.
        """
        path = as_floats(p_BE, "the path", ("num_points", 3), error=SystemsError)
        samples = densified(path, 0.5 * float(self.pitch.min()))
        samples = self.on_all_turns(samples)
        p = samples[samples[:, 2] <= height, :2] - self.corner
        half = 0.5 * np.asarray(footprint) + 1e-9
        first = np.ceil((p - half) / self.pitch - 0.5)
        end = np.floor((p + half) / self.pitch - 0.5) + 1.0
        limit = self.shape[::-1]
        i, j = np.clip(first, 0, limit).astype(np.intp).T
        i_end, j_end = np.clip(end, 0, limit).astype(np.intp).T
        # Number of passes over each cell, as differences along both axes.
        change = np.zeros((self.shape[0] + 1, self.shape[1] + 1), dtype=np.intp)
        np.add.at(change, (j, i), 1)
        np.add.at(change, (j, i_end), -1)
        np.add.at(change, (j_end, i), -1)
        np.add.at(change, (j_end, i_end), 1)
        return np.cumsum(np.cumsum(change, axis=0), axis=1)[:-1, :-1] > 0


def cleaned_fraction(ink: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Return the fraction of the cells to be cleaned that have less than 10 % of their ink.

    Parameters
    ----------
    ink : array_like, shape (ny, nx) or (ny nx,)
        Ink.
    mask : array_like of bool, same size, optional
        The cells to be cleaned; by default all.

    Returns
    -------
    float
        From 0 to 1; 1 if there is nothing to be cleaned.
    """
    clean = np.asarray(ink).ravel() < CLEAN_BELOW
    if mask is not None:
        chosen = as_floats(np.ravel(mask), "the mask", clean.shape, error=SystemsError)
        clean = clean[chosen > 0]
    return float(np.count_nonzero(clean) / clean.size) if clean.size else 1.0


@dataclass(frozen=True, kw_only=True)
class MissedSpots:
    """Remaining spots on an area that should have been cleaned.

    Attributes
    ----------
    cleaned_fraction : float
        Fraction of the area's cells with less than 10 % ink, from 0 to 1.
    count : int
        Number of spots: groups of cells that are not clean and touch one another
        at an edge or a corner. No spot is too small to count.
    area_cm2, largest_cm2 : float
        Area of all spots and of the largest in cm^2.

    Examples
    --------
    >>> from fmp_drake.systems import InkGrid
    >>> from fmp_drake.systems.ink.grid import missed_spots
    >>> grid = InkGrid(size=(0.5, 0.7))
    >>> ink = np.zeros(grid.shape)
    >>> ink[10:14, 20:30] = 1.0
    >>> spots = missed_spots(ink, np.full(grid.shape, True), grid=grid)
    >>> spots.count, spots.area_cm2
    (1, 10.0)
    """

    cleaned_fraction: float
    count: int
    area_cm2: float
    largest_cm2: float


def missed_spots(ink: ArrayLike, mask: ArrayLike, *, grid: InkGrid) -> MissedSpots:
    """Return the number and area of the spots of an area that are not clean.

    Parameters
    ----------
    ink : array_like, shape (ny, nx) or (ny nx,)
        Ink at the end, from 0 to 1.
    mask : array_like of bool, same size
        The area that should be clean.
    grid : InkGrid
        The cells.

    Raises
    ------
    SystemsError
        If an array does not fit the grid.
    """
    values = grid.cells("ink", np.asarray(ink, dtype=float))
    area = grid.cells("mask", np.asarray(mask, dtype=bool))
    labels, _ = ndimage.label(area & (values >= CLEAN_BELOW), structure=_ALL_NEIGHBOURS)
    for axis in (0, 1):
        if grid.is_wound(axis):
            _join_at_seam(np.moveaxis(labels, 1 - axis, 0))
    cells = np.bincount(labels.ravel())[1:]
    cell_cm2 = 1e4 * float(np.prod(grid.pitch))
    return MissedSpots(
        cleaned_fraction=cleaned_fraction(values, area),
        count=int(np.count_nonzero(cells)),
        area_cm2=cell_cm2 * int(cells.sum()),
        largest_cm2=cell_cm2 * int(cells.max(initial=0)),
    )


def _join_at_seam(labels: Indices) -> None:
    """Give spots that touch at the ends of the first axis one label, in place."""
    count = labels.shape[1]
    for i in range(count):
        for j in range(max(i - 1, 0), min(i + 2, count)):
            one, other = labels[0, i], labels[-1, j]
            if one > 0 and other > 0:
                labels[labels == other] = one


def cleaned_history(
    erase_time: ArrayLike,
    mask: ArrayLike,
    times: ArrayLike,
) -> Array:
    """Return the fraction of an area that was clean at given times.

    Parameters
    ----------
    erase_time : array_like, shape (ny, nx) or (ny nx,)
        Time in seconds at which a cell became clean, `inf` for never: the
        output of `EraseTimes` at the end of a run.
    mask : array_like of bool, same size
        The cells to be cleaned.
    times : array_like, shape (num_times,)
        Times in seconds.

    Returns
    -------
    ndarray, shape (num_times,)
        Fraction from 0 to 1, equal to `cleaned_fraction` of the ink at that time; 1
        where there is nothing to be cleaned.
    """
    erased = np.asarray(erase_time, dtype=float).ravel()
    chosen = as_floats(np.ravel(mask), "the mask", erased.shape, error=SystemsError)
    moments = np.sort(erased[chosen > 0])
    if not moments.size:
        return np.ones(np.shape(times))
    clean = np.searchsorted(moments, np.asarray(times, dtype=float), side="right")
    return clean / moments.size


def times_to_clean(times: ArrayLike, cleaned: ArrayLike) -> dict[float, float | None]:
    """Return the first times at which an area was clean to 50, 90 and 99 %.

    Parameters
    ----------
    times : array_like, shape (num_times,)
        Times in seconds, ascending.
    cleaned : array_like, shape (num_times,)
        Cleaned fraction at these times, from 0 to 1.

    Returns
    -------
    dict
        Maps each fraction to the first of the times at which it was reached, or to
        None.

    Raises
    ------
    SystemsError
        If the two arrays differ in length.
    """
    moments = np.asarray(times, dtype=float).ravel()
    what = "the cleaned fractions"
    history = as_floats(np.ravel(cleaned), what, moments.shape, error=SystemsError)
    reached: dict[float, float | None] = {}
    for fraction in (0.5, 0.9, 0.99):
        hits = np.flatnonzero(history >= fraction)
        reached[fraction] = float(moments[hits[0]]) if hits.size else None
    return reached


@dataclass(frozen=True, kw_only=True)
class CoverageChoice:
    """Selects the sample of a skill that would remove the most ink.

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
        there, and the arm is up to 5 mm off its path.
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
    area: Mask | None = None
    position: tuple[int, int, int] = (0, 1, 2)

    def __post_init__(self) -> None:
        """Check the values."""
        what = "the number of candidates"
        check_number(self.candidates, what, least=1, whole=True, error=SystemsError)

    def wiped(self, ink: Array, paths: Array) -> Array:
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
        cells = np.floor((p_BE[..., :2] - self.grid.corner) / pitch)
        return _passed_over(
            ink,
            cells.astype(np.intp, order="C"),
            p_BE[..., 2] <= self.height,
            reach,
        )

    def tracked(
        self, player: Player, state: PlaybackState, ink: Array
    ) -> PlaybackState:
        """Return the state that tracks the best sample; see `Player.track_sample`.

        Parameters
        ----------
        player : Player
        state : PlaybackState
        ink : ndarray, shape (ny, nx)
        """
        return player.track_sample(
            state,
            count=self.candidates,
            score=lambda paths: self.wiped(ink, paths),
            scored=self.position[:2],
        )


@compiled
def _passed_over(
    ink: Array,
    cells: NDArray[np.intp],
    down: Mask,
    reach: NDArray[np.intp],
) -> Array:
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
        for k in range(cells.shape[1]):
            if not down[i, k]:
                continue
            column, row = cells[i, k, 0], cells[i, k, 1]
            for y in range(max(row - reach[1], 0), min(row + reach[1] + 1, len(ink))):
                for x in range(
                    max(column - reach[0], 0), min(column + reach[0] + 1, ink.shape[1])
                ):
                    if last[y, x] != i:
                        last[y, x] = i
                        total[i] += ink[y, x]
    return total
