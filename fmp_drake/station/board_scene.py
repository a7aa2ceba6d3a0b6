"""The scene that every station shares: arm, eraser and whiteboard."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder

from fmp_drake.errors import StationError
from fmp_drake.station.model_files import AddFmpDrakePackage, AddPandaWithEraser
from fmp_drake.station.posture import SolvePosture
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.impedance_config import ImpedanceConfig
from fmp_drake.systems.joint_friction import JointFriction
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardScene:
    """The parts of a scene that was added to a builder.

    Attributes
    ----------
    plant, scene_graph
        What is simulated: arm, eraser and board.
    panda, eraser, whiteboard : ModelInstanceIndex
        In `plant`.
    tip, surface : Frame
        E and B in `plant`.
    arm : MultibodyPlant
        What the controller knows: the arm and its eraser, no board.
    arm_tip : Frame
        E in `arm`.
    X_WB : RigidTransform
        The board in the world.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    panda: ModelInstanceIndex
    eraser: ModelInstanceIndex
    whiteboard: ModelInstanceIndex
    tip: Frame
    surface: Frame
    arm: MultibodyPlant
    arm_tip: Frame
    X_WB: RigidTransform


def AddBoardScene(
    builder: DiagramBuilder, scenario: Scenario, *, start: ArrayLike
) -> BoardScene:
    """Add the plant with arm, eraser and board, the eraser held at a start.

    Parameters
    ----------
    builder : DiagramBuilder
    scenario : Scenario
    start : array_like, shape (3,)
        p_BE, m.

    Raises
    ------
    StationError
        Where the arm cannot reach the start.
    """
    X_WB = scenario.board.pose()
    arm = MultibodyPlant(time_step=0.0)
    arm.set_name("arm")
    _, arm_eraser = AddPandaWithEraser(arm)
    arm.Finalize()
    arm_tip = arm.GetFrameByName("eraser_tip", arm_eraser)

    plant, scene_graph = _AddPlant(builder, scenario)
    panda, eraser = AddPandaWithEraser(plant)
    parser = Parser(plant)
    AddFmpDrakePackage(parser)
    (whiteboard,) = parser.AddModels(
        url="package://fmp_drake/whiteboard/whiteboard.sdf"
    )
    surface = plant.GetFrameByName("surface", whiteboard)
    plant.WeldFrames(plant.world_frame(), surface, X_WB)
    plant.Finalize()

    X_BE = RigidTransform(scenario.eraser_orientation(), np.asarray(start, dtype=float))
    posture = SolvePosture(
        arm, frame=arm_tip, X_WE=X_WB @ X_BE, q_preferred=scenario.posture
    )
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
        eraser=eraser,
        whiteboard=whiteboard,
        tip=plant.GetFrameByName("eraser_tip", eraser),
        surface=surface,
        arm=arm,
        arm_tip=arm_tip,
        X_WB=X_WB,
    )


def _AddPlant(
    builder: DiagramBuilder, scenario: Scenario
) -> tuple[MultibodyPlant, SceneGraph]:
    time_step = scenario.plant.time_step
    if not (np.isfinite(time_step) and time_step >= 0):
        raise StationError(
            f"plant.time_step is {time_step} s; it must not be negative."
        )
    try:
        plant, scene_graph = AddMultibodyPlant(scenario.plant, builder)
    except RuntimeError as error:
        raise StationError(f"the scenario's plant cannot be built: {error}.") from None
    return plant, scene_graph


def AddArmController(
    builder: DiagramBuilder, scene: BoardScene, config: ImpedanceConfig
) -> OperationalSpaceImpedanceController:
    """Add the controller, and the gravity compensation that the real arm has built in.

    The controller's torque plus the torque that carries arm and eraser drive the
    plant. Systems: controller, gravity_compensation, actuation (the sum).
    """
    plant = scene.plant
    controller = OperationalSpaceImpedanceController(
        scene.arm,
        end_effector=scene.arm_tip,
        X_WT=scene.X_WB,
        config=config,
        q_posture=plant.GetDefaultPositions(scene.panda),
    )
    controller.set_name("controller")
    builder.AddSystem(controller)
    compensation = InverseDynamics(
        scene.arm, InverseDynamics.InverseDynamicsMode.kGravityCompensation
    )
    compensation.set_name("gravity_compensation")
    builder.AddSystem(compensation)
    total = Adder(2, scene.arm.num_velocities())
    total.set_name("actuation")
    builder.AddSystem(total)
    state = plant.get_state_output_port(scene.panda)
    builder.Connect(state, controller.GetInputPort("state"))
    builder.Connect(state, compensation.get_input_port_estimated_state())
    builder.Connect(controller.GetOutputPort("torque"), total.get_input_port(0))
    builder.Connect(
        compensation.get_output_port_generalized_force(), total.get_input_port(1)
    )
    builder.Connect(
        total.get_output_port(), plant.get_actuation_input_port(scene.panda)
    )
    return controller
