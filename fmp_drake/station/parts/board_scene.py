"""The scene that every station shares: arm, eraser and whiteboard."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import CollisionFilterDeclaration, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
)
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Multiplexer, Sine

from fmp_drake.errors import StationError
from fmp_drake.numeric import check_number, finite_array
from fmp_drake.station.models.model_files import AddPandaWithEraser
from fmp_drake.station.models.whiteboard import AddWhiteboard
from fmp_drake.station.parts.posture import SolvePosture
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scenario_parts import BoardConfig
from fmp_drake.systems.joint_friction import JointFriction

# The servo of a moving board: its natural frequency, rad/s.
_SERVO = 120.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardScene:
    """The parts of a scene that was added to a builder.

    Attributes
    ----------
    plant, scene_graph
        What is simulated: arm, eraser and board. Arm and eraser have no weight, because
        the real arm compensates it by itself.
    panda, whiteboard : ModelInstanceIndex
        In `plant`.
    tip, surface : Frame
        E and B in `plant`.
    arm : MultibodyPlant
        What the controller knows: the arm and its eraser with their weight, no board.
    arm_tip : Frame
        E in `arm`.
    X_WB : RigidTransform
        The board in the world at time 0.
    X_WA : RigidTransform
        The assumed board: what the controller takes for X_WB.
    rail : Sine or None
        The wanted motion of a board on a rail: position, velocity, acceleration.

    Examples
    --------
    >>> from pydrake.systems.framework import DiagramBuilder
    >>> from fmp_drake.station import AddBoardScene, Scenario
    >>> scene = AddBoardScene(DiagramBuilder(), Scenario(), start=[0.0, 0.0, 0.05])
    >>> scene.plant.num_positions(), scene.arm.num_positions()
    (7, 7)
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    panda: ModelInstanceIndex
    whiteboard: ModelInstanceIndex
    tip: Frame
    surface: Frame
    arm: MultibodyPlant
    arm_tip: Frame
    X_WB: RigidTransform
    X_WA: RigidTransform
    rail: Sine | None


def AddBoardScene(
    builder: DiagramBuilder,
    scenario: Scenario,
    *,
    start: ArrayLike,
    q: ArrayLike | None = None,
    visuals: str = "own",
) -> BoardScene:
    """Add the plant with arm, eraser and board, the eraser held at a start.

    Parameters
    ----------
    builder : DiagramBuilder
    scenario : Scenario
    start : array_like, shape (3,)
        p_BE, m: where the board is assumed to be.
    q : array_like, shape (7,), optional
        Joint angles in which the arm begins instead, wherever the eraser then is, rad.
    visuals : str
        Of the arm: `own` or `drake_models`.

    Raises
    ------
    StationError
        Where the scenario has values that do not fit, or the arm cannot reach the start.
    """
    scenario.check()
    arm, arm_tip = MakeArm(scenario)
    plant, scene_graph = _AddPlant(builder, scenario)
    panda, eraser = AddPandaWithEraser(plant, eraser=scenario.eraser, visuals=visuals)
    for carried in (panda, eraser):
        plant.set_gravity_enabled(carried, False)
    board = scenario.board
    whiteboard = AddWhiteboard(plant, board)
    _Mount(plant, whiteboard, board)
    plant.Finalize()
    _FilterSelfContact(plant, scene_graph, panda, eraser)

    moved = RigidTransform(-board.motion.amplitude * board.axis())
    X_WA = board.assumed_pose() @ moved
    if q is None:
        X_AE = RigidTransform(
            scenario.eraser_orientation(), np.asarray(start, dtype=float)
        )
        q = SolvePosture(
            arm, frame=arm_tip, X_WE=X_WA @ X_AE, q_preferred=scenario.posture
        )
    posture = finite_array(q, "q", (len(scenario.posture),), error=StationError)
    plant.SetDefaultPositions(panda, posture)
    if scenario.friction.enabled:
        friction = builder.AddSystem(
            JointFriction(plant, arm=panda, config=scenario.friction)
        )
        builder.Connect(
            plant.get_state_output_port(panda), friction.GetInputPort("state")
        )
        builder.Connect(
            friction.get_output_port(),
            plant.get_applied_generalized_force_input_port(),
        )
    return BoardScene(
        plant=plant,
        scene_graph=scene_graph,
        panda=panda,
        whiteboard=whiteboard,
        tip=plant.GetFrameByName("eraser_tip", eraser),
        surface=plant.GetFrameByName("surface", whiteboard),
        arm=arm,
        arm_tip=arm_tip,
        X_WB=board.pose() @ moved,
        X_WA=X_WA,
        rail=_AddRail(builder, plant, whiteboard, scenario),
    )


