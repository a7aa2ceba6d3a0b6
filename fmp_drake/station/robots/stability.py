"""Stability of the springs and dampers of a sampled controller, with delayed sensors."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import Context
from scipy.linalg import eigh

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array
from fmp_drake.station.robots.robot import Robot
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.interface.arm_model import check_limits, joint_limits

# Greatest delay, relative to the one at which the springs are unstable. Runs of the Panda, the
# iiwa and the UR5e pressed as without a delay up to 0.6, and ended in stops from 1.0, 0.73 and
# 0.76: contact and limits of joints have delays of their own.
_DELAY_FRACTION = 0.6
# Candidates for the reflected inertia that an error recommends, kg m², and the estimate for
# each joint of the iiwa and the UR5e.
_CANDIDATES, _TYPICAL = np.geomspace(1e-4, 10.0, 101), 0.1


def stability_ratio(stiffness: ArrayLike, damping: ArrayLike, period: float) -> Array:
    """Return the stiffness of a sampled spring relative to the largest stable one.

    A controller reads the state at the time ``t`` and applies the torque one period ``h``
    later. With ``a² = k h²`` and ``c = d h`` the loop has the characteristic polynomial
    ``z³ − 2 z² + (1 + c + a²) z − c``. By Jury's criterion it is stable for
    ``a² < c (1 − c)`` and ``c < 1``. With a damping ratio ζ, ``c = 2 ζ a``, this is
    ``a < 2 ζ / (1 + 4 ζ²)``.

    Parameters
    ----------
    stiffness, damping : array_like, shape (n,)
        ``k`` and ``d`` per unit of inertia, 1/s² and 1/s.
    period : float
        ``h``, s.

    Returns
    -------
    array, shape (n,)
        Less than 1 for a stable loop.

    Examples
    --------
    >>> stability_ratio([2500.0], [100.0], 0.001).round(3)
    array([0.028])
    """
    c = np.multiply(damping, period)
    largest = np.maximum(c * (1 - c), 1e-12)
    return np.asarray(np.multiply(stiffness, period**2) / largest)


def stability_limit(stiffness: float, damping_ratio: float) -> float:
    """Return the shortest delay with which a damped spring is unstable, s.

    With a delay T the loop ``ẍ + 2 ζ ω ẋ(t − T) + ω² x(t − T) = 0`` has a gain of 1 at
    ``ω ρ``, ``ρ² = 2 ζ² + √(4 ζ⁴ + 1)``. Its phase margin there is ``arctan(2 ζ ρ)``.

    Parameters
    ----------
    stiffness : float
        ``ω²``, 1/s².
    damping_ratio : float
        ``ζ``.

    Examples
    --------
    >>> round(stability_limit(625.0, 1.0), 4)
    0.0259
    """
    square = damping_ratio**2
    rho = math.sqrt(2 * square + math.sqrt(4 * square**2 + 1))
    return math.atan(2 * damping_ratio * rho) / (rho * math.sqrt(stiffness))


def CheckStability(
    robot: Robot, config: ImpedanceConfig, *, delay: float = 0.0
) -> None:
    """Check that the controller is stable at its period and with the delay of its sensors.

    The springs at the joint limits and those of the tool make a light joint oscillate with
    a growing amplitude, see `stability_ratio`. A model without the inertia of its motors
    has such joints in its wrist. A long delay does the same to the arm, see
    `stability_limit`, and so do the springs at two limits that are too near to each other.

    Parameters
    ----------
    robot : Robot
        In a finalized plant that holds nothing else. Its posture is checked.
    config : ImpedanceConfig
    delay : float, optional
        Of the measured state, s.

    Raises
    ------
    StationError
        With the lightest joint and the reflected inertia that is sufficient, with the
        longest delay, or with a joint that does not bear the weight in the posture.
    SystemsError
        With the joint whose springs meet.

    Examples
    --------
    >>> from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel
    >>> CheckStability(MakeRobotModel(LoadRobot("panda")), ImpedanceConfig())
    """
    plant = robot.plant
    check_limits(plant, config.walls.width)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.array(robot.config.posture))
    limits = joint_limits(plant)
    _check_weight(robot, context, limits)
    M = plant.CalcMassMatrix(context)
    J = plant.CalcJacobianSpatialVelocity(
        context,
        JacobianWrtVariable.kV,
        robot.tip,
        np.zeros(3),
        plant.world_frame(),
        robot.tip,
    )
    if delay > 0:
        stiffest = eigh(J.T @ config.stiffness() @ J, M, eigvals_only=True)[-1]
        limit = stability_limit(stiffest, config.damping_ratio)
        # A torque acts one and a half periods after the state that it is computed from.
        longest = _DELAY_FRACTION * limit - 1.5 * config.control_period
        if delay > longest:
            raise StationError(
                f"sensors.delay is {delay:g} s. The springs of the controller would make the "
                f"arm oscillate; it may be at most {max(longest, 0.0):.2g} s with this arm "
                "and stiffness."
            )
    effort = np.minimum(limits.upper_effort, -limits.lower_effort)
    ratios = _ratios(config, M, J, effort)
    if np.max(ratios) < 1:
        return
    i, motors = int(np.argmax(ratios)), np.eye(len(M))
    for needed in _CANDIDATES:
        if np.max(_ratios(config, M + needed * motors, J, effort)) < 1:
            break
    else:
        raise StationError(
            f"impedance.control_period is {config.control_period:g} s; with it no arm is "
            f"stable in its springs. Choose a shorter one, or correct {robot.joint_names[i]}'s "
            f"effort limit of {effort[i]:g} Nm."
        )
    raise StationError(
        f"{robot.joint_names[i]} of {Path(robot.config.model).name} has an inertia of only "
        f"{1 / np.linalg.inv(M)[i, i]:.2g} kg m². The controller's springs would make it "
        f"oscillate at a control period of {config.control_period:g} s. Give the inertia of "
        f"the motors as seen at the joints, at least {needed:.2g} kg m², in the robot's YAML "
        f"file: reflected_inertia: [{max(_TYPICAL, needed):.2g}]"
    )


def _check_weight(robot: Robot, context: Context, limits: JointLimits) -> None:
    """Check that the effort limits are above the torques of the weight in a posture."""
    plant = robot.plant
    weight = -plant.CalcGravityGeneralizedForces(context)
    effort = np.where(weight > 0, limits.upper_effort, -limits.lower_effort)
    i = int(np.argmax(np.abs(weight) / effort))
    if abs(weight[i]) > effort[i]:
        mass = plant.CalcTotalMass(context, [robot.arm, robot.tool])
        raise StationError(
            f"{robot.joint_names[i]} of {Path(robot.config.model).name} needs "
            f"{abs(weight[i]):.1f} Nm to hold the weight of {mass:.1f} kg in the posture; its "
            f"effort limit is {effort[i]:g} Nm. Correct the masses of the links, kg, or the "
            "effort limit."
        )


def _ratios(config: ImpedanceConfig, M: Array, J: Array, effort: Array) -> Array:
    """Return the greatest `stability_ratio` of each joint's springs, shape (n,).

    Parameters
    ----------
    config : ImpedanceConfig
    M : array, shape (n, n)
        Mass matrix, kg m².
    J : array, shape (6, n)
        Jacobian of the tool in the axes of the stiffness.
    effort : array, shape (n,)
        Effort limits, Nm; infinite where there is none.
    """
    period, walls = config.control_period, config.walls
    # Angular acceleration of each joint by a unit of its own torque, 1/(kg m²).
    flexibility = np.diag(np.linalg.inv(M))
    stiffness = 2 * np.where(np.isfinite(effort), effort, 0.0) / walls.width
    damping = np.diag(M) / walls.braking_time
    ratios = stability_ratio(flexibility * stiffness, flexibility * damping, period)
    # The modes of the tool in its springs; the lightest joint moves most in the fastest.
    squares, modes = eigh(J.T @ config.stiffness() @ J, M)
    damping = 2 * config.damping_ratio * np.sqrt(squares[-1])
    tool = stability_ratio(squares[-1], damping, period)
    i = int(np.argmax(np.abs(modes[:, -1])))
    ratios[i] = max(ratios[i], tool)
    return ratios
