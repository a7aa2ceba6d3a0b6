"""Facts about the skills that the commands read."""

import os
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    find_rhythm,
    modulate_skill,
    save_skill,
)
from fmp_drake.skills import (
    description,
    learn_skill,
    load_on_board,
    scenario_skill,
)
from fmp_drake.skills.description import (
    describe_recording,
    skill_in_words,
    source_in_words,
)
from fmp_drake.skills.learning import shared_skill
from fmp_drake.skills.placement import place_on_board
from fmp_drake.station.scenario import Scenario


def test_skill_without_paths_is_reported_as_unbounded(tmp_path, wiping_skill):
    file = tmp_path / "skill.npz"
    without_paths = modulate_skill(wiping_skill, harmonics=[1], gain=1.0)
    for skill, remarked in ((wiping_skill, False), (without_paths, True)):
        save_skill(skill, file)
        loaded, _, remarks = scenario_skill(Scenario(), skill_file=file)
        assert bool(loaded.paths_) != remarked
        said = "has no demonstrated paths, as after modulate_skill" in remarks[-1]
        assert said == remarked


TIME = np.arange(0, 12, 0.05)


def circles(phase, centre=0.0):
    x, y = centre + 0.08 * np.cos(phase), 0.12 * np.sin(phase)
    return np.column_stack([x, y, 0 * phase])


def test_paths_of_recordings_and_skills_may_be_strings(tmp_path, wiping_skill):
    file, skill_file = str(tmp_path / "circles.npz"), str(tmp_path / "skill.npz")
    Demonstration(time=TIME, values=circles(3 * TIME)).save(file)
    save_skill(wiping_skill, skill_file)
    for paths in (file, [file]):
        (placed,), _ = load_on_board(paths, scenario=Scenario())
        assert placed.channels == ("x", "y", "z")
    _, (learned,), _ = scenario_skill(Scenario(), demonstrations=file)
    assert_allclose(learned.values, placed.values)
    loaded, _, _ = scenario_skill(Scenario(), skill_file=skill_file)
    assert loaded.period_ == wiping_skill.period_


def test_a_shared_skill_is_learned_once_for_each_robot(tmp_path):
    angles = np.tile([0, -0.7, 0, -1.8, 0, 1.6, 0.8], (len(TIME), 1))
    angles[:, [0, 5]] += 0.1 * np.column_stack([np.cos(3 * TIME), np.sin(3 * TIME)])
    joints = tuple(f"q{i}" for i in range(1, 8))
    recording = Demonstration(
        time=TIME, values=angles, channels=joints, units=["rad"] * 7
    )
    recording.save(tmp_path / "joints.npz")
    learned_values = []
    for robot in ("panda", "iiwa14", "panda"):
        scenario = Scenario(robot=robot)
        scenario.skill.demonstration = str(tmp_path / "joints.npz")
        learned_values.append(shared_skill(scenario))
    assert learned_values[0][0] is learned_values[2][0]
    assert (
        np.ptp(learned_values[0][1][0].values - learned_values[1][1][0].values) > 1e-3
    )


def test_a_changed_file_is_learned_and_loaded_again(tmp_path):
    scenario, extents = Scenario(), []
    recording, file = tmp_path / "circle.npz", tmp_path / "skill.npz"
    for size in (0.05, 0.1):
        path = size * np.column_stack([np.cos(5 * TIME), np.sin(5 * TIME), 0 * TIME])
        shown = Demonstration(time=TIME, values=path, frame="board")
        shown.save(recording)
        save_skill(FourierMovementPrimitive().fit(shown), file)
        os.utime(recording, ns=(0, round(1e9 * size)))
        os.utime(file, ns=(0, round(1e9 * size)))
        scenario.skill.demonstration, scenario.skill.file = str(recording), ""
        skill, demonstrations = shared_skill(scenario)
        extents.append(skill.extent_[1, 0])
        # A caller's list is not the one that others get.
        demonstrations.clear()
        assert len(shared_skill(scenario)[1]) == 1
        scenario.skill.file = str(file)
        extents.append(shared_skill(scenario)[0].extent_[1, 0])
    assert_allclose(extents, [0.05, 0.05, 0.1, 0.1], atol=2e-3)


