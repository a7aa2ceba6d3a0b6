"""Scene of every station: arm, eraser and whiteboard."""

from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
)
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Multiplexer

from fmp_drake.errors import StationError
from fmp_drake.numeric import check_type, finite_array
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.models.whiteboard import AddWhiteboard, FilterHull
from fmp_drake.station.reach.posture import SolveStartPosture
from fmp_drake.station.robots.robot import (
    AddRobot,
    FilterSelfContact,
    LoadRobot,
    MakeRobotModel,
    Robot,
    ShowContactGeometry,
    check_posture,
)
from fmp_drake.station.robots.stability import CheckStability
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scenario_parts import BoardConfig, in_one_line
from fmp_drake.systems.joint_friction import JointFriction
from fmp_drake.systems.rail_motion import RailMotion
from fmp_drake.systems.surface.surface import Surface

# Natural frequency of the servo that moves a board, rad/s.
_SERVO = 120.0
# Distance beyond the limit of a joint that a plant permits, rad.
_YIELD = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardScene:
    """Parts of a scene in a builder.

    Attributes
    ----------
    scenario : Scenario
    plant, scene_graph
        Arm, eraser and board. If they are simulated, arm and eraser have no weight, because
        the real arm compensates for it. Otherwise the board has its assumed pose, and
        neither is in the diagram.
    is_simulated : bool
    robot : Robot
        In `plant`.
    model : Robot
        Model of the controller: arm and eraser with their weight, without a board.
    whiteboard : ModelInstanceIndex or None
        None in free space.
    surface : Frame
        B in `plant`.
    curvature : Surface
        Of the board.
    X_WB : RigidTransform
        The board in the world at the start.
    X_WA : RigidTransform
        The controller's assumption of X_WB.
    rail : RailMotion or None
        Desired motion of a board on a rail.

    Examples
    --------
    >>> from pydrake.systems.framework import DiagramBuilder
    >>> from fmp_drake.station import AddBoardScene, Scenario
    >>> scene = AddBoardScene(DiagramBuilder(), Scenario(), start=[0.0, 0.0, 0.05])
    >>> scene.plant.num_positions(), scene.model.plant.num_positions()
    (7, 7)
    """

    scenario: Scenario
    plant: MultibodyPlant
    scene_graph: SceneGraph
    is_simulated: bool
    robot: Robot
    model: Robot
    whiteboard: ModelInstanceIndex | None
    surface: Frame
    curvature: Surface
    X_WB: RigidTransform
    X_WA: RigidTransform
    rail: RailMotion | None


BODIES = ("body_poses", "body_spatial_velocities")
"""Outputs of a plant, and inputs of a system: poses and spatial velocities of bodies."""


def Connect(
    builder: DiagramBuilder, source: System, target: System, *ports: str
) -> None:
    """Connect outputs of a system to the inputs of another one with the same names."""
    for port in ports:
        builder.Connect(source.GetOutputPort(port), target.GetInputPort(port))


