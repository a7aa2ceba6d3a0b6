"""Facts about the mapping of partial trajectories: Algorithm 1."""

import pickle

import dense_paper
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from fmp_drake.errors import SkillError
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.mapping import MappingPlan


def candidates_of(components, y, **options):
    """Return the weights (14) of every component, as if it were the only one."""
    plans = [MappingPlan(np.ones(1), (c,), **options) for c in components]
    return np.stack([plan.map(y).weights for plan in plans])


def observations(skill, k, count=6, spread=0.02):
    """Return partial trajectories (count, K, D) near and off the demonstrations."""
    rng = np.random.default_rng(k)
    y = skill.sample(count, seed=k, with_noise=False)[:, :k]
    return y + spread * rng.standard_normal((count, 1, y.shape[2]))


@pytest.mark.parametrize("fixture", ["small_skill", "odd_skill"])
@pytest.mark.parametrize("k", [1, 4, 12])
def test_candidates_costs_and_choice_are_those_of_14_to_16(
    fixture, k, paper_mixture, request
):
    skill = request.getfixturevalue(fixture)
    t, d, lam = skill.n_steps, skill.n_channels_, 1e-6
    pi, mu, sigma = paper_mixture(skill)
    rows = dense_paper.phi_of(range(k), t, d)
    options = {"rows": skill.observation_rows(np.arange(k)), "tolerance": lam}
    plan = MappingPlan(pi, skill.components_, **options)
    for y in observations(skill, k):
        w, j, candidates, costs = dense_paper.map_partial(
            dense_paper.stacked(y), rows, pi, mu, sigma, lam
        )
        mapping = plan.map(y.ravel())
        assert mapping.component == j
        assert_allclose(mapping.costs, np.array(costs) / lam, rtol=1e-6)
        ours = candidates_of(skill.components_, y.ravel(), **options)
        for mine, theirs in zip(ours, candidates, strict=True):
            trajectory = dense_paper.phi_of(range(t), t, d) @ theirs
            assert_allclose(trajectory.imag, 0, atol=1e-9)
            assert_allclose(
                dense_paper.stacked(skill.basis.synthesize(mine)),
                trajectory.real,
                atol=1e-7,
            )
            window = dense_paper.window_of(theirs, d)
            assert_allclose(mine, skill.basis.analyze(window), atol=1e-7)
        assert_allclose(skill.basis.to_paper(mapping.weights), w, atol=1e-6)


def test_complex_normal_equations_only_loosen_the_observation(
    small_skill, paper_mixture
):
    # (14) as printed may also explain y by imaginary weights, of which the
    # regulariser allows T * noise: the same as a tolerance larger by `noise`.
    skill, k, lam = small_skill, 4, 1e-6
    noise = skill.components_[0].noise
    pi, mu, sigma = paper_mixture(skill)
    rows = dense_paper.phi_of(range(k), skill.n_steps, 2)
    options = {"rows": skill.observation_rows(np.arange(k)), "tolerance": lam + noise}
    plan = MappingPlan(pi, skill.components_, **options)
    for y in observations(skill, k):
        _, j, candidates, costs = dense_paper.map_partial(
            dense_paper.stacked(y),
            rows,
            pi,
            mu,
            sigma,
            lam,
            solve=dense_paper.candidate_as_printed,
        )
        mapping = plan.map(y.ravel())
        assert mapping.component == j
        assert_allclose(mapping.costs, np.array(costs) / lam, rtol=1e-6)
        ours = candidates_of(skill.components_, y.ravel(), **options)
        ours = skill.basis.synthesize(ours)
        theirs = [dense_paper.window_of(np.real(w), 2) for w in candidates]
        assert_allclose(ours, theirs, atol=1e-7)


def test_partial_trajectories_may_start_anywhere(small_skill, paper_mixture):
    skill = small_skill
    pi, mu, sigma = paper_mixture(skill)
    rows = dense_paper.phi_of(range(7, 12), skill.n_steps, 2)
    y = observations(skill, 5)[0]
    w, j, _, _ = dense_paper.map_partial(
        dense_paper.stacked(y), rows, pi, mu, sigma, skill.tolerance
    )
    mapping = skill.map_partial(y, first_step=7)
    assert mapping.component == j
    window = dense_paper.window_of(w, 2)
    assert_allclose(mapping.weights, skill.basis.analyze(window), atol=1e-7)


def test_mapped_trajectory_meets_the_observation(wiping_skill):
    y = observations(wiping_skill, 10)
    for window in y:
        mapping = wiping_skill.map_partial(window)
        mean = wiping_skill.components_[mapping.component].mean
        met, expected = (
            wiping_skill.synthesize(weights)[:10] for weights in (mapping.weights, mean)
        )
        # lambda = 1e-8 and the isotropic noise leave a tenth of the residual of the
        # component.
        assert np.abs(met - window).max() < 0.1 * np.abs(window - expected).max()


