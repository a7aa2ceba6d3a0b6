"""Facts about the trackers: Algorithm 2."""

import dense_paper
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are

from fmp_drake.errors import SkillError
from fmp_drake.primitives import ExponentialTracker, LqrTracker, ProportionalTracker
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.playback.trackers import paper_precision_diagonal

TICK = 0.1


def component(noise=1e-3):
    rng = np.random.default_rng(3)
    basis, _ = np.linalg.qr(rng.standard_normal((16, 5)))
    return LowRankGaussian(
        mean=rng.standard_normal(16),
        basis=basis,
        variances=np.array([1.0, 0.3, 0.1, 0.02, 0.004]),
        noise=noise,
    )


def start(g, scale=1.0):
    return g.mean + scale * np.random.default_rng(8).standard_normal(g.dim)


@pytest.mark.parametrize("fixture", ["small_skill", "odd_skill"])
def test_precision_diagonal_is_that_of_the_papers_weights(
    fixture, paper_mixture, request
):
    skill = request.getfixturevalue(fixture)
    t = skill.n_steps
    _, _, sigmas = paper_mixture(skill)
    # Which of the paper's weights a weight of ours appears in.
    used = np.abs(skill.basis.to_paper(np.eye(t))) > 1e-9
    for gaussian, sigma in zip(skill.components_, sigmas, strict=True):
        ours = paper_precision_diagonal(gaussian, n_steps=t).reshape(-1, t)
        theirs = np.diag(np.linalg.inv(sigma)).reshape(-1, 2 * t)
        for mine, channel in zip(ours, theirs, strict=True):
            for rate, where in zip(mine, used, strict=True):
                assert_allclose(channel[where], rate, rtol=1e-6)


def test_proportional_tracker_is_17_step_by_step(small_skill, paper_mixture):
    skill = small_skill
    _, mu, sigma = paper_mixture(skill)
    gaussian = skill.components_[1]
    precision = np.diag(np.linalg.inv(sigma[1]))
    beta = 1.5 / (TICK * precision.max())
    relaxation = ProportionalTracker(beta=beta).relaxation(
        gaussian, n_steps=skill.n_steps, tick=TICK
    )
    ours = skill.basis.analyze(skill.sample(seed=4)[0])
    paper = skill.basis.to_paper(ours)
    for _ in range(60):
        ours = relaxation.after(ours, gaussian.mean, TICK)
        paper = dense_paper.track(paper, mu[1], sigma[1], beta, TICK)
        assert_allclose(skill.basis.to_paper(ours), paper, atol=1e-9)
    assert np.linalg.norm(ours - gaussian.mean) < 1.0


def test_algorithm_2_is_the_papers(small_skill, paper_mixture):
    skill, k = small_skill, small_skill.overlap
    pi, mu, sigma = paper_mixture(skill)
    precision = np.max([np.diag(np.linalg.inv(s)).max() for s in sigma])
    beta = 1 / (TICK * precision)
    y = skill.sample(seed=6, with_noise=False)[0][:k]
    values, covariances = dense_paper.algorithm_2(
        y, pi, mu, sigma, skill.tolerance, beta, TICK
    )
    mapping = skill.map_partial(y)
    gaussian = skill.components_[mapping.component]
    relaxation = ProportionalTracker(beta=beta).relaxation(
        gaussian, n_steps=skill.n_steps, tick=TICK
    )
    w = mapping.weights
    for i, step in enumerate(range(k, skill.n_steps)):
        w = relaxation.after(w, gaussian.mean, TICK)
        value = skill.basis.synthesize(w)[step]
        assert_allclose(value, values[i].real, atol=1e-7)
        assert_allclose(values[i].imag, 0, atol=1e-9)
        # Phi is complex: as printed, (18) counts the regulariser twice.
        twice = skill.covariance(mapping.component, step) + gaussian.noise * np.eye(2)
        assert_allclose(covariances[i].real, twice, rtol=1e-9, atol=1e-15)


def test_covariance_at_a_sample_is_18_over_real_weights(small_skill, paper_mixture):
    skill = small_skill
    _, _, sigmas = paper_mixture(skill)
    for j, sigma in enumerate(sigmas):
        for step in (0, 3, 23):
            row = dense_paper.phi_of([step], skill.n_steps, 2).real
            expected = row @ sigma @ row.T
            assert_allclose(skill.covariance(j, step), expected, rtol=1e-9, atol=1e-15)


