"""Postures of the arm for a wanted pose of the eraser."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.solvers import Solve

from fmp_drake.errors import StationError
from fmp_drake.numeric import finite_array
from fmp_drake.station.robots.robot import Robot

_POSITION_TOLERANCE = 1e-6
_ROTATION_TOLERANCE = 1e-5
_LIMIT_MARGIN = 0.03
# Height of the felt in `FindLevelReach`, m.
_LEVEL_HEIGHT = 0.10


def SolvePosture(
    plant: MultibodyPlant,
    *,
    frame: Frame,
    X_WE: RigidTransform,
    q_preferred: ArrayLike,
) -> NDArray[np.float64]:
    """Find joint angles that put a frame at a pose, near preferred ones.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized; its joints are the arm's.
    frame : Frame
        E.
    X_WE : RigidTransform
        Wanted pose in the world.
    q_preferred : array_like, shape (n,)
        rad.

    Returns
    -------
    ndarray, shape (n,)
        Inside the joint limits by at least 0.03 rad.

    Raises
    ------
    StationError
        Where the arm cannot reach the pose.
    """
    n = plant.num_positions()
    preferred = finite_array(q_preferred, "the posture", (n,), error=StationError)
    p = finite_array(X_WE.translation(), "the eraser's position", error=StationError)
    ik = InverseKinematics(plant)
    world = plant.world_frame()
    ik.AddPositionConstraint(
        frame, np.zeros(3), world, p - _POSITION_TOLERANCE, p + _POSITION_TOLERANCE
    )
    ik.AddOrientationConstraint(
        world, X_WE.rotation(), frame, type(X_WE.rotation())(), _ROTATION_TOLERANCE
    )
    lower = plant.GetPositionLowerLimits() + _LIMIT_MARGIN
    upper = plant.GetPositionUpperLimits() - _LIMIT_MARGIN
    program = ik.prog()
    program.AddBoundingBoxConstraint(lower, upper, ik.q())
    program.AddQuadraticErrorCost(np.eye(n), preferred, ik.q())
    program.SetInitialGuess(ik.q(), np.clip(preferred, lower, upper))
    result = Solve(program)
    if not result.is_success():
        x, y, z = p
        raise StationError(
            f"the arm cannot bring the eraser to ({x:.3f}, {y:.3f}, {z:.3f}) m from "
            "its base with the eraser level on the board; choose a point nearer to "
            "the middle of the board."
        )
    return result.GetSolution(ik.q())


def FindLevelReach(robot: Robot) -> float:
    """Find the greatest x at which an arm holds the eraser level, 0.1 m high, m.

    The search along x has steps of 1 cm.

    Parameters
    ----------
    robot : Robot
        Of `MakeRobotModel`.

    Raises
    ------
    StationError
        Where the arm reaches nothing from 0.2 to 2 m.
    """
    level = RotationMatrix(RollPitchYaw(np.array([np.pi, 0.0, 0.0])))
    for x in np.arange(2.0, 0.2, -0.01):
        X_WE = RigidTransform(level, np.array([x, 0.0, _LEVEL_HEIGHT]))
        try:
            SolvePosture(
                robot.plant,
                frame=robot.tip,
                X_WE=X_WE,
                q_preferred=robot.config.posture,
            )
        except StationError:
            continue
        return float(x)
    raise StationError(
        f"{Path(robot.config.model).stem} cannot hold the eraser level anywhere from "
        f"0.2 to 2 m in front of it, {_LEVEL_HEIGHT:g} m high; check its mount and posture."
    )
