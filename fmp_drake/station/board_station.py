"""A robot at a board, and a skill on it, whatever the robot is."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcmInterface
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from fmp_drake.errors import StationError
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.station.panda_driver import (
    LcmPanda,
    MakePandaDriver,
    PandaConfig,
    SimulatedPanda,
)
from fmp_drake.station.parts.arm_controller import (
    AddArmController,
    AddNormalForceEstimator,
)
from fmp_drake.station.parts.board_scene import AddBoardScene, MakeArm
from fmp_drake.station.parts.page_scene import AddMeasuredArm, AddPageControls
from fmp_drake.station.parts.posture import SolvePosture
from fmp_drake.station.parts.skill_motion import DESIRED, AddSkillMotion, ChoiceByInk
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)
from fmp_drake.systems.wiped_area import WipedArea


def MakeBoardStation(
    scenario: Scenario,
    config: PandaConfig,
    *,
    lcm: DrakeLcmInterface | None = None,
) -> Diagram:
    """Build a robot at a board, with its controller and without a skill.

    Systems: panda_driver, controller, normal_force_estimator; plant and scene_graph of a simulated arm.

    Input ports: desired_position, desired_velocity, desired_acceleration (3,) in the frame
    B of the board, m, m/s, m/s^2; desired_normal_force (1,), N; and wall_time and go of
    an arm behind LCM. Output ports: measured_position, measured_velocity (3,) in B,
    tracking_error (6,), status (6,), torque (7,) of the controller; normal_force (1,), N, as
    the arm's external torque tells it, over which an enabled `force_control` closes; and
    those of `MakePandaDriver`.

    Parameters
    ----------
    scenario : Scenario
        Of a board that stands still, where the arm is not simulated.
    config : SimulatedPanda, LcmPanda or ReplayPanda
        Behind LCM the law has the period of its gate.
    lcm : DrakeLcmInterface, optional
        As for `MakePandaDriver`.

    Raises
    ------
    StationError
        Where the scenario has values that do not fit, or the arm cannot reach the start.
    """
    builder = DiagramBuilder()
    driver: System
    if isinstance(config, SimulatedPanda):
        scene = AddBoardScene(builder, scenario, start=scenario.start)
        arm, tip, X_WA = scene.arm, scene.arm_tip, scene.X_WA
        controller = AddArmController(
            builder,
            scene,
            scenario.impedance,
            engage_height=scenario.press.engage_height,
            sensors=config.sensors,
        )
        driver = builder.GetSubsystemByName("panda_driver")
    else:
        scenario.check()
        if scenario.board.motion.amplitude > 0:
            raise StationError(
                f"board.motion.amplitude is {scenario.board.motion.amplitude} m; nothing "
                "measures a real board's motion. Set it to 0."
            )
        arm, tip = MakeArm(scenario)
        X_WA = scenario.board.assumed_pose()
        X_AE = RigidTransform(scenario.eraser_orientation(), np.array(scenario.start))
        posture = SolvePosture(
            arm, frame=tip, X_WE=X_WA @ X_AE, q_preferred=scenario.posture
        )
        impedance = scenario.impedance
        if isinstance(config, LcmPanda):
            impedance = replace(impedance, control_period=config.gate.period)
        controller = OperationalSpaceImpedanceController(
            arm,
            end_effector=tip,
            X_WT=X_WA,
            config=impedance,
            q_posture=posture,
            engage_height=scenario.press.engage_height,
        )
        builder.AddNamedSystem("controller", controller)
        driver = builder.AddSystem(
            MakePandaDriver(config, arm=arm, initial=posture, lcm=lcm)
        )
        builder.Connect(driver.GetOutputPort("state"), controller.GetInputPort("state"))
        torque = controller.GetOutputPort("torque")
        builder.Connect(torque, driver.GetInputPort("torque"))
    force = AddNormalForceEstimator(builder, arm, tip, X_WA.rotation(), driver)
    builder.Connect(force, controller.GetInputPort("normal_force"))
    builder.ExportOutput(force, "normal_force")
    for name in (*DESIRED, "desired_normal_force"):
        builder.ExportInput(controller.GetInputPort(name), name)
    if isinstance(config, LcmPanda):
        for name in ("wall_time", "go"):
            builder.ExportInput(driver.GetInputPort(name), name)
    for system in (controller, driver):
        for i in range(system.num_output_ports()):
            port = system.get_output_port(i)
            if port.get_name() != "plant_actuation":
                builder.ExportOutput(port, port.get_name())
    diagram = builder.Build()
    diagram.set_name("board_station")
    return diagram


def MakeSkillStation(
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    config: PandaConfig,
    *,
    lcm: DrakeLcmInterface | None = None,
    meshcat: Meshcat | None = None,
    demonstrated: Sequence[NDArray[np.float64]] = (),
) -> Diagram:
    """Build a robot that plays a skill at a board, without ink.

    Systems: board_station, fourier_primitive, desired_motion, and wiped_area, by which
    samples are chosen as nobody sees the ink. Input ports: tempo,
    desired_normal_force and, behind LCM, wall_time and go. Output ports: desired_position,
    desired_velocity, desired_acceleration, and those of `MakeBoardStation`. With a
    Meshcat also those of `AddMeasuredArm`, and where the scenario shows controls
    page_controls, whose outputs page_tempo (1,) and page_normal_force (1,) move nothing by
    themselves.

    Parameters
    ----------
    scenario, config, lcm
        As for `MakeBoardStation`.
    skill : FourierMovementPrimitive
        Fitted, of 3 position channels in the frame of the board, m.
    meshcat : Meshcat, optional
        Where to show the arm as it is measured.
    demonstrated : sequence of ndarray, shape (N, 3)
        Paths in B to show, m.
    """
    builder = DiagramBuilder()
    board = builder.AddSystem(MakeBoardStation(scenario, config, lcm=lcm))
    x, y = scenario.board.size
    grid = InkGrid(size=(x, y), cell=scenario.ink.cell)
    choice, _ = ChoiceByInk(scenario, skill, grid)
    primitive, desired = AddSkillMotion(
        builder, skill, scenario.skill, board, choice=choice
    )
    if choice is not None:
        wiped = builder.AddSystem(WipedArea(grid, footprint=choice.footprint))
        for name in ("measured_position", "normal_force"):
            builder.Connect(board.GetOutputPort(name), wiped.GetInputPort(name))
        builder.Connect(wiped.get_output_port(), primitive.GetInputPort("ink"))
    if meshcat is not None:
        AddMeasuredArm(
            builder,
            scenario,
            robot=board,
            primitive=primitive,
            meshcat=meshcat,
            demonstrated=demonstrated,
        )
        if scenario.show.controls:
            controls = AddPageControls(builder, scenario, primitive, meshcat)
            for name in ("tempo", "normal_force"):
                builder.ExportOutput(controls.GetOutputPort(name), f"page_{name}")
    for i, name in enumerate(DESIRED):
        builder.ExportOutput(desired.get_output_port(i), name)
    builder.ExportInput(primitive.GetInputPort("tempo"), "tempo")
    for i in range(board.num_input_ports()):
        port = board.get_input_port(i)
        if port.get_name() not in DESIRED:
            builder.ExportInput(port, port.get_name())
    for i in range(board.num_output_ports()):
        output = board.get_output_port(i)
        builder.ExportOutput(output, output.get_name())
    diagram = builder.Build()
    diagram.set_name("skill_station")
    return diagram
