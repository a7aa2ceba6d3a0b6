"""Facts about playing a skill."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import SkillError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    LqrTracker,
    Player,
    ProportionalTracker,
)
from fmp_drake.primitives.playback.trackers import paper_precision_diagonal


def proportional(skill):
    """Return the tracker (17) at half the gain at which it diverges."""
    greatest = max(
        paper_precision_diagonal(c, n_steps=skill.n_steps).max()
        for c in skill.components_
    )
    return ProportionalTracker(beta=skill.rate / greatest)


@pytest.fixture(params=["lqr", "proportional", "samples"])
def options(request, small_skill):
    """The ways to play."""
    return {
        "lqr": {},
        "proportional": {"tracker": proportional(small_skill)},
        "samples": {"sample": True, "seed": 3},
    }[request.param]


@pytest.fixture
def player(options, small_skill):
    """A player of each kind."""
    return Player(small_skill, **options)


def outside(skill):
    """Return a start 10 cm outside what was demonstrated, in every channel."""
    return skill.extent_[1] + 0.1


def ticks(player, state, count):
    """Yield the states at the coming ticks."""
    for _ in range(count):
        state = player.advance(state, player.tick_seconds)
        yield state


def motion_after(player, state, seconds):
    """Return the motion some seconds after a state."""
    return player.motion(player.advance(state, seconds))


def assert_states_equal(one, two):
    for name in ("component", "step", "remaps"):
        assert getattr(one, name) == getattr(two, name)
    for name in ("weights", "target", "history", "offset"):
        assert np.array_equal(getattr(one, name), getattr(two, name)), name


# Start --------------------------------------------------------------------


@pytest.mark.parametrize("tempo", [0.0, 0.7, 1.0])
def test_playback_starts_at_rest_exactly_at_the_start(player, tempo):
    for position in (player.skill.extent_.mean(axis=0), outside(player.skill)):
        state = player.start(position, tempo=tempo)
        value, velocity, _ = player.motion(state)
        assert_allclose(value, position, atol=1e-14)
        assert_allclose(velocity, 0, atol=1e-12)
        assert state.step == 3
        assert state.remaps == 0
        assert_allclose(state.history, np.tile(position, (4, 1)))


def test_start_maps_one_sample(small_skill):
    player = Player(small_skill, start_tolerance=0)
    position = small_skill.extent_.mean(axis=0) + 0.01
    state = player.start(position)
    mapping = small_skill.map_partial(position[None], first_step=3)
    gaussian = small_skill.components_[mapping.component]
    assert state.component == mapping.component
    inside = gaussian.basis @ gaussian.basis.T
    expected = gaussian.mean + inside @ (mapping.weights - gaussian.mean)
    assert_allclose(state.weights, expected, atol=1e-12)
    assert np.array_equal(state.target, gaussian.mean)


def test_start_within_its_tolerance_does_not_swing_out_elsewhere(
    wiping_skill, wiping_mixture
):
    low, high = wiping_skill.extent_
    starts = np.random.default_rng(0).uniform(low, high, size=(100, 3))
    starts[:, 2] = 0.1

    def swing(skill, **options):
        paths = Player(skill, **options).rollout(starts, 6.0)[:, :, 0, :2]
        outside = np.maximum(paths - high[:2], low[:2] - paths).max(axis=(1, 2))
        return np.percentile(outside, 90)

    assert swing(wiping_mixture) < 0.5 * swing(wiping_mixture, start_tolerance=0)
    # The window of a phase model lies around its cycle, however it was mapped.
    assert swing(wiping_skill) < 0.025


def test_start_tolerance_that_is_negative_is_refused(small_skill):
    with pytest.raises(SkillError, match="start_tolerance is -1"):
        Player(small_skill, start_tolerance=-1)


@pytest.mark.parametrize(
    "start", [[0.0], [0, 0, 0], [[0, 0]], [0, np.nan], [0, np.inf]]
)
def test_invalid_start_is_refused(small_skill, start):
    with pytest.raises(
        SkillError, match=r"the start of shape .* expected \(2,\)|NaN or .* the start"
    ):
        Player(small_skill).start(start)


# Continuity ---------------------------------------------------------------


@pytest.mark.parametrize("tempo", [1.0, 0.9, 1.37])
def test_position_and_velocity_continue_at_every_instant(player, tempo):
    state, h = player.start(outside(player.skill), tempo=tempo), 1e-6
    linear = player.segment(state).linear
    for _ in range(450):
        before, state = state, player.advance(state, player.tick_seconds / 2)
        wait = before.seconds_until(player.tick_seconds)
        if not 0 < wait < player.tick_seconds / 2:
            continue
        early, late = (motion_after(player, before, wait + s) for s in (-h, h))
        assert_allclose(late[0], early[0], atol=2e-5)
        if not linear:  # (17) moves the weights in Euler steps: its velocity jumps.
            assert_allclose(late[1], early[1], atol=1e-4)
    assert state.remaps >= 9


def test_remapping_changes_neither_position_nor_velocity(player):
    state = player.advance(player.start(outside(player.skill)), 1.23)
    after = player.remap(state)
    assert_allclose(player.motion(after)[:2], player.motion(state)[:2], atol=1e-12)
    assert after.step == player.skill.overlap - 1
    assert after.time_since_tick == state.time_since_tick
    assert after.remaps == state.remaps + 1
    assert np.array_equal(after.history, state.history)


@pytest.mark.parametrize("options", [{}, {"sample": True, "seed": 3}])
def test_remapping_between_two_ticks_does_not_stop_the_movement(small_skill, options):
    player = Player(small_skill, **options)
    state, path = player.start(player.skill.extent_.mean(axis=0)), []
    for _ in range(400):
        state = player.remap(player.advance(state, 0.48 * player.tick_seconds))
        path.append(player.motion(state)[0])
    moved, demonstrated = (
        np.ptp(path[200:], axis=0),
        np.ptp(player.skill.extent_, axis=0),
    )
    assert np.all(moved > 0.4 * demonstrated)
    assert np.all(moved < 1.5 * demonstrated)


def test_a_target_is_not_shared_with_its_owner(small_skill):
    target = small_skill.components_[0].mean.copy()
    expected = target.copy()
    player = Player(small_skill, target=target)
    state = player.start(small_skill.extent_.mean(axis=0))
    target[:] = 0
    assert_allclose(state.target, expected)
    assert_allclose(player.start(small_skill.extent_[1]).target, expected)


@pytest.mark.parametrize(("tempo", "tempo_rate"), [(1.0, 0.0), (0.6, 0.5)])
def test_derivatives_of_the_motion_are_finite_differences(player, tempo, tempo_rate):
    h = 1e-5
    state = player.start(outside(player.skill), tempo=tempo)
    for one in ticks(player, replace(state, tempo_rate=tempo_rate), 25):
        wait = one.seconds_until(player.tick_seconds)
        for seconds in (0.2 * wait, 0.5 * wait, 0.9 * wait):
            early, here, late = (
                motion_after(player, one, seconds + s) for s in (-h, 0, h)
            )
            assert_allclose(here[1:], (late - early)[:2] / (2 * h), atol=2e-5)


def test_history_holds_the_last_desired_values(player):
    values = [player.motion(player.start(outside(player.skill)))[0]]
    for state in ticks(player, player.start(outside(player.skill)), 60):
        values.append(player.motion(state)[0])
        count = min(len(values), 4)
        assert_allclose(state.history[-count:], values[-count:], atol=1e-12)


def test_remapping_happens_every_t_minus_k_ticks(player):
    assert player.ticks_between_remaps == 20
    remaps = [s.remaps for s in ticks(player, player.start(outside(player.skill)), 65)]
    assert remaps == [i // 20 for i in range(1, 66)]


def test_weights_relax_to_their_target(player):
    state = player.start(outside(player.skill))
    distances = []
    for one in [state, *ticks(player, state, 19)]:
        distances.append(np.linalg.norm(player.weights(one) - one.target))
    assert np.all(np.diff(distances) < 0)


def test_first_values_repeat_the_mapped_values(small_skill):
    # A re-mapped window follows the last K values of the one before.
    player = Player(small_skill)
    state = player.advance(player.start(small_skill.extent_.mean(axis=0)), 2.0)
    assert state.remaps == 1
    assert state.component == small_skill.map_partial(state.history).component


# Where it goes ------------------------------------------------------------


@pytest.mark.parametrize("fixture", ["small_skill", "wiping_skill"])
@pytest.mark.parametrize("sample", [False, True])
def test_returns_to_the_demonstrations_from_outside(fixture, sample, request):
    skill = request.getfixturevalue(fixture)
    player = Player(skill, sample=sample)
    cycle = player.ticks_between_remaps
    motion = player.rollout(outside(skill), 8 * cycle / skill.rate)
    late = motion[3 * cycle :, 0]
    span = np.ptp(skill.extent_, axis=0)
    # Samples vary as much as the demonstrations did, around Gaussians' means.
    margin = (0.35 if sample else 0.1) * span
    assert np.all(late > skill.extent_[0] - margin)
    assert np.all(late < skill.extent_[1] + margin)
    # And does not come to rest there.
    assert np.all(np.ptp(late, axis=0)[:2] > 0.4 * span[:2])


def deviation(skill, state):
    """Return how many standard deviations the weights are from the mean."""
    gaussian = skill.components_[state.component]
    inside = (state.weights - gaussian.mean) @ gaussian.basis
    return np.linalg.norm(inside / np.sqrt(gaussian.variances + gaussian.noise))


@pytest.mark.parametrize("confidence", [0.5, 0.99])
def test_mapped_weights_stay_in_the_ellipsoid_of_the_confidence(
    wiping_mixture, confidence
):
    player = Player(wiping_mixture, confidence=confidence, start_tolerance=0)
    state = player.start(outside(wiping_mixture))
    rank = wiping_mixture.components_[state.component].rank
    radius = np.sqrt(chi2.ppf(confidence, rank))
    assert deviation(wiping_mixture, state) == pytest.approx(radius)
    free = Player(wiping_mixture, confidence=1.0, start_tolerance=0).start(
        outside(wiping_mixture)
    )
    assert deviation(wiping_mixture, free) > 1.5 * radius
    for later in ticks(player, state, 330):
        assert deviation(wiping_mixture, later) <= radius * (1 + 1e-9)


def test_return_from_outside_does_not_swing_out(wiping_skill):
    # Without the ellipsoid: 0.25 m further out along y, and at 1.4 m/s.
    start = outside(wiping_skill)
    motion = Player(wiping_skill).rollout(start, 11.0)
    assert np.all(motion[:, 0] < start + 0.01)
    assert np.all(np.abs(motion[:, 1]) < 1.0)


@pytest.mark.parametrize("confidence", [0.0, -0.1, 1.1, np.nan])
def test_confidence_that_is_not_a_fraction_is_refused(small_skill, confidence):
    with pytest.raises(SkillError, match=r"confidence is .* positive and at most 1\.0"):
        Player(small_skill, confidence=confidence)


def test_start_inside_stays_inside(wiping_skill):
    skill = wiping_skill
    span = np.ptp(skill.extent_, axis=0)
    for window in skill.sample(5, seed=0, with_noise=False):
        start = np.clip(window[9], *skill.extent_)
        motion = Player(skill).rollout(start, 30.0)[:, 0]
        assert np.all(motion > skill.extent_[0] - 0.25 * span)
        assert np.all(motion < skill.extent_[1] + 0.25 * span)


def test_motion_is_as_fast_as_the_demonstrations(wiping_skill, wiping_demonstration):
    demonstrated = wiping_demonstration.resample(20)
    fastest = np.abs(np.diff(demonstrated.values, axis=0)).max(axis=0) * 20
    played = Player(wiping_skill).rollout(outside(wiping_skill), 60)[220:]
    assert np.all(np.abs(played[:, 1]).max(axis=0) < 1.3 * fastest)


# Repeatability ------------------------------------------------------------


def test_two_players_are_identical(small_skill, player, options):
    twin, start = Player(small_skill, **options), outside(small_skill)
    one, two = player.start(start), twin.start(start)
    assert_states_equal(one, two)
    for a, b in zip(ticks(player, one, 50), ticks(twin, two, 50), strict=True):
        assert_states_equal(a, b)


def test_player_keeps_no_state(player):
    start = outside(player.skill)
    first = player.rollout(start, 7.0)
    player.rollout(start - 0.3, 3.0)
    assert np.array_equal(player.rollout(start, 7.0), first)


def test_samples_differ_from_the_mean_and_repeat_with_the_seed(small_skill):
    start = small_skill.extent_.mean(axis=0)
    mean = Player(small_skill).rollout(start, 10.0)
    one, same, other = (
        Player(small_skill, sample=True, seed=seed).rollout(start, 10.0)
        for seed in (1, 1, 2)
    )
    assert np.array_equal(one, same)
    assert np.max(np.abs(one[:, 0] - mean[:, 0])) > 0.005
    assert np.max(np.abs(one[:, 0] - other[:, 0])) > 0.005


def test_new_samples_are_drawn_at_every_remapping(small_skill):
    player = Player(small_skill, sample=True)
    state = player.start(small_skill.extent_.mean(axis=0))
    targets = [s.target for s in ticks(player, state, 60)]
    assert len({target.tobytes() for target in targets}) == 4
    assert np.array_equal(targets[0], targets[18])


def test_samples_stay_in_the_span_of_the_component(small_skill):
    player = Player(small_skill, sample=True)
    state = player.start(small_skill.extent_.mean(axis=0))
    gaussian = small_skill.components_[state.component]
    delta = state.target - gaussian.mean
    assert np.linalg.norm(delta) > 0.01
    assert_allclose(gaussian.basis @ (gaussian.basis.T @ delta), delta, atol=1e-12)


def test_parts_of_a_motion_have_names(small_skill):
    player = Player(small_skill)
    starts = np.zeros((2, 2))
    for motion in (
        player.motion(player.start([0.1, 0.0])),
        player.rollout([0.1, 0.0], 2.0),
        player.rollout(starts, 1.0),
    ):
        parts = (motion.position, motion.velocity, motion.acceleration)
        assert np.array_equal(np.stack(parts, axis=-2), motion)
        # Whatever is taken out of it or computed from it has no names.
        for plain in (*parts, motion[0], 2 * motion, motion.max(axis=0), *motion):
            assert type(plain) is np.ndarray


def test_rollout_is_repeated_ticks(player):
    start = outside(player.skill)
    state = player.start(start)
    expected = [player.motion(state)]
    expected += [player.motion(s) for s in ticks(player, state, 45)]
    rollout = player.rollout(start, 4.5)
    assert rollout.shape == (46, 3, 2)
    assert_allclose(rollout, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize(("duration", "count"), [(0, 1), (0.3, 4), (0.35, 4), (0.7, 8)])
def test_rollout_has_a_row_per_tick(small_skill, duration, count):
    assert len(Player(small_skill).rollout([0, 0], duration)) == count


@pytest.mark.parametrize("duration", [-1.0, np.nan, np.inf])
def test_rollout_without_an_end_is_refused(small_skill, duration):
    with pytest.raises(SkillError, match=r"duration is .* s; it must be at least 0 s"):
        Player(small_skill).rollout([0, 0], duration)


# Other outputs ------------------------------------------------------------


def test_covariance_is_that_of_predictions_at_the_time(small_skill):
    player = Player(small_skill)
    state = replace(player.start([0, 0]), step=7)
    expected = small_skill.predicted_covariance(state.component, 7.4)
    later = player.advance(state, 0.04)
    assert_allclose(player.covariance(later), expected)
    assert np.all(np.linalg.eigvalsh(expected) > 0)


def test_variation_of_the_demonstrations_lacks_the_errors_of_predictions(small_skill):
    player = Player(small_skill)
    later = player.advance(replace(player.start([0, 0]), step=7), 0.04)
    variation = player.variation(later)
    assert_allclose(variation, small_skill.covariance(later.component, 7.4))
    assert np.trace(variation) < 0.999 * np.trace(player.covariance(later))


def test_motion_is_weights_plus_offset(player):
    start = outside(player.skill)
    for state in ticks(player, player.start(start), 30):
        w = player.weights(state)
        on_path = player.skill.basis.synthesize(w)[state.step]
        assert_allclose(player.motion(state)[0], on_path + state.offset[0], atol=1e-12)


def test_offset_decays_like_a_critically_damped_spring(small_skill):
    player = Player(small_skill, blend_time=0.3)
    state = replace(player.start([0, 0]), offset=np.array([[0.1, 0.0], [0.0, 0.2]]))
    without = replace(state, offset=np.zeros((2, 2)))
    for t in (0.0, 0.03, 0.1):
        value, velocity, acceleration = motion_after(player, state, t) - motion_after(
            player, without, t
        )
        decay = np.exp(-t / 0.3)
        assert_allclose(value, [0.1 * (1 + t / 0.3) * decay, 0.2 * t * decay])
        spring = -value / 0.3**2 - 2 * velocity / 0.3
        assert_allclose(acceleration, spring, atol=1e-9)


@pytest.mark.parametrize("blend_time", [0.0, -1.0, np.nan, np.inf])
def test_blend_time_that_is_not_positive_is_refused(small_skill, blend_time):
    with pytest.raises(SkillError, match=r"blend_time is .* must be at least 0\.001 s"):
        Player(small_skill, blend_time=blend_time)


def ellipses(period, rate):
    """Return ellipses of 0.2 m x 0.12 m whose tempo and size vary a little."""
    time = np.arange(60 * rate) / rate
    phase = 2 * np.pi / period * time + 0.2 * np.sin(0.3 * time)
    size = 0.1 * (1 + 0.05 * np.sin(0.17 * time))
    path = [size * np.cos(phase), 0.6 * size * np.sin(phase), 0.01 * np.sin(2 * phase)]
    noise = 2e-4 * np.random.default_rng(0).standard_normal((len(time), 3))
    return Demonstration(time=time, values=np.column_stack(path) + noise)


@pytest.mark.parametrize(
    ("period", "rate", "tempo", "model"),
    [
        (0.5, 20, 1.0, "phase"),
        (0.6, 20, 1.0, "phase"),
        (0.5, 50, 4.0, "phase"),
        (1.0, 20, 4.0, "phase"),
        (2.5, 20, 5.0, "mixture"),
    ],
)
def test_fast_movements_keep_their_size(period, rate, tempo, model):
    shown = ellipses(period, rate)
    player = Player(FourierMovementPrimitive(rate=rate, model=model).fit(shown))
    state, played = player.start(shown.values[0], tempo=tempo), []
    for k in range(round(30 / tempo * 100)):
        state = player.advance(state, 0.01)
        if k >= 15 / tempo * 100:
            played.append(player.motion(state)[0])
    assert_allclose(np.ptp(played, axis=0)[:2], [0.2, 0.12], rtol=0.06)


def test_a_movement_that_halts_stays_where_it_has_stopped(small_skill):
    player = Player(small_skill)
    state = player.advance(player.start(outside(small_skill)), 1.02)
    halting = replace(state, tempo_rate=-4.0)
    steps = halting
    for _ in range(200):
        steps = player.advance(steps, 0.01)
    at_once = player.advance(halting, 2.0)
    assert at_once.tempo == steps.tempo == 0
    assert at_once.time_since_tick == pytest.approx(steps.time_since_tick, rel=0.01)
    assert_allclose(player.motion(at_once)[0], player.motion(steps)[0], atol=1e-3)


def test_a_pickled_rollout_keeps_its_times(small_skill):
    motion = Player(small_skill).rollout(outside(small_skill), 1.0)
    restored = pickle.loads(pickle.dumps(motion))
    assert np.array_equal(restored.time, motion.time)
    assert np.array_equal(restored.velocity, motion.velocity)


def test_unfitted_skill_cannot_be_played():
    with pytest.raises(NotFittedError):
        Player(FourierMovementPrimitive())


def test_tracker_is_used(small_skill):
    start = outside(small_skill)
    slow = Player(small_skill, tracker=LqrTracker(time_constant=20)).rollout(start, 4)
    fast = Player(small_skill, tracker=LqrTracker(time_constant=0.5)).rollout(start, 4)
    assert np.max(np.abs(slow - fast)) > 0.01


def test_real_demonstrations_are_played_from_outside(real_demonstration_paths):
    for name, path in real_demonstration_paths.items():
        demonstration = Demonstration.load(path).resample(20)
        n_steps = min(60, len(demonstration.time) - 10)
        skill = FourierMovementPrimitive(
            n_steps=n_steps, overlap=n_steps // 10, stride=2, n_components=5
        ).fit(demonstration)
        span = np.ptp(skill.extent_, axis=0)
        start = skill.extent_[1] + 0.05
        motion = Player(skill).rollout(start, 30.0)
        assert np.all(np.isfinite(motion)), name
        late = motion[300:, 0]
        assert np.all(late > skill.extent_[0] - 0.3 * span - 0.01), name
        assert np.all(late < skill.extent_[1] + 0.3 * span + 0.01), name


# Many starts, targets ------------------------------------------------


def starts_around(skill, count=9):
    """Return starts in a box twice as wide as what was demonstrated."""
    middle, half = skill.extent_.mean(axis=0), np.ptp(skill.extent_, axis=0) / 2
    rng = np.random.default_rng(0)
    return middle + 2 * half * rng.uniform(-1, 1, (count, len(middle)))


def test_rollout_of_many_starts_is_that_of_each(small_skill, options):
    starts = starts_around(small_skill)
    many = Player(small_skill, **options).rollout(starts, 7.3)
    assert many.shape == (9, 74, 3, 2)
    assert_allclose(many[:, 0, 0], starts, atol=1e-12)
    for i, start in enumerate(starts):
        # The samples of start i are drawn from the seed plus i.
        alone = dict(options)
        if "seed" in alone:
            alone["seed"] += i
        one = Player(small_skill, **alone).rollout(start, 7.3)
        assert_allclose(many[i], one, rtol=1e-9, atol=1e-8)


def test_rollout_has_the_times_of_its_samples(small_skill):
    player = Player(small_skill)
    for starts in ([0.3, 0.1], [[0.3, 0.1], [0.0, 0.0]]):
        motion = player.rollout(starts, 2.01)
        assert_allclose(motion.time, np.arange(len(motion.time)) / small_skill.rate)
        assert len(motion.time) == motion.position.shape[-2]
        assert motion.copy().time is motion.time
    assert player.motion(player.start([0.3, 0.1])).time is None


def test_own_target_is_reached(small_skill):
    window = small_skill.sample(1, seed=8, with_noise=False)[0]
    target = small_skill.analyze(window)
    player = Player(
        small_skill, target=target, tracker=LqrTracker(time_constant=0.2, shortest=0.1)
    )
    state = player.start(outside(small_skill))
    assert np.array_equal(state.target, target)
    state = player.advance(state, 1.9)
    assert_allclose(state.weights, target, atol=1e-3)
    assert_allclose(player.motion(state)[0] - state.offset[0], window[22], atol=1e-3)
    assert np.array_equal(player.advance(state, 0.1).target, target)


def test_own_target_is_one_for_all_starts(small_skill):
    target = small_skill.components_[1].mean
    starts = starts_around(small_skill, 4)
    player = Player(small_skill, target=target)
    many = player.rollout(starts, 6.0)
    for motion, start in zip(many, starts, strict=True):
        assert_allclose(motion, player.rollout(start, 6.0), rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (np.zeros(47), r"the target of shape \(47,\); expected \(48,\)"),
        (np.zeros((1, 48)), r"expected \(48,\)"),
        (np.full(48, np.nan), "NaN or infinite numbers in the target"),
        ("mean", "'mean' cannot be read as real numbers"),
    ],
)
def test_invalid_target_is_refused(small_skill, target, message):
    with pytest.raises(SkillError, match=message):
        Player(small_skill, target=target)


def test_target_and_samples_exclude_each_other(small_skill):
    with pytest.raises(SkillError, match="either a target or sample=True"):
        Player(small_skill, target=np.zeros(48), sample=True)


@pytest.mark.parametrize("seed", [-1, 1.5, None, "one"])
def test_seed_that_is_not_a_whole_number_is_refused(small_skill, seed):
    with pytest.raises(SkillError, match=r"seed is .* whole number"):
        Player(small_skill, seed=seed)


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda p: Player(p.skill, tracker="lqr"), "tracker is 'lqr'; give one"),
        (lambda p: p.start([0, 0], seed=-1), "seed is -1"),
        (lambda p: p.track_sample(p.start([0, 0]), count=0), "count is 0"),
    ],
)
def test_unusable_arguments_are_named(small_skill, use, message):
    with pytest.raises(SkillError, match=message):
        use(Player(small_skill))


@pytest.mark.parametrize("start", [[0.0], [[[0.0, 0.0]]], [[0, np.nan]], "here", None])
def test_rollout_from_an_invalid_start_is_refused(small_skill, start):
    with pytest.raises(SkillError, match="the start"):
        Player(small_skill).rollout(start, 1.0)


@pytest.mark.parametrize("sample", [False, True])
def test_ten_minutes_stay_where_the_demonstrations_were(wiping_skill, sample):
    player = Player(wiping_skill, sample=sample)
    motion = player.rollout(outside(wiping_skill), 600.0)
    assert motion.shape == (12001, 3, 3)
    assert np.all(np.isfinite(motion))
    low, high = wiping_skill.extent_
    margin = (0.35 if sample else 0.1) * (high - low)
    late = motion[440:, 0]
    assert np.all((late > low - margin) & (late < high + margin))
    # The last minute moves like the second.
    second, last = motion[1200:2400, 0], motion[-1200:, 0]
    assert_allclose(last.std(axis=0), second.std(axis=0), rtol=0.35)
    # Values are the integral of velocities and those of accelerations, throughout.
    # At a re-mapping the acceleration may jump.
    for k, tolerance in ((0, 4e-3), (1, 0.15)):
        trapezium = (motion[1:, k + 1] + motion[:-1, k + 1]) / 2 / 20
        assert np.max(np.abs(np.diff(motion[:, k], axis=0) - trapezium)) < tolerance


def test_skill_of_a_movement_that_never_varies_plays():
    # Periods of a whole number of strides: most components have no variance at all.
    time = np.arange(400) / 20
    angle = 2 * np.pi * time / 2.5
    exact = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) / 10
    demonstration = Demonstration(time=time, values=exact)
    skill = FourierMovementPrimitive(model="mixture", n_components=80).fit(
        demonstration
    )
    assert min(c.rank for c in skill.components_) == 0
    path = Player(skill).rollout([0.2, 0.2, 0.1], 20.0)
    assert np.all(np.isfinite(path))
    assert_allclose(np.linalg.norm(path[-50:, 0, :2], axis=1), 0.1, atol=2e-3)
    state = Player(skill).start([0.1, 0.0, 0.0])
    assert np.all(np.isfinite(Player(skill).covariance(state)))


# What a robot that is watched adds ------------------------------------------------


@pytest.mark.parametrize("ticks", [2.5, -1, None])
def test_a_plan_has_a_whole_number_of_ticks(ticks, small_skill):
    player = Player(small_skill)
    with pytest.raises(
        SkillError, match=f"ticks is {ticks}; it must be a whole number, at least 0"
    ):
        player.plan(player.start([0.1, 0.0]), ticks)


@pytest.mark.parametrize("sample", [False, True])
def test_plan_is_the_coming_ticks(small_skill, sample):
    player = Player(small_skill, sample=sample, seed=4)
    state = player.advance(player.start([0.1, 0.0]), 0.13)
    values, covariances = player.plan(state, 45)
    assert values.shape == (46, 2)
    assert covariances.shape == (46, 2, 2)
    tick = player.advance(state, 0.07)
    coming = [state, tick, *ticks(player, tick, 44)]
    for one, value, covariance in zip(coming, values, covariances, strict=True):
        assert_allclose(player.motion(one)[0], value, atol=1e-9)
        assert_allclose(player.covariance(one), covariance, atol=1e-12)
    assert coming[-1].remaps == 2


@pytest.mark.parametrize("every", [1, 7, 20])
def test_remappings_have_the_given_interval(small_skill, every):
    player = Player(small_skill, remap_ticks=every)
    *_, state = ticks(player, player.start([0.1, 0.0]), 40)
    assert state.remaps == 40 // every


@pytest.mark.parametrize("every", [0, 21, 2.5, "often"])
def test_ticks_between_remaps_fit_into_a_window(small_skill, every):
    with pytest.raises(SkillError, match=rf"remap_ticks is {every!r}; .* 1 .* 20"):
        Player(small_skill, remap_ticks=every)


@pytest.mark.parametrize(
    ("observed", "message"),
    [
        (np.zeros((3, 2)), r"the observed values of shape \(3, 2\); expected \(4, 2\)"),
        (np.full((4, 2), np.nan), "NaN or infinite numbers in the observed values"),
    ],
)
def test_observation_that_does_not_fit_is_refused(small_skill, observed, message):
    player = Player(small_skill)
    with pytest.raises(SkillError, match=message):
        player.remap(player.start([0.1, 0.0]), observed=observed)


def test_pushed_robot_is_met_more_closely_than_a_start(small_skill):
    player = Player(small_skill)
    state = player.start([0.0, 0.0])
    observed = np.tile([0.04, -0.03], (4, 1))
    mapped = player.remap(state, observed=observed)
    reached = player.motion(replace(mapped, offset=np.zeros((2, 2))))[0]
    assert np.linalg.norm(reached - observed[-1]) < 0.02
    assert_allclose(player.motion(mapped)[0], player.motion(state)[0], atol=1e-9)


# Tempo ------------------------------------------------------------------------------


@pytest.mark.parametrize(("tempo", "tempo_rate"), [(0.5, 0), (2.0, 0), (0.3, 0.7)])
def test_ticks_come_when_the_skills_time_has_passed(small_skill, tempo, tempo_rate):
    player = Player(small_skill)
    state = player.start(outside(small_skill), tempo=tempo)
    state = replace(state, tempo_rate=tempo_rate)
    for seconds in np.linspace(0.05, 3, 40):
        passed = tempo * seconds + tempo_rate * seconds**2 / 2
        later = player.advance(state, seconds)
        ticks_made = later.step - 3 + 20 * later.remaps
        assert_allclose(ticks_made * 0.1 + later.time_since_tick, passed, atol=1e-6)
        assert later.tempo == pytest.approx(tempo + tempo_rate * seconds)


@pytest.mark.parametrize("tempo", [0.5, 1.0, 1.37])
def test_advancing_in_parts_is_advancing_at_once(player, tempo):
    state = player.start(outside(player.skill), tempo=tempo)
    state = replace(state, tempo_rate=0.1)
    parts = state
    for _ in range(100):
        parts = player.advance(parts, 0.0437)
    once = player.advance(state, 4.37)
    assert (parts.step, parts.remaps) == (once.step, once.remaps)
    assert_allclose(player.motion(parts), player.motion(once), atol=1e-6)


def test_tempo_scales_the_velocity_and_not_the_path(small_skill):
    player = Player(small_skill)
    state = player.advance(player.start(outside(small_skill)), 0.73)
    state = replace(state, offset=np.zeros((2, 2)))
    nominal = player.motion(state)
    quick = player.motion(replace(state, tempo=2.0, tempo_rate=0.5))
    assert_allclose(quick[0], nominal[0])
    assert_allclose(quick[1], 2 * nominal[1])
    assert_allclose(quick[2], 4 * nominal[2] + 0.5 * nominal[1])


def test_offset_decays_where_the_tempo_is_0(small_skill):
    player = Player(small_skill)
    state = player.start(outside(small_skill), tempo=0.0)
    later = player.advance(state, 5.0)
    assert later.step == state.step
    assert later.time_since_tick == 0
    assert_allclose(later.offset, 0, atol=1e-3)
    assert_allclose(player.motion(later)[1:], 0, atol=1e-3)


@pytest.mark.parametrize("tempo", [0.5, 1.0, 1.37])
def test_other_target_and_observation_make_no_jump(player, tempo):
    state = player.advance(player.start(outside(player.skill), tempo=tempo), 0.87)
    before = player.motion(state)[:2]
    target = player.skill.components_[1].mean
    retargeted = player.retarget(state, target)
    assert np.array_equal(retargeted.target, target)
    assert_allclose(player.motion(retargeted)[:2], before, atol=1e-12)
    observed = np.tile([0.04, -0.03], (4, 1))
    assert_allclose(
        player.motion(player.remap(state, observed=observed))[:2], before, atol=1e-12
    )


def test_the_force_at_the_start_does_not_change_the_path():
    t = np.arange(0, 60, 0.05)
    turning = 0.1 * np.column_stack([np.cos(2 * t), np.sin(2 * t)])
    size = 1 + 0.1 * np.sin(0.3 * t)
    recording = Demonstration(
        time=t,
        values=np.column_stack([turning * size[:, None], 20 * size]),
        channels=["x", "y", "force"],
        units=["m", "m", "N"],
    )
    player = Player(FourierMovementPrimitive().fit(recording))
    pressing, free = (player.start([0.1, 0.0, force]) for force in (20.0, 0.0))
    paths = [player.rollout([0.1, 0.0, force], 5.0).position for force in (20.0, 0.0)]
    np.testing.assert_allclose(paths[1][:, :2], paths[0][:, :2], atol=1e-5)
    # The force begins where it was measured, and never exceeds what was shown.
    assert player.motion(pressing)[0, 2] == pytest.approx(20.0)
    assert player.motion(free)[0, 2] == pytest.approx(0.0, abs=1e-9)
    assert np.max(paths[1][:, 2]) < 24.0
