"""Station: the diagram of a robot at a board with its operator."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array, check_type
from fmp_drake.primitives import FourierMovementPrimitive, Tracker
from fmp_drake.primitives.data.windows import DEFAULT_RATE
from fmp_drake.station.arm_controller import AddArmController
from fmp_drake.station.board_scene import AddBoardScene, BoardScene, Connect
from fmp_drake.station.external_forces import (
    GUIDING,
    TURNING,
    AddExternalForces,
    TeachingHand,
)
from fmp_drake.station.page import AddBodies, AddPage, AddPageStatus
from fmp_drake.station.reach.posture import TORQUE_FRACTION, StartForceLimit
from fmp_drake.station.robots.driver import Driver, SimulatedDriver
from fmp_drake.station.scenario import Scenario, check_scenario
from fmp_drake.station.skill_motion import (
    DESIRED,
    AddSkill,
    CheckForceChannel,
    ContactHeight,
    Playback,
    SkillRoles,
)
from fmp_drake.station.tasks.following import Following
from fmp_drake.station.tasks.task import Task
from fmp_drake.station.tasks.wiping import AddInk, Wiping
from fmp_drake.systems import PagePanel
from fmp_drake.systems.page.page_controls import PageControls
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
    meshcat: Meshcat | None = None,
    panel: PagePanel | None = None,
    demonstrated: Sequence[Array] = (),
) -> Diagram:
    """Build the diagram of a robot with its task and an operator: skill, hand, or input ports.

    Desired and measured motion are in the frame B of the board. The initialisation of a
    Simulator maps the measured start to the skill. For a plant without a time step
    (CENIC) give the Simulator the scenario's integrator:
    ``ApplySimulatorConfig(scenario.simulator, simulator)``. This Drake function sets the
    time of the simulator's context to 0: restore a saved context after it, not before.
    Several stations in one diagram need names of their own: add each by
    ``DiagramBuilder.AddNamedSystem``. Drake ends the program (SystemExit) where two systems
    of a diagram have one name.

    Systems of every station: controller and driver; plant and scene_graph of a simulated
    arm. Further systems:

    - of a skill: fourier_primitive, desired_motion, tempo, desired_normal_force, ink_board,
      surface_monitor, status;
    - where the scenario needs them: normal_force_estimator, rail, rail_state, task_frame,
      task_frame_velocity, task_frame_acceleration, joint_friction, disturbances,
      optional_spatial_forces and spatial_force_sum;
    - with a Meshcat: those of `AddPage`, where page_controls replaces tempo and
      desired_normal_force; with a panel: page_status;
    - of a hand: rest for the controller's inputs, recorder; human_hand and is_guided of a
      `SimulatedHand`, mouse_hand and meshcat_mouse_spring of a `MouseOnPage`.

    Output ports with a skill and a simulated arm, all vectors:

    - of the skill: desired_position, desired_velocity, desired_acceleration (3,) in B,
      covariance (9,), weights, component (1,), remaps (2,); phase (1,) of a phase model;
      desired_orientation (4,), a quaternion w, x, y, z of R_TE, of a skill with such
      channels; desired_normal_force (1,), N, of the scenario, the page or such a channel;
    - of the arm: measured_position, measured_velocity (3,) in B (on a curved board the
      coordinates (u, v, h), and a velocity relative to the target); measured_pose (7,), a
      quaternion w, x, y, z and the position in T; tracking_error (6,); state (2n,); torque
      (n,), the command without gravity; actuation (n,), with gravity, Nm;
      last_fault (1,), the reason of the latest protective stop, one or more of
      `STOP_REASONS`;
    - of the task: status (6,) of the controller and of the surface monitor, see
      `ImpedanceStatus`; ink, one value per cell; cleaned_fraction (1,); normal_force (1,),
      N; contact_area (1,), m^2; penetration (1,) of the deepest hard point of arm and
      eraser below the board's surface, m; disturbance (3,), the force of the scenario's
      disturbances, N, in W, where it has any.

    The input port applied_spatial_force is the plant's, for external forces; it may stay
    unconnected.

    Output ports with a hand: position (3,) of the eraser in B by the arm's sensors, m;
    is_guided (1,), 1 during hand guiding; state, torque and actuation as above; measured_pose
    (7,) where the hand turns the tool.

    An arm that is not simulated, and one without skill and hand, has the outputs of the
    controller and of `MakeDriver`, such as torque_measured and torque_external. It also
    has normal_force, N, from the external torque. With a skill there are the outputs of the
    skill, and with controls on a page page_tempo (1,) and page_press_force (1,), which are
    not connected. Its inputs are desired_normal_force
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
        p_BE of the eraser at time 0, m; the scenario's, or the hand's, if None.
    q : array_like, shape (n,), optional
        Initial joint angles instead, at rest, rad.
    tracker : Tracker, optional
        As for `FourierPrimitiveSystem`.
    sample, seed : optional
        Instead of the scenario's.
    meshcat : Meshcat, optional
        Page of the scene, with the items of the scenario's `show`.
    panel : PagePanel, optional
        Panel for the status of the run.
    demonstrated : sequence of ndarray, shape (N, D)
        Channels of the demonstrations to show; positions in B, m.

    Raises
    ------
    StationError
        If a channel of the skill has no role, the arm cannot reach the start, the normal
        force there exceeds its torque limits, or a real board moves.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario
    >>> station = MakeStation(LoadScenario("table_top"), None)
    >>> station.GetInputPort("desired_position").size()
    3
    """
    _CheckTypes(scenario, operator, driver, task, meshcat)
    if not isinstance(operator, FourierMovementPrimitive | None):
        return _MakeTeachingStation(scenario, operator, start, q, meshcat)
    if operator is not None:
        CheckForceChannel(scenario, SkillRoles(operator))
    builder = DiagramBuilder()
    driver = driver or SimulatedDriver(sensors=scenario.sensors)
    scene = AddBoardScene(
        builder,
        scenario,
        start=scenario.start if start is None else start,
        q=q,
        simulated=isinstance(driver, SimulatedDriver),
    )
    controller = AddArmController(
        builder,
        scene,
        scenario.impedance,
        driver=driver,
        lcm=lcm,
        contact_height=ContactHeight(scenario, operator),
    )
    arm: Any = builder.GetSubsystemByName("driver")
    if task is None:
        is_wiping = operator is not None and scenario.has_board
        task = Wiping() if is_wiping else Following()
    measured = task.AddTo(builder, scene, controller=controller, driver=arm)
    playback = controls = pull = None
    position = controller.GetOutputPort("measured_position")
    if operator is not None:
        if scene.is_simulated and scenario.has_board:
            CheckNormalForce(scene)
        playback = AddSkill(
            builder,
            scene,
            operator,
            controller=controller,
            measured=measured,
            tracker=tracker,
            sample=sample,
            seed=seed,
        )
        position = playback.position
        if meshcat is not None:
            controls, pull = AddPage(
                builder,
                scene,
                playback,
                measured=measured,
                driver=arm,
                meshcat=meshcat,
                demonstrated=demonstrated,
            )
    # The controller uses it if its configuration enables force control.
    builder.Connect(measured.normal_force, controller.GetInputPort("normal_force"))
    name = "arm_station"
    if playback is not None and scene.is_simulated:
        name = "wiping_station"
        force = _AddNominalMotion(builder, scenario, playback, controls)
        if playback.roles.force is None:
            builder.ExportOutput(force, "desired_normal_force")
        AddExternalForces(builder, scene, pull=pull)
        builder.ExportOutput(arm.GetOutputPort("torque_measured"), "actuation")
        state = scene.plant.get_state_output_port(scene.robot.arm)
        builder.ExportOutput(state, "state")
        if panel is not None:
            AddPageStatus(
                builder,
                scene,
                playback,
                measured=measured,
                last_fault=controller.GetOutputPort("last_fault"),
                desired_normal_force=force,
                panel=panel,
            )
    else:
        _ExportArm(builder, controller, arm, playback)
        for port in ("tempo", "press_force"):
            if controls is not None and controls.HasOutputPort(port):
                builder.ExportOutput(controls.GetOutputPort(port), f"page_{port}")
    _ExportOutputs(builder, controller, without=("status", "measured_position"))
    builder.ExportOutput(position, "measured_position")
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


def MakeWipingStation(
    scenario: Scenario, skill: FourierMovementPrimitive, **options: Any
) -> Diagram:
    """Build a station that plays a skill: `MakeStation`, with its options."""
    check_type(skill, "skill", FourierMovementPrimitive, error=StationError)
    return MakeStation(scenario, skill, **options)


def _CheckTypes(
    scenario: Any, operator: Any, driver: Any, task: Any, meshcat: Any
) -> None:
    """Raise an error for arguments of `MakeStation` that are not of its types."""
    check_scenario(scenario, "MakeStation(scenario)")
    for name, value, kind in (
        ("operator", operator, FourierMovementPrimitive | TeachingHand | None),
        ("driver", driver, Driver | None),
        ("task", task, Task | None),
        ("meshcat", meshcat, Meshcat | None),
    ):
        check_type(value, name, kind, error=StationError)


def CheckNormalForce(scene: BoardScene) -> None:
    """Raise an error for a normal force above the arm's torque limits at the start.

    Raises
    ------
    StationError
    """
    scenario = scene.scenario
    limit = StartForceLimit(scenario, scene.model, scene.robot.default_posture)
    if scenario.press.force > limit:
        raise StationError(
            f"press.force is {scenario.press.force:g} N; at the start the arm can press "
            f"with {limit:.1f} N without a joint at more than {100 * TORQUE_FRACTION:.0f} % of "
            "its torque. Lower it, or move the board nearer to the base."
        )


def _AddNominalMotion(
    builder: DiagramBuilder,
    scenario: Scenario,
    playback: Playback,
    controls: PageControls | None,
) -> OutputPort:
    """Connect tempo and normal force of the page or else of the scenario.

    Systems: tempo and desired_normal_force, unless a page has controls for them.

    Returns
    -------
    OutputPort
        The desired normal force, N: that of the skill, if it has such a channel.
    """
    tempo, force = playback.primitive.GetInputPort("tempo"), scenario.nominal_force()
    for name, system, port, value in (
        ("tempo", "tempo", tempo, scenario.skill.tempo),
        ("press_force", "desired_normal_force", playback.force, force),
    ):
        if controls is not None and controls.HasOutputPort(name):
            source = controls.GetOutputPort(name)
        else:
            constant = ConstantVectorSource(np.array([value]))
            source = builder.AddNamedSystem(system, constant).get_output_port()
        builder.Connect(source, port)
    if playback.roles.force is not None:
        source = builder.GetSubsystemByName("force_channel").get_output_port()
    return source


def _ExportArm(
    builder: DiagramBuilder,
    controller: System,
    driver: System,
    playback: Playback | None,
) -> None:
    """Export the inputs and outputs of an arm that is operated from outside the station."""
    force = controller.GetInputPort("desired_normal_force")
    inputs: list[tuple[System, str]] = [(driver, "wall_time"), (driver, "go")]
    if playback is None:
        inputs += [(controller, name) for name in DESIRED]
    else:
        force = playback.force
        inputs.append((playback.primitive, "tempo"))
    builder.ExportInput(force, "desired_normal_force")
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
    meshcat: Meshcat | None,
) -> Diagram:
    """Build a station where a hand guides the gravity-compensated arm."""
    is_curved = not scenario.board.curvature().is_plane
    if is_curved and scenario.board.motion.amplitude > 0:
        raise StationError(
            f"board.motion.amplitude is {scenario.board.motion.amplitude:g} m; guide the arm "
            "over a curved board at rest. Set it to 0."
        )
    builder = DiagramBuilder()
    if start is None:
        start = scenario.start if hand.start is None else hand.start
    scene = AddBoardScene(builder, scenario, start=start, q=q)
    plant = scene.plant
    recorded = hand.recorded(scenario)
    config = TURNING if "measured_pose" in recorded else GUIDING
    controller = AddArmController(builder, scene, config)
    rest = builder.AddNamedSystem("rest", ConstantVectorSource(np.zeros(3)))
    for name in DESIRED:
        builder.Connect(rest.get_output_port(), controller.GetInputPort(name))
    forces, is_guided = hand.AddTo(builder, scene)
    builder.Connect(forces, plant.GetInputPort("applied_spatial_force"))
    position = controller.GetOutputPort("measured_position")
    if not scene.curvature.is_plane:
        surface = builder.AddSystem(
            SurfaceCoordinates(scene.curvature, scenario.eraser_orientation())
        )
        Connect(builder, controller, surface, "measured_pose", "measured_velocity")
        for name in ("orientation", "angular_velocity"):
            desired = controller.GetInputPort(f"desired_{name}")
            builder.Connect(surface.GetOutputPort(name), desired)
        position = surface.GetOutputPort("coordinates")
    LogVectorOutput(position, builder, 1 / DEFAULT_RATE).set_name("recorder")
    for name in recorded:
        source: System = controller
        if name == "normal_force":
            source = AddInk(builder, scene)
        port = source.GetOutputPort(name)
        LogVectorOutput(port, builder, 1 / DEFAULT_RATE).set_name(f"record_{name}")
    if meshcat is not None:
        AddBodies(builder, scene, meshcat)
    driver: Any = builder.GetSubsystemByName("driver")
    exported = {
        "position": position,
        "is_guided": is_guided,
        "state": plant.get_state_output_port(scene.robot.arm),
        "torque": controller.GetOutputPort("torque"),
        "actuation": driver.GetOutputPort("torque_measured"),
    }
    if "measured_pose" in recorded:
        exported["measured_pose"] = controller.GetOutputPort("measured_pose")
    for name, port in exported.items():
        builder.ExportOutput(port, name)
    diagram = builder.Build()
    diagram.set_name("teaching_station")
    return diagram
