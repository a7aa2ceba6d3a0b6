"""Facts about random inputs: a finite result, or an error that names the reason."""

import json
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import FmpError
from fmp_drake.primitives import (
    Demonstration,
    ExponentialTracker,
    FourierMovementPrimitive,
    Keypoint,
    LqrTracker,
    Player,
    ProportionalTracker,
    load_skill,
    save_skill,
)

pytestmark = pytest.mark.slow

many = settings(
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

# Numbers of every kind: ordinary ones most of the time.
ordinary = st.floats(-10, 10)
odd = st.sampled_from(
    [0.0, -0.0, 1e-300, 1e-12, 1e12, 1e200, -1e308, np.nan, np.inf, -np.inf]
)
numbers = st.one_of(ordinary, ordinary, ordinary, odd)
no_numbers = st.sampled_from(
    [None, "seven", "", [], {}, object(), 1j, [[1.0], [2.0, 3.0]], ["a"], 10**400, True]
)
small = st.integers(-2, 12)


def arrays(*shape, elements=numbers):
    size = int(np.prod(shape))
    return st.lists(elements, min_size=size, max_size=size).map(
        lambda values: np.array(values, dtype=float).reshape(shape)
    )


@st.composite
def odd_shapes(draw):
    shape = draw(st.lists(st.integers(0, 4), max_size=3))
    return draw(arrays(*shape))


def outcome(use):
    """Return the result, or None after an error that says something."""
    # NumPy's warnings are errors in these tests: they are about NaN and overflow.
    try:
        return use()
    except FmpError as error:
        text = str(error)
        assert len(text) > 20, text
        assert text.endswith("."), text
        return None


def assert_finite(*results):
    for result in results:
        assert np.all(np.isfinite(result))


def assert_skill_is_finite(skill):
    assert_finite(skill.proportions_, skill.extent_, skill.scales_)
    for c in skill.components_:
        assert_finite(c.mean, c.basis, c.variances, c.noise)
    assert_finite(skill.sample(2), skill.covariance(0, 1.5))


# Demonstrations -----------------------------------------------------------------


@st.composite
def times(draw):
    count = draw(st.integers(0, 60))
    time = np.arange(count) / draw(st.sampled_from([20.0, 5.0, 100.0, 1e-3]))
    for _ in range(draw(st.integers(0, 2)) if count else 0):
        time[draw(st.integers(0, count - 1))] = draw(numbers)
    return time


@st.composite
def recordings(draw):
    """Return arguments of a demonstration: a good one, most of the time."""
    time = draw(st.one_of(times(), times(), no_numbers, odd_shapes()))
    count = len(time) if isinstance(time, np.ndarray) and time.ndim else 10
    d = draw(st.integers(0, 3))
    values = np.sin(np.arange(count * d).reshape(count, d) * draw(st.floats(-2, 2)))
    values *= 10.0 ** draw(st.sampled_from([0, 0, 0, -200, -9, 6, 60, 200]))
    for _ in range(draw(st.integers(0, 2)) if values.size else 0):
        values.flat[draw(st.integers(0, values.size - 1))] = draw(numbers)
    values = draw(st.sampled_from([values, values, values, values[:-1], "nothing"]))
    names = draw(
        st.sampled_from([(), (), (), ("x",), ("a", "b"), ("a", "a"), 7, None, "xyz"])
    )
    return {"time": time, "values": values, "channels": names}


@many
@given(recordings(), st.one_of(st.sampled_from([20.0, 7.0, 50.0]), numbers, no_numbers))
def test_any_recording_is_refused_or_resampled_to_finite_values(recording, rate):
    demonstration = outcome(lambda: Demonstration(**recording))
    if demonstration is None:
        return
    assert_finite(demonstration.time, demonstration.values)
    if demonstration.duration < 1e4:
        resampled = outcome(lambda: demonstration.resample(rate))
        if resampled is not None:
            assert_finite(resampled.values)
            assert resampled.is_uniform(rate)


@many
@given(recordings())
def test_any_recording_is_refused_or_learned(recording):
    demonstration = outcome(lambda: Demonstration(**recording))
    if demonstration is None or demonstration.duration > 1e4:
        return
    skill = FourierMovementPrimitive(
        n_steps=8, overlap=2, stride=3, n_components=2, shrinkage=1.0
    )
    if outcome(lambda: skill.fit(demonstration)) is not None:
        assert_skill_is_finite(skill)
        assert_finite(skill.score(demonstration))
        player = outcome(lambda: Player(skill))
        if player is not None:
            assert_finite(player.rollout(skill.extent_[1], 3.0))


# Learning -----------------------------------------------------------------------

parameters = st.fixed_dictionaries(
    {},
    optional={
        "n_steps": st.one_of(st.integers(6, 12), no_numbers, numbers),
        "stride": st.one_of(small, no_numbers, numbers),
        "rate": st.one_of(numbers, no_numbers),
        "n_components": st.one_of(small, st.just("automatic"), no_numbers, numbers),
        "overlap": st.one_of(small, no_numbers, numbers),
        "explained_variance": st.one_of(st.floats(0, 1.1), numbers, no_numbers),
        "regularization": st.one_of(st.floats(0, 1), numbers, no_numbers),
        "shrinkage": st.one_of(st.floats(0, 9), numbers, no_numbers),
        "scales": st.one_of(st.just("units"), arrays(2), arrays(3), no_numbers),
        "tolerance": st.one_of(st.floats(0, 1), numbers, no_numbers),
        "random_state": st.one_of(small, no_numbers, numbers),
    },
)


def windows(count=12, t=8, d=2, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((count, t, d)) * 0.1


@many
@given(parameters)
def test_any_parameters_are_refused_or_learned_with(options):
    options = {"n_steps": 8, "overlap": 2, "n_components": 2, **options}
    skill = FourierMovementPrimitive(**options)
    x = windows(t=8)
    if outcome(lambda: skill.fit(x)) is None:
        return
    assert_skill_is_finite(skill)
    assert_finite(skill.score_samples(x))
    motion = outcome(lambda: Player(skill).rollout([0.05, 0.02], 2.0 / skill.rate))
    if motion is not None:
        assert_finite(motion)


@st.composite
def sets_of_windows(draw):
    x = windows(
        draw(st.integers(0, 9)), draw(st.integers(7, 9)), draw(st.integers(0, 3))
    )
    x *= 10.0 ** draw(st.sampled_from([0, 0, 0, -200, -9, 9, 90, 200]))
    kind = draw(st.sampled_from(["as is", "repeated", "constant", "spoilt"]))
    if kind == "repeated" and len(x):
        x[:] = x[:1]
    if kind == "constant":
        x[..., :1] = draw(ordinary)
    if kind == "spoilt" and x.size:
        x.flat[draw(st.integers(0, x.size - 1))] = draw(numbers)
    return x


@many
@given(
    st.one_of(sets_of_windows(), sets_of_windows(), no_numbers, odd_shapes()),
    st.one_of(st.none(), arrays(5), no_numbers, st.just("ones")),
    st.sampled_from([1, 2, 8, "automatic"]),
)
def test_any_windows_are_refused_or_learned(x, weights, n_components):
    if isinstance(weights, str) and weights == "ones":
        weights = np.ones(len(x)) if isinstance(x, np.ndarray) and x.ndim else None
    skill = FourierMovementPrimitive(
        n_steps=8, overlap=2, n_components=n_components, shrinkage=1.0
    )
    if outcome(lambda: skill.fit(x, weights=weights)) is not None:
        assert_skill_is_finite(skill)
        assert_finite(skill.score_samples(x))


# Observing ----------------------------------------------------------------------

steps = st.one_of(
    st.floats(0, 23),
    st.integers(0, 23),
    st.lists(st.floats(0, 23), min_size=1, max_size=4),
    numbers,
    odd_shapes(),
    no_numbers,
)
channels = st.one_of(
    st.none(),
    st.sampled_from([["x"], ["y", "x"], [0], [1, "x"], "y"]),
    st.sampled_from(
        [[], ["z"], [2], [-1], [0, 0], ["x", 0], "xy", 0, 1.0, [0.5], [None]]
    ),
    no_numbers,
)
derivatives = st.one_of(st.integers(0, 2), st.sampled_from([-1, 3, 7, 1.5]), no_numbers)
tolerances = st.one_of(
    st.none(), st.floats(1e-9, 1), numbers, arrays(2), odd_shapes(), no_numbers
)


@many
@given(st.data())
def test_any_observation_is_refused_or_mapped(small_skill, data):
    options = {
        "channels": data.draw(channels),
        "derivative": data.draw(derivatives),
        "tolerance": data.draw(tolerances),
    }
    at = data.draw(steps)
    plan = outcome(lambda: small_skill.mapping_plan(at, **options))
    if plan is None:
        return
    y = data.draw(st.one_of(arrays(plan.size), arrays(plan.size), odd_shapes()))
    mapping = outcome(lambda: plan.map(y))
    if mapping is not None:
        assert_finite(mapping.weights, mapping.costs)


keypoints = st.builds(
    Keypoint,
    step=st.one_of(st.floats(0, 23), numbers, no_numbers),
    values=st.one_of(arrays(2), arrays(1), numbers, odd_shapes(), no_numbers),
    channels=channels,
    derivative=derivatives,
    tolerance=tolerances,
)


@many
@given(
    st.one_of(
        st.lists(keypoints, max_size=4),
        st.lists(keypoints, max_size=4),
        no_numbers,
        st.just([3.0]),
        keypoints,
    )
)
def test_any_keypoints_are_refused_or_mapped(small_skill, points):
    mapping = outcome(lambda: small_skill.map_keypoints(points))
    if mapping is not None:
        assert_finite(mapping.weights, mapping.costs)


@many
@given(
    st.one_of(arrays(3, 2), arrays(24, 2, elements=ordinary), odd_shapes(), no_numbers),
    st.one_of(st.integers(-2, 25), numbers, no_numbers),
)
def test_any_partial_trajectory_is_refused_or_mapped(small_skill, y, first_step):
    mapping = outcome(lambda: small_skill.map_partial(y, first_step=first_step))
    if mapping is not None:
        assert_finite(mapping.weights)


@many
@given(
    st.one_of(st.integers(-3, 4), no_numbers, numbers),
    st.one_of(st.floats(0, 23), numbers, no_numbers),
)
def test_any_covariance_is_refused_or_positive(small_skill, component, step):
    covariance = outcome(lambda: small_skill.covariance(component, step))
    if covariance is not None:
        assert_finite(covariance)
        assert np.all(np.linalg.eigvalsh(covariance) > 0)


@many
@given(st.one_of(arrays(2, 24, 2), odd_shapes(), no_numbers))
def test_any_windows_are_refused_or_scored(small_skill, x):
    score = outcome(lambda: small_skill.score_samples(x))
    if score is not None:
        assert_finite(score)


@many
@given(st.one_of(small, numbers, no_numbers), st.one_of(small, numbers, no_numbers))
def test_any_number_of_samples_is_refused_or_drawn(small_skill, n, seed):
    samples = outcome(lambda: small_skill.sample(n, seed=seed))
    if samples is not None:
        assert_finite(samples)


# Playing ------------------------------------------------------------------------

trackers = st.one_of(
    st.none(),
    st.tuples(
        st.sampled_from([LqrTracker, ProportionalTracker, ExponentialTracker]),
        st.one_of(st.floats(1e-12, 1e-3), numbers, no_numbers),
    ),
)


def tracker_of(drawn):
    if drawn is None:
        return None
    kind, value = drawn
    if kind is LqrTracker:
        return LqrTracker(time_constant=value)
    return kind(beta=value)


@many
@given(st.data())
def test_any_playback_is_refused_or_finite(small_skill, data):
    rule = data.draw(trackers)
    options = data.draw(
        st.fixed_dictionaries(
            {},
            optional={
                "sample": st.booleans(),
                "seed": st.one_of(small, no_numbers, numbers),
                "blend_time": st.one_of(st.floats(0.01, 2), numbers, no_numbers),
                "start_tolerance": st.one_of(st.floats(0, 2), numbers, no_numbers),
                "confidence": st.one_of(st.floats(0, 1.1), numbers, no_numbers),
                "target": st.one_of(
                    st.none(), arrays(48, elements=ordinary), arrays(48), no_numbers
                ),
            },
        )
    )
    start = data.draw(
        st.one_of(arrays(2), arrays(2), arrays(3, 2), odd_shapes(), no_numbers)
    )
    duration = data.draw(
        st.one_of(
            st.floats(0, 6), numbers.filter(lambda x: not 60 < x < 1e300), no_numbers
        )
    )
    player = outcome(lambda: Player(small_skill, tracker=tracker_of(rule), **options))
    if player is None:
        return
    motion = outcome(lambda: player.rollout(start, duration))
    if motion is not None:
        assert_finite(motion)
    state = outcome(lambda: player.start(start))
    if state is not None:
        assert_finite(player.motion(player.advance(state, player.tick_seconds + 0.03)))


# Files --------------------------------------------------------------------------


class SkillFile(NamedTuple):
    """A good one."""

    content: bytes
    arrays: dict

    def __repr__(self):
        return "SkillFile"


@pytest.fixture(scope="module")
def saved(small_skill, tmp_path_factory):
    """A good skill file."""
    path = tmp_path_factory.mktemp("skills") / "s.npz"
    save_skill(small_skill, path)
    with np.load(path) as file:
        return SkillFile(path.read_bytes(), {name: file[name] for name in file.files})


def assert_loads_or_refuses(path):
    skill = outcome(lambda: load_skill(path))
    if skill is not None:
        assert_skill_is_finite(skill)
        player = outcome(lambda: Player(skill))
        if player is not None:
            start = np.zeros(skill.n_channels_)
            assert_finite(player.rollout(start, 3 / skill.rate))


@many
@given(changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255))))
def test_file_of_any_bytes_is_refused_or_plays(saved, tmp_path, changes):
    broken = bytearray(saved.content)
    for at, byte in changes:
        broken[at % len(broken)] = byte
    path = tmp_path / "s.npz"
    path.write_bytes(bytes(broken))
    assert_loads_or_refuses(path)


