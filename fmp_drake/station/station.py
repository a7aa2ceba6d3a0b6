"""The station: a robot at a board, and what moves it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import (
    Diagram,
    DiagramBuilder,
    InputPort,
    OutputPort,
    System,
)
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    LogVectorOutput,
)

from fmp_drake.primitives import FourierMovementPrimitive, Tracker
from fmp_drake.primitives.data.channels import ChannelRoles
from fmp_drake.primitives.data.windows import DEFAULT_RATE
from fmp_drake.station.arm_controller import AddArmController
from fmp_drake.station.external_forces import AddExternalForces
from fmp_drake.station.page.page_scene import (
    AddBodies,
    AddMeasuredArm,
    AddPage,
    AddPageControls,
    AddPageStatus,
    PagePorts,
)
from fmp_drake.station.reach.normal_force_limit import CheckPress
from fmp_drake.station.robots.driver import Driver, SimulatedDriver
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scene import AddBoardScene, BoardScene
from fmp_drake.station.skill_motion import (
    DESIRED,
    AddCoordinates,
    AddPositionCovariance,
    AddSkillMotion,
    CheckForceChannel,
    ChoiceByInk,
    SkillRoles,
)
from fmp_drake.station.tasks.following import Following
from fmp_drake.station.tasks.task import Measurements, Task
from fmp_drake.station.tasks.wiping import AddInk, BoardGrid, Wiping
from fmp_drake.station.teaching_hands import GUIDING, TURNING, TeachingHand
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.page.page_panel import PagePanel
from fmp_drake.systems.surface_coordinates import SurfaceCoordinates


def MakeStation(
    scenario: Scenario,
    operator: FourierMovementPrimitive | TeachingHand | None,
    *,
    driver: Driver | None = None,
    task: Task | None = None,
    lcm: DrakeLcmInterface | None = None,
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
    """Build the diagram of a robot with its task and an operator: skill, hand, or input ports.

    Desired and measured motion are in the frame B of the board. The initialisation of a
    Simulator maps the measured start to the skill. For a plant without a time step
    (CENIC) give it the scenario's integrator:
    ``ApplySimulatorConfig(scenario.simulator, simulator)``. This Drake function sets the
    time of the simulator's context to 0: restore a saved context after it, not before.

    Systems of every station: controller and driver; plant and scene_graph of a simulated
    arm. Further systems:

    - of a skill: fourier_primitive, desired_motion, tempo, desired_normal_force, ink_board,
      surface_monitor, status;
    - where the scenario needs them: normal_force_estimator, rail, rail_state, task_frame,
      task_frame_velocity, task_frame_acceleration, joint_friction, disturbances and
      spatial_force_sum;
    - with a Meshcat: those of `AddPage`, where page_controls replaces tempo and
      desired_normal_force; with a panel: page_status;
    - of a hand: rest for the controller's inputs, recorder; human_hand and leading of a
      `SimulatedHand`, mouse_hand and meshcat_mouse_spring of a `MouseOnPage`.

    Output ports with a skill and a simulated arm, all vectors:

    - of the skill: desired_position, desired_velocity, desired_acceleration (3,) in B,
      covariance (9,), weights, component (1,), remaps (2,); phase (1,) of a phase model;
      desired_orientation (4,), a quaternion w, x, y, z of R_TE, and desired_normal_force
      (1,), N, of a skill with such channels;
    - of the arm: measured_position, measured_velocity (3,) in B (on a curved board the
      coordinates (u, v, h), and a velocity relative to the target); measured_pose (7,), a
      quaternion w, x, y, z and the position in T; tracking_error (6,); state (2n,); torque
      (n,), the command without gravity; actuation (n,), with gravity, Nm;
    - of the task: status (6,) of the controller and of the surface monitor, see
      `ImpedanceStatus`; ink, one value per cell; cleaned_fraction (1,); normal_force (1,),
      N; contact_area (1,), m^2; penetration (1,) of the deepest hard point of arm and
      eraser below the board's surface, m; disturbance (3,), the force of the scenario's
      disturbances, N, in W, where it has any.

    The input port applied_spatial_force is the plant's, for external forces; it may stay
    unconnected.

    Output ports with a hand: position (3,) of the eraser in B by the arm's sensors, m;
    leading (1,), 1 during hand guiding; state, torque and actuation as above; measured_pose
    (7,) where the hand turns the tool.

    An arm that is not simulated, and one without skill and hand, has the outputs of the
    controller and of `MakeDriver`, among them torque_measured and torque_external, and
    normal_force, N, from the external torque. With a skill there are desired_position,
    desired_velocity and desired_acceleration, and with controls on a page page_tempo (1,)
    and page_normal_force (1,), which are not connected. Its inputs are desired_normal_force
    (1,), N; tempo (1,) of a skill or else desired_position, desired_velocity,
    desired_acceleration (3,); wall_time and go of an arm behind LCM.

    Parameters
    ----------
    scenario : Scenario
        Of a board that stands still, where the arm is not simulated.
    operator : FourierMovementPrimitive, TeachingHand or None
        Source of the arm's motion. A skill is fitted; its channels are x, y, z in B, m,
        and optionally rx, ry, rz, rad, and force, N. See `ChannelRoles`.
    driver : Driver, optional
        A simulated arm with the scenario's sensors by default.
    task : Task, optional
        `Wiping` for a skill at a board by default, else `Following`.
    lcm : DrakeLcmInterface, optional
        As for `MakeDriver`.
    start : array_like, shape (3,), optional
        p_BE of the eraser at time 0, m; the scenario's, or the hand's, where None.
    q : array_like, shape (n,), optional
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
        Where a channel of the skill has no role, the arm cannot reach the start, the
        normal force is more than it bears there, or nothing measures a real board's motion.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario
    >>> station = MakeStation(LoadScenario("table_top"), None)
    >>> station.GetInputPort("desired_position").size()
    3
    """
    skill = operator if isinstance(operator, FourierMovementPrimitive) else None
    if skill is not None:
        roles = SkillRoles(skill)
        CheckForceChannel(scenario, roles)
    elif operator is not None:
        return _MakeTeachingStation(scenario, operator, start, q, visuals, meshcat)
    builder = DiagramBuilder()
    driver = driver or SimulatedDriver(sensors=scenario.sensors)
    scene = AddBoardScene(
        builder,
        scenario,
        start=scenario.start if start is None else start,
        q=q,
        visuals=visuals,
        simulated=isinstance(driver, SimulatedDriver),
    )
    is_played = scene.is_simulated and skill is not None
    controller = AddArmController(
        builder,
        scene,
        scenario.impedance,
        engage_height=scenario.press.engage_height,
        driver=driver,
        lcm=lcm,
    )
    arm: Any = builder.GetSubsystemByName("driver")
    if task is None:
        is_wiping = skill is not None and scene.whiteboard is not None
        task = Wiping() if is_wiping else Following()
    measured = task.AddTo(builder, scene, scenario, controller=controller, driver=arm)
    primitive = None
    force = controller.GetInputPort("desired_normal_force")
    position = controller.GetOutputPort("measured_position")
    if skill is not None:
        primitive, position, force = _AddSkill(
            builder,
            scene,
            scenario,
            skill,
            roles,
            controller=controller,
            measured=measured,
            tracker=tracker,
            sample=sample,
            seed=seed,
        )
    if measured.normal_force is not None:
        # Used where the impedance's configuration enables it.
        builder.Connect(measured.normal_force, controller.GetInputPort("normal_force"))
    if is_played and primitive is not None:
        _AddPlay(
            builder,
            scene,
            scenario,
            driver=arm,
            measured=measured,
            primitive=primitive,
            position=position,
            meshcat=meshcat,
            panel=panel,
            demonstrated=demonstrated,
            force=force,
        )
    else:
        _ExportArm(builder, controller, arm, primitive, force)
        if primitive is not None and meshcat is not None:
            _AddMeasuredPage(
                builder,
                scene,
                scenario,
                driver=arm,
                primitive=primitive,
                position=position,
                meshcat=meshcat,
                demonstrated=demonstrated,
            )
    _ExportOutputs(builder, controller, without=("status", "measured_position"))
    builder.ExportOutput(position, "measured_position")
    diagram = builder.Build()
    diagram.set_name("wiping_station" if is_played else "arm_station")
    return diagram


def MakeWipingStation(
    scenario: Scenario, skill: FourierMovementPrimitive, **options: Any
) -> Diagram:
    """Build a station that plays a skill: `MakeStation`, with its options."""
    return MakeStation(scenario, skill, **options)


def _AddSkill(
    builder: DiagramBuilder,
    scene: BoardScene,
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    roles: ChannelRoles,
    *,
    controller: System,
    measured: Measurements,
    **options: Any,
) -> tuple[FourierPrimitiveSystem, OutputPort, InputPort]:
    """Add a skill that commands the controller, and export the desired motion.

    Parameters
    ----------
    builder, scene, scenario, skill, roles, controller, measured
    **options
        Tracker, sample and seed, as for `AddSkillMotion`.

    Returns
    -------
    primitive : FourierPrimitiveSystem
    position : OutputPort
        The measured position, m; (u, v, h) over a curved board.
    force : InputPort
        Of the desired normal force, N.
    """
    if scene.is_simulated and scene.whiteboard is not None:
        CheckPress(scenario, scene)
    force = controller.GetInputPort("desired_normal_force")
    position = controller.GetOutputPort("measured_position")
    choice = None
    if measured.ink is not None:
        choice, _ = ChoiceByInk(scenario, skill, BoardGrid(scenario))
    primitive, desired, task_motion = AddSkillMotion(
        builder,
        skill,
        scenario.skill,
        controller,
        choice=choice,
        roles=roles,
        X_WS=scene.X_WA,
        surface=scenario.board.curvature(),
        **options,
    )
    if task_motion is not None and not scene.curvature.is_plane:
        position = AddCoordinates(builder, task_motion, roles)
    if choice is not None and measured.ink is not None:
        builder.Connect(measured.ink, primitive.GetInputPort("ink"))
    if scene.is_simulated:
        covariance = AddPositionCovariance(builder, primitive, roles)
        builder.Connect(covariance, controller.GetInputPort("covariance"))
    if roles.force is not None and task_motion is not None:
        if measured.normal_force is not None:
            builder.Connect(
                measured.normal_force, task_motion.GetInputPort("normal_force")
            )
        force = _AddForceChannel(builder, scenario, task_motion, force)
    if roles.rotation is not None and task_motion is not None:
        name = "desired_orientation"
        builder.ExportOutput(task_motion.GetOutputPort(name), name)
    for order, name in enumerate(DESIRED):
        builder.ExportOutput(desired.get_output_port(order), name)
    return primitive, position, force


def _AddMeasuredPage(
    builder: DiagramBuilder,
    scene: BoardScene,
    scenario: Scenario,
    *,
    driver: System,
    primitive: FourierPrimitiveSystem,
    position: OutputPort,
    meshcat: Meshcat,
    demonstrated: Sequence[NDArray[np.float64]],
) -> None:
    """Add the page of an arm that is not simulated, and export what its sliders say."""
    AddMeasuredArm(
        builder,
        scene,
        scenario,
        state=driver.GetOutputPort("state"),
        measured_position=position,
        primitive=primitive,
        meshcat=meshcat,
        demonstrated=demonstrated,
    )
    if scenario.show.controls:
        controls = AddPageControls(builder, scenario, primitive, meshcat)
        for name in ("tempo", "normal_force"):
            if controls.HasOutputPort(name):
                builder.ExportOutput(controls.GetOutputPort(name), f"page_{name}")


def _AddPlay(
    builder: DiagramBuilder,
    scene: BoardScene,
    scenario: Scenario,
    *,
    driver: System,
    measured: Measurements,
    primitive: FourierPrimitiveSystem,
    position: OutputPort,
    meshcat: Meshcat | None,
    panel: PagePanel | None,
    demonstrated: Sequence[NDArray[np.float64]],
    force: InputPort,
) -> None:
    """Add to a simulated skill its page, its tempo and force, and what pushes at it."""
    page = PagePorts()
    if meshcat is not None:
        page = AddPage(
            builder,
            scene,
            scenario,
            meshcat=meshcat,
            primitive=primitive,
            measured_position=position,
            ink=measured.ink_board,
            demonstrated=demonstrated,
        )
    tempo = primitive.GetInputPort("tempo")
    sources: dict[str, OutputPort] = {}
    for name, port, value in (
        ("tempo", tempo, scenario.skill.tempo),
        ("normal_force", force, scenario.nominal_force()),
    ):
        if page.controls is not None and page.controls.HasOutputPort(name):
            sources[name] = page.controls.GetOutputPort(name)
        else:
            constant = ConstantVectorSource(np.array([value]))
            builder.AddNamedSystem(
                name if name == "tempo" else f"desired_{name}", constant
            )
            sources[name] = constant.get_output_port()
        builder.Connect(sources[name], port)
    AddExternalForces(
        builder, scene, scenario, others=[] if page.pull is None else [page.pull]
    )
    for name in ("covariance", "weights", "component", "remaps", "phase"):
        if primitive.HasOutputPort(name):
            builder.ExportOutput(primitive.GetOutputPort(name), name)
    builder.ExportOutput(driver.GetOutputPort("torque_measured"), "actuation")
    state = scene.plant.get_state_output_port(scene.robot.arm)
    builder.ExportOutput(state, "state")
    if panel is not None:
        area = None
        if measured.ink_board is not None:
            skill, grid = primitive.player.skill, measured.ink_board.grid
            _, area = ChoiceByInk(scenario, skill, grid)
        AddPageStatus(
            builder,
            panel,
            primitive=primitive,
            status=measured.status,
            period=scenario.impedance.control_period,
            ink=measured.ink_board,
            area=area,
            desired_normal_force=sources["normal_force"],
        )


def _AddForceChannel(
    builder: DiagramBuilder,
    scenario: Scenario,
    task_motion: System,
    force: InputPort,
) -> InputPort:
    """Let a skill's force channel say the force, and return the port of its nominal force.

    What comes in at the port, less the scenario's normal force, is added to the channel: a
    page's slider shifts the force that was demonstrated.
    """
    total = builder.AddNamedSystem("force_channel", Adder(3, 1))
    nominal = builder.AddNamedSystem(
        "demonstrated_force_offset",
        ConstantVectorSource(np.array([-scenario.press.force])),
    )
    channel = task_motion.GetOutputPort("desired_normal_force")
    builder.Connect(channel, total.get_input_port(0))
    builder.Connect(nominal.get_output_port(), total.get_input_port(2))
    builder.Connect(total.get_output_port(), force)
    builder.ExportOutput(total.get_output_port(), "desired_normal_force")
    return total.get_input_port(1)


def _ExportArm(
    builder: DiagramBuilder,
    controller: System,
    driver: System,
    primitive: FourierPrimitiveSystem | None,
    force: InputPort,
) -> None:
    """Export the inputs of an arm that nothing here commands, and what it measures."""
    builder.ExportInput(force, "desired_normal_force")
    inputs: list[tuple[System, str]] = []
    if primitive is None:
        inputs += [(controller, name) for name in DESIRED]
    else:
        inputs.append((primitive, "tempo"))
    inputs += [(driver, name) for name in ("wall_time", "go")]
    for system, name in inputs:
        if system.HasInputPort(name):
            builder.ExportInput(system.GetInputPort(name), name)
    _ExportOutputs(builder, driver, without=("plant_actuation",))


def _ExportOutputs(
    builder: DiagramBuilder, system: System, *, without: Sequence[str]
) -> None:
    """Export the output ports of a system by their names, without some."""
    for i in range(system.num_output_ports()):
        port = system.get_output_port(i)
        if port.get_name() not in without:
            builder.ExportOutput(port, port.get_name())


def _MakeTeachingStation(
    scenario: Scenario,
    hand: TeachingHand,
    start: ArrayLike | None,
    q: ArrayLike | None,
    visuals: str,
    meshcat: Meshcat | None,
) -> Diagram:
    """Build a station where a hand guides the gravity-compensated arm."""
    builder = DiagramBuilder()
    if start is None:
        start = scenario.start if hand.start is None else hand.start
    scene = AddBoardScene(builder, scenario, start=start, q=q, visuals=visuals)
    plant = scene.plant
    recorded = hand.recorded(scenario)
    config = TURNING if "measured_pose" in recorded else GUIDING
    controller = AddArmController(builder, scene, config)
    rest = builder.AddNamedSystem("rest", ConstantVectorSource(np.zeros(3)))
    for name in DESIRED:
        builder.Connect(rest.get_output_port(), controller.GetInputPort(name))
    forces, leading = hand.AddTo(builder, scene, scenario)
    builder.Connect(forces, plant.GetInputPort("applied_spatial_force"))
    position = controller.GetOutputPort("measured_position")
    if not scene.curvature.is_plane:
        over = builder.AddSystem(
            SurfaceCoordinates(scene.curvature, scenario.eraser_orientation())
        )
        for name in ("measured_pose", "measured_velocity"):
            builder.Connect(controller.GetOutputPort(name), over.GetInputPort(name))
        for name in ("orientation", "angular_velocity"):
            desired = controller.GetInputPort(f"desired_{name}")
            builder.Connect(over.GetOutputPort(name), desired)
        position = over.GetOutputPort("coordinates")
    LogVectorOutput(position, builder, 1 / DEFAULT_RATE).set_name("recorder")
    for name in recorded:
        source: System = controller
        if name == "normal_force":
            source = AddInk(builder, scene, scenario)
        port = source.GetOutputPort(name)
        LogVectorOutput(port, builder, 1 / DEFAULT_RATE).set_name(f"record_{name}")
    if meshcat is not None:
        AddBodies(builder, scene.scene_graph, scenario, meshcat)
    driver: Any = builder.GetSubsystemByName("driver")
    for port, name in (
        (position, "position"),
        (leading, "leading"),
        (plant.get_state_output_port(scene.robot.arm), "state"),
        (controller.GetOutputPort("torque"), "torque"),
        (driver.GetOutputPort("torque_measured"), "actuation"),
    ):
        builder.ExportOutput(port, name)
    if "measured_pose" in recorded:
        builder.ExportOutput(controller.GetOutputPort("measured_pose"), "measured_pose")
    diagram = builder.Build()
    diagram.set_name("teaching_station")
    return diagram
