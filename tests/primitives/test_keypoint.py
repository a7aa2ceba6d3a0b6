"""Facts about keypoints: where, and how closely, a movement has to pass."""

import numpy as np
import pytest
from dense_paper import dense
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from fmp_drake.errors import SkillError
from fmp_drake.primitives import Keypoint
from fmp_drake.primitives.data.channels import channel_indices

NAMES = ("x", "y", "fz")


def dense_candidates(skill, rows, y, noise):
    """Return every component's posterior mean and (15) / lambda, by dense matrices."""
    means, costs = [], []
    for pi, g in zip(skill.proportions_, skill.components_, strict=True):
        cov = dense(g)
        seen = rows @ cov @ rows.T + np.diag(noise)
        delta = y - rows @ g.mean
        means.append(g.mean + cov @ rows.T @ np.linalg.solve(seen, delta))
        costs.append(delta @ np.linalg.solve(seen, delta) - np.log(pi))
    return means, np.array(costs)


def rows_of(skill, step, channels, derivative):
    """Return the rows that observe some channels at one time, one after the other."""
    one = skill.basis.rows(step, derivative) * skill.rate**derivative
    out = np.zeros((len(channels), skill.n_channels_, skill.n_steps))
    for i, channel in enumerate(channels):
        out[i, channel] = one
    return out.reshape(len(channels), -1)


def assert_mapping_is_dense(skill, mapping, rows, y, noise):
    means, costs = dense_candidates(skill, rows, y, noise)
    assert_allclose(mapping.costs, costs, rtol=1e-5)
    assert mapping.component == int(np.argmin(costs))
    expected = means[mapping.component]
    assert_allclose(mapping.weights, expected, rtol=1e-5, atol=1e-7)


def test_keypoint_between_samples_is_met(small_skill):
    y = small_skill.extent_.mean(axis=0) + np.array([0.02, -0.01])
    point = Keypoint(step=7.3, values=y, tolerance=1e-10)
    mapping = small_skill.map_keypoints([point])
    rows = rows_of(small_skill, 7.3, [0, 1], 0)
    assert_allclose(rows @ mapping.weights, y, atol=1e-4)
    assert_mapping_is_dense(small_skill, mapping, rows, y, np.full(2, 1e-10))


@pytest.mark.parametrize("channels", [["y"], [1], "y", np.array([1])])
def test_keypoint_of_one_channel_leaves_the_other_free(small_skill, channels):
    y = small_skill.extent_[1, 1] - 0.01
    point = Keypoint(step=5, values=[y], channels=channels)
    mapping = small_skill.map_keypoints([point])
    rows = rows_of(small_skill, 5, [1], 0)
    assert_mapping_is_dense(
        small_skill, mapping, rows, np.array([y]), np.array([small_skill.tolerance])
    )
    free = small_skill.synthesize(mapping.weights)[:, 0]
    assert np.ptp(free) > 0.5 * np.ptp(small_skill.extent_[:, 0])


def test_values_are_in_the_order_of_the_channels(small_skill):
    turned = Keypoint(step=5, values=[0.01, 0.03], channels=["y", "x"])
    straight = Keypoint(step=5, values=[0.03, 0.01])
    one, two = (small_skill.map_keypoints([p]) for p in (turned, straight))
    assert_allclose(one.weights, two.weights, atol=1e-9)


def test_one_value_of_one_channel_needs_no_list(small_skill):
    one = small_skill.map_keypoints([Keypoint(step=5, values=0.01, channels="x")])
    two = small_skill.map_keypoints([Keypoint(step=5, values=[0.01], channels=[0])])
    assert np.array_equal(one.weights, two.weights)


@pytest.mark.parametrize("derivative", [1, 2])
def test_velocities_and_accelerations_are_per_second(small_skill, derivative):
    value = 0.1 * 5.0 ** (derivative - 1)
    point = Keypoint(
        step=9.5, values=[value], channels=["x"], derivative=derivative, tolerance=1e-9
    )
    mapping = small_skill.map_keypoints([point])
    h = 1e-3 if derivative == 1 else 1e-2  # samples
    x = [
        (small_skill.observation_rows(9.5 + s * h) @ mapping.weights)[0]
        for s in (-1, 0, 1)
    ]
    seconds = h / small_skill.rate
    found = (x[2] - x[0]) / (2 * seconds)
    if derivative == 2:
        found = (x[0] - 2 * x[1] + x[2]) / seconds**2
    assert found == pytest.approx(value, abs=2e-3 * derivative**3)


