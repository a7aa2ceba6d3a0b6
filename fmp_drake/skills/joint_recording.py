"""Eraser paths from recorded joint angles of a robot, by forward kinematics."""

import re
import warnings
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import check_type
from fmp_drake.primitives import Demonstration, add_orientation
from fmp_drake.primitives.data.channels import (
    FORCE_CHANNEL,
    FORCE_COMPONENTS,
    POSITION_CHANNELS,
    ROTATION_CHANNELS,
)
from fmp_drake.primitives.data.orientation import rotations_of
from fmp_drake.primitives.data.reading.columns import NO_MEASURED_ANGLES
from fmp_drake.primitives.data.reading.groups import JOINT
from fmp_drake.primitives.data.reading.table import columns_option
from fmp_drake.station import LoadRobot
from fmp_drake.station.robots.robot import DEFAULT_ROBOT, ListRobots, MakeRobotModel
from fmp_drake.station.scenario_parts import EraserConfig

_MARGIN = 0.05  # rad
# Samples and distances between them of which the rotations are compared, and the greatest
# difference relative to these rotations.
_SAMPLES, _LAGS, _AGREES = 200, (1, 20, 67), 0.1
# Words after and before the name of a joint that do not distinguish arms.
_ANGLE = re.compile(r"([_./ ]?(pos(itions?)?|angles?))?([_ ](in_)?(rad|deg))?$")
_OF_A_ROBOT = re.compile(r"^((robot\d*|arm|observation|obs|state|measured)[_./])+")


def RobotJoints(
    demonstration: Demonstration,
    *,
    robot: str = DEFAULT_ROBOT,
    needs_own_names: bool = False,
) -> list[str]:
    """Return the channels of a robot's joints in order, or an empty list.

    It is also empty if several arms were recorded, unless only one of them was measured.

    The channels have the names of the joints in the robot's URDF or YAML file, or are
    numbered from 1 or 0: `iiwa_joint_1`, `joint1`, `q1`.

    Parameters
    ----------
    demonstration : Demonstration
    robot : str
        Name of a robot of the package, or its YAML file.
    needs_own_names : bool
        Whether names that other robots share, such as `q1`, are refused.
    """
    check_type(demonstration, "demonstration", Demonstration, error=DemonstrationError)
    config = LoadRobot(robot)
    names = MakeRobotModel(config).joint_names
    if set(names) <= set(demonstration.channels):
        return names
    # Channels of each arm by the number of the joint; the arms by their names in the channels.
    arms: dict[str, dict[int, str]] = {}
    own = config.joint_prefixes
    others = {p for r in ListRobots() for p in LoadRobot(r).joint_prefixes} - {*own}
    for channel in demonstration.channels:
        bare = _ANGLE.sub("", channel)
        known = [n for n in config.joint_names if f"_{bare}".endswith(f"_{n}")]
        match = JOINT.fullmatch(_OF_A_ROBOT.sub("", bare))
        if known:
            arm = arms.setdefault(bare.removesuffix(known[0]), {})
            arm[config.joint_names.index(known[0]) + 1] = channel
        elif match is None:
            continue
        # The default robot may not have been named: unknown names are not taken for its own.
        elif _has_word(match[1], own) or not (
            needs_own_names
            or (match[1] and robot == DEFAULT_ROBOT)
            or _has_word(match[1], others)
        ):
            arms.setdefault(match[1] or "", {})[int(match[2])] = channel
    ranges = [list(range(first, first + len(names))) for first in (1, 0)]
    complete = {name: arm for name, arm in arms.items() if sorted(arm) in ranges}
    if len(complete) > 1:
        complete = {
            name: arm
            for name, arm in complete.items()
            if not NO_MEASURED_ANGLES.search(name.lower())
        }
    if len(complete) != 1:
        return []
    (numbers,) = complete.values()
    return [numbers[i] for i in sorted(numbers)]


def _has_word(prefix: str | None, words: Collection[str]) -> bool:
    """Return whether a prefix contains one of the words, optionally with a number."""
    return any(
        re.fullmatch(re.escape(word) + r"\d*", part, re.IGNORECASE)
        for part in re.split(r"[\W_]+", prefix or "")
        for word in words
    )


def FindRobot(demonstration: Demonstration, *, robot: str) -> str | None:
    """Return the robot whose joints were recorded, or None.

    Parameters
    ----------
    demonstration : Demonstration
    robot : str
        Robot that is tried first. Other robots of the package are recognised only by joint
        names that are specific to them.
    """
    if RobotJoints(demonstration, robot=robot):
        return robot
    for other in ListRobots():
        if RobotJoints(demonstration, robot=other, needs_own_names=True):
            return other
    return None


