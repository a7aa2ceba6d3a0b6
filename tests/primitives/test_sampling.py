"""Facts about which samples are played: those that stay within what was shown."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import gaussian_filter1d

from fmp_drake.primitives import (
    Demonstration,
    ExponentialTracker,
    FourierMovementPrimitive,
    LqrTracker,
    Player,
    ProportionalTracker,
)
from fmp_drake.primitives.model.movement_primitive import copy_skill
from fmp_drake.primitives.playback.motion import look_ahead

MARGIN = 0.01


@pytest.fixture(scope="module")
def skill(wiping_demonstration):
    mixture = FourierMovementPrimitive(model="mixture", n_components=40)
    return mixture.fit(wiping_demonstration)


@pytest.fixture(scope="module")
def skills(skill, wiping_demonstration):
    """One of each model."""
    phase = FourierMovementPrimitive(model="phase", n_components=40)
    return {"mixture": skill, "phase": phase.fit(wiping_demonstration)}


def on_path(skill):
    return skill.paths_[0][40]


def distance_from_paths(player, values):
    return Player(player.skill, margin=MARGIN).region.distance(values)


def farthest_at_first(skill):
    """Return how far out a sample may lead in its first window, which begins at rest.

    By a quarter of the margin farther than the mean, which catches up with the movement.
    """
    player = Player(skill)
    path = player.rollout(on_path(skill), player.ticks_between_remaps / skill.rate)
    return max(MARGIN, distance_from_paths(player, path[:, 0]).max() + MARGIN / 4)


MODELS = pytest.mark.parametrize("model", ["mixture", "phase"])


@MODELS
@pytest.mark.parametrize("seed", range(2))
def test_no_sample_that_is_played_leaves_the_region(skills, model, seed):
    skill = skills[model]
    start = on_path(skill)
    bounded = Player(skill, sample=True, seed=seed, margin=MARGIN)
    free = Player(skill, sample=True, seed=seed, margin=None)
    outside = [
        distance_from_paths(p, p.rollout(start, 50.0)[:, 0]) for p in (bounded, free)
    ]
    first = bounded.ticks_between_remaps + 1
    assert outside[0][:first].max() <= farthest_at_first(skill)
    assert outside[0][first:].max() <= MARGIN
    assert outside[1].max() > (MARGIN if model == "mixture" else 0.5 * MARGIN)


@MODELS
def test_samples_stay_near_the_demonstrations_by_default(skills, model):
    skill = skills[model]
    width = np.linalg.norm(np.ptp(skill.extent_, axis=0)) / 2
    player = Player(skill, sample=True, seed=1)
    path = player.rollout(on_path(skill), 50.0)[:, 0]
    after = player.ticks_between_remaps + 1
    assert distance_from_paths(player, path[after:]).max() <= 0.2 * width
    without = copy_skill(skill, paths_=())
    assert Player(without, sample=True).region is None


@MODELS
def test_choice_of_the_sample_does_not_lead_out_of_the_region(skills, model):
    skill = skills[model]

    def score(values):  # The farther out the better.
        return np.max(player.region.distance(values), axis=1)

    player = Player(skill, sample=True, margin=MARGIN)
    state = player.start(on_path(skill))
    for i in range(8):
        state = player.track_sample(state, count=16, score=score)
        seconds = player.ticks_between_remaps * player.tick_seconds
        values, _ = player.plan(state, player.ticks_between_remaps)
        farthest = np.max(distance_from_paths(player, values))
        most = MARGIN * (1 + 1e-7) if i else farthest_at_first(skill)
        assert MARGIN / 2 < farthest <= most
        state = player.advance(state, seconds)


def test_choice_draws_samples_out_where_the_region_allows_it(skill):
    free, wide = Player(skill, margin=None), Player(skill, margin=5.0)
    state = free.start(on_path(skill))
    mean = skill.components_[state.component].mean
    near, far = (
        p.track_sample(state, count=16, score=lambda v: v[:, -1, 1]).target - mean
        for p in (free, wide)
    )
    assert_allclose(far, 1.5 * near, atol=1e-12)


@pytest.mark.parametrize(
    ("scored", "others"), [(None, [3]), ((0, 1), [2, 3]), ((1,), [0, 2, 3])]
)
def test_choice_draws_out_only_the_scored_channels(
    wiping_demonstration, scored, others
):
    rng = np.random.default_rng(0)
    noise = rng.normal([0.02, 10], [0.01, 2], (len(wiping_demonstration.time), 2))
    noise[::600, 1] += 20  # Its range is wide enough for every sample.
    demonstration = replace(
        wiping_demonstration,
        values=np.column_stack([wiping_demonstration.values[:, :2], noise]),
        channels=("x", "y", "z", "force"),
        units=("m", "m", "m", "N"),
    )
    skill = FourierMovementPrimitive(model="phase", n_components=40).fit(demonstration)
    free, wide = Player(skill, margin=None), Player(skill, margin=5.0)
    state = free.start(on_path(skill))
    near, far = (
        skill.synthesize(
            p.track_sample(
                state, count=16, score=lambda v: -np.arange(len(v)), scored=scored
            ).target
        )
        for p in (free, wide)
    )
    drawn = np.setdiff1d(np.arange(4), others)
    assert_allclose(far[:, others], near[:, others], atol=1e-9)
    assert np.all(np.max(np.abs(far - near), axis=0)[drawn] > 0.003)


@pytest.mark.parametrize("noise", [0.0001, 0.001])
def test_choice_does_not_draw_out_the_noise_of_a_recording(noise):
    time = np.arange(0.0, 12.0, 0.05)
    angle = 2 * np.pi * time / 4 + 0.1 * np.sin(time)
    circle = 0.08 * np.column_stack([np.cos(angle), np.sin(angle)])
    circle += np.random.default_rng(0).normal(scale=noise, size=circle.shape)
    skill = FourierMovementPrimitive(model="phase").fit(
        Demonstration(time=time, values=circle, channels=("x", "y"), units=("m", "m"))
    )
    player = Player(skill, sample=True)

    def score(values):  # The farther out the better.
        return np.max(player.region.distance(values), axis=1)

    def acceleration(values):
        return np.sqrt(np.mean(np.diff(values, n=2, axis=0) ** 2))

    state, ratios = player.start(skill.paths_[0][0]), []
    for _ in range(6):
        state = player.track_sample(state, count=48, score=score)
        played, _ = player.plan(state, player.ticks_between_remaps)
        ratios.append(acceleration(played) / acceleration(skill.paths_[0]))
        seconds = player.ticks_between_remaps * player.tick_seconds
        state = player.advance(state, seconds)
    assert max(ratios) < 2


def force_and_angle(wiping_demonstration):
    """Return the wiping with a force and an angle that vary slowly."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(len(wiping_demonstration.time), 2))
    slow = gaussian_filter1d(noise, 8, axis=0, mode="wrap")
    values = [10.0, 0.0] + slow / slow.std(axis=0) * [3.0, 0.2]
    return replace(
        wiping_demonstration,
        values=np.column_stack([wiping_demonstration.values, values]),
        channels=(*wiping_demonstration.channels, "force", "angle"),
        units=(*wiping_demonstration.units, "N", "rad"),
    )


