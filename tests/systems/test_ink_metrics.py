"""Facts about the metrics of cleaning."""

import numpy as np
import pytest

from fmp_drake.errors import SystemsError
from fmp_drake.systems.ink.grid import (
    InkGrid,
    cleaned_fraction,
    cleaned_history,
    missed_spots,
    times_to_clean,
)
from fmp_drake.systems.surface.surface import Surface

GRID = InkGrid(size=(0.10, 0.06), cell=0.01)
EVERYWHERE = np.ones(GRID.shape, dtype=bool)


def test_a_clean_area_has_no_spots():
    spots = missed_spots(np.zeros(GRID.shape), EVERYWHERE, grid=GRID)
    assert (spots.cleaned_fraction, spots.count) == (1.0, 0)
    assert spots.area_cm2 == spots.largest_cm2 == 0.0


def test_spots_are_groups_that_touch_even_at_corners():
    ink = np.zeros(GRID.shape)
    ink[0, 0] = ink[1, 1] = 0.1  # one spot of 2 cells
    ink[4, 4:7] = 0.5  # one of 3 cells
    ink[0, 9] = 0.099  # clean
    spots = missed_spots(ink.ravel(), EVERYWHERE, grid=GRID)
    assert spots.count == 2
    assert spots.area_cm2 == pytest.approx(5.0)
    assert spots.largest_cm2 == pytest.approx(3.0)
    assert spots.cleaned_fraction == 1.0 - 5.0 / 60.0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_spot_across_the_seam_of_a_pipe_is_one(axis):
    curvature = [0.0, 0.0]
    curvature[axis] = 2 * np.pi / (0.10, 0.06)[axis]
    pipe = InkGrid(size=(0.10, 0.06), cell=0.01, curvature=Surface(*curvature))
    for across, along, joined in ((0, 0, True), (1, 2, True), (1, 3, False)):
        ink = np.zeros(GRID.shape)
        view = ink if axis == 1 else ink.T
        view[0, 1] = view[-1, 1 + along - across] = 0.5
        view[2, 4] = 0.5
        spots = missed_spots(ink, EVERYWHERE, grid=pipe)
        assert spots.count == (2 if joined else 3)
        assert spots.largest_cm2 == pytest.approx(2.0 if joined else 1.0)
        assert spots.area_cm2 == pytest.approx(3.0)
        assert missed_spots(ink, EVERYWHERE, grid=GRID).count == 3


def test_only_spots_of_the_area_count():
    mask = EVERYWHERE.copy()
    mask[:, 5] = False
    spots = missed_spots(np.ones(GRID.shape), mask, grid=GRID)
    assert spots.count == 2
    assert spots.area_cm2 == pytest.approx(54.0)
    assert missed_spots(np.ones(60), ~mask & False, grid=GRID).count == 0


def test_the_history_is_the_cleaned_fraction_over_time():
    rng = np.random.default_rng(3)
    erased = np.where(rng.random(60) < 0.8, rng.uniform(0.0, 10.0, 60), np.inf)
    mask = rng.random(60) < 0.7
    times = np.linspace(0.0, 12.0, 25)
    history = cleaned_history(erased, mask, times)
    for t, fraction in zip(times, history, strict=True):
        ink = np.where(erased <= t, 0.05, 1.0)
        assert fraction == cleaned_fraction(ink, mask)
    assert 0.0 == history[0] < history[-1] < 1.0


def test_the_history_of_nothing_is_clean():
    np.testing.assert_array_equal(
        cleaned_history(np.full(60, np.inf), ~EVERYWHERE, [0.0, 1.0]), 1.0
    )


def test_times_to_clean_are_the_first_times_or_none():
    times = np.arange(5.0)
    reached = times_to_clean(times, [0.0, 0.5, 0.49, 0.9, 0.95])
    assert reached == {0.5: 1.0, 0.9: 3.0, 0.99: None}
    assert times_to_clean([], []) == {0.5: None, 0.9: None, 0.99: None}
    assert times_to_clean(times, np.ones(5)) == {0.5: 0.0, 0.9: 0.0, 0.99: 0.0}


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(SystemsError, match="ink has 7 values, but the grid has 60"):
        missed_spots(np.ones(7), EVERYWHERE, grid=GRID)
    with pytest.raises(SystemsError, match="mask has 7 values"):
        missed_spots(np.ones(60), np.ones(7), grid=GRID)
    with pytest.raises(
        SystemsError, match=r"the mask of shape \(7,\); expected \(60,\)"
    ):
        cleaned_history(np.ones(60), np.ones(7), [0.0])
    with pytest.raises(
        SystemsError, match=r"fractions of shape \(3,\); expected \(2,\)"
    ):
        times_to_clean([0.0, 1.0], [0.0, 0.5, 1.0])
