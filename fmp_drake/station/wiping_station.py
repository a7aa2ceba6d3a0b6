"""The whiteboard station: a learned skill wipes a board with the Panda."""

from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import Diagram, DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.primitives import FourierMovementPrimitive, Tracker
from fmp_drake.station.board_scene import AddArmController, AddBoardScene
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.ink_board import InkBoard
from fmp_drake.systems.ink_grid import InkGrid
from fmp_drake.systems.ink_visualizer import InkVisualizer
from fmp_drake.systems.normal_press import NormalPress
from fmp_drake.systems.path_visualizer import PathVisualizer

BOARD_SIZE = (0.50, 0.70)
ERASER_FOOTPRINT = (0.12, 0.05)


def MakeWipingStation(
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    *,
    start: ArrayLike | None = None,
    tracker: Tracker | None = None,
    sample: bool = False,
    seed: int = 0,
    meshcat: Meshcat | None = None,
) -> Diagram:
    """Build the diagram in which the arm plays a skill on the whiteboard.

    The skill lives in the frame B of the board, so do the desired and the measured
    motion. A Simulator's initialisation maps the measured start to the skill.

    Systems: plant, scene_graph, fourier_primitive, normal_press, controller,
    gravity_compensation, actuation, ink_board, and with a Meshcat meshcat_visualizer,
    ink_visualizer and path_visualizer.

    Output ports, all vectors: desired_position, desired_velocity,
    desired_acceleration (3,), covariance (9,), weights, component (1,) of the skill;
    measured_position, measured_velocity (3,) in B, tracking_error (6,),
    status (6,) of the controller, read with `ImpedanceStatus`; torque (7,)
    commanded without gravity, actuation (7,) with it, state (14,) of the arm; ink and
    erase_time per cell, cleaned_fraction (1,), normal_force (1,) in N, contact_area
    (1,) in m^2. Input port: applied_spatial_force, the plant's, for pushes from
    outside; it may stay unconnected.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted, of 3 position channels in the frame of the board, m.
    start : array_like, shape (3,), optional
        p_BE of the eraser at time 0, m; the scenario's where None.
    tracker, sample, seed
        As for `FourierPrimitiveSystem`.
    meshcat : Meshcat, optional
        Where to show the scene.

    Raises
    ------
    StationError
        Where the skill has no 3 channels, or the arm cannot reach the start.
    """
    skill.check_fitted()
    if skill.n_channels_ != 3:
        raise StationError(
            f"the skill has {skill.n_channels_} channels; the station needs the 3 "
            "coordinates of a position."
        )
    builder = DiagramBuilder()
    start = scenario.start_position() if start is None else start
    scene = AddBoardScene(builder, scenario, start=start)
    plant = scene.plant
    controller = AddArmController(builder, scene, scenario.impedance)

    primitive = builder.AddSystem(
        FourierPrimitiveSystem(skill, tracker=tracker, sample=sample, seed=seed)
    )
    press = builder.AddSystem(
        NormalPress(
            force=scenario.press.force, engage_height=scenario.press.engage_height
        )
    )
    measured = controller.GetOutputPort("measured_position")
    builder.Connect(measured, primitive.GetInputPort("measured_position"))
    for name in ("position", "velocity", "acceleration"):
        builder.Connect(
            primitive.GetOutputPort(name), controller.GetInputPort(f"desired_{name}")
        )
    desired = primitive.GetOutputPort("position")
    builder.Connect(desired, press.GetInputPort("desired_position"))
    builder.Connect(measured, press.GetInputPort("measured_position"))
    builder.Connect(
        press.GetOutputPort("wrench"), controller.GetInputPort("feedforward_wrench")
    )

    grid = InkGrid(size=BOARD_SIZE, cell=scenario.ink.cell)
    ink = InkBoard.AddToBuilder(
        builder,
        plant=plant,
        eraser=scene.tip.body(),
        surface=scene.surface,
        grid=grid,
        period=scenario.ink.period,
    )
    # Used where the impedance's configuration enables them.
    for port in (
        ink.GetOutputPort("normal_force"),
        primitive.GetOutputPort("covariance"),
    ):
        builder.Connect(port, controller.GetInputPort(port.get_name()))
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, scene.scene_graph, meshcat).set_name(
            "meshcat_visualizer"
        )
        InkVisualizer.AddToBuilder(
            builder,
            ink.GetOutputPort("ink"),
            meshcat=meshcat,
            grid=grid,
            X_WB=scene.X_WB,
        )
        paths = builder.AddSystem(PathVisualizer(meshcat, X_WB=scene.X_WB))
        builder.Connect(desired, paths.GetInputPort("desired"))
        builder.Connect(measured, paths.GetInputPort("measured"))

    for name in ("position", "velocity", "acceleration"):
        builder.ExportOutput(primitive.GetOutputPort(name), f"desired_{name}")
    for name in ("covariance", "weights", "component"):
        builder.ExportOutput(primitive.GetOutputPort(name), name)
    for name in (
        "measured_position",
        "measured_velocity",
        "tracking_error",
        "torque",
        "status",
    ):
        builder.ExportOutput(controller.GetOutputPort(name), name)
    actuation = builder.GetSubsystemByName("actuation")
    builder.ExportOutput(actuation.get_output_port(), "actuation")
    builder.ExportOutput(plant.get_state_output_port(scene.panda), "state")
    for name in (
        "ink",
        "erase_time",
        "cleaned_fraction",
        "normal_force",
        "contact_area",
    ):
        builder.ExportOutput(ink.GetOutputPort(name), name)
    builder.ExportInput(
        plant.GetInputPort("applied_spatial_force"), "applied_spatial_force"
    )
    diagram = builder.Build()
    diagram.set_name("wiping_station")
    return diagram
