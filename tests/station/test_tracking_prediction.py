"""Facts about the predicted motion of an arm along a path, against its plant."""

from contextlib import contextmanager

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.math import RollPitchYaw
from pydrake.multibody.tree import JacobianWrtVariable
from scipy.spatial.transform import Rotation

from fmp_drake.station import Scenario
from fmp_drake.station.reach.board_reach import BoardReach, FollowingBounds
from fmp_drake.station.reach.tracking_prediction import (
    FeltContact,
    TrackingPredictor,
    lengths,
)
from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel

STEP = 0.05
TILT = RollPitchYaw(0.3, -0.2, 0.1).ToRotationMatrix().matrix()


class Follower:
    """An arm that follows paths near its posture, and its plant for comparisons."""

    def __init__(self, robot):
        scenario = Scenario()
        scenario.robot = robot
        model = MakeRobotModel(LoadRobot(robot), scenario.held_tool())
        self.plant, self.tip, self.arm = model.plant, model.tip, model.arm
        self.config = scenario.impedance
        self.predictor = TrackingPredictor(self.plant, self.tip, self.config)
        self.posture = BoardReach(scenario, FollowingBounds()).start_posture()
        self.context = self.plant.CreateDefaultContext()

    def at(self, q, v=None):
        """Return the pose of E, and its Jacobian in W, in a state."""
        self.plant.SetPositions(self.context, q)
        self.plant.SetVelocities(self.context, np.zeros_like(q) if v is None else v)
        W = self.plant.world_frame()
        J = self.plant.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, self.tip, np.zeros(3), W, W
        )
        return self.tip.CalcPoseInWorld(self.context), J

    def follow(self, offsets, **options):
        """Follow a path (T, 3) in W, m from the start, with the start's orientation."""
        X, _ = self.at(self.posture)
        options.setdefault("R_WB", TILT[None, None])
        options.setdefault("q_posture", self.posture[None])
        options.setdefault("step", STEP)
        R_WE = options.pop("R_WE", X.rotation().matrix()[None, None])
        motion = self.predictor.follow(X.translation() + offsets[None], R_WE, **options)
        return type(motion)(*(value[0] for value in motion))

    @contextmanager
    def held(self, joint, below=0.0, above=0.0):
        """Let a joint move by so much below and above its posture, rad, and no farther."""
        part = self.plant.get_joint(self.plant.GetJointIndices(self.arm)[joint])
        lower, upper = part.position_lower_limits(), part.position_upper_limits()
        q, width = self.posture[joint], self.config.walls.width
        part.set_position_limits([q - below - width], [q + above + width])
        yield
        part.set_position_limits(lower, upper)


@pytest.fixture(scope="module", params=["panda", "ur5e"])
def arm(request):
    return Follower(request.param)


@pytest.fixture(scope="module")
def circle():
    """A circle of 5 cm in 4 s, twice."""
    angle = np.linspace(0.0, 4 * np.pi, 160)
    return 0.05 * np.stack([np.cos(angle) - 1, np.sin(angle), 0 * angle], axis=1)


def test_pose_of_a_reachable_path_is_reached(arm, circle):
    motion = arm.follow(circle)
    X, _ = arm.at(arm.posture)
    for q, offset in zip(motion.q[::20], circle[::20], strict=True):
        reached, _ = arm.at(q)
        assert_allclose(reached.translation(), X.translation() + offset, atol=5e-4)
        assert_allclose(reached.rotation().matrix(), X.rotation().matrix(), atol=2e-3)
    assert np.abs(motion.error).max() < 2e-3


