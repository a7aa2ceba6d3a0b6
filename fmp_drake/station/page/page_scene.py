"""Page of a station: its visualizers and controls, and the fields of its panel."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import (
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
)
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from fmp_drake.station.external_forces import AddMousePull
from fmp_drake.station.page.stage import SetStage
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scenario_parts import FORCE_TOLERANCE
from fmp_drake.station.scene import AddBoardScene, BoardScene
from fmp_drake.station.skill_motion import ChoiceByInk, Playback
from fmp_drake.station.tasks.task import Measurements
from fmp_drake.systems import PagePanel, draw_demonstrations
from fmp_drake.systems.ink.grid import CLEAN_BELOW
from fmp_drake.systems.ink.mesh import ink_colours
from fmp_drake.systems.page.force_arrow import FORCE_COLOR, ForceArrow
from fmp_drake.systems.page.ink_visualizer import InkVisualizer
from fmp_drake.systems.page.page_controls import PageControls
from fmp_drake.systems.page.page_panel import Kind, PanelFields
from fmp_drake.systems.page.page_status import PageStatus
from fmp_drake.systems.page.paths import DEMONSTRATION_COLOR, css_color
from fmp_drake.systems.page.plan_visualizer import (
    PLAN_COLOR,
    TUBE_COLOR,
    PlanVisualizer,
)
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR, TrailVisualizer

# The periods on the page are 2^n milliseconds: events then coincide exactly with steps of
# the controller, and do not split a step of the integrator.

# Path of the bodies in Meshcat's tree.
_BODIES = "bodies"
BOARD = f"{_BODIES}/whiteboard/board"
"""Path of the board's body in Meshcat's tree. Drawings on the board are below this path
and move with the board, on the page and in recordings."""
INK = f"{BOARD}/ink"
"""Path of the ink in Meshcat's tree."""

VIEW_HELP = (
    "Drag the background to turn the view. Two fingers or the right button move it, "
    "the wheel zooms."
)
"""Help about the camera."""

_PULL_HELP = "Drag the arm or the {} to pull it; let go, and it returns."
_INK_COLOR = "rgb({:.0f} {:.0f} {:.0f})".format(*(255 * ink_colours(1.0, srgb=True)))


def AddBodies(builder: DiagramBuilder, scene: BoardScene, meshcat: Meshcat) -> None:
    """Show arm, eraser and board, with lights and the scenario's camera.

    System: meshcat_visualizer.
    """
    meshcat.Delete(_BODIES)
    visualizer = MeshcatVisualizer.AddToBuilder(
        builder,
        scene.scene_graph,
        meshcat,
        MeshcatVisualizerParams(
            prefix=_BODIES,
            publish_period=0.032,
            # An initialisation must not delete the drawings on the board.
            delete_on_initialization_event=False,
        ),
    )
    visualizer.set_name("meshcat_visualizer")
    camera = scene.scenario.camera
    SetStage(meshcat, eye=camera.eye, target=camera.target)


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
    AddBodies(builder, scene, meshcat)
    diagram = builder.Build()
    diagram.ForcedPublish(diagram.CreateDefaultContext())


def AddPage(
    builder: DiagramBuilder,
    scene: BoardScene,
    playback: Playback,
    *,
    measured: Measurements,
    driver: System,
    meshcat: Meshcat,
    demonstrated: Sequence[NDArray[np.float64]],
) -> tuple[PageControls | None, OutputPort | None]:
    """Show the items of a station that the scenario's `show` enables.

    An arm that is not simulated is shown in its measured state, with the board at its
    assumed pose; it cannot be pulled.

    Systems: meshcat_visualizer, ink_visualizer, trail_visualizer, plan_visualizer,
    page_controls, force_arrow and those of `AddMousePull`; scene_graph and geometry_pose of
    an arm that is not simulated.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    playback : Playback
    measured : Measurements
        Of the task.
    driver : System
        From `MakeDriver`.
    meshcat : Meshcat
    demonstrated : sequence of ndarray, shape (N, D)
        Channels of the demonstrations; positions in B, m.

    Returns
    -------
    controls : PageControls or None
        The sliders; only the one for samples or means is connected here.
    pull : OutputPort or None
        The forces of the mouse on the bodies.
    """
    show, plant = scene.scenario.show, scene.plant
    if not scene.is_simulated:
        _AddMeasuredPoses(builder, scene, driver.GetOutputPort("state"))
    AddBodies(builder, scene, meshcat)
    if show.ink and (ink := measured.ink_board) is not None:
        visualizer = builder.AddSystem(
            InkVisualizer(meshcat=meshcat, grid=ink.grid, path=INK)
        )
        builder.Connect(ink.GetOutputPort("ink"), visualizer.GetInputPort("ink"))
    _AddPaths(builder, scene, playback, meshcat, demonstrated)
    controls = pull = None
    if show.controls:
        controls = _AddControls(builder, scene, playback, meshcat)
    if show.force and scene.is_simulated and scene.whiteboard is not None:
        name = "contact_results"
        arrow = ForceArrow(plant, body=scene.robot.tip.body(), meshcat=meshcat)
        builder.AddSystem(arrow)
        builder.Connect(plant.GetOutputPort(name), arrow.GetInputPort(name))
    if show.mouse and scene.is_simulated:
        pull = AddMousePull(builder, plant, scene.scene_graph, meshcat)
    return controls, pull