def _FilterSelfContact(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    panda: ModelInstanceIndex,
    eraser: ModelInstanceIndex,
) -> None:
    """Of the robot let only the first links and the last ones touch each other.

    Neighbours overlap, and the others cannot meet within the joints' ranges.
    """
    links = [plant.GetBodyByName(f"panda_link{i}", panda) for i in range(8)]
    tool = plant.GetBodyByName("eraser", eraser)
    for bodies in (links[:5], [*links[3:], tool]):
        scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeWithin(
                plant.CollectRegisteredGeometries(bodies)
            )
        )


def MakeArm(scenario: Scenario) -> tuple[MultibodyPlant, Frame]:
    """Make what the controller knows: a plant of the arm and its eraser, and E in it."""
    arm = MultibodyPlant(time_step=0.0)
    arm.set_name("arm")
    _, eraser = AddPandaWithEraser(arm, eraser=scenario.eraser)
    arm.Finalize()
    return arm, arm.GetFrameByName("eraser_tip", eraser)


def _Mount(
    plant: MultibodyPlant, whiteboard: ModelInstanceIndex, board: BoardConfig
) -> None:
    """Weld a board to the world, or put it on the joint `rail` with a stiff servo."""
    surface = plant.GetFrameByName("surface", whiteboard)
    if board.motion.amplitude == 0:
        plant.WeldFrames(plant.world_frame(), surface, board.pose())
        return
    middle = plant.AddFrame(
        FixedOffsetFrame("rail", plant.world_frame(), board.pose(), whiteboard)
    )
    rail: Any = plant.AddJoint(PrismaticJoint("rail", middle, surface, board.axis()))
    rail.set_default_translation(-board.motion.amplitude)
    mass = plant.GetBodyByName("board", whiteboard).default_mass()
    plant.AddJointActuator("rail", rail).set_controller_gains(
        PdControllerGains(p=mass * _SERVO**2, d=2 * mass * _SERVO)
    )


def _AddPlant(
    builder: DiagramBuilder, scenario: Scenario
) -> tuple[MultibodyPlant, SceneGraph]:
    time_step = scenario.plant.time_step
    check_number(time_step, "plant.time_step", least=0, unit="s", error=StationError)
    try:
        plant, scene_graph = AddMultibodyPlant(scenario.plant, builder)
    except RuntimeError as error:
        raise StationError(f"the scenario's plant cannot be built: {error}.") from None
    return plant, scene_graph


def _AddRail(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    whiteboard: ModelInstanceIndex,
    scenario: Scenario,
) -> Sine | None:
    """Add what drives a board on a rail: systems rail and rail_state."""
    motion = scenario.board.motion
    if motion.amplitude == 0:
        return None
    # It starts at rest, at one end.
    rail = Sine(
        amplitude=motion.amplitude,
        frequency=2 * math.pi * motion.frequency,
        phase=-math.pi / 2,
        size=1,
    )
    builder.AddNamedSystem("rail", rail)
    state = builder.AddNamedSystem("rail_state", Multiplexer(2))
    builder.Connect(rail.get_output_port(0), state.get_input_port(0))
    builder.Connect(rail.get_output_port(1), state.get_input_port(1))
    builder.Connect(
        state.get_output_port(), plant.get_desired_state_input_port(whiteboard)
    )
    return rail