def test_speeds_and_torques_are_those_of_the_motion(arm, circle):
    motion = arm.follow(circle)
    assert_allclose(motion.v[1:], np.diff(motion.q, axis=0) / STEP, atol=1e-12)
    assert_allclose(motion.v[0], motion.v[1], atol=1e-12)
    acceleration = np.diff(motion.v, axis=0, prepend=motion.v[:1]) / STEP
    for k in (0, 3, 40, 111):
        arm.at(motion.q[k], motion.v[k])
        weight = arm.plant.CalcGravityGeneralizedForces(arm.context)
        torque = (
            arm.plant.CalcMassMatrix(arm.context) @ acceleration[k]
            + arm.plant.CalcBiasTerm(arm.context)
            - weight
        )
        assert_allclose(motion.torque[k], torque, atol=1e-2 * np.abs(weight).max())
    # Without motion the joints bear the weight, and nothing else.
    still = arm.follow(np.zeros((4, 3)))
    arm.at(still.q[-1])
    weight = arm.plant.CalcGravityGeneralizedForces(arm.context)
    assert_allclose(still.torque[-1], -weight, atol=1e-6)


def test_force_on_the_board_acts_along_its_normal(arm, circle):
    motion = arm.follow(circle)
    for k in (0, 57):
        _, J = arm.at(motion.q[k])
        assert_allclose(motion.force_torque[k], J[3:].T @ -TILT[:, 2], atol=1e-9)
        assert motion.manipulability[k] == pytest.approx(
            np.sqrt(np.linalg.det(J @ J.T)), rel=1e-9
        )


def test_errors_point_to_the_desired_pose_in_the_axes_of_the_board(arm):
    # Two metres away along x, and turned by half a radian.
    X, _ = arm.at(arm.posture)
    turned = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix() @ X.rotation().matrix()
    path = np.tile([2.0, 0.0, 0.0], (60, 1))
    motion = arm.follow(path, R_WE=turned[None, None])
    reached, _ = arm.at(motion.q[-1])
    p_error = X.translation() + path[-1] - reached.translation()
    assert_allclose(motion.error[-1, 3:], TILT.T @ p_error, atol=1e-9)
    assert np.linalg.norm(p_error) > 0.5
    rotation = turned @ reached.rotation().matrix().T
    expected = TILT.T @ Rotation.from_matrix(rotation).as_rotvec()
    assert_allclose(motion.error[-1, :3], expected, atol=1e-6)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_joints_stop_at_their_limit_springs(arm, side):
    # Turned about its axis until the last joints reach their ends.
    X, _ = arm.at(arm.posture)
    angles = side * np.linspace(0.0, 9.0, 120)[:, None] * [0.0, 0.0, 1.0]
    R_WE = Rotation.from_rotvec(angles).as_matrix() @ X.rotation().matrix()
    R_WB = np.tile(TILT, (1, 120, 1, 1))
    motion = arm.follow(np.zeros((120, 3)), R_WE=R_WE[None], R_WB=R_WB)
    width = arm.config.walls.width
    margins = np.stack(
        [
            motion.q - arm.plant.GetPositionLowerLimits() - width,
            arm.plant.GetPositionUpperLimits() - width - motion.q,
        ]
    )
    assert margins.min() == pytest.approx(0.0, abs=1e-9)
    assert np.abs(motion.error[:, :3]).max() > 0.5


def test_other_joints_compensate_for_one_at_its_limit_spring(circle):
    panda = Follower("panda")
    # The one that moves most while the tool stays.
    _, J = panda.at(panda.posture)
    joint = np.argmax(np.abs(np.linalg.svd(J)[2][-1]))
    moved = panda.follow(circle).q[:, joint] - panda.posture[joint]
    below, above = -0.5 * moved.min(), 0.5 * moved.max()
    with panda.held(joint, below, above):
        motion = panda.follow(circle)
    moved = motion.q[:, joint] - panda.posture[joint]
    assert (moved.min(), moved.max()) == pytest.approx((-below, above))
    assert np.abs(motion.error).max() < 2e-3


