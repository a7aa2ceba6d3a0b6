"""Facts about the model that knows the phase."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import chi2

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
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.fit import tracked
from fmp_drake.primitives.model.phase.path import best_path, phase_path
from fmp_drake.primitives.model.prediction import PredictionPlan
from fmp_drake.primitives.playback.place import phase_of

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


# Tracking ---------------------------------------------------------------


def test_the_cheapest_path_is_the_one_that_trying_all_finds():
    rng = np.random.default_rng(0)
    cost, step_cost = rng.random((5, 6)), np.array([0.5, 0.0, 0.7])
    start, steps = best_path(cost, step_cost)

    def price(first, by):
        states = (first + np.concatenate([[0], np.cumsum(by)])) % 6
        return cost[np.arange(5), states].sum() + step_cost[list(by)].sum()

    every = min(price(first, by) for first in range(6) for by in np.ndindex(3, 3, 3, 3))
    assert steps[0] == 0
    assert price(start, steps[1:]) == pytest.approx(every)


def test_phase_is_tracked_through_a_wavering_tempo():
    phase = wavering(900, spread=0.12)
    track = tracked([recorded(phase).values], n_steps=60)
    off = track.phases[0] - phase
    assert track.cycles == pytest.approx((phase[-1] - phase[0]) / (2 * np.pi), abs=0.1)
    # The zero of the phase is anywhere.
    assert np.std(off) < 0.1


def test_slow_shifts_of_the_centre_do_not_bend_the_phase():
    phase = wavering(900)
    moved = recorded(phase).values.copy()
    moved[:, 0] += 0.03 * np.sin(np.linspace(0, 6, 900))
    track = tracked([moved], n_steps=60)
    assert np.std(track.phases[0] - phase) < 0.15
    assert track.shifts[0][:, 0].std() > 0.01


def test_phase_is_tracked_where_the_tempo_changes_by_a_third():
    phase = np.cumsum(2 * np.pi / 50 * (1 + 0.35 * np.sin(np.arange(1800) / 90)))
    track = tracked([recorded(phase).values], n_steps=60)
    assert track.cycles == pytest.approx((phase[-1] - phase[0]) / (2 * np.pi), abs=0.1)
    assert np.std(track.phases[0] - phase) < 0.1


def test_a_pause_is_cut_out():
    phase = wavering(900)
    phase = np.concatenate([phase[:400], np.full(100, phase[400]), phase[400:]])
    track = tracked([recorded(phase).values], n_steps=60)
    assert len(track.recordings) == 2
    assert 60 <= track.paused <= 140
    assert len(track.recordings[0]) == pytest.approx(400, abs=25)


def test_phase_of_seen_samples_is_that_of_the_cycle():
    cycle = Cycle.fit(
        np.linspace(0, 6.2, 200), curve(np.linspace(0, 6.2, 200)), harmonics=5
    )
    phase = 1.0 + 0.13 * np.arange(30)
    found = phase_path(curve(phase), cycle, tempo=0.12)
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * phase), atol=0.02)


# Which model ------------------------------------------------------------


def test_automatic_takes_the_phase_where_there_are_cycles(small):
    skill, phase = small
    assert skill.model_ == "phase"
    assert "cycles" in skill.model_reason_
    assert skill.period_ == pytest.approx(
        2 * np.pi / np.diff(phase).mean() / RATE, 0.02
    )


def test_automatic_takes_the_mixture_where_there_are_few_cycles_and_says_why():
    demonstration = recorded(wavering(170))
    skill = FourierMovementPrimitive(n_steps=60, overlap=6, model="automatic")
    skill.fit(demonstration)
    assert skill.model_ == "mixture"
    assert "3.4 cycles" in skill.model_reason_
    with pytest.raises(SkillError, match="knows no phase"):
        skill.phase(demonstration.values)
    skill.set_params(model="phase")
    with pytest.raises(
        DemonstrationError, match=r"3\.4 cycles; the phase model needs 4"
    ):
        skill.fit(demonstration)


def test_a_centre_that_wanders_farther_than_the_movement_is_refused():
    values = recorded(wavering(300)).values
    ramp = np.linspace(0, 0.4, 300)[:, None] * [1.0, 0.0]
    with pytest.raises(
        DemonstrationError, match=r"its centre wanders: .* at most 50 %"
    ):
        tracked([values + ramp], n_steps=60)


@pytest.mark.parametrize(("apart", "noise"), [(0.035, 0.0), (0.017, 0.011)])
def test_two_strokes_that_differ_are_one_cycle(apart, noise):
    phase = wavering(600, period=100)
    values = curve(2 * phase)
    values[:, 0] += apart * np.cos(phase)
    values += noise * np.random.default_rng(5).standard_normal(values.shape)
    assert tracked([values], n_steps=60).cycles == pytest.approx(6, abs=0.1)


def test_phase_of_samples_on_the_cycle_is_exact():
    phase = 2 * np.pi * np.arange(100) / 50
    cycle = Cycle.fit(phase, curve(phase), harmonics=6)
    found = phase_path(cycle.values(phase), cycle, tempo=phase[1])
    np.testing.assert_allclose(found, phase, atol=1e-9)


def test_two_samples_are_enough_to_find_the_phase():
    shown = 2 * np.pi * np.arange(50) / 50
    cycle = Cycle.fit(shown, curve(shown), harmonics=6)
    found = phase_path(cycle.values([1.0, 1.2]), cycle, tempo=0.2)
    np.testing.assert_allclose(found, [1.0, 1.2], atol=0.1)


def test_automatic_takes_the_mixture_where_nothing_repeats():
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.standard_normal((900, 2)), axis=0) / 100
    demonstration = Demonstration(time=np.arange(900) / RATE, values=walk)
    skill = FourierMovementPrimitive(model="automatic").fit(demonstration)
    assert (skill.model_, skill.phase_model_) == ("mixture", None)
    assert skill.model_reason_


def test_the_paper_has_a_mixture_and_other_words_are_refused():
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


def test_weights_may_leave_recordings_out_but_not_weigh_them():
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


def test_of_what_twenty_seconds_teach_the_covariances_hold_too(eight):
    _, known, held = eight
    demonstration = Demonstration(time=np.arange(400) / RATE, values=known[:400])
    skill = FourierMovementPrimitive(model="phase").fit(demonstration)
    plan, inside = PredictionPlan(skill, 20), []
    for first in range(0, len(held) - 30, 11):
        prediction = plan.predict(held[first : first + 10])
        error = held[first + 10 : first + 30] - prediction.values
        solved = np.linalg.solve(prediction.covariances, error[..., None])[..., 0]
        inside.append(np.sum(error * solved, axis=1) < chi2.ppf(0.95, 3))
    assert np.mean(inside) > 0.93
    # They are too wide here; without the factors they would be too narrow.
    assert np.all(skill.phase_model_.widening(20)[9:] > 1.3)


def test_covariances_are_those_of_the_model_where_nothing_can_be_left_out():
    made = FourierMovementPrimitive(n_steps=60, overlap=6, model="phase")
    skill = made.fit(recorded(wavering(215)))
    assert np.array_equal(skill.phase_model_.widening(40), np.ones(40))


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


def test_a_file_whose_predictions_have_no_width_is_refused(small, tmp_path):
    skill, _ = small
    save_skill(skill, tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz") as file:
        arrays = dict(file)
    arrays["phase_calibration"][0, 1] = 0.0
    np.savez(tmp_path / "s.npz", **arrays)
    with pytest.raises(SkillFileError, match="no covariances"):
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


def test_a_skill_with_other_harmonics_is_a_mixture(small):
    louder = modulate_skill(small[0], harmonics=[2], gain=1.5)
    assert (louder.model_, louder.phase_model_) == ("mixture", None)
    assert louder.sample(2).shape == (2, 60, 2)


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


def test_ways_to_and_from_a_movement_are_left_out():
    phase = wavering(600)
    movement = recorded(phase).values
    to = eased([0.3, 0.2], movement[0], 50)
    back = eased(movement[-1], [-0.4, 0.0], 40)
    skill = learned(np.concatenate([to, movement, back]))
    assert skill.model_ == "phase"
    assert 80 <= skill.phase_model_.approach <= 95
    assert np.all(np.abs(skill.extent_ - learned(movement).extent_) < 0.01)
    assert len(np.concatenate(skill.paths_)) < 615
    assert off_the_curve(skill) < 0.012


def test_a_pause_is_not_played():
    phase = wavering(600)
    phase = np.concatenate([phase[:300], np.full(80, phase[300]), phase[300:]])
    skill = learned(recorded(phase).values)
    assert 50 <= skill.phase_model_.paused <= 110
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


def test_a_drift_is_found_and_a_great_one_refused_in_words():
    values = recorded(wavering(700)).values
    ramp = np.linspace(0, 1, 700)[:, None] * [1.0, 0.0]
    skill = learned(values + 0.1 * ramp)
    assert skill.phase_model_.history.drift == pytest.approx([0.1, 0.0], abs=0.02)
    wandered = learned(values + 0.6 * ramp)
    assert wandered.model_ == "mixture"
    assert "the phase cannot be tracked" in wandered.model_reason_


def test_a_cycle_that_consists_of_equal_ones_is_known_as_such():
    phase = np.linspace(0, 2 * np.pi, 400)
    for count in (1, 2, 3):
        cycle = Cycle.fit(phase, curve(count * phase), harmonics=15)
        assert cycle.folds(0.01) == count


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
            phases.append(phase_of(player, state))
        steps = np.angle(np.exp(1j * np.diff(phases[50:])))
        assert np.all(steps > 0)
        assert steps.mean() * 25 * skill.period_ == pytest.approx(2 * np.pi, rel=0.1)
        # Where the cycle is slow, what a sample adds moves the phase, too.
        assert steps.max() < 3 * steps.mean()


def test_a_mixture_knows_no_phase_of_a_playback(small_skill):
    player = Player(small_skill)
    with pytest.raises(SkillError, match="a mixture, which knows no phase"):
        phase_of(player, player.start([0.1, 0.0]))
