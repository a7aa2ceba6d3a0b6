"""Facts about how a travelling patch of polygons rubs cells, and wears their ink."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plane_shapes import inside_convex, rectangle

from fmp_drake.systems.ink import rubbing
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.rubbing import (
    LONGEST_STEP,
    STRIPE_PITCH,
    Cells,
    Patch,
    PlanarMotion,
    exposure,
)

GRID = InkGrid(size=(0.4, 0.3), cell=0.005)
CELLS = Cells.of(GRID)
FELT = (0.12, 0.05)
REST = PlanarMotion(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
# So short that the patch stays where it is.
SHORT = 1e-9


def patch_of(*polygons, pressure=1.0, depth=0.0):
    """Make a patch in E; the pressure is a number or a function of the vertices."""
    p = np.concatenate(polygons)
    values = pressure(p) if callable(pressure) else np.full(len(p), pressure)
    starts = np.cumsum([0, *map(len, polygons)])
    return Patch(np.column_stack([p, values]), starts, depth)


def straight(way, *, end=(0.0, 0.0), yaw=0.0, seconds=0.05):
    """Return the eraser before and after a way at a constant velocity."""
    v = np.divide(way, seconds)
    now = REST._replace(x=end[0], y=end[1], yaw=yaw, v_x=v[0], v_y=v[1])
    start = np.subtract(end, way)
    return now._replace(time=1.0 - seconds, x=start[0], y=start[1]), now


def pressed(patch):
    """Return the pressure of a resting patch on all cells."""
    felt = exposure(CELLS, patch, *straight((SHORT, 0.0)), 0.0)
    return felt.ravel() / SHORT


@settings(max_examples=60)
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
    pressure = pressed(patch_of(polygon, pressure=7.0))
    # Centres on an edge may fall on either side by rounding.
    surely = inside_convex(GRID.centres, [x, y] + (1.0 - 1e-6) * (polygon - [x, y]))
    maybe = inside_convex(GRID.centres, [x, y] + (1.0 + 1e-6) * (polygon - [x, y]))
    assert set(np.flatnonzero(surely)) <= set(np.flatnonzero(pressure))
    assert set(np.flatnonzero(pressure)) <= set(np.flatnonzero(maybe))
    np.testing.assert_allclose(pressure[pressure > 0.0], 7.0, rtol=1e-5)


@pytest.mark.parametrize("flip", [False, True])
def test_the_pressure_is_linear_whatever_the_winding(flip):
    polygon = rectangle([0.03, -0.02], FELT, yaw=0.4)
    if flip:
        polygon = polygon[::-1]
    pressure = pressed(
        patch_of(polygon, pressure=lambda p: 1000.0 + p @ [3000.0, -2000.0])
    )
    cells = np.flatnonzero(pressure)
    assert len(cells) > 200
    expected = 1000.0 + GRID.centres[cells] @ [3000.0, -2000.0]
    np.testing.assert_allclose(pressure[cells], expected, atol=0.01)


def test_a_row_of_centres_on_a_shared_edge_counts_once():
    # The edge x = 0.0025 runs through cell centres.
    a, b, c, d = [-0.0225, 0.0], [0.0025, -0.02], [0.0025, 0.03], [0.04, 0.0]
    pressure = pressed(patch_of([a, b, c], [d, c, b]))
    on_edge = np.abs(GRID.centres[:, 0] - 0.0025) < 1e-9
    assert np.count_nonzero(pressure[on_edge]) == 10
    np.testing.assert_allclose(pressure[pressure > 0.0], 1.0, rtol=1e-5)


def test_a_travelling_patch_rubs_by_pressure_times_path():
    # Across its short side: every cell in the middle feels the whole felt.
    patch = patch_of(rectangle([0.0, 0.0], FELT), pressure=1500.0)
    felt = exposure(CELLS, patch, *straight((0.0, 0.1), end=(0.0, 0.05)), 0.0)
    middle = felt[(np.abs(GRID.y) < 0.02), :][:, np.abs(GRID.x) < 0.055]
    np.testing.assert_allclose(middle, 1500.0 * FELT[1], atol=1500.0 * LONGEST_STEP)
    force_times_path = felt.sum() * np.prod(GRID.pitch)
    assert force_times_path == pytest.approx(1500.0 * 0.12 * 0.05 * 0.1, rel=0.01)


def test_a_turning_patch_rubs_its_outside_more_than_its_centre():
    now = REST._replace(yaw=-3.1, yaw_rate=2.0)
    before = now._replace(time=0.8, yaw=now.yaw - 0.4 + 2 * np.pi)
    felt = exposure(CELLS, patch_of(rectangle([0, 0], FELT)), before, now, 0.0)
    r = np.hypot(*GRID.centres.T).reshape(GRID.shape)
    under = r < 0.02
    np.testing.assert_allclose(felt[under], 0.4 * r[under], rtol=1e-9)


def test_path_of_a_patch_is_the_cubic_through_both_ends():
    # A quarter of a circle in one period: the path is longer than the chord.
    w, radius, seconds = 5.0, 0.05, 0.1 * np.pi
    now = REST._replace(x=radius, v_y=radius * w)
    before = now._replace(time=1.0 - seconds, x=0.0, y=-radius, v_x=radius * w, v_y=0.0)
    patch = patch_of(rectangle([0.0, 0.0], (0.03, 0.03)))
    felt = exposure(CELLS, patch, before, now, 0.0)
    length = felt.sum() * np.prod(GRID.pitch) / 0.03**2
    assert length == pytest.approx(0.5 * np.pi * radius, rel=0.02)


def test_a_felt_that_lands_rubs_from_where_it_touches():
    before, now = straight((0.04, 0.0))
    landing = (
        before._replace(depth=-0.001, sinking=0.04),
        now._replace(depth=0.001, sinking=0.04),
    )
    felt = rectangle([0.0, 0.0], FELT)
    steady = exposure(CELLS, patch_of(felt), before, now, 0.0).sum()
    # Half of the way in the air, and half the pressure after it.
    landed = exposure(CELLS, patch_of(felt, depth=0.001), *landing, 0.0).sum()
    assert landed == pytest.approx(0.25 * steady, rel=0.01)


@pytest.mark.parametrize("yaw", [0.0, 0.7])
@pytest.mark.parametrize("worn", [0.3, 1.0])
def test_a_worn_felt_does_not_rub_in_its_stripes(yaw, worn):
    before, now = straight((SHORT, 0.0), yaw=yaw)
    patch = patch_of(rectangle([0.0, 0.0], FELT))
    felt = exposure(CELLS, patch, before, now, worn)
    whole = exposure(CELLS, patch, before, now, 0.0)
    along = (GRID.centres @ [np.cos(yaw), np.sin(yaw)]).reshape(GRID.shape)
    stripe = along / STRIPE_PITCH
    gone = 2.0 * np.abs(stripe - np.rint(stripe)) < worn
    np.testing.assert_array_equal(felt, np.where(gone, 0.0, whole))


def test_patches_off_the_grid_edge_on_or_without_pressure_have_no_exposure():
    edge_on = np.array([[0.0, 0.0], [0.1, 0.0], [0.05, 0.0]])
    for polygon, pressure in (
        (rectangle([0.5, 0.0], FELT), 1.0),
        (edge_on, 1.0),
        (rectangle([0.0, 0.0], FELT), 0.0),
    ):
        assert (pressed(patch_of(polygon, pressure=pressure)) == 0.0).all()


def test_a_patch_over_the_edge_of_the_grid_is_clipped():
    pressure = pressed(patch_of(rectangle([0.2, 0.15], FELT)))
    assert np.count_nonzero(pressure) == 12 * 5


def test_wear_of_ink_follows_its_law():
    felt = np.array([0.0, 10.0, 20.0, 60.0, 60.0])
    initial = np.array([1.0, 1.0, 1.0, 1.0, 0.05])
    ink = initial.copy()
    rubbing.wear(ink, felt)
    np.testing.assert_allclose(ink, initial * np.exp(-felt / 20.0))


def test_one_stroke_at_10_newton_removes_more_than_95_percent():
    pressure = np.array([10.0, 3.0]) / (FELT[0] * FELT[1])
    ink = np.ones(2)
    rubbing.wear(ink, pressure * FELT[1])
    assert 0.005 < ink[0] < 0.05
    assert ink[1] > 0.25


def test_compiled_and_plain_python_agree(monkeypatch):
    polygons = [rectangle([x, 0.02], (0.04, 0.05), yaw=0.2) for x in (-0.04, 0.0)]
    patch = patch_of(
        *polygons, pressure=lambda p: 900.0 + p @ [4000.0, 3000.0], depth=0.001
    )
    before, now = straight((0.006, 0.004), end=(0.0, 0.02), yaw=0.2)
    now = now._replace(yaw_rate=0.5, depth=0.002, sinking=0.001)
    fast = exposure(CELLS, patch, before, now, 0.4)
    for name in ("_cubic", "_plane", "_crossings"):
        monkeypatch.setattr(rubbing, name, getattr(rubbing, name).py_func)
    plain = exposure.py_func(CELLS, patch, before, now, 0.4)
    assert fast.max() > 1.0
    np.testing.assert_allclose(fast, plain, rtol=1e-12, atol=1e-12)
