"""Page of a station: visualizers, controls, panel, and the stage of page and films."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import (
    LightParameter,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    RenderEngineVtkParams,
    Rgba,
)
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array, finite_array
from fmp_drake.station.board_scene import AddBoardScene, BoardScene, Connect
from fmp_drake.station.external_forces import AddMousePull
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scenario_parts import FORCE_TOLERANCE
from fmp_drake.station.skill_motion import DemonstratedArea, Playback
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
FIELD_OF_VIEW = 40.0  # Of the page's camera, vertical, degrees.
_SKY = (0.93, 0.945, 0.96)
_GROUND = (0.80, 0.82, 0.85)
# Direction of the key light in the camera's axes: right, down, away from it.
_KEY = np.array([0.50, 0.75, 0.80]) / np.linalg.norm([0.50, 0.75, 0.80])
_KEY_DISTANCE = 3.4  # From the robot's base, m.
_ON = "/<object>"


def AddBodies(builder: DiagramBuilder, scene: BoardScene, meshcat: Meshcat) -> None:
    """Show arm, eraser and board, with lights and the scenario's camera.

    System: meshcat_visualizer.
    """
    meshcat.Delete(_BODIES)
    if not scene.scenario.has_board:
        meshcat.SetTransform(BOARD, scene.scenario.board.pose())
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


def ShowStill(scenario: Scenario, meshcat: Meshcat) -> None:
    """Show arm, eraser and board at rest, before there is a station.

    The tool is at the start; where the arm cannot reach it, in the preferred posture.

    Parameters
    ----------
    scenario : Scenario
    meshcat : Meshcat
        A station clears the picture before it draws its own.
    """
    builder = DiagramBuilder()
    try:
        scene = AddBoardScene(builder, scenario, start=scenario.start)
    except StationError:
        builder, q = DiagramBuilder(), scenario.preferred_posture()
        scene = AddBoardScene(builder, scenario, start=scenario.start, q=q)
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
    demonstrated: Sequence[Array],
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
        Connect(builder, ink, visualizer, "ink")
    _AddPaths(builder, scene, playback, meshcat, demonstrated)
    controls = pull = None
    if show.controls:
        scenario, primitive = scene.scenario, playback.primitive
        controls = PageControls(
            meshcat,
            tempo=scenario.skill.tempo,
            press_force=scenario.press.force if scenario.has_board else None,
            sample=primitive.player.sample,
        )
        builder.AddSystem(controls)
        Connect(builder, controls, primitive, "sample")
    if show.force and scene.is_simulated and scene.whiteboard is not None:
        arrow = ForceArrow(plant, body=scene.robot.tip.body(), meshcat=meshcat)
        builder.AddSystem(arrow)
        Connect(builder, plant, arrow, "contact_results")
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


def _AddPaths(
    builder: DiagramBuilder,
    scene: BoardScene,
    playback: Playback,
    meshcat: Meshcat,
    demonstrated: Sequence[Array],
) -> None:
    """Show demonstrated paths, the measured one and the plan.

    Systems: trail_visualizer, plan_visualizer.
    """
    scenario, surface = scene.scenario, scene.curvature
    show, skill, roles = scenario.show, playback.skill, playback.roles
    position = list(roles.position)
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
                roles=roles,
                path=f"{BOARD}/plan",
                surface=surface,
                show_plan=show.plan,
                show_tube=show.tube,
                show_component=show.component,
            )
        )
        Connect(builder, primitive, plan, "plan", "plan_covariance", "component")


def AddPageStatus(
    builder: DiagramBuilder,
    scene: BoardScene,
    playback: Playback,
    *,
    measured: Measurements,
    last_fault: OutputPort,
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
    last_fault : OutputPort
        Of the controller.
    desired_normal_force : OutputPort
        Of the scenario or the page, N.
    panel : PagePanel
    """
    scenario, ink = scene.scenario, measured.ink_board
    cells = None
    if ink is not None:
        cells = DemonstratedArea(scenario, playback.skill)
        cells &= ink.initial_ink >= CLEAN_BELOW
    status = builder.AddSystem(PageStatus(panel, area=cells))
    builder.Connect(measured.status, status.GetInputPort("status"))
    builder.Connect(last_fault, status.GetInputPort("last_fault"))
    Connect(builder, playback.primitive, status, "component")
    if ink is not None:
        name = "desired_normal_force"
        builder.Connect(desired_normal_force, status.GetInputPort(name))
        Connect(builder, ink, status, "normal_force", "ink")


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
    >>> describe_page(LoadScenario("table_top"))["desired_force"]
    10.0
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
        band = {"desired_force": force, "force_tolerance": FORCE_TOLERANCE}
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


