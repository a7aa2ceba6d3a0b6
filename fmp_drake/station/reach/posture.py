"""Postures of an arm for poses of its tool, and the normal force in a posture."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.solvers import Solve

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array, check_type, finite_array
from fmp_drake.station.robots.robot import Robot, check_posture
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.impedance.joints import JointWallConfig
from fmp_drake.systems.interface.callbacks import check_frame
from fmp_drake.systems.surface.surface import rotation

_POSITION_TOLERANCE = 1e-6
_ROTATION_TOLERANCE = 1e-5
_LIMIT_MARGIN = 0.03
# Distance from the springs at the joint limits, which would move the arm at its start, rad.
_SPRING_DISTANCE = 0.005
# Random initial guesses where the preferred posture leads to no solution.
_GUESSES = 16
LEVEL_HEIGHT = 0.10
"""Height of the felt in `FindLevelReach`, m."""

TORQUE_FRACTION = 0.8
"""Fraction of the joints' torque limits for the normal force and the weight."""


def SolvePosture(
    plant: MultibodyPlant,
    *,
    frame: Frame,
    X_WE: RigidTransform,
    q_preferred: ArrayLike,
    spring_width: float = JointWallConfig.width,
) -> Array:
    """Find joint angles that put a frame at a pose, near preferred ones.

    Where that fails, for example with the posture of a table-top arm on a ceiling, the
    search begins at random angles, and the result farthest from the joint limits is
    returned. Joints are outside the springs at their limits where that is possible near
    the preferred posture, or where a search from random angles ends nearer to it.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized; its joints are the arm's.
    frame : Frame
        E.
    X_WE : RigidTransform
        Desired pose in the world.
    q_preferred : array_like, shape (n,)
        rad.
    spring_width : float
        Width of the controller's springs at the joint limits, rad.

    Returns
    -------
    ndarray, shape (n,)
        Inside the joint limits by at least 0.03 rad.

    Raises
    ------
    StationError
        Where the arm cannot reach the pose, or the frame is not one of the plant.
    """
    check_frame(frame, "frame", plant, error=StationError)
    check_type(X_WE, "X_WE", RigidTransform, error=StationError)
    q = _FindPosture(plant, frame, X_WE, q_preferred, spring_width)
    if q is None:
        x, y, z = X_WE.translation()
        raise StationError(
            f"the arm cannot bring {frame.name()} to ({x:.3f}, {y:.3f}, {z:.3f}) m in the "
            f"world in this orientation with every joint {_LIMIT_MARGIN} rad inside its "
            "limits; choose another pose, or check the limits and the base of the arm."
        )
    return q


def _FindPosture(
    plant: MultibodyPlant,
    frame: Frame,
    X_WE: RigidTransform,
    q_preferred: ArrayLike,
    spring_width: float,
) -> Array | None:
    """Return the result of `SolvePosture`, or None."""
    n = plant.num_positions()
    preferred = finite_array(q_preferred, "the posture", (n,), error=StationError)
    limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()

    def margin(q: Array) -> float:
        return float(np.min(np.minimum(q - limits[0], limits[1] - q)))

    def guessed(least_margin: float) -> list[Array]:
        lower, upper = np.clip(limits, -np.pi, np.pi)
        guesses = np.random.default_rng(0).uniform(lower, upper, (_GUESSES, n))
        found = (
            _SolveFrom(guess, plant, frame, X_WE, least_margin=least_margin)
            for guess in guesses
        )
        return [q for q in found if q is not None]

    outside = spring_width + _SPRING_DISTANCE
    q = _SolveFrom(preferred, plant, frame, X_WE)
    if q is None:
        return max(guessed(_LIMIT_MARGIN), key=margin, default=None)
    if margin(q) < outside:
        farther = _SolveFrom(preferred, plant, frame, X_WE, least_margin=outside)
        # The search may end far from the preferred posture.
        nearest = [q, *guessed(outside)] if farther is None else [farther]
        q = min(nearest, key=lambda q: float(np.linalg.norm(q - preferred)))
    return q


def SolveStartPosture(scenario: Scenario, model: Robot, start: ArrayLike) -> Array:
    """Find the posture of a station at the start.

    Parameters
    ----------
    scenario : Scenario
    model : Robot
        Of `MakeRobotModel`.
    start : array_like, shape (3,)
        Position of the tool on the board at time 0, as in `Scenario.start`.

    Returns
    -------
    ndarray, shape (n,)
        rad; in (-π, π] for joints without limits.

    Raises
    ------
    StationError
        Where the arm cannot reach the start, or the scenario's posture is out of range.
    """
    X_WB = scenario.board.assumed_pose() @ scenario.board.start_displacement()
    preferred = scenario.preferred_posture()
    limits = model.plant.GetPositionLowerLimits(), model.plant.GetPositionUpperLimits()
    check_posture(preferred, model.joint_names, *limits)
    X_WE, width = X_WB @ scenario.eraser_pose(start), scenario.impedance.walls.width
    q = _FindPosture(model.plant, model.tip, X_WE, preferred, width)
    if q is None:
        x, y, z = X_WE.translation()
        raise StationError(
            f"the arm cannot bring the eraser to ({x:.3f}, {y:.3f}, {z:.3f}) m in the "
            "world with the eraser level on the board; choose a point nearer to the "
            "middle of the board, or another pose of the board or of the robot's base."
        )
    turns = np.ceil((q - np.pi) / (2 * np.pi))
    return q - 2 * np.pi * turns * np.all(np.isinf(limits), axis=0)


