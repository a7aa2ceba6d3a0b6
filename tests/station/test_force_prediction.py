"""Facts about the predicted normal force of braked joints, against statics."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.station.reach.force_prediction import predict_force_error
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


def error(motion, **changes):
    config = ImpedanceConfig(**changes)
    return predict_force_error(config, LIMITS, motion, step=STEP)


@pytest.mark.parametrize("excess", [0.1, 0.2])
@pytest.mark.parametrize("direction", [1, -1])
def test_the_board_bears_what_a_brake_pushes_along_its_normal(excess, direction):
    # The springs bear the other part. A joint that lowers the eraser is held back:
    # then the board is relieved.
    forces = error(moving(direction * (BRAKED_ABOVE + excess)))
    expected = direction * BRAKE * excess * np.sin(ANGLE)
    assert_allclose(forces[0, -10:], expected, rtol=0.01)


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


def test_joints_without_limits_are_braked_by_their_speed():
    limits = LIMITS._replace(half_range=np.full(N, np.inf), middle=np.zeros(N))
    config = ImpedanceConfig()
    forces = predict_force_error(config, limits, moving(1.8), step=STEP)
    assert_allclose(forces, error(moving(1.8)))


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
