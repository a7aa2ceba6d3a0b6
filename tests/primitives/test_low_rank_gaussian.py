"""Facts about the low-rank Gaussian, each against dense matrices."""

import numpy as np
import pytest
from dense_paper import dense
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from fmp_drake.errors import SkillError
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian


@st.composite
def gaussians(draw):
    n = draw(st.integers(1, 30))
    r = draw(st.integers(0, n))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    basis, _ = np.linalg.qr(rng.standard_normal((n, n)))
    noise = 10.0 ** draw(st.floats(-4, 0))
    # Some variances are zero: a direction may be as certain as the rest.
    variances = noise * 10.0 ** rng.uniform(-2, 4, r) * (rng.random(r) > 0.1)
    return LowRankGaussian(
        mean=rng.standard_normal(n),
        basis=np.ascontiguousarray(basis[:, :r]),
        variances=variances,
        noise=noise,
    )


def points(g, count=4, seed=0):
    rng = np.random.default_rng(seed)
    return g.mean + rng.standard_normal((count, g.dim))


many = settings(deadline=None, max_examples=60)


@many
@given(gaussians())
def test_multiply_is_the_covariance_product(g):
    x = points(g)
    assert_allclose(g.multiply(x), x @ dense(g), rtol=1e-9, atol=1e-9)
    assert_allclose(g.multiply(x[0]), dense(g) @ x[0], rtol=1e-9, atol=1e-9)


@many
@given(gaussians())
def test_precision_diagonal_is_that_of_the_inverse(g):
    expected = np.diag(np.linalg.inv(dense(g)))
    assert_allclose(g.precision_diagonal(), expected, rtol=1e-8, atol=1e-10 / g.noise)


@many
@given(gaussians())
def test_mahalanobis_and_log_density_are_the_dense_ones(g):
    x = points(g)
    delta = x - g.mean
    squares = np.sum(delta * np.linalg.solve(dense(g), delta.T).T, axis=1)
    assert_allclose(g.mahalanobis_squared(x), squares, rtol=1e-7)
    expected = multivariate_normal(g.mean, dense(g)).logpdf(x)
    assert_allclose(g.log_density(x), np.ravel(expected), rtol=1e-7, atol=1e-7)


@many
@given(gaussians(), st.integers(1, 6))
def test_marginal_is_that_of_the_projected_gaussian(g, m):
    rows = np.random.default_rng(m).standard_normal((m, g.dim))
    mean, cov = g.marginal(rows)
    assert_allclose(mean, rows @ g.mean)
    assert_allclose(cov, rows @ dense(g) @ rows.T, rtol=1e-9, atol=1e-9)


def example(r=3, noise=0.04):
    rng = np.random.default_rng(5)
    basis, _ = np.linalg.qr(rng.standard_normal((6, r)))
    return LowRankGaussian(
        mean=np.arange(6.0),
        basis=basis,
        variances=np.array([4.0, 1.0, 0.25])[:r],
        noise=noise,
    )


def test_samples_have_the_mean_and_covariance():
    g = example()
    draws = g.sample(np.random.default_rng(0), 40_000)
    assert draws.shape == (40_000, 6)
    assert_allclose(draws.mean(axis=0), g.mean, atol=0.04)
    assert_allclose(np.cov(draws.T), dense(g), atol=0.06)


def test_samples_without_noise_stay_in_the_span():
    g = example()
    draws = g.sample(np.random.default_rng(0), 40_000, with_noise=False)
    delta = draws - g.mean
    assert_allclose(delta @ g.basis @ g.basis.T, delta, atol=1e-12)
    assert_allclose(np.cov(draws.T), dense(g) - g.noise * np.eye(6), atol=0.06)


def test_samples_repeat_with_the_seed():
    g = example()
    one, two, other = (g.sample(np.random.default_rng(s), 3) for s in (1, 1, 2))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)


def test_gaussian_without_a_factor_is_isotropic():
    g = LowRankGaussian(
        mean=np.zeros(4), basis=np.zeros((4, 0)), variances=np.zeros(0), noise=2.0
    )
    assert (g.dim, g.rank) == (4, 0)
    assert_allclose(g.multiply(np.ones(4)), 2.0)
    assert_allclose(g.precision_diagonal(), 0.5)
    expected = multivariate_normal(np.zeros(4), 2 * np.eye(4)).logpdf(np.ones(4))
    assert g.log_density(np.ones(4)) == pytest.approx(expected)


def test_arrays_are_read_only():
    g = example()
    for array in (g.mean, g.basis, g.variances):
        with pytest.raises(ValueError, match="read-only"):
            array.flat[0] = 1
    with pytest.raises(AttributeError):
        g.noise = 1.0


@pytest.mark.parametrize("noise", [0.0, -1.0, np.nan])
def test_noise_that_is_not_positive_is_refused(noise):
    with pytest.raises(SkillError, match="noise must be positive"):
        example(noise=noise)


@pytest.mark.parametrize("variance", [-1.0, np.nan])
def test_covariance_that_is_not_positive_is_refused(variance):
    with pytest.raises(SkillError, match="no variance negative"):
        LowRankGaussian(
            mean=np.zeros(3),
            basis=np.eye(3)[:, :1],
            variances=np.array([variance]),
            noise=1.0,
        )


@pytest.mark.parametrize(
    ("mean", "basis", "variances"),
    [
        (np.zeros(3), np.zeros((4, 2)), np.zeros(2)),
        (np.zeros(3), np.zeros((3, 2)), np.zeros(1)),
        (np.zeros((3, 1)), np.zeros((3, 2)), np.zeros(2)),
    ],
)
def test_shapes_that_do_not_fit_are_refused(mean, basis, variances):
    with pytest.raises(SkillError, match="expected"):
        LowRankGaussian(mean=mean, basis=basis, variances=variances, noise=1.0)
