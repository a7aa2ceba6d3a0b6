"""Eraser paths from recorded joint angles of a robot, by forward kinematics."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import Demonstration
from fmp_drake.primitives.data.channels import POSITION_CHANNELS
from fmp_drake.primitives.data.reading.table import columns_option
from fmp_drake.station import LoadRobot
from fmp_drake.station.robots.robot import MakeRobotModel
from fmp_drake.station.scenario_parts import EraserConfig

# Prefix, if any, and number of a joint; prefixes of a Panda and of other robots.
_JOINT = re.compile(
    r"(?:(.*)_)?(?:joints?|q|j|a)[_.]?(\d)(?:[_.]pos(?:ition)?)?", re.IGNORECASE
)
# Joints of Universal Robots in their order, as their drivers name them.
_UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_UR_JOINT = re.compile(rf"(?:(.*)_)?({'|'.join(_UR_JOINTS)})_joint")
_PANDA = re.compile(r".*(?:panda|fr3|franka|fer)\d*", re.IGNORECASE)
_OTHER = re.compile(r"(?!.*(?:panda|fr3|franka)).*", re.IGNORECASE)
_MARGIN = 0.05  # rad


def RobotJoints(
    demonstration: Demonstration,
    *,
    robot: str = "panda",
    plant: MultibodyPlant | None = None,
) -> list[str]:
    """Return the channels of a robot's joints in order, or an empty list.

    They have the names of the joints in the robot's URDF, or are numbered from 1 or 0:
    `iiwa_joint_1`, `joint1`, `q1`; a Panda's also `fr3_joint1`, a UR5e's `elbow_joint`.

    Parameters
    ----------
    demonstration : Demonstration
    robot : str
        Name of a robot of the package, or its YAML file.
    plant : MultibodyPlant, optional
        Model of that robot, if there is one already.
    """
    names = _joint_names(plant or MakeRobotModel(LoadRobot(robot)).plant)
    if set(names) <= set(demonstration.channels):
        return names
    prefix = _PANDA if robot == "panda" else _OTHER
    numbers = {}
    for channel in demonstration.channels:
        match = _JOINT.fullmatch(channel)
        if match and (match[1] is None or prefix.fullmatch(match[1])):
            numbers[int(match[2])] = channel
        elif match := _UR_JOINT.fullmatch(channel):
            numbers[_UR_JOINTS.index(match[2]) + 1] = channel
    for first in (1, 0):
        if sorted(numbers) == list(range(first, first + len(names))):
            return [numbers[i] for i in sorted(numbers)]
    return []


def _joint_names(plant: MultibodyPlant) -> list[str]:
    joints = [plant.get_joint(JointIndex(i)) for i in range(plant.num_joints())]
    moving = [joint for joint in joints if joint.num_positions() == 1]
    return [j.name() for j in sorted(moving, key=lambda j: int(j.position_start()))]


def EraserPath(
    demonstration: Demonstration,
    *,
    eraser: EraserConfig | None = None,
    robot: str = "panda",
) -> Demonstration:
    """Return the path of the eraser for recorded joint angles of a robot.

    Parameters
    ----------
    demonstration : Demonstration
        With the channels of `RobotJoints`, rad.
    eraser : EraserConfig, optional
        The default one where None.
    robot : str
        Name of a robot of the package, or its YAML file.

    Returns
    -------
    Demonstration
        x, y and z of the eraser's tip in the frame of the robot's base, m: `panda_link0`.

    Raises
    ------
    DemonstrationError
        Where a joint is not the robot's, for it leaves its limits.

    Examples
    --------
    >>> posture = [0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4]
    >>> joints = Demonstration(
    ...     time=np.arange(4) / 20,
    ...     values=np.tile(posture, (4, 1)),
    ...     channels=tuple(f"panda_joint{i}" for i in range(1, 8)),
    ...     units=("rad",) * 7,
    ... )
    >>> EraserPath(joints).values[0].round(2) + 0.0
    array([0.31, 0.  , 0.49])
    """
    config = LoadRobot(robot)
    model = MakeRobotModel(config, eraser)
    plant = model.plant
    joints = RobotJoints(demonstration, robot=robot, plant=plant)
    whose = "Panda" if robot == "panda" else Path(robot).stem
    if not joints:
        names = _joint_names(plant)
        raise DemonstrationError(
            f"the channels {', '.join(demonstration.channels)} are no {whose}'s joints; "
            f"expected {names[0]} to {names[-1]}."
        )
    angles = demonstration.select(joints).values
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    outside = (angles < lower - _MARGIN) | (angles > upper + _MARGIN)
    if np.any(outside):
        sample, i = np.argwhere(outside)[0]
        radians = np.deg2rad(angles)
        is_degrees = np.all((lower - _MARGIN < radians) & (radians < upper + _MARGIN))
        advice = (
            "Of another robot, name it (--robot), or record the position of its tool."
        )
        if is_degrees:
            option = columns_option({name: f"{name} [deg]" for name in joints})
            advice = f"Degrees? Add {option}"
        raise DemonstrationError(
            f"{joints[i]} is {angles[sample, i]:.3g} in sample {sample}; a {whose}'s joint "
            f"{i + 1} is from {lower[i]:.3g} to {upper[i]:.3g} rad. {advice}"
        )
    context = plant.CreateDefaultContext()
    path = np.empty((len(angles), 3))
    for i, q in enumerate(angles):
        plant.SetPositions(context, q)
        path[i] = model.tip.CalcPoseInWorld(context).translation()
    return replace(
        demonstration,
        values=path,
        channels=POSITION_CHANNELS,
        units=("m", "m", "m"),
        frame=config.base,
        rotation_reference=None,
    )