def test_sampled_force_and_angle_stay_in_their_range(wiping_demonstration):
    demonstration = force_and_angle(wiping_demonstration).rows(np.arange(600))
    skill = FourierMovementPrimitive(model="phase", n_components=40).fit(demonstration)
    low, high = skill.extent_[:, 3:]
    farthest, spread = {}, {}
    for margin in ("automatic", None):
        values = np.concatenate(
            [
                Player(skill, sample=True, seed=k, margin=margin).rollout(
                    on_path(skill), 60.0
                )[200:, 0, 3:]
                for k in range(3)
            ]
        )
        farthest[margin] = np.max(np.maximum(low - values, values - high), axis=0)
        spread[margin] = values.std(axis=0)
    half = (high - low) / 2
    assert np.all(farthest["automatic"] <= 0.25 * half)
    assert np.any(farthest[None] > 0.3 * half)
    assert np.all(spread["automatic"] > 0.6 * spread[None])


def test_return_of_samples_is_hardly_farther_out_than_that_of_the_mean(skill):
    start = skill.extent_[1] + [0.1, 0.1, 0.05]
    bounded = Player(skill, sample=True, seed=3, margin=MARGIN)
    path = bounded.rollout(start, 15.0)[:, 0]
    n = bounded.ticks_between_remaps
    mean = distance_from_paths(bounded, Player(skill).rollout(start, 15.0)[: n + 1, 0])
    mine = distance_from_paths(bounded, path)
    assert mine[0] > 0.1
    limit = np.where(mean > MARGIN, mean + MARGIN / 4, MARGIN)
    assert np.all(mine[: n + 1] <= limit + 1e-9)
    assert np.all(mine[n:] <= MARGIN)
    # It is a sample all the same.
    assert not np.allclose(
        path[: n + 1], Player(skill).rollout(start, 15.0)[: n + 1, 0]
    )


