"""The task of wiping a board: its ink, its surface, and the normal force on it."""

from dataclasses import replace

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import Adder

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array
from fmp_drake.station.arm_controller import AddNormalForceEstimator
from fmp_drake.station.board_scene import BODIES, BoardScene, Connect
from fmp_drake.station.models.whiteboard import BoardBox
from fmp_drake.station.robots.collision_spheres import CollectCollisionSpheres
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.tasks.following import Following
from fmp_drake.station.tasks.task import Measurements, Task
from fmp_drake.systems import InkBoard, InkGrid
from fmp_drake.systems.impedance.controller_status import STATUS_SIZE
from fmp_drake.systems.ink.drawing import draw_picture, draw_words, upright_turns
from fmp_drake.systems.surface_monitor import SurfaceMonitor
from fmp_drake.systems.wiped_area import WipedArea


class Wiping(Task):
    """An eraser that wipes a board.

    In simulation the ink, the contact force and the distance of hard points from the
    surface are measured. For a real arm, the normal force follows from its external
    torque, and the ink from the places where the eraser pressed.

    Examples
    --------
    >>> from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
    >>> from fmp_drake.station import LoadScenario, MakeStation, models_dir
    >>> wiping = Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")
    >>> skill = FourierMovementPrimitive().fit(wiping)
    >>> station = MakeStation(LoadScenario("table_top"), skill, task=Wiping())
    >>> station.GetOutputPort("normal_force").size()
    1
    """

    def AddTo(
        self,
        builder: DiagramBuilder,
        scene: BoardScene,
        *,
        controller: System,
        driver: System,
    ) -> Measurements:
        """Add ink_board and surface_monitor, or wiped_area; export their outputs."""
        scenario = scene.scenario
        if not scene.is_simulated:
            measured = Following().AddTo(
                builder, scene, controller=controller, driver=driver
            )
            if scenario.skill.candidates == 1:
                return measured
            ink = builder.AddSystem(
                WipedArea(BoardGrid(scenario), footprint=scenario.board_footprint())
            )
            builder.Connect(measured.normal_force, ink.GetInputPort("normal_force"))
            return replace(
                measured,
                ink=ink.get_output_port(),
                ink_position=ink.GetInputPort("measured_position"),
            )
        ink_board = AddInk(builder, scene)
        for i in range(ink_board.num_output_ports()):
            port = ink_board.get_output_port(i)
            builder.ExportOutput(port, port.get_name())
        force = ink_board.GetOutputPort("normal_force")
        if scenario.press.by_torque:
            force = AddNormalForceEstimator(builder, scene, driver)
        status = controller.GetOutputPort("status")
        return Measurements(
            status=AddSurfaceMonitor(builder, scene, status),
            normal_force=force,
            ink=ink_board.GetOutputPort("ink"),
            ink_board=ink_board,
        )


def BoardGrid(scenario: Scenario) -> InkGrid:
    """Return the cells of a scenario's board."""
    x, y = scenario.board.size
    return InkGrid(
        size=(x, y), cell=scenario.ink.cell, curvature=scenario.board.curvature()
    )


def AddInk(builder: DiagramBuilder, scene: BoardScene) -> InkBoard:
    """Add the ink that the eraser rubs off: system ink_board.

    Words and pictures are upright for the scenario's camera.

    Raises
    ------
    StationError
        If there is no board, a picture cannot be read, or there would be no ink on the board.
    """
    scenario = scene.scenario
    if not scenario.has_board:
        raise StationError(
            "there is no board for the ink, because board.shape is none (free space). Leave "
            "out the ink, or choose another shape."
        )
    grid = BoardGrid(scenario)
    ink = InkBoard(
        plant=scene.plant,
        eraser=scene.robot.tip,
        surface=scene.surface,
        grid=grid,
        initial_ink=_Drawing(grid, scene),
        worn=scenario.eraser.worn,
        period=scenario.ink.period,
    )
    builder.AddSystem(ink)
    Connect(builder, scene.plant, ink, "contact_results", *BODIES)
    return ink


def _Drawing(grid: InkGrid, scene: BoardScene) -> Array | None:
    """Return the initial ink; None for a board full of ink."""
    scenario, ink = scene.scenario, scene.scenario.ink
    if not (ink.words or ink.picture):
        return None
    turns = upright_turns(grid, X_WB=scene.X_WB, eye=scenario.camera.eye)
    if ink.words:
        return draw_words(grid, ink.words, height=ink.size, quarter_turns=turns)
    return draw_picture(grid, ink.picture, size=ink.size, quarter_turns=turns)


def AddSurfaceMonitor(
    builder: DiagramBuilder, scene: BoardScene, status: OutputPort
) -> OutputPort:
    """Monitor the clearance of the rigid geometry of arm and eraser; report it in the status.

    Systems: surface_monitor; status, the sum of the controller's status and the
    monitor's. Output ports: penetration, status.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    status : OutputPort
        The controller's.

    Returns
    -------
    OutputPort
        The sum.
    """
    plant = scene.plant
    arm, eraser = (
        CollectCollisionSpheres(plant, scene.scene_graph, model)
        for model in (scene.robot.arm, scene.robot.tool)
    )
    monitor = builder.AddSystem(
        SurfaceMonitor(
            surface=scene.surface,
            box=BoardBox(scene.scenario.board),
            curvature=scene.curvature,
            bodies=np.concatenate([arm.bodies, eraser.bodies]),
            points=np.concatenate([arm.points, eraser.points]),
            radii=np.concatenate([arm.radii, eraser.radii]),
            on_arm=np.arange(len(arm.radii) + len(eraser.radii)) < len(arm.radii),
        )
    )
    Connect(builder, plant, monitor, "body_poses")
    total = builder.AddNamedSystem("status", Adder(2, STATUS_SIZE))
    builder.Connect(status, total.get_input_port(0))
    builder.Connect(monitor.GetOutputPort("status"), total.get_input_port(1))
    builder.ExportOutput(total.get_output_port(), "status")
    builder.ExportOutput(monitor.GetOutputPort("penetration"), "penetration")
    return total.get_output_port()
