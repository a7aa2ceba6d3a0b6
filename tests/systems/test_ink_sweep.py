"""Facts about the pressure that a travelling patch of polygons brings on cells."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plane_shapes import inside_convex, rectangle

from fmp_drake.errors import StationError
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.sweep import sweep

GRID = InkGrid(size=(0.4, 0.3), cell=0.005)
FELT = (0.12, 0.05)


def swept(p_BV, pressure, polygon=None, **options):
    """Return the pressure on all cells."""
    polygon = np.zeros(len(p_BV)) if polygon is None else polygon
    rows, columns, part = sweep(GRID, p_BV, pressure, polygon, **options)
    pressure = np.zeros(GRID.shape)
    pressure[rows, columns] = part
    return pressure.ravel()


def test_it_imports_without_drake():
    code = (
        "import sys, fmp_drake.systems.ink.sweep; assert 'pydrake' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@settings(deadline=None, max_examples=60)
@given(
    x=st.floats(-0.25, 0.25),
    y=st.floats(-0.2, 0.2),
    yaw=st.floats(-4.0, 4.0),
    n=st.integers(3, 8),
    radius=st.floats(0.003, 0.1),
)
def test_a_resting_polygon_presses_the_centres_inside_it(x, y, yaw, n, radius):
    angle = yaw + 2.0 * np.pi * np.arange(n) / n
    polygon = [x, y] + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    pressure = swept(polygon, np.full(n, 7.0))
    # Centres on an edge may fall on either side by rounding.
    surely = inside_convex(GRID.centres, [x, y] + (1.0 - 1e-6) * (polygon - [x, y]))
    maybe = inside_convex(GRID.centres, [x, y] + (1.0 + 1e-6) * (polygon - [x, y]))
    assert set(np.flatnonzero(surely)) <= set(np.flatnonzero(pressure))
    assert set(np.flatnonzero(pressure)) <= set(np.flatnonzero(maybe))
    np.testing.assert_allclose(pressure[pressure > 0.0], 7.0)


@pytest.mark.parametrize("flip", [False, True])
def test_the_pressure_is_linear_whatever_the_winding(flip):
    polygon = rectangle([0.03, -0.02], FELT, yaw=0.4)
    if flip:
        polygon = polygon[::-1]
    pressure = swept(polygon, 1000.0 + polygon @ [3000.0, -2000.0])
    cells = np.flatnonzero(pressure)
    assert len(cells) > 200
    expected = 1000.0 + GRID.centres[cells] @ [3000.0, -2000.0]
    np.testing.assert_allclose(pressure[cells], expected, atol=0.01)


def test_a_row_of_centres_on_a_shared_edge_counts_once():
    # The edge x = 0.0025 runs through cell centres.
    a, b, c, d = [-0.0225, 0.0], [0.0025, -0.02], [0.0025, 0.03], [0.04, 0.0]
    pressure = swept([a, b, c, d, c, b], np.ones(6), [0, 0, 0, 1, 1, 1])
    on_edge = np.abs(GRID.centres[:, 0] - 0.0025) < 1e-9
    assert np.count_nonzero(pressure[on_edge]) == 10
    np.testing.assert_allclose(pressure[pressure > 0.0], 1.0)


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    dx=st.floats(-0.03, 0.03),
    dy=st.floats(-0.03, 0.03),
    places=st.integers(1, 6),
)
def test_a_travelling_patch_is_the_mean_of_resting_ones(seed, dx, dy, places):
    rng = np.random.default_rng(seed)
    # A fan of triangles around a point, with a pressure of its own at each vertex.
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 6))
    rim = rng.uniform(-0.1, 0.1, 2) + 0.06 * np.column_stack(
        [np.cos(angle), np.sin(angle)]
    )
    middle, p, top = rim.mean(axis=0), rng.uniform(1.0, 900.0, 6), 1000.0
    vertices, pressure = [], []
    for i in range(6):
        j = (i + 1) % 6
        vertices += [middle, rim[i], rim[j]]
        pressure += [top, p[i], p[j]]
    polygon = np.repeat(np.arange(6), 3)
    offsets = np.outer(np.linspace(0.0, 1.0, places), [dx, dy])
    moving = swept(vertices, pressure, polygon, offsets=offsets)
    resting = [swept(vertices + shift, pressure, polygon) for shift in offsets]
    # Rounding may put a centre on the other side of an edge.
    different = np.abs(moving - np.mean(resting, axis=0)) > 1e-6
    assert np.count_nonzero(different) <= 2


def test_the_sum_over_the_cells_is_the_force():
    polygon = rectangle([0.01, 0.02], FELT, yaw=0.3)
    offsets = np.outer(np.linspace(-1.0, 1.0, 9), [0.03, 0.02])
    force = swept(polygon, np.full(4, 10.0 / 0.006), offsets=offsets).sum() * 25e-6
    assert force == pytest.approx(10.0, rel=0.01)


def test_off_the_grid_edge_on_or_without_pressure_nothing_is_pressed():
    edge_on = np.array([[0.0, 0.0], [0.1, 0.0], [0.05, 0.0]])
    for polygon, pressure in (
        (rectangle([0.5, 0.0], FELT), 1.0),
        (edge_on, 1.0),
        (rectangle([0.0, 0.0], FELT), 0.0),
        (np.zeros((0, 2)), 1.0),
    ):
        assert (swept(polygon, np.full(len(polygon), pressure)) == 0.0).all()


def test_a_patch_over_the_edge_of_the_grid_is_clipped():
    pressure = swept(rectangle([0.2, 0.15], FELT), np.ones(4))
    assert np.count_nonzero(pressure) == 12 * 5


def test_arrays_that_do_not_match_are_refused():
    felt = rectangle([0, 0], FELT)
    with pytest.raises(StationError, match=r"3 pressures and 4 numbers.* 4 vertices"):
        sweep(GRID, felt, np.ones(3), np.zeros(4))
    with pytest.raises(StationError, match=r"4 pressures and 2 numbers.* 4 vertices"):
        sweep(GRID, felt, np.ones(4), np.zeros(2))
