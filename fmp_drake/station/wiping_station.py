"""The whiteboard station: a learned skill wipes a board with the Panda."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from fmp_drake.errors import StationError
from fmp_drake.primitives import FourierMovementPrimitive, Tracker
from fmp_drake.station.arm_controller import AddArmController
from fmp_drake.station.board_scene import AddBoardScene, BoardScene
from fmp_drake.station.page_scene import BOARD, AddBodies
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.ink_board import InkBoard
from fmp_drake.systems.ink_grid import InkGrid
from fmp_drake.systems.ink_visualizer import InkVisualizer
from fmp_drake.systems.normal_press import NormalPress
from fmp_drake.systems.path_visualizer import PathVisualizer
from fmp_drake.systems.scripted_disturbances import Hold, Push, ScriptedDisturbances
from fmp_drake.systems.spatial_force_sum import SpatialForceSum


def MakeWipingStation(
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    *,
    start: ArrayLike | None = None,
    tracker: Tracker | None = None,
    sample: bool | None = None,
    seed: int | None = None,
    visuals: str = "own",
    meshcat: Meshcat | None = None,
) -> Diagram:
    """Build the diagram in which the arm plays a skill on the whiteboard.

    The skill lives in the frame B of the board, so do the desired and the measured
    motion. A Simulator's initialisation maps the measured start to the skill.

    Systems: plant, scene_graph, fourier_primitive, tempo, normal_press, controller,
    gravity_compensation, actuation, ink_board; sensors, rail, rail_state, task_frame,
    task_frame_velocity, task_frame_acceleration, disturbances and spatial_force_sum
    where the scenario needs them; with a Meshcat meshcat_visualizer,
    ink_visualizer and path_visualizer.

    Output ports, all vectors: desired_position, desired_velocity,
    desired_acceleration (3,), covariance (9,), weights, component (1,), remaps (2,) of
    the skill; measured_position, measured_velocity (3,) in B, tracking_error (6,),
    status (6,) of the controller, read with `ImpedanceStatus`; torque (7,)
    commanded without gravity, actuation (7,) with it, state (14,) of the arm; ink and
    erase_time per cell, cleaned_fraction (1,), normal_force (1,) in N, contact_area
    (1,) in m^2; disturbance (3,), the force of the scenario's disturbances in N, in W,
    where it has any. Input port: applied_spatial_force, the plant's, for pushes
    from outside; it may stay unconnected.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted, of 3 position channels in the frame of the board, m.
    start : array_like, shape (3,), optional
        p_BE of the eraser at time 0, m; the scenario's where None.
    tracker : Tracker, optional
        As for `FourierPrimitiveSystem`.
    sample, seed : optional
        Instead of the scenario's.
    visuals : str
        Of the arm: `own`, or `drake_models` for those that Drake downloads.
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
    scene = AddBoardScene(builder, scenario, start=start, visuals=visuals)
    plant = scene.plant
    controller = AddArmController(
        builder, scene, scenario.impedance, sensors=scenario.sensors
    )
    plays = scenario.skill
    primitive = builder.AddSystem(
        FourierPrimitiveSystem(
            skill,
            tracker=tracker,
            sample=plays.sample if sample is None else sample,
            seed=plays.seed if seed is None else seed,
            push_threshold=plays.push_threshold,
            push_dwell=plays.push_dwell,
        )
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
    tempo = builder.AddSystem(ConstantVectorSource(np.array([plays.tempo])))
    tempo.set_name("tempo")
    builder.Connect(tempo.get_output_port(), primitive.GetInputPort("tempo"))

    x, y = scenario.board.size
    grid = InkGrid(size=(x, y), cell=scenario.ink.cell)
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
        AddBodies(builder, scene, meshcat)
        InkVisualizer.AddToBuilder(
            builder,
            ink.GetOutputPort("ink"),
            meshcat=meshcat,
            grid=grid,
            X_WB=RigidTransform(),
            path=f"{BOARD}/ink",
        )
        paths = builder.AddSystem(PathVisualizer(meshcat, path=f"{BOARD}/paths"))
        builder.Connect(desired, paths.GetInputPort("desired"))
        builder.Connect(measured, paths.GetInputPort("measured"))
    _AddExternalForces(builder, scene, scenario)

    for name in ("position", "velocity", "acceleration"):
        builder.ExportOutput(primitive.GetOutputPort(name), f"desired_{name}")
    for name in ("covariance", "weights", "component", "remaps"):
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
    diagram = builder.Build()
    diagram.set_name("wiping_station")
    return diagram


def _AddExternalForces(
    builder: DiagramBuilder, scene: BoardScene, scenario: Scenario
) -> None:
    """Export the plant's port for forces, and add the scenario's disturbances to it."""
    name = "applied_spatial_force"
    forces = scene.plant.GetInputPort(name)
    if not scenario.disturbances:
        builder.ExportInput(forces, name)
        return
    X_WB = scene.X_WB
    script: list[Push] = []
    for each in scenario.disturbances:
        if each.kind == "push":
            script.append(
                Push(
                    start=each.start,
                    duration=each.duration,
                    every=each.every,
                    force=X_WB.rotation() @ np.array(each.force),
                )
            )
        else:
            script.append(
                Hold(
                    start=each.start,
                    duration=each.duration,
                    every=each.every,
                    force=np.zeros(3),
                    point=X_WB @ np.array(each.position),
                    stiffness=each.stiffness,
                    max_force=each.max_force,
                )
            )
    disturbances = builder.AddSystem(
        ScriptedDisturbances(grip=scene.tip, disturbances=script)
    )
    for port in ("body_poses", "body_spatial_velocities"):
        builder.Connect(
            scene.plant.GetOutputPort(port), disturbances.GetInputPort(port)
        )
    total = builder.AddSystem(SpatialForceSum("outside", "scripted"))
    builder.ExportInput(total.GetInputPort("outside"), name)
    builder.Connect(
        disturbances.GetOutputPort("spatial_forces"), total.GetInputPort("scripted")
    )
    builder.Connect(total.get_output_port(), forces)
    builder.ExportOutput(disturbances.GetOutputPort("force"), "disturbance")