def test_paths_do_not_affect_one_another(arm, circle):
    X, _ = arm.at(arm.posture)
    offsets = np.stack([circle, -circle, 3 * circle])
    R_WE, R_WB = X.rotation().matrix()[None, None], np.tile(TILT, (3, 1, 1, 1))
    # At their limit springs, on some of the paths.
    with arm.held(3, 0.05, 0.05):
        together = arm.predictor.follow(
            X.translation() + offsets,
            np.tile(R_WE, (3, 1, 1, 1)),
            R_WB,
            q_posture=np.tile(arm.posture, (3, 1)),
            step=STEP,
        )
        for i in range(3):
            alone = arm.follow(offsets[i])
            assert_allclose(together.q[i], alone.q, atol=1e-9)
            assert_allclose(together.error[i], alone.error, atol=1e-9)


def test_orientation_and_normal_may_change_along_the_path(arm):
    X, _ = arm.at(arm.posture)
    turns = np.linspace(0.0, 0.4, 40)[:, None] * [1.0, 0.0, 0.0]
    turned = Rotation.from_rotvec(turns).as_matrix()
    motion = arm.follow(
        np.zeros((40, 3)),
        R_WE=(turned @ X.rotation().matrix())[None],
        R_WB=(turned @ TILT)[None],
    )
    for k in (0, 1, 20, 39):
        reached, J = arm.at(motion.q[k])
        expected = turned[k] @ X.rotation().matrix()
        assert_allclose(reached.rotation().matrix(), expected, atol=3e-3)
        normal = (turned[k] @ TILT)[:, 2]
        assert_allclose(motion.force_torque[k], J[3:].T @ -normal, atol=1e-9)


def test_posture_draws_a_redundant_arm_back():
    panda = Follower("panda")
    angle = np.linspace(0.0, 20 * np.pi, 800)
    circles = 0.1 * np.stack([np.cos(angle) - 1, np.sin(angle), 0 * angle], axis=1)
    motion = panda.follow(circles)
    assert np.abs(motion.error[:, 3:]).max() < 1e-3
    # Kinematic inverses alone drift from cycle to cycle.
    assert np.abs(motion.q[-1] - motion.q[79]).max() < 0.02
    assert np.abs(motion.q[-1] - panda.posture).max() < 0.1


@pytest.mark.parametrize(("damping_ratio", "frequency"), [(1.0, 5.0), (0.3, 8.0)])
def test_nullspace_motion_is_that_of_the_posture_s_spring_and_damper(
    damping_ratio, frequency
):
    panda = Follower("panda")
    panda.config.posture_damping_ratio = damping_ratio
    panda.config.posture_frequency = frequency
    step = 0.01
    # The tool waits elsewhere, so that the posture is not the one nearest to it.
    motion = panda.follow(np.tile([0.05, -0.15, 0.05], (150, 1)), step=step)
    _, J = panda.at(motion.q[-1])
    along = (motion.q - motion.q[-1]) @ np.linalg.svd(J)[2][-1]
    assert np.abs(along[0]) > 1e-3
    # Coefficients of x'' + a x' + b x + c = 0 that fit best.
    velocity = np.diff(along)[1:] / step
    acceleration = np.diff(along, n=2) / step**2
    columns = np.stack([velocity, along[2:], np.ones_like(velocity)], axis=1)
    (a, b, _), *_ = np.linalg.lstsq(columns, -acceleration, rcond=None)
    assert a == pytest.approx(2 * damping_ratio * frequency, rel=0.02)
    # The spring pulls all joints, and the nullspace is curved.
    assert b == pytest.approx(frequency**2, rel=0.15)


def test_a_jump_of_the_path_takes_several_samples(arm):
    X, _ = arm.at(arm.posture)
    turns = np.where(np.arange(20) < 5, 0.0, 1.2)[:, None] * [0.0, 0.0, 1.0]
    R_WE = Rotation.from_rotvec(turns).as_matrix() @ X.rotation().matrix()
    path = np.where(np.arange(20) < 5, 0.0, 0.25)[:, None] * [-1.0, 0.0, 0.3]
    motion = arm.follow(path, R_WE=R_WE[None])
    assert np.abs(motion.error[4]).max() < 2e-3
    # Five corrections of at most 0.15 rad, and what the posture's spring adds.
    assert 0.3 < np.linalg.norm(motion.q[5] - motion.q[4]) < 0.8
    distance = np.linalg.norm(motion.error[4:, 3:], axis=1)
    assert distance[1] > 0.05
    assert np.all(np.diff(distance[1:4]) < 2e-4)
    assert np.abs(motion.error[-1]).max() < 2e-3


