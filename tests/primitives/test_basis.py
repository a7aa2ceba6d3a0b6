"""Facts about the Fourier basis."""

import dense_paper
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from fmp_drake.errors import SkillError
from fmp_drake.primitives import FourierBasis

LENGTHS = [8, 9, 24, 25]
# A smooth movement that does not close on itself, as a demonstrated window.
SMOOTH = {
    0: lambda s: 0.1 * np.sin(0.21 * s) + 0.001 * s,
    1: lambda s: 0.021 * np.cos(0.21 * s) + 0.001,
    2: lambda s: -0.00441 * np.sin(0.21 * s),
}


def windows(t, channels=2, count=3, seed=0):
    return np.random.default_rng(seed).standard_normal((count, t, channels))


@settings(deadline=None, max_examples=50)
@given(t=st.integers(8, 60), d=st.integers(1, 4), seed=st.integers(0, 1000))
def test_analysis_and_synthesis_undo_each_other(t, d, seed):
    basis = FourierBasis(t)
    y = windows(t, d, seed=seed)
    w = basis.analyze(y)
    assert w.shape == (3, t * d)
    assert_allclose(basis.synthesize(w), y, atol=1e-12)
    assert_allclose(basis.analyze(basis.synthesize(w)), w, atol=1e-12)


@pytest.mark.parametrize("t", LENGTHS)
def test_basis_is_orthonormal(t):
    rows = FourierBasis(t).series(np.arange(t))
    assert_allclose(rows @ rows.T, np.eye(t), atol=1e-13)
    assert_allclose(rows.T @ rows, np.eye(t), atol=1e-13)


@pytest.mark.parametrize("t", LENGTHS)
def test_analysis_keeps_inner_products(t):
    a, b = windows(t, 3, 2)
    basis = FourierBasis(t)
    assert basis.analyze(a) @ basis.analyze(b) == pytest.approx(np.sum(a * b))


