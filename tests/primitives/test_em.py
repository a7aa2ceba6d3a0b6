"""Facts about expectation-maximisation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from sklearn.mixture import GaussianMixture

from fmp_drake.primitives.model.mixture import fit_gaussians, log_gaussians


def blobs(count=240, r=4, centres=3, apart=3.0, seed=0):
    """Return samples of clusters that overlap a little."""
    rng = np.random.default_rng(seed)
    centre = apart * rng.standard_normal((centres, r))
    shape = rng.standard_normal((centres, r, r)) / np.sqrt(r)
    of = rng.integers(centres, size=count)
    z = rng.standard_normal((count, r))
    return centre[of] + np.einsum("nab,nb->na", shape[of], z)


def fit(samples, sample_weights=None, **changes):
    if sample_weights is None:
        sample_weights = np.ones(len(samples))
    options = {
        "n_components": 3,
        "regularization": 1e-6,
        "shrinkage": 0.0,
        "seed": 0,
        **changes,
    }
    return fit_gaussians(samples, sample_weights=sample_weights, **options)


def log_likelihood(mixture, x, times=None):
    """Return the mean log density of samples that count some times."""
    logs = log_gaussians(x, mixture.means, mixture.covariances)
    return np.average(
        logsumexp(logs + np.log(mixture.proportions), axis=1), weights=times
    )


def by_first_coordinate(fit):
    order = np.argsort(fit.means[:, 0])
    return fit.proportions[order], fit.means[order], fit.covariances[order]


@pytest.mark.parametrize("n_components", [1, 2, 5])
@pytest.mark.parametrize("seed", [0, 7])
def test_unweighted_fit_is_scikit_learns(n_components, seed):
    x = blobs()
    ours = fit(x, n_components=n_components, seed=seed, regularization=1e-4)
    theirs = GaussianMixture(
        n_components, reg_covar=1e-4, max_iter=200, random_state=seed
    ).fit(x)
    assert_allclose(ours.proportions, theirs.weights_, rtol=1e-6)
    assert_allclose(ours.means, theirs.means_, rtol=1e-6, atol=1e-9)
    assert_allclose(ours.covariances, theirs.covariances_, rtol=1e-6, atol=1e-9)
    assert log_likelihood(ours, x) == pytest.approx(theirs.score(x), rel=1e-6)


def test_log_densities_are_scikit_learns():
    x = blobs()
    theirs = GaussianMixture(3, random_state=0).fit(x)
    log_joint = log_gaussians(x, theirs.means_, theirs.covariances_)
    log_joint += np.log(theirs.weights_)
    total = np.logaddexp.reduce(log_joint, axis=1)
    assert_allclose(total, theirs.score_samples(x), rtol=1e-9)


@pytest.mark.parametrize("shrinkage", [0.0, 5.0])
def test_integer_weights_are_repeated_samples(shrinkage):
    x = blobs(apart=4.0)
    times = np.random.default_rng(1).integers(1, 5, size=len(x))
    # To convergence: k-means draws other first centres where samples repeat.
    options = {"shrinkage": shrinkage, "tolerance": 1e-12, "max_rounds": 2000}
    weighted = fit(x, times.astype(float), **options)
    repeated = fit(np.repeat(x, times, axis=0), **options)
    for one, two in zip(
        by_first_coordinate(weighted), by_first_coordinate(repeated), strict=True
    ):
        assert_allclose(one, two, rtol=1e-5, atol=1e-7)
    likelihoods = [
        log_likelihood(weighted, x, times),
        log_likelihood(repeated, np.repeat(x, times, axis=0)),
    ]
    assert likelihoods[0] == pytest.approx(likelihoods[1])


def test_one_weighted_component_is_the_weighted_mean_and_covariance():
    x = blobs()
    weights = np.random.default_rng(2).uniform(0, 3, len(x))
    got = fit(x, weights, n_components=1, regularization=1e-3)
    assert_allclose(got.means[0], np.average(x, axis=0, weights=weights))
    expected = np.cov(x.T, aweights=weights, ddof=0) + 1e-3 * np.eye(4)
    assert_allclose(got.covariances[0], expected, rtol=1e-9)


def test_weights_matter_only_relative_to_each_other():
    x = blobs()
    weights = np.random.default_rng(2).uniform(0.1, 3, len(x))
    one, two = fit(x, weights), fit(x, 2 * weights)
    assert_allclose(one.covariances, two.covariances, rtol=1e-9)


@pytest.mark.parametrize("n_components", [1, 3, 6])
def test_log_likelihood_grows_round_by_round(n_components):
    x = blobs(apart=1.0)
    grown = [
        log_likelihood(
            fit(
                x,
                n_components=n_components,
                regularization=1e-12,
                tolerance=0.0,
                max_rounds=rounds,
            ),
            x,
        )
        for rounds in range(1, 25)
    ]
    assert np.all(np.diff(grown) > -1e-9)
    if n_components > 1:
        assert grown[-1] > grown[0] + 1e-3


def test_fit_ends_where_the_log_likelihood_stops_growing():
    said = []
    fit(blobs(apart=1.0), progress=said.append, tolerance=1e-3)
    assert said[0].startswith("3 components, round 1: mean log-likelihood ")
    values = [float(line.rsplit(" ", 1)[1]) for line in said]
    steps = np.diff(values)
    assert np.all(steps[:-1] > 0.5e-3)  # Told to three digits.
    assert abs(steps[-1]) < 1.5e-3
    assert len(said) < 200
    said.clear()
    fit(blobs(apart=1.0), progress=said.append, tolerance=0.0, max_rounds=7)
    assert len(said) == 7


# Shrinkage ------------------------------------------------------------------


def shared_covariance(x):
    """Return what all components share before the first round, and each one's own."""
    plain = fit(x, regularization=0.0, max_rounds=0)
    shared = np.einsum("j,jab->ab", plain.proportions, plain.covariances)
    return shared, plain