def test_several_keypoints_hold_at_once_each_to_its_tolerance(small_skill):
    skill = small_skill
    points = [
        Keypoint(step=2, values=[0.02, 0.0], tolerance=1e-9),
        Keypoint(step=11.5, values=[0.05], channels=["y"], tolerance=[1e-4]),
        Keypoint(step=20, values=[0.1, -0.1], derivative=1, tolerance=[1e-2, 1e-6]),
        Keypoint(step=6, values=[0.0], channels=[0]),
    ]
    rows = np.concatenate(
        [
            rows_of(skill, 2, [0, 1], 0),
            rows_of(skill, 11.5, [1], 0),
            rows_of(skill, 20, [0, 1], 1),
            rows_of(skill, 6, [0], 0),
        ]
    )
    y = np.array([0.02, 0.0, 0.05, 0.1, -0.1, 0.0])
    noise = np.array([1e-9, 1e-9, 1e-4, 1e-2, 1e-6, skill.tolerance])
    assert_mapping_is_dense(skill, skill.map_keypoints(points), rows, y, noise)


def test_order_of_the_keypoints_does_not_matter(small_skill):
    points = [
        Keypoint(step=2, values=[0.02, 0.0], tolerance=1e-6),
        Keypoint(step=11.5, values=[0.05], channels=["y"], tolerance=1e-6),
    ]
    one = small_skill.map_keypoints(points)
    two = small_skill.map_keypoints(points[::-1])
    assert_allclose(one.weights, two.weights, atol=1e-9)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    points=st.lists(
        st.tuples(
            st.floats(0, 23),
            st.sampled_from([[0], [1], [1, 0]]),
            st.integers(0, 2),
            st.floats(-6, -2),
            st.integers(0, 1000),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_any_keypoints_give_the_dense_posterior(small_skill, points):
    skill = small_skill
    given_points, rows, y, noise = [], [], [], []
    for step, channels, derivative, exponent, seed in points:
        values = np.random.default_rng(seed).normal(0, 0.05, len(channels))
        # Derivatives are larger, by the rate of 10 Hz.
        tolerance = 10.0**exponent * 100.0**derivative
        given_points.append(
            Keypoint(
                step=step,
                values=values,
                channels=channels,
                derivative=derivative,
                tolerance=tolerance,
            )
        )
        rows.append(rows_of(skill, step, channels, derivative))
        y.append(values)
        noise.append(np.full(len(channels), tolerance))
    assert_mapping_is_dense(
        skill,
        skill.map_keypoints(given_points),
        np.concatenate(rows),
        np.concatenate(y),
        np.concatenate(noise),
    )


def test_smaller_tolerance_is_met_more_closely(small_skill):
    y = small_skill.extent_[1] + 0.05
    misses = []
    for tolerance in (1e-2, 1e-4, 1e-6, 1e-8):
        mapping = small_skill.map_keypoints(
            [Keypoint(step=12, values=y, tolerance=tolerance)]
        )
        here = small_skill.observation_rows(12) @ mapping.weights
        misses.append(np.linalg.norm(here - y))
    assert np.all(np.diff(misses) < 0)
    assert misses[-1] < 1e-3


def test_keypoints_at_the_start_are_a_partial_trajectory(small_skill):
    y = small_skill.sample(1, seed=5)[0][:4]
    points = [Keypoint(step=i, values=value) for i, value in enumerate(y)]
    one, two = small_skill.map_keypoints(points), small_skill.map_partial(y)
    assert_allclose(one.weights, two.weights, atol=1e-12)
    assert one.component == two.component


def test_plan_observes_channels_and_derivatives_as_keypoints_do(small_skill):
    plan = small_skill.mapping_plan(
        [3, 8.5], channels=["y"], derivative=1, tolerance=[1e-3, 1e-5]
    )
    points = [
        Keypoint(step=3, values=[0.1], channels=["y"], derivative=1, tolerance=1e-3),
        Keypoint(step=8.5, values=[0.2], channels=[1], derivative=1, tolerance=1e-5),
    ]
    one = plan.map([0.1, 0.2])
    two = small_skill.map_keypoints(points)
    assert_allclose(one.weights, two.weights, atol=1e-12)


# Errors -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("point", "message"),
    [
        (Keypoint(step=24, values=[0, 0]), "defined from 0 to 23"),
        (Keypoint(step=-0.5, values=[0, 0]), "defined from 0 to 23"),
        (Keypoint(step=np.nan, values=[0, 0]), "step of a keypoint is nan"),
        (Keypoint(step=[1, 2], values=[0, 0]), r"step of a keypoint is \[1, 2\]"),
        (Keypoint(step=3, values=[0]), "values of the keypoint at step 3 of shape"),
        (Keypoint(step=3, values=[0, np.nan]), "NaN or infinite numbers"),
        (Keypoint(step=3, values="here"), "'here' cannot be read as real numbers"),
        (Keypoint(step=3, values=[0], channels=["z"]), "no channel 'z'.* x, y"),
        (Keypoint(step=3, values=[0], channels=[2]), r"no channel 2.*\(0 to 1\)"),
        (Keypoint(step=3, values=[0], channels=[-1]), "no channel -1"),
        (Keypoint(step=3, values=[0], channels=[0.5]), "no channel 0.5"),
        (Keypoint(step=3, values=[], channels=[]), "are empty or repeat"),
        (Keypoint(step=3, values=[0, 0], channels=[0, "x"]), "are empty or repeat"),
        (Keypoint(step=3, values=[0], channels=0), "give a list of names or indices"),
        (Keypoint(step=3, values=[0, 0], tolerance=0.0), "must be positive"),
        (Keypoint(step=3, values=[0, 0], tolerance=[1, -1]), "must be positive"),
        (
            Keypoint(step=3, values=[0, 0], tolerance=[1, 1, 1]),
            "the tolerance of the keypoint at step 3 of shape",
        ),
        (Keypoint(step=3, values=[0, 0], tolerance="low"), "'low' cannot be read"),
        (
            Keypoint(step=3, values=[0, 0], derivative=5),
            "derivative is 5; .* at most 4",
        ),
        (Keypoint(step=3, values=[0, 0], derivative=-1), "derivative is -1"),
    ],
)
def test_error_of_infeasible_keypoints_gives_the_reason(small_skill, point, message):
    good = Keypoint(step=1, values=[0.0, 0.0])
    with pytest.raises(SkillError, match=message):
        small_skill.map_keypoints([good, point])


@pytest.mark.parametrize("points", [[], ()])
def test_no_keypoint_is_refused(small_skill, points):
    with pytest.raises(SkillError, match="no keypoint; give at least one"):
        small_skill.map_keypoints(points)


@pytest.mark.parametrize("points", [None, 3, [[0.0, 0.0]], "xy"])
def test_invalid_lists_of_keypoints_are_refused(small_skill, points):
    with pytest.raises(SkillError, match="is not a list of Keypoint"):
        small_skill.map_keypoints(points)


def test_same_keypoint_twice_is_met_like_one_of_half_the_tolerance(small_skill):
    point = Keypoint(step=3, values=[0.01, 0.02], tolerance=2e-6)
    half = Keypoint(step=3, values=[0.01, 0.02], tolerance=1e-6)
    one = small_skill.map_keypoints([point, point])
    two = small_skill.map_keypoints([half])
    assert_allclose(one.weights, two.weights, atol=1e-8)


@pytest.mark.parametrize(
    ("given_channels", "expected"),
    [
        (None, [0, 1, 2]),
        (["fz", "x"], [2, 0]),
        ([1, "x"], [1, 0]),
        ("fz", [2]),
        ((np.int64(2),), [2]),
    ],
)
def test_channels_are_found_by_name_or_index(given_channels, expected):
    assert channel_indices(given_channels, NAMES) == expected
