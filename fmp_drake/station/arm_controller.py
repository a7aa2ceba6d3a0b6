"""Controller and driver of an arm, added to a scene."""

from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import AffineSystem, MatrixGain

from fmp_drake.station.board_scene import BoardScene, Connect
from fmp_drake.station.robots.driver import Driver, MakeDriver, SimulatedDriver
from fmp_drake.systems import (
    ImpedanceConfig,
    NormalForceEstimator,
    OperationalSpaceImpedanceController,
)


def AddArmController(
    builder: DiagramBuilder,
    scene: BoardScene,
    config: ImpedanceConfig,
    *,
    driver: Driver | None = None,
    lcm: DrakeLcmInterface | None = None,
    contact_height: float = 0.0,
) -> OperationalSpaceImpedanceController:
    """Add the controller, and the driver between it and the arm.

    The controller's torque drives the plant of a simulated arm, where the arm has no
    weight. Systems: controller; driver of `MakeDriver`, whose torque_measured includes the
    weight of arm and eraser; task_frame, task_frame_velocity and task_frame_acceleration
    where the board moves.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    config : ImpedanceConfig
        The robot's values replace missing ones.
    driver : Driver, optional
        A simulated arm with ideal sensors by default. If the driver requires a period, the
        controller has the same.
    lcm : DrakeLcmInterface, optional
        As for `MakeDriver`.
    contact_height : float
        As for the controller, m.
    """
    plant, driver = scene.plant, driver or SimulatedDriver()
    driver.check_robot(scene.robot.config)
    config = scene.robot.config.complete(config)
    if driver.control_period is not None:
        config = replace(config, control_period=driver.control_period)
    controller = OperationalSpaceImpedanceController(
        scene.model.plant,
        end_effector=scene.model.tip,
        X_WT=scene.X_WA,
        config=config,
        q_posture=scene.robot.default_posture,
        engage_height=scene.scenario.press.engage_height,
        contact_height=contact_height,
    )
    builder.AddNamedSystem("controller", controller)
    diagram = builder.AddSystem(
        MakeDriver(
            driver,
            arm=scene.model.plant,
            initial=scene.robot.default_posture,
            lcm=lcm,
        )
    )
    builder.Connect(controller.GetOutputPort("torque"), diagram.GetInputPort("torque"))
    builder.Connect(diagram.GetOutputPort("state"), controller.GetInputPort("state"))
    if not scene.is_simulated:
        return controller
    arm = scene.robot.arm
    builder.Connect(
        plant.get_state_output_port(arm), diagram.GetInputPort("plant_state")
    )
    external = plant.get_generalized_contact_forces_output_port(arm)
    builder.Connect(external, diagram.GetInputPort("plant_external"))
    actuation = plant.get_actuation_input_port(arm)
    builder.Connect(diagram.GetOutputPort("plant_actuation"), actuation)
    _AddBoardFrame(builder, scene, controller)
    return controller


def AddNormalForceEstimator(
    builder: DiagramBuilder, scene: BoardScene, driver: System
) -> OutputPort:
    """Estimate the normal force from the external torque of a `MakeDriver`.

    System: normal_force_estimator.
    """
    model, R_WT = scene.model, scene.X_WA.rotation()
    estimator = builder.AddSystem(
        NormalForceEstimator(model.plant, end_effector=model.tip, R_WT=R_WT)
    )
    Connect(builder, driver, estimator, "state", "torque_external")
    return estimator.get_output_port()


def _AddBoardFrame(
    builder: DiagramBuilder,
    scene: BoardScene,
    controller: OperationalSpaceImpedanceController,
) -> None:
    """Connect the measured and planned motion of a board on a rail to the controller.

    On a curved board the frame also moves over the board: `AddSkill` connects it.
    """
    if scene.rail is None or scene.whiteboard is None:
        return
    surface = scene.curvature
    plant = scene.plant
    joint: Any = plant.GetJointByName("rail", scene.whiteboard)
    axis_W = scene.X_WA.rotation() @ np.array(joint.translation_axis())
    # X_WA is the assumed pose of the board at the start.
    start = scene.X_WA.translation() - joint.get_default_translation() * axis_W
    position = np.vstack([np.zeros((4, 2)), np.outer(axis_W, [1.0, 0.0])])
    rotation = scene.X_WA.rotation().ToQuaternion().wxyz()
    frame = AffineSystem(D=position, y0=np.concatenate([rotation, start]))
    no_rotation = np.zeros((3, 2))
    velocity = MatrixGain(np.vstack([no_rotation, np.outer(axis_W, [0.0, 1.0])]))
    acceleration = MatrixGain(np.vstack([no_rotation[:, :1], axis_W[:, None]]))
    measured = plant.get_state_output_port(scene.whiteboard)
    planned = scene.rail.GetOutputPort("acceleration")
    for name, system, source in (
        ("task_frame", frame, measured),
        ("task_frame_velocity", velocity, measured),
        ("task_frame_acceleration", acceleration, planned),
    ):
        builder.AddNamedSystem(name, system)
        builder.Connect(source, system.get_input_port())
        if surface.is_plane:
            builder.Connect(system.get_output_port(), controller.GetInputPort(name))
