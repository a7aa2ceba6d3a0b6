"""The primitive that moves a robot, wired to it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import Demultiplexer, MatrixGain

from fmp_drake.errors import SkillError, StationError
from fmp_drake.primitives import FourierMovementPrimitive, Tracker
from fmp_drake.primitives.data.channels import ChannelRoles, channel_roles
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scenario_parts import SkillConfig
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.ink.coverage_choice import CoverageChoice
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.surface.surface import Surface
from fmp_drake.systems.task_motion import TaskMotion

DESIRED = ("desired_position", "desired_velocity", "desired_acceleration")
"""Inputs of a robot, and outputs of `AddSkillMotion`'s second system, in its order."""


_FRAME = ("task_frame", "task_frame_velocity", "task_frame_acceleration")
_ESTIMATOR = "normal_force_estimator"


def ChoiceByInk(
    scenario: Scenario, skill: FourierMovementPrimitive, grid: InkGrid
) -> tuple[CoverageChoice | None, NDArray[np.bool_] | None]:
    """Return how samples are chosen by the ink, if they are, and what is to be cleaned.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted; the area is what its demonstrations passed over, None where it knows none.
    grid : InkGrid
        Of the ink.
    """
    x, y = scenario.eraser.footprint
    position = SkillRoles(skill).position
    paths = [path[:, position] for path in skill.paths_]
    area = grid.swept_by(paths, (x, y)) if paths else None
    candidates = scenario.skill.candidates
    if candidates == 1:
        return None, area
    choice = CoverageChoice(
        grid=grid,
        footprint=(x, y),
        candidates=candidates,
        area=area,
        position=position,
    )
    return choice, area


def SkillRoles(skill: FourierMovementPrimitive) -> ChannelRoles:
    """Find position, rotation and force among the channels of a fitted skill.

    Raises
    ------
    StationError
        If a robot cannot play the skill: it has no position, or a channel without a role.
    """
    skill.check_fitted()
    if skill.n_channels_ == 3 and set(skill.units_) == {"m"}:
        return ChannelRoles(position=(0, 1, 2))
    try:
        return channel_roles(
            skill.channels_, skill.units_, rotation_reference=skill.rotation_reference_
        )
    except SkillError as error:
        raise StationError(f"this skill cannot be played: {error}") from None


def CheckForceChannel(scenario: Scenario, roles: ChannelRoles) -> None:
    """Refuse a skill with a force channel where there is nothing to press on.

    Raises
    ------
    StationError
    """
    if roles.force is not None and not scenario.has_board:
        raise StationError(
            "the skill has a force channel, and board.shape is none: there is nothing to "
            "press on. Take a scenario with a board, or learn the skill without the channel."
        )


