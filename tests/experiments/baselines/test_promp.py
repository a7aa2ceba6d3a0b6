"""Facts about ProMP-VM, one Gaussian and a mixture."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines.promp import ProMP, von_mises_bases
from fmp_drake.primitives import sliding_windows

SMALL = {"frequencies": (2, 4), "n_bases": 6, "width": 5.0, "ridge": 1e-6}


@pytest.fixture(scope="module", params=[1, 3])
def model(request, eight_windows):
    return ProMP(**SMALL, n_components=request.param).fit(eight_windows)


def block_basis(model, steps):
    """Phi^D of steps (K,), dense: shape (K * D, D * B), ordered (K, D)."""
    z = np.asarray(steps) / model.n_steps_
    rows = von_mises_bases(z, frequencies=(2, 4), n_bases=6, width=5.0)
    d = model.n_channels_
    return np.concatenate([np.kron(np.eye(d), row) for row in rows])


def dense_joint(model, steps, noise):
    """Mean and covariance of the values at steps for each component."""
    phi = block_basis(model, steps)
    white = np.diag(np.broadcast_to(noise, (len(steps), model.n_channels_)).ravel())
    return [
        (phi @ mean, phi @ cov @ phi.T + white)
        for mean, cov in zip(model.means_, model.covariances_, strict=True)
    ]


def test_weights_are_ridge_least_squares(eight_windows):
    model = ProMP(**SMALL).fit(eight_windows)
    phi = von_mises_bases(np.arange(80) / 80, frequencies=(2, 4), n_bases=6, width=5.0)
    normal = phi.T @ phi + 1e-6 * np.eye(12)
    weights = [np.linalg.solve(normal, phi.T @ w).T.ravel() for w in eight_windows]
    assert_allclose(model.means_[0], np.mean(weights, axis=0), atol=1e-6)
    expected = np.cov(np.transpose(weights), bias=True) + 1e-6 * np.eye(24)
    assert_allclose(model.covariances_[0], expected, atol=1e-5)


def test_the_noise_is_found():
    rng = np.random.default_rng(0)
    bases = von_mises_bases(np.arange(80) / 80, frequencies=(2,), width=1.0)
    weights = rng.standard_normal((60, 2, 20))
    clean = np.swapaxes(weights @ bases.T, 1, 2)
    noisy = clean + rng.standard_normal(clean.shape) * [0.01, 0.05]
    model = ProMP(frequencies=(2,), width=1.0, ridge=1e-9).fit(noisy)
    assert_allclose(np.sqrt(model.noise_), [0.01, 0.05], rtol=0.03)


def test_the_density_is_that_of_dense_gaussians(model, eight_windows):
    windows = eight_windows[::20] + 0.01
    joint = dense_joint(model, np.arange(80), model.noise_)
    each = [
        multivariate_normal(mean, cov).logpdf(windows.reshape(len(windows), -1))
        for mean, cov in joint
    ]
    expected = logsumexp(np.array(each).T + np.log(model.proportions_), axis=1)
    posterior = model.posterior(np.arange(80), windows, noise=model.noise_)
    assert_allclose(posterior.log_evidence, expected, rtol=1e-8)


def test_conditioning_is_that_of_dense_gaussians(model):
    keys, values = (
        np.array([0.0, 17.0, 63.5]),
        np.array([[0.02, 0.05], [0, 0.1], [0, 0]]),
    )
    steps = np.concatenate([np.arange(80.0), keys])
    k, n = values.size, 160
    log_joint, means = [], []
    for proportion, (mean, cov) in zip(
        model.proportions_, dense_joint(model, steps, 0.0), strict=True
    ):
        seen = cov[n:, n:] + model.tolerance * np.eye(k)
        gain = np.linalg.solve(seen, cov[n:, :n]).T
        means.append(mean[:n] + gain @ (values.ravel() - mean[n:]))
        evidence = multivariate_normal(mean[n:], seen).logpdf(values.ravel())
        log_joint.append(np.log(proportion) + evidence)
    expected = means[np.argmax(log_joint)].reshape(80, 2)
    trajectory = model.condition(keys, values)
    assert_allclose(trajectory, expected, atol=1e-6)
    assert_allclose(trajectory[[0, 17]], values[:2], atol=2e-3)


def test_prediction_is_the_mixture_of_dense_regressions(model, eight_windows):
    prefix, horizon = eight_windows[7, :9], 12
    k, out, log_joint = 18, [], []
    noise = np.tile(model.noise_, 9)
    for proportion, (mean, cov) in zip(
        model.proportions_, dense_joint(model, np.arange(21), 0.0), strict=True
    ):
        seen = cov[:k, :k] + np.diag(noise)
        delta = np.linalg.solve(seen, prefix.ravel() - mean[:k])
        out.append(mean[k:] + cov[k:, :k] @ delta)
        evidence = multivariate_normal(mean[:k], seen).logpdf(prefix.ravel())
        log_joint.append(np.log(proportion) + evidence)
    probabilities = np.exp(log_joint - logsumexp(log_joint))
    expected = (probabilities @ np.array(out)).reshape(horizon, 2)
    assert_allclose(model.predict(prefix, horizon).values, expected, atol=1e-7)


def test_prediction_continues_past_the_window(model, eight_windows):
    far = model.predict(eight_windows[0, :10], 200).values
    assert_allclose(far[:40], far[40:80], atol=1e-9)  # f = 2 and 4 in T = 80.


def test_samples_follow_the_distribution(model):
    samples = model.sample(20000, seed=1).reshape(20000, -1)
    joint = dense_joint(model, np.arange(80), 0.0)
    mean = sum(p * m for p, (m, _) in zip(model.proportions_, joint, strict=True))
    second = sum(
        p * (c + np.outer(m, m))
        for p, (m, c) in zip(model.proportions_, joint, strict=True)
    )
    assert_allclose(samples.mean(axis=0), mean, atol=3e-3)
    assert_allclose(np.cov(samples.T), second - np.outer(mean, mean), atol=4e-4)


def test_samples_repeat_with_the_seed(model):
    assert np.array_equal(model.sample(5, seed=4), model.sample(5, seed=4))
    assert model.sample(0).shape == (0, 80, 2)


def test_mixture_avoids_the_middle_unlike_one_gaussian(split_windows):
    """Fig. 5b and 5c: polishing is a ring; without alignment its phase is arbitrary."""
    learned, _ = split_windows("polishing")
    centre, spread = learned.mean(axis=(0, 1)), learned.std(axis=(0, 1))

    def inside(trajectories):
        scaled = ((trajectories - centre) / spread)[..., :2]
        return float(np.mean(np.linalg.norm(scaled, axis=-1) < 0.7))

    one, ten = (
        ProMP(frequencies=(3,), n_components=m).fit(learned).sample(1000)
        for m in (1, 10)
    )
    assert inside(learned) == 0
    assert inside(one) > 0.15
    assert inside(ten) < 0.02


def test_a_promp_finds_the_frequencies_of_the_movement():
    t = np.arange(500)
    path = np.sin(2 * np.pi * t / 37) + 0.3 * np.cos(4 * np.pi * t / 37)
    windows = sliding_windows(path[:, None], n_steps=60, stride=5)
    model = ProMP(frequencies=2).fit(windows)
    assert_allclose(model.frequencies_, [60 / 37, 120 / 37], rtol=0.01)
    error = model.predict(path[:10, None], 20).values[:, 0] - path[10:30]
    assert np.abs(error).max() < 0.02


def test_redundant_bases_of_five_frequencies_stay_finite(split_windows):
    learned, _ = split_windows("eight")
    model = ProMP(frequencies=(1, 2, 3, 4, 5), n_components=10).fit(learned)
    assert model.means_.shape == (10, 300)
    assert np.abs(model.sample(500)).max() < 1.0
    start = learned[0, 0] + [0.1, 0.1, 0.0]
    far = model.condition([0], [start])
    assert_allclose(far[0], start, atol=1e-3)


def test_too_little_regularisation_is_an_error_that_names_it(eight_windows):
    with pytest.raises(ExperimentError, match="reg_covar is 1e-300: too small"):
        ProMP(**SMALL, n_components=10, reg_covar=1e-300).fit(eight_windows)


def test_half_a_component_is_refused(eight_windows):
    with pytest.raises(ExperimentError, match=r"n_components is 1\.5"):
        ProMP(**SMALL, n_components=1.5).fit(eight_windows)


def test_components_are_at_most_half_the_windows(eight_windows):
    model = ProMP(**SMALL, n_components=10).fit(eight_windows[:5])
    assert len(model.proportions_) == 2
    same = ProMP(**SMALL, n_components=10).fit(np.tile(eight_windows[:1], (6, 1, 1)))
    assert len(same.proportions_) == 1


@pytest.mark.parametrize(
    ("windows", "match"),
    [
        ("text", "the windows: 'text' cannot be read"),
        (np.zeros((3, 4)), r"shape \(3, 4\); expected \(N, T, D\)"),
        (np.zeros((1, 8, 2)), "1 window; at least 2"),
        (np.full((3, 8, 2), np.nan), "NaN"),
    ],
)
def test_bad_windows_are_named(windows, match):
    with pytest.raises(ExperimentError, match=match):
        ProMP(**SMALL).fit(windows)


@pytest.mark.parametrize("name", ["ridge", "n_components", "reg_covar", "tolerance"])
def test_bad_parameters_are_named(name, eight_windows):
    with pytest.raises(ExperimentError, match=f"{name} is 0"):
        ProMP(**{**SMALL, name: 0}).fit(eight_windows)


def test_bad_requests_are_named(model, eight_windows):
    with pytest.raises(ExperimentError, match=r"step is 80\.0; .* at most 79"):
        model.condition([80], [[0, 0]])
    with pytest.raises(ExperimentError, match=r"values of shape \(1, 3\)"):
        model.condition([1], [[0, 0, 0]])
    with pytest.raises(ExperimentError, match="NaN"):
        model.condition([1], [[0, np.inf]])
    with pytest.raises(ExperimentError, match=r"shape \(2, 3\); expected \(K, 2\)"):
        model.predict(np.zeros((2, 3)), 5)
    with pytest.raises(ExperimentError, match="horizon is 0"):
        model.predict(eight_windows[0, :4], 0)
    with pytest.raises(ExperimentError, match="n is -1"):
        model.sample(-1)
    with pytest.raises(ExperimentError, match="seed is -1"):
        model.sample(1, seed=-1)


def test_inputs_are_not_changed(model, eight_windows):
    before = eight_windows.copy()
    model.predict(eight_windows[0, :10], 5)
    clone(model).fit(eight_windows)
    assert np.array_equal(before, eight_windows)


def test_methods_require_fit(model):
    for call in (
        lambda: clone(model).sample(),
        lambda: clone(model).predict(np.zeros((2, 2)), 3),
        lambda: clone(model).condition([0], np.zeros((1, 2))),
    ):
        with pytest.raises(NotFittedError):
            call()
