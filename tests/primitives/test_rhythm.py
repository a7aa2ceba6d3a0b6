"""Facts about what is rhythm in a recording, and what is left out."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from synthetic_recordings import (
    RATE,
    eased,
    few_cycles,
    named_curve,
    random_curve,
    smooth_noise,
    synthetic_recording,
    varying_phase,
    with_pause,
)

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    find_rhythm,
    load_skill,
    save_skill,
)
from fmp_drake.primitives.model.phase import segmentation
from fmp_drake.primitives.model.phase.self_alignment import (
    aligned_period,
    aligned_samples,
    self_alignments,
)
from fmp_drake.station import models_dir


def demonstration(values):
    return Demonstration(time=np.arange(len(values)) / RATE, values=values)


def drop(phase, size=0.1):
    """Return points (n, 2) of a closed curve that no symmetry maps to itself."""
    phase = np.asarray(phase)
    x = np.cos(phase) + 0.3 * np.cos(2 * phase)
    return size * np.column_stack([x, 0.7 * np.sin(phase)])


def phases(count, period=50):
    return 2 * np.pi / period * np.arange(count)


def agreement(seeds):
    """Return which periods, cycles and parts of synthetic recordings are found."""
    period, cycles, parts = [], [], []
    for seed in seeds:
        truth = synthetic_recording(seed)
        found = find_rhythm(demonstration(truth.values))
        period.append(abs(found.period / truth.period - 1) < 0.05)
        cycles.append(abs(found.cycles - truth.cycles) < 0.5)
        parts += [
            any(
                abs(part.start - start) <= 0.3
                and abs(part.end - end) <= 0.3
                and part.kind == kind
                for part in found.left_out
            )
            for start, end, kind in truth.left_out
        ]
        parts += [False] * (len(found.left_out) - len(truth.left_out))
    return np.mean(period), np.mean(cycles), np.mean(parts)


def test_approach_retreat_lifts_pauses_and_bouts_are_found():
    assert min(agreement(range(300, 325))) >= 0.9


@pytest.mark.slow
def test_rhythm_is_found_in_95_of_100_recordings():
    assert min(agreement(range(200))) >= 0.95


def test_learning_and_inspection_agree_on_the_rhythm():
    recording = demonstration(synthetic_recording(6).values)
    skill = FourierMovementPrimitive().fit(recording)
    found = find_rhythm(recording)
    assert skill.rhythm_ == found
    assert skill.phase_model_.period / RATE == pytest.approx(found.period)
    assert len(skill.paths_) == len(found.bouts) > 1


@pytest.mark.parametrize("model", ["automatic", "phase"])
def test_window_is_at_most_as_long_as_the_recording(model):
    skill = FourierMovementPrimitive(model=model).fit(demonstration(drop(phases(110))))
    assert skill.model_ == "phase"
    assert skill.n_steps <= 110
    assert skill.n_windows_ >= 1


def test_a_window_longer_than_the_longest_bout_is_shortened_with_a_remark(tmp_path):
    skill = FourierMovementPrimitive(window=8.0).fit(demonstration(drop(phases(110))))
    assert (skill.model_, skill.n_steps, skill.n_windows_) == ("phase", 110, 1)
    assert "the window is 5.5 s instead of 8 s" in skill.model_reason_
    save_skill(skill, tmp_path / "s.npz")
    assert load_skill(tmp_path / "s.npz").n_steps == 110
    assert skill.fit(demonstration(drop(phases(400)))).window == 8.0
    assert "instead" not in skill.model_reason_


def test_a_skill_file_keeps_the_rhythm(tmp_path):
    skill = FourierMovementPrimitive().fit(demonstration(synthetic_recording(6).values))
    save_skill(skill, tmp_path / "s.npz")
    assert load_skill(tmp_path / "s.npz").rhythm_ == skill.rhythm_


def test_a_growing_amplitude_is_reported():
    growing = drop(phases(1200)) * np.linspace(0.7, 1.4, 1200)[:, None]
    found = find_rhythm(demonstration(growing))
    assert found.amplitude_change == pytest.approx(0.67, abs=0.1)
    assert not found.left_out
    assert any("the amplitude grows" in line for line in found.describe())


def test_an_eight_that_grows_to_three_times_its_size_is_one_movement():
    phase = phases(600)
    eight = 0.1 * np.column_stack([np.sin(phase), 0.6 * np.sin(2 * phase)])
    found = find_rhythm(demonstration(eight * np.linspace(0.5, 1.5, 600)[:, None]))
    assert found.amplitude_change == pytest.approx(1.0, abs=0.2)
    assert not found.left_out


def test_a_growing_tempo_is_reported():
    phase = np.cumsum(2 * np.pi / 50 * np.linspace(0.75, 1.3, 1200))
    found = find_rhythm(demonstration(drop(phase)))
    assert found.tempo_change > 0.3
    assert not found.left_out
    assert any("the tempo grows" in line for line in found.describe())


def test_a_steady_movement_has_no_remark():
    found = find_rhythm(demonstration(drop(phases(600))))
    assert found.describe() == ["12.0 cycles of 2.50 s"]


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3])
def test_a_movement_on_a_line_has_its_own_period(noise):
    """Forwards and backwards are the same there."""
    time = np.arange(0, 40, 0.05)
    x = 0.1 * np.sin(2 * np.pi * time / 4)
    path = np.column_stack([x, 0.5 * x, 0 * x])
    path += noise * np.random.default_rng(0).standard_normal(path.shape)
    rhythm = find_rhythm(Demonstration(time=time, values=path))
    assert rhythm.period == pytest.approx(4, rel=0.01)
    assert rhythm.cycles == pytest.approx(10, abs=0.1)


@pytest.mark.parametrize("period", [0, -4.0, np.nan])
def test_a_period_that_cannot_be_is_refused(period):
    path = Demonstration(time=np.arange(100) / 20, values=np.ones((100, 1)))
    with pytest.raises(DemonstrationError, match=r"period is .*at least 0\.4 s"):
        find_rhythm(path, period=period)


def test_reversal_is_not_a_pause():
    phase = phases(1200)
    phase = np.concatenate([phase[:700], 2 * phase[700] - phase[700:]])
    found = find_rhythm(demonstration(drop(phase)))
    backwards = [part for part in found.left_out if part.kind == "backwards"]
    assert [part.start for part in backwards] == pytest.approx([35], abs=0.3)
    assert backwards == list(found.left_out)
    text = " ".join(found.remarks())
    assert "the direction reverses" in text
    assert "% of the recording is left out" in text


@pytest.mark.parametrize("shape", ["circle", "eight", "scrub"])
@pytest.mark.parametrize("turn", [9.0, 22.0])
def test_the_shorter_direction_ends_at_the_turn(shape, turn):
    rng = np.random.default_rng(3)
    velocity = 2 * np.pi / 60 * np.clip((turn * RATE - np.arange(620)) / 10, -1, 1)
    curve = named_curve(rng, shape, 3)
    values = curve(np.cumsum(velocity)) + smooth_noise(rng, 620, 3, 5e-4)
    found = find_rhythm(demonstration(values))
    (part,) = found.left_out
    (bout,) = found.bouts
    assert part.kind == "backwards"
    assert part.duration < bout.duration
    assert min(part.end, bout.end) == pytest.approx(turn, abs=0.3)
    assert found.period == pytest.approx(3.0, rel=0.05)


@pytest.mark.parametrize("is_first", [True, False])
def test_the_longer_of_two_movements_is_learned(is_first):
    rng = np.random.default_rng(8)
    longer = named_curve(rng, "circle", 3)(varying_phase(rng, 500, 50, 0.05))
    shorter = named_curve(rng, "scrub", 3)(varying_phase(rng, 280, 70, 0.05))
    both = [longer, shorter] if is_first else [shorter, longer]
    way = eased(both[0][-1], both[1][0], 20)
    values = np.concatenate([both[0], way, both[1]])
    found = find_rhythm(demonstration(values + smooth_noise(rng, 800, 3, 5e-4)))
    (bout,) = found.bouts
    start = 0.0 if is_first else 15.0
    assert (bout.start, bout.end) == pytest.approx((start, start + 25.0), abs=0.3)
    assert [part.kind for part in found.left_out] == ["another movement"]


def test_a_slow_pause_where_the_movement_is_slow_is_found():
    path = 0.1 * np.column_stack(
        [np.cos(phases(800, 80)), 0.1 * np.sin(phases(800, 80))]
    )
    values = np.concatenate([path[:400], np.repeat(path[[400]], 30, 0), path[400:]])
    (pause,) = find_rhythm(demonstration(values)).left_out
    assert (pause.start, pause.end) == pytest.approx((20, 21.5), abs=0.4)
    assert pause.kind == "pause"


@pytest.mark.parametrize("size", [0, 1e-3, 2e-3])
def test_noise_of_a_sensor_does_not_make_a_lift_of_a_pause(size):
    path = drop(phases(600))
    values = np.concatenate([path[:280], np.tile(path[280], (60, 1)), path[280:]])
    values += size * np.random.default_rng(5).standard_normal(values.shape)
    (pause,) = find_rhythm(demonstration(values)).left_out
    assert pause.kind == "pause"
    assert (pause.start, pause.end) == pytest.approx((14, 17), abs=0.3)


def test_two_movements_in_one_recording_are_told_apart():
    circle = 0.1 * np.column_stack([np.cos(phases(700)), np.sin(phases(700))])
    turns = phases(600, 60)
    eight = 0.1 * np.column_stack([np.sin(turns), 0.5 * np.sin(2 * turns)])
    found = find_rhythm(demonstration(np.concatenate([circle, eight])))
    (other,) = (part for part in found.left_out if part.kind == "another movement")
    assert (other.start, other.end) == pytest.approx((35, 65), abs=0.3)
    assert any("two movements" in line for line in found.remarks())


@pytest.mark.parametrize("seed", [26, 56])
def test_transition_to_another_movement_is_not_a_pause(seed):
    rng = np.random.default_rng(seed)
    first, second = random_curve(rng, 3), random_curve(rng, 3)
    first = first(varying_phase(rng, 250, 50, 0.05))
    second = second(varying_phase(rng, 260, 65, 0.05))
    values = np.concatenate([first, second - second[0] + first[-1]])
    values += smooth_noise(rng, len(values), 3, 1e-3)
    found = find_rhythm(demonstration(values))
    assert "pause" not in {part.kind for part in found.left_out}


def test_a_user_may_choose_part_and_period():
    values = np.concatenate([drop(phases(500)), drop(phases(500, 80), 0.2)])
    recording = demonstration(values)
    chosen = find_rhythm(recording, start_time=26.0, end_time=49.0)
    assert chosen.period == pytest.approx(4.0, rel=0.02)
    assert chosen.bouts[0].start == pytest.approx(26.0, abs=0.3)
    skill = FourierMovementPrimitive().fit(recording, start_time=26.0, end_time=49.0)
    assert skill.rhythm_ == chosen
    double = find_rhythm(demonstration(drop(phases(600))), period=5.0)
    assert double.period == pytest.approx(5.0, rel=0.02)
    assert double.cycles == pytest.approx(6, abs=0.1)


def test_a_part_without_samples_is_refused():
    with pytest.raises(DemonstrationError, match="no two samples from 40 s to 50 s"):
        find_rhythm(demonstration(drop(phases(600))), start_time=40.0, end_time=50.0)


def test_recording_without_repetition_has_no_rhythm():
    path = eased(np.zeros(2), np.ones(2), 200)
    with pytest.raises(DemonstrationError, match="no part of it recurs"):
        find_rhythm(demonstration(path))


@pytest.mark.parametrize("seed", [7, 22])
def test_a_smooth_random_path_has_no_rhythm(seed):
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((500, 2))
    path = gaussian_filter1d(normals, rng.uniform(8, 24), axis=0, mode="wrap") / 2
    # It is closed, so that it can only be one cycle.
    assert find_rhythm(demonstration(path)).cycles == 1
    with pytest.raises(DemonstrationError, match="cycles"):
        find_rhythm(demonstration(path[:420]))
    if seed == 22:  # The user knows it better.
        assert find_rhythm(demonstration(path), period=11.7).cycles > 1.5


@pytest.mark.parametrize(
    ("name", "period", "cycles"),
    [
        ("car_fender_3", 5.5, 3.7),
        ("car_rim_1", 1.97, 2.7),
        ("car_rim_4", 1.7, 5.9),
        ("drums_01", 4.95, 2.0),
        ("panda_mixing_pan", 1.25, 4.2),
        ("panda_wiping_big_board_2_loop", 5.1, 2.1),
    ],
)
def test_rhythm_of_real_recordings_is_found(
    real_demonstration_paths, name, period, cycles
):
    with np.load(real_demonstration_paths[name]) as file:
        recording = Demonstration(time=file["time"], values=file["position"])
    found = find_rhythm(recording)
    assert found.period == pytest.approx(period, rel=0.05)
    assert found.cycles == pytest.approx(cycles, abs=0.5)


@pytest.mark.parametrize("name", ["car_rim_1", "car_rim_4"])
def test_the_rhythm_of_positions_is_found_beside_all_other_channels(
    real_demonstration_paths, name
):
    with np.load(real_demonstration_paths[name]) as file:
        names = ("position", "quaternion", "force", "joints")
        arrays, time = [file[key] for key in names], file["time"]
    units = ("m",) * 3 + ("1",) * 4 + ("N",) * 3 + ("rad",) * 7
    values = np.concatenate(arrays, axis=1)
    found = find_rhythm(
        Demonstration(
            time=time,
            values=values,
            channels=tuple(f"c{i}" for i in range(len(units))),
            units=units,
        )
    )
    alone = find_rhythm(Demonstration(time=time, values=values[:, :3]))
    assert found.period == pytest.approx(alone.period, rel=0.01)
    assert found.cycles == pytest.approx(alone.cycles, abs=0.1)


def found_of_few_cycles(seeds, cycles):
    """Return the fractions of periods that are right and wrong, and of right bout ends."""
    is_right, is_wrong, ends = [], [], []
    for seed in seeds:
        truth = few_cycles(seed, cycles)
        try:
            found = find_rhythm(demonstration(truth.values))
        except DemonstrationError:
            found = None
        is_right.append(
            found is not None and abs(found.period / truth.period - 1) < 0.08
        )
        is_wrong.append(found is not None and not is_right[-1])
        if is_right[-1]:
            (_, begin, _), (end, _, _) = truth.left_out
            ends += [
                abs(found.bouts[0].start - begin) <= 0.3,
                abs(found.bouts[-1].end - end) <= 0.3,
            ]
    return np.mean(is_right), np.mean(is_wrong), np.mean(ends)


@pytest.mark.parametrize(
    ("cycles", "least"), [(1.3, 0.6), (1.5, 0.9), (2.2, 0.9), (3, 0.9)]
)
def test_few_cycles_between_approach_and_retreat_are_found(cycles, least):
    is_right, is_wrong, ends = found_of_few_cycles(range(700, 730), cycles)
    assert is_right >= least
    assert is_wrong <= 0.04
    assert ends >= 0.9


@pytest.mark.parametrize(("cycles", "least"), [(1.6, 0.8), (2.2, 0.9), (3, 0.95)])
@pytest.mark.parametrize("has_approach", [True, False])
def test_few_cycles_with_a_pause_within_are_found(cycles, least, has_approach):
    is_right = []
    for seed in range(930, 950):
        truth = few_cycles(seed, cycles, has_approach=has_approach)
        rng = np.random.default_rng(seed)
        count, start = truth.values.shape[0], rng.uniform(0.3, 0.7)
        at, length = round(start * count), round(rng.uniform(1.5, 5.0) * RATE)
        held = np.repeat(truth.values[[at]], length, axis=0)
        held += 3e-5 * np.cumsum(rng.standard_normal(held.shape), axis=0)
        values = np.concatenate([truth.values[:at], held, truth.values[at:]])
        try:
            found = find_rhythm(demonstration(values)).period
        except DemonstrationError:
            found = np.inf
        is_right.append(abs(found / truth.period - 1) < 0.08)
    assert np.mean(is_right) >= least


@pytest.mark.parametrize(
    ("cycles", "places", "height", "least"),
    [
        (1.6, 1, 0.0, 0.7),
        (2.2, 1, 0.0, 0.8),
        (3, 1, 0.0, 0.9),
        (3, 2, 0.0, 0.7),
        (2.2, 1, 0.1, 0.6),
        (3, 1, 0.1, 0.75),
    ],
)
def test_few_cycles_with_pauses_and_lifts_are_found(cycles, places, height, least):
    is_right = []
    for seed in range(930, 954):
        truth = few_cycles(seed, cycles, has_approach=seed % 2 == 0)
        rng = np.random.default_rng(seed)
        values = truth.values
        for place in range(places):
            at = round((place + rng.uniform(0.3, 0.7)) / places * len(values))
            values = with_pause(rng, values, at, rng.uniform(0.6, 4), height=height)
        try:
            found = find_rhythm(demonstration(values)).period
        except DemonstrationError:
            found = np.inf
        # The movement is slower beside a pause.
        is_right.append(-0.08 < found / truth.period - 1 < 0.12)
    assert np.mean(is_right) >= least


def eight():
    """Return 2.2 cycles of 5 s of an 8 (n, 3), 0.2 m wide."""
    phase = 2 * np.pi * np.linspace(0, 2.2, 221)
    path = [np.sin(phase), 0.6 * np.sin(2 * phase + 0.5), 0 * phase]
    return 0.1 * np.column_stack(path)


@pytest.mark.parametrize(("height", "kind"), [(0.0, "pause"), (0.1, "lift")])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_bouts_beside_a_pause_in_few_cycles(height, kind, noise):
    rng = np.random.default_rng(1)
    values = with_pause(rng, eight(), 130, 2.0, height=height)
    values += noise * rng.standard_normal(values.shape)
    found = find_rhythm(demonstration(values))
    duration = 2.0 + (1.4 if height else 0.0)
    (pause,) = found.left_out
    assert pause.kind == kind
    assert pause.start == pytest.approx(6.8, abs=0.3)
    assert pause.end == pytest.approx(6.8 + duration, abs=0.3)
    assert [bout.start for bout in found.bouts] == [0.0, pause.end]
    assert found.bouts[1].end == pytest.approx(len(values) / RATE)
    assert found.period == pytest.approx(5.0, rel=0.06)
    assert found.cycles == pytest.approx(2.2, abs=0.1)
    ends = [end for bout in found.bouts for end in bout.cycle_ends]
    # Stopping and starting take 0.3 s each.
    assert ends == pytest.approx([5.0, 10.6 + duration], abs=0.2)


def test_lift_with_two_pauses_is_one_part():
    path, steady = eight(), np.zeros((20, 1))
    top, other = path[130] + [0.0, 0.0, 0.12], path[130] + [0.03, 0.0, 0.12]
    up, down = eased(path[130], top, 14), eased(other, path[130], 14)
    way = eased(top, other, 12)
    pieces = [path[:130], up, top + steady, way, other + steady, down, path[130:]]
    found = find_rhythm(demonstration(np.concatenate(pieces)))
    assert [part.kind for part in found.left_out] == ["lift"]
    assert found.left_out[0].duration == pytest.approx(4.0, abs=0.4)
    assert found.period == pytest.approx(5.0, rel=0.06)


def test_pauses_at_the_same_place_of_two_recordings_are_left_out():
    rng = np.random.default_rng(1)
    recordings = [demonstration(with_pause(rng, eight(), at, 2.0)) for at in (130, 132)]
    found = find_rhythm(recordings)
    assert found.period == pytest.approx(5.0, rel=0.06)
    assert [part.recording for part in found.left_out] == [0, 1]


def test_a_recording_without_the_movement_of_the_others_is_no_approach():
    rng = np.random.default_rng(7)
    circle = named_curve(rng, "circle", 3)(varying_phase(rng, 500, 50, 0.05))
    line = np.linspace([0.5, 0.0, 0.3], [0.9, 0.4, 0.1], 120)
    recordings = [line + smooth_noise(rng, 120, 3, 5e-4), circle]
    found = find_rhythm(list(map(demonstration, recordings)))
    (part,) = found.left_out
    assert (part.recording, part.start, part.end) == (0, 0.0, 120 / RATE)
    assert "left out: no cycle, 0.0 to 6.0 s of recording 1" in found.describe()


def test_parts_beside_pauses_cover_the_recordings():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        recordings = []
        for number in range(2):
            values = few_cycles(10 * seed + number, rng.uniform(1.6, 3)).values
            for _ in range(2):
                at = round(rng.uniform(0.3, 0.7) * len(values))
                height = 0.1 * rng.integers(2)
                values = with_pause(rng, values, at, 1.5, height=height)
            recordings.append(values)
        try:
            found = find_rhythm(list(map(demonstration, recordings)))
        except DemonstrationError:
            continue
        for number, values in enumerate(recordings):
            parts = [
                p for p in (*found.bouts, *found.left_out) if p.recording == number
            ]
            parts.sort(key=lambda part: part.start)
            assert parts[0].start == 0.0
            assert parts[-1].end == pytest.approx(len(values) / RATE)
            for part, following in pairwise(parts):
                assert part.end == following.start
            kinds = [part.kind for part in parts]
            assert "approach" not in kinds[1:] or kinds[0] in {
                "approach",
                "pause",
                "lift",
            }


@pytest.mark.parametrize(("strokes", "cycles"), [(1, 2), (1, 3), (1, 5), (2, 2)])
def test_pause_of_each_cycle_is_a_part_of_it(strokes, cycles):
    phase = 2 * np.pi * np.linspace(0, 1, 60)[:-1]
    stroke = np.column_stack([np.sin(phase), 0.6 * np.sin(2 * phase + 0.5)])
    one = np.concatenate([*[stroke] * strokes, np.repeat(stroke[:1], 30, axis=0)])
    values = 0.1 * np.tile(one, (cycles, 1))
    values += 2e-4 * np.random.default_rng(0).standard_normal(values.shape)
    found = find_rhythm(demonstration(values))
    assert found.period == pytest.approx(len(one) / RATE, rel=0.05)


@pytest.mark.parametrize(
    ("name", "cycles"),
    [
        ("car_fender_3", (1.5, 2, 2.5, 3)),
        ("car_rim_1", (1.5, 2, 2.5)),
        ("car_rim_4", (3, 4)),
        ("drums_05", (1.5,)),
        ("panda_mixing", (1.5,)),
        ("panda_mixing_pan", (1.5, 2, 3, 4)),
        ("panda_wiping_big_board_2_loop", (1.5, 2)),
        ("panda_wiping_loop", (1.5,)),
    ],
)
def test_few_cycles_of_real_recordings_are_found(
    real_demonstration_paths, name, cycles
):
    with np.load(real_demonstration_paths[name]) as file:
        recording = Demonstration(time=file["time"], values=file["position"])
    whole = find_rhythm(recording)
    for count in cycles:
        end = whole.bouts[0].start + count * whole.period
        found = find_rhythm(recording, end_time=end)
        assert found.period == pytest.approx(whole.period, rel=0.08)


def test_irregular_cycles_are_refused_not_guessed(real_demonstration_paths):
    with np.load(real_demonstration_paths["car_rim_4"]) as file:
        recording = Demonstration(time=file["time"], values=file["position"])
    with pytest.raises(DemonstrationError, match="no part of it recurs"):
        find_rhythm(recording, end_time=6.9)


def test_the_best_alignment_joins_equal_parts():
    rng = np.random.default_rng(3)
    path = np.cumsum(gaussian_filter1d(rng.standard_normal((60, 2)), 5, axis=0), axis=0)
    away = eased(path[-1], path[-1] + 10, 40)
    back = eased(away[-1], path[0], 40)
    values = np.concatenate([away[:20] + 20, path, away, back, path, away[::-1]])
    (best,) = self_alignments(values, 8, 200, most=1)
    assert best.period == pytest.approx(140, abs=2)
    assert (best.start, best.end) == pytest.approx((20, 220), abs=8)
    assert aligned_period([values]) == best.period
    (mask,) = aligned_samples([values], 140)
    assert np.flatnonzero(mask)[[0, -1]] == pytest.approx((20, 219), abs=8)


def test_alignment_does_not_depend_on_size_place_or_direction():
    values = few_cycles(731, 1.6).values
    (best,) = self_alignments(values, 8, 200, most=1)
    (other,) = self_alignments(3 * values + 1, 8, 200, most=1)
    assert other == pytest.approx(best)
    (backwards,) = self_alignments(values[::-1], 8, 200, most=1)
    assert backwards.period == pytest.approx(best.period, rel=0.03)
    ends = len(values) - backwards.end, len(values) - backwards.start
    assert ends == pytest.approx((best.start, best.end), abs=5)


def test_samples_with_a_very_long_period_are_not_compared():
    still = np.zeros((100_000, 2))
    (mask,) = aligned_samples([still], 40_000.0)
    assert np.all(mask)


def test_a_recording_of_rest_has_no_rhythm_and_gives_no_warning():
    still = demonstration(np.tile([0.4, 0.1, 0.3], (400, 1)))
    with (
        np.errstate(all="raise"),
        pytest.raises(DemonstrationError, match="no part of it recurs"),
    ):
        find_rhythm(still)


def test_rest_is_not_similar_to_rest():
    assert aligned_period([np.zeros((200, 2))]) is None
    step = np.concatenate([np.zeros((90, 2)), eased(np.zeros(2), np.ones(2), 20)])
    assert aligned_period([np.concatenate([step, np.ones((90, 2))])]) is None


def test_two_of_six_cycles_are_not_mistaken_for_one(real_demonstration_paths):
    with np.load(real_demonstration_paths["car_rim_4"]) as file:
        recording = Demonstration(time=file["time"] / 2, values=file["position"])
    found = find_rhythm(recording)
    assert found.period == pytest.approx(0.84, rel=0.05)
    assert found.cycles == pytest.approx(5.9, abs=0.5)


@pytest.mark.parametrize("seed", range(8))
def test_one_of_four_strokes_is_not_mistaken_for_a_cycle(seed):
    rng = np.random.default_rng(seed)
    phase = varying_phase(rng, 400, 60, 0.05)
    strokes = 0.1 * np.column_stack([np.sin(4 * phase), 0.45 * np.cos(phase)])
    strokes += 1e-3 * rng.standard_normal(strokes.shape)
    found = find_rhythm(demonstration(strokes))
    assert found.period == pytest.approx(3.0, rel=0.05)


@pytest.mark.parametrize(
    ("start", "cycles"),
    [(23.5, 2.2), (65.9, 2.2), (33.8, 3.2), (65.5, 3.2), (4.0, 4.0)],
)
def test_one_stroke_is_not_mistaken_for_one_of_few_cycles(start, cycles):
    whole = Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")
    end = start + cycles * 4.78
    rhythm = find_rhythm(whole, start_time=start, end_time=end)
    assert rhythm.period == pytest.approx(4.78, rel=0.1)
    assert rhythm.fraction_left_out < 0.1
    # Also between an approach and a retreat.
    path = whole.values[(whole.time >= start) & (whole.time < end)]
    rate, away = 1 / np.mean(np.diff(whole.time)), np.array([0.3, -0.2, 0.2])
    approach = eased(path[0] + away, path[0], round(1.5 * rate))
    retreat = eased(path[-1], path[-1] + away, round(1.5 * rate))
    values = np.concatenate([approach, path, retreat])
    rhythm = find_rhythm(
        Demonstration(time=np.arange(len(values)) / rate, values=values)
    )
    assert rhythm.period == pytest.approx(4.78, rel=0.1)
    (bout,) = rhythm.bouts
    assert bout.duration == pytest.approx(end - start, abs=1.0)


@pytest.mark.parametrize(("unit", "width"), [("N", 0), ("m", 0), ("N", 10)])
def test_a_channel_without_rhythm_does_not_hide_that_of_the_others(unit, width):
    truth = synthetic_recording(6)
    noise = 5 * np.random.default_rng(2).standard_normal(len(truth.values))
    noise = gaussian_filter1d(noise, width) if width else noise
    values = np.column_stack([truth.values, noise])
    d = truth.values.shape[1]
    recording = Demonstration(
        time=np.arange(len(values)) / RATE,
        values=values,
        channels=(*"xyz"[:d], "noise"),
        units=("m",) * d + (unit,),
    )
    found = find_rhythm(recording)
    alone = find_rhythm(recording.select(list("xyz"[:d])))
    assert found.period == pytest.approx(truth.period, rel=0.05)
    assert found.bouts == alone.bouts
    assert found.irregular == ("noise",)
    assert "differ from cycle to cycle: noise;" in found.describe()[-1]
    skill = FourierMovementPrimitive().fit(recording)
    assert (skill.model_, skill.rhythm_) == ("phase", found)
    assert skill.phase_model_.cycle.coefficients.shape[1] == d + 1


@pytest.mark.parametrize("cycles", [1.5, 1.6, 1.7, 1.8, 1.9, 2.0])
def test_fewer_than_two_cycles_are_found_whatever_their_number(cycles):
    rng = np.random.default_rng(1)
    phase = 1.0 + phases(round(60 * cycles) + 1, 60)
    values = drop(phase) + 1e-3 * rng.standard_normal((len(phase), 2))
    found = find_rhythm(demonstration(values))
    assert found.period == pytest.approx(3.0, rel=0.05)
    assert found.cycles == pytest.approx(cycles, abs=0.1)


def test_windows_follow_the_period_where_none_are_given():
    quick = FourierMovementPrimitive(rate=RATE).fit(drop(phases(600, 22)))
    slow = FourierMovementPrimitive(rate=RATE).fit(drop(phases(600, 130)))
    assert (quick.n_steps, slow.n_steps) == (70, 156)
    given = FourierMovementPrimitive(rate=RATE, n_steps=100).fit(drop(phases(600, 22)))
    assert given.n_steps == 100


def test_recordings_shorter_than_a_window_are_learned():
    values = drop(phases(90, 60))
    skill = FourierMovementPrimitive(rate=RATE).fit(values)
    assert skill.model_ == "phase"
    path = eased(np.zeros(2), np.ones(2), 90)
    skill = FourierMovementPrimitive(rate=RATE).fit(path)
    assert (skill.model_, skill.n_steps) == ("mixture", 45)


def cycles_apart(count, turn=2 * np.pi):
    """Return recordings of one turn each, of unequal length and size, between rests."""
    rng = np.random.default_rng(4)
    out = []
    for _ in range(count):
        steps = int(rng.integers(46, 56))
        path = drop(0.5 + turn * np.arange(steps + 1) / steps, rng.normal(0.1, 0.003))
        out.append(demonstration(np.vstack([path[[0] * 12], path, path[[-1] * 15]])))
    return out


def test_recordings_of_one_cycle_each_are_learned_together():
    recordings = cycles_apart(5)
    found = find_rhythm(recordings)
    assert found.cycles == pytest.approx(5, abs=0.2)
    lengths = [recording.duration - 27 / RATE for recording in recordings]
    assert found.period == pytest.approx(np.mean(lengths), rel=0.02)
    assert [bout.recording for bout in found.bouts] == [0, 1, 2, 3, 4]
    for recording, bout in zip(recordings, found.bouts, strict=True):
        assert bout.start == pytest.approx(0.6, abs=0.15)
        assert bout.end == pytest.approx(recording.duration - 0.75, abs=0.15)
    assert {part.kind for part in found.left_out} == {"pause"}
    skill = FourierMovementPrimitive(model="phase").fit(recordings)
    assert skill.rhythm_ == found
    assert skill.predict(drop(0.5 + phases(25)), 25).values[:, 0] == pytest.approx(
        drop(0.5 + phases(50)[25:])[:, 0], abs=0.02
    )


@pytest.mark.parametrize(("turns", "end"), [(1.0, 2.55), (0.97, 2.5), (1.15, 2.55)])
def test_a_recording_that_ends_where_it_begins_is_one_cycle(turns, end):
    turn = 2 * np.pi * np.arange(round(50 * turns) + 1) / 50
    found = find_rhythm(demonstration(drop(turn)))
    assert found.cycles == 1
    assert found.period == pytest.approx(2.5, abs=0.15)
    (bout,) = found.bouts
    assert (bout.start, bout.end) == pytest.approx((0.0, end), abs=0.06)
    assert [part.kind for part in found.left_out] == ["retreat"] * (turns > 1)
    assert "one closed cycle" in found.remarks()[0]
    assert found.describe()[0].startswith("1 cycle of 2.")


@pytest.mark.parametrize("turns", [2.1, 2.5, 3.1])
@pytest.mark.parametrize("noise", [0.1, 0.15])
def test_noise_does_not_make_two_turns_one_cycle(turns, noise):
    turn = 2 * np.pi * np.arange(round(88 * turns)) / 88
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    circle += noise * np.random.default_rng(0).standard_normal(circle.shape)
    found = find_rhythm(demonstration(0.1 * circle))
    assert found.cycles == pytest.approx(turns, abs=0.1)
    assert found.period == pytest.approx(88 / RATE, rel=0.02)


@pytest.mark.parametrize("noise", [0.1, 0.15])
def test_noise_does_not_make_one_lap_of_two_circles_two_turns(noise):
    turn = 2 * np.pi * np.arange(120) / 120
    circles = np.column_stack([np.cos(2 * turn), np.sin(2 * turn)])
    circles += 0.4 * np.column_stack([np.cos(turn), np.sin(turn)])
    circles += noise * np.random.default_rng(0).standard_normal(circles.shape)
    assert find_rhythm(demonstration(0.1 * circles)).cycles == 1


def test_noise_of_a_path_without_repetition_has_no_rhythm():
    rng = np.random.default_rng(32)
    count = rng.integers(100, 400)
    corner, end = np.cumsum(rng.standard_normal((2, 2)) * [[0.4], [0.3]], axis=0)
    path = np.vstack([eased(np.zeros(2), corner, count), eased(corner, end, count)])
    path += 0.06 * rng.standard_normal(path.shape)
    with pytest.raises(DemonstrationError):
        find_rhythm(demonstration(path))


def test_pauses_at_the_ends_of_one_closed_cycle_are_left_out():
    (recording,) = cycles_apart(1)
    found = find_rhythm(recording)
    assert found.cycles == 1
    assert found.bouts[0].start == pytest.approx(0.6, abs=0.15)
    assert found.bouts[0].end == pytest.approx(recording.duration - 0.75, abs=0.15)
    assert len(found.left_out) == 2
    assert find_rhythm(recording, period=found.period).cycles == 1
    with pytest.raises(DemonstrationError, match="no part of it recurs"):
        find_rhythm(recording, period=0.6 * found.period)


def test_a_path_that_passes_its_beginning_and_goes_elsewhere_is_no_closed_cycle():
    turn = 2 * np.pi * np.arange(51) / 50
    path = drop(turn)
    away = path[-1] + np.arange(1, 12)[:, None] * [0.01, 0.02]
    with pytest.raises(DemonstrationError, match="no part of it recurs"):
        find_rhythm(demonstration(np.concatenate([path, away])))


def test_an_open_recording_is_no_closed_cycle():
    for turns in (0.6, 0.8, 1.4):
        turn = 2 * np.pi * np.linspace(0, turns, 60)
        spiral = drop(turn) * np.linspace(0.4, 1.0, 60)[:, None]
        with pytest.raises(DemonstrationError, match="no part of it recurs"):
            find_rhythm(demonstration(spiral))


def raster(strokes, seconds, laps=1):
    """Return laps (n, 2), m, of parallel strokes and the way back; tempo and place vary."""
    rng = np.random.default_rng(strokes)
    x = np.repeat(np.linspace(0.0, 0.3, strokes), 2)
    y = np.tile([0.0, 0.2, 0.2, 0.0], strokes)[: 2 * strokes]
    corners = np.column_stack([x, y])[np.r_[: 2 * strokes, 0]]
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
    paths = []
    for _ in range(laps):
        count = int(seconds * rng.uniform(0.93, 1.07) * RATE)
        places = length[-1] * np.arange(count) / count
        path = np.column_stack([np.interp(places, length, c) for c in corners.T])
        paths.append(path + rng.normal(0, 0.002, 2))
    return gaussian_filter1d(np.concatenate(paths), 3.0, axis=0)


@pytest.mark.parametrize("strokes", [5, 8])
@pytest.mark.parametrize("seconds", [15, 30, 50])
def test_slow_laps_are_found_and_played(strokes, seconds):
    path = raster(strokes, seconds, laps=2)
    found = find_rhythm(demonstration(path))
    assert found.cycles == pytest.approx(2, abs=0.1)
    assert found.period == pytest.approx(len(path) / RATE / 2, rel=0.08)
    skill = FourierMovementPrimitive().fit(demonstration(path))
    assert skill.window <= 12.0
    played = Player(skill).rollout(path[0], 2.0 * seconds).position
    gaps = np.linalg.norm(path[::5, None] - played, axis=2).min(axis=1)
    assert gaps.max() < 0.02


def spirals(laps):
    """Return laps (n, 2), m, of a spiral inwards and outwards, of unequal length."""
    rng = np.random.default_rng(3)
    paths = []
    for _ in range(laps):
        u = np.linspace(0, 1, int(240 * rng.uniform(0.93, 1.07)), endpoint=False)
        inwards = np.abs(2 * u - 1)
        radius, angle = 0.15 * (0.1 + 0.9 * inwards), 8 * np.pi * inwards
        path = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        paths.append(path * rng.uniform(0.97, 1.03) + rng.normal(0, 0.003, 2))
    return gaussian_filter1d(np.concatenate(paths), 2.0, axis=0)


def spirals_that_return(laps):
    """Return laps (n, 2), m, of a spiral inwards and a straight line back."""
    u = np.linspace(0, 1, 200)
    radius, angle = 0.15 * (1 - 0.85 * u), 8 * np.pi * u
    spiral = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    lap = np.concatenate([spiral, np.linspace(spiral[-1], spiral[0], 37)[1:-1]])
    return gaussian_filter1d(np.concatenate([lap] * laps), 2.0, axis=0)


def circles_there_and_back(laps):
    """Return laps (n, 2), m, of 16 small circles along a line and back."""
    rng = np.random.default_rng(2)
    paths = []
    for _ in range(laps):
        u = np.linspace(0, 1, int(240 * rng.uniform(0.93, 1.07)), endpoint=False)
        angle, place = 32 * np.pi * u, 0.3 * (1 - np.abs(2 * u - 1))
        path = np.column_stack([place + 0.05 * np.cos(angle), 0.05 * np.sin(angle)])
        paths.append(path + rng.normal(0, 0.003, 2))
    return gaussian_filter1d(np.concatenate(paths), 2.0, axis=0)


def arcs_there_and_back(laps):
    """Return laps (n, 2), m, of five arcs about one centre, each farther out, and back."""
    corners = []
    for i in range(5):
        angle = np.linspace(-0.7, 0.7, 15) * (-1) ** i
        radius = 0.1 + 0.05 * i
        corners.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    there = np.concatenate(corners)
    corners = np.concatenate([there, there[::-1]] * laps)
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
    places = np.linspace(0, length[-1], 250 * laps)
    path = np.column_stack([np.interp(places, length, c) for c in corners.T])
    return gaussian_filter1d(path, 2.0, axis=0)


@pytest.mark.parametrize("laps", [1, 2, 4])
@pytest.mark.parametrize(
    "movement",
    [spirals, spirals_that_return, circles_there_and_back, arcs_there_and_back],
)
def test_laps_of_many_strokes_are_the_cycles(movement, laps):
    path = movement(laps)
    found = find_rhythm(demonstration(path))
    assert found.cycles == pytest.approx(laps, abs=0.15)
    skill = FourierMovementPrimitive().fit(demonstration(path))
    played = Player(skill).rollout(path[0], 30.0).position
    gaps = np.linalg.norm(path[::5, None] - played, axis=2).min(axis=1)
    assert np.mean(gaps > 0.02) < 0.05


def test_a_winding_way_from_home_and_back_is_not_the_lap():
    circles = drop(np.linspace(0, 6 * np.pi, 121))
    u = np.linspace(0, 1, 120)[:, None]
    way = (1 - u) * [0.3, 0.2] + u * circles[0] + np.sin(np.pi * u) * [-0.1, 0.8]
    path = np.concatenate([way[:-1], circles, way[-2::-1]])
    found = find_rhythm(demonstration(path))
    assert found.cycles == pytest.approx(3, abs=0.15)
    assert [part.kind for part in found.left_out] == ["approach", "retreat"]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_many_cycles_after_a_longer_movement_are_not_strokes_of_a_lap(seed):
    rng = np.random.default_rng(seed)
    time = np.arange(540)[:, None] / RATE
    sizes, frequencies, starts = (
        rng.uniform(*limits, (6, 2)) for limits in ((0.01, 0.05), (0.5, 2.5), (0, 6.3))
    )
    # Six sines in each channel, which begin and end at rest.
    other = np.sin(2 * np.pi * frequencies * time[:, None] + starts)
    other = np.sum(sizes * other, axis=1)
    is_away = np.clip(10 * np.minimum(time, time[::-1]) / 5, 0, 1)
    circles = drop(phases(180, period=15))
    other = circles[0] + is_away * (other - other.mean(axis=0))
    found = find_rhythm(demonstration(np.concatenate([other, circles])))
    assert found.period == pytest.approx(0.75, rel=0.02)
    assert found.cycles == pytest.approx(12, abs=0.3)


def test_growing_circles_before_another_movement_are_not_a_spiral():
    circles = drop(np.linspace(0, 12 * np.pi, 241), 0.05)
    circles *= np.linspace(1, 3, 241)[:, None]
    phase = np.linspace(0, 6 * np.pi, 150)
    eights = [0.5, 0] + 0.08 * np.column_stack([np.sin(phase), np.sin(2 * phase) / 2])
    ways = (circles[-1], eights[0]), (eights[-1], circles[0])
    there, back = (np.linspace(*ends, 20)[1:-1] for ends in ways)
    found = find_rhythm(demonstration(np.concatenate([circles, there, eights, back])))
    assert found.cycles == pytest.approx(6, abs=0.3)
    assert "another movement" in [part.kind for part in found.left_out]


def test_a_noisy_approach_of_one_cycle_is_left_out():
    circle = 0.15 * drop(np.linspace(0, 2 * np.pi, 100), 1.0)
    circle = np.column_stack([circle, 0 * circle[:, 0]])
    way = np.linspace(circle[0] + [0, 0, 0.2], circle[0], 60)
    path = np.concatenate([way[:-1], circle, way[-2::-1]])
    path += 0.005 * np.random.default_rng(0).standard_normal(path.shape)
    found = find_rhythm(demonstration(path))
    assert [part.kind for part in found.left_out] == ["approach", "retreat"]
    assert found.period == pytest.approx(5.5, abs=1.0)


def strokes_there_and_back(cycles, period, strokes):
    """Return cycles (n, 2), m, of short strokes whose centre moves away and back."""
    time = np.arange(round(20 * cycles * period)) / 20
    phase = 2 * np.pi * time / period
    away = 0.1 * (1 - np.cos(2 * np.pi * time / time[-1]))
    return np.column_stack([0.12 * np.sin(strokes * phase) + away, 0.1 * np.sin(phase)])


def test_one_lap_keeps_its_short_strokes():
    path = strokes_there_and_back(10, 2.3, 4)
    skill = FourierMovementPrimitive().fit(demonstration(path))
    assert skill.rhythm_.is_one_cycle
    # The first window of 12 s leads from rest to 1 m/s.
    played = Player(skill).rollout(path[0], 52.0).position[240:]
    lengths = [np.abs(np.diff(y, axis=0)).sum() for y in (path, played)]
    assert lengths[1] / 40 == pytest.approx(lengths[0] / 23, rel=0.2)


def test_hundreds_of_cycles_whose_centre_returns_are_not_one_lap():
    found = find_rhythm(demonstration(strokes_there_and_back(200, 2.0, 1)))
    assert not found.is_one_cycle


def test_one_lap_of_strokes_beside_one_another_is_one_cycle():
    for strokes, seconds in ((8, 30), (8, 45), (11, 15)):
        path = raster(strokes, seconds)
        found = find_rhythm(demonstration(path))
        assert found.is_one_cycle
        assert found.period == pytest.approx(len(path) / RATE, rel=0.02)
    # It does not return, so its strokes are the cycles.
    there = path[: round(0.85 * len(path))]
    with pytest.raises(DemonstrationError, match="centre of its cycles wanders"):
        find_rhythm(demonstration(there))


@pytest.mark.parametrize("lift", [0.0, 0.05])
def test_one_lap_between_approach_and_retreat_is_one_cycle(lift):
    flat = raster(5, 12)
    heights = lift * np.clip(12 * np.sin(np.linspace(0, 6 * np.pi, len(flat))), 0, 1)
    lap = np.column_stack([flat, heights])
    home, end = lap[0] + [-0.1, 0.05, 0.2], lap[-1] + [-0.08, 0.1, 0.22]
    approach, retreat = eased(home, lap[0], 24), eased(lap[-1], end, 24)
    rests = np.repeat([home], 15, axis=0), np.repeat([end], 15, axis=0)
    path = np.concatenate([rests[0], approach, lap, retreat, rests[1]])
    path += gaussian_filter1d(
        np.random.default_rng(0).normal(0, 2e-3, path.shape), 2, axis=0
    )
    found = find_rhythm(demonstration(path))
    assert found.is_one_cycle
    (bout,) = found.bouts
    assert bout.start == pytest.approx(39 / RATE, abs=0.5)
    assert bout.end == pytest.approx((39 + len(lap)) / RATE, abs=0.5)
    assert [part.kind for part in found.left_out] == ["approach", "retreat"]


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_one_real_cycle_is_repeated_and_predicts_the_others(
    number, real_demonstration_paths
):
    paths = {}
    for i in range(1, 5):
        path = real_demonstration_paths[f"panda_wiping_loop_increase_z_{i}"]
        with np.load(path) as file:
            paths[i] = Demonstration(time=file["time"], values=file["position"])
    recording = paths.pop(number)
    skill = FourierMovementPrimitive().fit(recording)
    assert (skill.model_, skill.rhythm_.cycles) == ("phase", 1)
    played = Player(skill).rollout(recording.values[0], 40.0).position[100:]
    # Position 0 to 40 mm from the recording, which is 0.7 m long.
    gaps = np.linalg.norm(played[:, None] - recording.values, axis=2).min(axis=1)
    assert gaps.max() < 0.04
    assert gaps.mean() < 0.006
    steps = np.linalg.norm(np.diff(played, axis=0), axis=1) * skill.rate
    shown = np.linalg.norm(np.diff(recording.values, axis=0), axis=1)
    assert steps.max() < 1.1 * shown.max() / np.diff(recording.time).mean()
    is_inside = []
    for other in paths.values():
        values = other.resample(skill.rate).values
        for i in range(0, len(values) - 30, 10):
            prediction = skill.predict(values[i : i + 10], 20)
            error = values[i + 29] - prediction.values[-1]
            squared = error @ np.linalg.solve(prediction.covariances[-1], error)
            is_inside.append(squared < 7.81)
    assert np.mean(is_inside) > 0.9


def test_cycles_of_few_samples_are_joined_although_their_ends_are_steps_apart():
    # The first and the last sample are within a step of rest, so that they are cut off.
    turn = 2 * np.pi * 0.965 * np.arange(18) / 17
    found = find_rhythm([demonstration(drop(turn + 0.02 * i)) for i in range(3)])
    assert found.cycles == pytest.approx(2.9, abs=0.2)
    assert len(found.bouts) == 3


def test_open_strokes_of_few_samples_are_not_joined():
    for turn in (1.5 * np.pi, 1.2 * np.pi):
        arcs = [drop(turn * np.arange(8) / 7 + 0.02 * i) for i in range(4)]
        with pytest.raises(DemonstrationError, match="no part of it recurs"):
            find_rhythm([demonstration(arc) for arc in arcs])


def test_channels_that_are_still_or_repeat_are_not_called_different():
    truth = synthetic_recording(6)
    noise = 5 * np.random.default_rng(2).standard_normal(len(truth.values))
    still, repeated = 0 * noise + 3.0, truth.values[:, 0]
    values = np.column_stack([truth.values, noise, still, repeated])
    d = truth.values.shape[1]
    found = find_rhythm(
        Demonstration(
            time=np.arange(len(values)) / RATE,
            values=values,
            channels=(*"xyz"[:d], "noise", "still", "repeated"),
            units=("m",) * d + ("N",) * 3,
        )
    )
    assert found.irregular == ("noise",)


def test_recordings_that_end_elsewhere_are_not_joined():
    with pytest.raises(DemonstrationError, match="no part of it recurs"):
        find_rhythm(cycles_apart(5, turn=4.0))


def several_bouts():
    """Return recordings of unequal length, not all of which repeat by themselves."""
    counts, lengths = (170, 75, 120), (50, 53, 47)
    return [
        demonstration(drop(i + phases(n, p), 0.1 + 0.003 * i))
        for i, (n, p) in enumerate(zip(counts, lengths, strict=True))
    ]


@pytest.mark.parametrize("recordings", [several_bouts(), cycles_apart(3)])
def test_the_order_of_recordings_does_not_matter(recordings):
    def found(order):
        rhythm = find_rhythm([recordings[i] for i in order])
        parts = (*rhythm.bouts, *rhythm.left_out)
        found = sorted((order[p.recording], p.start, p.end, p.kind) for p in parts)
        return rhythm.period, rhythm.cycles, rhythm.drift, found

    expected = found((0, 1, 2))
    assert {part[0] for part in expected[-1]} == {0, 1, 2}
    for order in ((0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        assert found(order) == expected


def test_a_rhythm_is_found_beside_a_gap():
    time = np.concatenate([np.arange(0, 12, 0.05), np.arange(15, 30, 0.05)])
    circles = 0.1 * np.column_stack([np.cos(3 * time), np.sin(3 * time)])
    rhythm = find_rhythm(Demonstration(time=time, values=circles))
    assert rhythm.period == pytest.approx(2 * np.pi / 3, rel=0.01)
    assert rhythm.cycles == pytest.approx(27 * 3 / (2 * np.pi), rel=0.05)


def test_parts_beside_a_gap_are_located_in_their_recording():
    time = np.concatenate([np.arange(10, 30, 0.05), np.arange(35, 70, 0.05)])
    phase = 3 * np.where(time < 50, time, np.maximum(time - 5, 50))
    recording = Demonstration(
        time=time, values=0.1 * np.column_stack([np.cos(phase), np.sin(phase)])
    )
    for given, start, number in (
        (recording, None, 0),
        (recording, 5.0, 0),
        ([recording.rows(np.arange(300)), recording], None, 1),
    ):
        found = find_rhythm(given, start_time=start)
        learned = FourierMovementPrimitive().fit(given, start_time=start).rhythm_
        for rhythm in (found, learned):
            (pause,) = rhythm.left_out
            assert (pause.recording, pause.kind) == (number, "pause")
            assert pause.start == pytest.approx(40.0, abs=0.3)
            assert pause.end == pytest.approx(45.0, abs=0.3)
            assert rhythm.bouts[-1].recording == number
            assert rhythm.bouts[-1].end == pytest.approx(59.95, abs=0.1)


def test_a_recording_without_weight_counts_in_the_numbers_of_recordings():
    recordings = [demonstration(drop(np.arange(0, 60, 0.15))) for _ in range(2)]
    skill = FourierMovementPrimitive().fit(recordings, weights=[0, 1])
    assert [bout.recording for bout in skill.rhythm_.bouts] == [1]


def test_ends_of_cycles_follow_a_varying_tempo():
    phase = np.cumsum(2 * np.pi / 50 * np.linspace(0.75, 1.3, 1200))
    found = find_rhythm(demonstration(drop(phase)))
    (bout,) = found.bouts
    turns = phase[0] + 2 * np.pi * np.arange(1, int(found.cycles) + 1)
    expected = np.interp(turns, phase, np.arange(1200)) / RATE
    assert bout.cycle_ends == pytest.approx(expected, abs=0.15)
    later = found.located([], 3.0).bouts[0].cycle_ends
    assert later == pytest.approx(np.array(bout.cycle_ends) + 3.0)


def test_values_at_rest_stay_finite_beside_a_cycle():
    phase = np.linspace(0, 12, 60)
    cycle = np.column_stack([np.cos(phase), np.sin(phase)])
    with np.errstate(all="raise"):
        rest = segmentation._normalised(0 * cycle, cycle, np.ones(60, bool), 20)
    assert np.all(np.isfinite(rest))
