"""The arm's controller and what it measures, added to a scene."""

from typing import Any

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import AffineSystem, MatrixGain

from fmp_drake.station.panda_driver import MakePandaDriver, SimulatedPanda
from fmp_drake.station.parts.board_scene import BoardScene
from fmp_drake.station.scenario_parts import SensorConfig
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.normal_force_estimator import NormalForceEstimator
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)


def AddArmController(
    builder: DiagramBuilder,
    scene: BoardScene,
    config: ImpedanceConfig,
    *,
    engage_height: float = 0.01,
    sensors: SensorConfig | None = None,
) -> OperationalSpaceImpedanceController:
    """Add the controller, and the driver between it and the simulated arm.

    The controller's torque drives the plant, in which the arm has no weight. Systems:
    controller; panda_driver of `MakePandaDriver`, whose torque_measured has the weight of
    arm and eraser; task_frame, task_frame_velocity and task_frame_acceleration where the
    board moves.
    """
    plant = scene.plant
    controller = OperationalSpaceImpedanceController(
        scene.arm,
        end_effector=scene.arm_tip,
        X_WT=scene.X_WA,
        config=config,
        q_posture=plant.GetDefaultPositions(scene.panda),
        engage_height=engage_height,
    )
    builder.AddNamedSystem("controller", controller)
    driver = builder.AddSystem(
        MakePandaDriver(
            SimulatedPanda(sensors=sensors or SensorConfig()),
            arm=scene.arm,
            initial=plant.GetDefaultPositions(scene.panda),
        )
    )
    for source, name in (
        (controller.GetOutputPort("torque"), "torque"),
        (plant.get_state_output_port(scene.panda), "plant_state"),
        (
            plant.get_generalized_contact_forces_output_port(scene.panda),
            "plant_external",
        ),
    ):
        builder.Connect(source, driver.GetInputPort(name))
    builder.Connect(
        driver.GetOutputPort("plant_actuation"),
        plant.get_actuation_input_port(scene.panda),
    )
    builder.Connect(driver.GetOutputPort("state"), controller.GetInputPort("state"))
    _AddBoardFrame(builder, scene, controller)
    return controller


def AddNormalForceEstimator(
    builder: DiagramBuilder,
    arm: MultibodyPlant,
    tip: Frame,
    R_WT: RotationMatrix,
    driver: System,
) -> OutputPort:
    """Measure the normal force by the external torque of a `MakePandaDriver`.

    System: normal_force_estimator.
    """
    estimator = builder.AddSystem(
        NormalForceEstimator(arm, end_effector=tip, R_WT=R_WT)
    )
    for name in ("state", "torque_external"):
        builder.Connect(driver.GetOutputPort(name), estimator.GetInputPort(name))
    return estimator.get_output_port()


def _AddBoardFrame(
    builder: DiagramBuilder,
    scene: BoardScene,
    controller: OperationalSpaceImpedanceController,
) -> None:
    """Tell the controller how a board on a rail moves: measured, and as planned."""
    if scene.rail is None:
        return
    plant = scene.plant
    joint: Any = plant.GetJointByName("rail", scene.whiteboard)
    axis_W = scene.X_WA.rotation() @ np.array(joint.translation_axis())
    # X_WA is where the board is assumed to be at time 0.
    start = scene.X_WA.translation() - joint.get_default_translation() * axis_W
    still, moving = np.zeros((4, 2)), np.outer(axis_W, [1.0, 0.0])
    rotation = scene.X_WA.rotation().ToQuaternion().wxyz()
    frame = AffineSystem(
        D=np.vstack([still, moving]), y0=np.concatenate([rotation, start])
    )
    turning = np.zeros((3, 2))
    velocity = MatrixGain(np.vstack([turning, np.outer(axis_W, [0.0, 1.0])]))
    acceleration = MatrixGain(np.vstack([turning[:, :1], axis_W[:, None]]))
    measured = plant.get_state_output_port(scene.whiteboard)
    for name, system, source in (
        ("task_frame", frame, measured),
        ("task_frame_velocity", velocity, measured),
        ("task_frame_acceleration", acceleration, scene.rail.get_output_port(2)),
    ):
        builder.AddNamedSystem(name, system)
        builder.Connect(source, system.get_input_port())
        builder.Connect(system.get_output_port(), controller.GetInputPort(name))
