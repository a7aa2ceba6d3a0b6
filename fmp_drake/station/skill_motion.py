"""Playback of a skill, wired to a robot's controller."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Demultiplexer,
    MatrixGain,
    Saturation,
)
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SkillError, StationError
from fmp_drake.numeric import Array, Mask
from fmp_drake.primitives import FourierMovementPrimitive, Player, Tracker
from fmp_drake.primitives.data.channels import ChannelRoles, channel_roles
from fmp_drake.primitives.data.orientation import rotation_vectors, rotations_of
from fmp_drake.primitives.model.region import DemonstratedRegion, automatic_margin
from fmp_drake.primitives.model.trajectory_mixture import check_skill
from fmp_drake.station.board_scene import BoardScene, Connect
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.tasks.task import Measurements
from fmp_drake.station.tasks.wiping import BoardGrid
from fmp_drake.systems import FourierPrimitiveSystem
from fmp_drake.systems.ink.grid import CoverageChoice
from fmp_drake.systems.task_motion import FRAME, POSITION, TaskMotion

DESIRED = (*POSITION,)
"""Inputs of a controller, and outputs of a station with a skill."""

_ESTIMATOR = "normal_force_estimator"

# Least margin of samples that no scenario sets, m.
_MARGIN = 0.02
# Total number of samples of a skill's paths, and range of the number of windows.
_SAMPLES, _WINDOWS = 6000, (8, 48)
# Number of windows that are played from the start, each with its own seed.
_BEGINNINGS = 3
# Candidates per window: a run prefers samples that wipe much, so the longest are checked.
_CANDIDATES = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Playback:
    """A skill that commands a controller.

    Attributes
    ----------
    primitive : FourierPrimitiveSystem
    roles : ChannelRoles
        Of the skill.
    position : OutputPort
        Measured position, m; (u, v, h) over a curved board.
    force : InputPort
        Desired normal force, N; with a force channel, the nominal one.
    """

    primitive: FourierPrimitiveSystem
    roles: ChannelRoles
    position: OutputPort
    force: InputPort

    @property
    def skill(self) -> FourierMovementPrimitive:
        """The played skill."""
        return self.primitive.player.skill


def DemonstratedArea(scenario: Scenario, skill: FourierMovementPrimitive) -> Mask:
    """Return the cells below the demonstrated paths of the eraser, shape (ny, nx).

    Only what was learned counts, without an approach. A skill without paths has those of
    its means.
    """
    position = SkillRoles(skill).position
    paths = skill.paths_ or [skill.synthesize(c.mean) for c in skill.components_]
    footprint = scenario.board_footprint()
    return BoardGrid(scenario).swept_by([p[:, position] for p in paths], footprint)


def ChoiceByInk(
    scenario: Scenario, skill: FourierMovementPrimitive
) -> CoverageChoice | None:
    """Return the choice of samples by the ink, if there is one.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted. If it has demonstrated paths, their area is to be cleaned.
    """
    candidates = scenario.skill.candidates
    if candidates == 1:
        return None
    return CoverageChoice(
        grid=BoardGrid(scenario),
        footprint=scenario.board_footprint(),
        candidates=candidates,
        area=DemonstratedArea(scenario, skill) if skill.paths_ else None,
        position=SkillRoles(skill).position,
    )


def SkillMargin(scenario: Scenario, skill: FourierMovementPrimitive) -> float | None:
    """Return the margin of the samples that a scenario plays, m.

    None, for no bound, where the skill has no demonstrated paths.
    """
    if not skill.paths_:
        return None
    if scenario.skill.margin is not None:
        return scenario.skill.margin
    if skill.phase_model_ is None:  # The means of unlike movements are none of them.
        return _MARGIN
    region = DemonstratedRegion(skill, _MARGIN)
    means = skill.synthesize([component.mean for component in skill.components_])
    # The second half of a window may not be played.
    distance = region.distance(means[:, : skill.n_steps // 2])
    most = automatic_margin(skill) or _MARGIN
    return max(_MARGIN, min(float(np.max(distance)), most))


def SkillRoles(skill: FourierMovementPrimitive) -> ChannelRoles:
    """Find position, rotation and force among the channels of a fitted skill.

    Raises
    ------
    StationError
        If the skill has no position, or a channel without a role.
    """
    check_skill(skill, "a station")
    if skill.n_channels_ == 3 and set(skill.units_) == {"m"}:
        return ChannelRoles(position=(0, 1, 2))
    try:
        return channel_roles(
            skill.channels_, skill.units_, rotation_reference=skill.rotation_reference_
        )
    except SkillError as error:
        raise StationError(f"this skill cannot be played: {error}") from None


def StartChannels(
    scenario: Scenario, skill: FourierMovementPrimitive, roles: ChannelRoles
) -> Array:
    """Return the measured channels of a skill at the start, shape (D,).

    A force channel starts at 0, before contact.
    """
    start = np.zeros(roles.count)
    start[list(roles.position)] = scenario.start
    if roles.rotation is not None and roles.reference is not None:
        R_TE = Rotation.from_matrix(scenario.eraser_orientation().matrix())
        middle = np.mean(skill.extent_, axis=0)[list(roles.rotation)]
        vector = rotation_vectors(R_TE, roles.reference, near=middle)
        start[list(roles.rotation)] = vector
    return start


def ContactHeight(scenario: Scenario, skill: FourierMovementPrimitive | None) -> float:
    """Return the height over the board up to which a skill presses with its whole force, m.

    A recorded tool that was never higher than `press.engage_height` was always in contact:
    the hand only pressed with more or less force. Samples of a recording with lifts may mix
    heights in contact and in the air. For these the height is `engage_height` if a force
    channel determines where to press, and otherwise 0.
    """
    if skill is None or not skill.paths_:
        return 0.0
    roles, engage = SkillRoles(skill), scenario.press.engage_height
    highest = max(np.max(path[:, roles.position[2]]) for path in skill.paths_)
    if highest >= engage:
        return 0.0 if roles.force is None else engage
    return max(float(highest), 0.0)


def CheckForceChannel(scenario: Scenario, roles: ChannelRoles) -> None:
    """Check that there is a board for a skill with a force channel.

    Raises
    ------
    StationError
    """
    if roles.force is not None and not scenario.has_board:
        raise StationError(
            "the skill has a force channel, but board.shape is none. Use a scenario with "
            "a board, or learn the skill without the channel."
        )


def AddSkill(
    builder: DiagramBuilder,
    scene: BoardScene,
    skill: FourierMovementPrimitive,
    *,
    controller: System,
    measured: Measurements,
    tracker: Tracker | None,
    sample: bool | None,
    seed: int | None,
) -> Playback:
    """Add a skill that commands a controller, and export its outputs.

    Systems: fourier_primitive, desired_motion; of a skill with further channels, or on
    a curved surface, task_motion, controller_inputs, skill_position, position_covariance
    of a simulated arm, measured_coordinates, and force_channel with demonstrated_force
    and demonstrated_force_offset.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    skill : FourierMovementPrimitive
        Fitted.
    controller : System
        With the outputs measured_position and measured_pose, and the inputs of the
        impedance controller.
    measured : Measurements
        Of the task.
    tracker : Tracker or None
        As for `FourierPrimitiveSystem`.
    sample, seed
        Instead of the scenario's, unless None.
    """
    roles, config = SkillRoles(skill), scene.scenario.skill
    choice = None if measured.ink is None else ChoiceByInk(scene.scenario, skill)
    primitive = FourierPrimitiveSystem(
        skill,
        tracker=tracker,
        sample=config.sample if sample is None else sample,
        seed=config.seed if seed is None else seed,
        push_threshold=config.push_threshold,
        push_dwell=config.push_dwell,
        choice=choice,
        margin=SkillMargin(scene.scenario, skill),
        soft_start=True,
    )
    builder.AddSystem(primitive)
    # The motion is evaluated once for position, velocity and acceleration.
    desired: Any = builder.AddNamedSystem("desired_motion", Demultiplexer([3, 3, 3]))
    position = controller.GetOutputPort("measured_position")
    force = controller.GetInputPort("desired_normal_force")
    covariance = primitive.GetOutputPort("covariance")
    d = roles.count
    if d == 3 and scene.curvature.is_plane:
        builder.Connect(position, primitive.GetInputPort("measured_position"))
        builder.Connect(primitive.GetOutputPort("motion"), desired.get_input_port())
        for order, name in enumerate(DESIRED):
            source = desired.get_output_port(order)
            builder.Connect(source, controller.GetInputPort(name))
    else:
        rows = [order * d + i for order in range(3) for i in roles.position]
        motion = primitive.GetOutputPort("motion")
        part = _Select(builder, "skill_position", motion, rows)
        builder.Connect(part, desired.get_input_port())
        task, parts = _AddTaskMotion(builder, scene, roles, primitive, controller)
        if not scene.curvature.is_plane:
            coordinates = task.GetOutputPort("measured")
            position = _Select(
                builder, "measured_coordinates", coordinates, roles.position
            )
        if d > 3 and scene.is_simulated:
            rows = [i * d + j for i in roles.position for j in roles.position]
            covariance = _Select(builder, "position_covariance", covariance, rows)
        if roles.force is not None:
            port = task.GetInputPort("normal_force")
            builder.Connect(measured.normal_force, port)
            largest_force = max(float(skill.extent_[1, roles.force]), 0.0)
            demonstrated = parts["desired_normal_force"]
            force = _AddForceChannel(builder, scene, demonstrated, force, largest_force)
        if roles.rotation is not None:
            name = "desired_orientation"
            builder.ExportOutput(parts[name], name)
    if choice is not None and measured.ink is not None:
        builder.Connect(measured.ink, primitive.GetInputPort("ink"))
    if measured.ink_position is not None:
        builder.Connect(position, measured.ink_position)
    if scene.is_simulated:
        builder.Connect(covariance, controller.GetInputPort("covariance"))
    for order, name in enumerate(DESIRED):
        builder.ExportOutput(desired.get_output_port(order), name)
    for name in ("covariance", "weights", "component", "remaps", "phase"):
        if primitive.HasOutputPort(name):
            builder.ExportOutput(primitive.GetOutputPort(name), name)
    return Playback(primitive=primitive, roles=roles, position=position, force=force)


def _AddTaskMotion(
    builder: DiagramBuilder,
    scene: BoardScene,
    roles: ChannelRoles,
    primitive: FourierPrimitiveSystem,
    controller: System,
) -> tuple[TaskMotion, dict[str, OutputPort]]:
    """Convert a skill's motion to the controller's inputs; return these as ports.

    The normal force is not connected to the controller here.
    """
    # A curved surface on a rail moves, and the task frame moves over it.
    on_rail = builder.HasSubsystemNamed("task_frame") and not scene.curvature.is_plane
    task = TaskMotion(roles, scene.curvature, X_WS=scene.X_WA, is_moving=on_rail)
    builder.AddSystem(task)
    for name in FRAME if on_rail else ():
        frame = builder.GetSubsystemByName(name).get_output_port()
        builder.Connect(frame, task.GetInputPort(name.replace("task", "surface")))
    desired = builder.AddNamedSystem(
        "controller_inputs", Demultiplexer([*task.parts.values()])
    )
    builder.Connect(task.GetOutputPort("desired"), desired.get_input_port())
    parts = {name: desired.get_output_port(i) for i, name in enumerate(task.parts)}
    if "task_frame" in parts and builder.HasSubsystemNamed(_ESTIMATOR):
        estimator = builder.GetSubsystemByName(_ESTIMATOR)
        builder.Connect(parts["task_frame"], estimator.GetInputPort("task_frame"))
    Connect(builder, primitive, task, "motion")
    Connect(builder, controller, task, "measured_pose")
    measured = task.GetOutputPort("measured")
    builder.Connect(measured, primitive.GetInputPort("measured_position"))
    for name, port in parts.items():
        if name != "desired_normal_force":
            builder.Connect(port, controller.GetInputPort(name))
    return task, parts


def _AddForceChannel(
    builder: DiagramBuilder,
    scene: BoardScene,
    demonstrated: OutputPort,
    force: InputPort,
    largest_force: float,
) -> InputPort:
    """Connect a skill's force channel, and return the port of the nominal force.

    Samples are limited to the largest demonstrated force, N. The value at the port, less
    the scenario's normal force, is added to the channel: a page's slider shifts the
    demonstrated force.
    """
    total = builder.AddNamedSystem("force_channel", Adder(3, 1))
    nominal = builder.AddNamedSystem(
        "demonstrated_force_offset",
        ConstantVectorSource(np.array([-scene.scenario.press.force])),
    )
    name = "desired_normal_force"
    limit = builder.AddNamedSystem(
        "demonstrated_force",
        Saturation(min_value=np.zeros(1), max_value=np.full(1, largest_force)),
    )
    builder.Connect(demonstrated, limit.get_input_port())
    builder.Connect(limit.get_output_port(), total.get_input_port(0))
    builder.Connect(nominal.get_output_port(), total.get_input_port(2))
    builder.Connect(total.get_output_port(), force)
    builder.ExportOutput(total.get_output_port(), name)
    return total.get_input_port(1)


def _Select(
    builder: DiagramBuilder, name: str, source: OutputPort, rows: Sequence[int]
) -> OutputPort:
    """Add a system that selects some elements of a vector."""
    part = builder.AddNamedSystem(name, MatrixGain(np.eye(source.size())[[*rows]]))
    builder.Connect(source, part.get_input_port())
    return part.get_output_port()


def SampleSkillPaths(
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    roles: ChannelRoles,
    *,
    tempo: float,
    stride: int,
) -> Array:
    """Play windows from the start, and sample windows from the whole mixture.

    Half of the samples are arbitrary, half are the longest of many: a run prefers
    samples that wipe much, which are long and fast. As in a run, samples are moved
    towards the mean until they are within the skill's margin.

    Returns
    -------
    array, shape (B, T, D)
        Channels of the skill, with positions in B, m; windows from the start first.
    """
    config = scenario.skill
    start = StartChannels(scenario, skill, roles)
    beginnings = np.empty((_BEGINNINGS, skill.n_steps, skill.n_channels_))
    margin = SkillMargin(scenario, skill)
    player = Player(skill, sample=config.sample, seed=config.seed, margin=margin)
    for i in range(_BEGINNINGS):
        state = player.start(start, tempo=tempo, seed=config.seed + i)
        for k in range(skill.n_steps):
            beginnings[i, k] = player.motion(state)[0]
            state = player.advance(state, player.tick_seconds / tempo)
    windows = int(np.clip(_SAMPLES // skill.n_steps, *_WINDOWS))
    steady, deviation = skill.draw_windows(_CANDIDATES * windows, seed=config.seed)
    steps = np.diff((steady + deviation)[..., list(roles.position)], axis=1)
    lengths = np.sum(np.linalg.norm(steps, axis=2), axis=1)
    longest = np.argsort(lengths[windows // 2 :])[windows // 2 - windows :]
    rows = [*range(windows // 2), *(windows // 2 + longest)]
    steady, deviation = steady[rows], deviation[rows]
    if player.region is not None:
        parts = player.region.largest_channel_fractions(steady, deviation)
        deviation *= parts[:, None]
    return np.concatenate([beginnings, steady + deviation])[:, ::stride]


def SampledForces(
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    roles: ChannelRoles,
    values: Array,
) -> Array | float:
    """Return the normal forces (B, T) of sampled channels (B, T, D), or the nominal one, N."""
    if roles.force is None:
        return scenario.nominal_force()
    largest_force = max(float(skill.extent_[1, roles.force]), 0.0)
    return np.clip(values[..., roles.force], 0.0, largest_force)


def SampledRotations(roles: ChannelRoles, values: Array) -> Array | None:
    """Return R_TE (B, T, 3, 3) of sampled channels (B, T, D), if they have a rotation."""
    if roles.rotation is None or roles.reference is None:
        return None
    vectors = values[..., list(roles.rotation)].reshape(-1, 3)
    R_TE = rotations_of(vectors, roles.reference).as_matrix()
    return R_TE.reshape(*values.shape[:2], 3, 3)
