"""What a page shows of a station, added to its diagram."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import (
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    SceneGraph,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from fmp_drake.station.models.model_files import AddPandaWithEraser
from fmp_drake.station.models.whiteboard import AddWhiteboard
from fmp_drake.station.parts.board_scene import AddBoardScene, BoardScene
from fmp_drake.station.parts.mouse import AddMousePull
from fmp_drake.station.parts.stage import SetStage
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.ink.grid import CLEAN_BELOW
from fmp_drake.systems.ink_board import InkBoard
from fmp_drake.systems.page.force_arrow import ForceArrow
from fmp_drake.systems.page.ink_visualizer import InkVisualizer
from fmp_drake.systems.page.page_controls import PageControls
from fmp_drake.systems.page.page_status import PageStatus
from fmp_drake.systems.page.plan_visualizer import PlanVisualizer
from fmp_drake.systems.page.trail_visualizer import TrailVisualizer
from fmp_drake.systems.viewer.page_panel import PagePanel
from fmp_drake.systems.viewer.path_drawing import draw_demonstrations

# Everything on the page has a period of 2^n milliseconds: its events then fall on steps
# of the controller to the last bit, and never cut a step of the integrator in two.

# Every station's bodies are drawn under this path of Meshcat's tree.
_BODIES = "bodies"
BOARD = f"{_BODIES}/whiteboard/board"
"""Where the board's body is in Meshcat's tree: what is drawn on the board is under
it, and moves with it, on the page and in recordings."""
INK = f"{BOARD}/ink"
"""Where the ink is drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PagePorts:
    """What comes from the page: None where it is switched off.

    Attributes
    ----------
    controls : PageControls
        The sliders.
    pull : OutputPort
        The forces of the mouse on the bodies.
    """

    controls: PageControls | None = None
    pull: OutputPort | None = None


def AddBodies(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    scenario: Scenario,
    meshcat: Meshcat,
) -> None:
    """Show arm, eraser and board, lit and seen by the scenario's camera.

    System: meshcat_visualizer.
    """
    meshcat.Delete(_BODIES)
    visualizer = MeshcatVisualizer.AddToBuilder(
        builder,
        scene_graph,
        meshcat,
        MeshcatVisualizerParams(
            prefix=_BODIES,
            publish_period=0.032,
            # What others draw on the board outlives an initialisation.
            delete_on_initialization_event=False,
        ),
    )
    visualizer.set_name("meshcat_visualizer")
    SetStage(meshcat, eye=scenario.camera.eye, target=scenario.camera.target)


def ShowStill(scenario: Scenario, meshcat: Meshcat, *, visuals: str = "own") -> None:
    """Show arm, eraser and board at rest, while there is no station yet.

    Parameters
    ----------
    scenario : Scenario
    meshcat : Meshcat
        A station with a page clears it before it draws.
    visuals : str
        Of the arm: `own` or `drake_models`.
    """
    builder = DiagramBuilder()
    scene = AddBoardScene(
        builder, scenario, start=scenario.start, q=scenario.posture, visuals=visuals
    )
    AddBodies(builder, scene.scene_graph, scenario, meshcat)
    diagram = builder.Build()
    diagram.ForcedPublish(diagram.CreateDefaultContext())


