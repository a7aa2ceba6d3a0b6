"""External forces on the simulated arm: disturbances, the mouse, and hands that teach."""

from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.lcm import DrakeLcm
from pydrake.multibody.plant import (
    ExternallyAppliedSpatialForceMultiplexer,
    MultibodyPlant,
)
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, VectorLog
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

from fmp_drake.errors import StationError
from fmp_drake.primitives import Demonstration, add_orientation
from fmp_drake.primitives.data.channels import FORCE_CHANNEL, POSITION_CHANNELS
from fmp_drake.station.board_scene import BODIES, BoardScene, Connect
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems import HandMotion, ImpedanceConfig
from fmp_drake.systems.human_hand import HumanHand
from fmp_drake.systems.mouse_hand import MouseHand
from fmp_drake.systems.optional_spatial_forces import OptionalSpatialForces
from fmp_drake.systems.scripted_disturbances import ScriptedDisturbances
from fmp_drake.systems.teaching.hand_motion import MAX_TURN_RATE
from fmp_drake.systems.teaching.mouse_drag import GUIDING_DRAG, BoardSurface

_PORT = "applied_spatial_force"
# Stiffness of Drake's mouse spring per unit of mass, 1/s². The ratio of its damping to its
# stiffness is the inverse of the square root, 0.1 s.
_SPECIFIC_STIFFNESS = 100.0


def AddExternalForces(
    builder: DiagramBuilder, scene: BoardScene, *, pull: OutputPort | None
) -> None:
    """Export the plant's port for forces, and add the scenario's disturbances to it.

    Systems: disturbances where the scenario has any, with their sum exported as
    disturbance; with these or a mouse optional_spatial_forces and spatial_force_sum.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    pull : OutputPort or None
        The mouse's forces.
    """
    sources = [] if pull is None else [pull]
    if script := scene.scenario.disturbances:
        disturbances = builder.AddSystem(
            ScriptedDisturbances(
                grip=scene.robot.tip, disturbances=script, X_WB=scene.X_WB
            )
        )
        Connect(builder, scene.plant, disturbances, *BODIES)
        builder.ExportOutput(disturbances.GetOutputPort("force"), "disturbance")
        sources.append(disturbances.GetOutputPort("spatial_forces"))
    forces = scene.plant.GetInputPort(_PORT)
    if not sources:
        builder.ExportInput(forces, _PORT)
        return
    exported = builder.AddSystem(OptionalSpatialForces())
    builder.ExportInput(exported.get_input_port(), _PORT)
    sources.insert(0, exported.get_output_port())
    total = builder.AddNamedSystem(
        "spatial_force_sum", ExternallyAppliedSpatialForceMultiplexer(len(sources))
    )
    for i, source in enumerate(sources):
        builder.Connect(source, total.get_input_port(i))
    builder.Connect(total.get_output_port(), forces)


def AddMousePull(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    meshcat: Meshcat,
) -> OutputPort:
    """Add a spring between the mouse and the body that it drags on the page.

    A drag begins with the left button or a finger on a body that Drake's
    MeshcatVisualizer shows; on Meshcat's own page it also needs the Ctrl key. The spring
    pulls the grabbed point towards the mouse, in the plane of the screen.

    Systems: meshcat_mouse_spring (Drake's), mouse_hand.

    Parameters
    ----------
    builder : DiagramBuilder
    plant : MultibodyPlant
        Finalized; its applied_spatial_force port is not connected yet.
    scene_graph : SceneGraph
    meshcat : Meshcat

    Returns
    -------
    OutputPort
        The forces; the caller connects them to the plant's applied_spatial_force port,
        or to a sum before it.

    Raises
    ------
    StationError
        If the plant's port is already connected.
    """
    hand = MouseHand(plant, specific_stiffness=_SPECIFIC_STIFFNESS)
    _ConnectMouse(builder, hand, plant, scene_graph, meshcat)
    return hand.GetOutputPort("spatial_forces")


