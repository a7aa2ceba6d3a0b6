"""Facts about the choice of the movement that passes over the most ink."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from fmp_drake.errors import SystemsError
from fmp_drake.systems.ink.grid import CoverageChoice, InkGrid

GRID = InkGrid(size=(0.5, 0.7), cell=0.01)
# 11 by 5 cells, and a rim of half a cell that is not wiped.
FOOTPRINT = (0.12, 0.06)
CELLS = 11 * 5


def make_choice(**options):
    fixed = {"grid": GRID, "footprint": FOOTPRINT, "candidates": 4, "margin": 0.005}
    return CoverageChoice(**fixed | options)


def at_cell(column, row, z=0.0):
    """Return the middle of a cell, m; cells beyond the grid are cells, too."""
    return [*(GRID.corner + (np.array([column, row]) + 0.5) * GRID.pitch), z]


def walk(seed, steps=150):
    """Return a path from cell to neighbouring cell, in two directions."""
    rng = np.random.default_rng(seed)
    moves = rng.permutation([[1, 0], [0, 1], [-1, 0], [0, -1]])[:2]
    cells = np.cumsum(moves[rng.integers(0, 2, size=steps)], axis=0)
    cells += rng.integers([0, 0], GRID.shape[::-1])
    return np.array([at_cell(*cell) for cell in cells])


def on_ink(path, ink=None):
    ink = GRID.full() if ink is None else ink
    return float(make_choice().wiped(ink, np.array([path]))[0])


def test_ink_under_the_eraser_is_counted_once():
    here = at_cell(20, 30)
    assert on_ink([here]) == CELLS
    assert on_ink([here, here, here]) == CELLS
    assert on_ink([here, at_cell(21, 30)]) == CELLS + 5
    assert on_ink([here, at_cell(20, 31), here]) == CELLS + 11


def test_only_remaining_ink_counts():
    ink = np.zeros(GRID.shape)
    ink[30, 20], ink[32, 25], ink[33, 20] = 0.5, 0.25, 1.0
    # The last is beyond the eraser, which reaches from row 28 to row 32.
    assert on_ink([at_cell(20, 30)], ink) == 0.75
    assert on_ink([at_cell(20, 31)], ink) == 1.75
    assert on_ink([at_cell(20, 30)], np.zeros(GRID.shape)) == 0


@pytest.mark.parametrize("seed", range(6))
def test_paths_wipe_the_area_swept_on_the_grid(seed):
    ink = np.random.default_rng(100 + seed).uniform(size=GRID.shape)
    paths = np.array([walk(10 * seed + i) for i in range(3)])
    beyond = np.abs(paths[..., :2]) > np.array(GRID.size) / 2
    assert beyond.any()
    inner = tuple(np.array(FOOTPRINT) - 2 * 0.005)
    swept = [ink[GRID.swept_area(path, inner)].sum() for path in paths]
    assert_allclose(make_choice().wiped(ink, paths), swept)


def test_eraser_over_the_edge_wipes_nothing_there():
    columns, rows = GRID.shape[1], GRID.shape[0]
    assert on_ink([at_cell(0, 30)]) == 6 * 5
    assert on_ink([at_cell(columns - 1, 30)]) == 6 * 5
    assert on_ink([at_cell(20, 0)]) == 11 * 3
    assert on_ink([at_cell(columns - 1, rows - 1)]) == 6 * 3
    assert on_ink([at_cell(-5, 30)]) == 5
    assert on_ink([at_cell(-6, 30)]) == 0
    assert on_ink([at_cell(20, rows + 1)]) == 11
    for far in ([5.0, 0.0, 0.0], [0.0, -5.0, 0.0], [-5.0, 5.0, 0.0]):
        assert on_ink([far]) == 0


def test_samples_above_the_height_wipe_nothing():
    here, there = at_cell(20, 30), at_cell(20, 50)
    for z, counted in ((-0.02, 2), (0.0099, 2), (0.0101, 1), (0.3, 1)):
        assert on_ink([here, [*there[:2], z]]) == counted * CELLS
    raised = np.array([[at_cell(20, 30, 0.03)]])
    assert make_choice(height=0.04).wiped(GRID.full(), raised) == CELLS
    assert make_choice(height=0.02).wiped(GRID.full(), raised) == 0


@pytest.mark.parametrize(
    ("margin", "cells"), [(0.004, 11 * 5), (0.012, 9 * 3), (0.025, 7), (1.0, 1)]
)
def test_margin_makes_the_eraser_smaller(margin, cells):
    path = np.array([[at_cell(20, 30)]])
    assert make_choice(margin=margin).wiped(GRID.full(), path) == cells


def test_only_ink_of_the_area_counts():
    area = np.zeros(GRID.shape, dtype=bool)
    area[:, :21] = True
    inside, rim, outside = ([at_cell(c, 30)] for c in (10, 20, 40))
    wiped = make_choice(area=area).wiped(GRID.full(), np.array([inside, rim, outside]))
    assert_array_equal(wiped, [CELLS, 6 * 5, 0])


def test_ink_and_paths_stay_as_they_are():
    ink, paths = GRID.full(), np.array([walk(1), walk(2)])
    before = ink.copy(), paths.copy()
    make_choice(area=ink > 0).wiped(ink, paths)
    assert_array_equal(ink, before[0])
    assert_array_equal(paths, before[1])


@pytest.mark.parametrize("candidates", [0, -1])
def test_a_choice_of_nothing_is_refused(candidates):
    with pytest.raises(SystemsError, match=f"candidates is {candidates}; "):
        make_choice(candidates=candidates)