@st.composite
def problems(draw):
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    n, m = draw(st.integers(2, 12)), draw(st.integers(1, 5))
    count = draw(st.integers(1, 4))
    components = []
    for _ in range(count):
        r = rng.integers(0, n + 1)
        basis, _ = np.linalg.qr(rng.standard_normal((n, n)))
        components.append(
            LowRankGaussian(
                mean=rng.standard_normal(n),
                basis=np.ascontiguousarray(basis[:, :r]),
                variances=rng.uniform(0.1, 10, r),
                noise=rng.uniform(0.01, 1),
            )
        )
    return (
        rng.dirichlet(np.ones(count)),
        tuple(components),
        rng.standard_normal((m, n)),
        rng.uniform(0.01, 1, m),
        rng.standard_normal(m),
    )


@settings(deadline=None, max_examples=60)
@given(problems())
def test_keypoints_with_a_tolerance_each_are_posterior_means(problem):
    pi, components, rows, tolerance, y = problem
    plan = MappingPlan(pi, components, rows=rows, tolerance=tolerance)
    expected = []
    for c in components:
        cross = rows @ dense_paper.dense(c)
        observed = cross @ rows.T + np.diag(tolerance)
        expected.append(c.mean + cross.T @ np.linalg.solve(observed, y - rows @ c.mean))
    ours = candidates_of(components, y, rows=rows, tolerance=tolerance)
    assert_allclose(ours, expected, rtol=1e-8, atol=1e-8)
    mapping = plan.map(y)
    assert_allclose(mapping.weights, expected[mapping.component], atol=1e-8)
    # (15), each square weighed by its own tolerance, divided by lambda.
    costs = [
        np.sum((y - rows @ w) ** 2 / tolerance)
        - np.log(p)
        + float(c.mahalanobis_squared(w))
        for w, p, c in zip(expected, pi, components, strict=True)
    ]
    assert_allclose(mapping.costs, costs, rtol=1e-8)
    assert mapping.component == int(np.argmin(costs))


def plan_of_two(**changes):
    component = LowRankGaussian(
        mean=np.zeros(3), basis=np.eye(3)[:, :1], variances=np.ones(1), noise=0.1
    )
    options = {"rows": np.eye(3)[:2], **changes}
    return MappingPlan(np.array([0.5, 0.5]), (component, component), **options)


def test_first_of_equal_components_is_chosen():
    assert plan_of_two().map([1.0, 2.0]).component == 0


def test_one_row_may_be_given_as_a_vector():
    assert plan_of_two(rows=np.eye(3)[0]).map([1.0]).weights.shape == (3,)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, [1.0, 0.0]])
def test_tolerance_that_is_not_positive_is_refused(tolerance):
    with pytest.raises(SkillError, match="must be positive"):
        plan_of_two(tolerance=tolerance)


def test_observation_of_another_length_is_refused():
    with pytest.raises(SkillError, match=r"shape \(3,\); expected \(2,\)"):
        plan_of_two().map(np.zeros(3))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_observation_that_is_not_finite_is_refused(bad):
    with pytest.raises(SkillError, match="NaN or infinite"):
        plan_of_two().map([0.0, bad])


def test_nearly_dependent_observations_are_refused():
    component = LowRankGaussian(
        mean=np.zeros(3), basis=np.eye(3)[:, :1], variances=np.array([1e12]), noise=1e-9
    )
    rows = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    with pytest.raises(SkillError, match="depend on each other more closely than"):
        MappingPlan(np.ones(1), (component,), rows=rows, tolerance=1e-9)


def test_players_of_one_skill_share_their_plans_until_it_is_learned_again():
    windows = np.random.default_rng(0).standard_normal((40, 12, 1))
    skill = FourierMovementPrimitive(n_steps=12, overlap=4, n_components=2)
    skill.fit(windows)
    plan = skill.mapping_plan([0, 1])
    assert skill.mapping_plan([0, 1]) is plan
    assert skill.mapping_plan([0, 1], tolerance=1e-3) is not plan
    copied = pickle.loads(pickle.dumps(skill))
    assert "_plans" not in vars(copied)
    before = plan.map([0.1, 0.2]).weights
    np.testing.assert_array_equal(
        copied.mapping_plan([0, 1]).map([0.1, 0.2]).weights, before
    )
    skill.fit(2.0 * windows[::-1])
    after = skill.mapping_plan([0, 1]).map([0.1, 0.2]).weights
    assert not np.allclose(after, before)
    # Only three are kept.
    for step in range(3):
        skill.mapping_plan([step + 2])
    assert skill.mapping_plan([0, 1]) is not plan
