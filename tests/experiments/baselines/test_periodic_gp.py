"""Facts about the Gaussian process with a periodic kernel."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines import PeriodicGP


@pytest.fixture(scope="module")
def model(eight_windows):
    return PeriodicGP(n_points=80, n_moments=12).fit(eight_windows)


def literal_posterior(model, eight, channel, times):
    """Mean and covariance, noise included, of a channel at times after the memory."""
    process = model.processes_[channel]
    kernel = process.kernel_
    s2, per, decay = kernel.k1.k1.k1, kernel.k1.k1.k2, kernel.k1.k2

    def k(a, b):
        gap = np.subtract.outer(a, b)
        wave = np.sin(np.pi * gap / per.periodicity) / per.length_scale
        return s2.constant_value * np.exp(
            -2 * wave**2 - 0.5 * (gap / decay.length_scale) ** 2
        )

    memory = process.X_train_[:, 0]
    y = (eight[len(eight) + memory.astype(int), channel] - eight[:, channel].mean()) / (
        eight[:, channel].std()
    )
    noise = kernel.k2.noise_level
    gram = k(memory, memory) + (noise + 1e-10) * np.eye(len(memory))
    cross = k(times, memory)
    cov = k(times, times) - cross @ np.linalg.solve(gram, cross.T)
    return cross @ np.linalg.solve(gram, y), cov + noise * np.eye(len(times))


def test_the_density_is_the_mixture_over_moments(model, eight, eight_windows):
    windows = eight_windows[:4, :]
    each = np.zeros((12, 4))
    for i in range(12):
        times = model.period_ * i / 12 + np.arange(80.0)
        for d in range(2):
            mean, cov = literal_posterior(model, eight, d, times)
            scaled = (windows[:, :, d] - eight[:, d].mean()) / eight[:, d].std()
            each[i] += multivariate_normal(mean, cov).logpdf(scaled)
            each[i] -= 80 * np.log(eight[:, d].std())
    expected = logsumexp(each, axis=0) - np.log(12)
    assert_allclose(model.log_density(windows), expected / 80, rtol=1e-5, atol=1e-6)


def test_it_finds_the_period(model):
    assert model.period_ == pytest.approx(40, rel=0.02)
    for process in model.processes_:
        periodicity = process.kernel_.k1.k1.k2.periodicity
        assert periodicity == pytest.approx(40, rel=0.16)


def test_its_prediction_is_better_than_the_mean(split_windows):
    learned, held_out = split_windows("eight")
    model = PeriodicGP(n_points=150, n_moments=24).fit(learned)
    error, spread = [], []
    for window in held_out[::6]:
        error.append(model.predict(window[:10], 20) - window[10:30])
        spread.append(window[10:30] - learned.mean(axis=(0, 1)))
    # About 40 to 48 mm rms against 100 mm, by the seed.
    assert np.mean(np.square(error)) < 0.5 * np.mean(np.square(spread))


def test_samples_are_as_wide_as_the_demonstrations(model, eight):
    samples = model.sample(600, seed=1)
    assert samples.shape == (600, 80, 2)
    assert_allclose(samples.std(axis=(0, 1)), eight.std(axis=0), rtol=0.3)
    assert np.array_equal(samples, model.sample(600, seed=1))
    own = model.log_density(model.sample(20, seed=2))
    assert own.mean() > model.log_density(samples[:20] + 0.05).mean()


def test_a_constant_channel_does_no_harm(eight_windows):
    flat = np.concatenate(
        [eight_windows, np.zeros_like(eight_windows[..., :1])], axis=2
    )
    model = PeriodicGP(n_points=40, n_moments=6).fit(flat)
    assert np.all(np.isfinite(model.log_density(flat[:2])))
    assert_allclose(model.predict(flat[0, :10], 5)[:, 2], 0, atol=1e-6)


def test_bad_parameters_are_named(eight_windows):
    for name in ("n_points", "n_periods", "n_moments"):
        with pytest.raises(ExperimentError, match=f"{name} is 0"):
            PeriodicGP(**{name: 0}).fit(eight_windows)
