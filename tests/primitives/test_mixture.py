"""Facts about the mixture of the weights (9)."""

import dense_paper
import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.errors import SkillError
from fmp_drake.primitives import FourierBasis
from fmp_drake.primitives.mixture import fit_mixture, log_densities

OPTIONS = {
    "n_components": 1,
    "explained_variance": 1.0,
    "regularization": 1e-3,
    "seed": 0,
}


def dense(g):
    return (g.basis * g.variances) @ g.basis.T + g.noise * np.eye(g.dim)


def clusters(n=10, each=40, centres=3, seed=0):
    rng = np.random.default_rng(seed)
    spread = rng.standard_normal((n, 4)) * 0.1
    return np.concatenate(
        [
            rng.standard_normal(n) * 3
            + rng.standard_normal((each * (i + 1), 4)) @ spread.T
            for i in range(centres)
        ]
    )


@pytest.mark.parametrize("count", [5, 12, 60])
def test_one_component_is_the_sample_mean_and_covariance(count):
    w = np.random.default_rng(0).standard_normal((count, 12)) @ np.diag(np.arange(12.0))
    pi, (g,) = fit_mixture(w, **OPTIONS)
    assert_allclose(pi, [1.0])
    assert_allclose(g.mean, w.mean(axis=0), atol=1e-12)
    expected = np.cov(w.T, bias=True) + 1e-3 * np.eye(12)
    assert_allclose(dense(g), expected, atol=2e-8)


def test_one_component_is_the_dense_fit_of_the_papers_weights():
    t, noise = 12, 1e-3
    y = np.random.default_rng(0).standard_normal((9, t, 2))
    basis = FourierBasis(t)
    _, (g,) = fit_mixture(basis.analyze(y), **OPTIONS)
    mu, sigma = dense_paper.gaussian_of(
        basis.synthesize(g.mean), basis.synthesize(g.basis.T), g.variances, g.noise
    )
    paper = np.array([dense_paper.weights_of(window) for window in y])
    assert_allclose(mu, paper.mean(axis=0), atol=1e-11)
    expected = np.cov(paper.T, bias=True) + t * noise * np.eye(4 * t)
    assert_allclose(sigma, expected, atol=1e-6)


def test_directions_left_out_become_isotropic_variance():
    rng = np.random.default_rng(0)
    w = rng.standard_normal((200, 10)) * ([10.0, 5.0] + [0.1] * 8)
    _, (g,) = fit_mixture(w, **{**OPTIONS, "explained_variance": 0.99})
    assert g.rank == 2
    values, vectors = np.linalg.eigh(np.cov(w.T, bias=True))
    noise = 1e-3 + values[:-2].mean()
    assert g.noise == pytest.approx(noise)
    # It is added in all directions, so that a component stays low-rank plus isotropic.
    kept = (vectors[:, -2:] * values[-2:]) @ vectors[:, -2:].T
    assert_allclose(dense(g), kept + noise * np.eye(10), atol=1e-6)


def test_separate_clusters_become_components_sorted_by_proportion():
    w = clusters()
    pi, components = fit_mixture(w, **{**OPTIONS, "n_components": 3})
    assert_allclose(pi, [3 / 6, 2 / 6, 1 / 6], atol=1e-6)
    for g, part in zip(components, (w[120:], w[40:120], w[:40]), strict=True):
        assert_allclose(g.mean, part.mean(axis=0), atol=1e-6)


def test_fit_repeats_with_the_seed():
    w = np.random.default_rng(0).standard_normal((60, 12))
    options = {**OPTIONS, "n_components": 4}
    (pi, one), (_, two) = fit_mixture(w, **options), fit_mixture(w, **options)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.mean, b.mean)
        assert np.array_equal(a.basis, b.basis)
    assert pi.sum() == pytest.approx(1)


@pytest.mark.parametrize(("windows", "expected"), [(2, 1), (3, 1), (5, 2), (40, 10)])
def test_at_most_half_as_many_components_as_windows(windows, expected):
    w = np.random.default_rng(0).standard_normal((windows, 12))
    pi, components = fit_mixture(w, **{**OPTIONS, "n_components": 10})
    assert len(pi) == len(components) == expected


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_identical_windows_leave_only_the_regulariser(value):
    pi, components = fit_mixture(
        np.full((6, 12), value), **{**OPTIONS, "n_components": 3}
    )
    assert pi.sum() == pytest.approx(1)
    for g in components:
        assert_allclose(g.mean, value, atol=1e-12)
        assert_allclose(dense(g), 1e-3 * np.eye(12), atol=1e-12)


def test_log_density_is_that_of_9_up_to_the_change_of_weights(
    small_skill, paper_mixture
):
    skill = small_skill
    t, n = skill.n_steps, skill.components_[0].dim
    noise = skill.components_[0].noise
    mixture = paper_mixture(skill)
    y = skill.sample(5, seed=2)
    ours = log_densities(skill.basis.analyze(y), skill.proportions_, skill.components_)
    # The paper's weights: n directions longer by sqrt(T), and n more that are zero
    # and have the variance T * noise of the regulariser.
    constant = 0.5 * n * (np.log(t) + np.log(2 * np.pi * t * noise))
    for window, value in zip(y, ours, strict=True):
        w = dense_paper.weights_of(window)
        theirs = dense_paper.mixture_log_density(w, *mixture)
        assert value == pytest.approx(theirs + constant, rel=1e-7)


def test_one_proportion_is_needed_per_component():
    _, components = fit_mixture(clusters(), **{**OPTIONS, "n_components": 3})
    with pytest.raises(SkillError, match="2 proportions for 3 components"):
        log_densities(clusters(), np.array([0.5, 0.5]), components)
