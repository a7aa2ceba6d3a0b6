"""Facts about what becomes of a recorded hand before it is learned from."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from fmp_drake.primitives.data.recording import hand_time, led_demonstrations

TIME = np.arange(0.0, 20.0, 0.05)


def eight(time):
    w = 2 * np.pi * np.asarray(time) / 5
    return np.column_stack([0.06 * np.sin(2 * w), 0.12 * np.sin(w), 0 * w])


def test_a_simulation_in_pace_keeps_its_own_time_whatever_the_clock_jitters():
    jitter = np.random.default_rng(0).uniform(0, 0.018, len(TIME))
    jitter[0] = 0
    assert_allclose(np.diff(hand_time(TIME, 100 + TIME + jitter)), 0.05)


@pytest.mark.parametrize("rate", [0.5, 0.8])
def test_a_slow_simulation_records_the_rhythm_of_the_hand(rate):
    clock = TIME / rate
    [shown] = led_demonstrations(
        hand_time(TIME, clock), eight(clock), np.ones(len(TIME))
    )
    assert shown.duration == pytest.approx(clock[-1], abs=0.2)
    assert np.abs(shown.values - eight(shown.time)).max() < 0.012


def test_what_was_missed_is_left_out():
    clock = TIME + np.where(TIME > 8.0, 1.5, 0.0)
    one, two = led_demonstrations(
        hand_time(TIME, clock), eight(clock), np.ones(len(TIME))
    )
    assert one.duration == pytest.approx(8.0, abs=0.11)
    assert two.duration == pytest.approx(11.95, abs=0.11)


def test_each_time_that_the_hand_led_is_a_demonstration_of_its_own():
    leads = (TIME < 7) | (TIME > 8)
    found = led_demonstrations(TIME, eight(TIME), leads)
    assert [round(d.duration) for d in found] == [7, 12]
    assert {(d.frame, d.channels) for d in found} == {("board", ("x", "y", "z"))}


def test_still_beginnings_and_ends_are_cut_off_and_rests_between_are_not():
    moving = np.interp(TIME, [2, 6, 9, 16, 20], [0, 4, 4, 11, 11])
    [shown] = led_demonstrations(TIME, eight(moving), np.ones(len(TIME)))
    assert shown.duration == pytest.approx(14.0, abs=0.3)
    assert_allclose(shown.values[0], 0, atol=0.01)


def test_who_never_moved_has_shown_nothing():
    path = np.zeros((len(TIME), 3))
    assert led_demonstrations(TIME, path, np.ones(len(TIME))) == []
    assert led_demonstrations(TIME, eight(TIME), np.zeros(len(TIME))) == []
    assert led_demonstrations([], np.zeros((0, 3)), []) == []


def test_a_path_that_is_sampled_uniformly_is_recorded_as_it_is():
    [shown] = led_demonstrations(TIME, eight(TIME), np.ones(len(TIME)))
    assert_array_equal(shown.values, eight(TIME)[-len(shown.time) :])


@pytest.mark.parametrize("frame", [0.1, 0.25])
def test_steps_of_a_slow_pages_pictures_are_smoothed_and_no_more(frame):
    stepped = eight(np.floor(TIME / frame + 1e-9) * frame)
    ones = np.ones(len(TIME))
    [raw] = led_demonstrations(TIME, stepped, ones)
    [smooth] = led_demonstrations(TIME, stepped, ones, frame_seconds=frame)
    late = eight(smooth.time + (TIME[-1] - smooth.time[-1]) - frame / 2)
    inner = slice(10, -10)
    errors = [np.abs(d.values - late)[inner].max() for d in (raw, smooth)]
    assert errors[1] < 0.6 * errors[0]
    [same] = led_demonstrations(TIME, stepped, ones, frame_seconds=1 / 60)
    assert_array_equal(same.values, raw.values)
