"""A page of an arm that is not simulated here: as it is measured."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from fmp_drake.station.models.model_files import AddPandaWithEraser
from fmp_drake.station.models.whiteboard import AddWhiteboard
from fmp_drake.station.parts.page_scene import AddBodies, AddPaths
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem


def AddMeasuredArm(
    builder: DiagramBuilder,
    scenario: Scenario,
    *,
    robot: System,
    primitive: FourierPrimitiveSystem,
    meshcat: Meshcat,
    demonstrated: Sequence[NDArray[np.float64]] = (),
) -> None:
    """Show an arm where it is measured, the board where it is assumed, and the plan.

    Nothing on the page can be touched. Systems: scene_graph, geometry_pose,
    meshcat_visualizer, trail_visualizer, plan_visualizer, as far as the scenario's `show`
    says.

    Parameters
    ----------
    builder : DiagramBuilder
    scenario : Scenario
    robot : System
        With the outputs state (14,) and measured_position (3,).
    primitive : FourierPrimitiveSystem
    meshcat : Meshcat
    demonstrated : sequence of ndarray, shape (N, 3)
        Paths in B, m.
    """
    plant = MultibodyPlant(time_step=0.0)
    scene_graph = SceneGraph()
    builder.AddNamedSystem("scene_graph", scene_graph)
    source = plant.RegisterAsSourceForSceneGraph(scene_graph)
    AddPandaWithEraser(plant, eraser=scenario.eraser)
    whiteboard = AddWhiteboard(plant, scenario.board)
    surface = plant.GetFrameByName("surface", whiteboard)
    plant.WeldFrames(plant.world_frame(), surface, scenario.board.assumed_pose())
    plant.Finalize()
    poses = builder.AddNamedSystem(
        "geometry_pose",
        MultibodyPositionToGeometryPose(plant, input_multibody_state=True),
    )
    builder.Connect(robot.GetOutputPort("state"), poses.get_input_port())
    builder.Connect(poses.get_output_port(), scene_graph.get_source_pose_port(source))
    AddBodies(builder, scene_graph, scenario, meshcat)
    AddPaths(
        builder,
        scenario,
        meshcat=meshcat,
        primitive=primitive,
        measured_position=robot.GetOutputPort("measured_position"),
        demonstrated=demonstrated,
    )
