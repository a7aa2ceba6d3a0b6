"""The monitor of a board's surface, added to a scene."""

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder

from fmp_drake.station.models.hard_points import CollectHardPoints
from fmp_drake.station.models.whiteboard import BoardBox
from fmp_drake.station.parts.board_scene import BoardScene
from fmp_drake.station.scenario_parts import BoardConfig
from fmp_drake.systems.impedance.status import STATUS_SIZE
from fmp_drake.systems.surface_monitor import SurfaceMonitor


def AddSurfaceWatch(
    builder: DiagramBuilder,
    scene: BoardScene,
    board: BoardConfig,
    *,
    status: OutputPort,
) -> OutputPort:
    """Watch all of arm and eraser that touches and is hard; report it in the status.

    Systems: surface_monitor; status, the sum of the controller's status and the
    monitor's. Output ports: penetration, status.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    board : BoardConfig
    status : OutputPort
        The controller's.

    Returns
    -------
    OutputPort
        The sum.
    """
    plant = scene.plant
    arm, eraser = (
        CollectHardPoints(plant, scene.scene_graph, model)
        for model in (scene.panda, scene.tip.model_instance())
    )
    monitor = builder.AddSystem(
        SurfaceMonitor(
            surface=scene.surface,
            box=BoardBox(board),
            bodies=np.concatenate([arm.bodies, eraser.bodies]),
            points=np.concatenate([arm.points, eraser.points]),
            radii=np.concatenate([arm.radii, eraser.radii]),
            on_arm=np.arange(len(arm.radii) + len(eraser.radii)) < len(arm.radii),
        )
    )
    builder.Connect(
        plant.get_body_poses_output_port(), monitor.GetInputPort("body_poses")
    )
    total = builder.AddNamedSystem("status", Adder(2, STATUS_SIZE))
    builder.Connect(status, total.get_input_port(0))
    builder.Connect(monitor.GetOutputPort("status"), total.get_input_port(1))
    builder.ExportOutput(total.get_output_port(), "status")
    builder.ExportOutput(monitor.GetOutputPort("penetration"), "penetration")
    return total.get_output_port()
