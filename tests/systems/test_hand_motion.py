"""Facts about the simulated hand's wandering paths."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from fmp_drake.errors import SystemsError
from fmp_drake.systems.surface.surface import PLANE, Surface
from fmp_drake.systems.teaching.hand_motion import (
    MAX_TURN_RATE,
    HandMotion,
    HandVariability,
)

RATE = 200
STEADY = HandVariability(frequency=0, amplitude=0, centre=0, tremor=0)
PERIODS = {"wiping": 4.8, "polishing": 2.0, "eight": 3.0}
# How often the path crosses its middle along x and y in one period.
TURNS = {"wiping": (1, 3), "polishing": (1, 1), "eight": (2, 1)}


@pytest.mark.parametrize("task", ["stirring", "pulsing"])
def test_channels_of_a_motion_with_poses_vary_about_their_means(task):
    motion = HandMotion.make(task, duration=60, seed=2)
    mean = dict(zip(motion.channels, motion.position.mean(axis=0), strict=True))
    spread = dict(zip(motion.channels, np.ptp(motion.position, axis=0), strict=True))
    if task == "pulsing":
        assert motion.channels == ("x", "y", "force")
        assert mean["force"] == pytest.approx(10.0, abs=0.5)
        assert 4.5 < spread["force"] < 8.5
    else:
        assert motion.channels == ("x", "y", "z", "rx", "ry", "rz")
        assert mean["z"] == pytest.approx(0.06, abs=0.005)
        assert 0.5 < spread["rx"] < 0.9
        # The tool's z leans away from the middle: the hand moves less than the tip.
        x, y, ry, rx = (
            motion.position[:, motion.channels.index(c)] for c in ("x", "y", "ry", "rx")
        )
        assert np.corrcoef(x, ry)[0, 1] < -0.9
        assert np.corrcoef(y, rx)[0, 1] > 0.9


@pytest.mark.parametrize("curved", [Surface(0.0, 4.0), Surface(-3.0, -3.0)])
def test_hand_is_slow_where_the_board_turns_the_tool(curved):
    motion = HandMotion.make("wiping", duration=20, seed=1)
    slowed = motion.slowed(curved)
    assert slowed.channels == motion.channels
    assert slowed.position.shape == motion.position.shape

    def turn_rate(motion):
        velocity = np.diff(motion.position, axis=0) * RATE
        return np.linalg.norm(velocity * np.array(curved), axis=1)

    assert np.max(turn_rate(motion)) > 1.5 * MAX_TURN_RATE
    assert np.max(turn_rate(slowed)) < 1.02 * MAX_TURN_RATE
    # Neither slower than it must be, nor beside its path.
    assert np.max(turn_rate(slowed)) > 0.95 * MAX_TURN_RATE
    for point in slowed.position[::400]:
        gaps = np.linalg.norm(motion.position - point, axis=1)
        assert np.min(gaps) < 0.002
    assert motion.slowed(PLANE) is motion


@pytest.mark.parametrize("task", PERIODS)
def test_path_repeats_with_the_seed(task):
    one, same, other = (HandMotion.make(task, duration=5, seed=s) for s in (1, 1, 2))
    assert np.array_equal(one.position, same.position)
    assert np.max(np.abs(one.position - other.position)) > 0.01


@pytest.mark.parametrize("task", PERIODS)
def test_longer_path_covers_its_whole_time(task):
    motion = HandMotion.make(task, duration=7.3, seed=0)
    assert motion.position.shape[1] == 2
    assert len(motion.position) / RATE >= 7.3
    before, _ = motion.at(7.29)
    end, _ = motion.at(7.3)
    assert not np.array_equal(before, end)


@pytest.mark.parametrize("task", PERIODS)
def test_steady_hand_repeats_after_a_period(task):
    motion = HandMotion.make(task, duration=15, seed=4, variability=STEADY)
    period = PERIODS[task]
    for time in np.linspace(0, 9, 25):
        assert_allclose(motion.at(time + period)[0], motion.at(time)[0], atol=2e-5)
    half = np.array([motion.at(t)[0] for t in np.linspace(0, period, 200)])
    for axis, count in enumerate(TURNS[task]):
        signs = np.sign(half[:-1, axis])
        assert np.sum(signs != np.roll(signs, 1)) == 2 * count


@pytest.mark.parametrize("task", PERIODS)
def test_wandering_hand_keeps_period_and_size_on_average(task):
    steady = HandMotion.make(task, duration=60, seed=0, variability=STEADY).position
    human = HandMotion.make(task, duration=240, seed=0).position
    assert_allclose(human.std(axis=0), steady.std(axis=0), rtol=0.1)
    assert np.all(np.abs(human) < 1.5 * np.abs(steady).max(axis=0))
    crossings = np.sum(np.diff(np.sign(human[:, 1])) > 0) / 240
    assert crossings == pytest.approx(TURNS[task][1] / PERIODS[task], rel=0.1)


def test_path_never_repeats():
    position = HandMotion.make("polishing", duration=60, seed=0).position
    period = 2 * RATE
    apart = np.linalg.norm(position[period:] - position[:-period], axis=1)
    assert np.max(apart) > 0.03


def test_tremor_has_its_size_and_band():
    only = HandVariability(frequency=0, amplitude=0, centre=0, tremor=0.001)
    shaking = HandMotion.make("eight", duration=60, seed=0, variability=only)
    still = HandMotion.make("eight", duration=60, seed=0, variability=STEADY)
    tremor = shaking.position - still.position
    assert_allclose(tremor.std(axis=0), 0.001, rtol=0.1)
    power = np.abs(np.fft.rfft(tremor[:, 0])) ** 2
    frequency = np.fft.rfftfreq(len(tremor), 1 / RATE)
    inside = (frequency > 7) & (frequency < 13)
    assert power[inside].sum() > 0.9 * power.sum()


@settings(deadline=None, max_examples=30)
@given(time=st.floats(0.01, 4.9))
def test_velocity_is_the_derivative_of_the_position(time):
    motion = HandMotion.make("eight", duration=5, seed=3)
    position, velocity = motion.at(time)
    i = int(time * RATE)
    slope = (motion.position[i + 1] - motion.position[i]) * RATE
    assert_allclose(velocity, slope, atol=1e-9)
    assert_allclose(
        position, motion.position[i] + (time - i / RATE) * slope, atol=1e-12
    )


def test_hand_rests_before_and_after_the_path():
    motion = HandMotion.make("eight", duration=2, seed=0)
    for time, position in ((-1, motion.position[0]), (99, motion.position[-1])):
        assert_allclose(motion.at(time)[0], position, atol=1e-15)
        assert_allclose(motion.at(time)[1], 0.0)
    assert np.all(motion.at(0)[1] != 0)


def test_seed_and_slowness_that_draw_no_path_are_refused():
    with pytest.raises(SystemsError, match="seed is -1"):
        HandMotion.make("eight", duration=2, seed=-1)
    human = HandVariability(slowness=0.0)
    with pytest.raises(SystemsError, match=r"slowness is 0"):
        HandMotion.make("eight", duration=2, seed=0, variability=human)


def test_hand_moves_at_the_speed_of_a_person():
    for task in PERIODS:
        position = HandMotion.make(task, duration=60, seed=5).position
        speed = np.linalg.norm(np.diff(position, axis=0), axis=1) * RATE
        assert 0.1 < speed.mean() < 0.8
        assert speed.max() < 1.5


def test_path_is_read_only():
    with pytest.raises(ValueError, match="read-only"):
        HandMotion.make("eight", duration=1, seed=0).position[0] = 1


def test_unknown_task_lists_the_tasks():
    with pytest.raises(SystemsError, match="'dance'; choose from wiping, polishing"):
        HandMotion.make("dance", duration=1, seed=0)


def test_duration_that_would_fill_the_memory_is_refused():
    with pytest.raises(
        SystemsError, match=r"duration is 1000000000.0 s; .* at most 36"
    ):
        HandMotion.make("eight", duration=1e9, seed=0)


@pytest.mark.parametrize("seconds", [0, -1, np.nan, np.inf])
def test_duration_that_is_not_positive_is_refused(seconds):
    with pytest.raises(SystemsError, match="must be positive"):
        HandMotion.make("eight", duration=seconds, seed=0)