def test_shrinkage_counts_the_shared_covariance_as_samples():
    x = blobs()
    shared, plain = shared_covariance(x)
    got = fit(x, regularization=1e-3, shrinkage=12.0, max_rounds=0)
    counts = plain.proportions * len(x)
    for j, count in enumerate(counts):
        expected = (count * plain.covariances[j] + 12 * shared) / (count + 12)
        assert_allclose(got.covariances[j], expected + 1e-3 * np.eye(4), rtol=1e-9)
    assert_allclose(got.means, plain.means)
    assert_allclose(got.proportions, plain.proportions)


def test_more_shrinkage_is_nearer_to_the_shared_covariance():
    x = blobs()
    shared, _ = shared_covariance(x)
    distances = np.array(
        [
            np.linalg.norm(
                fit(x, shrinkage=s, regularization=0.0, max_rounds=0).covariances
                - shared,
                axis=(1, 2),
            )
            for s in (0.0, 1.0, 10.0, 100.0, 1e4, 1e9)
        ]
    )
    assert np.all(np.diff(distances, axis=0) < 0)
    assert_allclose(distances[-1], 0, atol=1e-6 * np.linalg.norm(shared))


def test_endless_shrinkage_ties_the_covariances():
    x = blobs(apart=4.0)
    got = fit(x, shrinkage=1e12, tolerance=1e-9, max_rounds=500)
    theirs = GaussianMixture(
        3, covariance_type="tied", reg_covar=1e-6, tol=1e-9, max_iter=500,
        random_state=0,
    ).fit(x)  # fmt: skip
    for covariance in got.covariances:
        assert_allclose(covariance, theirs.covariances_, rtol=1e-3, atol=1e-5)


def test_one_component_is_not_shrunk():
    x = blobs()
    plain = fit(x, n_components=1)
    shrunk = fit(x, n_components=1, shrinkage=50.0)
    assert_allclose(shrunk.covariances, plain.covariances, rtol=1e-9)


# Degenerate samples -----------------------------------------------------------


def test_samples_on_a_line_leave_the_regulariser_across_it():
    t = np.random.default_rng(0).standard_normal(80)
    line = np.array([3.0, 0.0, 4.0]) / 5
    got = fit(np.outer(t, line), regularization=1e-3, n_components=2)
    for covariance in got.covariances:
        across = np.linalg.eigvalsh(covariance)[:2]
        assert_allclose(across, 1e-3, rtol=1e-9)


def test_as_many_components_as_samples_sit_on_the_samples():
    x = 10 * np.random.default_rng(0).standard_normal((5, 2))
    got = fit(x, n_components=5, regularization=1e-2)
    assert_allclose(got.proportions, 0.2, atol=1e-9)
    assert_allclose(
        np.sort(got.means, axis=0), np.sort(x, axis=0), rtol=1e-6, atol=1e-6
    )
    assert_allclose(got.covariances, np.tile(1e-2 * np.eye(2), (5, 1, 1)), atol=1e-9)