def FindRobotOfInverseRotation(demonstration: Demonstration) -> str:
    """Return the bundled robot that turns like the inverse of the orientation, or "".

    A quaternion whose elements are read in the wrong order is the inverse of the right one,
    up to constant rotations. How the robot and the tool are mounted is unknown as well,
    so rotations between samples are compared up to one constant rotation. No robot is
    returned that also turns like the orientation itself, as about a single axis.

    Parameters
    ----------
    demonstration : Demonstration
        Its orientation and its joints are compared, if it has both.
    """
    reference = demonstration.rotation_reference
    if reference is None:
        return ""
    samples = np.unique(
        np.linspace(0, len(demonstration.time) - 1, _SAMPLES).astype(int)
    )
    part = demonstration.rows(samples)
    recorded = rotations_of(part.select(ROTATION_CHANNELS).values, reference)
    for robot in ListRobots():
        joints = RobotJoints(part, robot=robot)
        if not joints:
            continue
        poses = MakeRobotModel(LoadRobot(robot)).tip_poses(part.select(joints).values)
        arm = Rotation.from_matrix([X_WE.rotation().matrix() for X_WE in poses])
        if _turn_alike(recorded, arm.inv()) and not _turn_alike(recorded, arm):
            return robot
    return ""


def _turn_alike(one: Rotation, other: Rotation) -> bool:
    """Return whether rotations (N) differ by constant rotations only."""
    turns = [
        (rotations * rotations[np.roll(np.arange(len(one)), lag)].inv()).as_rotvec()
        for rotations in (one, other)
        for lag in _LAGS
    ]
    ours, theirs = np.split(np.concatenate(turns), 2)
    with warnings.catch_warnings(action="ignore"):  # Turns about one axis.
        _, distance = Rotation.align_vectors(ours, theirs)
    return bool(distance < _AGREES * np.linalg.norm(ours))


def EraserPath(
    demonstration: Demonstration,
    *,
    eraser: EraserConfig | None = None,
    robot: str = DEFAULT_ROBOT,
    with_orientation: bool = False,
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
    with_orientation : bool

    Returns
    -------
    Demonstration
        x, y and z of the eraser's tip in the world, in which the robot's base is at its
        `base_pose`, m. If requested, its orientation rx, ry and rz, rad, and recorded
        forces, unchanged.

    Raises
    ------
    DemonstrationError
        Where the channels are not the robot's joints, or an angle is outside its limits.

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
    joints = RobotJoints(demonstration, robot=robot)
    name = Path(robot).stem
    if not joints:
        raise DemonstrationError(
            f"the channels {', '.join(demonstration.channels)} are not the joints of "
            f"{name}; expected {model.joint_names[0]} to {model.joint_names[-1]}."
        )
    angles = demonstration.select(joints).values
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    outside = (angles < lower - _MARGIN) | (angles > upper + _MARGIN)
    if np.any(outside):
        sample, i = np.argwhere(outside)[0]
        radians = np.deg2rad(angles)
        is_degrees = np.all((lower - _MARGIN < radians) & (radians < upper + _MARGIN))
        advice = (
            "If it is another robot's, name that (--robot), or record the position of its "
            "tool."
        )
        if is_degrees:
            option = columns_option({joint: f"{joint} [deg]" for joint in joints})
            advice = f"Degrees? Add {option}"
        raise DemonstrationError(
            f"{joints[i]} is {angles[sample, i]:.3g} in sample {sample}; joint {i + 1} "
            f"of {name} is limited to {lower[i]:.3g} to {upper[i]:.3g} rad. {advice}"
        )
    poses = model.tip_poses(angles)
    path = replace(
        demonstration,
        values=np.array([X_WE.translation() for X_WE in poses]),
        channels=POSITION_CHANNELS,
        units=("m", "m", "m"),
        frame=config.base,
        rotation_reference=None,
    )
    if not with_orientation:
        return path
    names = (*FORCE_COMPONENTS, FORCE_CHANNEL)
    if forces := [name for name in names if name in demonstration.channels]:
        force = demonstration.select(forces)
        path = replace(
            path,
            values=np.hstack([path.values, force.values]),
            channels=(*path.channels, *force.channels),
            units=(*path.units, *force.units),
        )
    return add_orientation(
        path, Rotation.from_matrix([X_WE.rotation().matrix() for X_WE in poses])
    )
