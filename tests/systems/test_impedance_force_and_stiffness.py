"""Facts about the force loop, the varying stiffness, its tank, and the targets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from fmp_drake.systems.impedance.algebra import (
    Pose,
    TaskTarget,
    blended,
    motion_in_world,
    rotation_from_quaternion,
    rotation_from_vector,
)
from fmp_drake.systems.impedance.force_control import (
    ForceControlConfig,
    ForceState,
    NormalForceDemand,
    approach_factor,
    correct_normal_force,
    engagement,
    with_force,
)
from fmp_drake.systems.impedance.records import values_of
from fmp_drake.systems.impedance.stiffness import (
    CovarianceStiffnessConfig,
    EnergyTankConfig,
    admit_stiffness,
    is_covariance,
    is_positive_definite,
    refill,
    stiffness_from_covariance,
)

FORCE = ForceControlConfig()
SOFT = CovarianceStiffnessConfig()
K = np.diag([30.0, 30, 3, 1500, 1500, 200])
seeds = st.integers(0, 2**32 - 1)


def pushed(measured, *, desired=10.0, steps=1, state=None, **others):
    """Feed the same measured force, or none, for some milliseconds."""
    state = ForceState() if state is None else state
    press = NormalForceDemand(
        desired=desired,
        measured=np.nan if measured is None else measured,
        searching=desired > 0,
        away=False,
        height=0.0,
        stiffness=200.0,
        saturated=False,
    )._replace(**others)
    for _ in range(steps):
        result = correct_normal_force(values_of(FORCE), state, press, 0.001)
        state = result.state
    return result


# The normal force.


def test_a_force_that_is_too_small_is_increased():
    once, later = pushed(8.0), pushed(8.0, steps=100)
    assert once.closed
    assert once.correction == FORCE.proportional_gain * 2
    assert later.state.surface < once.state.surface < 0


def test_surface_is_searched_within_its_range_and_left_at_once():
    result = pushed(1.0, steps=10000)
    assert result.limited
    assert result.state.surface == -FORCE.search_range
    assert pushed(12.0, state=result.state).state.surface > -FORCE.search_range


@pytest.mark.parametrize("measured", [5.0, None])
@pytest.mark.parametrize("why", ["saturated", "away"])
def test_the_surface_stands_still_for_limited_torque_and_a_far_target(measured, why):
    state = ForceState(0.002, 0.0, 0.0)
    found = pushed(measured, state=state, height=-0.01, **{why: True})
    assert found.state.surface == 0.002


def test_found_surface_is_reset_without_a_desired_force():
    for measured in (6.0, 14.0):
        held = pushed(measured, steps=100)
        assert abs(held.state.surface) > 1e-3
        lifted = pushed(0.0, searching=False, steps=1500, state=held.state)
        assert lifted.lost
        assert not lifted.closed
        assert (lifted.correction, lifted.state.surface) == (0.0, 0.0)
        result = pushed(measured, desired=0.0, steps=1500, state=held.state)
        assert not result.lost
        assert (result.correction, result.state.surface) == (0.0, 0.0)


def test_pushing_is_never_turned_into_pulling():
    assert pushed(100.0, desired=3.0, steps=1000).correction == -3.0


def test_the_surface_follows_a_tool_that_sinks_soon_and_one_that_is_lifted_slowly():
    """Without a sensor: a person may lift the tool, but nobody pushes it through."""
    state = ForceState(0.0, 10.0, 0.0)
    low, high = (pushed(None, height=z, steps=200, state=state) for z in (-0.01, 0.01))
    assert low.state.surface == pytest.approx(-0.01, rel=0.03)
    assert 0 < high.state.surface < 0.2 * FORCE.search_speed
    far = pushed(None, height=0.05, steps=200, state=state)
    assert far.state.surface == 0.0


@pytest.mark.parametrize(
    ("force", "height", "lost"),
    [(10.0, 0.0, False), (1.0, 0.0, True), (30.0, 0.02, True), (10.0, 0.009, False)],
)
def test_without_a_sensor_contact_follows_from_force_and_height(force, height, lost):
    """Also where nothing is measured; a person who lifts the tool is no surface."""
    state = ForceState(0.0, force, 0.0)
    assert pushed(None, height=height, steps=100, state=state).lost == lost


def test_the_force_of_the_law_is_low_pass_filtered():
    state = ForceState()
    for _ in range(50):
        state = with_force(values_of(FORCE), state, 10.0, 0.001)
    assert state.force == pytest.approx(10 * (1 - np.exp(-1)), rel=0.02)


def test_the_approach_is_slow_near_the_surface_and_quick_far_from_it():
    def factor(height, speed):
        return approach_factor(values_of(FORCE), 0.005, height, speed)

    slow = FORCE.search_speed
    assert factor(0.005, slow) == factor(-0.01, slow) == 1
    assert factor(0.005, 1.5 * slow) == pytest.approx(0.5)
    assert factor(0.005, 3 * slow) == 0
    assert factor(0.035, 3 * slow) == 1
    assert factor(0.3, 0.5) == 2


def test_desired_force_increases_as_a_smooth_step():
    heights = np.linspace(-0.01, 0.02, 3001)
    part = np.array([engagement(z, 0.01) for z in heights])
    assert_array_equal(part[heights <= 0], 1.0)
    assert_array_equal(part[heights >= 0.01], 0.0)
    assert np.all(np.diff(part) <= 0)
    assert engagement(0.005, 0.01) == pytest.approx(0.5)
    # A cubic step: steepest in the middle, flat at both ends, no kink.
    derivative = np.gradient(part, heights)
    assert np.min(derivative) == pytest.approx(-150, rel=1e-3)
    assert np.max(np.abs(np.diff(derivative))) < 2


# Stiffness of a covariance.


@given(seeds, st.floats(1e-12, 10))
def test_the_stiffness_of_any_covariance_is_bounded(seed, size):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, rng.integers(1, 4)))
    config = CovarianceStiffnessConfig(axes=[True] * 3)
    found = stiffness_from_covariance(values_of(config), size * A @ A.T, K)
    values = np.linalg.eigvalsh(found[3:, 3:])
    assert values[0] >= config.min_stiffness * (1 - 1e-9)
    assert values[-1] <= config.max_stiffness * (1 + 1e-9)
    assert_array_equal(found[:3], K[:3])


def test_it_is_stiff_where_the_demonstrations_agree():
    R = Rotation.from_rotvec([0, 0, 0.7]).as_matrix()
    covariance = R @ np.diag([1e-8, 1.0, 1.0]) @ R.T
    found = stiffness_from_covariance(values_of(SOFT), covariance, K)
    along, across = R[:, 0], R[:, 1]
    assert along @ found[3:, 3:] @ along == pytest.approx(1500, rel=1e-3)
    assert across @ found[3:, 3:] @ across == pytest.approx(300, rel=1e-2)
    middle = stiffness_from_covariance(
        values_of(SOFT), SOFT.deviation**2 * np.eye(3), K
    )
    assert middle[3, 3] == pytest.approx(900)


def test_between_its_bounds_it_is_proportional_to_the_precision():
    config = CovarianceStiffnessConfig(
        min_stiffness=1e-6, max_stiffness=1e6, deviation=1e-3, axes=[True] * 3
    )
    covariance = np.diag([0.02, 0.03, 0.05]) ** 2
    found = stiffness_from_covariance(values_of(config), covariance, K)[3:, 3:]
    assert_allclose(found @ covariance, np.eye(3), rtol=0.01, atol=1e-9)


def test_the_normal_keeps_its_own_stiffness_by_default():
    covariance = 1e-4 * (np.eye(3) + 0.5 * np.ones((3, 3)))
    found = stiffness_from_covariance(values_of(SOFT), covariance, K)
    assert_array_equal(found[5], K[5])
    assert_array_equal(found[:, 5], K[:, 5])
    assert found[3, 4] != 0


def test_invalid_covariance_or_stiffness_is_reported():
    assert is_covariance(np.zeros((3, 3)))
    assert is_covariance(np.diag([1.0, 0.0, 1e-9]))
    assert not is_covariance(np.diag([1.0, -0.1, 1.0]))
    assert not is_covariance(np.eye(3) + np.eye(3, k=1))
    assert is_positive_definite(K)
    assert not is_positive_definite(np.diag([1.0, 1, 1, 1, 1, 0]))
    assert not is_positive_definite(-K)
    assert not is_positive_definite(K + np.eye(6, k=1))
    assert not is_positive_definite(np.full((6, 6), np.nan))


# The tank.


def test_a_stiffer_spring_that_is_not_stretched_is_free():
    found, energy, held = admit_stiffness(K, 2 * K, np.zeros(6), 0.0)
    assert_array_equal(found, 2 * K)
    assert (energy, held) == (0.0, False)


@given(seeds, st.floats(0, 10))
def test_tank_supplies_the_energy_of_a_stiffer_spring(seed, energy):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(6, 6))
    desired = A @ A.T + np.eye(6)
    e = rng.normal(size=6)
    found, left, held = admit_stiffness(np.eye(6), desired, e, energy)
    gained = 0.5 * e @ (found - np.eye(6)) @ e
    assert 0 <= left <= energy
    assert gained <= energy - left + 1e-9
    assert held == (0.5 * e @ (desired - np.eye(6)) @ e > energy)
    assert np.linalg.eigvalsh(found)[0] > 0


def test_a_softer_spring_fills_nothing():
    _, energy, _ = admit_stiffness(K, 0.5 * K, np.ones(6), 0.3)
    assert energy == 0.3


def test_the_tank_stores_a_part_of_the_dissipation_up_to_its_capacity():
    config = values_of(EnergyTankConfig(capacity=1.0, stored_fraction=0.5))
    assert refill(config, 0.2, 0.4) == pytest.approx(0.4)
    assert refill(config, 0.9, 0.4) == 1.0


# Targets.


def random_target(seed, scale=0.3):
    rng = np.random.default_rng(seed)
    return TaskTarget(
        Pose(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)),
        scale * rng.normal(size=6),
        scale * rng.normal(size=6),
    )


@given(seeds, st.floats(1e-3, 1e3))
def test_a_quaternion_of_any_length_and_sign_is_a_rotation(seed, size):
    wxyz = np.random.default_rng(seed).normal(size=4)
    expected = Rotation.from_quat(wxyz[[1, 2, 3, 0]]).as_matrix()
    for sign in (1, -1):
        assert_allclose(
            rotation_from_quaternion(sign * size * wxyz), expected, atol=1e-12
        )


def test_a_quaternion_of_length_zero_gives_nan():
    assert np.isnan(rotation_from_quaternion(np.zeros(4))).any()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, np.pi, 4.0])
def test_the_exponential_of_a_rotation_vector(angle):
    phi = angle * np.array([0.6, -0.8, 0.0])
    assert_allclose(
        rotation_from_vector(phi), Rotation.from_rotvec(phi).as_matrix(), atol=1e-12
    )


def test_a_blend_goes_from_the_pose_to_the_target():
    pose, target = random_target(2).X, random_target(3)
    start = blended(target, pose, 0.0, 0.0)
    assert_allclose(start.X.R, pose.R)
    assert_allclose(start.X.p, pose.p)
    assert_array_equal(start.V, 0.0)
    end = blended(target, pose, 1.0, 0.0)
    for found, expected in zip(
        (*end.X, *end[1:]), (*target.X, *target[1:]), strict=True
    ):
        assert_allclose(found, expected, atol=1e-9)


def test_a_motion_in_a_moving_frame_is_that_of_its_positions():
    """Compare with finite differences of poses in the world."""
    w, u = np.array([0.0, 0.0, 0.8]), np.array([0.1, 0.2, -0.3])
    alpha, g = np.array([0.0, 0.0, 0.6]), np.array([0.5, -0.4, 0.2])
    w_rel, v, a = np.array([0.2, 0.1, -0.4]), np.array([0.5, -0.2, 0.1]), np.ones(3)
    p0 = np.array([0.3, 0.2, -0.1])

    def frame(t):
        return Rotation.from_rotvec(w * t + 0.5 * alpha * t * t).as_matrix()

    def position(t):
        return u * t + 0.5 * g * t * t + frame(t) @ (p0 + v * t + 0.5 * a * t * t)

    def orientation(t):
        return frame(t) @ Rotation.from_rotvec(w_rel * t).as_matrix()

    h = 1e-4
    found = motion_in_world(
        TaskTarget(Pose(np.eye(3), p0), np.r_[w_rel, v], np.r_[np.zeros(3), a]),
        np.r_[w, u],
        np.r_[alpha, g],
    )
    assert_allclose(found.V[3:], (position(h) - position(-h)) / (2 * h), atol=1e-6)
    assert_allclose(
        found.A[3:], (position(h) - 2 * position(0) + position(-h)) / h**2, atol=1e-5
    )

    def spin(t):
        turn = orientation(t + h) @ orientation(t - h).T
        return Rotation.from_matrix(turn).as_rotvec() / (2 * h)

    assert_allclose(found.V[:3], spin(0), atol=1e-6)
    assert_allclose(found.A[:3], (spin(0.01) - spin(-0.01)) / 0.02, atol=1e-3)
