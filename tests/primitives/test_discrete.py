"""Facts about discrete movements."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import DemonstrationError, SkillError
from fmp_drake.primitives import Demonstration, add_orientation, skill_rotations
from fmp_drake.primitives.discrete.discrete_movement_primitive import (
    DiscreteMovementPrimitive,
    ViaPoint,
)


def reach(start, goal, bow, duration, rate=50.0):
    """Return a minimum-jerk reach with a bow, as a demonstration of three channels."""
    time = np.linspace(0, duration, round(duration * rate) + 1)
    s = time / duration
    along = 10 * s**3 - 15 * s**4 + 6 * s**5
    values = start + np.outer(along, np.subtract(goal, start))
    values[:, 2] += bow * np.sin(np.pi * along) ** 2
    return Demonstration(time=time, values=values, frame="board")


def reaches(count=12, seed=0):
    rng = np.random.default_rng(seed)
    return [
        reach(
            0.05 * rng.standard_normal(3),
            [0.4, 0.1, 0.0] + 0.05 * rng.standard_normal(3),
            0.1 + 0.02 * rng.standard_normal(),
            rng.uniform(1.0, 2.0),
        )
        for _ in range(count)
    ]


@pytest.fixture(scope="module")
def demonstrations():
    return reaches()


@pytest.fixture(scope="module")
def primitive(demonstrations):
    return DiscreteMovementPrimitive(n_steps=60).fit(demonstrations)


# Learning ---------------------------------------------------------------


def test_fit_describes_the_demonstrations(primitive, demonstrations):
    assert primitive.n_channels_ == 3
    assert primitive.channels_ == ("x", "y", "z")
    assert primitive.units_ == ("m", "m", "m")
    assert primitive.frame_ == "board"
    assert primitive.rotation_reference_ is None
    mean = np.mean([d.duration for d in demonstrations])
    assert primitive.duration_ == pytest.approx(mean)
    assert primitive.skill_.n_steps == 120
    assert primitive.skill_.n_windows_ == 12
    assert primitive.skill_.n_steps / primitive.skill_.rate == pytest.approx(2 * mean)


def test_windows_are_mirrored(primitive):
    for component in primitive.skill_.components_:
        vectors = np.vstack([component.mean, component.basis.T])
        windows = primitive.skill_.synthesize(vectors)
        assert_allclose(windows, windows[:, ::-1], atol=1e-9)


def test_mirrored_window_has_no_sine_about_its_mirror(primitive):
    # The sines of the series about the start of the movement, half a sample before.
    window = primitive.skill_.synthesize(primitive.skill_.components_[0].mean)
    spectrum = np.fft.rfft(window, axis=0)
    k = np.arange(len(spectrum))[:, None]
    about_start = spectrum * np.exp(-1j * np.pi * k / 120)
    assert_allclose(about_start.imag, 0, atol=1e-9)


def test_movements_of_one_shape_and_many_durations_are_learned_as_one():
    slow_and_fast = [
        reach([0, 0, 0], [0.4, 0.1, 0], 0.1, duration) for duration in (1, 1.7, 3.2)
    ]
    primitive = DiscreteMovementPrimitive(n_steps=50).fit(slow_and_fast)
    drawn = primitive.sample(4, with_noise=False)
    assert drawn.shape == (4, 50, 3)
    s = (np.arange(50) + 0.5) / 50
    along = 10 * s**3 - 15 * s**4 + 6 * s**5
    assert_allclose(drawn[:, :, 0], np.tile(0.4 * along, (4, 1)), atol=2e-4)


def test_rest_before_and_after_a_movement_is_left_out(demonstrations, primitive):
    rng = np.random.default_rng(1)

    def resting(movement):
        before, after = rng.integers(0, 120, 2)
        values = np.pad(movement.values, ((before, after), (0, 0)), mode="edge")
        values = values + 2e-4 * rng.standard_normal(values.shape)
        return Demonstration(time=np.arange(len(values)) / 50, values=values)

    learned = DiscreteMovementPrimitive(n_steps=60)
    learned.fit([resting(movement) for movement in demonstrations])
    assert_allclose(learned.duration_, primitive.duration_, rtol=0.03)
    start, goal = np.zeros(3), np.array([0.4, 0.1, 0.0])
    one, other = (p.rollout(start, goal, duration=1.5) for p in (learned, primitive))
    assert_allclose(one.position, other.position, atol=0.01)  # 0.1 m with the rest.


def test_a_recording_without_a_movement_is_kept():
    still = Demonstration(time=np.arange(40) / 20, values=np.ones((40, 2)))
    learned = DiscreteMovementPrimitive(n_steps=8).fit([still, still])
    assert_allclose(learned.rollout([1.0, 1.0]).position, 1.0)
    assert learned.duration_ == still.duration


def test_samples_are_halves_of_windows(primitive):
    halves = primitive.sample(3, seed=1)
    assert np.array_equal(halves, primitive.skill_.sample(3, seed=1)[:, :60])
    assert np.array_equal(halves, primitive.sample(3, seed=1))


def test_fit_repeats_and_clones(primitive, demonstrations):
    again = clone(primitive).fit(demonstrations)
    start = [0.0, 0.0, 0.0]
    assert np.array_equal(again.rollout(start), primitive.rollout(start))


@pytest.mark.parametrize(
    ("x", "message"),
    [
        ([], "0 demonstrations"),
        ([reach([0, 0, 0], [1, 0, 0], 0, 1)], "got 1 demonstration;"),
        (reach([0, 0, 0], [1, 0, 0], 0, 1), "got 1 demonstration;"),
        (np.zeros((3, 20, 2)), "needs a Demonstration, or a list"),
        (
            [
                reach([0, 0, 0], [1, 0, 0], 0, 1),
                reach([0, 0, 0], [1, 0, 0], 0, 1).select("x"),
            ],
            "must be the same",
        ),
    ],
)
def test_unusable_training_data_are_refused(x, message):
    with pytest.raises(DemonstrationError, match=message):
        DiscreteMovementPrimitive().fit(x)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_steps": 7}, "n_steps is 7"),
        ({"n_steps": 1_000_000}, "n_steps is 1000000; .* at most 10000"),
        ({"confidence": 0.0}, r"confidence is 0\.0"),
        ({"confidence": 1.5}, r"confidence is 1\.5"),
        ({"n_components": 0}, "n_components is 0"),
        ({"tolerance": 0.0}, r"tolerance is 0\.0"),
    ],
)
def test_parameters_out_of_range_are_named(demonstrations, options, message):
    with pytest.raises(SkillError, match=message):
        DiscreteMovementPrimitive(**options).fit(demonstrations)


def test_movements_of_the_most_steps_take_little_memory(demonstrations):
    primitive = DiscreteMovementPrimitive(n_steps=10_000).fit(demonstrations)
    tracemalloc.start()
    primitive.plan([0.0, 0.0, 0.0], [1.0, 0.5, 0.2])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1e8


def test_use_before_fit_is_refused():
    for use in (lambda p: p.plan([0, 0, 0]), lambda p: p.sample()):
        with pytest.raises(NotFittedError):
            use(DiscreteMovementPrimitive())


# Playing ----------------------------------------------------------------

points = st.tuples(*[st.floats(-0.5, 0.5)] * 3)


@given(start=points, goal=points, via=points, phase=st.floats(0.1, 0.9))
def test_start_goal_and_via_point_are_met_at_rest(primitive, start, goal, via, phase):
    duration = 1.3
    movement = primitive.plan(
        start, goal, via=[ViaPoint(phase=phase, values=via)], duration=duration
    )
    first, passed, last = movement.motion([0.0, phase * duration, duration])
    assert_allclose(first[0], start, atol=1e-9)
    assert_allclose(passed[0], via, atol=1e-9)
    assert_allclose(last[0], goal, atol=1e-9)
    assert np.all(first[1] == 0)
    assert_allclose(last[1], 0, atol=1e-11)


def test_movement_without_a_goal_goes_where_the_demonstrations_went(primitive):
    near, far = ([0.0, 0.0, 0.0], [0.03, -0.05, 0.02]), ([-0.3, 0.3, 0.4],)
    for starts, tolerance in ((near, 0.1), (far, 0.2)):
        for start in starts:
            motion = primitive.rollout(start)
            assert_allclose(motion[0, 0], start, atol=1e-9)
            assert_allclose(motion[-1, 0], [0.4, 0.1, 0.0], atol=tolerance)


def test_movement_keeps_the_shape_of_the_demonstrations(primitive):
    motion = primitive.rollout([0.02, 0.0, 0.01], [0.42, 0.12, 0.01])
    assert np.max(motion[:, 0, 2]) == pytest.approx(0.11, abs=0.03)
    assert np.all(motion[:, 0, 0] > -0.02)
    assert np.all(motion[:, 0, 0] < 0.46)


def test_far_start_and_goal_cause_no_overshoot(primitive):
    motion = primitive.rollout([-0.6, 0.0, 0.0], [0.4, 0.9, 0.0])
    assert np.all(motion[:, 0] > [-0.65, -0.1, -0.1])
    assert np.all(motion[:, 0] < [0.5, 1.0, 0.25])


def test_start_and_goal_of_a_demonstration_give_its_movement(demonstrations):
    primitive = DiscreteMovementPrimitive(n_steps=80).fit(demonstrations)
    shown = demonstrations[3]
    motion = primitive.plan(
        shown.values[0], shown.values[-1], duration=shown.duration
    ).motion(shown.time)
    # Start and goal determine it but for the height of the bow.
    assert_allclose(motion[:, 0, :2], shown.values[:, :2], atol=2e-3)
    assert_allclose(motion[:, 0, 2], shown.values[:, 2], atol=0.05)


def test_via_point_may_be_of_one_channel(primitive):
    via = [ViaPoint(phase=0.5, values=0.3, channels=["z"])]
    movement = primitive.plan([0, 0, 0], [0.4, 0.1, 0], via=via)
    half = movement.motion(movement.duration / 2)
    assert half[0, 2] == pytest.approx(0.3)
    without = primitive.plan([0, 0, 0], [0.4, 0.1, 0])
    assert_allclose(half[0, :2], without.motion(without.duration / 2)[0, :2], atol=0.03)


@pytest.mark.parametrize("duration", [None, 0.7, 5.0])
def test_velocity_and_acceleration_are_derivatives(primitive, duration):
    movement = primitive.plan([0.1, 0, 0], [0.5, 0, 0], duration=duration)
    h = 1e-4 * movement.duration
    for t in np.linspace(0.05, 0.95, 7) * movement.duration:
        before, here, after = movement.motion([t - h, t, t + h])
        assert_allclose(here[1], (after[0] - before[0]) / (2 * h), atol=1e-5)
        assert_allclose(here[2], (after[1] - before[1]) / (2 * h), atol=1e-4)


def test_movement_rests_before_and_after(primitive):
    movement = primitive.plan([0.1, 0, 0], [0.5, 0, 0])
    first, last = movement.motion([0.0, movement.duration])
    before, after = movement.motion([-1.0, movement.duration + 1])
    assert_allclose(before[0], first[0])
    assert_allclose(after[0], last[0])
    assert np.all(before[1:] == 0)
    assert np.all(after[1:] == 0)


def test_duration_scales_velocities(primitive):
    one = primitive.rollout([0, 0, 0], duration=1.0, rate=100)
    two = primitive.rollout([0, 0, 0], duration=2.0, rate=50)
    assert_allclose(one[:, 0], two[:, 0], atol=1e-12)
    assert_allclose(one[:, 1], 2 * two[:, 1], atol=1e-10)
    assert_allclose(one[:, 2], 4 * two[:, 2], atol=1e-9)


@pytest.mark.parametrize(("duration", "count"), [(1.0, 101), (0.995, 101), (0.01, 2)])
def test_rollout_ends_with_the_movement(primitive, duration, count):
    motion = primitive.rollout([0, 0, 0], [0.4, 0, 0], duration=duration)
    assert motion.shape == (count, 3, 3)
    assert_allclose(motion[-1, 0], [0.4, 0, 0], atol=1e-9)


def test_motion_is_read_only_and_vectorised(primitive):
    movement = primitive.plan([0, 0, 0])
    times = np.linspace(0, 1, 6).reshape(2, 3)
    assert movement.motion(times).shape == (2, 3, 3, 3)
    assert_allclose(movement.motion(times)[1, 2], movement.motion(times[1, 2]))
    with pytest.raises(ValueError, match="read-only"):
        movement.coefficients[0] = 1


def test_component_is_chosen_by_the_start():
    rng = np.random.default_rng(0)
    two_kinds = [
        reach([0, side, 0], [0.4, side * 2, 0], 0.1 + 0.01 * rng.random(), 1)
        for side in (-0.3, 0.3)
        for _ in range(8)
    ]
    primitive = DiscreteMovementPrimitive(n_components=2).fit(two_kinds)
    left, right = (primitive.plan([0, y, 0]) for y in (-0.25, 0.25))
    assert left.component != right.component
    assert left.motion(1.0)[0, 1] == pytest.approx(-0.6, abs=0.05)
    assert right.motion(1.0)[0, 1] == pytest.approx(0.6, abs=0.05)


def test_channels_of_other_units_are_learned_too():
    def with_force(d, seed):
        push = 20 * np.sin(np.pi * d.time / d.duration) ** 2 + seed
        return Demonstration(
            time=d.time,
            values=np.column_stack([d.values, push]),
            channels=("x", "y", "z", "fz"),
            units=("m", "m", "m", "N"),
        )

    primitive = DiscreteMovementPrimitive().fit(
        [with_force(d, i / 10) for i, d in enumerate(reaches())]
    )
    motion = primitive.rollout([0, 0, 0, 0.5], [0.4, 0.1, 0, 0.5])
    assert np.max(motion[:, 0, 3]) == pytest.approx(20.5, abs=1)
    assert_allclose(motion[-1, 0], [0.4, 0.1, 0, 0.5], atol=1e-9)


def test_orientation_is_learned_with_the_position():
    shown = []
    for i, d in enumerate(reaches()):
        angle = (1.5 + 0.02 * i) * (1 - np.cos(np.pi * d.time / d.duration)) / 2
        quaternions = np.zeros((len(angle), 4))
        quaternions[:, 0], quaternions[:, 1] = np.cos(angle / 2), np.sin(angle / 2)
        shown.append(
            add_orientation(d, quaternions, order="wxyz", reference=[0, 0, 0, 1])
        )
    primitive = DiscreteMovementPrimitive().fit(shown)
    motion = primitive.rollout(np.zeros(6))
    turned = skill_rotations(primitive, motion[:, 0]).as_rotvec()
    assert_allclose(turned[0], 0, atol=1e-9)
    assert_allclose(turned[-1], [1.6, 0, 0], atol=0.15)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": [0, 0]}, r"the start of shape"),
        ({"start": [0, 0, np.nan]}, "numbers in the start"),
        ({"goal": [0, 0, 0, 0]}, "the goal of shape"),
        ({"duration": 0.0}, r"duration is 0\.0 s"),
        ({"duration": np.inf}, "duration is inf"),
        (
            {"via": [ViaPoint(phase=0.0, values=[0, 0, 0])]},
            r"phase of via-point 0 is",
        ),
        (
            {"via": [ViaPoint(phase=1.2, values=[0, 0, 0])]},
            r"the phase of via-point 0 is 1",
        ),
        ({"via": [ViaPoint(phase=0.5, values=[0, 0])]}, "via-point 0 of shape"),
        ({"via": [ViaPoint(phase=0.5, values=1, channels=["w"])]}, "no channel 'w'"),
        (
            {
                "via": [
                    ViaPoint(phase=0.5 + v / 1000, values=[v, 0, 0]) for v in (0.0, 0.1)
                ]
            },
            "same phase or too near",
        ),
        (
            {"via": [ViaPoint(phase=0.5, values=[v, 0, 0]) for v in (0.0, 0.1)]},
            "same phase or too near",
        ),
        ({"via": 0.5}, r"via is 0\.5; give a list of ViaPoint"),
        ({"via": [0.5]}, r"via has 0\.5; give a list of ViaPoint"),
        ({"rate": 0.0}, r"rate is 0\.0 Hz"),
    ],
)
def test_movements_that_cannot_be_made_are_refused(primitive, options, message):
    with pytest.raises(SkillError, match=message):
        primitive.rollout(**{"start": [0, 0, 0], **options})
