"""The arm's controller and what it measures, added to a scene."""

from typing import Any

import numpy as np
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, AffineSystem, MatrixGain

from fmp_drake.station.parts.board_scene import BoardScene
from fmp_drake.station.scenario_parts import SensorConfig
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)
from fmp_drake.systems.sensor_model import SensorModel


def AddArmController(
    builder: DiagramBuilder,
    scene: BoardScene,
    config: ImpedanceConfig,
    *,
    engage_height: float = 0.01,
    sensors: SensorConfig | None = None,
) -> OperationalSpaceImpedanceController:
    """Add the controller, and what the motors bear besides its torque.

    The controller's torque drives the plant, in which the arm has no weight. Systems:
    controller; gravity_compensation, the torque that carries arm and eraser in the real
    arm, and actuation, the sum of both, computed when somebody asks; sensors
    between the arm and the controller, where they have a rate; task_frame,
    task_frame_velocity and task_frame_acceleration where the board moves.
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
    compensation = InverseDynamics(
        scene.arm, InverseDynamics.InverseDynamicsMode.kGravityCompensation
    )
    builder.AddNamedSystem("gravity_compensation", compensation)
    total = Adder(2, scene.arm.num_velocities())
    builder.AddNamedSystem("actuation", total)
    state = plant.get_state_output_port(scene.panda)
    measured = _AddSensors(builder, scene, sensors or SensorConfig())
    builder.Connect(measured, controller.GetInputPort("state"))
    builder.Connect(state, compensation.get_input_port_estimated_state())
    torque = controller.GetOutputPort("torque")
    builder.Connect(torque, plant.get_actuation_input_port(scene.panda))
    builder.Connect(torque, total.get_input_port(0))
    builder.Connect(
        compensation.get_output_port_generalized_force(), total.get_input_port(1)
    )
    _AddBoardFrame(builder, scene, controller)
    return controller


def _AddSensors(
    builder: DiagramBuilder, scene: BoardScene, config: SensorConfig
) -> OutputPort:
    """Return the port of the arm's state as it is measured."""
    plant = scene.plant
    state = plant.get_state_output_port(scene.panda)
    if config.rate == 0:
        return state
    q = plant.GetDefaultPositions(scene.panda)
    sensors = builder.AddSystem(
        SensorModel(
            initial=np.concatenate([q, np.zeros_like(q)]),
            rate=config.rate,
            delay=config.delay,
            position_noise=config.position_noise,
            velocity_noise=config.velocity_noise,
            seed=config.seed,
        )
    )
    builder.Connect(state, sensors.GetInputPort("state"))
    return sensors.get_output_port()


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