def AddPage(
    builder: DiagramBuilder,
    scene: BoardScene,
    scenario: Scenario,
    *,
    meshcat: Meshcat,
    primitive: FourierPrimitiveSystem,
    measured_position: OutputPort,
    ink: InkBoard,
    demonstrated: Sequence[NDArray[np.float64]],
) -> PagePorts:
    """Show a wiping station as far as the scenario's `show` says.

    Systems: meshcat_visualizer, ink_visualizer, trail_visualizer, plan_visualizer,
    force_arrow, page_controls, and those of `AddMousePull`.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    scenario : Scenario
    meshcat : Meshcat
    primitive : FourierPrimitiveSystem
        It plays the skill that is shown.
    measured_position : OutputPort
        p_BE, m.
    ink : InkBoard
    demonstrated : sequence of ndarray, shape (N, 3)
        Paths in B, m.
    """
    show = scenario.show
    AddBodies(builder, scene.scene_graph, scenario, meshcat)
    if show.ink:
        shown = builder.AddSystem(
            InkVisualizer(meshcat=meshcat, grid=ink.grid, path=INK)
        )
        builder.Connect(ink.GetOutputPort("ink"), shown.GetInputPort("ink"))
    AddPaths(
        builder,
        scenario,
        meshcat=meshcat,
        primitive=primitive,
        measured_position=measured_position,
        demonstrated=demonstrated,
    )
    controls = None
    if show.controls:
        controls = AddPageControls(builder, scenario, primitive, meshcat)
    if show.force:
        arrow = builder.AddSystem(
            ForceArrow(scene.plant, body=scene.tip.body(), meshcat=meshcat)
        )
        builder.Connect(
            scene.plant.GetOutputPort("contact_results"),
            arrow.GetInputPort("contact_results"),
        )
    pull = None
    if show.mouse:
        pull = AddMousePull(builder, scene.plant, scene.scene_graph, meshcat)
    return PagePorts(controls=controls, pull=pull)


def AddPageControls(
    builder: DiagramBuilder,
    scenario: Scenario,
    primitive: FourierPrimitiveSystem,
    meshcat: Meshcat,
) -> PageControls:
    """Let a page choose samples or means; its tempo and force are not connected here.

    System: page_controls.
    """
    controls = PageControls(
        meshcat,
        tempo=scenario.skill.tempo,
        normal_force=scenario.press.force,
        sample=primitive.player.sample,
    )
    builder.AddSystem(controls)
    builder.Connect(controls.GetOutputPort("sample"), primitive.GetInputPort("sample"))
    return controls


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


def AddPaths(
    builder: DiagramBuilder,
    scenario: Scenario,
    *,
    meshcat: Meshcat,
    primitive: FourierPrimitiveSystem,
    measured_position: OutputPort,
    demonstrated: Sequence[NDArray[np.float64]],
) -> None:
    """Show demonstrated paths, the measured one and the plan, as `AddPage` does.

    Systems: trail_visualizer, plan_visualizer.
    """
    show, skill = scenario.show, primitive.player.skill
    if show.demonstrations:
        draw_demonstrations(meshcat, f"{BOARD}/demonstrations", demonstrated)
    if show.trail:
        trail = builder.AddSystem(TrailVisualizer(meshcat, path=f"{BOARD}/trail"))
        builder.Connect(measured_position, trail.get_input_port())
    if show.plan or show.tube or show.component:
        plan = builder.AddSystem(
            PlanVisualizer(
                meshcat,
                points=primitive.GetOutputPort("plan").size() // 3,
                component_paths=skill.synthesize([c.mean for c in skill.components_]),
                path=f"{BOARD}/plan",
                show_plan=show.plan,
                show_tube=show.tube,
                show_component=show.component,
            )
        )
        for name in ("plan", "plan_covariance", "component"):
            builder.Connect(primitive.GetOutputPort(name), plan.GetInputPort(name))


def AddPageStatus(
    builder: DiagramBuilder,
    panel: PagePanel,
    *,
    primitive: FourierPrimitiveSystem,
    status: OutputPort,
    period: float,
    ink: InkBoard,
    area: NDArray[np.bool_] | None,
) -> None:
    """Show in a panel what a wiping station is doing: system page_status.

    Parameters
    ----------
    builder : DiagramBuilder
    panel : PagePanel
    primitive : FourierPrimitiveSystem
    status : OutputPort
        Of the controller and what watches it.
    period : float
        Of the controller, s.
    ink : InkBoard
    area : ndarray of bool, shape (ny, nx), optional
        The cells that should be cleaned where there is ink; all by default.
    """
    inked = ink.initial_ink >= CLEAN_BELOW
    wanted = inked if area is None else inked & area
    shown = builder.AddSystem(PageStatus(panel, area=wanted, status_period=period))
    builder.Connect(status, shown.GetInputPort("status"))
    for port in (
        ink.GetOutputPort("normal_force"),
        ink.GetOutputPort("ink"),
        primitive.GetOutputPort("component"),
    ):
        builder.Connect(port, shown.GetInputPort(port.get_name()))
