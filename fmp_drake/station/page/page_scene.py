"""Visualizers and controls of a station's page, added to its diagram."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import (
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    SceneGraph,
)
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from fmp_drake.station.external_forces import AddMousePull
from fmp_drake.station.page.stage import SetStage
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scene import AddBoardScene, BoardScene
from fmp_drake.station.skill_motion import SkillRoles
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.ink.grid import CLEAN_BELOW
from fmp_drake.systems.ink_board import InkBoard
from fmp_drake.systems.page.force_arrow import ForceArrow
from fmp_drake.systems.page.ink_visualizer import InkVisualizer
from fmp_drake.systems.page.page_controls import PageControls
from fmp_drake.systems.page.page_panel import PagePanel
from fmp_drake.systems.page.page_status import PageStatus
from fmp_drake.systems.page.paths import draw_demonstrations
from fmp_drake.systems.page.plan_visualizer import PlanVisualizer
from fmp_drake.systems.page.trail_visualizer import TrailVisualizer

# Everything on the page has a period of 2^n milliseconds: its events then fall on steps
# of the controller to the last bit, and never cut a step of the integrator in two.

# Every station's bodies are drawn under this path of Meshcat's tree.
_BODIES = "bodies"
BOARD = f"{_BODIES}/whiteboard/board"
"""Path of the board's body in Meshcat's tree. Drawings on the board are below this path
and move with the board, on the page and in recordings."""
INK = f"{BOARD}/ink"
"""Path of the ink in Meshcat's tree."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PagePorts:
    """Systems of the page that act on the station; None if switched off.

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
    """Show arm, eraser and board at rest, before there is a station.

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
        builder,
        scenario,
        start=scenario.start,
        q=scenario.preferred_posture(),
        visuals=visuals,
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
    ink: InkBoard | None,
    demonstrated: Sequence[NDArray[np.float64]],
) -> PagePorts:
    """Show a station as far as the scenario's `show` says.

    Systems: meshcat_visualizer, ink_visualizer, trail_visualizer, plan_visualizer,
    force_arrow, page_controls, and those of `AddMousePull`.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    scenario : Scenario
    meshcat : Meshcat
    primitive : FourierPrimitiveSystem
        Player of the skill.
    measured_position : OutputPort
        p_BE, m.
    ink : InkBoard or None
    demonstrated : sequence of ndarray, shape (N, D)
        Channels of the demonstrations; positions in B, m.
    """
    show = scenario.show
    AddBodies(builder, scene.scene_graph, scenario, meshcat)
    if show.ink and ink is not None:
        visualizer = builder.AddSystem(
            InkVisualizer(meshcat=meshcat, grid=ink.grid, path=INK)
        )
        builder.Connect(ink.GetOutputPort("ink"), visualizer.GetInputPort("ink"))
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
    if show.force and scene.whiteboard is not None:
        arrow = builder.AddSystem(
            ForceArrow(scene.plant, body=scene.robot.tip.body(), meshcat=meshcat)
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
    """Add the sliders of a page; only that for samples or means is connected here.

    System: page_controls.
    """
    controls = PageControls(
        meshcat,
        tempo=scenario.skill.tempo,
        normal_force=scenario.press.force if scenario.has_board else None,
        sample=primitive.player.sample,
    )
    builder.AddSystem(controls)
    builder.Connect(controls.GetOutputPort("sample"), primitive.GetInputPort("sample"))
    return controls


def AddMeasuredArm(
    builder: DiagramBuilder,
    scene: BoardScene,
    scenario: Scenario,
    *,
    state: OutputPort,
    measured_position: OutputPort,
    primitive: FourierPrimitiveSystem,
    meshcat: Meshcat,
    demonstrated: Sequence[NDArray[np.float64]] = (),
) -> None:
    """Show an arm at its measured state, the board at its assumed pose, and the plan.

    The page cannot move anything. Systems: scene_graph, geometry_pose,
    meshcat_visualizer, trail_visualizer, plan_visualizer, as far as the scenario's `show`
    says.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
        Not simulated.
    scenario : Scenario
    state : OutputPort
        (2n,), rad and rad/s.
    measured_position : OutputPort
        p_BE, m.
    primitive : FourierPrimitiveSystem
    meshcat : Meshcat
    demonstrated : sequence of ndarray, shape (N, 3)
        Paths in B, m.
    """
    scene_graph: Any = builder.AddNamedSystem("scene_graph", scene.scene_graph)
    poses = builder.AddNamedSystem(
        "geometry_pose",
        MultibodyPositionToGeometryPose(scene.plant, input_multibody_state=True),
    )
    builder.Connect(state, poses.get_input_port())
    source = scene_graph.get_source_pose_port(scene.plant.get_source_id())
    builder.Connect(poses.get_output_port(), source)
    AddBodies(builder, scene.scene_graph, scenario, meshcat)
    AddPaths(
        builder,
        scenario,
        meshcat=meshcat,
        primitive=primitive,
        measured_position=measured_position,
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
    roles = SkillRoles(skill)
    position = list(roles.position)
    if not scenario.has_board:
        meshcat.SetTransform(BOARD, scenario.board.pose())
    surface = scenario.board.curvature()
    if show.demonstrations:
        paths = [path[:, position] for path in demonstrated]
        draw_demonstrations(meshcat, f"{BOARD}/demonstrations", paths, surface=surface)
    if show.trail:
        trail = builder.AddSystem(
            TrailVisualizer(meshcat, path=f"{BOARD}/trail", surface=surface)
        )
        builder.Connect(measured_position, trail.get_input_port())
    if show.plan or show.tube or show.component:
        plan = builder.AddSystem(
            PlanVisualizer(
                meshcat,
                points=primitive.GetOutputPort("plan").size() // skill.n_channels_,
                component_paths=skill.synthesize([c.mean for c in skill.components_])[
                    ..., position
                ],
                channels=skill.n_channels_,
                position=position,
                rotation=roles.rotation or (),
                reference=roles.reference,
                path=f"{BOARD}/plan",
                surface=surface,
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
    ink: InkBoard | None,
    area: NDArray[np.bool_] | None,
    desired_normal_force: OutputPort,
) -> None:
    """Show the state of a station in a panel, by the system page_status.

    Parameters
    ----------
    builder : DiagramBuilder
    panel : PagePanel
    primitive : FourierPrimitiveSystem
    status : OutputPort
        Of the controller and the surface monitor.
    period : float
        Of the controller, s.
    ink : InkBoard or None
        Also measures the normal force; None without a board.
    area : ndarray of bool, shape (ny, nx), optional
        The cells that should be cleaned where there is ink; all by default.
    desired_normal_force : OutputPort
        Of the scenario or the page, N.
    """
    cells = None
    if ink is not None:
        inked = ink.initial_ink >= CLEAN_BELOW
        cells = inked if area is None else inked & area
    page_status = builder.AddSystem(PageStatus(panel, area=cells, status_period=period))
    builder.Connect(status, page_status.GetInputPort("status"))
    component = primitive.GetOutputPort("component")
    builder.Connect(component, page_status.GetInputPort("component"))
    if ink is not None:
        builder.Connect(
            desired_normal_force, page_status.GetInputPort("desired_normal_force")
        )
        for name in ("normal_force", "ink"):
            builder.Connect(ink.GetOutputPort(name), page_status.GetInputPort(name))