metadata_values = st.one_of(
    small,
    numbers,
    st.sampled_from([None, "seven", [], {}, True, ["a"], [1, 2], 10**30]),
)


@many
@given(
    which=st.integers(0, 20),
    change=st.sampled_from(["spoil", "reshape", "remove", "reword", "shorten"]),
    at=st.integers(0, 10**4),
    number=numbers,
    other=odd_shapes(),
)
def test_skill_file_of_any_arrays_is_refused_or_plays(
    saved, tmp_path, which, change, at, number, other
):
    arrays_now = dict(saved.arrays)
    name = sorted(arrays_now)[which % len(arrays_now)]
    array = np.array(arrays_now[name])
    if change == "remove":
        del arrays_now[name]
    elif change == "reword":
        arrays_now[name] = np.array("something else")
    elif change == "reshape":
        arrays_now[name] = other
    elif change == "shorten":
        arrays_now[name] = array[..., :-1] if array.ndim else array
    elif array.dtype.kind in "fi":
        array = array.astype(float)
        array.flat[at % array.size] = number
        arrays_now[name] = array
    path = tmp_path / "s.npz"
    np.savez(path, **arrays_now)
    assert_loads_or_refuses(path)


@many
@given(which=st.integers(0, 30), parameter=st.booleans(), value=metadata_values)
def test_skill_file_of_any_metadata_is_refused_or_plays(
    saved, tmp_path, which, parameter, value
):
    metadata = json.loads(str(saved.arrays["metadata"]))
    where = metadata["parameters"] if parameter else metadata
    where[sorted(where)[which % len(where)]] = value
    path = tmp_path / "s.npz"
    np.savez(path, **{**saved.arrays, "metadata": np.array(json.dumps(metadata))})
    assert_loads_or_refuses(path)


# Before fit -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "use",
    [
        lambda s: s.mapping_plan([0]),
        lambda s: s.map_keypoints([Keypoint(step=0, values=[0.0, 0.0])]),
        lambda s: s.covariance(0, 1.0),
        lambda s: s.analyze(np.zeros((8, 2))),
        lambda s: s.synthesize(np.zeros(16)),
        Player,
    ],
)
def test_use_before_fit_is_refused_as_scikit_learn_does(use):
    with pytest.raises(NotFittedError):
        use(FourierMovementPrimitive(n_steps=8))
