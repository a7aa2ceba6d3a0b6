"""Time of learning, and the held-out log-likelihood.

The literal model is scikit-learn's full-covariance mixture on the paper's 2TD = 720
weights (6) of a window. It has a density over weights, half of whose dimensions
describe no real signal, and this package one over trajectories. They become
comparable by the literal model's marginal over trajectories y = Re(Phi) w: a component
N(mu, Sigma) of the weights is N(Re(Phi) mu, Re(Phi) Sigma Re(Phi)') of the TD samples.
Re(Phi) Re(Phi)' = I / T, so the regulariser T * eps of the weights is eps of every
sample: with `reg_covar` = T * eps both models regularise trajectories alike. The density
of the samples is that of the orthonormal weights, an isometry.
"""

import warnings
from time import perf_counter

import dense_paper
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture
from tube import bundled

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.data.windows import as_windows
from fmp_drake.primitives.model.movement_primitive import PAPER_SETTINGS

SECTION = "Learning from the bundled 8 (3 minutes)"
LEARN_SECONDS = 120


@pytest.fixture
def table(figures):
    figures.section = SECTION
    return figures


def part(demonstration, begin, end):
    """Return the seconds from begin to end of a demonstration."""
    keep = (demonstration.time >= begin) & (demonstration.time < end)
    return Demonstration(
        time=demonstration.time[keep], values=demonstration.values[keep]
    )


def papers_windows(demonstration):
    return as_windows([demonstration], n_steps=120, stride=10, rate=20.0).values


def fit_literally(windows, *, regularization):
    """Fit scikit-learn's mixture to the paper's 2TD weights."""
    t = windows.shape[1]
    weights = np.array([dense_paper.weights_of(window) for window in windows])
    model = GaussianMixture(10, reg_covar=t * regularization, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return model.fit(weights)


def literal_score(model, windows):
    """Return the mean log density of windows per time step, see above."""
    t, d = windows.shape[1:]
    phi = dense_paper.phi_of(range(t), t, d).real
    y = np.array([dense_paper.stacked(window) for window in windows])
    each = [
        np.log(pi) + multivariate_normal(phi @ mu, phi @ sigma @ phi.T).logpdf(y)
        for pi, mu, sigma in zip(
            model.weights_, model.means_, model.covariances_, strict=True
        )
    ]
    return logsumexp(each, axis=0).mean() / t


def test_literal_density_over_trajectories_is_the_same_for_one_component(benchmark):
    x = np.random.default_rng(0).standard_normal((60, 12, 2))
    weights = np.array([dense_paper.weights_of(window) for window in x])
    model = GaussianMixture(1, reg_covar=12 * 1e-2).fit(weights)
    skill = FourierMovementPrimitive(
        n_steps=12, overlap=2, n_components=1, explained_variance=1.0,
        regularization=1e-2, shrinkage=0.0,
    ).fit(x)  # fmt: skip
    held_out = np.random.default_rng(1).standard_normal((9, 12, 2))
    score = benchmark.pedantic(skill.score, args=(held_out,), rounds=1)
    assert_allclose(literal_score(model, held_out), score, rtol=1e-6)


def test_fit(benchmark, table, median):
    demonstration = bundled("eight")
    skill = FourierMovementPrimitive(**PAPER_SETTINGS)
    benchmark.pedantic(skill.fit, args=(demonstration,), rounds=5, warmup_rounds=1)
    windows = papers_windows(demonstration)
    begin = perf_counter()
    fit_literally(windows, regularization=skill.regularization)
    literal = perf_counter() - begin
    table.add("fit, M = 10, 349 windows 10 samples apart", median() * 1e3, "ms")
    table.add("scikit-learn's full mixture on 720 weights", literal * 1e3, "ms")
    table.add("scikit-learn's / fit", literal / median(), above=10)


def test_fit_with_the_defaults(benchmark, table, median):
    demonstration = bundled("eight")
    skill = FourierMovementPrimitive()
    benchmark.pedantic(skill.fit, args=(demonstration,), rounds=5, warmup_rounds=1)
    table.add(
        f"fit with the defaults, M = 80, {skill.n_windows_} windows",
        median() * 1e3,
        "ms",
    )


def test_fit_of_the_phase_model(benchmark, table, median):
    demonstration = bundled("eight")
    skill = FourierMovementPrimitive(model="phase")
    benchmark.pedantic(skill.fit, args=(demonstration,), rounds=3, warmup_rounds=1)
    table.add(
        f"fit of the phase model, M = {len(skill.components_)}, "
        f"{skill.phase_model_.cycles:.0f} cycles",
        median() * 1e3,
        "ms",
        below=4000,
    )


def test_held_out_log_likelihood(benchmark, table):
    demonstration = bundled("eight")
    learned = part(demonstration, 0, LEARN_SECONDS)
    rest = part(demonstration, LEARN_SECONDS, np.inf)
    skill = FourierMovementPrimitive(**PAPER_SETTINGS)
    benchmark.pedantic(skill.fit, args=(learned,), rounds=1)
    windows, held_out = papers_windows(learned), papers_windows(rest)
    default = FourierMovementPrimitive().fit(learned)
    table.section = (
        "Log-likelihood of the third minute of the 8, learned from two (nats per time "
        "step)"
    )
    # The second literal model gets the variance that our fit gives to all directions:
    # the regularization and what the principal directions leave out.
    reached = []
    for name, regularization in (
        ("as regularised", skill.regularization),
        ("with the isotropic variance of the fit", skill.components_[0].noise),
    ):
        literal = fit_literally(windows, regularization=regularization)
        reached.append(literal_score(literal, held_out))
        table.add(f"literal, M = 10, {name}", reached[-1])
        table.add(f"literal, {name}, its own minutes", literal_score(literal, windows))
    for name, model in (("fit, M = 10", skill), ("fit with the defaults", default)):
        table.add(name, model.score(held_out), above=max(reached), digits=4)
        table.add(f"{name}, its own minutes", model.score(windows))
