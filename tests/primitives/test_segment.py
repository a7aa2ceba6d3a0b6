"""Facts about the motion between two ticks."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from tracking_rules import TRACKERS

from fmp_drake.errors import SkillError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, Player
from fmp_drake.primitives.playback.polynomial_segment import HORIZON, PolynomialSegment
from fmp_drake.primitives.playback.segment import Segment, critically_damped

SECONDS = np.concatenate(
    [[0.0, 1e-6], np.random.default_rng(0).uniform(0, 0.1, 40), [0.0999]]
)


@pytest.fixture(scope="module", params=["metres", "units"])
def skill(request, small_skill):
    """Skills of one unit, and of several with scales."""
    if request.param == "metres":
        return small_skill
    time = np.arange(400) / 10
    values = np.column_stack(
        [0.1 * np.sin(3 * time), 15 + 6 * np.cos(3 * time + 0.05 * np.sin(time))]
    )
    both = Demonstration(time=time, values=values, units=("m", "N"))
    return FourierMovementPrimitive(
        n_steps=24, rate=10.0, overlap=4, n_components=2, stride=3
    ).fit(both)


@pytest.fixture(params=list(TRACKERS))
def player(request, skill):
    return Player(skill, tracker=TRACKERS[request.param](skill))


def states(player):
    """Yield states at several steps, far from their target, with an offset."""
    skill = player.skill
    start = skill.extent_[1] + np.ptp(skill.extent_, axis=0)
    state = player.start(start)
    while True:
        if state.step in (3, 4, 10, 22, 23):
            # Outside the span of the component too.
            w = np.random.default_rng(state.step).normal(0, 1e-3, len(state.weights))
            yield state
            yield replace(state, weights=state.weights + w)
        if state.step == 23:
            return
        state = player.tick(state)


def literal(player, state, seconds):
    """Return the motion by the rows Phi and the weights at that time."""
    skill = player.skill
    d, rate = skill.n_channels_, skill.rate
    at = min(state.step + seconds * rate, skill.n_steps - 1.0)
    phi = [skill.basis.rows(at, k) * rate**k for k in range(3)]
    w, w_dot, w_ddot = (
        x.reshape(d, -1)
        for x in player._drifts[state.component].advance(
            state.weights, state.target, seconds
        )
    )
    on_path = np.stack(
        [
            w @ phi[0],
            w @ phi[1] + w_dot @ phi[0],
            w @ phi[2] + 2 * w_dot @ phi[1] + w_ddot @ phi[0],
        ]
    )
    blend = critically_damped(state.offset, 1 / player.blend_time, seconds)
    return on_path * skill.scales_ + blend


def greatest(player):
    """Return the sizes of value, velocity and acceleration to compare with."""
    size = np.max(np.abs(player.skill.extent_), axis=0)
    return size * np.array([[1], [10], [100]])


def test_segment_is_the_rows_times_the_weights_plus_the_offset(player):
    scale = greatest(player)
    for state in states(player):
        segment = player.segment(state)
        for t in SECONDS if state.step < 23 else [0.0]:
            expected = literal(player, state, t)
            got = segment.motion(t)
            assert got.shape == (3, 2)
            assert_allclose(got / scale, expected / scale, atol=1e-8)


def test_derivatives_of_a_segment_are_finite_differences(player):
    h = 1e-5
    scale = greatest(player)[:2] * 10
    for state in states(player):
        segment = player.segment(state)
        for t in SECONDS[2:-1]:
            if not h < t < 0.1 - h:
                continue
            slope = (segment.motion(t + h) - segment.motion(t - h))[:2] / (2 * h)
            assert_allclose(
                segment.motion(t)[1:] / scale, slope / scale, rtol=2e-6, atol=1e-6
            )


def test_segment_ends_where_the_next_begins(player):
    # (17) moves the weights in Euler steps: its velocity jumps at a tick.
    exact = 1 if player._drifts[0].euler_tick > 0 else 3
    scale = greatest(player)
    for state in states(player):
        if state.step < 23:
            end = player.segment(state).motion(player.tick_seconds)
            begin = player.segment(player.tick(state)).motion(0.0)
            assert_allclose((end / scale)[:exact], (begin / scale)[:exact], atol=1e-8)


def test_only_slow_decays_make_one_polynomial(skill):
    made = {
        name: type(player.segment(player.start(skill.extent_[1])))
        for name, player in (
            (name, Player(skill, tracker=tracker(skill)))
            for name, tracker in TRACKERS.items()
        )
    }
    # A quick decay, of 0.05 s at ticks of 0.1 s, has no short series.
    assert made == {
        "lqr": PolynomialSegment,
        "quick": Segment,
        "proportional": Segment,
        "exponential": Segment,
    }


def test_polynomial_is_the_segment_also_a_little_beyond_its_tick(skill):
    player = Player(skill)
    scale = greatest(player)
    for state in states(player):
        if state.step == 23:
            return
        exact = Segment(
            polynomial=skill.basis.local_polynomial(state.step),
            rate=skill.rate,
            scales=skill.scales_,
            drift=player._drifts[state.component],
            weights=state.weights,
            target=state.target,
            offset=state.offset,
            blend_rate=1 / player.blend_time,
        )
        for t in np.linspace(0, HORIZON * player.tick_seconds, 7):
            found = player.segment(state).motion(float(t))
            assert_allclose(found / scale, exact.motion(t) / scale, atol=1e-10)


def test_component_without_variation_has_a_segment(skill):
    player = Player(skill)
    flat = replace(
        player._drifts[0], modes=np.zeros((48, 0)), rates=np.zeros(0), rest_rate=2.0
    )
    state = replace(player.start(skill.extent_[1]), component=0)
    player._drifts[0] = flat
    assert isinstance(player.segment(state), PolynomialSegment)
    assert_allclose(
        player.motion(state, 0.05) / greatest(player),
        literal(player, state, 0.05) / greatest(player),
        atol=1e-8,
    )


def test_player_and_segment_agree(player):
    for state in states(player):
        for t in (0.0, 0.04):
            assert np.array_equal(
                player.motion(state, t), player.segment(state).motion(t)
            )


def test_segment_keeps_no_state(player):
    state = next(states(player))
    segment = player.segment(state)
    before = segment.motion(0.02)
    segment.motion(0.09)
    assert np.array_equal(segment.motion(0.02), before)


def test_weights_at_their_target_move_along_the_window(skill):
    player = Player(skill)
    state = player.start(skill.extent_.mean(axis=0))
    state = replace(state, weights=state.target, offset=np.zeros((2, 2)))
    for t in (0.0, 0.033, 0.1):
        for k in range(3):
            rows = skill.observation_rows(3 + 10 * t, derivative=k)
            assert_allclose(
                player.segment(state).motion(t)[k],
                rows @ state.target,
                rtol=1e-8,
                atol=1e-7 * 10**k,
            )


# Critically damped decay --------------------------------------------------------


@pytest.mark.parametrize("rate", [0.5, 2.5, 40.0])
def test_offset_solves_the_critically_damped_spring(rate):
    offset = np.array([[0.1, -0.2], [0.5, 3.0]])

    def spring(_, state):
        x, v = state[:2], state[2:]
        return np.concatenate([v, -(rate**2) * x - 2 * rate * v])

    times = np.linspace(0, 2, 9)
    solution = solve_ivp(
        spring, (0, 2), offset.ravel(), t_eval=times, rtol=1e-10, atol=1e-12
    ).y
    value, velocity, acceleration = critically_damped(offset, rate, times)
    assert_allclose(value, solution[:2].T, atol=1e-8)
    assert_allclose(velocity, solution[2:].T, atol=1e-6)
    assert_allclose(acceleration, -(rate**2) * value - 2 * rate * velocity, atol=1e-9)


def test_offsets_of_many_playbacks_decay_like_each_one():
    offsets = np.random.default_rng(0).standard_normal((5, 2, 3))
    times = np.array([0.0, 0.1, 1.5])
    together = critically_damped(offsets, 2.0, times)
    assert together.shape == (3, 3, 5, 3)
    for i, offset in enumerate(offsets):
        for j, t in enumerate(times):
            alone = critically_damped(offset, 2.0, float(t))
            assert_allclose(together[:, j, i], alone, atol=1e-14)


def test_offset_starts_as_given():
    offset = np.array([[0.1], [0.7]])
    assert_allclose(critically_damped(offset, 3.0, 0.0)[:2], offset)


def test_next_tick_after_the_window_is_refused(skill):
    player = Player(skill)
    with pytest.raises(SkillError, match="re-map before the next tick"):
        player.tick(player.start(skill.extent_[0], step=23))
