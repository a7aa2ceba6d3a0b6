"""Facts about playing at a tempo that changes."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.primitives import Player
from fmp_drake.primitives.playback.live_playback import (
    LivePlayback,
    LiveState,
    remapped,
)


def live_at(player, start, **options):
    """Return a playback that starts at rest."""
    state = player.start(start)
    still = replace(state, offset=np.zeros_like(state.offset))
    return LivePlayback(
        player,
        LiveState(
            playback=still,
            offset=state.offset,
            blend_time=player.blend_time,
            **options,
        ),
    )


@pytest.fixture
def player(small_skill):
    return Player(small_skill)


@pytest.fixture
def start(small_skill):
    return small_skill.extent_[1] + 0.02


def test_at_tempo_1_it_is_the_players_motion(player, start):
    live, state = live_at(player, start), player.start(start)
    for i in range(1, 70):
        state = player.tick(state)
        if state.step == 23:
            state = player.remap(state)
        assert_allclose(
            live.motion(i * 0.1 + 0.03), player.motion(state, 0.03), atol=1e-9
        )
        assert live.playback(i * 0.1 + 0.03)[0].remaps == state.remaps


@pytest.mark.parametrize(("tempo", "slope"), [(0.5, 0.0), (2.0, 0.0), (0.3, 0.7)])
def test_ticks_come_when_the_skills_time_has_passed(player, start, tempo, slope):
    live = live_at(player, start, tempo=tempo, slope=slope)
    for seconds in np.linspace(0.05, 3, 40):
        passed = tempo * seconds + slope * seconds**2 / 2
        state, since = live.playback(seconds)
        assert_allclose((state.step - 3 + 20 * state.remaps) * 0.1 + since, passed)
        assert_allclose(live.state.seconds_to(passed), seconds)


@pytest.mark.parametrize(("tempo", "slope"), [(0.5, 0.0), (2.0, 0.0), (1.0, -0.4)])
def test_velocity_and_acceleration_are_derivatives(player, start, tempo, slope):
    live = live_at(player, start, tempo=tempo, slope=slope)
    h, times = 1e-4, np.arange(0.0523, 2.2, 0.0731)
    for t in times:
        before, here, after = (live.motion(t + k * h) for k in (-1, 0, 1))
        assert_allclose(here[1], (after[0] - before[0]) / (2 * h), atol=2e-4)
        assert_allclose(here[2], (after[1] - before[1]) / (2 * h), atol=2e-2)


def test_offset_decays_in_real_time_where_the_tempo_is_0(player, start):
    live = live_at(player, start, tempo=0.0)
    away = [live.motion(t)[0] - live.motion(60.0)[0] for t in (0.0, 0.4, 0.8)]
    # Critically damped from rest, with a time constant of 0.4 s.
    share = [(1 + t / 0.4) * np.exp(-t / 0.4) for t in (0.0, 0.4, 0.8)]
    moving = np.linalg.norm(live.motion(60.0)[1])
    assert moving < 1e-9
    speed = live.state.offset[1]
    for t, ratio, got in zip((0.0, 0.4, 0.8), share, away, strict=True):
        expected = ratio * live.state.offset[0] + speed * t * np.exp(-t / 0.4)
        assert_allclose(got, expected, atol=1e-9)


def test_state_after_some_time_goes_on_with_the_same_motion(player, start):
    whole = live_at(player, start, tempo=0.7, slope=0.2)
    live, begin = whole, 0.0
    for seconds in (0.1, 0.03, 0.5, 1.2, 0.9):
        for t in np.linspace(0, seconds, 7):
            assert_allclose(live.motion(t), whole.motion(begin + t), atol=1e-8)
        live, begin = LivePlayback(player, live.after(seconds)), begin + seconds


@pytest.mark.parametrize("tempo", [0.0, 0.4, 1.0, 2.5])
def test_remapping_to_what_was_observed_makes_no_jump(player, start, tempo):
    live = live_at(player, start, tempo=tempo).after(0.83)
    before = LivePlayback(player, live).motion(0.0)
    observed = start + np.outer(np.linspace(0.03, 0.05, 4), [1.0, -0.5])
    playback, offset = remapped(
        player,
        live.playback,
        live.offset,
        tempo=tempo,
        seconds=live.rest,
        observed=observed,
    )
    after = replace(live, playback=playback, offset=offset, rest=0.0)
    motion = LivePlayback(player, after).motion(0.0)
    assert_allclose(motion[:2], before[:2], atol=1e-9)
    assert playback.remaps == live.playback.remaps + 1
    assert playback.step == 3


@pytest.mark.parametrize(("tempo", "slope"), [(1.0, 0.0), (0.5, 0.0), (1.0, -0.4)])
def test_jerk_is_the_mean_change_of_the_acceleration(player, start, tempo, slope):
    live = live_at(player, start, tempo=tempo, slope=slope)
    for seconds in (0.0, 0.013, 0.71, 0.74):
        motion = live.motion_and_jerk(seconds, 0.02)
        assert_allclose(motion[:3], live.motion(seconds))
        ahead = live.motion(seconds + 0.02)[2]
        assert_allclose(0.02 * motion[3], ahead - motion[2], atol=1e-10)


@pytest.mark.parametrize("tempo", [1.0, 4.0, 0.0])
def test_jerk_stays_a_jerk_where_the_window_leaves_the_tick(player, start, tempo):
    live = live_at(player, start, tempo=tempo)
    greatest = 0.0
    for seconds in np.arange(0.0, 4.0, 0.01):
        here, later = live.motion(seconds)[2], live.motion(seconds + 1e-4)[2]
        jerk = live.motion_and_jerk(seconds, 0.05)[3]
        greatest = max(greatest, np.abs(jerk).max())
        # The motion's own changes within a tick are of this size.
        assert (
            np.abs(jerk).max()
            < 50 * max(tempo, 0.1) ** 3 + np.abs((later - here) / 1e-4).max()
        )
    assert greatest > 0


@pytest.mark.parametrize(("tempo", "slope"), [(1.0, 0.0), (0.5, 0.0), (0.3, 0.7)])
def test_ticks_made_at_once_are_the_same(player, start, tempo, slope):
    one = live_at(player, start, tempo=tempo, slope=slope)
    many = LivePlayback(player, one.state, ticks_at_once=5)
    for seconds in np.linspace(0.0, 4.5, 100):
        assert np.array_equal(one.motion(seconds), many.motion(seconds))
        assert one.playback(seconds)[0].step == many.playback(seconds)[0].step