@pytest.mark.parametrize("t", LENGTHS)
def test_weights_have_the_documented_order(t):
    n = np.arange(t)
    columns = [np.full(t, 1 / np.sqrt(t))]
    for k in range(1, (t + 1) // 2):
        columns.append(np.sqrt(2 / t) * np.cos(2 * np.pi * k * n / t))
        columns.append(np.sqrt(2 / t) * np.sin(2 * np.pi * k * n / t))
    if t % 2 == 0:
        columns.append((-1.0) ** n / np.sqrt(t))
    basis = FourierBasis(t)
    assert_allclose(basis.series(n), np.column_stack(columns), atol=1e-13)
    y = windows(t, 1, 1)[0]
    assert_allclose(basis.analyze(y), np.column_stack(columns).T @ y[:, 0])


@pytest.mark.parametrize("t", LENGTHS)
def test_map_to_the_paper_is_its_equations_1_to_8(t):
    basis = FourierBasis(t)
    y = windows(t, 1, 1)[0]
    w_tilde = dense_paper.complex_weights(y[:, 0])
    assert_allclose(dense_paper.psi(t) @ y[:, 0], w_tilde, atol=1e-11)
    assert_allclose(dense_paper.signal(w_tilde), y[:, 0], atol=1e-12)
    paper = basis.to_paper(basis.analyze(y))
    assert_allclose(paper, dense_paper.expanded(w_tilde), atol=1e-11)
    assert_allclose(dense_paper.selector(t) @ paper, w_tilde, atol=1e-11)
    assert_allclose(dense_paper.phi(t) @ paper, y[:, 0], atol=1e-12)


@pytest.mark.parametrize("t", LENGTHS)
def test_map_to_the_paper_stacks_channels_as_19_and_20(t):
    basis = FourierBasis(t)
    y = windows(t, 3, 1)[0]
    paper = basis.to_paper(basis.analyze(y))
    assert_allclose(paper, dense_paper.weights_of(y), atol=1e-11)
    assert_allclose(
        dense_paper.phi_of(range(t), t, 3) @ paper, dense_paper.stacked(y), atol=1e-12
    )


@pytest.mark.parametrize("t", LENGTHS)
def test_map_to_the_paper_is_an_isometry_up_to_root_t(t):
    g = FourierBasis(t).to_paper(np.eye(t)) / np.sqrt(t)
    assert_allclose(g @ g.T, np.eye(t), atol=1e-13)


@pytest.mark.parametrize("t", LENGTHS)
def test_rows_at_the_samples_are_the_series(t):
    basis = FourierBasis(t)
    n = np.arange(t)
    assert_allclose(basis.rows(n), basis.series(n), atol=1e-13)
    assert_allclose(
        basis.rows(n) @ basis.analyze(windows(t, 1, 1)[0]),
        windows(t, 1, 1)[0][:, 0],
        atol=1e-12,
    )


@pytest.mark.parametrize("t", LENGTHS)
def test_local_rows_are_the_rows_and_two_derivatives(t):
    basis = FourierBasis(t)
    ends = [0.0, 1.0, t / 2, t - 2, t - 1]
    inside = np.random.default_rng(0).uniform(0, t - 1, 20)
    for step in [*ends, *inside]:
        expected = [basis.rows(step, order) for order in range(3)]
        assert_allclose(basis.local_rows(step), expected, atol=1e-10)


@pytest.mark.parametrize("t", [24, 25])
@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_of_the_series_are_finite_differences(t, order):
    basis = FourierBasis(t)
    tau = np.random.default_rng(1).uniform(-t, 2 * t, 20)
    h = 1e-5
    slope = (basis.series(tau + h, order - 1) - basis.series(tau - h, order - 1)) / (
        2 * h
    )
    assert_allclose(basis.series(tau, order), slope, atol=1e-7)


@pytest.mark.parametrize("t", [24, 25])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_derivatives_of_the_rows_are_finite_differences(t, order):
    basis = FourierBasis(t)
    tau = np.random.default_rng(1).uniform(0.01, t - 1.01, 20)
    h = 1e-5
    slope = (basis.rows(tau + h, order - 1) - basis.rows(tau - h, order - 1)) / (2 * h)
    assert_allclose(basis.rows(tau, order), slope, atol=1e-6)


def test_series_is_periodic_and_wraps_frequencies():
    basis = FourierBasis(25)
    tau = np.linspace(0, 24, 50)
    assert_allclose(basis.series(tau + 25), basis.series(tau), atol=1e-12)
    # Wrapped to half the rate, a slow cosine stays slow between the samples.
    slow = np.cos(2 * np.pi * np.arange(25) / 25)
    between = basis.series(tau) @ basis.analyze(slow[:, None])
    assert_allclose(between, np.cos(2 * np.pi * tau / 25), atol=1e-12)


@pytest.mark.parametrize(("order", "error"), [(0, 1e-5), (1, 1e-5), (2, 1e-4)])
def test_rows_follow_a_window_that_does_not_close_where_the_series_rings(order, error):
    t = 60
    basis = FourierBasis(t)
    w = basis.analyze(SMOOTH[0](np.arange(t))[:, None])
    tau = np.linspace(0, t - 1, 1001)
    exact = SMOOTH[order](tau)
    assert_allclose(basis.rows(tau, order) @ w, exact, atol=error)
    assert np.max(np.abs(basis.series(tau, order) @ w - exact)) > 100 * error


@pytest.mark.parametrize("step", [-0.1, 23.1, np.nan])
def test_rows_outside_the_window_are_refused(step):
    with pytest.raises(SkillError, match="defined from 0 to 23"):
        FourierBasis(24).rows([1.0, step])


def test_rows_of_no_step_are_refused():
    with pytest.raises(SkillError, match="no step; give at least one"):
        FourierBasis(24).rows([])


def test_windows_shorter_than_8_samples_are_refused():
    with pytest.raises(SkillError, match="at least 8"):
        FourierBasis(7)


def test_samples_and_weights_of_another_length_are_refused():
    basis = FourierBasis(24)
    with pytest.raises(SkillError, match=r"expected \(\.\.\., 24, channels\)"):
        basis.analyze(np.zeros((23, 2)))
    with pytest.raises(SkillError, match="24"):
        basis.analyze(np.zeros(24))
    with pytest.raises(SkillError, match="multiple of n_steps = 24"):
        basis.synthesize(np.zeros(25))
    with pytest.raises(SkillError, match="multiple of n_steps = 24"):
        basis.by_channel(np.zeros(0))