@MODELS
def test_wide_margin_changes_nothing(skills, model):
    skill = skills[model]
    start = on_path(skill)
    free = Player(skill, sample=True, seed=1, margin=None).rollout(start, 12.0)
    wide = Player(skill, sample=True, seed=1, margin=5.0).rollout(start, 12.0)
    assert_allclose(wide, free, atol=1e-9)


def test_means_are_played_as_they_are(skill):
    free, bounded = Player(skill), Player(skill, margin=1e-4)
    start = on_path(skill)
    assert_array_equal(bounded.rollout(start, 12.0), free.rollout(start, 12.0))


def test_samples_follow_from_seed_and_re_mapping(skill):
    start = on_path(skill)
    paths = [
        Player(skill, sample=True, seed=seed, margin=MARGIN).rollout(start, 12.0)
        for seed in (1, 1, 2)
    ]
    assert_array_equal(paths[0], paths[1])
    assert not np.allclose(paths[0], paths[2])


def test_sample_of_highest_score_is_tracked_and_the_first_of_equals(small_skill):
    player = Player(small_skill, margin=None)
    state = player.start([0.1, 0.0])
    gaussian = small_skill.components_[state.component]
    rng = np.random.default_rng([state.seed, state.remaps])
    targets = gaussian.sample(rng, 6, with_noise=False)
    before = player.motion(state)[:2]
    for scores, best in (
        ([0, 1, 5, 2, 3, 4], 2),
        ([0, 3, 1, 3, 3, 2], 1),
        (np.zeros(6), 0),
    ):
        tracked = player.track_sample(
            state, count=6, score=lambda _, scores=scores: np.array(scores)
        )
        assert_allclose(tracked.target, targets[best], atol=1e-12)
        assert_allclose(player.motion(tracked)[:2], before, atol=1e-12)


TRACKERS = (LqrTracker(), ExponentialTracker(beta=2e-8), ProportionalTracker(beta=2e-8))


@pytest.mark.parametrize("tracker", TRACKERS, ids=lambda t: type(t).__name__)
@pytest.mark.parametrize(("tempo", "passed"), [(1.0, 2.0), (1.0, 2.73), (1.9, 1.07)])
def test_look_ahead_equals_the_played_motion(small_skill, tracker, tempo, passed):
    player = Player(small_skill, sample=True, seed=2, tracker=tracker)
    state = player.advance(player.start([0.3, 0.1], tempo=tempo), passed)
    assert state.remaps == 1
    ahead = look_ahead(small_skill, player.relaxations[state.component], state)
    gaussian = small_skill.components_[state.component]
    change = np.random.default_rng(1).normal(size=gaussian.rank)
    change *= np.sqrt(gaussian.variances)
    for target, values in (
        (state.target, ahead.steady),
        (
            state.target + gaussian.basis @ change,
            ahead.steady + ahead.response @ change,
        ),
    ):
        # To the last sample of the window, where it is mapped anew.
        plan = player.plan(player.retarget(state, target), len(values))[0]
        assert_allclose(values, plan[1:], atol=1e-9)
