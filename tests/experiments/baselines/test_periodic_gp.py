"""Facts about the Gaussian process with a periodic kernel."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from fmp_drake.experiments.baselines import PeriodicGP


@pytest.fixture(scope="module")
def model(eight_windows):
    return PeriodicGP().fit(eight_windows)


def literal(model, channel, count):
    """The covariance of samples of a scaled channel, noise included."""
    s, length, decay, s_2, decay_2, noise, period = model.parameters_[channel]
    gap = np.subtract.outer(np.arange(count), np.arange(count))
    wave = np.sin(np.pi * gap / period) ** 2 / length**2
    out = s**2 * np.exp(-2 * wave) * np.exp(-(gap**2) / (2 * decay**2))
    out += s_2**2 * np.exp(-(gap**2) / (2 * decay_2**2))
    return out + noise**2 * np.eye(count)


def test_the_density_is_that_of_independent_channels(model, eight, eight_windows):
    windows = eight_windows[:4]
    expected = np.zeros(4)
    for d in range(2):
        scaled = (windows[:, :, d] - eight[:, d].mean()) / eight[:, d].std()
        expected += multivariate_normal(cov=literal(model, d, 80)).logpdf(scaled)
        expected -= 80 * np.log(eight[:, d].std())
    assert_allclose(model.log_density(windows), expected / 80, rtol=1e-5, atol=1e-6)


def test_it_finds_the_period(model):
    assert model.period_ == pytest.approx(40, rel=0.02)
    assert_allclose(model.parameters_[:, 6], 40, rtol=0.16)


def test_a_prediction_is_conditioned_on_what_was_seen(model, eight):
    prediction = model.tubes(eight[:10], 20)
    for d in range(2):
        both = literal(model, d, 30)
        scaled = (eight[:10, d] - eight[:, d].mean()) / eight[:, d].std()
        mean = both[10:, :10] @ np.linalg.solve(both[:10, :10], scaled)
        values = mean * eight[:, d].std() + eight[:, d].mean()
        assert_allclose(prediction.values[:, d], values, atol=1e-6)
        left = np.linalg.inv(np.linalg.inv(both)[10:, 10:])
        variance = np.diag(left) * eight[:, d].std() ** 2
        assert_allclose(prediction.covariances[:, d, d], variance, rtol=1e-4)
    assert np.array_equal(prediction.values, model.predict(eight[:10], 20))


def test_samples_have_the_covariance_of_the_process(model, eight):
    samples = model.sample(4000, seed=1)[..., 0] / eight[:, 0].std()
    expected = literal(model, 0, 80) - model.parameters_[0, 5] ** 2 * np.eye(80)
    found = samples.T @ samples / len(samples)
    assert_allclose(found, expected, atol=0.1 * expected[0, 0])


def test_a_constant_channel_does_no_harm(eight_windows):
    flat = np.concatenate(
        [eight_windows, np.zeros_like(eight_windows[..., :1])], axis=2
    )
    model = PeriodicGP().fit(flat)
    assert np.all(np.isfinite(model.log_density(flat[:2])))
    assert_allclose(model.predict(flat[0, :10], 5)[:, 2], 0, atol=1e-6)