def AddSkillMotion(
    builder: DiagramBuilder,
    skill: FourierMovementPrimitive,
    plays: SkillConfig,
    robot: System,
    *,
    roles: ChannelRoles,
    X_WS: RigidTransform,
    surface: Surface | None = None,
    tracker: Tracker | None = None,
    sample: bool | None = None,
    seed: int | None = None,
    choice: CoverageChoice | None = None,
) -> tuple[FourierPrimitiveSystem, Any, TaskMotion | None]:
    """Add systems fourier_primitive and desired_motion, and let a robot follow them.

    A skill of more than positions, or one on a curved surface, is turned into the inputs of
    the robot by the system task_motion.

    Parameters
    ----------
    builder : DiagramBuilder
    skill : FourierMovementPrimitive
        Fitted.
    plays : SkillConfig
        How it is played.
    robot : System
        With the outputs measured_position and measured_pose, and the inputs of the
        impedance controller.
    roles : ChannelRoles
        Of the skill.
    X_WS : RigidTransform
        The surface in the world.
    surface : Surface, optional
        A plane where None.
    tracker, choice
        As for `FourierPrimitiveSystem`.
    sample, seed : optional
        Instead of those of `plays`.

    Returns
    -------
    FourierPrimitiveSystem
    Demultiplexer
        Of the desired position, velocity and acceleration.
    TaskMotion or None
        Its desired_normal_force is not connected here.
    """
    primitive = FourierPrimitiveSystem(
        skill,
        tracker=tracker,
        sample=plays.sample if sample is None else sample,
        seed=plays.seed if seed is None else seed,
        push_threshold=plays.push_threshold,
        push_dwell=plays.push_dwell,
        choice=choice,
        margin=plays.margin if skill.paths_ else None,
        soft_start=True,
    )
    builder.AddSystem(primitive)
    motion = primitive.GetOutputPort("motion")
    # One evaluation of the motion for all of its parts.
    desired = builder.AddNamedSystem("desired_motion", Demultiplexer([3, 3, 3]))
    surface = surface or Surface()
    if roles.count == 3 and surface.is_plane:
        measured = robot.GetOutputPort("measured_position")
        builder.Connect(measured, primitive.GetInputPort("measured_position"))
        builder.Connect(motion, desired.get_input_port())
        for order, name in enumerate(DESIRED):
            builder.Connect(desired.get_output_port(order), robot.GetInputPort(name))
        return primitive, desired, None
    d = roles.count
    rows = [order * d + i for order in range(3) for i in roles.position]
    position = builder.AddNamedSystem("skill_position", MatrixGain(np.eye(3 * d)[rows]))
    builder.Connect(motion, position.get_input_port())
    builder.Connect(position.get_output_port(), desired.get_input_port())
    # On a rail a curved surface moves under a task frame that moves itself.
    on_rail = builder.HasSubsystemNamed("task_frame") and not surface.is_plane
    task = TaskMotion(roles, surface, X_WS=X_WS, is_moving=on_rail)
    builder.AddSystem(task)
    for name in _FRAME if on_rail else ():
        frame = builder.GetSubsystemByName(name).get_output_port()
        builder.Connect(frame, task.GetInputPort(name.replace("task", "surface")))
    if task.HasOutputPort("task_frame") and builder.HasSubsystemNamed(_ESTIMATOR):
        estimator = builder.GetSubsystemByName(_ESTIMATOR)
        frame = task.GetOutputPort("task_frame")
        builder.Connect(frame, estimator.GetInputPort("task_frame"))
    builder.Connect(motion, task.GetInputPort("motion"))
    pose = robot.GetOutputPort("measured_pose")
    builder.Connect(pose, task.GetInputPort("measured_pose"))
    measured = task.GetOutputPort("measured")
    builder.Connect(measured, primitive.GetInputPort("measured_position"))
    for i in range(task.num_output_ports()):
        port = task.get_output_port(i)
        if port.get_name() not in ("measured", "desired_normal_force"):
            builder.Connect(port, robot.GetInputPort(port.get_name()))
    return primitive, desired, task


def AddCoordinates(
    builder: DiagramBuilder, task: TaskMotion, roles: ChannelRoles
) -> OutputPort:
    """Return the measured position (3,) among the measured channels of a skill, m.

    System: measured_coordinates.
    """
    rows = np.eye(roles.count)[list(roles.position)]
    part = builder.AddNamedSystem("measured_coordinates", MatrixGain(rows))
    builder.Connect(task.GetOutputPort("measured"), part.get_input_port())
    return part.get_output_port()


def AddPositionCovariance(
    builder: DiagramBuilder, primitive: FourierPrimitiveSystem, roles: ChannelRoles
) -> OutputPort:
    """Return the covariance of the desired position (9,), m^2, of a skill of any channels.

    System: position_covariance, where the skill has more channels than the position.
    """
    covariance = primitive.GetOutputPort("covariance")
    if (d := roles.count) == 3:
        return covariance
    rows = [i * d + j for i in roles.position for j in roles.position]
    part = builder.AddNamedSystem(
        "position_covariance", MatrixGain(np.eye(d * d)[rows])
    )
    builder.Connect(covariance, part.get_input_port())
    return part.get_output_port()
