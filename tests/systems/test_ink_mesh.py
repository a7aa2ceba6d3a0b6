"""Facts about the triangles that show ink."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import Meshcat

from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import (
    LEVELS,
    LIFT,
    corner_shades,
    draw_ink,
    ink_colours,
    ink_mesh,
)

GRID = InkGrid(size=(0.08, 0.06), cell=0.01)


def at_centre(vertices, colours, p):
    """Return the red that rectangles show at a point, each if they cover it."""
    seen = []
    for i in range(0, vertices.shape[1], 4):
        low, high = vertices[:2, i], vertices[:2, i + 2]
        if (p >= low).all() and (p <= high).all():
            u, v = (p - low) / (high - low)
            a, b, c, d = colours[0, i : i + 4]
            # The triangles 0 1 2 and 0 2 3 of a unit square.
            seen.append(
                a + u * (b - a) + v * (c - b)
                if u >= v
                else a + v * (d - a) + u * (c - d)
            )
    return seen


def test_corners_are_means_of_the_cells_around_them():
    ink = np.zeros((2, 3))
    ink[0, 0] = 1.0
    expected = np.array([[12, 6, 0, 0], [6, 3, 0, 0], [0, 0, 0, 0]])
    np.testing.assert_array_equal(corner_shades(ink), expected)
    np.testing.assert_array_equal(corner_shades(np.ones((2, 3))), LEVELS)


def test_a_clean_board_has_no_mesh():
    vertices, faces, colours = ink_mesh(GRID, corner_shades(np.zeros(GRID.shape)))
    assert vertices.shape == colours.shape == (3, 0)
    assert faces.shape == (3, 0)
    meshcat = Meshcat()
    assert draw_ink(meshcat, "ink", ink_mesh(GRID, corner_shades(GRID.full())))
    assert meshcat.HasPath("ink")
    assert not draw_ink(meshcat, "ink", (vertices, faces, colours))
    assert not meshcat.HasPath("ink")


def test_neighbours_of_one_shade_share_a_rectangle():
    vertices, _, _ = ink_mesh(GRID, corner_shades(GRID.full()))
    assert vertices.shape == (3, 4 * GRID.shape[0])


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10**6), ink=st.sampled_from([0.1, 0.5, 0.9]))
def test_the_mesh_covers_inked_cells_once_in_the_shades_of_their_corners(seed, ink):
    rng = np.random.default_rng(seed)
    values = np.where(
        rng.random(GRID.shape) < ink, rng.integers(0, 3, GRID.shape) / 2, 0
    )
    corners = corner_shades(values)
    vertices, faces, colours = ink_mesh(GRID, corners)
    assert (vertices[2] == LIFT).all()
    a, b, c = (vertices[:, i] for i in faces)
    normal = np.cross(b - a, c - a, axis=0)
    assert (normal[2] > 0.0).all()
    around = np.array(
        [corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]]
    )
    inked = around.any(axis=0)
    area = 0.5 * normal[2].sum()
    expected_area = np.count_nonzero(inked) * GRID.pitch.prod()
    assert expected_area <= area + 1e-12 <= 1.021 * expected_area + 2e-12
    # At the middle of a cell both triangles show the mean of the corners 0 and 2.
    expected = ink_colours(0.5 * (around[0] / LEVELS + around[2] / LEVELS))[..., 0]
    centres = GRID.centres.reshape(*GRID.shape, 2)
    for cell in np.ndindex(GRID.shape):
        seen = at_centre(vertices, colours, centres[cell])
        assert len(seen) == int(inked[cell])
        if seen:
            assert seen[0] == pytest.approx(expected[cell], abs=0.01)


def test_rows_overlap_a_little_so_that_no_board_shines_through():
    vertices, _, _ = ink_mesh(GRID, corner_shades(GRID.full()))
    low, high = vertices[1, 0::4], vertices[1, 2::4]
    gaps = low[1:] - high[:-1]
    assert (gaps < 0.0).all()
    assert (gaps > -0.05 * GRID.pitch[1]).all()


def test_parts_make_up_the_whole():
    rng = np.random.default_rng(2)
    corners = corner_shades(rng.random(GRID.shape))
    whole = ink_mesh(GRID, corners)[0]
    part = ink_mesh(GRID, corners[2:5, 3:7], origin=(2, 3))[0]
    assert part.shape[1] == 4 * 6
    rest = {tuple(p) for p in whole.T}
    assert {tuple(p) for p in part.T} <= rest


def test_layers_of_cells_tile_the_ink():
    rng = np.random.default_rng(4)
    corners = corner_shades(GRID.full())
    first = rng.random(GRID.shape) < 0.5
    area = 0.0
    for cells in (first, ~first):
        vertices, _, _ = ink_mesh(GRID, corners, cells=cells, lift=0.002)
        assert (vertices[2] == 0.002).all()
        size = vertices[:2, 2::4] - vertices[:2, 0::4]
        area += size.prod(axis=0).sum()
    assert area == pytest.approx(0.08 * 0.06, rel=0.021)
