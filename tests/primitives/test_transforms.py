"""Facts about skills in another tempo, place, direction or size."""

import numpy as np
import pytest
from dense_paper import dense
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import SkillError
from fmp_drake.primitives import (
    FourierMovementPrimitive,
    LqrTracker,
    Player,
    load_skill,
    save_skill,
)
from fmp_drake.primitives.editing.transforms import scale_tempo, transform_space
from fmp_drake.primitives.model.movement_primitive import copy_skill

XY = ("x", "y")


def turn(angle):
    """Return the plane rotation by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def moments(skill):
    """Return the mean (T*D,) and covariance of the windows of each component."""
    phi = skill.synthesize(np.eye(skill.components_[0].dim))
    phi = phi.reshape(len(phi), -1).T
    return [(phi @ c.mean, phi @ dense(c) @ phi.T) for c in skill.components_]


def mixed_skill(units=("m", "m", "N"), scales="units", seed=0):
    """Return a skill of 8 steps and three channels (x, y and a force)."""
    rng = np.random.default_rng(seed)
    windows = rng.standard_normal((60, 8, 3)).cumsum(axis=1) * [0.1, 0.1, 10.0]
    skill = FourierMovementPrimitive(
        n_steps=8, overlap=2, n_components=2, scales=scales, regularization=1e-3
    ).fit(windows)
    if scales == "units":
        skill.units_ = units
        skill.channels_ = ("x", "y", "f")
    return skill


# Copies -----------------------------------------------------------------


def test_copies_have_all_parts_and_leave_the_original(small_skill):
    copy = copy_skill(small_skill, parameters={"rate": 7.0}, frame_="table")
    assert copy.rate == 7.0
    assert copy.frame_ == "table"
    assert small_skill.rate == 10.0
    assert small_skill.frame_ == "board"
    assert copy.components_ is small_skill.components_
    names = {name for name in vars(small_skill) if name.endswith("_")}
    assert names <= set(vars(copy))
    assert np.array_equal(copy.sample(2, seed=1), small_skill.sample(2, seed=1))


@pytest.mark.parametrize(
    "use", [lambda s: scale_tempo(s, 2), lambda s: transform_space(s, scale=2)]
)
def test_skills_that_have_learned_nothing_are_refused(use):
    with pytest.raises(NotFittedError):
        use(FourierMovementPrimitive())


# Tempo ------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.5, 2.0, 3.7])
def test_tempo_scales_velocities_and_keeps_positions(small_skill, factor):
    fast = scale_tempo(small_skill, factor)
    # Time constants in seconds are the player's: scaled alike, all is.
    slow_player = Player(
        small_skill, tracker=LqrTracker(time_constant=2, shortest=0.3), blend_time=0.4
    )
    fast_player = Player(
        fast,
        tracker=LqrTracker(time_constant=2 / factor, shortest=0.3 / factor),
        blend_time=0.4 / factor,
    )
    start = small_skill.extent_[1] + 0.02
    slow = slow_player.rollout(start, 9.0)
    quick = fast_player.rollout(start, 9.0 / factor)
    assert_allclose(quick[:, 0], slow[:, 0], atol=1e-9)
    assert_allclose(quick[:, 1], factor * slow[:, 1], atol=1e-8)
    assert_allclose(quick[:, 2], factor**2 * slow[:, 2], atol=1e-7)


def test_tempo_leaves_the_distribution_over_windows(small_skill):
    fast = scale_tempo(small_skill, 2)
    assert np.array_equal(fast.sample(3, seed=1), small_skill.sample(3, seed=1))


@pytest.mark.parametrize("options", [{}, {"window": 1.0}])
def test_another_tempo_has_the_same_samples(options, tmp_path):
    values = np.cumsum(np.random.default_rng(0).standard_normal((400, 2)), axis=0)
    skill = FourierMovementPrimitive(model="mixture", rate=20.0, **options).fit(values)
    for factor in (0.3, 3.0):
        copy = scale_tempo(skill, factor)
        save_skill(copy, tmp_path / "skill.npz")
        for other in (copy, load_skill(tmp_path / "skill.npz")):
            assert (other.n_steps, other.overlap) == (skill.n_steps, skill.overlap)
            assert other.window == pytest.approx(skill.window / factor)


def test_tempo_halves_the_period(small_skill):
    def fastest_frequency(skill):
        # Of the mean, without its offset.
        window = skill.synthesize(skill.components_[0].mean)[:, 0]
        power = np.abs(np.fft.rfft(window - window.mean()))
        return np.fft.rfftfreq(len(window), 1 / skill.rate)[np.argmax(power)]

    assert fastest_frequency(scale_tempo(small_skill, 2)) == pytest.approx(
        2 * fastest_frequency(small_skill)
    )


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_tempo_that_is_not_positive_is_refused(small_skill, factor):
    with pytest.raises(SkillError, match=r"factor is .*; it must be positive"):
        scale_tempo(small_skill, factor)


# Space ------------------------------------------------------------------


@settings(max_examples=25)
@given(
    angle=st.floats(-4, 4),
    scale=st.floats(0.2, 5),
    shift=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
)
def test_transformed_skill_is_the_distribution_of_transformed_windows(
    small_skill, angle, scale, shift
):
    r = turn(angle)
    moved = transform_space(
        small_skill, rotation=r, scale=scale, translation=shift, channels=XY
    )
    windows = small_skill.sample(4, seed=3)
    images = scale * windows @ r.T + shift
    # The density of an image is less by the factor that volumes grow by.
    stretch = windows[0].size * np.log(scale)
    expected = small_skill.score_samples(windows) - stretch
    assert_allclose(moved.score_samples(images), expected, rtol=1e-6, atol=1e-5)
    whole = np.kron(np.eye(small_skill.n_steps), scale * r)
    offset = np.tile(shift, small_skill.n_steps)
    pairs = zip(moments(small_skill), moments(moved), strict=True)
    for (mean, cov), (new_mean, new_cov) in pairs:
        assert_allclose(new_mean, whole @ mean + offset, atol=1e-12)
        assert_allclose(new_cov, whole @ cov @ whole.T, atol=1e-12 * scale**2)


def test_samples_transform_one_by_one(small_skill):
    r, shift = turn(0.7), np.array([0.3, -0.2])
    moved = transform_space(
        small_skill, rotation=r, scale=1.5, translation=shift, channels=XY
    )
    one = small_skill.sample(5, seed=2, with_noise=False)
    two = moved.sample(5, seed=2, with_noise=False)
    assert_allclose(two, 1.5 * one @ r.T + shift, atol=1e-12)


@pytest.mark.parametrize("fixture", ["small_skill", "wiping_skill"])
def test_rotated_skill_plays_the_rotated_rollout(fixture, request):
    skill = request.getfixturevalue(fixture)
    d = skill.n_channels_
    r = turn(0.9)
    if d == 3:
        r = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    shift = np.linspace(0.1, -0.3, d)
    moved = transform_space(
        skill, rotation=r, scale=0.8, translation=shift, channels=skill.channels_
    )
    start = skill.extent_[1] + 0.03
    before = Player(skill).rollout(start, 20.0)
    after = Player(moved).rollout(0.8 * r @ start + shift, 20.0)
    assert_allclose(after[:, 0], 0.8 * before[:, 0] @ r.T + shift, atol=1e-7)
    assert_allclose(after[:, 1:], 0.8 * before[:, 1:] @ r.T, atol=1e-5)


def test_extent_holds_the_transformed_demonstrations(
    wiping_skill, wiping_demonstration
):
    r = Rotation.from_rotvec([0.2, 0.4, 1.1])
    moved = transform_space(wiping_skill, rotation=r, translation=[1.0, 0.0, 0.0])
    images = r.apply(wiping_demonstration.resample(20).values)
    images[:, 0] += 1.0
    assert np.all(moved.extent_[0] <= images.min(axis=0) + 1e-12)
    assert np.all(moved.extent_[1] >= images.max(axis=0) - 1e-12)


def test_there_and_back_is_the_skill_itself(wiping_skill):
    r = Rotation.from_rotvec([0.2, 0.4, 1.1])
    there = transform_space(wiping_skill, rotation=r, scale=3.0, translation=[1, 2, 3])
    back = transform_space(
        there,
        rotation=r.inv(),
        scale=1 / 3,
        translation=-r.inv().apply([1, 2, 3]) / 3,
    )
    assert_allclose(back.scales_, wiping_skill.scales_, rtol=1e-12)
    for one, two in zip(back.components_, wiping_skill.components_, strict=True):
        assert_allclose(one.mean, two.mean, atol=1e-12)
        assert_allclose(one.basis, two.basis, atol=1e-12)


def test_transform_leaves_the_skill_alone(small_skill):
    before = [small_skill.scales_.copy(), small_skill.components_[0].mean.copy()]
    moved = transform_space(
        small_skill, rotation=turn(1), scale=2.0, channels=XY, frame="table"
    )
    assert (moved.frame_, small_skill.frame_) == ("table", "board")
    assert np.array_equal(small_skill.scales_, before[0])
    assert np.array_equal(small_skill.components_[0].mean, before[1])


def test_other_channels_stay(tmp_path):
    skill = mixed_skill()
    moved = transform_space(
        skill, rotation=turn(0.4), scale=2.0, translation=[1, 1], channels=XY
    )
    one = skill.sample(3, seed=0, with_noise=False)
    two = moved.sample(3, seed=0, with_noise=False)
    assert_allclose(two[..., 2], one[..., 2], atol=1e-12)
    assert_allclose(two[..., :2], 2 * one[..., :2] @ turn(0.4).T + 1, atol=1e-12)
    # And the scale survives a file.
    save_skill(moved, tmp_path / "s.npz")
    again = load_skill(tmp_path / "s.npz").sample(3, seed=0, with_noise=False)
    assert np.array_equal(again, two)


def test_quarter_turn_of_channels_of_different_scales_is_exact():
    skill = mixed_skill(scales=[1.0, 3.0, 1.0])
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    moved = transform_space(skill, rotation=quarter, channels=XY)
    assert_allclose(moved.scales_, [3.0, 1.0, 1.0])
    windows = skill.sample(3, seed=0)
    images = windows.copy()
    images[..., :2] = windows[..., :2] @ quarter.T
    assert_allclose(
        moved.score_samples(images), skill.score_samples(windows), rtol=1e-9
    )


def test_rotation_over_different_scales_is_refused():
    skill = mixed_skill(scales=[1.0, 3.0, 1.0])
    with pytest.raises(SkillError, match=r"mixes the channels x, y .* scales 1, 3"):
        transform_space(skill, rotation=turn(0.3), channels=XY)


def test_rotation_over_different_units_is_refused():
    with pytest.raises(SkillError, match=r"mixes the channels x, f .* units m, N"):
        transform_space(mixed_skill(), rotation=turn(0.3), channels=("x", "f"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"channels": ("x", "y", "z")}, "no channel 'z'"),
        ({"channels": ("x", "x")}, "empty or repeat"),
        ({"channels": ()}, "empty or repeat"),
        ({"scale": 0.0}, r"scale is 0\.0; it must be positive"),
        ({"scale": np.nan}, "scale is nan"),
        ({"translation": [1.0]}, "translation"),
        ({"translation": [1.0, np.inf]}, "translation"),
        ({"rotation": np.eye(3)}, r"shape \(3, 3\); expected \(2, 2\)"),
        ({"rotation": Rotation.identity()}, r"shape \(3, 3\)"),
        ({"rotation": np.diag([1.0, -1.0])}, "determinant is -1"),
        ({"rotation": 1.1 * np.eye(2)}, "off the identity by 0.21"),
        ({"rotation": np.full((2, 2), np.nan)}, "NaN or infinite"),
    ],
)
def test_invalid_transforms_are_refused(small_skill, options, message):
    with pytest.raises(SkillError, match=message):
        transform_space(small_skill, **{"channels": XY, **options})