def test_proportional_gain_is_refused_exactly_where_17_diverges():
    g = component()
    precision = paper_precision_diagonal(g, n_steps=16)
    largest = 2 / (TICK * precision.max())
    fine = ProportionalTracker(beta=0.999 * largest)
    relaxation = fine.relaxation(g, n_steps=16, tick=TICK)
    w = start(g)
    for _ in range(20_000):
        w = relaxation.after(w, g.mean, TICK)
    assert_allclose(w, g.mean, atol=1e-3)
    with pytest.raises(SkillError, match=f"up to {largest:.6g}"):
        ProportionalTracker(beta=1.001 * largest).relaxation(g, n_steps=16, tick=TICK)


@pytest.mark.parametrize("beta", [0.0, -1.0, np.nan])
def test_proportional_gain_that_is_not_positive_is_refused(beta):
    with pytest.raises(SkillError, match="must be positive"):
        ProportionalTracker(beta=beta).relaxation(component(), n_steps=16, tick=TICK)


def test_proportional_tracker_moves_linearly_between_ticks():
    g = component()
    relaxation = ProportionalTracker(beta=1e-3).relaxation(g, n_steps=16, tick=TICK)
    w0 = start(g)
    w1 = relaxation.after(w0, g.mean, TICK)
    assert_allclose(relaxation.after(w0, g.mean, TICK / 2), (w0 + w1) / 2)


def lqr_gain(g, time_constant):
    """Solve the Riccati equation of the documented cost; return K of dw = -K w."""
    sigma = dense_paper.dense(g)
    rho = time_constant**2 / np.linalg.eigvalsh(sigma)[-1]
    n = g.dim
    precision = np.linalg.inv(sigma)
    p = solve_continuous_are(
        np.zeros((n, n)), np.eye(n), (precision + precision.T) / 2, rho * np.eye(n)
    )
    return p / rho


@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.7, 4.0])
def test_lqr_tracker_solves_the_riccati_equation(seconds):
    g = component()
    tracker = LqrTracker(time_constant=1.5, shortest=1e-9)
    relaxation = tracker.relaxation(g, n_steps=16, tick=TICK)
    gain = lqr_gain(g, 1.5)
    w0 = start(g)
    expected = g.mean + expm(-gain * seconds) @ (w0 - g.mean)
    assert_allclose(relaxation.after(w0, g.mean, seconds), expected, atol=1e-7)


def test_lqr_tracker_follows_its_differential_equation_to_any_target():
    g = component()
    relaxation = LqrTracker(shortest=1e-9).relaxation(g, n_steps=16, tick=TICK)
    gain, target, w0 = lqr_gain(g, 2.0), g.mean + 0.3, start(g)
    solution = solve_ivp(
        lambda _, w: -gain @ (w - target), (0, 1), w0, rtol=1e-9, atol=1e-11
    )
    assert_allclose(relaxation.after(w0, target, 1.0), solution.y[:, -1], atol=1e-7)


def test_lqr_cost_is_least_at_the_closed_form():
    g = component()
    sigma, tau = dense_paper.dense(g), 1.5
    rho = tau**2 / np.linalg.eigvalsh(sigma)[-1]
    gain, x0 = lqr_gain(g, tau), start(g) - g.mean

    def cost(k):
        # Lyapunov: the integral over all time of x'(Q + rho K'K)x, with dx = -Kx.
        values, vectors = np.linalg.eigh(k)
        weight = vectors.T @ (np.linalg.inv(sigma) + rho * k @ k) @ vectors
        x = vectors.T @ x0
        return x @ (weight / (values[:, None] + values[None, :])) @ x

    direction = np.diag(np.random.default_rng(0).uniform(-1, 1, g.dim))
    for step in (-0.05, 0.05):
        assert cost(gain + step * direction) > cost(gain)


def test_relaxing_twice_is_relaxing_for_the_sum():
    g = component()
    relaxation = LqrTracker().relaxation(g, n_steps=16, tick=TICK)
    w0 = start(g)
    twice = relaxation.after(relaxation.after(w0, g.mean, 0.3), g.mean, 0.5)
    assert_allclose(twice, relaxation.after(w0, g.mean, 0.8), atol=1e-12)


def test_lqr_time_constants_follow_the_standard_deviations():
    g = component(noise=1e-6)
    tracker = LqrTracker(time_constant=2.0, shortest=0.3)
    relaxation = tracker.relaxation(g, n_steps=16, tick=TICK)
    eigenvalues = g.variances + g.noise
    for i, eigenvalue in enumerate(eigenvalues):
        tau = max(2.0 * np.sqrt(eigenvalue / eigenvalues[0]), 0.3)
        w = relaxation.after(g.mean + g.basis[:, i], g.mean, tau)
        assert_allclose(w - g.mean, g.basis[:, i] / np.e, atol=1e-12)
    # What no demonstration showed returns in the shortest time.
    residual = start(g) - g.mean
    residual -= g.basis @ (g.basis.T @ residual)
    w = relaxation.after(g.mean + residual, g.mean, 0.3)
    assert_allclose(w - g.mean, residual / np.e, atol=1e-12)