def SetStage(meshcat: Meshcat, *, eye: ArrayLike, target: ArrayLike) -> None:
    """Light a page and place its camera.

    The background is bright, without grid and axes. One lamp above the viewer's left
    shoulder casts soft shadows; the other light is weak and ambient. The lamp stays fixed
    when a user rotates the view.

    Parameters
    ----------
    meshcat : Meshcat
    eye, target : array_like, shape (3,)
        Position of the camera, and point in the middle of its view, in the world, m.

    Raises
    ------
    StationError
        If the direction of the view is undefined or vertical.
    """
    eye = finite_array(eye, "the camera's eye", (3,), error=StationError)
    target = finite_array(target, "the camera's target", (3,), error=StationError)
    R_WC = CameraAxes(eye, target)
    meshcat.SetProperty("/Background" + _ON, "top_color", list(_SKY))
    meshcat.SetProperty("/Background" + _ON, "bottom_color", list(_GROUND))
    # The background also illuminates the arm's meshes, here less than the ambient light.
    meshcat.SetProperty("/", "environmentIntensity", 0.15)
    for name in (
        "/Grid",
        "/Axes",
        "/Lights/PointLightNegativeX",
        "/Lights/PointLightPositiveX",
    ):
        meshcat.SetProperty(name, "visible", False)

    meshcat.SetProperty("/Lights/SpotLight", "visible", True)
    key = "/Lights/SpotLight" + _ON
    meshcat.SetProperty(key, "position", list(-_KEY_DISTANCE * (R_WC @ _KEY)))
    for name, value in (
        ("intensity", 58.0),  # cd
        ("angle", 0.42),  # rad
        ("penumbra", 1.0),
        ("shadow.mapSize.width", 2048.0),
        ("shadow.mapSize.height", 2048.0),
        ("shadow.radius", 3.0),
        ("shadow.bias", -0.0004),
        ("shadow.normalBias", 0.02),
    ):
        meshcat.SetProperty(key, name, value)
    meshcat.SetProperty(key, "castShadow", True)
    meshcat.SetProperty("/Lights/AmbientLight" + _ON, "intensity", 0.65)
    fill = "/Lights/FillLight" + _ON
    meshcat.SetProperty(fill, "position", list(R_WC @ [1.0, -0.2, -0.6]))
    meshcat.SetProperty(fill, "intensity", 0.35)

    camera = Meshcat.PerspectiveCamera(
        fov=FIELD_OF_VIEW, aspect=1.5, near=0.05, far=50.0
    )
    meshcat.SetCamera(camera)
    meshcat.SetCameraPose(eye, target)


def RenderLights() -> RenderEngineVtkParams:
    """Return the parameters of a VTK renderer whose pictures look like the page.

    The lamps are fixed to the camera, at a distance of 1 m to 3 m. Two lamps replace the key
    light, and only one of them casts shadows. VTK's shadow maps darken patches of round
    surfaces towards the lamp, which is less visible with two lamps. The caller sets the
    backend.

    Returns
    -------
    RenderEngineVtkParams
    """
    place = np.array([0.0, 0.0, 1.9]) - _KEY_DISTANCE * _KEY
    lamps = [
        _Lamp(place, 1.75),
        _Lamp(np.array([2.0, -0.4, 0.0]), 0.8),
        _Lamp(np.array([-1.5, -1.0, 0.0]), 0.5),
        _Lamp(np.array([0.0, 2.0, 2.0]), 0.35),
    ]
    key = _Lamp(place, 1.35)
    key.type = "spot"
    key.direction = _KEY
    key.cone_angle = 24.0
    return RenderEngineVtkParams(
        lights=[key, *lamps],
        default_clear_color=np.array(_SKY),
        cast_shadows=True,
        shadow_map_size=1024,
    )


def _Lamp(position: np.ndarray, intensity: float) -> LightParameter:
    return LightParameter(
        type="point",
        frame="camera",
        color=Rgba(1, 1, 1),
        intensity=intensity,
        position=position,
    )


def CameraAxes(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return R_WC, with the right, down and forward axes of the camera as columns."""
    forward = target - eye
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        raise StationError(
            f"the camera at {eye} looks straight up or down at {target}; move its eye "
            "a little to the side."
        )
    forward = forward / np.linalg.norm(forward)
    right = right / np.linalg.norm(right)
    return np.column_stack([right, np.cross(forward, right), forward])
