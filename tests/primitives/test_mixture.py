"""Facts about the mixture of the weights (9)."""

import dense_paper
import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.primitives import FourierBasis
from fmp_drake.primitives.model import mixture
from fmp_drake.primitives.model.mixture import fit_mixture

OPTIONS = {
    "n_components": 1,
    "explained_variance": 1.0,
    "regularization": 1e-3,
    "seed": 0,
}


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
    assert_allclose(dense_paper.dense(g), expected, atol=2e-8)


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
    assert_allclose(dense_paper.dense(g), kept + noise * np.eye(10), atol=1e-6)


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
        assert_allclose(dense_paper.dense(g), 1e-3 * np.eye(12), atol=1e-12)


def test_log_density_is_that_of_9_up_to_the_change_of_weights(
    small_skill, paper_mixture
):
    skill = small_skill
    t, n = skill.n_steps, skill.components_[0].dim
    noise = skill.components_[0].noise
    of_paper = paper_mixture(skill)
    y = skill.sample(5, seed=2)
    ours = skill.score_samples(y)
    # The paper's weights: n directions longer by sqrt(T), and n more that are zero
    # and have the variance T * noise of the regulariser.
    constant = 0.5 * n * (np.log(t) + np.log(2 * np.pi * t * noise))
    for window, value in zip(y, ours, strict=True):
        w = dense_paper.weights_of(window)
        theirs = dense_paper.mixture_log_density(w, *of_paper)
        assert value == pytest.approx(theirs + constant, rel=1e-7)


# Principal directions -------------------------------------------------------


@pytest.mark.parametrize("shape", [(40, 12), (12, 40), (15, 15), (2, 9), (9, 1)])
@pytest.mark.parametrize("explained_variance", [0.5, 0.99, 1.0])
def test_directions_of_products_are_those_of_the_decomposition(
    shape, explained_variance, monkeypatch
):
    rng = np.random.default_rng(0)
    x = rng.standard_normal(shape) * np.geomspace(1, 1e-3, shape[1])
    x -= x.mean(axis=0)
    energy = np.linalg.svd(x, compute_uv=False) ** 2
    one, residual = mixture._principal_directions(x, explained_variance)
    monkeypatch.setattr(mixture, "_LARGE", 0)
    two, other_residual = mixture._principal_directions(x, explained_variance)
    rank = len(one)
    assert len(two) == rank
    assert energy[:rank].sum() >= explained_variance * energy.sum() * (1 - 1e-9)
    assert energy[: rank - 1].sum() < explained_variance * energy.sum()
    expected = energy[rank:].sum() / max(shape[1] - rank, 1)
    assert_allclose([residual, other_residual], expected, rtol=1e-6, atol=1e-12)
    assert_allclose(two @ two.T, np.eye(rank), atol=1e-9)
    assert_allclose(np.abs(np.sum(one * two, axis=1)), 1, atol=1e-6)


@pytest.mark.parametrize("shape", [(40, 120), (120, 40)])
@pytest.mark.parametrize("explained_variance", [0.99, 1.0])
def test_large_fits_are_the_same(shape, explained_variance, monkeypatch):
    rng = np.random.default_rng(0)
    w = rng.standard_normal((shape[0], 8)) @ rng.standard_normal((8, shape[1]))
    options = {
        **OPTIONS,
        "n_components": 2,
        "explained_variance": explained_variance,
    }
    pi, components = fit_mixture(w, **options)
    monkeypatch.setattr(mixture, "_LARGE", 0)
    other_pi, others = fit_mixture(w, **options)
    assert_allclose(other_pi, pi)
    for one, two in zip(components, others, strict=True):
        assert_allclose(two.mean, one.mean, atol=1e-8)
        assert_allclose(dense_paper.dense(two), dense_paper.dense(one), atol=1e-7)
        assert_allclose(two.basis.T @ two.basis, np.eye(two.rank), atol=1e-9)


def test_large_fit_of_directions_that_hardly_vary_stays_orthonormal(monkeypatch):
    monkeypatch.setattr(mixture, "_LARGE", 0)
    rng = np.random.default_rng(0)
    w = rng.standard_normal((30, 60)) * np.geomspace(1, 1e-12, 60)
    _, (g,) = fit_mixture(w, **{**OPTIONS, "regularization": 1e-14})
    assert_allclose(g.basis.T @ g.basis, np.eye(g.rank), atol=1e-9)


@pytest.mark.parametrize("large", [1000, 0])
@pytest.mark.parametrize("value", [0.0, 0.3, 1e6])
def test_windows_that_do_not_vary_have_the_regulariser_alone(large, value, monkeypatch):
    monkeypatch.setattr(mixture, "_LARGE", large)
    for shape in ((6, 12), (12, 6), (2, 8)):
        _, components = fit_mixture(
            np.full(shape, value), **{**OPTIONS, "n_components": 3}
        )
        for g in components:
            assert_allclose(g.mean, value, rtol=1e-12)
            assert_allclose(
                dense_paper.dense(g), 1e-3 * np.eye(shape[1]), rtol=1e-6, atol=1e-9
            )


def test_two_windows_vary_along_their_difference():
    a, b = np.random.default_rng(0).standard_normal((2, 9))
    pi, (g,) = fit_mixture(np.stack([a, b]), **{**OPTIONS, "n_components": 10})
    assert_allclose(pi, [1.0])
    assert_allclose(g.mean, (a + b) / 2)
    half = (a - b) / 2
    assert_allclose(
        dense_paper.dense(g), np.outer(half, half) + 1e-3 * np.eye(9), atol=1e-9
    )


# Weights of the windows -----------------------------------------------------


def test_integer_weights_are_repeated_windows():
    w = clusters(each=20)
    times = np.random.default_rng(1).integers(1, 4, size=len(w))
    options = {**OPTIONS, "n_components": 3, "explained_variance": 0.9999}
    pi, components = fit_mixture(w, sample_weights=times / times.mean(), **options)
    other_pi, others = fit_mixture(np.repeat(w, times, axis=0), **options)
    assert_allclose(other_pi, pi, rtol=1e-9)
    for one, two in zip(components, others, strict=True):
        assert_allclose(two.mean, one.mean, atol=1e-9)
        assert_allclose(dense_paper.dense(two), dense_paper.dense(one), atol=1e-8)


def test_progress_reports_the_parts_of_the_fit():
    said = []
    fit_mixture(clusters(), **{**OPTIONS, "n_components": 2}, progress=said.append)
    assert said[0] == "principal directions of 240 windows of 10 weights"
    assert said[1].startswith("2 components, round 1: mean log-likelihood ")
