"""Facts about the calibration of predictions by parts that are left out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.primitives.model.phase import calibration as module
from fmp_drake.primitives.model.phase.calibration import (
    MANY_CYCLES,
    Calibration,
    calibrate,
    calibrate_playback,
    calibrate_replay,
)
from fmp_drake.primitives.model.phase.components import phase_grid
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.tracking import PhaseTrack
from fmp_drake.primitives.model.prediction import Replay, Replayed

PERIOD, SEEN, HORIZON = 40, 10, 20


def curve(phase):
    """Return a curve of two channels that never passes a point twice."""
    x = np.cos(phase) + 0.3 * np.cos(2 * phase)
    return np.column_stack([x, np.sin(phase) - 0.2 * np.cos(3 * phase)])


def smooth(count, rng, length=9):
    """Return smooth noise (count, 2) of unit variance."""
    white = rng.standard_normal((2, count + length - 1))
    kernel = np.ones(length) / np.sqrt(length)
    return np.stack([np.convolve(x, kernel, "valid") for x in white], axis=1)


def track_of(values, phase, *, cuts=()):
    """Return the track of a movement, cut into recordings."""
    cycle = Cycle.fit([phase], [values], harmonics=5)
    recordings, phases = np.split(values, cuts), np.split(phase, cuts)
    shifts = [np.zeros_like(y) for y in recordings]
    return PhaseTrack(recordings=recordings, phases=phases, shifts=shifts, cycle=cycle)


def moving(cycles, *, seed=0, noise=0.03, spread=0.04, cuts=()):
    """Return the track of a movement whose tempo varies, with smooth noise."""
    rng = np.random.default_rng(seed)
    tempo = 1 + spread * smooth(round(cycles * PERIOD) + 1, rng, 20)[:, 0]
    phase = np.cumsum(2 * np.pi / PERIOD * tempo)
    return track_of(curve(phase) + noise * smooth(len(phase), rng), phase, cuts=cuts)


def calibrated(track):
    """Return the calibration of windows of 60 samples, of which 10 are known."""
    return calibrate(track, phase_grid(track, 12), n_steps=60, reference_step=SEEN)


def autoregressive(count, seed, coefficient):
    """Return samples (count, 2) of which nothing but the recent ones is a sign."""
    noise = np.random.default_rng(seed).standard_normal((count + 100, 2))
    for i in range(1, len(noise)):
        noise[i] += coefficient * noise[i - 1]
    return noise[100:]


def sizes(covariances):
    return np.trace(covariances, axis1=1, axis2=2)


# Replay ------------------------------------------------------------------


@pytest.mark.parametrize("coefficient", [0.0, 0.9])
@pytest.mark.parametrize("count", [200, 1000])
def test_errors_of_replay_are_as_large_as_they_are_said_to_be(coefficient, count):
    """Mean squared Mahalanobis distances per channel, of samples that were not seen."""
    squares = []
    for seed in range(3):
        known = [autoregressive(count, seed, coefficient)]
        held = autoregressive(400, seed + 50, coefficient)
        replay = Replay(known, SEEN, HORIZON)
        calibration = calibrate_replay(known, SEEN, HORIZON).at(HORIZON)
        for first in range(0, len(held) - SEEN - HORIZON, 11):
            past = held[first : first + SEEN]
            truth = held[first + SEEN : first + SEEN + HORIZON]
            replayed = replay.predict(past)
            mean, covariances = calibration.combined(
                replayed.values,
                calibration.error_covariances,
                replayed,
                replay.variance,
            )
            error = truth - mean
            solved = np.linalg.solve(covariances, error[..., None])[..., 0]
            squares.append(np.sum(error * solved, axis=1) / 2)
    assert np.all(np.abs(np.log(np.mean(squares, axis=0))) < np.log(1.9))
    assert 0.7 < np.mean(squares) < 1.3


@pytest.mark.parametrize("seen", [2, 3, 8])
def test_replay_continues_the_velocity_of_an_offset(seen):
    path = curve(2 * np.pi * np.arange(6 * PERIOD) / PERIOD)
    replay = Replay([path], seen, HORIZON)
    first = 2 * PERIOD
    past = path[first : first + seen]
    drift = 1e-5 * np.arange(1 - seen, 1)[:, None]
    change = replay.predict(past + drift).values[0] - replay.predict(past).values[0]
    # By a step, less the decay.
    assert_allclose(change, 0.8e-5, rtol=0.1)


def test_what_repeats_exactly_has_small_errors_and_smaller_ones_the_longer_it_lasts():
    relative = []
    for cycles in (1.2, 4, 8, 16):
        path = curve(2 * np.pi * np.arange(round(cycles * PERIOD)) / PERIOD)
        calibration = calibrate_replay([path], SEEN, HORIZON)
        changes = [
            np.sum(np.mean((path[h:] - path[:-h]) ** 2, axis=0))
            for h in calibration.horizons.astype(int)
        ]
        relative.append(sizes(calibration.error_covariances) / changes)
    relative = np.mean(relative, axis=1)
    assert np.all(np.diff(relative) < 0)
    assert 0.1 < relative[0] < 0.5
    assert relative[-1] < 0.04


def test_replay_alone_has_no_model_and_reports_how_long_it_looked():
    found = [calibrate_replay([autoregressive(n, 0, 0.9)], SEEN, 30) for n in (60, 600)]
    for each in found:
        assert each.model_weight == 0.0
        assert_allclose(each.factors, 1.0)
        assert each.horizons[0] == 1.0
        assert np.all(np.diff(each.horizons) > 0)
        assert 20 <= each.horizons[-1] <= 30
        assert 0 < each.local_factor < 1
    short, long = found
    assert 4 < short.degrees_of_freedom < long.degrees_of_freedom
    assert 0.2 > short.background_weight > long.background_weight > 0


def test_too_short_recordings_have_no_calibration():
    path = autoregressive(SEEN, 0, 0.9)
    assert calibrate_replay([path], SEEN, HORIZON) is None
    assert calibrate_replay([path, path], SEEN, HORIZON) is None
    # Too short to leave a part out, but not to replay.
    found = calibrate_replay([autoregressive(SEEN + 4, 0, 0.9)], SEEN, HORIZON)
    assert np.all(np.isfinite(found.error_covariances))
    assert np.all(np.linalg.eigvalsh(found.error_covariances) > 0)


def test_changes_have_the_shape_of_what_recordings_move_in_a_time():
    recordings = [autoregressive(60, 1, 0.9) * [1, 3], autoregressive(15, 2, 0.9)]
    calibration = calibrate_replay(recordings, SEEN, HORIZON)
    for ahead, change in zip(
        calibration.horizons, calibration.change_covariances, strict=True
    ):
        h = int(ahead)
        steps = np.concatenate([y[h:] - y[:-h] for y in recordings if len(y) > h])
        expected = np.mean([np.outer(x, x) for x in steps], axis=0)
        assert_allclose(change, expected / np.trace(expected), atol=1e-6)


@pytest.mark.parametrize("size", [1.0, 0.5, 20.0])
def test_a_calibration_scales_and_permutes_with_the_channels(size):
    A = size * np.array([[0.0, 1.0], [-1.0, 0.0]])
    path = autoregressive(150, 3, 0.9) * [1.0, 2.0]
    before = calibrate_replay([path], SEEN, HORIZON)
    after = calibrate_replay([path @ A.T], SEEN, HORIZON)
    assert_allclose(
        after.error_covariances, A @ before.error_covariances @ A.T, rtol=1e-5
    )
    assert_allclose(
        after.change_covariances,
        A @ before.change_covariances @ A.T / size**2,
        atol=1e-5,
    )
    track = moving(4)
    turned = track_of(track.recordings[0] @ A.T, track.phases[0])
    before, after = calibrated(track), calibrated(turned)
    largest = np.max(after.error_covariances)
    assert_allclose(
        after.error_covariances, A @ before.error_covariances @ A.T, atol=0.01 * largest
    )
    assert_allclose(after.factors, before.factors, rtol=0.01)
    assert after.model_weight == pytest.approx(before.model_weight, rel=0.01)


def test_channels_are_independent_until_parts_show_otherwise():
    one = autoregressive(1000, 0, 0.9)[:, :1]
    correlations = []
    for count in (SEEN + 5, 100, 1000):
        path = np.repeat(one[:count], 2, axis=1) + 1e-3 * autoregressive(count, 1, 0.5)
        error = calibrate_replay([path], SEEN, HORIZON).error_covariances[3]
        correlations.append(error[0, 1] / np.sqrt(error[0, 0] * error[1, 1]))
    assert np.all(np.diff(correlations) > 0)
    assert 0.2 < correlations[0] < 0.4
    assert correlations[-1] > 0.75


# Phase model -------------------------------------------------------------


def test_the_more_cycles_the_less_is_added_to_the_model():
    found = [calibrated(moving(cycles)) for cycles in (2, 4, 8, 14, 20, 40)]
    assert all(each.horizons[-1] <= 50 for each in found)
    added = [np.mean(sizes(each.error_covariances)[:6]) for each in found]
    assert np.all(np.diff(added) < 0)
    assert added[-1] < 0.003 * added[0]
    for name, sign in (("degrees_of_freedom", 1), ("background_weight", -1)):
        assert np.all(sign * np.diff([getattr(each, name) for each in found]) > 0)
    few, many = found[:4], found[4:]
    assert np.all(np.diff([each.local_factor for each in few]) < 0)
    assert all(0.05 < each.model_weight < 0.95 for each in few)
    assert all(each.model_weight == 1.0 and each.local_factor == 0.0 for each in many)
    assert all(np.all(each.factors > 0) for each in found)


def test_many_cycles_of_a_stationary_noise_need_little_correction():
    rng = np.random.default_rng(0)
    phase = np.cumsum(2 * np.pi / PERIOD * (1 + 0.02 * rng.standard_normal(2401)))
    values = curve(phase) + 0.03 * smooth(len(phase), rng)
    found = calibrated(track_of(values, phase))
    assert np.all((found.factors > 0.8) & (found.factors < 2.3))
    assert np.mean(found.factors) < 2.0


def test_covariances_are_enlarged_where_left_out_parts_were_not_foreseen():
    """The last fifth of many cycles is ten times as noisy as the others."""
    track, rng = moving(24, noise=0.01), np.random.default_rng(3)
    values = track.recordings[0].copy()
    fifth = len(values) // 5
    values[-fifth:] += 0.1 * smooth(fifth, rng)
    noisy = calibrated(track_of(values, track.phases[0]))
    assert np.all(noisy.factors > 2 * calibrated(track).factors)


def test_variances_of_cycles_too_few_to_leave_out_are_enlarged():
    once, twice = (calibrated(moving(cycles)).at(10) for cycles in (1.3, 2.0))
    assert once.factors[-1] > 1.2 * twice.factors[-1] > 1.2**2


class FakeReplay:
    """Replay whose error a test gives, as the whole movement is known to it."""

    def __init__(self, track, error):
        self.values = np.concatenate(track.recordings)
        self.error, self.rests, self.pasts, self.missed = error, [], [], 0

    def __call__(self, recordings, seen, horizon):
        self.rests.append((recordings, len(self.pasts)))
        self.seen, self.horizon = seen, horizon
        return self

    is_possible = True

    def predict(self, past):
        at = self.place(past)
        self.pasts.append(at)
        ahead = np.arange(at + self.seen, at + self.seen + self.horizon)
        truth = self.values[np.minimum(ahead, len(self.values) - 1)]
        d = truth.shape[1]
        return Replayed(truth + self.error(truth), np.zeros((self.horizon, d, d)), 0.0)

    def place(self, past):
        """Return where in the movement a past begins."""
        (found,) = np.flatnonzero(np.all(self.values == past[0], axis=1))
        return int(found)


@pytest.mark.parametrize("cycles", [4, 8])
def test_weight_of_the_model_is_larger_where_replay_is_worse(monkeypatch, cycles):
    track, rng = moving(cycles), np.random.default_rng(7)
    weights, added = [], []
    for size in (0.0, 0.1, 1.0):
        replay = FakeReplay(track, lambda y, s=size: s * rng.standard_normal(y.shape))
        monkeypatch.setattr(module, "Replay", replay)
        found = calibrated(track)
        weights.append(found.model_weight)
        added.append(np.mean(sizes(found.error_covariances)[:4]))
    assert np.all(np.diff(weights) > 0.02)
    assert np.all(np.diff(added) > 0)
    # Without errors of replay the prior alone is left; with large ones the model.
    assert 0.1 < weights[0] < 0.25
    assert 0.6 < weights[-1] <= 1.0


def test_windows_are_played_without_what_replay_does_to_predictions(monkeypatch):
    track, played, weights = moving(8), [], []
    for error in (0.0, 0.4):
        replay = FakeReplay(track, lambda y, e=error: 0 * y + [e, 0.0])
        monkeypatch.setattr(module, "Replay", replay)
        found = calibrated(track)
        played.append(found.playback_covariances)
        weights.append(found.model_weight)
    # The model is nearly right, so a window lies a part of replay's error beside
    # predictions. In the other channel replay errs no more than it did.
    beside = (1 - weights[1]) * 0.4
    assert 0.05 < beside < 0.3
    assert np.all(played[1][:4, 0, 0] > 0.5 * beside**2)
    assert np.all(played[1][:4, 1, 1] < 0.2 * beside**2)
    assert np.all(np.linalg.eigvalsh(played[0]) > 0)


def test_windows_of_many_cycles_are_played_as_they_are_predicted():
    assert calibrated(moving(20)).playback_covariances is None


def test_predicted_parts_are_not_among_what_is_learned(monkeypatch):
    track = moving(6, cuts=[90])
    replay = FakeReplay(track, lambda y: 0 * y)
    monkeypatch.setattr(module, "Replay", replay)
    calibrated(track)
    counts = [number for _, number in replay.rests] + [len(replay.pasts)]
    covered = np.zeros(len(replay.values), dtype=bool)
    for (rest, first), last in zip(replay.rests, counts[1:], strict=True):
        learned = np.zeros(len(replay.values), dtype=bool)
        for part in rest:
            begin = replay.place(part)
            assert_allclose(part, replay.values[begin : begin + len(part)])
            learned[begin : begin + len(part)] = True
        assert np.sum(learned) > len(learned) // 2
        for past in replay.pasts[first:last]:
            # The past, and at least one sample to compare.
            assert not np.any(learned[past : past + SEEN + 1])
        covered[replay.pasts[first:last]] = True
        between = np.diff(replay.pasts[first:last])
        assert np.all((between >= 1) & (between <= 90))
    assert len(replay.rests) >= 4
    # All over the movement, but for the ends of the parts.
    assert np.sum(covered) > len(covered) // 4
    assert covered[0]
    assert 100 < len(replay.pasts) <= 300


def test_replay_predicts_several_parts_of_each_recording_without_them(monkeypatch):
    recordings = [autoregressive(n, n, 0.9) for n in (300, 40, 120)]
    track = PhaseTrack(recordings=recordings, phases=[], shifts=[], cycle=None)
    replay = FakeReplay(track, lambda y: 0 * y)
    monkeypatch.setattr(module, "Replay", replay)
    calibrate_replay(recordings, SEEN, HORIZON)
    counts = [number for _, number in replay.rests]
    parts = {}
    for (rest, first), last in zip(replay.rests, counts[1:], strict=False):
        learned = {tuple(y) for part in rest for y in part}
        pasts = replay.pasts[first:last]
        for past in pasts:
            missing = [tuple(y) in learned for y in replay.values[past : past + SEEN]]
            assert not any(missing)
        number = int(np.searchsorted([300, 340, 460], pasts[0], side="right"))
        parts[number] = parts.get(number, 0) + 1
    # In proportion to their lengths, and two of the shortest.
    assert parts[1] == 2
    assert parts[0] > parts[2] > 2
    assert 150 < len(replay.pasts) <= 300


def test_phases_that_are_shown_once_cannot_be_validated():
    """The prior is left, as of a recording that is too short; of several passes it is not."""
    prior = calibrated(moving(1.2)).model_weight
    slow = 2 * np.pi * np.arange(200) / 200
    values = curve(slow) + 0.03 * smooth(200, np.random.default_rng(0))
    assert calibrated(track_of(values, slow)).model_weight == prior
    # Twenty samples of a cycle have gaps between them, which do not matter.
    quick = 2 * np.pi * np.arange(200) / 20
    values = curve(quick) + 0.03 * smooth(200, np.random.default_rng(0))
    assert calibrated(track_of(values, quick)).model_weight != prior


def test_errors_that_no_part_reaches_grow_as_the_movement_changes():
    """Two parts of 25 samples, of which 10 are known, reach 14 samples ahead and not 20."""
    path = autoregressive(50, 5, 0.95)
    found = calibrate_replay([path], SEEN, HORIZON).at(HORIZON)
    changes = [np.sum(np.mean((path[h:] - path[:-h]) ** 2, axis=0)) for h in (14, 20)]
    growth = sizes(found.error_covariances)[19] / sizes(found.error_covariances)[13]
    assert 1 < growth / (changes[1] / changes[0]) < 1.3


def test_an_exact_movement_has_a_calibration():
    phase = 2 * np.pi * np.arange(241) / PERIOD
    found = calibrated(track_of(curve(phase), phase))
    for values in (found.factors, found.error_covariances, found.change_covariances):
        assert np.all(np.isfinite(values))
    assert np.all(found.factors > 0)


def test_whole_turns_and_cuts_of_the_recordings_do_not_matter():
    track = moving(6)
    before = calibrated(track)
    phase = track.phases[0] - 20 * np.pi
    turned = calibrated(track_of(track.recordings[0], phase))
    assert_allclose(turned.factors, before.factors, rtol=1e-6)
    assert_allclose(
        turned.error_covariances, before.error_covariances, rtol=1e-6, atol=1e-12
    )
    cut = calibrated(moving(6, cuts=[120]))
    assert cut.model_weight == pytest.approx(before.model_weight, abs=0.1)
    assert_allclose(cut.factors, before.factors, rtol=0.3)
    assert_allclose(
        sizes(cut.error_covariances), sizes(before.error_covariances), rtol=0.4
    )


# Mixture -----------------------------------------------------------------


class Player:
    """Playback of windows whose error grows as a test says, and what it was asked."""

    def __init__(self, recordings, error, length):
        self.recordings, self.error, self.length = recordings, error, length
        self.rests, self.pasts = [], []

    def learn(self, rest):
        self.rests.append(rest)
        self.pasts.append([])
        return self.play

    def play(self, past):
        i, at = self.place(past)
        self.pasts[-1].append((i, at))
        ahead = np.arange(1, self.length + 1)
        y = self.recordings[i]
        truth = y[np.minimum(at + len(past) - 1 + ahead, len(y) - 1)]
        return truth + ahead[:, None] * self.error

    def place(self, past):
        ((i, at),) = [
            (i, int(at))
            for i, y in enumerate(self.recordings)
            for at in np.flatnonzero(np.all(y == past[0], axis=1))
        ]
        assert np.array_equal(self.recordings[i][at : at + len(past)], past)
        return i, at


def flat(recordings):
    """Return a calibration with errors that grow as the time ahead."""
    made = calibrate_replay(recordings, SEEN, HORIZON)
    errors = made.horizons[:, None, None] * np.eye(2)
    return Calibration(
        horizons=made.horizons,
        factors=made.factors,
        error_covariances=errors,
        change_covariances=made.change_covariances,
    )


@pytest.mark.parametrize("length", [HORIZON, 7])
def test_played_errors_are_those_of_windows_that_were_left_out(length):
    recordings = [autoregressive(170, 0, 0.9), autoregressive(120, 1, 0.9)]
    error = np.array([0.3, -0.2])
    player = Player(recordings, error, length)
    before = flat(recordings)
    found = calibrate_playback(before, recordings, player.learn, seen=SEEN)
    parts = len(player.rests)
    assert 3 <= parts <= 6
    # A few parts show too small errors: what is known of n parts is enlarged by 2 / n.
    known = before.horizons[before.horizons <= length]
    variances = (1 + 2 / parts) * known[:, None] ** 2 * error**2
    at = found.playback_covariances[: len(known)]
    assert_allclose(np.diagonal(at, axis1=1, axis2=2), variances, rtol=0.02)
    correlation = at[:, 0, 1] / np.sqrt(at[:, 0, 0] * at[:, 1, 1])
    assert np.all((correlation < -0.5) & (correlation > -0.9))
    # Farther than it is played, it increases by as much as the errors did before.
    later = sizes(found.playback_covariances)[len(known) - 1 :]
    expected = sizes(before.error_covariances)[len(known) - 1 :]
    assert_allclose(later - later[0], expected - expected[0], rtol=0.004)
    assert_allclose(found.error_covariances, before.error_covariances)


def test_every_part_is_left_out_once_and_played_all_along():
    recordings = [autoregressive(170, 0, 0.9), autoregressive(120, 1, 0.9)]
    player = Player(recordings, np.array([0.3, -0.2]), HORIZON)
    calibrate_playback(flat(recordings), recordings, player.learn, seen=SEEN)
    total = sum(map(len, recordings))
    left_out = 0
    for rest, pasts in zip(player.rests, player.pasts, strict=True):
        learned = {tuple(y) for part in rest for y in part}
        assert len(pasts) > 10
        assert len({i for i, _ in pasts}) == 1
        starts = np.array([at for _, at in pasts])
        y = recordings[pasts[0][0]]
        for at in starts:
            assert not any(tuple(x) in learned for x in y[at : at + SEEN + 1])
        # From the first sample of the part to one of the last that have a successor.
        part = [k for k in range(len(y)) if tuple(y[k]) not in learned]
        assert starts[0] == part[0]
        assert 0 <= part[-1] - SEEN - starts[-1] <= 5
        assert np.ptp(np.diff(starts)) <= 1
        assert len(part) + len(learned) == total
        left_out += len(part)
    assert left_out == total


def test_of_many_recordings_some_from_first_to_last_are_left_out():
    recordings = [autoregressive(60, seed, 0.9) for seed in range(40)]
    player = Player(recordings, np.array([0.3, -0.2]), HORIZON)
    calibrate_playback(flat(recordings), recordings, player.learn, seen=SEEN)
    left_out = [pasts[0][0] for pasts in player.pasts]
    assert len(left_out) == len(set(left_out)) == 16
    assert (left_out[0], left_out[-1]) == (0, 39)
    assert np.ptp(np.diff(left_out)) <= 1


def test_without_windows_to_play_a_calibration_is_unchanged():
    recordings = [autoregressive(60, 0, 0.9)]
    before = flat(recordings)
    assert calibrate_playback(before, recordings, lambda _: None, seen=SEEN) is before
    short = [autoregressive(SEEN + 1, 0, 0.9)]
    player = Player(short, np.zeros(2), HORIZON)
    assert calibrate_playback(before, short, player.learn, seen=SEEN) is before


# Use ---------------------------------------------------------------------


def test_a_calibration_is_linear_between_its_horizons_and_constant_beyond():
    made = flat([autoregressive(100, 0, 0.9)])
    found = made.at(30)
    assert_allclose(found.horizons, np.arange(1, 31))
    assert found.playback_covariances is None
    expected = np.minimum(np.arange(1, 31), made.horizons[-1])
    assert_allclose(found.error_covariances, expected[:, None, None] * np.eye(2))
    assert found.factors.shape == (30,)
    assert found.change_covariances.shape == (30, 2, 2)


@pytest.mark.parametrize("played", [True, False])
def test_a_transformed_calibration_is_of_the_transformed_channels(played):
    rng = np.random.default_rng(0)
    A, e = rng.standard_normal((2, 2)), rng.standard_normal((3, 1, 2, 2))
    errors, changes, windows = e[:, 0] @ e[:, 0].mT + np.eye(2)
    before = Calibration(
        horizons=np.array([2.0]),
        factors=np.ones(1),
        error_covariances=errors[None],
        change_covariances=changes[None],
        playback_covariances=windows[None] if played else None,
    )
    after = before.transformed(A)
    assert_allclose(after.error_covariances[0], A @ errors @ A.T)
    assert_allclose(after.change_covariances[0], A @ changes @ A.T)
    own = windows if played else errors
    assert_allclose(after.playback_covariance(1.0), A @ own @ A.T / 2)
    assert (after.playback_covariances is None) != played


def test_many_cycles_are_a_bound_between_two_ways_of_prediction():
    for cycles in (MANY_CYCLES - 1.5, MANY_CYCLES + 1.5):
        assert (calibrated(moving(cycles)).model_weight == 1.0) == (
            cycles > MANY_CYCLES
        )