def test_a_demonstration_on_the_board_is_learned_once_for_all_boards_and_robots():
    scenario, other = Scenario(), Scenario(robot="iiwa14")
    for each in (scenario, other):
        each.skill.demonstration = "polishing"
    other.board.size = [0.5, 0.4]
    assert shared_skill(scenario)[0] is shared_skill(other)[0]
    other.skill.window = 5.0
    assert shared_skill(scenario)[0] is not shared_skill(other)[0]


def test_channels_that_the_board_does_not_need_are_left_out_and_named():
    demonstration = Demonstration(
        time=TIME,
        values=np.column_stack([TIME, circles(3 * TIME)]),
        channels=["force_z", "x", "y", "z"],
        frame="board",
    )
    placed_recording, remarks = place_on_board(demonstration, scenario=Scenario())
    assert placed_recording.channels == ("x", "y", "z")
    np.testing.assert_array_equal(placed_recording.values, demonstration.values[:, 1:])
    assert remarks == ["force_z left out: the board needs x, y and z"]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            np.insert(circles(3 * TIME), [120] * 40, circles(18.0), axis=0),
            r"left out: pause, 6\.0 to 8\.[01] s$",
        ),
        (
            np.vstack(
                [np.linspace([0.5, 0.3, 0], [0.08, 0, 0], 50), circles(3 * TIME)]
            ),
            r"left out: approach, 0\.0 to 2\.[56] s$",
        ),
        (
            circles(3 * TIME, centre=TIME / 120),
            r"the centre drifts by 29 % of the width:",
        ),
        (circles(3 * TIME + 1.2 * np.sin(TIME)), "the tempo varies so much"),
    ],
    ids=["pause", "way", "drift", "tempo"],
)
def test_unusual_cycles_are_reported(values, said):
    recording_part = Demonstration(time=0.05 * np.arange(len(values)), values=values)
    skill = FourierMovementPrimitive(model="phase", n_steps=60, stride=3).fit(
        recording_part
    )
    (odd,) = skill_in_words(skill)[2:-1]
    assert re.match(said, odd)


def test_a_bout_shorter_than_a_window_is_reported_by_its_cycles():
    short = circles(2 * np.pi * np.arange(38) / 24)
    skill = FourierMovementPrimitive(model="phase", rate=20.0).fit(short)
    assert skill.n_windows_ == 0
    assert source_in_words(skill).endswith(" components from 1.5 cycles of 1.20 s")
    assert "; windows of 2 s at 20 Hz" in repr(skill)
    mixture = FourierMovementPrimitive(model="mixture", window=1.0, rate=20.0)
    assert source_in_words(mixture.fit(short)).endswith(
        " components from 19 windows of 1 s"
    )


def test_windows_that_are_announced_are_those_that_are_learned():
    t = np.arange(0, 5, 0.05)
    once = 0.05 * np.column_stack([np.sin(t**1.7), np.cos(1.3 * t**1.2), 0 * t])
    recording = Demonstration(time=t, values=once)
    announced = describe_recording(recording)[-1]
    assert FourierMovementPrimitive().fit(recording).n_windows_ == 51
    assert "possible, from 51 windows of 2.5 s" in announced


def test_a_short_recording_that_does_not_repeat_may_be_a_discrete_movement():
    t = np.arange(0, 5, 0.05)
    along = np.clip(t / 4, 0, 1) ** 2 * (3 - 2 * np.clip(t / 4, 0, 1))
    recording = Demonstration(time=t, values=np.outer(along, [0.3, 0.1, 0.2]))
    hint = "from a start to a goal is learned in Python, .*: DiscreteMovementPrimitive"
    assert re.search(hint, describe_recording(recording)[-1])
    skill = FourierMovementPrimitive().fit(recording)
    assert re.search(hint, " ".join(skill_in_words(skill)))


