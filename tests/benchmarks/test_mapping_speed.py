"""Time of one mapping, compared with the paper's formula, and of one evaluation."""

from time import perf_counter

import dense_paper
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tube import bundled

from fmp_drake.primitives import FourierMovementPrimitive, Keypoint, Player
from fmp_drake.primitives.model.movement_primitive import PAPER_SETTINGS
from fmp_drake.primitives.playback.motion import segment_motion

SECTION = "One mapping and one evaluation (T = 120, D = 3, K = 10, bundled 8)"


@pytest.fixture(scope="module")
def skill():
    """M = 10 and windows 10 samples apart, as in the paper."""
    return FourierMovementPrimitive(**PAPER_SETTINGS).fit(bundled("eight"))


@pytest.fixture(scope="module")
def default_skill():
    return FourierMovementPrimitive().fit(bundled("eight"))


@pytest.fixture
def table(figures):
    figures.section = SECTION
    return figures


def fastest(use, rounds):
    """Return the least seconds of some rounds."""
    times = []
    for _ in range(rounds):
        begin = perf_counter()
        use()
        times.append(perf_counter() - begin)
    return min(times)


def literal_mapping(y, rows, pi, mu, precision, lam):
    """(14) to (16) on 2TD weights, with the inverse covariances given.

    Kinder than the printed formulas: those invert Sigma_j twice per component.
    """
    seen = (rows.conj().T @ rows).real
    right = (rows.conj().T @ y).real
    best, least = None, np.inf
    for j in range(len(pi)):
        left = seen + lam * precision[j]
        w = np.linalg.solve(left, right + lam * precision[j] @ mu[j])
        delta = w - mu[j]
        cost = np.linalg.norm(y - rows @ w) ** 2 - lam * np.log(pi[j])
        cost += lam * delta @ precision[j] @ delta
        if cost < least:
            best, least = w, cost
    return best


def test_mapping(benchmark, table, skill, paper_mixture, median):
    y = bundled("eight").values[1000:1010]
    plan = skill.mapping_plan(np.arange(10))
    observed = y.ravel()
    mapping = benchmark(plan.map, observed)

    pi, mu, sigma = paper_mixture(skill)
    precision = [np.linalg.inv(s) for s in sigma]
    rows = dense_paper.phi_of(range(10), 120, 3)
    lam = skill.tolerance
    stacked = dense_paper.stacked(y)
    w = literal_mapping(stacked, rows, pi, mu, precision, lam)
    assert_allclose(skill.basis.to_paper(mapping.weights), w, atol=1e-5)
    given = fastest(lambda: literal_mapping(stacked, rows, pi, mu, precision, lam), 3)
    printed = fastest(
        lambda: dense_paper.map_partial(stacked, rows, pi, mu, sigma, lam), 1
    )
    table.add("mapping, M = 10", median() * 1e6, "us", below=20)
    table.add("literal (14)-(15) on 720 weights, Sigma^-1 given", given * 1e3, "ms")
    table.add("literal (14)-(15) as printed", printed * 1e3, "ms")
    table.add("literal (Sigma^-1 given) / mapping", given / median(), above=5000)
    table.add("literal as printed / mapping", printed / median(), above=5000)


def test_mapping_with_the_default_80_components(
    benchmark, table, default_skill, median
):
    plan = default_skill.mapping_plan(np.arange(10))
    benchmark(plan.map, bundled("eight").values[1000:1010].ravel())
    table.add("mapping, M = 80 (default)", median() * 1e6, "us")


def test_mapping_with_the_phase_model(benchmark, table, median):
    skill = FourierMovementPrimitive(model="phase").fit(bundled("eight"))
    plan = skill.mapping_plan(np.arange(10))
    benchmark(plan.map, bundled("eight").values[1000:1010].ravel())
    table.add(
        f"mapping, phase model, M = {len(skill.components_)}",
        median() * 1e6,
        "us",
        below=20,
    )


def test_mapping_with_new_keypoints(benchmark, table, skill, median):
    values = bundled("eight").values
    points = [
        Keypoint(step=0, values=values[0]),
        Keypoint(step=31.7, values=values[32][:2], channels=["x", "y"]),
        Keypoint(step=80, values=[0.1], channels=["x"], derivative=1, tolerance=1e-4),
    ]
    benchmark(skill.map_keypoints, points)
    table.add("mapping of 3 new keypoints, M = 10", median() * 1e6, "us", below=1000)


@pytest.fixture
def moving(default_skill):
    """A player and a state that is not yet back on its path."""
    player = Player(default_skill)
    state = player.start(default_skill.extent_[1] + 0.1)
    return player, player.advance(state, 5 * player.tick_seconds)


def test_evaluation(benchmark, table, moving, median):
    player, state = moving
    segment = player.segment(state)
    benchmark(segment_motion, segment, 0.0173)
    table.add(
        "position, velocity, acceleration (segment_motion)",
        median() * 1e6,
        "us",
        below=15,
    )


def test_preparation_of_a_segment(benchmark, table, moving, median):
    player, state = moving
    benchmark(player.segment, state)
    table.add("preparation of a segment, once a tick", median() * 1e6, "us")


def test_tick(benchmark, table, moving, median):
    player, state = moving
    benchmark(player.advance, state, player.tick_seconds)
    table.add("one tick", median() * 1e6, "us")


def test_remapping(benchmark, table, moving, median):
    player, state = moving
    benchmark(player.remap, state)
    table.add("one re-mapping, M = 80", median() * 1e6, "us")


def test_covariance(benchmark, table, moving, median):
    player, state = moving
    benchmark(player.covariance, state)
    table.add("one covariance (18)", median() * 1e6, "us")