def AddBoardScene(
    builder: DiagramBuilder,
    scenario: Scenario,
    *,
    start: ArrayLike,
    q: ArrayLike | None = None,
    simulated: bool = True,
) -> BoardScene:
    """Add the plant with arm, eraser and board, the eraser held at a start.

    The plant is finalized: bodies of your own belong in the scenario's `tool`, a model file.
    A builder takes one simulated scene, because the names of its systems are unique. Build each
    scene in a diagram of its own, and add these by ``DiagramBuilder.AddNamedSystem``.

    Parameters
    ----------
    builder : DiagramBuilder
    scenario : Scenario
    start : array_like, shape (3,)
        p_BE, m, in the frame of the assumed board.
    q : array_like, shape (n,), optional
        Initial joint angles instead of those for the start, rad.
    simulated : bool
        Whether the plant is simulated, or only describes a real robot.

    Raises
    ------
    StationError
        If the scenario has invalid values, the arm cannot reach the start, or the builder
        has a scene.
    """
    check_type(scenario, "scenario", Scenario, error=StationError)
    for name in ("plant", "scene_graph"):
        if simulated and builder.HasSubsystemNamed(name):
            raise StationError(
                f"the builder already has a system named {name}, as a scene names its own; "
                "build each scene in a diagram of its own."
            )
    start = finite_array(start, "start", (3,), error=StationError)
    started = copy(scenario)
    started.start = start.tolist()
    started.check()
    if not simulated and scenario.board.motion.amplitude > 0:
        raise StationError(
            f"board.motion.amplitude is {scenario.board.motion.amplitude} m; the motion "
            "of a real board is not measured. Set it to 0."
        )
    config = LoadRobot(scenario.robot)
    model = MakeRobotModel(config, scenario.held_tool())
    CheckStability(model, scenario.impedance, delay=scenario.sensors.delay)
    if simulated:
        with in_one_line("the scenario's plant cannot be built"):
            plant, scene_graph = AddMultibodyPlant(scenario.plant, builder)
    else:
        plant, scene_graph = MultibodyPlant(time_step=0.0), SceneGraph()
        plant.RegisterAsSourceForSceneGraph(scene_graph)
    robot = AddRobot(plant, config, scenario.held_tool())
    for instance in (robot.arm, robot.tool):
        plant.set_gravity_enabled(instance, False)
    board = scenario.board
    X_WB = board.pose() if simulated else board.assumed_pose()
    whiteboard = None
    if not scenario.has_board:
        fixed = FixedOffsetFrame("surface", plant.world_frame(), X_WB, robot.tool)
        surface = plant.AddFrame(fixed)
        if scenario.scenery == "pot":
            (pot,) = Parser(plant).AddModels(str(models_dir() / "pot" / "pot.sdf"))
            plant.WeldFrames(surface, plant.GetFrameByName("pot", pot))
    else:
        whiteboard = AddWhiteboard(plant, board)
        surface = plant.GetFrameByName("surface", whiteboard)
        _Mount(plant, whiteboard, board, X_WB)
    plant.Finalize()
    FilterSelfContact(robot, scene_graph)
    ShowContactGeometry(robot, scene_graph)
    if whiteboard is not None and min(board.curvature()) < 0:
        FilterHull(plant, scene_graph, whiteboard)

    displacement = board.start_displacement()
    X_WA = board.assumed_pose() @ displacement
    if q is None:
        q = SolveStartPosture(scenario, model, start)
    posture = finite_array(q, "q", (len(config.posture),), error=StationError)
    limits = model.plant.GetPositionLowerLimits(), model.plant.GetPositionUpperLimits()
    # An arm that is pushed against a limit is a little beyond it.
    nearest = np.clip(posture, *limits)
    posture = np.where(np.abs(posture - nearest) < _YIELD, nearest, posture)
    with in_one_line("q is not in the joints' ranges"):
        check_posture(posture.tolist(), model.joint_names, *limits)
    plant.SetDefaultPositions(robot.arm, posture)
    if simulated and scenario.friction.enabled:
        completed = scenario.friction.completed(config.friction)
        friction = builder.AddSystem(
            JointFriction(plant, arm=robot.arm, config=completed)
        )
        state = plant.get_state_output_port(robot.arm)
        builder.Connect(state, friction.get_input_port())
        force = plant.get_applied_generalized_force_input_port()
        builder.Connect(friction.get_output_port(), force)
    return BoardScene(
        scenario=scenario,
        plant=plant,
        scene_graph=scene_graph,
        is_simulated=simulated,
        robot=robot,
        model=model,
        whiteboard=whiteboard,
        surface=surface,
        curvature=board.curvature(),
        X_WB=X_WB @ displacement,
        X_WA=X_WA,
        rail=_AddRail(builder, plant, whiteboard, scenario),
    )


def _Mount(
    plant: MultibodyPlant,
    whiteboard: ModelInstanceIndex,
    board: BoardConfig,
    X_WB: RigidTransform,
) -> None:
    """Weld a board to the world, or mount it on the joint `rail` with a stiff servo."""
    surface = plant.GetFrameByName("surface", whiteboard)
    if board.motion.amplitude == 0:
        plant.WeldFrames(plant.world_frame(), surface, X_WB)
        return
    middle = plant.AddFrame(
        FixedOffsetFrame("rail", plant.world_frame(), X_WB, whiteboard)
    )
    rail: Any = plant.AddJoint(
        PrismaticJoint("rail", middle, surface, board.rail_axis())
    )
    rail.set_default_translation(-board.motion.amplitude)
    mass = plant.GetBodyByName("board", whiteboard).default_mass()
    plant.AddJointActuator("rail", rail).set_controller_gains(
        PdControllerGains(p=mass * _SERVO**2, d=2 * mass * _SERVO)
    )


def _AddRail(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    whiteboard: ModelInstanceIndex | None,
    scenario: Scenario,
) -> RailMotion | None:
    """Add the desired motion of a board on a rail: systems rail and rail_state."""
    motion = scenario.board.motion
    if whiteboard is None or motion.amplitude == 0:
        return None
    rail = RailMotion(amplitude=motion.amplitude, frequency=motion.frequency)
    builder.AddSystem(rail)
    state = builder.AddNamedSystem("rail_state", Multiplexer(2))
    for i, name in enumerate(("position", "velocity")):
        builder.Connect(rail.GetOutputPort(name), state.get_input_port(i))
    builder.Connect(
        state.get_output_port(), plant.get_desired_state_input_port(whiteboard)
    )
    return rail