def test_part_without_samples_is_not_announced_as_possible():
    t = np.arange(0, 12, 0.05)
    recording = Demonstration(time=t, values=circles(2 * np.pi * t / 2))
    for part in ({"start_time": 50.0}, {"start_time": 8.0, "end_time": 4.0}):
        announced = describe_recording(recording, **part)[-1]
        assert announced.startswith("learning: not possible: demonstration 1 lasts")


@pytest.mark.parametrize("others", [0, 3])
def test_a_recording_of_many_channels_without_cycles_is_advised_to_name_some(others):
    time = np.arange(0, 20, 0.02)
    rng = np.random.default_rng(0)
    noise = np.cumsum(rng.normal(size=(len(time), 3 + others)), axis=0)
    names = tuple(f"{kind}_{axis}" for kind in ("acc", "gyr") for axis in "xyz")
    recording = Demonstration(
        time=time,
        values=noise,
        channels=names[: 3 + others],
        units=("1",) * (3 + others),
    )
    cycles = describe_recording(recording)[2]
    assert cycles.startswith("cycles: none found")
    assert ("If only some channels repeat, name them (--columns)." in cycles) == (
        others > 0
    )


def test_tremor_of_the_force_is_not_learned_and_the_path_is_learned_as_it_was_shown():
    time = np.arange(0, 60, 0.05)
    path = circles(3 * time)
    # As of a hand, at 9 Hz in force and path alike.
    tremor = np.sin(2 * np.pi * 9 * time)
    path[:, 0] += 0.001 * tremor
    intended_force = 10 + 3 * np.sin(3 * time)
    recording = Demonstration(
        time=time,
        values=np.column_stack([path, intended_force + tremor]),
        channels=["x", "y", "z", "force"],
        units=["m", "m", "m", "N"],
    )
    learned_values = np.concatenate(learn_skill([recording]).paths_)
    inner = slice(20, -20)
    np.testing.assert_allclose(learned_values[:, :3], path, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        learned_values[inner, 3], intended_force[inner], atol=0.1
    )


def test_a_force_is_learned_from_short_parts_between_gaps_too():
    time = np.concatenate([np.arange(0, 40, 0.05), 45 + 0.05 * np.arange(8)])
    values = np.column_stack([circles(3 * time), 10 + 3 * np.sin(3 * time)])
    recording = Demonstration(
        time=time,
        values=values,
        channels=["x", "y", "z", "force"],
        units=["m", "m", "m", "N"],
    )
    assert learn_skill([recording]).n_channels_ == 4


def test_a_recording_shorter_than_the_window_is_learned_in_a_shorter_one():
    recording = Demonstration(time=TIME[:100], values=circles(3 * TIME[:100]))
    skill = learn_skill([recording], window=6.0)
    assert skill.window == pytest.approx(5.0)
    assert "the window is 5 s instead of 6 s" in skill.model_reason_


def test_an_extent_of_zero_has_no_sign():
    time = np.arange(0, 20, 0.05)
    circles = 0.1 * np.column_stack([np.cos(2 * time), np.sin(2 * time), 0 * time])
    circles[:, 2] = -1e-3 * (1 + np.cos(2 * time))
    skill = FourierMovementPrimitive(rate=20).fit(circles)
    played = skill_in_words(skill)[-1]
    assert "to 0.10 m, z -0.0020 to 0.0000 m" in played


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (-0.1, 0.1, "-0.10 to 0.10"),
        (-0.003, 0.003, "-0.0030 to 0.0030"),
        (999.999, 1000.001, "999.9990 to 1000.0010"),
        (3.0, 27.0, "3.00 to 27.00"),
        (-1e-16, 1e-16, "0.00 to 0.00"),
        (0.25, 0.25, "0.25 to 0.25"),
    ],
)
def test_ranges_are_told_with_two_digits_of_their_difference(low, high, words):
    assert description._range_in_words(low, high) == words


