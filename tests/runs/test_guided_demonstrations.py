"""Facts about demonstrations from the recorded path of a hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from fmp_drake.runs.guided_demonstrations import (
    guided_demonstrations,
    hand_time,
)

TIME = np.arange(0.0, 20.0, 0.05)


def eight(time):
    w = 2 * np.pi * np.asarray(time) / 5
    return np.column_stack([0.06 * np.sin(2 * w), 0.12 * np.sin(w), 0 * w])


def test_hand_time_ignores_clock_jitter_while_the_simulation_keeps_pace():
    jitter = np.random.default_rng(0).uniform(0, 0.018, len(TIME))
    jitter[0] = 0
    assert_allclose(np.diff(hand_time(TIME, 100 + TIME + jitter)), 0.05)


@pytest.mark.parametrize("rate", [0.5, 0.8])
def test_slow_simulation_records_the_rhythm_of_the_hand(rate):
    clock = TIME / rate
    [result] = guided_demonstrations(
        hand_time(TIME, clock), eight(clock), np.ones(len(TIME))
    )
    assert result.duration == pytest.approx(clock[-1], abs=0.2)
    assert np.abs(result.values - eight(result.time)).max() < 0.012


def test_gap_in_the_samples_splits_the_demonstration():
    clock = TIME + np.where(TIME > 8.0, 1.5, 0.0)
    one, two = guided_demonstrations(
        hand_time(TIME, clock), eight(clock), np.ones(len(TIME))
    )
    assert one.duration == pytest.approx(8.0, abs=0.11)
    assert two.duration == pytest.approx(11.95, abs=0.11)


def test_each_guided_interval_is_one_demonstration():
    is_guided = (TIME < 7) | (TIME > 8)
    demonstrations = guided_demonstrations(TIME, eight(TIME), is_guided)
    assert [round(d.duration) for d in demonstrations] == [7, 12]
    assert {(d.frame, d.channels) for d in demonstrations} == {
        ("board", ("x", "y", "z"))
    }


def test_rest_is_cut_off_at_both_ends_and_kept_in_between():
    moving = np.interp(TIME, [2, 6, 9, 16, 20], [0, 4, 4, 11, 11])
    [result] = guided_demonstrations(TIME, eight(moving), np.ones(len(TIME)))
    assert result.duration == pytest.approx(14.0, abs=0.3)
    assert_allclose(result.values[0], 0, atol=0.01)


def test_no_motion_gives_no_demonstration():
    path = np.zeros((len(TIME), 3))
    assert guided_demonstrations(TIME, path, np.ones(len(TIME))) == []
    assert guided_demonstrations(TIME, eight(TIME), np.zeros(len(TIME))) == []
    assert guided_demonstrations([], np.zeros((0, 3)), []) == []


def test_uniformly_sampled_path_is_unchanged():
    [result] = guided_demonstrations(TIME, eight(TIME), np.ones(len(TIME)))
    assert_array_equal(result.values, eight(TIME)[-len(result.time) :])


@pytest.mark.parametrize("frame", [0.1, 0.25])
def test_only_steps_longer_than_a_sample_are_smoothed(frame):
    stepped = eight(np.floor(TIME / frame + 1e-9) * frame)
    ones = np.ones(len(TIME))
    [raw] = guided_demonstrations(TIME, stepped, ones)
    [smooth] = guided_demonstrations(TIME, stepped, ones, frame_seconds=frame)
    late = eight(smooth.time + (TIME[-1] - smooth.time[-1]) - frame / 2)
    inner = slice(10, -10)
    errors = [np.abs(d.values - late)[inner].max() for d in (raw, smooth)]
    assert errors[1] < 0.6 * errors[0]
    [same] = guided_demonstrations(TIME, stepped, ones, frame_seconds=1 / 60)
    assert_array_equal(same.values, raw.values)
