"""Facts about heatmaps, divergences and distances of section V."""

import numpy as np
import pytest

from fmp_drake.experiments.comparison import heatmap, kl_divergence

EXTENT = [[0.0, 1.0], [0.0, 2.0]]


def test_heatmap_counts_each_sample_in_its_cell():
    points = np.array(
        [[0.1, 0.1, 9.0], [0.9, 1.9, 9.0], [0.9, 1.8, 9.0], [0.1, 1.1, 9.0]]
    )
    expected = [[0.25, 0.25], [0.0, 0.5]]
    np.testing.assert_array_equal(heatmap(points, bins=2, extent=EXTENT), expected)


def test_heatmap_counts_samples_outside_in_the_nearest_cell():
    out = heatmap([[-5.0, 0.1], [5.0, 9.0]], bins=2, extent=EXTENT)
    np.testing.assert_array_equal(out, [[0.5, 0.0], [0.0, 0.5]])


def test_heatmap_takes_the_first_channels_of_many_trajectories():
    values = np.random.default_rng(0).random((3, 5, 4))
    same = heatmap(values[..., :2].reshape(-1, 2), bins=4, extent=EXTENT)
    np.testing.assert_array_equal(heatmap(values, bins=4, extent=EXTENT), same)
    assert same.sum() == pytest.approx(1)


def test_divergence_is_the_papers_formula():
    p, q = np.array([0.5, 0.3, 0.2]), np.array([0.2, 0.2, 0.6])
    expected = sum(a * np.log(a / b) for a, b in zip(p, q, strict=True))
    assert kl_divergence(p, q, floor=1e-12) == pytest.approx(expected, rel=1e-9)
    assert kl_divergence(p, p, floor=1e-6) == 0
    assert kl_divergence(p, q, floor=1e-6) != kl_divergence(q, p, floor=1e-6)


def test_empty_cells_cost_the_logarithm_of_the_floor():
    p, q = np.array([0.5, 0.5]), np.array([1.0, 0.0])
    nearer, farther = (kl_divergence(p, q, floor=f) for f in (1e-3, 1e-6))
    assert farther - nearer == pytest.approx(0.5 * np.log(1e3), rel=0.01)
