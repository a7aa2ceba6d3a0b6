"""Facts about the low-rank Gaussian, each against dense matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from fmp_drake.errors import SkillError
from fmp_drake.primitives import LowRankGaussian


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


def dense(g):
    return (g.basis * g.variances) @ g.basis.T + g.noise * np.eye(g.dim)


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
def test_solve_is_the_precision_product(g):
    x = points(g)
    scale = 1 / g.noise
    expected = np.linalg.solve(dense(g), x.T).T
    assert_allclose(g.solve(x), expected, rtol=1e-8, atol=1e-10 * scale)
    assert_allclose(g.solve(g.multiply(x)), x, rtol=1e-8, atol=1e-8)


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


@many
@given(gaussians(), st.integers(1, 6), st.booleans())
def test_posterior_mean_is_the_least_squares_solution(g, m, same):
    rng = np.random.default_rng(m)
    rows = rng.standard_normal((m, g.dim))
    values = rng.standard_normal(m)
    noise = 0.01 if same else rng.uniform(0.01, 1, m)
    precision = np.linalg.inv(dense(g))
    weighted = rows.T / np.broadcast_to(noise, (m,))
    expected = np.linalg.solve(
        weighted @ rows + precision, weighted @ values + precision @ g.mean
    )
    got = g.posterior(rows, values, noise).mean
    assert_allclose(got, expected, rtol=1e-6, atol=1e-7)


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
    with pytest.raises(SkillError, match="greater than -noise"):
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


# Posteriors -------------------------------------------------------------------


@st.composite
def observations(draw):
    """Return a Gaussian, rows, values and the noise of an observation."""
    g = draw(gaussians())
    m = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    rows = rng.standard_normal((m, g.dim))
    if draw(st.booleans()):
        # Within the span of the factor, or the same row again.
        rows[-1] = g.basis[:, 0] if g.rank else rows[0]
    noise = g.noise * 10.0 ** rng.uniform(-3, 3, m)
    if draw(st.booleans()):
        noise = float(noise[0])
    return g, rows, rng.standard_normal(m), noise


def dense_posterior(g, rows, values, noise):
    """Return the mean and covariance by the textbook."""
    cov = dense(g)
    seen = rows @ cov @ rows.T + np.diag(np.broadcast_to(noise, len(rows)))
    gain = np.linalg.solve(seen, rows @ cov).T
    return g.mean + gain @ (values - rows @ g.mean), cov - gain @ rows @ cov


@many
@given(observations())
def test_posterior_is_the_dense_one(observation):
    g, rows, values, noise = observation
    mean, cov = dense_posterior(g, rows, values, noise)
    got = g.posterior(rows, values, noise)
    scale = np.max(np.abs(dense(g)))
    assert_allclose(dense(got), cov, rtol=1e-6, atol=1e-9 * scale)
    assert_allclose(got.mean, mean, rtol=1e-6, atol=1e-7)
    assert got.noise == g.noise
    assert_allclose(got.basis.T @ got.basis, np.eye(got.rank), atol=1e-9)


@many
@given(observations())
def test_posterior_is_positive(observation):
    g = observation[0].posterior(*observation[1:])
    assert np.all(g.variances > -g.noise)
    assert np.all(np.isfinite(g.log_density(points(g))))


def test_posterior_of_the_isotropic_rest_is_a_gaussian_like_any_other():
    g = example().posterior(*observation_of_the_rest())
    assert np.min(g.variances) < 0
    x = points(g)
    assert_allclose(g.multiply(x), x @ dense(g), atol=1e-12)
    assert_allclose(g.solve(g.multiply(x)), x, rtol=1e-6, atol=1e-7)
    assert_allclose(g.precision_diagonal(), np.diag(np.linalg.inv(dense(g))), rtol=1e-6)
    expected = multivariate_normal(g.mean, dense(g)).logpdf(x)
    assert_allclose(g.log_density(x), expected, rtol=1e-6)


def observation_of_the_rest():
    """Return rows outside the span of the example's factor, which is 3 of 6."""
    basis = example().basis
    _, _, rest = np.linalg.svd(basis.T)
    return rest[3:5], np.array([0.5, -0.5]), 0.01


def test_observations_one_after_the_other_are_all_at_once():
    g = example()
    rng = np.random.default_rng(0)
    rows, values = rng.standard_normal((4, 6)), rng.standard_normal(4)
    noise = rng.uniform(0.01, 1, 4)
    at_once = g.posterior(rows, values, noise)
    first = g.posterior(rows[:2], values[:2], noise[:2])
    then = first.posterior(rows[2:], values[2:], noise[2:])
    assert_allclose(then.mean, at_once.mean, atol=1e-9)
    assert_allclose(dense(then), dense(at_once), atol=1e-9)


def test_posterior_of_an_exact_observation_is_certain_about_it():
    g = example()
    row = np.ones((1, 6))
    got = g.posterior(row, [3.0], 1e-12)
    mean, cov = got.marginal(row)
    assert_allclose(mean, 3.0, atol=1e-6)
    assert 0 < cov[0, 0] < 1e-8


def test_observation_of_nothing_new_changes_nothing():
    g = example()
    got = g.posterior(np.ones((2, 6)), [100.0, -100.0], 1e15)
    assert_allclose(got.mean, g.mean, atol=1e-9)
    assert_allclose(dense(got), dense(g), atol=1e-9)


def test_samples_of_a_posterior_have_its_mean_and_covariance():
    g = example().posterior(*observation_of_the_rest())
    draws = g.sample(np.random.default_rng(0), 40_000)
    assert_allclose(draws.mean(axis=0), g.mean, atol=0.04)
    assert_allclose(np.cov(draws.T), dense(g), atol=0.06)
    rows, _, noise = observation_of_the_rest()
    seen = np.cov((draws @ rows.T).T)
    # 0.04 of prior variance, seen with 0.01 of noise.
    assert_allclose(seen, 0.04 * noise / (0.04 + noise) * np.eye(2), atol=5e-4)


def test_samples_of_a_posterior_without_noise_leave_out_what_was_seen():
    g = example().posterior(*observation_of_the_rest())
    draws = g.sample(np.random.default_rng(0), 1000, with_noise=False)
    assert np.all(np.isfinite(draws))
    rows, _, _ = observation_of_the_rest()
    assert_allclose(draws @ rows.T, np.tile(rows @ g.mean, (1000, 1)), atol=1e-9)
