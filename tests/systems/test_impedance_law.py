"""Facts about the impedance law as a function of arrays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SystemsError
from fmp_drake.systems.impedance.algebra import (
    Pose,
    eigen,
    rotation_vector,
    rotation_vectors,
    task_error,
)
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.force_control import ForceControlConfig
from fmp_drake.systems.impedance.joints import (
    JointWallConfig,
    rate_scale,
    torque_scale,
)
from fmp_drake.systems.impedance.law import (
    ArmDynamics,
    impedance_law,
    length_clipped,
    mobility,
    spring_wrench,
    task_modes,
)
from fmp_drake.systems.impedance.records import values_of
from fmp_drake.systems.impedance.stiffness import (
    CovarianceStiffnessConfig,
    EnergyTankConfig,
)
from fmp_drake.systems.impedance.supervision import WatchdogConfig

seeds = st.integers(min_value=0, max_value=2**32 - 1)


def random_spd(rng: np.random.Generator, size: int) -> np.ndarray:
    A = rng.normal(size=(size, size))
    return A @ A.T + 0.1 * np.eye(size)


def random_config(rng: np.random.Generator) -> ImpedanceConfig:
    return ImpedanceConfig(
        damping_ratio=rng.uniform(0.2, 1.5),
        posture_frequency=rng.uniform(0, 10),
        posture_damping_ratio=rng.uniform(0.2, 1.5),
        max_rotation_error=10.0,
        max_translation_error=10.0,
        max_posture_error=100.0,
        max_effective_mass=1e12,
    )


def random_stiffness(rng: np.random.Generator) -> np.ndarray:
    return 100 * random_spd(rng, 6)


def random_arm(rng: np.random.Generator, n: int) -> ArmDynamics:
    return ArmDynamics(
        v=rng.normal(size=n),
        M=random_spd(rng, n),
        Cv=rng.normal(size=n),
        J=rng.normal(size=(6, n)),
        Jdot_v=rng.normal(size=6),
    )


def dense_torque(config, arm, K, e, V_d, A_d, F, posture_error):
    """The law as printed, with inverses and the generalized eigenproblem."""
    v, M, Cv, J, Jdot_v = arm
    Lambda = np.linalg.inv(J @ np.linalg.inv(M) @ J.T)
    squared, Q = eigh(K, Lambda)  # Qᵀ Λ Q = I, Qᵀ K Q = diag(ω²)
    Q_inv = np.linalg.inv(Q)
    D = Q_inv.T @ np.diag(2 * config.damping_ratio * np.sqrt(squared)) @ Q_inv
    spring = K @ e
    theta = np.linalg.norm(e[:3])
    x, y, z = e[:3]
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    left = (
        np.eye(3)
        + (1 - np.cos(theta)) / theta**2 * hat
        + (theta - np.sin(theta)) / theta**3 * hat @ hat
    )
    spring[:3] = np.linalg.inv(left) @ spring[:3]
    omega = config.posture_frequency
    tau_posture = M @ (
        omega**2 * posture_error - 2 * config.posture_damping_ratio * omega * v
    )
    N_T = np.eye(v.size) - J.T @ Lambda @ J @ np.linalg.inv(M)
    wrench = Lambda @ (A_d - Jdot_v) + spring + D @ (V_d - J @ v) + F
    return J.T @ wrench + Cv + N_T @ tau_posture


@pytest.mark.parametrize("law", [impedance_law, impedance_law.py_func])
@given(seed=seeds, n=st.sampled_from([6, 7, 9]))
def test_the_torque_equals_a_dense_transcription_of_the_law(law, seed, n):
    rng = np.random.default_rng(seed)
    config, K, arm = random_config(rng), random_stiffness(rng), random_arm(rng, n)
    e, V_d, A_d, F = 0.5 * rng.normal(size=(4, 6))
    posture_error = rng.normal(size=n)
    torque = law(values_of(config), arm, K, e, V_d, A_d, F, posture_error).torque
    expected = dense_torque(config, arm, K, e, V_d, A_d, F, posture_error)
    scale = np.abs(expected).max() + 1
    np.testing.assert_allclose(torque / scale, expected / scale, atol=1e-7)


def test_inputs_are_left_as_they_were():
    rng = np.random.default_rng(1)
    arm, K = random_arm(rng, 7), random_stiffness(rng)
    arguments = [K, *rng.normal(size=(4, 6)), rng.normal(size=7)]
    before = [array.copy() for array in (*arm, *arguments)]
    impedance_law(values_of(random_config(rng)), arm, *arguments)
    for array, old in zip((*arm, *arguments), before, strict=True):
        np.testing.assert_array_equal(array, old)


def test_invalid_mass_matrix_gives_no_torque():
    rng = np.random.default_rng(1)
    arm = random_arm(rng, 7)._replace(M=-np.eye(7))
    arguments = [random_stiffness(rng), *np.zeros((4, 6)), np.zeros(7)]
    law = impedance_law(values_of(ImpedanceConfig()), arm, *arguments)
    assert np.isnan(law.torque).all()


@given(seeds, st.floats(min_value=0, max_value=np.pi))
def test_the_rotation_vector_inverts_the_exponential(seed, angle):
    axis = np.random.default_rng(seed).normal(size=3)
    phi = angle * axis / np.linalg.norm(axis)
    R = Rotation.from_rotvec(phi).as_matrix()
    found = rotation_vector(R)
    np.testing.assert_allclose(np.linalg.norm(found), angle, atol=1e-7)
    np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), R, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), np.full(3, 3**-0.5)])
def test_the_rotation_vector_is_accurate_at_its_ends(angle, axis):
    found = rotation_vector(Rotation.from_rotvec(angle * axis).as_matrix())
    sign = np.sign(found @ axis) if angle > 3 else 1.0
    np.testing.assert_allclose(sign * found, angle * axis, rtol=1e-9, atol=1e-15)


def test_the_rotation_vectors_of_several_rotations_are_those_of_each():
    R = Rotation.random(50, random_state=np.random.default_rng(4)).as_matrix()
    vectors = rotation_vectors(R)
    assert vectors.shape == (50, 3)
    np.testing.assert_array_equal(vectors, [rotation_vector(each) for each in R])


def test_error_transforms_the_measured_pose_to_the_desired_one():
    rng = np.random.default_rng(2)
    R, R_d = Rotation.random(2, random_state=rng).as_matrix()
    p, p_d = rng.normal(size=(2, 3))
    e = task_error(Pose(R, p), Pose(R_d, p_d))
    rotated = Rotation.from_rotvec(e[:3]).as_matrix() @ R
    np.testing.assert_allclose(rotated, R_d, atol=1e-12)
    np.testing.assert_allclose(p + e[3:], p_d)


def unclipped(K, error):
    return spring_wrench(K, error, 10.0, 10.0)[0]


@given(seeds, st.floats(min_value=1e-6, max_value=3.1))
def test_the_spring_gives_back_its_energy(seed, angle):
    """Power on E is the loss of ½ eᵀ K e, for any twist and any error."""
    rng = np.random.default_rng(seed)
    K = random_stiffness(rng)
    axis = rng.normal(size=3)
    R = Rotation.random(random_state=rng).as_matrix()
    rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    p, p_d, twist_w, twist_v = rng.normal(size=(4, 3))

    def error(t):
        return task_error(
            Pose(Rotation.from_rotvec(t * twist_w).as_matrix() @ R, p + t * twist_v),
            Pose(rotation @ R, p_d),
        )

    def energy(t):
        return 0.5 * error(t) @ K @ error(t)

    h = 1e-6
    loss = (energy(-h) - energy(h)) / (2 * h)
    power = unclipped(K, error(0.0)) @ np.r_[twist_w, twist_v]
    assert power == pytest.approx(loss, rel=1e-4, abs=1e-3)


def test_small_displacement_meets_exactly_the_stiffness():
    K = random_stiffness(np.random.default_rng(3))
    e = 1e-7 * np.arange(1, 7)
    np.testing.assert_allclose(unclipped(K, e), K @ e, rtol=1e-6, atol=1e-9)


def test_the_rotational_spring_is_at_full_strength_at_the_antipode():
    K = ImpedanceConfig().stiffness()
    for axis in np.eye(3):
        torque = unclipped(K, np.r_[np.pi * axis, 0, 0, 0])[:3]
        k = axis @ K[:3, :3] @ axis
        np.testing.assert_allclose(torque, np.pi * k * axis, atol=1e-12)


def test_a_large_error_is_shortened_in_its_direction():
    K = 100 * np.eye(6)
    wrench, clipped = spring_wrench(K, np.array([0, 0, 0, 3.0, 0, -4.0]), 0.5, 0.1)
    assert clipped
    np.testing.assert_allclose(wrench[3:], [6.0, 0.0, -8.0])
    np.testing.assert_array_equal(length_clipped(np.array([0.3, 0.4]), 0.6), [0.3, 0.4])


def modes_of(M, J, K, max_effective_mass=1e12, characteristic_length=0.3):
    return task_modes(mobility(M, J), K, max_effective_mass, characteristic_length)


@given(seeds)
def test_double_diagonalization_reproduces_inertia_and_stiffness(seed):
    rng = np.random.default_rng(seed)
    M, J, K = random_spd(rng, 7), rng.normal(size=(6, 7)), random_spd(rng, 6)
    B, omega, bounded = modes_of(M, J, K)
    inverse_inertia = J @ np.linalg.solve(M, J.T)
    np.testing.assert_allclose(mobility(M, J), inverse_inertia, atol=1e-7)
    np.testing.assert_allclose(B @ B.T @ inverse_inertia, np.eye(6), atol=1e-6)
    np.testing.assert_allclose(B * omega**2 @ B.T, K, atol=1e-6 * np.abs(K).max())
    assert not bounded


@pytest.mark.parametrize("function", [eigen, eigen.py_func])
@given(seeds, st.integers(min_value=1, max_value=7), st.integers(0, 12))
def test_eigenvectors_diagonalize_a_symmetric_matrix(function, seed, size, decades):
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(size, size)))
    # Also with equal eigenvalues, negative ones and zero.
    exact = np.sort(
        np.round(rng.normal(size=size), 1) * 10.0 ** rng.integers(decades + 1)
    )
    A = (Q * exact) @ Q.T
    A = 0.5 * (A + A.T)
    before = A.copy()
    values, vectors = function(A)
    np.testing.assert_array_equal(A, before)
    largest = np.abs(exact).max() + 1e-300
    np.testing.assert_allclose(values / largest, exact / largest, atol=1e-14)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(size), atol=1e-14)
    np.testing.assert_allclose(
        A @ vectors / largest, vectors * values / largest, atol=1e-14
    )


def test_eigenvectors_of_a_diagonal_matrix_are_its_axes_in_order():
    values, vectors = eigen(np.diag([3.0, 0.0, 2.0]))
    np.testing.assert_array_equal(values, [0.0, 2.0, 3.0])
    np.testing.assert_array_equal(vectors, np.eye(3)[:, [1, 2, 0]])


@given(seeds, st.floats(min_value=0.1, max_value=0.95))
def test_every_mode_has_the_chosen_damping_ratio(seed, damping_ratio):
    rng = np.random.default_rng(seed)
    M, J, K = random_spd(rng, 7), rng.normal(size=(6, 7)), random_spd(rng, 6)
    B, omega, _ = modes_of(M, J, K)
    D = B * (2 * damping_ratio * omega) @ B.T
    inverse_inertia = J @ np.linalg.solve(M, J.T)
    poles = np.linalg.eigvals(
        np.block(
            [
                [np.zeros((6, 6)), np.eye(6)],
                [-inverse_inertia @ K, -inverse_inertia @ D],
            ]
        )
    )
    np.testing.assert_allclose(-poles.real / np.abs(poles), damping_ratio, atol=1e-5)


@settings(max_examples=30)
@given(seeds, st.integers(min_value=0, max_value=6))
def test_the_inertia_is_bounded_near_a_singularity(seed, rank):
    """And only as far as it must be: other directions keep theirs."""
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, 7))
    M, K, length = random_spd(rng, 7), random_spd(rng, 6), 0.5
    B, omega, bounded = modes_of(M, J, K, 50.0, length)
    scale = np.diag([length] * 3 + [1.0] * 3)
    values, U = np.linalg.eigh(scale @ J @ np.linalg.solve(M, J.T) @ scale)
    inertia = U / np.maximum(values, 1 / 50) @ U.T
    assert bounded == (values[0] < 1 / 50)
    found = B @ B.T
    np.testing.assert_allclose(scale @ inertia @ scale, found, atol=1e-6)
    np.testing.assert_allclose(B * omega**2 @ B.T, K, atol=1e-6 * np.abs(K).max())


def test_the_posture_does_not_accelerate_the_end_effector():
    rng = np.random.default_rng(4)
    config, K, arm = random_config(rng), random_stiffness(rng), random_arm(rng, 7)
    still = np.zeros((4, 6))
    with_posture, without = (
        impedance_law(values_of(c), arm, K, *still, np.ones(7)).torque
        for c in (config, replace(config, posture_frequency=0.0))
    )
    difference = with_posture - without
    assert np.linalg.norm(difference) > 1
    leak = arm.J @ np.linalg.solve(arm.M, difference)
    np.testing.assert_allclose(leak, 0, atol=1e-8)


@given(seeds, st.floats(min_value=0.01, max_value=100))
def test_limits_keep_the_direction_of_the_torque(seed, size):
    rng = np.random.default_rng(seed)
    torque = size * rng.normal(size=7)
    lower, upper = -rng.uniform(0.5, 2, 7), rng.uniform(0.5, 2, 7)
    limited = torque_scale(torque, lower, upper) * torque
    factor = limited[0] / torque[0]
    assert 0 < factor <= 1
    np.testing.assert_allclose(limited, factor * torque)
    assert np.all((lower - 1e-12 <= limited) & (limited <= upper + 1e-12))
    if factor < 1:
        assert np.min(np.minimum(upper - limited, limited - lower)) < 1e-12


def test_infinite_limits_do_not_limit():
    torque = np.array([1e6, -1e6])
    none = np.full(2, -np.inf), np.full(2, np.inf)
    limited = torque_scale(torque, *none) * torque
    np.testing.assert_array_equal(limited, torque)


@given(seeds, st.floats(min_value=0.01, max_value=100))
def test_the_rate_limit_keeps_the_direction_of_the_change(seed, size):
    rng = np.random.default_rng(seed)
    previous = rng.normal(size=7)
    change = size * rng.normal(size=7)
    limited = previous + rate_scale(change, 1.0) * change
    factor = (limited - previous)[0] / change[0]
    assert 0 < factor <= 1 + 1e-9
    np.testing.assert_allclose(limited - previous, factor * change, atol=1e-12)
    assert np.abs(limited - previous).max() <= 1 + 1e-12


def test_the_default_orientation_points_the_tool_into_the_board():
    np.testing.assert_allclose(
        ImpedanceConfig().desired_rotation(), np.diag([1, -1, -1]), atol=1e-15
    )


def test_the_config_puts_rotations_first():
    config = ImpedanceConfig(
        rotational_stiffness=[1.0, 2.0, 3.0], translational_stiffness=[4.0, 5.0, 6.0]
    )
    np.testing.assert_array_equal(config.stiffness(), np.diag([1, 2, 3, 4, 5, 6]))


def test_nested_settings_load_from_yaml():
    config = yaml_load_typed(
        schema=ImpedanceConfig,
        data="{force_control: {enabled: true}, watchdog: {max_age: 0.2}}",
        defaults=ImpedanceConfig(),
    )
    assert config.force_control == ForceControlConfig(enabled=True)
    assert config.watchdog == WatchdogConfig(max_age=0.2)


def test_the_config_survives_yaml():
    config = ImpedanceConfig(damping_ratio=0.8, orientation=[3.0, 0.1, 0.2])
    assert (
        yaml_load_typed(schema=ImpedanceConfig, data=yaml_dump_typed(config)) == config
    )


def test_yaml_overrides_single_values():
    config = yaml_load_typed(
        schema=ImpedanceConfig,
        data="translational_stiffness: [800, 800, 100]",
        defaults=ImpedanceConfig(),
    )
    assert config == ImpedanceConfig(translational_stiffness=[800.0, 800.0, 100.0])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"translational_stiffness": [1.0, 2.0]},
            r"translational_stiffness is \[1.0, 2.0\]; expected 3 numbers",
        ),
        (
            {"rotational_stiffness": [1.0, math.nan, 1.0]},
            r"rotational_stiffness\[1\] is nan",
        ),
        (
            {"rotational_stiffness": [1.0, 0.0, 1.0]},
            r"rotational_stiffness\[1\] .* positive \(use a small number for a free",
        ),
        ({"orientation": [0.0] * 4}, "orientation is .*; expected 3"),
        (
            {"orientation": [math.inf, 0.0, 0.0]},
            r"orientation\[0\] is inf; .* not degrees",
        ),
        ({"damping_ratio": -1.0}, "damping_ratio is -1.0; it must be positive"),
        ({"damping_ratio": math.nan}, "damping_ratio is nan; it must be positive"),
        (
            {"posture_frequency": -1.0},
            "posture_frequency is -1.0; it must be at least 0",
        ),
        ({"posture_damping_ratio": -1.0}, "posture_damping_ratio is -1.0"),
        ({"max_translation_error": 0.0}, "max_translation_error is 0.0"),
        ({"max_rotation_error": math.nan}, "max_rotation_error is nan"),
        ({"max_posture_error": -0.1}, "max_posture_error"),
        ({"max_torque_rate": math.inf}, "max_torque_rate is inf"),
        ({"max_effective_mass": 0.0}, "max_effective_mass"),
        ({"characteristic_length": 0.0}, "characteristic_length"),
        ({"control_period": 0.0}, "control_period"),
        ({"stiffness_time_constant": math.nan}, "stiffness_time_constant"),
        (
            {"walls": JointWallConfig(width=0.0)},
            r"walls\.width is 0.0; it must be positive",
        ),
        (
            {"walls": JointWallConfig(speed_fraction=1.1)},
            "speed_fraction is 1.1; .* at most 1",
        ),
        ({"watchdog": WatchdogConfig(max_age=-1.0)}, r"watchdog\.max_age"),
        (
            {"tank": EnergyTankConfig(initial_energy=2.0)},
            "initial_energy is 2.0 J; .* tank.capacity, 1.0 J",
        ),
        (
            {"tank": EnergyTankConfig(stored_fraction=1.1)},
            "tank.stored_fraction is 1.1; .* at most 1",
        ),
        (
            {"force_control": ForceControlConfig(release_time=0.0)},
            r"force_control\.release_time",
        ),
        (
            {"covariance_stiffness": CovarianceStiffnessConfig(max_stiffness=1.0)},
            "max_stiffness is 1.0 N/m; .* at least min_stiffness, 300.0 N/m",
        ),
        (
            {"covariance_stiffness": CovarianceStiffnessConfig(axes=[True])},
            r"axes is \[True\]; expected 3",
        ),
    ],
)
def test_error_of_an_invalid_config_states_the_allowed_range(values, message):
    config = ImpedanceConfig(**values)
    with pytest.raises(SystemsError, match=message):
        config.stiffness()
    with pytest.raises(SystemsError, match=message):
        config.desired_rotation()
