"""Facts about the geometry and the coverage of ink cells."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmp_drake.errors import SystemsError
from fmp_drake.systems.ink.grid import (
    CoverageChoice,
    InkGrid,
    cleaned_fraction,
)
from fmp_drake.systems.surface.surface import Surface

GRID = InkGrid(size=(0.4, 0.3), cell=0.005)
FELT = (0.12, 0.05)


def test_cells_run_along_x_first_and_fill_the_rectangle():
    assert GRID.shape == (60, 80)
    assert GRID.num_cells == 4800
    centres = GRID.centres.reshape(*GRID.shape, 2)
    np.testing.assert_allclose(centres[0, 0], [-0.1975, -0.1475])
    np.testing.assert_allclose(centres[0, 1], [-0.1925, -0.1475])
    np.testing.assert_allclose(centres[-1, -1], [0.1975, 0.1475])
    np.testing.assert_allclose(GRID.centres.mean(axis=0), 0.0, atol=1e-12)
    assert GRID.full().shape == GRID.shape
    assert (GRID.full() == 1.0).all()


def test_pitch_adapts_so_that_the_cells_fill_the_rectangle():
    grid = InkGrid(size=(0.1, 0.052), cell=0.03)
    assert grid.shape == (2, 3)
    np.testing.assert_allclose(grid.pitch, [0.1 / 3, 0.026])


def test_board_smaller_than_half_a_cell_is_one_cell():
    grid = InkGrid(size=(0.1, 0.004), cell=0.01)
    assert grid.shape == (1, 10)
    np.testing.assert_allclose(grid.pitch, [0.01, 0.004])
    # The path is sampled by the shorter edge: a step of the longer one would pass by.
    path = np.array([[0.0, -0.0075, 0.0], [0.0, 0.0075, 0.0]])
    assert grid.swept_area(path, (0.02, 0.0045)).any()


def test_centre_on_the_edge_of_the_footprint_counts():
    swept = GRID.swept_area([[-0.1025, 0.0, 0.0], [-0.1025, 0.0, 0.0]], FELT)
    assert np.count_nonzero(swept.any(axis=0)) == 25
    assert np.count_nonzero(swept.any(axis=1)) == 10


def test_grid_is_an_immutable_value():
    assert InkGrid(size=(0.4, 0.3)) == GRID
    with pytest.raises(AttributeError):
        GRID.cell = 0.01
    for array in (GRID.centres, GRID.pitch, GRID.corner):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("size", "cell", "what"),
    [
        ((0.0, 0.3), 0.005, r"size\[0\] is 0\.0"),
        ((0.4, np.nan), 0.005, r"size\[1\] is nan"),
        ((0.4, 0.3), -1.0, r"cell is -1\.0"),
        ((0.4,), 0.005, r"shape \(1,\); expected \(2,\)"),
    ],
)
def test_grid_refuses_lengths_that_are_not_positive(size, cell, what):
    with pytest.raises(SystemsError, match=what):
        InkGrid(size=size, cell=cell)


@pytest.mark.parametrize("num_points", [2, 11, 400])
def test_swept_area_of_a_straight_stroke_is_a_rectangle(num_points):
    path = np.linspace([-0.101, -0.07, -0.002], [-0.101, 0.08, -0.002], num_points)
    swept = GRID.swept_area(path, FELT)
    x, y = GRID.centres.reshape(*GRID.shape, 2).transpose(2, 0, 1)
    expected = (np.abs(x + 0.101) <= 0.06) & (y >= -0.095 - 1e-9) & (y <= 0.105 + 1e-9)
    np.testing.assert_array_equal(swept, expected)


@settings(deadline=None, max_examples=25)
@given(x=st.floats(-0.25, 0.25), y=st.floats(-0.2, 0.2))
def test_swept_area_is_close_to_a_brute_force_sweep(x, y):
    path = np.array([[-0.05, 0.02, 0.0], [x, y, 0.0]])
    swept = GRID.swept_area(path, FELT).ravel()
    dense, grown = np.zeros((2, GRID.num_cells), dtype=bool)
    for t in np.linspace(0.0, 1.0, 200):
        away = np.abs(GRID.centres - path[0, :2] - t * (path[1] - path[0])[:2])
        dense |= np.all(away <= np.array(FELT) / 2, axis=1)
        grown |= np.all(away <= np.array(FELT) / 2 + 0.0025, axis=1)
    assert not (swept & ~grown).any()
    assert (dense & ~swept).sum() <= 0.02 * dense.sum()


def test_swept_area_of_a_path_beside_the_board_is_empty():
    assert not GRID.swept_area([[3.0, 0.0, 0.0], [3.0, 3.0, 0.0]], FELT).any()


def test_swept_area_counts_only_while_the_eraser_is_down():
    down = [[-0.1, 0.0, -0.001], [0.0, 0.0, -0.001]]
    path = np.array([*down, [0.0, 0.0, 0.05], [0.12, 0.1, 0.05]])
    np.testing.assert_array_equal(
        GRID.swept_area(path, FELT), GRID.swept_area(np.array(down), FELT)
    )
    lifted = path + np.array([0.0, 0.0, 0.1])
    assert not GRID.swept_area(lifted, FELT).any()
    assert GRID.swept_area(lifted, FELT, height=0.2).any()


def test_swept_area_of_a_path_that_is_repeated_is_the_same():
    t = np.linspace(0.0, 20.0 * np.pi, 20_001)
    path = np.column_stack([0.1 * np.cos(t), 0.08 * np.sin(t), np.zeros_like(t)])
    once = GRID.swept_area(path[:2001], FELT)
    np.testing.assert_array_equal(GRID.swept_area(path, FELT), once)


@pytest.mark.parametrize("shape", [(0, 3), (3,), (5, 2)])
def test_swept_area_refuses_a_path_of_another_shape(shape):
    with pytest.raises(SystemsError, match=r"expected \(num_points, 3\)"):
        GRID.swept_area(np.zeros(shape), FELT)


def test_cleaned_fraction_counts_cells_below_a_tenth():
    ink = np.array([[0.0, 0.099, 0.1, 1.0]])
    assert cleaned_fraction(ink) == 0.5
    assert cleaned_fraction(ink.ravel(), [[True, False, True, True]]) == 1 / 3
    assert cleaned_fraction(ink, np.zeros(4, dtype=bool)) == 1.0
    with pytest.raises(SystemsError, match=r"shape \(3,\); expected \(4,\)"):
        cleaned_fraction(ink, [True] * 3)


@pytest.mark.parametrize("axis", [0, 1])
def test_grid_round_a_pipe_is_swept_on_both_sides_of_its_seam(axis):
    pipe = Surface(*np.roll([10.0, 0.0], axis))
    edge = 2 * np.pi * 0.1
    size, felt = (tuple(np.roll(pair, axis)) for pair in ([edge, 0.3], [0.02, 0.05]))
    grid = InkGrid(size=size, cell=0.01, curvature=pipe)
    path = np.zeros((2, 3))
    path[:, axis] = [edge / 2 - 0.02, edge / 2 + 0.02]
    rows = grid.swept_area(path, felt).any(axis=axis)
    expected = np.abs((grid.x, grid.y)[axis]) > edge / 2 - 0.03
    assert np.array_equal(rows, expected)
    # The second turn is the first.
    path[:, axis] -= edge
    assert np.array_equal(grid.swept_area(path, felt).any(axis=axis), expected)
    choice = CoverageChoice(grid=grid, footprint=felt, candidates=1, margin=0)
    assert choice.wiped(grid.full(), path[None])[0] > 0
    flat = InkGrid(size=size, cell=0.01)
    path[:, axis] += edge
    assert not flat.swept_area(path, felt).any(axis=axis)[0]
