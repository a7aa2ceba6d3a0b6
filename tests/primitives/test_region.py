"""Facts about the region that demonstrations have shown."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SkillError, SkillFileError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    load_skill,
    modulate_skill,
    save_skill,
    scale_tempo,
    transform_space,
)
from fmp_drake.primitives.model.region import DemonstratedRegion

MARGIN = 0.02


def wandering(samples, seed, units=("m", "m", "m")):
    """Return a demonstration at 20 Hz."""
    steps = np.random.default_rng(seed).normal(scale=0.01, size=(samples, len(units)))
    time = np.arange(samples) / 20
    return Demonstration(time=time, values=np.cumsum(steps, axis=0), units=units)


def learned(*demonstrations, **options):
    options = {"n_steps": 20, "overlap": 5, "n_components": 2, "stride": 5} | options
    weights = options.pop("weights", None)
    return FourierMovementPrimitive(**options).fit(
        list(demonstrations), weights=weights
    )


@pytest.fixture(scope="module")
def skill():
    return learned(wandering(60, 1), wandering(45, 2))


def distance_to_segments(paths, points):
    """Return the exact distance of points (N, D) to the nearest segment of paths."""
    nearest = np.full(len(points), np.inf)
    for path in paths:
        for a, b in pairwise(path):
            t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            along = np.linalg.norm(points - a - t[:, None] * (b - a), axis=1)
            nearest = np.minimum(nearest, along)
    return nearest


def test_distance_is_that_to_the_paths_and_not_to_their_samples(skill):
    points = np.random.default_rng(0).uniform(-0.15, 0.15, size=(400, 3))
    exact = distance_to_segments(skill.paths_, points)
    distance = DemonstratedRegion(skill, MARGIN).distance(points)
    assert np.all(distance >= exact - 1e-12)
    far = exact > MARGIN / 2
    assert_allclose(distance[far], exact[far], rtol=0.01)
    near = np.abs(exact - MARGIN) < MARGIN / 4
    assert np.any(near)
    assert_allclose(distance[near], exact[near], rtol=0.004)


def test_distance_has_the_shape_of_the_points(skill):
    region = DemonstratedRegion(skill, MARGIN)
    points = np.zeros((2, 5, 3))
    assert region.distance(points).shape == (2, 5)
    assert_array_equal(region.distance(points), region.distance(points[0, 0]))


def test_only_channels_in_metres_count():
    demonstration = wandering(60, 1, units=("m", "N", "m"))
    region = DemonstratedRegion(learned(demonstration), MARGIN)
    here = demonstration.values[30]
    assert region.distance(here + np.array([0, 9, 0])) < 1e-6
    assert region.distance(here + np.array([0.5, 0, 0])) > 0.2
    forces = learned(wandering(60, 1, units=("N",)))
    with pytest.raises(SkillError, match=r"no demonstrated paths in m .*N"):
        DemonstratedRegion(forces, MARGIN)


def test_range_of_other_channels_does_not_grow_with_rotations():
    units = ("m", "m", "m", "rad", "rad", "rad")
    skill = rotated = learned(wandering(60, 1, units), scales=np.ones(6))
    for _ in range(8):
        rotated = transform_space(
            rotated,
            rotation=Rotation.from_rotvec([0, 0, np.pi / 4]),
            channels=skill.channels_[3:],
        )
    outside = skill.paths_[0][:1] + np.array([0, 0, 0, 5.0, 0, 0])
    ratios = [
        DemonstratedRegion(s, MARGIN).largest_ratio(outside) for s in (skill, rotated)
    ]
    assert ratios[0] > 2
    assert_allclose(ratios[1], ratios[0], rtol=1e-6)


@pytest.mark.parametrize("margin", [0, -0.1, np.nan, "wide"])
def test_margin_out_of_range_is_refused(skill, margin):
    with pytest.raises(
        SkillError, match=r"margin is .*must be positive \(or 'automatic', or None"
    ):
        DemonstratedRegion(skill, margin)


def test_movement_is_shrunk_into_the_region_as_little_as_needed():
    time = np.arange(100) / 20
    line = np.column_stack([0.1 * np.sin(3 * time), 0 * time])
    region = DemonstratedRegion(learned(Demonstration(time=time, values=line)), MARGIN)
    steady = line[:20]
    sideways = np.zeros((4, 20, 2))
    sideways[:, 5:, 1] = np.array([0.019, 0.025, -0.05, 0.5])[:, None]
    fractions = region.largest_fractions(steady, sideways)
    assert_array_equal(fractions, [1, 0.75, 0.375, 0])
    # Hardly farther than without the deviation, where that is outside.
    away = steady + np.array([0, 0.05])
    fractions = region.largest_fractions(away, sideways)
    assert_array_equal(fractions, [0.25, 0.125, 1, 0])


# The paths of a skill -----------------------------------------------------------------


def test_skill_holds_the_demonstrations_it_was_learned_from(skill):
    first, second = skill.paths_
    assert_array_equal(first, wandering(60, 1).values)
    assert_array_equal(second, wandering(45, 2).values)
    # What lies after the last window has not been learned.
    assert len(learned(wandering(63, 1), wandering(45, 2)).paths_[0]) == 60
    apart = learned(wandering(90, 1), stride=30).paths_
    assert [len(path) for path in apart] == [20, 20, 20]


def test_demonstration_without_weight_is_not_held():
    both = wandering(60, 1), wandering(45, 2)
    (path,) = learned(*both, weights=[0, 1]).paths_
    assert_array_equal(path, both[1].values)


def test_skill_learned_from_windows_has_no_paths():
    windows = np.random.default_rng(0).normal(size=(30, 20, 2))
    skill = FourierMovementPrimitive(n_steps=20, overlap=5).fit(windows)
    assert skill.paths_ == ()
    with pytest.raises(SkillError, match=r"margin is 0.02 m, but .* learn it again"):
        DemonstratedRegion(skill, MARGIN)


def test_paths_go_with_a_transformed_skill(skill):
    rotation = Rotation.from_euler("z", 0.4)
    moved = transform_space(
        skill, rotation=rotation, scale=1.5, translation=[1.0, 0.0, 0.2]
    )
    for before, after in zip(skill.paths_, moved.paths_, strict=True):
        assert_allclose(after, 1.5 * rotation.apply(before) + [1.0, 0.0, 0.2])
    assert scale_tempo(skill, 2.0).paths_ is skill.paths_
    assert modulate_skill(skill, harmonics=[1], gain=2.0).paths_ == ()


def test_paths_are_saved_with_the_skill(tmp_path, skill):
    for each in (skill, modulate_skill(skill, harmonics=[1], gain=2.0)):
        save_skill(each, tmp_path / "skill.npz")
        loaded = load_skill(tmp_path / "skill.npz")
        assert len(loaded.paths_) == len(each.paths_)
        for one, two in zip(loaded.paths_, each.paths_, strict=True):
            assert_array_equal(one, two)


def rewritten(path, skill, drop=(), **arrays):
    save_skill(skill, path)
    with np.load(path) as file:
        content = {name: file[name] for name in file.files if name not in drop}
    np.savez(path, **{**content, **arrays})
    return path


def test_file_of_an_earlier_version_has_no_paths(tmp_path, skill):
    path = rewritten(tmp_path / "s.npz", skill, drop=("paths", "path_lengths"))
    assert load_skill(path).paths_ == ()


@pytest.mark.parametrize(
    "arrays",
    [
        {"path_lengths": np.array([60, 44])},
        {"path_lengths": np.array([105, 0])},
        {"path_lengths": np.array([110, -5])},
        {"path_lengths": np.array([60.0, 45.0])},
        {"path_lengths": np.array([[60], [45]])},
        {"paths": np.zeros((105, 2))},
        {"paths": np.full((105, 3), np.nan)},
        {"paths": np.zeros(105)},
    ],
)
def test_file_with_broken_paths_is_refused(tmp_path, skill, arrays):
    path = rewritten(tmp_path / "s.npz", skill, **arrays)
    with pytest.raises(SkillFileError, match=r"incomplete skill file: .*path"):
        load_skill(path)