def test_lengths_of_an_error_are_its_distance_and_its_angle():
    error = np.zeros((2, 4, 6))
    error[1, 2] = [0.3, 0.4, 1.2, 0.02, 0.03, 0.06]
    for has_rotation, angle in ((False, 0.5), (True, 1.3)):
        found = lengths(error, has_rotation=has_rotation)
        for values, expected in zip(found, (0.07, angle), strict=True):
            assert values.shape == (2, 4)
            assert values[1, 2] == pytest.approx(expected)
            assert np.sum(values) == pytest.approx(expected)


def test_an_error_that_a_held_joint_leaves_is_the_equilibrium_of_the_springs(arm):
    """The springs of the pose load the joint that is held, and no other one."""
    path = np.minimum(np.arange(120), 40)[:, None] * np.array([-1e-3, 2e-3, 2e-3])
    for joint in range(len(arm.posture)):
        with arm.held(joint):
            motion = arm.follow(path)
        _, J = arm.at(motion.q[-1])
        error = motion.error[-1].reshape(2, 3) @ TILT.T
        stiffness = np.diagonal(arm.config.stiffness()).reshape(2, 3)
        force = ((error @ TILT) * stiffness) @ TILT.T
        torque = J.T @ force.reshape(6)
        assert np.all(np.abs(np.delete(torque, joint)) < 0.02)  # Nm; it bears up to 12.


def test_joints_of_a_stretched_arm_do_not_go_far_back_and_forth(arm):
    """Full corrections near a singularity would go far beyond it, and back."""
    X, _ = arm.at(arm.posture)
    outward = X.translation() * [1.0, 1.0, 0.0]
    outward /= np.linalg.norm(outward)
    path = np.minimum(np.arange(120), 50)[:, None] * 0.01 * outward
    motion = arm.follow(path)
    distance = np.linalg.norm(motion.error[:, 3:], axis=1)
    assert distance[50] > 0.03  # m
    assert np.abs(np.diff(motion.q, n=2, axis=0)).max() < 0.4  # rad; 1.2 for full ones
    assert np.abs(np.diff(motion.q[90:], axis=0)).max() < 0.15
    assert_allclose(distance[90:], distance[-1], rtol=0.05)


def test_pressed_felt_bears_what_the_arm_cannot_yield():
    # A board that rises out of the arm's reach, and one that sinks.
    panda = Follower("panda")
    pressing, softer = (
        TrackingPredictor(
            panda.plant, panda.tip, panda.config, FeltContact(force=10.0, stiffness=k)
        )
        for k in (5000.0, 200.0)
    )
    free, everywhere = panda.predictor, np.ones((1, 60), dtype=bool)
    for direction in (1.0, -1.0):
        out = np.linspace(0.0, 0.9, 60)[:, None]
        path = direction * out * TILT[:, 2] + 0.3 * out * TILT[:, 0]
        panda.predictor = free
        loose = panda.follow(path).error[-1]
        panda.predictor = pressing
        pressed = panda.follow(path, pressed=everywhere).error[-1]
        assert_allclose(panda.follow(path).error[-1], loose, atol=1e-9)
        assert_allclose(np.sign(loose[5]), direction)
        if direction > 0:  # The error is beside the path instead.
            assert abs(pressed[5]) < 0.5 * abs(loose[5])
            panda.predictor = softer  # As stiff as the spring.
            soft = panda.follow(path, pressed=everywhere).error[-1]
            assert abs(pressed[5]) < abs(soft[5]) < abs(loose[5])
        else:  # The contact is lost: the board does not pull.
            assert pressed[5] == pytest.approx(loose[5], rel=0.05)
