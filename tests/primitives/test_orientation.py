"""Facts about orientations as channels."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError, SkillError, SkillFileError
from fmp_drake.primitives import (
    Demonstration,
    DiscreteMovementPrimitive,
    FourierMovementPrimitive,
    Player,
    add_orientation,
    load_skill,
    save_skill,
)
from fmp_drake.primitives.data.orientation import (
    LARGEST_ANGLE,
    angular_velocity,
    as_rotation,
    mean_rotation,
    rotation_vectors,
    rotations_of,
    skill_rotations,
)
from fmp_drake.primitives.editing.transforms import transform_space

IDENTITY = (0.0, 0.0, 0.0, 1.0)


def about(axis, angles):
    """Return rotations about one axis."""
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return Rotation.from_rotvec(np.multiply.outer(angles, axis))


def swaying(seconds=40.0, rate=50.0, down=True, seed=0):
    """Return a wiping demonstration whose tool sways, and its rotations."""
    time = np.arange(round(seconds * rate)) / rate
    phase = 2 * np.pi * 0.5 * time + 0.1 * np.sin(0.3 * time + seed)
    position = np.column_stack(
        [0.1 * np.cos(phase), 0.2 * np.sin(phase), 0.01 * np.cos(2 * phase)]
    )
    vectors = np.column_stack(
        [0.3 * np.sin(phase), 0.2 * np.cos(phase), 0.5 * np.sin(phase + 1)]
    )
    rotations = Rotation.from_rotvec(vectors)
    if down:
        rotations = rotations * about([1, 0, 0], np.pi)
    return Demonstration(time=time, values=position, frame="board"), rotations


vectors3 = st.tuples(*[st.floats(-1, 1)] * 3)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


# Input ------------------------------------------------------------------


def test_order_of_quaternions_has_to_be_stated():
    with pytest.raises(DemonstrationError, match="order of the quaternions is None"):
        as_rotation([[0, 0, 0, 1]])
    last = as_rotation([[0.1, 0.2, 0.3, 0.9]], order="xyzw")
    first = as_rotation([[0.9, 0.1, 0.2, 0.3]], order="wxyz")
    assert_allclose(last.as_matrix(), first.as_matrix(), atol=1e-12)
    assert as_rotation(last) is last


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.zeros((5, 3)), r"shape \(5, 3\)"),
        (np.zeros((2, 2, 4)), "expected"),
        ([[0, 0, 0, 1], [0, 0, 0, 0]], "quaternion 1 is zero"),
        ([[0, 0, np.nan, 1]], "NaN"),
    ],
)
def test_invalid_quaternions_are_refused(bad, message):
    with pytest.raises(DemonstrationError, match=message):
        as_rotation(bad, order="xyzw")


@given(seed=st.integers(0, 50))
def test_signs_of_quaternions_do_not_matter(seed):
    demonstration, rotations = swaying(2.0)
    rng = np.random.default_rng(seed)
    quaternion = rotations.as_quat()
    flipped = quaternion * rng.choice([-1, 1], (len(quaternion), 1))
    one = add_orientation(demonstration, quaternion, order="xyzw")
    two = add_orientation(demonstration, flipped, order="xyzw")
    assert_allclose(two.values, one.values, atol=1e-9)
    assert_allclose(two.rotation_reference, one.rotation_reference, atol=1e-9)


def test_length_of_quaternions_does_not_matter():
    demonstration, rotations = swaying(2.0)
    quaternion = rotations.as_quat(scalar_first=True)
    one = add_orientation(demonstration, rotations)
    two = add_orientation(demonstration, 1.01 * quaternion, order="wxyz")
    assert_allclose(two.values, one.values, atol=1e-9)


# Rotation vectors -------------------------------------------------------


@given(quaternions, st.lists(vectors3, min_size=2, max_size=6))
def test_rotation_vectors_give_the_rotations_back(reference, steps):
    reference = mean_rotation([list(reference)], order="xyzw")
    path = Rotation.from_rotvec(0.4 * np.cumsum(steps, axis=0))
    vectors = rotation_vectors(path * Rotation.from_quat(reference), reference)
    again = rotations_of(vectors, reference) * Rotation.from_quat(reference).inv()
    assert_allclose((again * path.inv()).magnitude(), 0, atol=1e-9)


def test_rotation_vectors_are_in_the_frame_of_the_demonstration():
    reference = about([1, 0, 0], np.pi)
    turned = about([0, 0, 1], [0.0, 0.3]) * reference  # About the z axis of B.
    vectors = rotation_vectors(turned, tuple(reference.as_quat()))
    assert_allclose(vectors, [[0, 0, 0], [0, 0, 0.3]], atol=1e-12)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, -1, 0], [0.3, -0.5, 0.8]])
@pytest.mark.parametrize("sign", [1, -1])
def test_rotation_vectors_continue_past_180_degrees(axis, sign):
    angles = sign * np.linspace(0, 1.7 * np.pi, 120)
    vectors = rotation_vectors(about(axis, angles), IDENTITY)
    unit = np.asarray(axis) / np.linalg.norm(axis)
    assert_allclose(vectors, np.outer(angles, unit), atol=1e-9)


@given(vectors3.filter(lambda v: np.linalg.norm(v) > 0.1), st.integers(0, 30))
def test_rotation_vectors_do_not_jump_at_180_degrees(axis, seed):
    # A tool that points down sways about orientations half a turn from the identity.
    _, rotations = swaying(3.0, seed=seed)
    vectors = rotation_vectors(about(axis, np.pi) * rotations, IDENTITY)
    steps = np.linalg.norm(np.diff(vectors, axis=0), axis=1)
    turned = (rotations[1:] * rotations[:-1].inv()).magnitude()
    # The rate of phi is at most a / (2 sin(a / 2)) times the angular velocity.
    a = np.linalg.norm(vectors, axis=1).max()
    if a < LARGEST_ANGLE:
        bound = a / 2 / max(np.sin(min(a, 1.9 * np.pi) / 2), 0.1)
        assert np.all(steps < 1.1 * max(bound, 1.0) * turned.max() + 1e-9)


def test_first_sample_is_chosen_near_the_given_rotation():
    almost = about([0, 0, 1], 3.5)  # The short way: 2 pi - 3.5 the other way round.
    short = rotation_vectors(almost, IDENTITY)
    assert_allclose(short, [0, 0, 3.5 - 2 * np.pi])
    near = rotation_vectors(almost, IDENTITY, near=[0, 0, 3.0])
    assert_allclose(near, [0, 0, 3.5])
    assert_allclose(rotation_vectors(about([0, 0, 1], 0.0), IDENTITY), 0, atol=1e-12)


def test_full_turns_are_refused_with_their_place():
    with pytest.raises(
        DemonstrationError, match=r"sample 99 is rotated by 355 degrees"
    ):
        rotation_vectors(about([0, 1, 0], np.linspace(0, 6.2, 100)), IDENTITY)


def test_jumps_are_refused_with_their_place():
    angles = np.array([0.0, 0.1, 0.2, 2.0, 2.1])
    with pytest.raises(
        DemonstrationError, match=r"jumps by 103 degrees after sample 2"
    ):
        rotation_vectors(about([0, 1, 0], angles), IDENTITY)


def test_mean_of_several_recordings_is_that_of_all_samples():
    one, two = about([0, 0, 1], [0.1, 0.2]), about([0, 0, 1], [0.3])
    mean = Rotation.from_quat(mean_rotation(Rotation.concatenate([one, two])))
    assert_allclose(mean.as_rotvec(), [0, 0, 0.2], atol=1e-9)


# Angular velocity -------------------------------------------------------


def path(t, a, b, c):
    return a + b * t + c * t**2


@given(vectors3, vectors3, vectors3, st.sampled_from([1e-6, 0.009, 0.011, 1.0, 3.0]))
def test_angular_velocity_is_the_derivative_of_the_rotation(a, b, c, size):
    a, b, c = size * np.array(a), np.array(b), np.array(c)
    h = 1e-5
    before, after = (Rotation.from_rotvec(path(t, a, b, c)) for t in (-h, h))
    expected = (after * before.inv()).as_rotvec() / (2 * h)
    assert_allclose(angular_velocity(a, b), expected, atol=1e-7)


def test_angular_velocity_is_exact_on_both_sides_of_the_series():
    rate = np.array([0.3, -1.0, 0.5])
    axis = np.array([0.6, 0.0, 0.8])
    below, above = 0.01 * (1 - 1e-12) * axis, 0.01 * (1 + 1e-12) * axis
    assert_allclose(
        angular_velocity(below, rate), angular_velocity(above, rate), rtol=1e-11
    )
    assert_allclose(angular_velocity(np.zeros(3), rate), rate)
    assert_allclose(angular_velocity(1e-200 * axis, rate), rate)


def test_angular_velocity_past_180_degrees_is_that_of_the_rotation():
    # Along the axis they agree; across it the left Jacobian turns.
    axis, across = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    assert_allclose(angular_velocity(4.0 * axis, axis), axis)
    expected = [np.sin(4) / 4, (1 - np.cos(4)) / 4, 0]
    assert_allclose(angular_velocity(4.0 * axis, across), expected)


def test_angular_velocity_integrates_to_the_orientation():
    _, rotations = swaying(2.0, rate=200.0)
    reference = mean_rotation(rotations)
    t = np.linspace(0, 1.5, 40)
    phase = np.pi * t

    def phi(s):
        return np.array([0.3 * np.sin(s), 2.0 * s / np.pi, 0.5 * np.cos(s)])

    def rate(s):
        return np.pi * np.array([0.3 * np.cos(s), 2.0 / np.pi, -0.5 * np.sin(s)])

    def slope(time, matrix):
        x, y, z = angular_velocity(phi(np.pi * time), rate(np.pi * time))
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return (skew @ matrix.reshape(3, 3)).ravel()

    start = rotations_of(phi(0), reference).as_matrix()
    end = solve_ivp(slope, (0, 1.5), start.ravel(), rtol=1e-10, atol=1e-12).y[:, -1]
    expected = rotations_of(phi(phase[-1]), reference).as_matrix()
    assert_allclose(end.reshape(3, 3), expected, atol=1e-8)


def test_angular_velocity_takes_many_at_once():
    rng = np.random.default_rng(0)
    phi, rate = rng.standard_normal((2, 4, 5, 3))
    many = angular_velocity(phi, rate)
    assert many.shape == (4, 5, 3)
    assert_allclose(many[2, 3], angular_velocity(phi[2, 3], rate[2, 3]), rtol=1e-12)
    # Small and large angles side by side.
    mixed = np.stack([np.zeros(3), phi[0, 0]])
    assert_allclose(angular_velocity(mixed, rate[0, :2])[0], rate[0, 0])


# Demonstrations and their files -----------------------------------------


def test_channels_and_units_are_added():
    demonstration, rotations = swaying(2.0)
    posed = add_orientation(demonstration, rotations)
    assert posed.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert posed.units == ("m", "m", "m", "rad", "rad", "rad")
    assert posed.frame == "board"
    assert np.array_equal(posed.values[:, :3], demonstration.values)
    assert_allclose(posed.rotation_reference, mean_rotation(rotations))
    # Around its mean, an orientation is near 0.
    assert np.max(np.abs(posed.values[:, 3:])) < 0.8
    again = rotations_of(posed.values[:, 3:], posed.rotation_reference)
    assert_allclose((again * rotations.inv()).magnitude(), 0, atol=1e-9)


def test_rotations_must_match_the_samples():
    demonstration, rotations = swaying(2.0)
    with pytest.raises(DemonstrationError, match="99 rotations for 100 samples"):
        add_orientation(demonstration, rotations[:-1])
    with pytest.raises(DemonstrationError, match="1 rotations for 100"):
        add_orientation(demonstration, rotations[0])
    posed = add_orientation(demonstration, rotations)
    with pytest.raises(DemonstrationError, match="rotation channels already"):
        add_orientation(posed, rotations)


@pytest.mark.parametrize(
    "reference", [(0, 0, 0), (0, 0, 0, 2), "text", 3, (0, 0, 0, np.nan)]
)
def test_reference_has_to_be_a_unit_quaternion(reference):
    with pytest.raises(DemonstrationError, match="expected a unit quaternion"):
        Demonstration(
            time=np.arange(5),
            values=np.zeros((5, 3)),
            channels=("rx", "ry", "rz"),
            rotation_reference=reference,
        )


def test_reference_that_is_nearly_of_unit_length_becomes_so():
    posed = Demonstration(
        time=np.arange(5),
        values=np.zeros((5, 3)),
        channels=("rx", "ry", "rz"),
        rotation_reference=(0.6 + 3e-8, 0, 0, 0.8 + 4e-8),
    )
    assert posed.rotation_reference == pytest.approx((0.6, 0, 0, 0.8), abs=1e-12)


def test_reference_needs_the_rotation_channels():
    with pytest.raises(DemonstrationError, match="no channel rx"):
        Demonstration(
            time=np.arange(5), values=np.zeros((5, 3)), rotation_reference=IDENTITY
        )


def test_reference_is_kept_when_channels_are_chosen_or_resampled():
    posed = add_orientation(*swaying(2.0))
    reference = posed.rotation_reference
    assert posed.resample(20).rotation_reference == reference
    assert posed.select(["rx", "ry", "rz"]).rotation_reference == reference
    assert posed.select(["x", "rx", "ry"]).rotation_reference is None
    assert posed.select(["x", "y", "z"]).rotation_reference is None


def test_reference_survives_the_file_exactly(tmp_path):
    posed = add_orientation(*swaying(2.0))
    posed.save(tmp_path / "d.npz")
    loaded = Demonstration.load(tmp_path / "d.npz")
    assert loaded.rotation_reference == posed.rotation_reference
    assert np.array_equal(loaded.values, posed.values)
    with pytest.raises(SkillFileError, match=r"no place for the reference .* \.npz"):
        posed.save(tmp_path / "d.csv")


@pytest.mark.parametrize("reference", ["text", [1, 2, 3, 4], 5])
def test_broken_reference_in_a_file_names_the_file(tmp_path, reference):
    path = tmp_path / "d.npz"
    add_orientation(*swaying(2.0)).save(path)
    with np.load(path) as file:
        content = dict(file)
    metadata = json.loads(str(content["metadata"]))
    metadata["rotation_reference"] = reference
    np.savez(path, **{**content, "metadata": np.array(json.dumps(metadata))})
    with pytest.raises(DemonstrationError, match=r"d\.npz: rotation_reference is"):
        Demonstration.load(path)


# Skills -----------------------------------------------------------------


@pytest.fixture(scope="module")
def posed_skill():
    """A skill of position and orientation, T = 40, D = 6, 10 Hz."""
    posed = add_orientation(*swaying(40.0))
    return FourierMovementPrimitive(
        n_steps=40, rate=10.0, overlap=5, n_components=10, stride=1
    ).fit(posed)


def test_skill_has_the_reference_of_its_demonstrations(posed_skill, small_skill):
    expected = add_orientation(*swaying(40.0)).rotation_reference
    assert posed_skill.rotation_reference_ == expected
    assert small_skill.rotation_reference_ is None
    with pytest.raises(SkillError, match="no orientation"):
        skill_rotations(small_skill, np.zeros(2))
    motion = Player(posed_skill).rollout(posed_skill.extent_.mean(axis=0), 1.0)
    assert len(skill_rotations(posed_skill, motion.position)) == len(motion.position)
    for wrong in (motion, np.zeros(3)):
        with pytest.raises(SkillError, match=r"expected \(6,\) or \(N, 6\)"):
            skill_rotations(posed_skill, wrong)


@pytest.mark.parametrize("skill", [FourierMovementPrimitive, DiscreteMovementPrimitive])
def test_demonstrations_of_different_references_are_learned_with_the_first(skill):
    demonstration, rotations = swaying(10.0)
    first, other = (
        add_orientation(demonstration, rotations, reference=about([1, 0, 0], angle))
        for angle in (0.0, 0.4)
    )
    learned, same = skill().fit([first, other]), skill().fit([first, first])
    assert learned.rotation_reference_ == first.rotation_reference
    extents = [getattr(s, "skill_", s).extent_ for s in (learned, same)]
    assert_allclose(*extents, rtol=0, atol=1e-5)
    with pytest.raises(DemonstrationError, match="rotation reference none"):
        skill().fit([first, replace(other, rotation_reference=None)])


def test_a_recording_of_another_reference_is_scored_alike(posed_skill):
    first, other = (
        add_orientation(*swaying(40.0), reference=reference)
        for reference in (None, about([1, 0, 0], 0.4))
    )
    assert first.rotation_reference != other.rotation_reference
    expected = posed_skill.score(first)
    assert posed_skill.score(other) == pytest.approx(expected, abs=1e-3)
    with pytest.raises(DemonstrationError, match="rotation reference none"):
        posed_skill.score(replace(other, rotation_reference=None))


def test_skill_file_keeps_the_reference(tmp_path, posed_skill):
    save_skill(posed_skill, tmp_path / "s.npz")
    loaded = load_skill(tmp_path / "s.npz")
    assert loaded.rotation_reference_ == posed_skill.rotation_reference_


def test_orientation_is_played_with_the_position(posed_skill):
    demonstration, rotations = swaying(40.0)
    motion = Player(posed_skill).rollout(posed_skill.extent_.mean(axis=0), 20.0)[100:]
    played = skill_rotations(posed_skill, motion[:, 0])
    # Every pose of the playback is near to one of the demonstration.
    for i in range(0, len(motion), 7):
        gap = np.linalg.norm(demonstration.values - motion[i, 0, :3], axis=1)
        turned = (rotations * played[i].inv()).magnitude()
        assert np.min(gap + 0.1 * turned) < 0.005


def test_transform_rotates_the_orientation_too(posed_skill):
    r = Rotation.from_rotvec([0.4, -0.2, 1.3])
    moved = transform_space(posed_skill, rotation=r, translation=[1, 0, 0])
    start = posed_skill.extent_.mean(axis=0) + 0.05
    shift = np.array([1.0, 0.0, 0.0])
    image = np.concatenate([r.apply(start[:3]) + shift, r.apply(start[3:])])
    before = Player(posed_skill).rollout(start, 12.0)[:, 0]
    after = Player(moved).rollout(image, 12.0)[:, 0]
    assert_allclose(after[:, :3], r.apply(before[:, :3]) + shift, atol=1e-7)
    expected = r * skill_rotations(posed_skill, before)
    error = skill_rotations(moved, after) * expected.inv()
    assert_allclose(error.magnitude(), 0, atol=1e-6)
    still = transform_space(posed_skill, rotation=r, rotate_orientation=False)
    assert still.rotation_reference_ == posed_skill.rotation_reference_


def test_transform_of_a_plane_does_not_rotate_an_orientation(posed_skill):
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    with pytest.raises(SkillError, match="does not rotate; name three channels"):
        transform_space(posed_skill, rotation=quarter, channels=("x", "y"))
    with pytest.raises(SkillError, match="rotated along with a position"):
        transform_space(
            posed_skill, rotation=Rotation.identity(), channels=("rx", "ry", "rz")
        )


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_real_recordings_are_learned_and_played(real_demonstration_paths, order):
    recordings = []
    for name, file in real_demonstration_paths.items():
        if "increase_z" in name:
            with np.load(file) as arrays:
                recordings.append(
                    (arrays["time"], arrays["position"], arrays["quaternion"])
                )
    assert len(recordings) == 4
    quaternions = np.concatenate([quaternion for *_, quaternion in recordings])
    reference = mean_rotation(quaternions, order=order)
    posed = [
        add_orientation(
            Demonstration(time=time, values=position),
            quaternion,
            order=order,
            reference=reference,
        )
        for time, position, quaternion in recordings
    ]
    # Half a turn from the identity, where plain rotation vectors jump.
    plain = as_rotation(recordings[0][2], order=order).as_rotvec()
    assert np.max(np.abs(np.diff(plain, axis=0))) > 3
    for demonstration in posed:
        assert np.max(np.abs(np.diff(demonstration.values[:, 3:], axis=0))) < 0.02
        assert np.max(np.abs(demonstration.values[:, 3:])) < 0.15
    skill = FourierMovementPrimitive(
        n_steps=40, overlap=5, stride=2, n_components=5
    ).fit(posed)
    motion = Player(skill).rollout(skill.extent_.mean(axis=0), 20.0)
    turned = skill_rotations(skill, motion[:, 0]) * Rotation.from_quat(reference).inv()
    assert np.max(turned.magnitude()) < 0.2
    omega = angular_velocity(motion[:, 0, 3:], motion[:, 1, 3:])
    assert np.max(np.abs(omega)) < 0.5