def test_windows_that_are_announced_do_not_cross_a_gap():
    t = np.r_[0:5:0.05, 7:9:0.05]
    once = 0.05 * np.column_stack([np.sin(t**1.7), np.cos(1.3 * t**1.2), 0 * t])
    recording = Demonstration(time=t, values=once)
    skill = FourierMovementPrimitive().fit(recording)
    announced = f"{skill.n_windows_} windows of {skill.window:g} s"
    assert announced in describe_recording(recording)[-1]


def test_the_described_cycles_are_those_of_the_path_that_is_learned():
    time = np.arange(0, 30, 0.05)
    path = 0.1 * np.column_stack([np.cos(3 * time), np.sin(3 * time), 0 * time])
    drifting = 3 * np.cumsum(np.random.default_rng(1).standard_normal(len(time)))
    recording = Demonstration(
        time=time,
        values=np.column_stack([path, drifting]),
        channels=("x", "y", "z", "temperature"),
        units=("m", "m", "m", "1"),
    )
    alone = describe_recording(recording.select(["x", "y", "z"]))
    assert describe_recording(recording)[2] == alone[2]


def test_the_described_cycles_are_those_of_the_path_on_the_board():
    time = np.arange(0, 6.8, 0.05)
    phase = 2 * np.pi * time / 4
    waves = 0.06 * np.cos(phase / 1.7) * np.sin(phase / 2)
    path = np.column_stack([0.1 * np.cos(phase), 0.15 * np.sin(phase), waves])
    recording = Demonstration(
        time=time, values=path, channels=("x", "y", "z"), units=("m",) * 3
    )
    placed, _ = place_on_board(recording, scenario=Scenario())
    learned = "; ".join(learn_skill([placed]).rhythm_.describe())
    assert learned != "; ".join(find_rhythm(recording).describe())
    assert describe_recording(recording)[2] == f"cycles: {learned}"


def test_a_playback_outside_the_demonstrated_range_is_reported():
    # Windows of two thirds of the only cycle.
    phase = 2 * np.pi * np.arange(24) / 23.5
    path = np.column_stack([0.027 * np.cos(phase), 0.049 * np.sin(phase)])
    skill = FourierMovementPrimitive(rate=20, window=0.8, model="mixture").fit(path)
    low, high = skill.extent_
    played = Player(skill).rollout(path[-1], 16.0).position[160:]
    outside = np.max(np.maximum(low - played, played - high), axis=0)
    assert outside.max() > 0.3 * np.max(high - low)
    assert "the playback leaves the demonstrated range (" in skill_in_words(skill)[-1]
    closed = FourierMovementPrimitive(rate=20).fit(np.tile(path[:-1], (6, 1)))
    assert not any("leaves" in words for words in skill_in_words(closed))


@pytest.mark.parametrize("value", [0.0, 0.1234567, 1.0, 10.0, 1e6])
def test_a_constant_channel_changes_nothing(value):
    time = np.arange(0, 20, 1 / 30)
    path = 0.1 * np.column_stack([np.cos(2.1 * time), np.sin(2.1 * time)])
    recording = Demonstration(
        time=time,
        values=np.column_stack([path, np.full(len(time), value)]),
        channels=("x", "y", "gripper"),
        units=("m", "m", "1"),
    )
    for model in ("phase", "mixture"):
        skill = FourierMovementPrimitive(model=model).fit(recording)
        played = Player(skill).rollout(recording.values[-1], 8.0).position
        assert_allclose(np.abs(played[80:, :2]).max(axis=0), 0.1, rtol=0.1)
        assert_allclose(played[:, 2], value, atol=1e-6 + 1e-6 * value)
        assert not any("leaves" in words for words in skill_in_words(skill))


def test_one_cycle_has_no_spread():
    time = np.arange(0, 4.4, 0.05)
    circles = 0.1 * np.column_stack([np.cos(2 * time), np.sin(2 * time)])
    skill = FourierMovementPrimitive(rate=20, model="phase").fit(circles)
    (cycles,) = [line for line in skill_in_words(skill) if "whole cycle" in line]
    assert re.fullmatch(r"1 whole cycle of 3\.1\d s; 12 or more would help", cycles)