def _ConnectMouse(
    builder: DiagramBuilder,
    hand: MouseHand,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    meshcat: Meshcat,
) -> None:
    """Connect a hand to Drake's mouse spring and to the plant."""
    count = len(builder.GetSystems())
    config = VisualizationConfig(
        publish_illustration=False,
        publish_proximity=False,
        publish_inertia=False,
        publish_contacts=False,
        enable_meshcat_creation=False,
        mouse_interaction_stiffness=_SPECIFIC_STIFFNESS,
    )
    ApplyVisualizationConfig(
        config,
        builder,
        plant=plant,
        scene_graph=scene_graph,
        meshcat=meshcat,
        lcm=DrakeLcm("memq://null"),
    )
    # Drake skips a plant whose port is connected.
    if len(builder.GetSystems()) == count:
        raise StationError(
            "the plant's applied_spatial_force is connected already; add the mouse "
            "first, and connect the sum of all forces afterwards."
        )
    spring = builder.GetSystems()[-1]
    # Drake connects it to the plant; insert the hand between them.
    builder.Disconnect(spring.get_output_port(), plant.GetInputPort(_PORT))
    builder.AddSystem(hand)
    builder.Connect(spring.get_output_port(), hand.GetInputPort("spring"))
    Connect(builder, plant, hand, *BODIES)


# Compliant in translation and rotation, with a fixed posture of the elbow.
TURNING = ImpedanceConfig(
    translational_stiffness=[1e-3, 1e-3, 1e-3],
    rotational_stiffness=[1e-3, 1e-3, 1e-3],
)

# Compliant in translation, with a level eraser and a fixed posture of the elbow.
GUIDING = ImpedanceConfig(
    translational_stiffness=[1e-3, 1e-3, 1e-3],
    rotational_stiffness=[30.0, 30.0, 30.0],
)


@runtime_checkable
class TeachingHand(Protocol):
    """Hand that guides the arm: simulated, by the mouse, or a person's at a real arm.

    Examples
    --------
    >>> hand: TeachingHand = SimulatedHand(HandMotion.make("eight", duration=5.0, seed=0))
    >>> from fmp_drake.station import LoadScenario, MakeStation
    >>> station = MakeStation(LoadScenario("table_top"), hand)
    """

    @property
    def start(self) -> list[float] | None:
        """Initial p_BE of the eraser, m; the scenario's if None."""

    def recorded(self, scenario: Scenario) -> tuple[str, ...]:
        """Return the outputs to record beside the position.

        They are `measured_pose` and `normal_force`, or none.
        """

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene
    ) -> tuple[OutputPort, OutputPort]:
        """Add the hand; return its forces, and a port (1,) that is 1 during guiding."""


@dataclass(frozen=True)
class SimulatedHand:
    """Model of a person's hand that guides the arm all the time.

    On a curved board, where the tool turns, it is slower; see `HandMotion.slowed`.

    Attributes
    ----------
    motion : HandMotion

    Examples
    --------
    >>> motion = HandMotion.make("eight", duration=5.0, seed=0)
    >>> len(SimulatedHand(motion).start)
    3
    """

    motion: HandMotion

    @property
    def start(self) -> list[float]:
        """Start of the motion; just above the board if the motion has no height."""
        values, _ = self.motion.at(0.0)
        start = dict(zip(self.motion.channels, values.tolist(), strict=True))
        return [start["x"], start["y"], start.get("z", 0.005)]

    def recorded(self, scenario: Scenario) -> tuple[str, ...]:  # noqa: ARG002
        """Return the outputs of the teaching station to record beside the position."""
        names = {"rx": "measured_pose", "force": "normal_force"}
        return tuple(port for c, port in names.items() if c in self.motion.channels)

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene
    ) -> tuple[OutputPort, OutputPort]:
        """Add human_hand, and is_guided, a constant."""
        if scene.whiteboard is None and "z" not in self.motion.channels:
            raise StationError(
                f"the motion has {', '.join(self.motion.channels)}, and the scenario no board "
                "to guide the tool over; use a motion with a height, such as stirring, or a "
                "scenario with a board."
            )
        amplitude = scene.scenario.board.motion.amplitude
        if amplitude > 0:
            raise StationError(
                f"board.motion.amplitude is {amplitude:g} m; the simulated hand moves over "
                "a board at rest. Set it to 0."
            )
        hand = builder.AddSystem(
            HumanHand(
                scene.plant,
                grip=scene.robot.tip,
                X_WB=scene.X_WB,
                motion=self.motion.slowed(scene.curvature),
                R_BE=scene.scenario.eraser_orientation(),
                surface=scene.curvature,
            )
        )
        Connect(builder, scene.plant, hand, *BODIES)
        is_guided = builder.AddNamedSystem(
            "is_guided", ConstantVectorSource(np.ones(1))
        )
        return hand.GetOutputPort("spatial_forces"), is_guided.get_output_port()


