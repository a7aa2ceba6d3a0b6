"""Facts about the model that knows the phase."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree
from scipy.stats import chi2, multivariate_t

from fmp_drake.errors import DemonstrationError, SkillError, SkillFileError
from fmp_drake.primitives import (
    PAPER_SETTINGS,
    Demonstration,
    FourierMovementPrimitive,
    Player,
    load_skill,
    modulate_skill,
    save_skill,
    scale_tempo,
    transform_space,
)
from fmp_drake.primitives.model.phase.calibration import (
    Calibration,
    calibrate_replay,
    variance_factor,
)
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.eigenvectors import leading_eigenvectors
from fmp_drake.primitives.model.phase.random_processes import (
    Autoregression,
    Residual,
)
from fmp_drake.primitives.model.phase.search import search_rhythm
from fmp_drake.primitives.model.phase.tracking import best_labels, phase_path
from fmp_drake.primitives.model.prediction import (
    Extrapolation,
    Prediction,
    Replay,
    Replayed,
)
from fmp_drake.primitives.model.trajectory_mixture import PredictionPlan

RATE = 20.0
EIGHT = Path(__file__).resolve().parents[2] / "models/demonstrations/eight.npz"


def curve(phase):
    """Return a curve of two channels, 0.2 m wide, that never passes a point twice."""
    x = np.cos(phase) + 0.3 * np.cos(2 * phase)
    y = np.sin(phase) - 0.2 * np.cos(3 * phase)
    return 0.1 * np.column_stack([x, y])


def wavering(count, *, period=50, spread=0.06, seed=0):
    """Return the phase of a movement whose tempo varies."""
    noise = np.random.default_rng(seed).standard_normal(count + 40)
    slow = np.convolve(noise, np.ones(20) / np.sqrt(20), "same")[20:-20]
    return np.cumsum(2 * np.pi / period * (1 + spread * slow))


def recorded(phase, *, seed=1):
    """Return a demonstration at phases, half a millimetre of smooth noise on it."""
    noise = np.random.default_rng(seed).standard_normal((len(phase) + 20, 2))
    smooth = np.stack([np.convolve(n, np.ones(9) / 9, "same") for n in noise.T], 1)
    values = curve(phase) + 1.5e-3 * smooth[10:-10]
    return Demonstration(time=np.arange(len(phase)) / RATE, values=values)


@pytest.fixture(scope="module")
def eight():
    """The bundled 8, and what is learned from its first two thirds."""
    y = Demonstration.load(EIGHT).resample(RATE).values
    known, held = y[: 2 * len(y) // 3], y[2 * len(y) // 3 :]
    demonstration = Demonstration(time=np.arange(len(known)) / RATE, values=known)
    return FourierMovementPrimitive(model="phase").fit(demonstration), known, held


@pytest.fixture(scope="module")
def small():
    phase = wavering(900)
    skill = FourierMovementPrimitive(n_steps=60, overlap=6, model="automatic")
    return skill.fit(recorded(phase)), phase


# Eigenvectors ------------------------------------------------------------


@pytest.mark.parametrize(("size", "count"), [(2, 1), (24, 7), (150, 149)])
def test_leading_eigenvectors_are_those_of_all(size, count):
    factor = np.random.default_rng(size).standard_normal((size, size))
    matrix = factor @ (np.logspace(0, -8, size)[:, None] * factor.T)
    values, vectors = leading_eigenvectors(matrix.copy(), count)
    all_values, all_vectors = np.linalg.eigh(matrix)
    assert_allclose(values, all_values[-count:], rtol=1e-9, atol=1e-13)
    assert_allclose(vectors.T @ vectors, np.eye(count), atol=1e-12)
    expected = (all_vectors * all_values)[:, -count:] @ all_vectors[:, -count:].T
    assert_allclose((vectors * values) @ vectors.T, expected, atol=1e-12)


def test_a_skill_does_not_depend_on_the_number_of_threads(monkeypatch):
    skills = []
    for cores in (1, 3):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        skill = FourierMovementPrimitive(n_steps=60, overlap=6, model="automatic")
        skills.append(skill.fit(recorded(wavering(900))))
    for one, other in zip(*(skill.components_ for skill in skills), strict=True):
        assert np.array_equal(one.mean, other.mean)
        assert np.array_equal(one.basis, other.basis)
        assert np.array_equal(one.variances, other.variances)


# Tracking ---------------------------------------------------------------


def test_the_cheapest_path_is_the_one_that_trying_all_finds():
    rng = np.random.default_rng(0)
    cost, step_cost = rng.random((5, 6)), np.array([0.5, 0.0, 0.7])
    step_costs, never = np.tile(step_cost, (5, 1)), np.full(5, np.inf)
    labels, states, least = best_labels(cost[None].copy(), step_costs, never, np.inf)

    def price(first, by):
        states = (first + np.concatenate([[0], np.cumsum(by)])) % 6
        return cost[np.arange(5), states].sum() + step_cost[list(by)].sum()

    every = min(price(first, by) for first in range(6) for by in np.ndindex(3, 3, 3, 3))
    assert not labels.any()
    assert price(states[0], np.diff(states) % 6) == pytest.approx(every)
    assert least == pytest.approx(every)


def test_phase_is_tracked_through_a_wavering_tempo():
    phase = wavering(900, spread=0.12)
    track = search_rhythm([recorded(phase).values], rate=RATE).track
    off = track.phases[0] - phase
    assert track.cycles == pytest.approx((phase[-1] - phase[0]) / (2 * np.pi), abs=0.1)
    # The zero of the phase is anywhere.
    assert np.std(off) < 0.1


def test_slow_shifts_of_the_centre_do_not_bend_the_phase():
    phase = wavering(900)
    moved = recorded(phase).values.copy()
    moved[:, 0] += 0.03 * np.sin(np.linspace(0, 6, 900))
    track = search_rhythm([moved], rate=RATE).track
    assert np.std(track.phases[0] - phase) < 0.15
    assert track.shifts[0][:, 0].std() > 0.01


def test_phase_is_tracked_where_the_tempo_changes_by_a_third():
    phase = np.cumsum(2 * np.pi / 50 * (1 + 0.35 * np.sin(np.arange(1800) / 90)))
    track = search_rhythm([recorded(phase).values], rate=RATE).track
    assert track.cycles == pytest.approx((phase[-1] - phase[0]) / (2 * np.pi), abs=0.1)
    assert np.std(track.phases[0] - phase) < 0.1


def test_a_pause_is_cut_out():
    phase = wavering(900)
    phase = np.concatenate([phase[:400], np.full(100, phase[400]), phase[400:]])
    found = search_rhythm([recorded(phase).values], rate=RATE)
    assert len(found.track.recordings) == 2
    (pause,) = found.rhythm.left_out
    assert pause.kind == "pause"
    assert (pause.start, pause.end) == pytest.approx((20, 25), abs=0.3)


def test_phase_of_seen_samples_is_that_of_the_cycle():
    around = np.linspace(0, 6.2, 200)
    cycle = Cycle.fit([around], [curve(around)], harmonics=5)
    phase = 1.0 + 0.13 * np.arange(30)
    found = phase_path(curve(phase), cycle, velocity=0.12)
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * phase), atol=0.02)


# Which model ------------------------------------------------------------


def test_automatic_takes_the_phase_where_there_are_cycles(small):
    skill, phase = small
    assert skill.model_ == "phase"
    assert "cycles" in skill.model_reason_
    assert skill.period_ == pytest.approx(
        2 * np.pi / np.diff(phase).mean() / RATE, 0.02
    )


def test_many_channels_are_learned_by_the_mixture_or_refused_with_what_to_do():
    angle = np.arange(400)[:, None] * 2 * np.pi / 40
    values = np.cos(angle + np.arange(30))
    skill = FourierMovementPrimitive(n_steps=60, rate=20, n_components=40, overlap=6)
    assert skill.fit(values).model_ == "mixture"
    assert "60 samples of 30 channels has 1800 values" in skill.model_reason_
    skill.set_params(model="phase")
    with pytest.raises(DemonstrationError, match=r"at most 1500.*choose fewer chan"):
        skill.fit(values)


def test_automatic_takes_the_mixture_without_a_repeated_cycle_and_reports_why():
    demonstration = recorded(wavering(62, period=80))
    skill = FourierMovementPrimitive(n_steps=60, overlap=6, model="automatic")
    skill.fit(demonstration)
    assert skill.model_ == "mixture"
    assert "the phase cannot be tracked" in skill.model_reason_
    with pytest.raises(SkillError, match="has no phase"):
        skill.phase(demonstration.values)
    skill.set_params(model="phase")
    with pytest.raises(DemonstrationError, match="no phase that could be learned"):
        skill.fit(demonstration)


def test_a_centre_that_wanders_farther_than_the_movement_is_refused():
    values = recorded(wavering(700)).values
    ramp = np.linspace(0, 0.6, 700)[:, None] * [1.0, 0.0]
    with pytest.raises(
        DemonstrationError, match=r"centre of its cycles wanders, .* at most 50 %"
    ):
        search_rhythm([values + ramp], rate=RATE)


@pytest.mark.parametrize(("apart", "noise"), [(0.035, 0.0), (0.017, 0.011)])
def test_two_strokes_that_differ_are_one_cycle(apart, noise):
    phase = wavering(600, period=100)
    values = curve(2 * phase)
    values[:, 0] += apart * np.cos(phase)
    values += noise * np.random.default_rng(5).standard_normal(values.shape)
    assert search_rhythm([values], rate=RATE).track.cycles == pytest.approx(6, abs=0.1)


def test_phase_of_samples_on_the_cycle_is_exact():
    phase = 2 * np.pi * np.arange(100) / 50
    cycle = Cycle.fit([phase], [curve(phase)], harmonics=6)
    found = phase_path(cycle.values(phase), cycle, velocity=phase[1])
    np.testing.assert_allclose(found, phase, atol=1e-9)


@pytest.mark.parametrize("derivative", [0, 1, 2, 3])
def test_a_cycle_has_the_same_values_at_few_and_at_many_phases(derivative):
    phase = 0.05 * np.arange(200)
    cycle = Cycle.fit([phase], [curve(phase)], harmonics=6)
    each = [cycle.values(x, derivative) for x in phase]
    assert_allclose(cycle.values(phase, derivative), each, atol=1e-11)


@pytest.mark.parametrize("cycles", [1.7, 2.7, 4.3])
def test_few_cycles_are_played_as_smoothly_as_they_were_shown(cycles):
    phase = 2 * np.pi * np.arange(0, cycles, 1 / 40)
    shown = curve(phase) + 0.02 * (phase / phase[-1])[:, None]
    found = Cycle.fit([phase], [shown], harmonics=18, has_soft_ends=True)
    order = np.repeat(np.arange(1, 19), 2)
    fast = found.coefficients[1:][order > 8]
    # With equal weights it is 0.4 to 1.2 mm, as the mean of the passes jumps.
    assert np.sqrt(np.sum(fast**2)) < 2e-5
    middle = np.abs(found.values(phase) - shown)[len(phase) // 4 : -len(phase) // 4]
    assert np.max(middle) < 0.006


def test_few_cycles_that_drift_are_played_without_shaking():
    phase = 2 * np.pi * np.arange(0, 2.7, 1 / 40)
    shown = curve(phase) + 0.03 * (phase / phase[-1])[:, None]
    demonstration = Demonstration(time=np.arange(len(shown)) / RATE, values=shown)
    player = Player(FourierMovementPrimitive(model="phase").fit(demonstration))
    state, played = player.start(shown[0]), []
    for _ in range(600):
        state = player.advance(state, 1 / RATE)
        played.append(player.motion(state)[0])

    def shaking(values):
        return np.sqrt(np.mean(np.diff(values, n=4, axis=0) ** 2))

    # With a mean that jumps at the ends of the recording it is 4.7 times as much.
    assert shaking(np.array(played[40:])) < 1.5 * shaking(shown)


def test_residual_of_few_cycles_varies_as_much_and_as_smoothly_as_it_was_shown():
    rng = np.random.default_rng(3)
    phase = 2 * np.pi * np.arange(0, 2.6, 1 / 40)
    slow = np.cumsum(np.cumsum(rng.standard_normal((len(phase) + 60, 7)), 0), 0)
    shown = slow[:-60] - slow[60:]
    shown = 0.01 * (shown - shown.mean(axis=0)) / shown.std()
    residual = Residual.fit([phase], [shown])
    drawn = residual.process.sample(rng.standard_normal((50, 2000, 7)))
    # With D^2 coefficients per lag it is 0.28, and 80 times as rough.
    assert np.std(drawn) == pytest.approx(1.0, abs=0.15)

    def roughness(values):
        jerk = np.diff(values, n=3, axis=-2)
        return np.sqrt(np.mean(jerk**2) / np.mean(values**2))

    assert 0.3 < roughness(drawn) / roughness(shown) < 3


def test_a_stroke_in_the_middle_of_a_recording_weighs_as_much_as_the_rest():
    t = np.arange(200)
    stroke = np.sin(2 * np.pi * t / 8) * (np.abs(t - 100) < 12)
    shown = (np.sin(2 * np.pi * t / 90) + stroke)[:, None]
    process = Autoregression.fit_separately([shown], order=6)
    zero, one = process.autocovariance(2).ravel()
    speed = 2 * (zero - one) / zero
    # Where the middle weighs most, it is 2.2 times as large.
    assert speed == pytest.approx(
        np.mean(np.diff(shown, axis=0) ** 2) / np.mean(shown**2), rel=0.3
    )


def residual_of(cycles, shown):
    phase = 2 * np.pi * np.linspace(0, cycles, len(shown))
    return Residual.fit([phase], [shown])


def test_a_smooth_channel_of_few_cycles_does_not_become_as_rough_as_another_one():
    t = np.arange(200)
    shown = np.column_stack([np.sin(t / 15), np.sin(2 * t)])
    process = residual_of(2.0, shown).process
    zero, one = process.autocovariance(2)
    assert np.diag(zero) == pytest.approx(1.0, abs=0.05)
    speed = np.diag(2 * (zero - one))
    # One process for both has 1.4.
    shown_speed = np.mean(np.diff(shown, axis=0) ** 2, axis=0) / np.mean(shown**2, 0)
    assert speed == pytest.approx(shown_speed, rel=0.3)


def test_few_cycles_on_a_tilted_plane_are_played_on_it():
    rng = np.random.default_rng(5)
    time = np.arange(0, 8, 0.05)
    phase = 2 * np.pi * time / 3 + 0.1 * np.sin(time)
    u, v = 0.1 * np.cos(phase) + 0.01 * np.sin(time), 0.05 * np.sin(phase)
    height = 2e-4 * rng.standard_normal(len(time))
    tilt = np.array([[1, 0, 1], [0, np.sqrt(2), 0], [-1, 0, 1]]) / np.sqrt(2)
    path = np.column_stack([u, v, height]) @ tilt.T
    skill = FourierMovementPrimitive().fit(Demonstration(time=time, values=path))
    assert skill.model_ == "phase"
    played = Player(skill, sample=True, seed=1).rollout(path[0], 40).position
    # 2 mm where the covariance of the channels is neglected.
    assert np.std(played[100:] @ tilt[:, 2]) < 6e-4


def test_two_samples_are_enough_to_find_the_phase():
    shown = 2 * np.pi * np.arange(50) / 50
    cycle = Cycle.fit([shown], [curve(shown)], harmonics=6)
    found = phase_path(cycle.values([1.0, 1.2]), cycle, velocity=0.2)
    np.testing.assert_allclose(found, [1.0, 1.2], atol=0.1)


def test_automatic_takes_the_mixture_where_nothing_repeats():
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.standard_normal((900, 2)), axis=0) / 100
    demonstration = Demonstration(time=np.arange(900) / RATE, values=walk)
    skill = FourierMovementPrimitive(model="automatic").fit(demonstration)
    assert (skill.model_, skill.phase_model_) == ("mixture", None)
    assert skill.model_reason_


def test_paper_settings_choose_the_mixture_and_unknown_models_are_refused():
    assert PAPER_SETTINGS["model"] == "mixture"
    with pytest.raises(SkillError, match="'mixture', 'phase' or 'automatic'"):
        FourierMovementPrimitive(model="angle").fit(recorded(wavering(300)))


def test_windows_and_demonstrations_teach_the_same():
    demonstration = recorded(wavering(500))
    made = FourierMovementPrimitive(n_steps=60, overlap=6, stride=5, model="phase")
    windows = np.stack([demonstration.values[i : i + 60] for i in range(0, 441, 5)])
    one = made.fit(demonstration).components_
    other = made.fit(windows).components_
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a.mean, b.mean, atol=1e-9)


def test_phase_model_accepts_equal_or_zero_weights_only():
    both = [recorded(wavering(500)), recorded(wavering(300, seed=3), seed=4)]
    skill = FourierMovementPrimitive(n_steps=60, overlap=6, model="phase")
    alone = skill.fit(both[:1]).phase_model_.cycles
    assert skill.fit(both, weights=[2.0, 0.0]).phase_model_.cycles == alone
    with pytest.raises(DemonstrationError, match="different weights"):
        skill.fit(both, weights=[2.0, 1.0])


# What it knows ----------------------------------------------------------


def test_the_next_second_of_the_eight_is_predicted_with_honest_covariances(eight):
    skill, _, held = eight
    plan = PredictionPlan(skill, 20)
    errors, inside = [], []
    for first in range(0, len(held) - 30, 11):
        prediction = plan.predict(held[first : first + 10])
        error = held[first + 10 : first + 30] - prediction.values
        errors.append(error)
        squared = np.einsum(
            "hd,hde,he->h", error, np.linalg.inv(prediction.covariances), error
        )
        inside.append(squared < chi2.ppf(0.95, 3))
    assert np.sqrt(np.mean(np.sum(np.square(errors), axis=-1))) < 0.0125
    assert 0.9 < np.mean(inside) < 0.99


def test_covariances_of_a_model_of_twenty_seconds_are_calibrated(eight):
    _, known, held = eight
    demonstration = Demonstration(time=np.arange(400) / RATE, values=known[:400])
    skill = FourierMovementPrimitive(model="phase").fit(demonstration)
    plan, inside, narrow = PredictionPlan(skill, 20), [], []
    skill.memory_ = ()
    alone = PredictionPlan(skill, 20)
    calibration = skill.calibration_.at(20)
    for first in range(0, len(held) - 30, 11):
        prediction = plan.predict(held[first : first + 10])
        model = alone.predict(held[first : first + 10])
        own = (model.covariances - calibration.error_covariances) / calibration.factors[
            :, None, None
        ]
        for values, covariances, out in (
            (prediction.values, prediction.covariances, inside),
            (model.values, own, narrow),
        ):
            error = held[first + 10 : first + 30] - values
            solved = np.linalg.solve(covariances, error[..., None])[..., 0]
            out.append(np.sum(error * solved, axis=1) < chi2.ppf(0.95, 3))
    assert np.mean(inside) > 0.93
    # Those of the model alone hold less.
    assert np.mean(narrow) < np.mean(inside) - 0.02


@pytest.mark.parametrize("cycles", [1.6, 3.0, 4.5])
def test_covariances_of_a_model_of_few_cycles_are_calibrated(cycles):
    coverage = []
    for seed in range(6):
        y = recorded(wavering(600, seed=seed), seed=seed + 100).values
        count = round(50 * cycles)
        skill = FourierMovementPrimitive(rate=RATE, model="phase").fit(y[:count])
        plan, inside = PredictionPlan(skill, 20), []
        for first in range(count - 10, count + 150, 3):
            prediction = plan.predict(y[first : first + 10])
            error = y[first + 10 : first + 30] - prediction.values
            solved = np.linalg.solve(prediction.covariances, error[..., None])[..., 0]
            inside.append(np.sum(error * solved, axis=1) < chi2.ppf(0.95, 2))
        coverage.append(np.mean(inside))
    assert np.mean(coverage) > 0.9
    assert np.min(coverage) > 0.75


def test_density_has_heavy_tails_with_few_cycles():
    y = recorded(wavering(600)).values
    densities = {}
    for count in (80, 500):
        skill = FourierMovementPrimitive(rate=RATE, model="phase").fit(y[:count])
        prediction = skill.predict(y[count - 10 : count], 20)
        far = prediction.values + 20 * np.sqrt(
            np.diagonal(prediction.covariances, axis1=1, axis2=2)
        )
        at = prediction.log_density(prediction.values) - prediction.log_density(far)
        densities[count] = float(at.max())
    # A Gaussian loses 400.
    assert densities[80] < 25
    assert densities[80] < densities[500] < 100


def test_a_density_is_that_of_a_t_distribution_with_the_covariance():
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    prediction = Prediction(
        values=np.zeros((1, 2)), covariances=covariance[None], degrees_of_freedom=5.0
    )
    expected = multivariate_t.logpdf([1.0, -2.0], shape=covariance * 3 / 5, df=5)
    assert prediction.log_density([[1.0, -2.0]])[0] == pytest.approx(expected)


def two_tones(count):
    """A smooth movement of two channels, as nothing but its next samples is foreseen."""
    t = np.arange(count) / 20
    return np.stack([np.sin(3 * t) + np.sin(4.2 * t), 0.01 * np.cos(3.7 * t)], axis=1)


def test_the_next_samples_of_a_smooth_movement_are_extrapolated():
    y = two_tones(130)
    learned, past, truth = [y[:80]], y[90:100], y[100:120]
    replayed = Replay(learned, 10, 20).predict(past)
    wide = replayed.spread + 0.01 * np.diag([1, 1e-4])
    values, covariances = Extrapolation(learned, 10, 20).blended(
        past, replayed.values, wide
    )
    before, after = (
        np.abs(truth - v)[:2].max(axis=0) for v in (replayed.values, values)
    )
    assert np.all(after < 0.2 * before)
    assert np.all(np.trace(covariances[:2], axis1=1, axis2=2) < 0.05 * 0.01)
    assert np.all(np.linalg.eigvalsh(covariances) > 0)


def test_a_prediction_that_is_certain_is_not_extrapolated():
    y = two_tones(60) + np.random.default_rng(0).normal(0, 0.1, (60, 2))
    exact, certain = np.zeros((20, 2)), np.broadcast_to(1e-9 * np.eye(2), (20, 2, 2))
    values, covariances = Extrapolation([y], 10, 20).blended(y[:10], exact, certain)
    assert_allclose(values, exact, atol=1e-6)
    assert_allclose(covariances, certain, rtol=0.01, atol=1e-11)


def test_two_predictions_of_equal_variance_are_no_more_certain_than_one():
    # Their errors may be the same: the mean of both has the variance of each.
    y = np.random.default_rng(1).normal(0, 1, (400, 1)).cumsum(axis=0)
    alone = Extrapolation([y], 10, 3)
    wide = np.full((3, 1, 1), 1e12)
    own, variances = alone.blended(y[:10], np.zeros((3, 1)), wide)
    values, covariances = alone.blended(y[:10], own + 2.0, variances)
    assert_allclose(values, own + 1.0, rtol=1e-4)
    assert_allclose(covariances, variances, rtol=1e-4)


def test_prediction_is_unchanged_beyond_the_extrapolated_samples():
    y = two_tones(18)
    values, covariances = np.ones((20, 2)), np.broadcast_to(np.eye(2), (20, 2, 2))
    after = Extrapolation([y], 10, 20).blended(y[:10], values, covariances)
    assert after[0][0, 0] != 1
    assert_allclose(after[0][10:], 1)
    assert_allclose(after[1][10:], covariances[10:])


@pytest.mark.parametrize("count", [24, 40, 70])
def test_prediction_without_repetition_has_covariances(count):
    rng = np.random.default_rng(3)
    path = np.cumsum(np.cumsum(rng.normal(0, 1e-3, (400, 2)), axis=0), axis=0)
    skill = FourierMovementPrimitive(rate=RATE, n_steps=20, overlap=5).fit(path[:count])
    assert skill.model_ == "mixture"
    densities, inside = [], []
    for first in range(count, 390 - 10, 5):
        prediction = skill.predict(path[first : first + 5], 10)
        truth = path[first + 5 : first + 15]
        densities.append(prediction.log_density(truth))
        error = truth - prediction.values
        solved = np.linalg.solve(prediction.covariances, error[..., None])[..., 0]
        inside.append(np.sum(error * solved, axis=1) < chi2.ppf(0.95, 2))
    assert np.min(densities) > -20
    assert np.mean(inside) > 0.6


def three_channels(cycles, *, seed=0):
    """Return samples of 60 mm, and of 5 mm at twice the frequency."""
    rng = np.random.default_rng(seed)
    phase = wavering(50 * cycles, seed=seed)
    kernel = np.ones(9) / 3
    white = rng.standard_normal((3, len(phase) + 8))
    noise = [np.convolve(channel, kernel, "valid") for channel in white]
    values = np.stack([np.cos(phase), np.sin(phase), np.sin(2 * phase + 0.5)], axis=1)
    sizes = np.array([0.06, 0.06, 0.005])
    return sizes * (values + 0.015 * np.stack(noise, axis=1))


@pytest.mark.parametrize("cycles", [3, 12])
def test_a_small_channel_is_learned_beside_large_ones(cycles):
    y = three_channels(cycles + 6)
    skill = FourierMovementPrimitive(rate=RATE).fit(y[: 50 * cycles])
    for sample in (False, True):
        path = Player(skill, sample=sample).rollout(y[0], 30.0)[100:, 0]
        assert_allclose(path.std(axis=0), y.std(axis=0), rtol=0.1)
    errors = []
    for first in range(50 * cycles, len(y) - 30, 7):
        prediction = skill.predict(y[first : first + 10], 20)
        errors.append(y[first + 10 : first + 30] - prediction.values)
    relative = np.sqrt(np.mean(np.square(errors), axis=(0, 1))) / y.std(axis=0)
    # An error of the phase counts twice where the frequency is double.
    assert relative[2] < 2.5 * relative[:2].max()


@pytest.mark.parametrize("noise", [0.0005, 0.002])
def test_samples_are_as_precise_as_the_movement_was(noise):
    rng = np.random.default_rng(1)
    phase = 2 * np.pi * np.arange(1500) / 50
    white = rng.standard_normal((2, 1508))
    smooth = [np.convolve(channel, np.ones(9) / 3, "valid") for channel in white]
    ellipse = np.stack([0.1 * np.cos(phase), 0.15 * np.sin(phase)], axis=1)
    y = ellipse + noise * np.stack(smooth, axis=1)
    skill = FourierMovementPrimitive(rate=RATE).fit(y)
    fine = 2 * np.pi * np.arange(5000) / 5000
    exact = cKDTree(np.stack([0.1 * np.cos(fine), 0.15 * np.sin(fine)], axis=1))

    def deviation(values):
        return np.sqrt(np.mean(exact.query(values)[0] ** 2))

    played = Player(skill, sample=True).rollout(y[0], 60.0)[100:, 0]
    assert 0.8 < deviation(skill.sample(100).reshape(-1, 2)) / deviation(y) < 1.25
    assert 0.8 < deviation(played) / deviation(y) < 1.4


@pytest.mark.parametrize("cycles", [3, 15])
def test_longer_observations_infer_other_channels_no_worse(cycles):
    y = three_channels(cycles + 20)
    skill = FourierMovementPrimitive(rate=RATE).fit(y[: 50 * cycles])
    held = y[50 * cycles :]
    errors, inside = [], []
    for length in (10, 40, 200, len(held)):
        whole = len(held) // length * length
        parts = held[:whole].reshape(-1, length, 3)
        inferred = [skill.infer(part[:, :1], ["x"]) for part in parts]
        error = held[:whole, 1:] - np.concatenate([p.values for p in inferred])
        covariances = np.concatenate([p.covariances for p in inferred])
        solved = np.linalg.solve(covariances, error[..., None])[..., 0]
        inside.append(np.mean(np.sum(error * solved, axis=1) < chi2.ppf(0.95, 2)))
        errors.append(np.sqrt(np.mean(error**2, axis=0)) / held[:, 1:].std(axis=0))
    assert np.all(errors[1:] <= 1.05 * errors[0])
    assert np.all(errors[-1] < 0.35)
    assert np.min(inside) > 0.85


def test_a_prediction_needs_as_many_samples_as_the_overlap(small):
    with pytest.raises(SkillError, match=r"5 samples were observed; .* the last 6"):
        small[0].predict(np.zeros((5, 2)), 10)


def test_the_held_out_density_of_the_eight_is_far_above_the_mixtures(eight):
    skill, known, held = eight
    windows = np.stack([held[i : i + 120] for i in range(0, len(held) - 120, 40)])
    demonstration = Demonstration(time=np.arange(len(known)) / RATE, values=known)
    mixture = FourierMovementPrimitive(model="mixture").fit(demonstration)
    assert skill.score(windows) > mixture.score(windows) + 2


def test_samples_follow_the_eight(eight):
    skill, known, held = eight
    apart = cKDTree(np.concatenate([known, held])).query(
        skill.sample(300, seed=2).reshape(-1, 3)
    )[0]
    assert apart.mean() < 0.002
    assert np.quantile(apart, 0.99) < 0.008


def test_played_means_keep_their_width_and_samples_their_place(eight):
    skill, known, held = eight
    shown = np.concatenate([known, held])
    tree = cKDTree(shown)
    for sample in (False, True):
        path = Player(skill, sample=sample).rollout(known[300], 60.0)[100:, 0]
        apart = tree.query(path)[0]
        assert apart.mean() < 0.002
        assert np.quantile(apart, 0.99) < 0.008
        assert np.all(path[:, :2].std(axis=0) > 0.95 * shown[:, :2].std(axis=0))


def test_samples_differ_and_follow_from_the_seed(small):
    skill, _ = small
    a, b, other = skill.sample(4, seed=1), skill.sample(4, seed=1), skill.sample(4)
    assert np.array_equal(a, b)
    assert not np.array_equal(a, other)
    assert skill.sample(0).shape == (0, 60, 2)


def test_a_target_of_a_component_is_near_its_mean(small):
    skill, _ = small
    drawn = skill.draw(3, np.random.default_rng(0), 200)
    mean = skill.synthesize(np.sum(drawn, axis=0).mean(axis=0))
    apart = np.linalg.norm(mean - skill.synthesize(skill.components_[3].mean), axis=1)
    assert apart.max() < 0.012  # Where the phase strays, the mean of samples shrinks.


def test_phase_of_a_skill_counts_cycles(small):
    skill, _ = small
    going = wavering(200, seed=8)
    found = skill.phase(recorded(going, seed=9).values)
    assert np.std(found - going) < 0.1


# What is done to it -----------------------------------------------------


def test_a_skill_file_keeps_the_phase(small, tmp_path):
    skill, _ = small
    save_skill(skill, tmp_path / "s.npz")
    loaded = load_skill(tmp_path / "s.npz")
    assert (loaded.model_, loaded.model_reason_) == ("phase", skill.model_reason_)
    assert loaded.period_ == skill.period_
    assert np.array_equal(loaded.sample(3, seed=5), skill.sample(3, seed=5))
    seen = skill.sample(1)[0, :10]
    expected, found = (each.predict(seen, 20).covariances for each in (skill, loaded))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    path = Player(skill, sample=True).rollout([0.1, 0.0], 9.0)
    assert np.array_equal(Player(loaded, sample=True).rollout([0.1, 0.0], 9.0), path)


@pytest.mark.parametrize(
    "name", ["phase_anchors", "phase_tempo_innovation", "phase_cycle"]
)
def test_a_file_whose_phase_does_not_fit_is_refused(small, tmp_path, name):
    skill, _ = small
    save_skill(skill, tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz") as file:
        arrays = dict(file)
    arrays[name] = arrays[name][:-1]
    np.savez(tmp_path / "s.npz", **arrays)
    with pytest.raises(SkillFileError, match=r"incomplete skill file"):
        load_skill(tmp_path / "s.npz")


@pytest.mark.parametrize(
    ("name", "shape"), [("factors", (3,)), ("errors", (10, 3, 3)), ("weight", (1,))]
)
def test_a_file_whose_calibration_has_another_shape_is_refused(
    small, tmp_path, name, shape
):
    skill, _ = small
    save_skill(skill, tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz") as file:
        arrays = dict(file)
    assert arrays[f"calibration_{name}"].shape != shape
    arrays[f"calibration_{name}"] = np.ones(shape)
    np.savez(tmp_path / "s.npz", **arrays)
    with pytest.raises(SkillFileError, match=f"calibration_{name} has shape"):
        load_skill(tmp_path / "s.npz")


def test_a_file_of_version_3_has_a_calibration_of_factors(small, tmp_path):
    skill, _ = small
    save_skill(skill, tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz") as file:
        arrays = {k: file[k] for k in file.files if not k.startswith("calibration")}
    factors = np.array([[1.0, 2.0], [20.0, 0.5]])
    np.savez(tmp_path / "s.npz", **arrays, phase_calibration=factors)
    calibration = load_skill(tmp_path / "s.npz").calibration_
    assert calibration.factors.tolist() == [2.0, 1.0]
    assert not calibration.error_covariances.any()
    assert not calibration.change_covariances.any()


def test_a_file_whose_predictions_have_no_width_is_refused(small, tmp_path):
    skill, _ = small
    save_skill(skill, tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz") as file:
        arrays = dict(file)
    arrays["calibration_factors"][0] = 0.0
    np.savez(tmp_path / "s.npz", **arrays)
    with pytest.raises(SkillFileError, match="horizons of its calibration"):
        load_skill(tmp_path / "s.npz")


def test_an_edited_skill_has_the_edited_phase_model(small):
    skill, _ = small
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    moved = transform_space(
        skill, rotation=quarter, scale=2.0, translation=[1, 2], channels=["x", "y"]
    )
    expected = 2 * skill.sample(5, seed=1) @ quarter.T + [1, 2]
    np.testing.assert_allclose(moved.sample(5, seed=1), expected, atol=1e-9)
    assert scale_tempo(skill, 2.0).period_ == pytest.approx(skill.period_ / 2)


def test_other_harmonics_of_a_window_are_those_of_the_cycle(small):
    skill, _ = small
    louder = modulate_skill(skill, harmonics=range(1, 31), gain=1.5, channels=["y"])
    phase = np.linspace(0, 2 * np.pi, 50)
    before, after = (s.phase_model_.cycle.values(phase) for s in (skill, louder))
    middle = skill.phase_model_.cycle.coefficients[0]
    np.testing.assert_allclose(
        after, middle + [1, 1.5] * (before - middle), rtol=0.02, atol=0.02
    )
    reach, louder_reach = (
        np.ptp(Player(s, sample=True).rollout([0, 0], 60.0)[300:, 0], axis=0)
        for s in (skill, louder)
    )
    assert louder_reach[1] / reach[1] == pytest.approx(1.45, abs=0.1)
    twice = modulate_skill(skill, harmonics=range(31), gain=2.0).phase_model_.cycle
    np.testing.assert_allclose(twice.values(phase), 2 * before)
    shifted = modulate_skill(skill, harmonics=range(1, 30), phase=np.pi)
    np.testing.assert_allclose(
        shifted.phase_model_.cycle.values(phase) - middle,
        middle - before,
        rtol=0.02,
        atol=0.02,
    )
    earlier = modulate_skill(skill, harmonics=range(1, 30), phase=0.7)
    own, of_earlier = (
        np.mean(s.score_samples(s.sample(20, seed=1))) for s in (skill, earlier)
    )
    assert of_earlier == pytest.approx(own, rel=0.1)


# Recordings as people make them ---------------------------------------------


def eased(begin, end, count):
    """Return a way (count, 2) that begins and ends at rest."""
    t = np.linspace(0, 1, count)[:, None]
    t = t * t * (3 - 2 * t)
    return (1 - t) * np.asarray(begin) + t * np.asarray(end)


def learned(values):
    demonstration = Demonstration(time=np.arange(len(values)) / RATE, values=values)
    skill = FourierMovementPrimitive(n_steps=60, overlap=6, model="automatic")
    return skill.fit(demonstration)


def off_the_curve(skill, seconds=40.0):
    """Return the 99 % quantile of how far samples that are played leave the curve, m."""
    cycle = curve(np.linspace(0, 2 * np.pi, 800))
    player = Player(skill, sample=True, seed=1)
    path = player.rollout(cycle[0], seconds)[100:, 0]
    return float(np.quantile(cKDTree(cycle).query(path)[0], 0.99))


def test_approach_and_retreat_are_left_out():
    phase = wavering(600)
    movement = recorded(phase).values
    to = eased([0.3, 0.2], movement[0], 50)
    back = eased(movement[-1], [-0.4, 0.0], 40)
    skill = learned(np.concatenate([to, movement, back]))
    assert skill.model_ == "phase"
    approach, retreat = skill.rhythm_.left_out
    assert (approach.kind, retreat.kind) == ("approach", "retreat")
    assert (approach.end, retreat.start) == pytest.approx((2.5, 32.5), abs=0.3)
    assert np.all(np.abs(skill.extent_ - learned(movement).extent_) < 0.01)
    assert len(np.concatenate(skill.paths_)) < 615
    assert off_the_curve(skill) < 0.012


def test_a_pause_is_not_played():
    phase = wavering(600)
    phase = np.concatenate([phase[:300], np.full(80, phase[300]), phase[300:]])
    skill = learned(recorded(phase).values)
    (pause,) = skill.rhythm_.left_out
    assert pause.kind == "pause"
    assert pause.duration == pytest.approx(4.0, abs=0.5)
    path = Player(skill, sample=True).rollout(curve(phase[:1])[0], 30.0)[100:, 0]
    ahead = np.diff(skill.phase(path))
    assert ahead.min() > 0.3 * ahead.mean()


@pytest.mark.parametrize(
    "tempo",
    [
        np.linspace(0.8, 1.2, 800),
        np.where(np.arange(800) < 400, 1.0, 1.4),
        1 + 0.4 * np.sin(np.arange(800) / 90),
    ],
    ids=["ramp", "step", "wave"],
)
def test_samples_stay_on_the_cycle_where_the_tempo_changes_by_40_percent(tempo):
    skill = learned(recorded(np.cumsum(2 * np.pi / 50 * tempo)).values)
    assert skill.model_ == "phase"
    assert np.ptp(skill.tempos_) > 0.3
    assert off_the_curve(skill) < 0.015


def test_a_drift_is_reported_and_a_large_one_refused():
    values = recorded(wavering(700)).values
    ramp = np.linspace(0, 1, 700)[:, None] * [1.0, 0.0]
    skill = learned(values + 0.1 * ramp)
    assert skill.phase_model_.history.drift == pytest.approx([0.1, 0.0], abs=0.02)
    wandered = learned(values + 0.6 * ramp)
    assert wandered.model_ == "mixture"
    assert "the phase cannot be tracked" in wandered.model_reason_


def test_a_cycle_that_consists_of_equal_ones_is_recognised():
    phase = np.linspace(0, 2 * np.pi, 400)
    for count in (1, 2, 3):
        cycle = Cycle.fit([phase], [curve(count * phase)], harmonics=15)
        assert cycle.repetitions(0.01) == count


def test_tempo_and_size_of_every_cycle_are_kept(small, tmp_path):
    skill, _ = small
    assert len(skill.tempos_) == skill.phase_model_.cycles == 17
    assert skill.tempos_.mean() == pytest.approx(1, abs=0.05)
    assert skill.amplitudes_ == pytest.approx(np.ones(17), abs=0.05)
    save_skill(skill, tmp_path / "s.npz")
    assert np.array_equal(load_skill(tmp_path / "s.npz").tempos_, skill.tempos_)


def test_few_components_make_a_mixture():
    skill = FourierMovementPrimitive(
        n_steps=60, overlap=6, n_components=4, model="automatic"
    )
    skill.fit(recorded(wavering(400)))
    assert skill.model_ == "mixture"
    assert "n_components is 4" in skill.model_reason_


def test_the_phase_of_a_playback_runs_on_from_cycle_to_cycle(small):
    skill, _ = small
    for sample in (False, True):
        player = Player(skill, sample=sample)
        state = player.start(curve(np.zeros(1))[0])
        phases = []
        for _ in range(300):
            state = player.advance(state, 0.04)
            phases.append(player.phase(state))
        steps = np.angle(np.exp(1j * np.diff(phases[50:])))
        assert np.all(steps > 0)
        assert steps.mean() * 25 * skill.period_ == pytest.approx(2 * np.pi, rel=0.1)
        # Where the cycle is slow, what a sample adds moves the phase, too.
        assert steps.max() < 3 * steps.mean()


def test_a_height_that_hardly_varies_does_not_drive_the_other_channels():
    # What a low-pass filter leaves of an approach, 0.1 micrometres, on 25 fast circles.
    time = np.arange(0, 20, 0.02)
    rng = np.random.default_rng(0)
    phase = 2 * np.pi * np.cumsum(1.25 + 0.1 * rng.standard_normal(len(time))) * 0.02
    xy = 0.06 * np.column_stack([np.cos(phase), np.sin(phase)])
    xy += np.cumsum(rng.normal(0, 2e-4, xy.shape), axis=0)
    ringing = 1e-7 * np.exp(-time) * np.cos(40 * time)
    demonstration = Demonstration(time=time, values=np.column_stack([xy, ringing]))
    skill = FourierMovementPrimitive(model="phase").fit(demonstration)
    path = Player(skill).rollout([0.06, 0.0, 0.05], 10.0).position
    # From rest the movement begins with a larger curve.
    assert np.max(np.abs(path[:, :2])) < 2.5 * np.max(np.abs(xy))
    assert np.max(np.abs(path[40:, :2])) < 1.2 * np.max(np.abs(xy))
    assert np.max(np.abs(path[40:, 2])) < 0.005


def test_playback_of_a_mixture_has_no_phase(small_skill):
    player = Player(small_skill)
    with pytest.raises(SkillError, match="a mixture, which has no phase"):
        player.phase(player.start([0.1, 0.0]))
    assert not any(hasattr(small_skill, f"{name}_") for name in ("period", "tempos"))
    with pytest.raises(SkillError, match="a mixture, which has no phase"):
        _ = small_skill.amplitudes_


def test_uncertainty_grows_farther_ahead_than_left_out_parts_reach():
    steps = np.random.default_rng(2).standard_normal((50, 2))
    path = np.cumsum(np.cumsum(steps, axis=0), axis=0)
    calibration = calibrate_replay([path], 10, 20).at(20)
    variances = np.trace(calibration.error_covariances, axis1=1, axis2=2)
    assert np.all(np.diff(variances[10:]) > 0)


def test_error_grows_linearly_between_horizons_from_zero_for_observed_samples():
    shape = np.array([[2.0, 0.5], [0.5, 1.0]])
    calibration = Calibration(
        horizons=np.array([1.0, 3.0]),
        factors=np.ones(2),
        error_covariances=np.array([4 * shape, 8 * shape]),
        change_covariances=np.array([shape, shape]),
    )
    for ahead, factor in ((0, 0), (0.5, 2), (1, 4), (1.5, 5), (3, 8), (9, 8)):
        np.testing.assert_allclose(
            calibration.playback_covariance(ahead), factor * shape
        )


def test_few_cycles_are_blended_with_replay_and_many_are_not():
    y = recorded(wavering(1000)).values
    few, many = (
        FourierMovementPrimitive(rate=RATE, model="phase").fit(y[:n]).calibration_
        for n in (150, 1000)
    )
    assert 0.1 < few.model_weight < 0.9
    # Three cycles are enough to leave parts out: it is not the weight without any, 0.4.
    assert abs(few.model_weight - 0.4) > 0.02
    assert many.model_weight == 1.0
    assert few.local_factor > 0.2
    assert many.local_factor == 0.0
    # Three cycles show less than the variances of the movement.
    assert few.at(20).factors[-1] > 1.2


def test_longer_recordings_have_lighter_tails():
    short, long = (
        calibrate_replay([wandering(s)], 10, 20).degrees_of_freedom for s in (4.0, 20.0)
    )
    assert 4.0 < short < 4.2
    # As of five cycles: half a cycle for each of the ten parts that are left out.
    assert long == pytest.approx(4 + 0.05 * 5**2)


def test_errors_of_short_recordings_grow_more_than_the_changes_of_the_movement():
    path = wandering(1.6)[:, :1]
    near, far = calibrate_replay([path], 10, 20).at(20).error_covariances[[9, 19], 0, 0]
    changes = [np.mean((path[h:] - path[:-h]) ** 2) for h in (10, 20)]
    growth = far / near / (changes[1] / changes[0])
    assert growth == pytest.approx(2 ** (1 / 3), rel=1e-3)


def test_errors_of_channels_that_move_together_are_correlated():
    # One second is too short to leave a part of it out.
    path = np.repeat(wandering(1.0)[:, :1], 2, axis=1)
    error = calibrate_replay([path], 10, 20).error_covariances[0]
    assert error[0, 1] / error[0, 0] == pytest.approx(1 / 3, abs=0.01)


def test_variances_of_few_cycles_fall_short_by_a_factor_that_vanishes():
    # (1 + 4.5 n^-1.5)^2
    for cycles, factor in ((1.0, 5.5**2), (4.0, 1.5625**2), (9.0, (7 / 6) ** 2)):
        assert variance_factor(cycles) == pytest.approx(factor)


@pytest.mark.parametrize(("distance", "added"), [(0.03, 0.0), (0.06, 0.75 * 0.02)])
def test_prediction_is_blended_with_the_continuations_of_similar_pasts(distance, added):
    shape = np.array([[0.75, 0.1], [0.1, 0.25]])
    calibration = Calibration(
        horizons=np.array([1.0]),
        factors=np.array([2.0]),
        error_covariances=np.zeros((1, 2, 2)),
        change_covariances=shape[None],
        model_weight=0.25,
        local_factor=0.4,
    )
    model, covariance = np.array([[1.0, 2.0]]), np.array([[[3.0, 1.0], [1.0, 2.0]]])
    spread = np.array([[[0.5, 0.2], [0.2, 0.4]]])
    replayed = Replayed(np.array([[0.6, 1.2]]), spread, distance)
    # The variance of the recordings is 1: a squared distance of 0.04 is not new.
    mean, out = calibration.combined(model, covariance, replayed, 1.0)
    np.testing.assert_allclose(mean, 0.25 * model + 0.75 * replayed.values)
    apart = (model - replayed.values)[0]
    expected = covariance[0] + 2.0 * 0.25 * 0.75 * np.outer(apart, apart)
    expected = expected + 0.4 * spread[0] + added / 2 * (shape + np.eye(2) / 2)
    np.testing.assert_allclose(out[0], expected)


def wandering(seconds, seed=5):
    """Return a smooth path (n, 2) in which nothing repeats; 60 s of it do not close."""
    noise = np.random.default_rng(seed).standard_normal((int(20 * seconds) + 200, 2))
    kernel = np.exp(-0.5 * (np.arange(-40, 41) / 10) ** 2)
    path = np.stack([np.convolve(x, kernel, "valid") for x in noise.T], axis=1)
    return 0.1 * path[: int(20 * seconds)] / path.std()


def test_tube_of_a_played_mixture_contains_most_held_out_samples():
    path = wandering(90)
    seen, later = path[:1200], path[1200:]
    skill = FourierMovementPrimitive(rate=20.0).fit(seen)
    assert skill.model_ == "mixture"
    k = skill.overlap
    of_component, of_playback = [], []
    for i in range(0, len(later) - k - 20, 5):
        mapping = skill.map_partial(later[i : i + k])
        step = k + 19
        error = later[i + step] - skill.synthesize(mapping.weights)[step]
        own = skill.covariance(mapping.component, step)
        tube = skill.predicted_covariance(mapping.component, step)
        for covariance, known in ((own, of_component), (tube, of_playback)):
            known.append(error @ np.linalg.solve(covariance, error) < 5.99)
    assert np.mean(of_playback) > 0.65
    assert np.mean(of_playback) > np.mean(of_component) + 0.4


def test_density_of_a_mixture_does_not_vanish_for_new_movements():
    path = wandering(90)
    new = np.stack([path[i : i + 120] for i in range(1200, 1680, 40)])
    chosen = FourierMovementPrimitive(rate=20.0).fit(path[:1200])
    asked = FourierMovementPrimitive(rate=20.0, model="mixture").fit(path[:1200])
    assert chosen.n_steps == asked.n_steps == 120
    assert chosen.score(new) > asked.score(new) + 1
    gained = chosen.score_samples(new) - asked.score_samples(new)
    assert np.min(gained) > -0.3
