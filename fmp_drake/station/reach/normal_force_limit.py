"""Greatest normal force of an arm on a board."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RotationMatrix
from pydrake.multibody.tree import JacobianWrtVariable

from fmp_drake.errors import StationError
from fmp_drake.station.robots.robot import Robot
from fmp_drake.station.scene import BoardScene
from fmp_drake.systems.surface.surface import rotation

_FRACTION = 0.8


def ArmForceLimit(
    model: Robot,
    *,
    q: ArrayLike,
    R_WB: RotationMatrix,
    friction: float,
) -> float:
    """Return the largest normal force within an arm's torque limits in a posture, N.

    A press F along -z of B goes with a friction of mu F along any edge of the board. The
    joints bear ``tau = g(q) + J^T F (-z + mu t)``, t any of +-x and +-y; the press is the
    largest at which no joint needs more than 80 % of its effort. The rest is for the
    motion, which takes a few percent when wiping.

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
    remaining = _FRACTION * arm.GetEffortUpperLimits() - holding_torque
    return float(max(0.0, np.min(remaining / np.maximum(np.abs(per_newton), 1e-9))))


def CheckNormalForce(scene: BoardScene) -> None:
    """Raise an error for a normal force above the arm's torque limits at the start.

    Raises
    ------
    StationError
    """
    scenario = scene.scenario
    u, v, _ = scenario.start
    R_BT = RotationMatrix(rotation(scene.curvature, u, v))
    limit = ArmForceLimit(
        scene.model,
        q=scene.robot.default_posture,
        R_WB=scene.X_WA.rotation() @ R_BT,
        friction=scenario.contact_friction(),
    )
    if scenario.press.force > limit:
        raise StationError(
            f"press.force is {scenario.press.force:g} N; at the start the arm can press "
            f"with {limit:.1f} N without a joint at more than {100 * _FRACTION:.0f} % of "
            "its torque. Press less, or move the board nearer to the base."
        )