def test_lqr_tracks_a_component_without_a_factor():
    g = LowRankGaussian(
        mean=np.zeros(8), basis=np.zeros((8, 0)), variances=np.zeros(0), noise=0.1
    )
    relaxation = LqrTracker(time_constant=2.0).relaxation(g, n_steps=8, tick=TICK)
    w = relaxation.after(np.ones(8), g.mean, 2.0)
    assert_allclose(w, 1 / np.e)


@pytest.mark.parametrize("name", ["time_constant", "shortest"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_time_constants_that_are_not_positive_are_refused(name, value):
    with pytest.raises(SkillError, match=f"{name} is .* must be positive"):
        LqrTracker(**{name: value})


# Exponential --------------------------------------------------------------------


def exponential(g, beta):
    return ExponentialTracker(beta=beta).relaxation(g, n_steps=16, tick=TICK)


@pytest.mark.parametrize("seconds", [0.0, 0.013, 0.4, 3.0])
def test_exponential_tracker_solves_its_differential_equation(seconds):
    g = component()
    precision = paper_precision_diagonal(g, n_steps=16)
    beta = 2 / precision.max()
    w0, target = start(g), g.mean + 0.3
    expected = w0
    if seconds > 0:
        expected = solve_ivp(
            lambda _, w: beta * precision * (target - w),
            (0, seconds),
            w0,
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
    relaxed = exponential(g, beta).after(w0, target, seconds)
    assert_allclose(relaxed, expected, atol=1e-8)


def test_exponential_tracker_is_the_limit_of_small_steps_of_17():
    g = component()
    beta = 5 / paper_precision_diagonal(g, n_steps=16).max()
    w0 = start(g)
    exact = exponential(g, beta).after(w0, g.mean, TICK)
    errors = []
    for steps in (1, 10, 100, 1000):
        relaxation = ProportionalTracker(beta=beta).relaxation(
            g, n_steps=16, tick=TICK / steps
        )
        w = w0
        for _ in range(steps):
            w = relaxation.after(w, g.mean, TICK / steps)
        errors.append(np.max(np.abs(w - exact)))
    # First order: a tenth of the step, a tenth of the error.
    assert_allclose(np.divide(errors[1:], errors[:-1]), 0.1, rtol=0.3)
    assert errors[-1] < 1e-3 * np.max(np.abs(w0 - g.mean))


def test_exponential_tracker_uses_the_diagonal_of_the_papers_precision(
    small_skill, paper_mixture
):
    skill, beta, seconds = small_skill, 1e-9, 0.7
    _, mu, sigma = paper_mixture(skill)
    ours = skill.basis.analyze(skill.sample(seed=4)[0])
    paper = skill.basis.to_paper(ours)
    for j, gaussian in enumerate(skill.components_):
        relaxation = ExponentialTracker(beta=beta).relaxation(
            gaussian, n_steps=skill.n_steps, tick=TICK
        )
        rates = beta * np.diag(np.linalg.inv(sigma[j]))
        expected = mu[j] + np.exp(-rates * seconds) * (paper - mu[j])
        got = relaxation.after(ours, gaussian.mean, seconds)
        assert_allclose(skill.basis.to_paper(got), expected, atol=1e-8)


@pytest.mark.parametrize("beta", [1e3, 1e9, 1e30, 1e90])
def test_exponential_tracker_is_stable_for_any_gain(beta):
    g = component()
    relaxation = exponential(g, beta)
    w = start(g)
    for _ in range(100):
        before, w = w, relaxation.after(w, g.mean, TICK)
        assert np.all(np.abs(w - g.mean) <= np.abs(before - g.mean))
    assert_allclose(w, g.mean, atol=1e-12)
    assert np.all(np.isfinite(relaxation.after(start(g), g.mean, 0.0)))


@pytest.mark.parametrize("beta", [0.0, -1.0, np.nan, np.inf, "high", None])
def test_exponential_gain_that_is_not_positive_is_refused(beta):
    with pytest.raises(SkillError, match=f"beta is {beta!r}; it must be positive"):
        ExponentialTracker(beta=beta)