@dataclass(frozen=True)
class MouseOnPage:
    """Hand guiding by the mouse on a page.

    A drag of the eraser or of any link moves the eraser parallel to the board, slower on a
    curved board, where the tool turns. After the drag the hand holds the position. On
    Meshcat's own page a drag needs the Ctrl key.

    Attributes
    ----------
    meshcat : Meshcat
        With ``?tracked_camera=on`` in its address it sends the pose of its camera;
        otherwise the scenario's is assumed.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario, MakeStation
    >>> hand = MouseOnPage(Meshcat())
    >>> station = MakeStation(LoadScenario("table_top"), hand)
    """

    meshcat: Meshcat

    @property
    def start(self) -> None:
        """None: the scenario's start is used."""
        return

    def recorded(self, scenario: Scenario) -> tuple[str, ...]:
        """Return the pose in free space, where the tool may be turned."""
        return () if scenario.has_board else ("measured_pose",)

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene
    ) -> tuple[OutputPort, OutputPort]:
        """Add meshcat_mouse_spring (Drake's) and mouse_hand."""
        scenario, plant, curvature = scene.scenario, scene.plant, scene.curvature
        free = np.array(scenario.board.size) - scenario.board_footprint()
        robot, config, R_WE = scene.robot, GUIDING_DRAG, None
        if not curvature.is_plane:
            greatest = max(abs(curvature.kx), abs(curvature.ky))
            speed = min(config.max_speed, MAX_TURN_RATE / greatest)
            config = replace(config, max_speed=speed)
        if not scenario.has_board:
            R_WE = scene.X_WB.rotation() @ scenario.eraser_orientation()
        models = (robot.arm, robot.tool)
        hand = MouseHand(
            plant,
            meshcat=self.meshcat,
            specific_stiffness=_SPECIFIC_STIFFNESS,
            config=config,
            bodies=[i for model in models for i in plant.GetBodyIndices(model)],
            tip=robot.tip,
            board=BoardSurface(
                scene.X_WB.GetAsMatrix34(),
                free / 2,
                curvature,
                is_solid=scenario.has_board,
            ),
            R_WE=R_WE,
            eye=scenario.camera.eye,
        )
        _ConnectMouse(builder, hand, plant, scene.scene_graph, self.meshcat)
        return hand.GetOutputPort("spatial_forces"), hand.GetOutputPort("is_guided")


def DemonstrationFromRecorder(
    diagram: Diagram, context: Context, *, skip: float, note: str
) -> Demonstration:
    """Return the recording of a teaching station, with and without guiding.

    The channels are x, y and z, and orientation and force if the hand guides them.

    Parameters
    ----------
    diagram : Diagram
        From `MakeStation` with a hand.
    context : Context
        Of the diagram, after a simulation.
    skip : float
        Duration to omit at the start, s.
    note : str
    """
    log = _Log(diagram, context, "recorder")
    times = log.sample_times()
    mask = times >= skip - 1e-9
    values = log.data()[:, mask].T
    channels: tuple[str, ...] = POSITION_CHANNELS
    units: tuple[str, ...] = ("m",) * 3
    recorded = {
        name: _Log(diagram, context, f"record_{name}").data()[:, mask].T
        for name in ("measured_pose", "normal_force")
        if diagram.HasSubsystemNamed(f"record_{name}")
    }
    if "normal_force" in recorded:
        values = np.column_stack([values, recorded["normal_force"]])
        channels, units = (*channels, FORCE_CHANNEL), (*units, "N")
    demonstration = Demonstration(
        time=np.round(times[mask] - skip, 9),
        values=np.array(values),
        channels=channels,
        units=units,
        frame="board",
        note=note,
    )
    if "measured_pose" in recorded:
        quaternions = recorded["measured_pose"][:, :4]
        demonstration = add_orientation(demonstration, quaternions, order="wxyz")
    return demonstration


def _Log(diagram: Diagram, context: Context, name: str) -> VectorLog:
    """Return the log of a log sink of a diagram."""
    sink: Any = diagram.GetSubsystemByName(name)
    return sink.FindLog(context)
