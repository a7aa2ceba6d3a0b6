"""Facts about the predicted normal force of braked joints, against mechanics."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.station.reach.deviation_prediction import (
    FeltContact,
    predict_deviation,
)
from fmp_drake.station.reach.tracking_prediction import PredictedMotion
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.impedance.force_control import ForceControlConfig
from fmp_drake.systems.impedance.joints import JointLimits

STEP, N = 0.05, 7
LIMITS = JointLimits.between(
    np.full(N, -1.0),
    np.full(N, 2.0),
    speed=np.full(N, 2.0),
    lower_effort=np.full(N, -87.0),
    upper_effort=np.full(N, 87.0),
)
# Above 85 % of its speed a joint of 1 kg m² is braked by 100 Nm per rad/s.
BRAKED_ABOVE, BRAKE = 1.7, 100.0
FELT = 1e5  # N/m.
# Of the axis of joint 4 from the board's x towards its normal.
ANGLE = 0.4


def moving(v, *, samples=80, q=0.5):
    """Return a motion whose joints are the axes of the eraser, two of them inclined.

    Joint 4 has the velocity v of one path, or of several, rad/s.
    """
    v = np.broadcast_to(
        np.asarray(v, dtype=float).reshape(-1, 1), (np.size(v), samples)
    )
    shape = v.shape
    J = np.eye(6, N)
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    J[np.ix_([3, 5], [3, 5])] = [[c, -s], [s, c]]
    velocities = np.zeros((*shape, N))
    velocities[..., 3] = v
    return PredictedMotion(
        np.full((*shape, N), q),
        velocities,
        np.zeros((*shape, N)),
        np.tile(np.eye(N), (*shape, 1, 1)),
        np.tile(J, (*shape, 1, 1)),
        np.zeros((*shape, 6)),
        np.ones(shape),
    )


def deviation(
    motion, *, force=50.0, felt=FELT, limits=LIMITS, lead=0.0, damping=0.0, **changes
):
    """Return pose and force; the posture of joint 4 is ahead of the motion by `lead`, rad."""
    contact, posture = FeltContact(force, felt), motion.q[0, 0].copy()
    posture[3] += lead
    config = ImpedanceConfig(**changes)
    return predict_deviation(
        config,
        limits,
        motion,
        contact,
        q_posture=posture,
        step=STEP,
        joint_damping=damping,
    )


def error(motion, **options):
    return deviation(motion, **options).force


def heavy(mass, v=0.0, acceleration=0.0):
    """Return a motion in which joint 4 moves a mass, kg, as at a singularity."""
    motion = moving(v, samples=240)
    motion.v[..., 3] += acceleration * STEP * np.arange(motion.v.shape[1])
    motion.M[..., 3, 3] = mass
    return motion


@pytest.mark.parametrize("excess", [0.1, 0.2])
@pytest.mark.parametrize("direction", [1, -1])
def test_the_board_bears_what_a_brake_pushes_along_its_normal(excess, direction):
    # The springs bear the other part. A joint that lowers the eraser is held back:
    # then the board is relieved.
    forces = error(moving(direction * (BRAKED_ABOVE + excess)))
    expected = direction * BRAKE * excess * np.sin(ANGLE)
    assert_allclose(forces[0, -10:], expected, rtol=0.01)


def test_the_force_rises_as_in_damped_springs_with_the_felt():
    # Unit masses along the board's x and normal, and joint 4 between both.
    zeta, felt = 0.7, 2000.0
    pose, found, _ = deviation(moving(1.8), felt=felt, damping_ratio=zeta)
    a = np.array([np.cos(ANGLE), np.sin(ANGLE)])
    D, K = 2 * zeta * np.sqrt([1500.0, 200.0]), np.diag([1500.0, 200.0 + felt])
    x, v, expected = np.zeros(2), np.zeros(2), []
    for _ in range(60):
        # An implicit step; the brake depends on the speed at its end.
        A = np.eye(2) / STEP**2 + np.diag(D) / STEP + K
        A += BRAKE / STEP * np.outer(a, a)
        b = (x + STEP * v) / STEP**2 + D * x / STEP
        b += BRAKE * a * (1.8 - BRAKED_ABOVE + a @ x / STEP)
        before, x = x, np.linalg.solve(A, b)
        v = (x - before) / STEP
        expected.append(x)
    assert_allclose(pose[0, :60, [3, 5]].T, expected, atol=1e-9)
    assert_allclose(pose[..., [0, 1, 2, 4]], 0.0, atol=1e-9)
    assert_allclose(found, felt * pose[..., 5], rtol=1e-9)


def test_force_fades_where_the_joint_is_not_braked_any_more():
    v = np.where(np.arange(80) < 40, BRAKED_ABOVE + 0.1, 0.5)
    motion = moving(0.0)
    motion.v[0, :, 3] = v
    forces = error(motion)[0]
    assert forces[39] > 3.5
    assert abs(forces[-1]) < 0.01


def test_only_braked_paths_have_an_error():
    forces = error(moving([1.69, 1.8, -1.69, -1.8]))
    assert np.all(forces[[0, 2]] == 0)
    assert_allclose(forces[3], -forces[1])
    assert_allclose(forces[1], error(moving(1.8))[0])


def test_what_hinders_the_arm_is_told_with_the_joint_and_its_part_of_the_path():
    motion = moving([1.69, 1.8])
    assert deviation(moving(1.69)).hindrance == ""
    braked = "joint 4 is braked on 50.0 % of the path"
    assert deviation(motion).hindrance == braked
    motion.v[1, :8, 6] = 9.0  # Joint 7 is braked less often.
    assert deviation(motion).hindrance == braked
    motion.q[:, :20, 2] = 1.95
    motion.q[0, :4, 5] = -0.95
    at_limit = "joint 3 is at its limit on 25.0 % of the path"
    assert deviation(motion).hindrance == f"{braked}, {at_limit}"
    motion.M[0, :16, 0, 0] = 1e9
    singular = "the arm is nearly singular on 10.0 % of the path"
    assert deviation(motion).hindrance == f"{braked}, {at_limit}, {singular}"


@pytest.mark.parametrize("side", [1, -1])
def test_a_joint_is_braked_before_its_limit_spring(side):
    # 0.32 m/s can be stopped within 10 mrad by 5 rad/s²; the spring begins at 0.1 rad.
    limit = 2.0 if side > 0 else -1.0
    q = limit - side * 0.11
    assert np.all(error(moving(side * 0.31, q=q)) == 0)
    assert np.all(error(moving(-side * 0.4, q=q)) == 0)
    forces = error(moving(side * 0.4, q=q))
    excess = 0.4 - np.sqrt(2 * 5.0 * 0.01)
    expected = side * BRAKE * excess * np.sin(ANGLE)
    assert_allclose(forces[0, -10:], expected, rtol=0.01)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("lead", [0.1, -0.1])
def test_a_limit_spring_turns_the_tool_where_the_posture_is_beyond_it(side, lead):
    # Joints 1 and 7 have the same axis; of their sum the tool does not tell them apart.
    motion = moving(0.0, samples=400)
    motion.J[..., 0, 6] = 1.0
    motion.q[..., 0] = 0.5 + side * (1.5 - 0.1)  # Where the spring begins.
    posture = motion.q[0, 0].copy()
    posture[[0, 6]] += side * lead * np.array([1, -1])
    config = ImpedanceConfig()
    found = predict_deviation(
        config, LIMITS, motion, FeltContact(0.0, 0.0), q_posture=posture, step=STEP
    )
    # The springs of tool, posture and limit are in equilibrium.
    spring, K = 2 * 87.0 / 0.1, config.rotational_stiffness[0]
    pull = config.posture_frequency**2
    depth = 2 * pull * max(lead, 0.0) / (2 * pull + spring + pull * spring / (2 * K))
    expected = side * depth * spring / (2 * K)
    assert (abs(expected) > 0.02) == (lead > 0)
    assert found.pose[0, -1, 0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("v", [0.5, -0.5])
def test_the_damping_of_a_joint_holds_the_eraser_back(v):
    # Joint 4 has 20 Nm s/rad: springs and felt bear the parts of its torque along their axes.
    damping = np.zeros(N)
    damping[3] = 20.0
    found = deviation(moving(v, samples=200), damping=damping)
    along, normal = 20.0 * v * np.array([np.cos(ANGLE), np.sin(ANGLE)])
    assert found.pose[0, -1, 3] == pytest.approx(along / 1500.0, rel=1e-3)
    assert found.force[0, -1] == pytest.approx(normal, rel=0.01)


def test_joints_without_limits_are_braked_by_their_speed():
    limits = LIMITS._replace(half_range=np.full(N, np.inf), middle=np.zeros(N))
    assert_allclose(error(moving(1.8), limits=limits), error(moving(1.8)))


def test_control_of_the_normal_force_removes_a_lasting_error():
    config = {"enabled": True, "proportional_gain": 3.0, "integral_gain": 8.0}
    left = error(moving(1.8), force_control=ForceControlConfig(**config))[0]
    free = error(moving(1.8))[0]
    # The proportional part is at once: 1 / (1 + p), less what is integrated in 50 ms.
    assert left[0] == pytest.approx(free[0] / (1 + 3.0 + 8.0 * STEP))
    # With a bandwidth of 2 rad/s nothing is left after 4 s.
    assert abs(left[-1]) < 0.01 * free[-1]


def test_a_singular_posture_has_finite_forces():
    motion = moving(1.8)
    motion.J[..., 4, :] = 0.0
    assert_allclose(error(motion), error(moving(1.8)), rtol=1e-6)


def test_the_spring_of_the_arm_bears_a_part_if_the_felt_is_soft():
    # It has 200 N/m along the normal.
    forces = error(moving(1.8), felt=1000.0)[0]
    assert forces[-1] == pytest.approx(error(moving(1.8))[0, -1] / 1.2, rel=0.01)


@pytest.mark.parametrize("acceleration", [0.1, -0.1])
def test_the_board_bears_the_force_that_a_bounded_inertia_lacks(acceleration):
    # An eraser that is lowered too slowly relieves the board.
    motion = heavy(1000.0, acceleration=acceleration)
    forces = error(motion, force=200.0, posture_frequency=0.0)[0]
    expected = (1000.0 - 300.0) * acceleration * np.sin(ANGLE)
    assert_allclose(forces[-10:], expected, rtol=0.01)
    motion = heavy(299.0 - 6 * 16.0, acceleration=acceleration)
    assert np.all(error(motion, posture_frequency=0.0) == 0)


def test_a_path_may_be_near_a_singularity_at_its_end_only():
    motion = heavy(1000.0, acceleration=0.1)
    motion.M[:, :120, 3, 3] = 1.0
    forces = error(motion, force=200.0, posture_frequency=0.0)[0]
    assert_allclose(forces[:120], 0.0, atol=1e-9)
    assert_allclose(forces[-10:], 700.0 * 0.1 * np.sin(ANGLE), rtol=0.06)


@pytest.mark.parametrize(
    ("lead", "v", "acceleration"),
    [(0.1, 0.0, 25 * 0.1), (-2.0, 0.0, -25 * 0.5), (0.0, 0.5, -2 * 0.8 * 5 * 0.5)],
)
def test_the_posture_moves_an_eraser_of_bounded_inertia(lead, v, acceleration):
    # Its acceleration is that of a spring with 5 rad/s, whose error is at most 0.5 rad.
    forces = error(heavy(310.0, v), lead=lead, posture_damping_ratio=0.8)[0]
    # The posture's spring, of 10 kg, acts against a deviation, too.
    compliance = np.cos(ANGLE) ** 2 / 1500.0 + np.sin(ANGLE) ** 2 / FELT
    force = -10.0 * acceleration / (1.0 + 10.0 * 25.0 * compliance)
    assert_allclose(forces[-10:], force * np.sin(ANGLE), rtol=0.01)


def test_an_eraser_without_contact_is_held_by_force_and_spring_only():
    # The brake of 20 N lifts it with 7.8 N, against a normal force of 5 N.
    motion, lift = moving(-1.9), BRAKE * 0.2 * np.sin(ANGLE)
    height = -error(motion, force=5.0)[0, -1] / FELT
    assert height == pytest.approx((lift - 5.0) / 200.0, rel=0.01)
    kept = error(motion, force=8.0)[0, -1]
    assert kept == pytest.approx(-lift, rel=0.01)
    control = ForceControlConfig(enabled=True)
    controlled = error(motion, force=5.0, force_control=control)
    assert np.min(controlled) > -5.0


def test_contact_returns_with_the_normal_force():
    motion = moving(0.0)
    motion.v[0, :20, 3] = -1.9
    forces = error(motion, force=5.0)[0]
    assert forces[19] < -5.0
    assert abs(forces[-1]) < 0.01