def _AddMeasuredPoses(
    builder: DiagramBuilder, scene: BoardScene, state: OutputPort
) -> None:
    """Add the scene graph of an arm that is not simulated, with its measured state."""
    scene_graph: Any = builder.AddNamedSystem("scene_graph", scene.scene_graph)
    poses = builder.AddNamedSystem(
        "geometry_pose",
        MultibodyPositionToGeometryPose(scene.plant, input_multibody_state=True),
    )
    builder.Connect(state, poses.get_input_port())
    source = scene_graph.get_source_pose_port(scene.plant.get_source_id())
    builder.Connect(poses.get_output_port(), source)


def _AddControls(
    builder: DiagramBuilder, scene: BoardScene, playback: Playback, meshcat: Meshcat
) -> PageControls:
    """Add the sliders of a page: system page_controls."""
    scenario, primitive = scene.scenario, playback.primitive
    controls = PageControls(
        meshcat,
        tempo=scenario.skill.tempo,
        normal_force=scenario.press.force if scenario.has_board else None,
        sample=primitive.player.sample,
    )
    builder.AddSystem(controls)
    builder.Connect(controls.GetOutputPort("sample"), primitive.GetInputPort("sample"))
    return controls


def _AddPaths(
    builder: DiagramBuilder,
    scene: BoardScene,
    playback: Playback,
    meshcat: Meshcat,
    demonstrated: Sequence[NDArray[np.float64]],
) -> None:
    """Show demonstrated paths, the measured one and the plan.

    Systems: trail_visualizer, plan_visualizer.
    """
    scenario, surface = scene.scenario, scene.curvature
    show, skill, roles = scenario.show, playback.skill, playback.roles
    position = list(roles.position)
    if not scenario.has_board:
        meshcat.SetTransform(BOARD, scenario.board.pose())
    if show.demonstrations:
        paths = [path[:, position] for path in demonstrated]
        draw_demonstrations(meshcat, f"{BOARD}/demonstrations", paths, surface=surface)
    if show.trail:
        trail = builder.AddSystem(
            TrailVisualizer(meshcat, path=f"{BOARD}/trail", surface=surface)
        )
        builder.Connect(playback.position, trail.get_input_port())
    if show.plan or show.tube or show.component:
        primitive = playback.primitive
        means = skill.synthesize([c.mean for c in skill.components_])
        plan = builder.AddSystem(
            PlanVisualizer(
                meshcat,
                points=primitive.GetOutputPort("plan").size() // skill.n_channels_,
                component_paths=means[..., position],
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
    scene: BoardScene,
    playback: Playback,
    *,
    measured: Measurements,
    desired_normal_force: OutputPort,
    panel: PagePanel,
) -> None:
    """Show the state of a station in a panel, by the system page_status.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    playback : Playback
    measured : Measurements
        Of the task.
    desired_normal_force : OutputPort
        Of the scenario or the page, N.
    panel : PagePanel
    """
    scenario, ink = scene.scenario, measured.ink_board
    cells = None
    if ink is not None:
        cells = ink.initial_ink >= CLEAN_BELOW
        _, area = ChoiceByInk(scenario, playback.skill)
        cells = cells if area is None else cells & area
    period = scenario.impedance.control_period
    status = builder.AddSystem(PageStatus(panel, area=cells, status_period=period))
    builder.Connect(measured.status, status.GetInputPort("status"))
    component = playback.primitive.GetOutputPort("component")
    builder.Connect(component, status.GetInputPort("component"))
    if ink is not None:
        name = "desired_normal_force"
        builder.Connect(desired_normal_force, status.GetInputPort(name))
        for name in ("normal_force", "ink"):
            builder.Connect(ink.GetOutputPort(name), status.GetInputPort(name))


def describe_page(scenario: Scenario, *, replay: bool = False) -> PanelFields:
    """Return the constant fields of the panel of a station: texts and legend.

    Parameters
    ----------
    scenario : Scenario
    replay : bool
        Whether the page only replays a run: there is no plan, and nothing can be pulled.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario
    >>> describe_page(LoadScenario("table_top"))["force_band"]
    (5.0, 15.0)
    """
    show, force = scenario.show, scenario.press.force
    plans, has_board = not replay, scenario.has_board
    tool = "eraser" if has_board else "tool"
    legend: list[tuple[bool, str, Rgba | str, Kind]] = [
        (show.ink and has_board, "ink", _INK_COLOR, "area"),
        (show.demonstrations, "demonstrated paths", DEMONSTRATION_COLOR, "line"),
        (show.trail, f"path of the {tool}", TRAIL_COLOR, "line"),
        (show.plan and plans, "plan of the next seconds", PLAN_COLOR, "line"),
        (show.tube and plans, "its variation (2σ)", TUBE_COLOR, "area"),
        (show.component and plans, "mean of the component", "", "line"),
        (show.force and has_board, "force on the eraser", FORCE_COLOR, "arrow"),
    ]
    band: PanelFields = {}
    if has_board:
        band["force_band"] = (
            max(0.0, force - FORCE_TOLERANCE),
            force + FORCE_TOLERANCE,
        )
    return {
        **band,
        "subtitle": scenario.description,
        "legend": [
            {
                "name": name,
                "color": color if isinstance(color, str) else css_color(color),
                "kind": kind,
            }
            for is_shown, name, color, kind in legend
            if is_shown
        ],
        "grab": "you are pulling" if show.mouse and plans else "",
        "help": [
            *([_PULL_HELP.format(tool)] if show.mouse and plans else []),
            VIEW_HELP,
        ],
    }
