"""Facts about the Gaussian process with a periodic kernel."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.experiments.baselines import PeriodicGP


@pytest.fixture(scope="module")
def model(eight):
    gp = PeriodicGP()
    gp.fit([eight])
    return gp


def literal(model, channel, count):
    """The covariance of samples of a scaled channel, noise included."""
    s, length, decay, s_2, decay_2, noise, period = model.parameters_[channel]
    gap = np.subtract.outer(np.arange(count), np.arange(count))
    wave = np.sin(np.pi * gap / period) ** 2 / length**2
    out = s**2 * np.exp(-2 * wave) * np.exp(-(gap**2) / (2 * decay**2))
    out += s_2**2 * np.exp(-(gap**2) / (2 * decay_2**2))
    return out + noise**2 * np.eye(count)


def test_it_finds_the_period(model):
    assert model.period_ == pytest.approx(40, rel=0.02)
    assert_allclose(model.parameters_[:, 6], 40, rtol=0.16)


def test_prediction_is_conditioned_on_the_observed_samples(model, eight):
    prediction = model.predict(eight[:10], 20)
    for d in range(2):
        both = literal(model, d, 30)
        scaled = (eight[:10, d] - eight[:, d].mean()) / eight[:, d].std()
        mean = both[10:, :10] @ np.linalg.solve(both[:10, :10], scaled)
        values = mean * eight[:, d].std() + eight[:, d].mean()
        assert_allclose(prediction.values[:, d], values, atol=1e-6)
        left = np.linalg.inv(np.linalg.inv(both)[10:, 10:])
        variance = np.diag(left) * eight[:, d].std() ** 2
        assert_allclose(prediction.covariances[:, d, d], variance, rtol=1e-4)


def test_a_constant_channel_is_accepted(eight):
    flat = np.column_stack([eight, np.zeros(len(eight))])
    model = PeriodicGP()
    model.fit([flat])
    forecast = model.predict(flat[:10], 5)
    assert np.all(np.isfinite(forecast.covariances))
    assert_allclose(forecast.values[:, 2], 0, atol=1e-6)
