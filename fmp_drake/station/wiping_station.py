"""The whiteboard station: a learned skill wipes a board with the Panda."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from fmp_drake.primitives import FourierMovementPrimitive, Tracker
from fmp_drake.station.parts.arm_controller import (
    AddArmController,
    AddNormalForceEstimator,
)
from fmp_drake.station.parts.board_ink import AddInk
from fmp_drake.station.parts.board_scene import AddBoardScene
from fmp_drake.station.parts.external_forces import AddExternalForces
from fmp_drake.station.parts.page_scene import AddPage, AddPageStatus, PagePorts
from fmp_drake.station.parts.press_limit import CheckPress
from fmp_drake.station.parts.skill_motion import DESIRED, AddSkillMotion, ChoiceByInk
from fmp_drake.station.parts.skill_paths import CheckPositions
from fmp_drake.station.parts.surface_watch import AddSurfaceWatch
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.viewer.page_panel import PagePanel


def MakeWipingStation(
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    *,
    start: ArrayLike | None = None,
    q: ArrayLike | None = None,
    tracker: Tracker | None = None,
    sample: bool | None = None,
    seed: int | None = None,
    visuals: str = "own",
    meshcat: Meshcat | None = None,
    panel: PagePanel | None = None,
    demonstrated: Sequence[NDArray[np.float64]] = (),
) -> Diagram:
    """Build the diagram in which the arm plays a skill on the whiteboard.

    The skill lives in the frame B of the board, so do the desired and the measured
    motion. A Simulator's initialisation maps the measured start to the skill. For
    a plant without a time step (CENIC) give it the scenario's integrator:
    ``ApplySimulatorConfig(scenario.simulator, simulator)``.

    Systems: plant, scene_graph, fourier_primitive, desired_motion, tempo, desired_normal_force,
    controller, panda_driver, ink_board, surface_monitor, status; where the scenario needs them
    normal_force_estimator, rail, rail_state, task_frame, task_frame_velocity, task_frame_acceleration,
    joint_friction, disturbances and spatial_force_sum; with a Meshcat those of `AddPage`,
    whose page_controls take the place of tempo and desired_normal_force; with a panel
    page_status.

    Output ports, all vectors: desired_position, desired_velocity,
    desired_acceleration (3,), covariance (9,), weights, component (1,), remaps (2,) of
    the skill, and its phase (1,) where it has a phase model; measured_position, measured_velocity (3,) in B, tracking_error (6,),
    status (6,) of the controller and of the surface monitor, read with
    `ImpedanceStatus`; penetration (1,) in m, of the deepest hard point of arm and eraser
    below the board's surface; torque (7,)
    commanded without gravity, actuation (7,) with it, state (14,) of the arm; ink
    per cell, cleaned_fraction (1,), normal_force (1,) in N,
    contact_area (1,) in m^2; disturbance (3,), the force of the scenario's
    disturbances in N, in W, where it has any. Input port: applied_spatial_force, the plant's, for pushes
    from outside; it may stay unconnected.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted, of 3 position channels in the frame of the board, m.
    start : array_like, shape (3,), optional
        p_BE of the eraser at time 0, m; the scenario's where None.
    q : array_like, shape (7,), optional
        Joint angles in which the arm begins instead, at rest, rad.
    tracker : Tracker, optional
        As for `FourierPrimitiveSystem`.
    sample, seed : optional
        Instead of the scenario's.
    visuals : str
        Of the arm: `own`, or `drake_models` for those that Drake downloads.
    meshcat : Meshcat, optional
        Where to show the scene, as far as the scenario's `show` says.
    panel : PagePanel, optional
        Where to say what goes on.
    demonstrated : sequence of ndarray, shape (N, 3)
        Paths in B to show, m.

    Raises
    ------
    StationError
        Where the skill has no 3 channels, the arm cannot reach the start, or the press
        is more than it bears there.
    """
    CheckPositions(skill)
    builder = DiagramBuilder()
    start = scenario.start if start is None else start
    scene = AddBoardScene(builder, scenario, start=start, q=q, visuals=visuals)
    CheckPress(scenario, scene)
    plant = scene.plant
    controller = AddArmController(
        builder,
        scene,
        scenario.impedance,
        engage_height=scenario.press.engage_height,
        sensors=scenario.sensors,
    )
    plays = scenario.skill
    ink = AddInk(builder, scene, scenario)
    choice, area = ChoiceByInk(scenario, skill, ink.grid)
    primitive, desired = AddSkillMotion(
        builder,
        skill,
        plays,
        controller,
        tracker=tracker,
        sample=sample,
        seed=seed,
        choice=choice,
    )
    if choice is not None:
        builder.Connect(ink.GetOutputPort("ink"), primitive.GetInputPort("ink"))
    driver = builder.GetSubsystemByName("panda_driver")
    normal_force = ink.GetOutputPort("normal_force")
    if scenario.press.by_torque:
        normal_force = AddNormalForceEstimator(
            builder, scene.arm, scene.arm_tip, scene.X_WA.rotation(), driver
        )
    # Used where the impedance's configuration enables them.
    for port in (normal_force, primitive.GetOutputPort("covariance")):
        builder.Connect(port, controller.GetInputPort(port.get_name()))
    page = PagePorts()
    if meshcat is not None:
        page = AddPage(
            builder,
            scene,
            scenario,
            meshcat=meshcat,
            primitive=primitive,
            measured_position=controller.GetOutputPort("measured_position"),
            ink=ink,
            demonstrated=demonstrated,
        )
    tempo = primitive.GetInputPort("tempo")
    force = controller.GetInputPort("desired_normal_force")
    if page.controls is not None:
        sliders = page.controls
        builder.Connect(sliders.GetOutputPort("tempo"), tempo)
        builder.Connect(sliders.GetOutputPort("normal_force"), force)
    else:
        for wanted, value in ((tempo, plays.tempo), (force, scenario.press.force)):
            constant = ConstantVectorSource(np.array([value]))
            builder.AddNamedSystem(wanted.get_name(), constant)
            builder.Connect(constant.get_output_port(), wanted)
    AddExternalForces(
        builder, scene, scenario, others=[] if page.pull is None else [page.pull]
    )

    for order, name in enumerate(DESIRED):
        builder.ExportOutput(desired.get_output_port(order), name)
    for name in ("covariance", "weights", "component", "remaps", "phase"):
        if primitive.HasOutputPort(name):
            builder.ExportOutput(primitive.GetOutputPort(name), name)
    builder.ExportOutput(driver.GetOutputPort("torque_measured"), "actuation")
    builder.ExportOutput(plant.get_state_output_port(scene.panda), "state")
    status = controller.GetOutputPort("status")
    status = AddSurfaceWatch(builder, scene, scenario.board, status=status)
    if panel is not None:
        AddPageStatus(
            builder,
            panel,
            primitive=primitive,
            status=status,
            period=scenario.impedance.control_period,
            ink=ink,
            area=area,
        )
    for system in (controller, ink):
        for i in range(system.num_output_ports()):
            port = system.get_output_port(i)
            if port.get_name() != "status":
                builder.ExportOutput(port, port.get_name())
    diagram = builder.Build()
    diagram.set_name("wiping_station")
    return diagram