def _SolveFrom(
    preferred: Array,
    plant: MultibodyPlant,
    frame: Frame,
    X_WE: RigidTransform,
    *,
    least_margin: float = _LIMIT_MARGIN,
) -> Array | None:
    """Return joint angles near preferred ones, at which the search begins, or None."""
    n = plant.num_positions()
    p = finite_array(X_WE.translation(), "the eraser's position", error=StationError)
    ik = InverseKinematics(plant)
    world = plant.world_frame()
    ik.AddPositionConstraint(
        frame, np.zeros(3), world, p - _POSITION_TOLERANCE, p + _POSITION_TOLERANCE
    )
    ik.AddOrientationConstraint(
        world, X_WE.rotation(), frame, RotationMatrix(), _ROTATION_TOLERANCE
    )
    lower = plant.GetPositionLowerLimits() + least_margin
    upper = plant.GetPositionUpperLimits() - least_margin
    program = ik.prog()
    program.AddBoundingBoxConstraint(lower, upper, ik.q())
    program.AddQuadraticErrorCost(np.eye(n), preferred, ik.q())
    program.SetInitialGuess(ik.q(), np.clip(preferred, lower, upper))
    result = Solve(program)
    return result.GetSolution(ik.q()) if result.is_success() else None


def FindLevelReach(robot: Robot, *, turn: float = 0.0) -> float:
    """Find the greatest distance at which an arm holds the eraser level, 0.1 m high, m.

    The distance is along x of the world from the robot's base, in steps of 1 cm; 0 where
    the arm reaches nothing from 0.2 to 2 m.

    Parameters
    ----------
    robot : Robot
        Of `MakeRobotModel`.
    turn : float
        Of the eraser about its z, beyond the robot's mount, rad.
    """
    level = RotationMatrix(RollPitchYaw(np.array([np.pi, 0.0, turn])))
    base_x, base_y, _ = robot.config.base_pose.translation
    posture = np.array(robot.config.posture)
    for x in np.arange(2.0, 0.2, -0.01):
        X_WE = RigidTransform(level, np.array([base_x + x, base_y, LEVEL_HEIGHT]))
        if _SolveFrom(posture, robot.plant, robot.tip, X_WE) is not None:
            return float(x)
    return 0.0


def ArmForceLimit(
    model: Robot,
    *,
    q: ArrayLike,
    R_WB: RotationMatrix,
    friction: float,
) -> float:
    """Return the largest normal force within an arm's torque limits in a posture, N.

    A normal force F along -z of B causes friction of mu F along any edge of the board.
    The joint torques are ``tau = g(q) + J^T F (-z + mu t)``, with t any of +-x and +-y;
    the result is the largest F at which no joint needs more than 80 % of its effort.
    The rest is for the motion, which takes a few percent when wiping.

    Parameters
    ----------
    model : Robot
        The arm with its eraser, where the force acts.
    q : array_like, shape (n,)
        rad.
    R_WB : RotationMatrix
        Of the board.
    friction : float
        mu.

    Examples
    --------
    >>> from pydrake.systems.framework import DiagramBuilder
    >>> from fmp_drake.station import AddBoardScene, Scenario
    >>> scene = AddBoardScene(DiagramBuilder(), Scenario(), start=[0.0, 0.0, 0.05])
    >>> limit = ArmForceLimit(
    ...     scene.model,
    ...     q=scene.robot.default_posture,
    ...     R_WB=scene.X_WB.rotation(),
    ...     friction=0.5,
    ... )
    >>> 55.0 < limit < 65.0
    True
    """
    arm = model.plant
    context = arm.CreateDefaultContext()
    arm.SetPositions(context, np.asarray(q, dtype=float))
    world, wrt = arm.world_frame(), JacobianWrtVariable.kV
    J = arm.CalcJacobianTranslationalVelocity(
        context, wrt, model.tip, np.zeros(3), world, world
    )
    x, y, z = R_WB.matrix().T
    directions = np.array([-z + friction * t for t in (x, -x, y, -y)])
    per_newton = directions @ J
    holding_torque = -arm.CalcGravityGeneralizedForces(context) * np.sign(per_newton)
    effort = np.minimum(arm.GetEffortUpperLimits(), -arm.GetEffortLowerLimits())
    remaining = TORQUE_FRACTION * effort - holding_torque
    return float(max(0.0, np.min(remaining / np.maximum(np.abs(per_newton), 1e-9))))


def StartForceLimit(scenario: Scenario, model: Robot, q: ArrayLike) -> float:
    """Return `ArmForceLimit` at the start on a scenario's board, N.

    Parameters
    ----------
    scenario : Scenario
        With a board.
    model : Robot
        The arm with its eraser.
    q : array_like, shape (n,)
        Joint angles at the start, rad.
    """
    board = scenario.board
    R_WT, curvature = board.assumed_pose().rotation(), board.curvature()
    if not curvature.is_plane:
        u, v, _ = scenario.start
        R_WT = R_WT @ RotationMatrix(rotation(curvature, u, v))
    friction = scenario.contact_friction()
    return ArmForceLimit(model, q=q, R_WB=R_WT, friction=friction)
