"""Robots: configuration (a YAML file beside a URDF), and models in plants."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import (
    CollisionFilterDeclaration,
    Convex,
    GeometryInstance,
    MakePhongIllustrationProperties,
    Mesh,
    PerceptionProperties,
    Rgba,
    Role,
    SceneGraph,
    Shape,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint, JointActuator, ModelInstanceIndex

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array, as_path, check_type
from fmp_drake.settings import bounded, check_settings
from fmp_drake.station.models.eraser import AddEraser
from fmp_drake.station.models.model_files import (
    check_free_name,
    check_limit_order,
    check_model_file,
    models_dir,
    name_is_taken,
    named_joints,
    warned_once,
)
from fmp_drake.station.scenario_parts import (
    EraserConfig,
    PoseConfig,
    in_one_line,
    load_settings,
)
from fmp_drake.systems import FrictionConfig, ImpedanceConfig

DEFAULT_ROBOT = "panda"
"""Robot of the package that is used where none is named."""

Tool = EraserConfig | str
"""An eraser, `spoon`, or a model file (SDF or URDF) with the frames `mount` and `tip`."""

TOOL = "tool"
"""Name of the tool's bodies in a group of `contact_free`, and of a link of this name."""

# Files of pictures that the page draws, and the colour of a link without one.
_DRAWN, _LINK_COLOUR = (".obj", ".gltf", ".glb", ".dae"), (0.75, 0.78, 0.82, 1.0)


@dataclass(kw_only=True)
class RobotConfig:
    """Settings of an arm of n joints that are not in its model.

    Attributes
    ----------
    description : str
        One sentence: the arm, and its command interfaces.
    model : str
        URDF or SDF file, relative to the YAML file.
    base, flange : str
        Frames of the model: the one that is welded to the world, and the one that
        carries the tool.
    base_pose : PoseConfig
        Of the base in the world.
    mount : PoseConfig
        Of the tool on the flange.
    posture : list of n floats
        Joint angles that a redundant arm prefers, rad.
    contact_free : list of lists of str
        Groups of bodies that cannot touch each other; `tool` stands for the tool.
    friction : FrictionConfig
        Of its joints; lists of n, or empty where it is not known.
    reflected_inertia : list of floats
        Inertia of the motors as seen at the joints, kg m²: a list of one number for all, or
        of n. It replaces the model's; empty where the model has it.
    max_torque_rate : float
        Fastest change of any joint torque that it accepts, Nm/s.
    driver : str
        Name of the real arm's `Driver`; empty where it has none.
    joint_names : list of n str
        Names of the joints in recordings by the maker's driver, in order; empty where they
        are those of the model.
    joint_prefixes : list of str
        Names of the arm before the numbers of joints in recordings: `panda` of
        `panda_joint1`. Other robots do not take joints of these names for their own.

    Examples
    --------
    >>> LoadRobot("panda").max_torque_rate
    900.0
    """

    description: str = ""
    model: str = ""
    base: str = ""
    flange: str = ""
    base_pose: PoseConfig = field(default_factory=PoseConfig)
    mount: PoseConfig = field(default_factory=PoseConfig)
    posture: list[float] = bounded([])
    contact_free: list[list[str]] = field(default_factory=list)
    friction: FrictionConfig = field(default_factory=FrictionConfig)
    reflected_inertia: list[float] = bounded([], least=0)
    max_torque_rate: float = bounded(1000.0, above=0)
    driver: str = ""
    joint_names: list[str] = field(default_factory=list)
    joint_prefixes: list[str] = field(default_factory=list)

    def complete(self, config: ImpedanceConfig) -> ImpedanceConfig:
        """Return a controller's settings with this robot's where they have none."""
        rate = config.max_torque_rate
        return replace(
            config,
            max_torque_rate=self.max_torque_rate if rate is None else rate,
            friction_compensation=config.friction_compensation.completed(self.friction),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """An arm with its tool in a plant.

    Attributes
    ----------
    config : RobotConfig
    plant : MultibodyPlant
    arm, tool : ModelInstanceIndex
    tip : Frame
        E, of the tool.
    """

    config: RobotConfig
    plant: MultibodyPlant
    arm: ModelInstanceIndex
    tool: ModelInstanceIndex
    tip: Frame

    @property
    def default_posture(self) -> Array:
        """Joint angles in the plant's default Context, shape (n,), rad."""
        return self.plant.GetDefaultPositions(self.arm)

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints in the arm's model; the plant is that of `MakeRobotModel`."""
        return self.plant.GetPositionNames(
            add_model_instance_prefix=False, always_add_suffix=False
        )

    def tip_poses(self, angles: ArrayLike) -> list[RigidTransform]:
        """Return the N poses X_WE for joint angles (N, n), rad.

        The plant is that of `MakeRobotModel`.
        """
        context = self.plant.CreateDefaultContext()
        poses = []
        for q in np.asarray(angles):
            self.plant.SetPositions(context, q)
            poses.append(self.tip.CalcPoseInWorld(context))
        return poses


def ListRobots() -> list[str]:
    """Return the names of the robots that come with the package."""
    files = models_dir().glob("*/*.yaml")
    return sorted(file.stem for file in files if file.stem == file.parent.name)


def LoadRobot(robot: str | Path) -> RobotConfig:
    """Load a robot: the name of one that comes with the package, or a YAML file.

    Raises
    ------
    StationError
        If there is no such robot, or a value of its file is not allowed.

    Examples
    --------
    >>> len(LoadRobot("panda").posture)
    7
    """
    file = as_path(robot, "the robot", error=StationError)
    if file.suffix not in (".yaml", ".yml"):
        if file.suffix and file.is_file():
            raise StationError(
                f"{robot} is not a YAML file; write one beside it, with the keys "
                f"`model: {file.name}`, `base` and `flange`."
            )
        file = models_dir() / file / f"{file}.yaml"
    if not file.is_file():
        raise StationError(
            f"there is no robot {robot}; give a YAML file or one of: "
            f"{', '.join(ListRobots())}."
        )
    with in_one_line(f"{file.name} is not a robot"):
        config = deepcopy(_ReadRobot(file.read_text(encoding="utf-8")))
    config.model = str(file.parent / config.model)
    return config


@lru_cache(maxsize=8)
def _ReadRobot(text: str) -> RobotConfig:
    """Parse the text of a robot's file, in 6 ms. A station loads its robot three times."""
    config: RobotConfig = load_settings(RobotConfig, text)
    _CheckRobot(config)
    return config


def _CheckRobot(config: RobotConfig) -> None:
    check_settings(config, StationError)
    n = len(config.posture)
    for name in ("model", "base", "flange", "posture"):
        if not getattr(config, name):
            raise StationError(f"{name} is empty; every robot needs it.")
    for name in ("height", "slope", "shift"):
        if len(values := getattr(config.friction, name)) not in (0, n):
            raise StationError(
                f"friction.{name} is {values}; expected {n} numbers, as in posture."
            )
    if len(config.reflected_inertia) not in (0, 1, n):
        raise StationError(
            f"reflected_inertia is {config.reflected_inertia}; expected a list "
            f"of one number, or of {n} as in posture."
        )
    if len(config.joint_names) not in (0, n):
        raise StationError(
            f"joint_names is {config.joint_names}; expected {n} names, as in posture."
        )


def AddRobot(
    plant: MultibodyPlant,
    config: RobotConfig,
    tool: Tool | None = None,
    *,
    model_name_prefix: str = "",
) -> Robot:
    """Add an arm, welded to the world, with its tool on the flange.

    Contact needs a plant that is registered with a scene graph.

    Parameters
    ----------
    plant : MultibodyPlant
        Not finalized, without a model of the arm's or the tool's name.
    config : RobotConfig
    tool : EraserConfig or str, optional
        An eraser, `spoon`, or a model file; the default eraser if None.
    model_name_prefix : str
        Scope of the names of both models, as of Drake's `Parser`, with which a plant takes
        a second arm.

    Raises
    ------
    StationError
        If a value is not allowed, or the model does not match the configuration.

    Examples
    --------
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> robot = AddRobot(plant, LoadRobot("panda"), EraserConfig(friction=0.3))
    >>> plant.GetModelInstanceName(robot.tool)
    'eraser'
    """
    check_type(config, "config", RobotConfig, error=StationError)
    _CheckRobot(config)
    if plant.is_finalized():
        raise StationError(
            "the plant is finalized; add the robot before plant.Finalize()."
        )
    parser = Parser(plant, model_name_prefix)
    packages = parser.package_map()
    hint = (
        " Meshes are found relative to the model, or in its package, a folder with a "
        "package.xml around it; those of a <collision> are .obj, .gltf or .vtk files, and a "
        "model needs no <visual>."
    )
    model = Path(config.model)
    check_model_file(model)
    with in_one_line(f"{model.name} cannot be read", hint):
        for folder in model.absolute().parents[:3]:
            if (folder / "package.xml").is_file():
                packages.AddPackageXml(str(folder / "package.xml"))
        if not packages.Contains("fmp_drake"):  # A copy of it may be around the model.
            packages.AddPackageXml(str(models_dir() / "package.xml"))
        arm = _AddOneModel(parser, config.model)
    motors = _CheckModel(plant, arm, config)
    if config.reflected_inertia:
        inertias = np.broadcast_to(config.reflected_inertia, len(motors))
        for motor, inertia in zip(motors, inertias, strict=True):
            motor.set_default_rotor_inertia(inertia)
            motor.set_default_gear_ratio(1.0)
    tool_instance, tip = AddTool(plant, tool or EraserConfig(), model_name_prefix)
    plant.WeldFrames(
        plant.world_frame(),
        plant.GetFrameByName(config.base, arm),
        config.base_pose.transform(),
    )
    plant.WeldFrames(
        plant.GetFrameByName(config.flange, arm),
        plant.GetFrameByName("mount", tool_instance),
        config.mount.transform(),
    )
    return Robot(config=config, plant=plant, arm=arm, tool=tool_instance, tip=tip)


def _AddOneModel(parser: Parser, file: str) -> ModelInstanceIndex:
    """Add the only model of a file.

    Raises
    ------
    StationError
        Where it has several, such as nested ones, or the plant has one of its name.
    """
    try:
        with warned_once(file):
            models = parser.AddModels(file)
    except (RuntimeError, SystemExit) as error:
        if "limits.array()" in str(error):  # Drake does not name the joint.
            check_limit_order(file)
        if "already contains a model instance named" not in str(error):
            raise
        raise name_is_taken(str(error).split("'")[1]) from None
    if len(models) != 1:
        names = ", ".join(map(parser.plant().GetModelInstanceName, models))
        raise StationError(
            f"it has {len(models)} models ({names}); put all links and joints into one."
        )
    return models[0]


def _CheckModel(
    plant: MultibodyPlant, arm: ModelInstanceIndex, config: RobotConfig
) -> list[JointActuator]:
    """Check that a model has what its configuration names, and actuated joints only.

    Returns the actuators, in the order of the joints.

    Raises
    ------
    StationError
    """
    model = Path(config.model).name
    frames = {plant.get_frame(i).name() for i in plant.GetFrameIndices(arm)}
    bodies = {plant.get_body(i).name() for i in plant.GetBodyIndices(arm)}
    named = [("base", config.base, frames), ("flange", config.flange, frames)]
    groups = (name for group in config.contact_free for name in group)
    named += [("contact_free", name, bodies | {TOOL}) for name in groups]
    for field_name, name, names in named:
        if name not in names:
            raise StationError(
                f"{field_name} names {name}, which {model} does not have; choose from: "
                f"{', '.join(sorted(names))}."
            )
    joints = [plant.get_joint(i) for i in plant.GetJointIndices(arm)]
    parents = {j.child_body().name(): j for j in joints}
    if any(j.parent_body().index() == plant.world_body().index() for j in joints):
        raise StationError(
            f"{model} is joined to the world; remove this joint, because {config.base} is "
            "placed by base_pose."
        )
    joints = [j for j in joints if j.num_positions()]
    if other := [j.name() for j in joints if j.type_name() != "revolute"]:
        raise StationError(
            f"{', '.join(other)} of {model} cannot be joints of an arm: it has revolute joints "
            'only. Make the joints of a gripper or a rail fixed (type="fixed").'
        )

    def moving(frame: str) -> list[str]:
        """Return the joints that move a frame, from the root of the model on."""
        body, found = plant.GetFrameByName(frame, arm).body().name(), list[Joint]()
        while body in parents:
            if parents[body] in found:
                loop = [j.name() for j in found[: found.index(parents[body]) + 1]]
                raise StationError(
                    f"{', '.join(loop)} of {model} are a loop; remove one of them, because "
                    "an arm is a chain of links."
                )
            found.insert(0, parents[body])
            body = parents[body].parent_body().name()
        return [j.name() for j in found if j.num_positions()]

    below, order = moving(config.base), moving(config.flange)
    if outside := sorted({j.name() for j in joints} - {*order} | {*below}):
        raise StationError(
            f"{', '.join(outside)} of {model} cannot be joints of an arm from the base "
            f"{config.base} to the flange {config.flange}. Name the arm's first link as base and "
            'its last one as flange, and make the joints of a gripper fixed (type="fixed").'
        )
    if plant.num_constraints():
        mimics = [n for n in named_joints(config.model, "mimic") if n in order]
        raise StationError(
            f"{', '.join(mimics) or 'a joint'} of {model} cannot mimic another joint; "
            "make it fixed or independent."
        )
    # As in a plant, wherever they are in the file.
    joints.sort(key=lambda joint: order.index(joint.name()))
    if len(joints) != len(config.posture):
        raise StationError(
            f"the posture is {config.posture}; give an angle for each of the {len(joints)} "
            f"joints of {model}, {', '.join(order)}, or make some fixed."
        )
    # Only a finalized plant lists the actuators of one model.
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    motors = {actuator.joint().index(): actuator for actuator in actuators}
    if without := [j.name() for j in joints if j.index() not in motors]:
        raise StationError(
            f"{', '.join(without)} of {model} cannot be moved: a joint needs an effort limit "
            "above 0, Nm, and in a URDF a transmission."
        )
    if unlimited := [
        j.name() for j in joints if not 0 < j.velocity_upper_limits()[0] < np.inf
    ]:
        raise StationError(
            f"the velocity limit of {', '.join(unlimited)} of {model} is missing or 0; give "
            "the joint's greatest speed, rad/s."
        )
    unlimited = [j.name() for j in joints if np.isinf(motors[j.index()].effort_limit())]
    if unlimited:
        raise StationError(
            f"the effort limit of {', '.join(unlimited)} of {model} is missing; give the "
            "joint's greatest torque, Nm."
        )
    # Masses of the links, each with the bodies that are fixed to it.
    masses = dict.fromkeys(order, 0.0)
    for body in bodies:
        for joint in moving(body)[-1:]:
            masses[joint] += plant.GetBodyByName(body, arm).default_mass()
    if massless := [j.child_body().name() for j in joints if not masses[j.name()]]:
        raise StationError(
            f"links of {model} have no mass: {', '.join(massless)}; give each its inertia."
        )
    check_posture(
        config.posture,
        order,
        np.concatenate([joint.position_lower_limits() for joint in joints]),
        np.concatenate([joint.position_upper_limits() for joint in joints]),
    )
    return [motors[joint.index()] for joint in joints]


def check_posture(
    posture: Sequence[float], names: Sequence[str], lower: Array, upper: Array
) -> None:
    """Check that the angles of joints (n,), rad, are between their limits.

    Raises
    ------
    StationError
        With the first one that is not.
    """
    for name, angle, low, high in zip(names, posture, lower, upper, strict=True):
        if not low <= angle <= high:
            raise StationError(
                f"posture has {angle:g} for {name}, whose range is {low:g} to {high:g} rad; "
                "choose an angle in it."
            )


def AddTool(
    plant: MultibodyPlant, tool: Tool, model_name_prefix: str = ""
) -> tuple[ModelInstanceIndex, Frame]:
    """Add a tool with its frame `mount`, and return it with its tip E.

    Raises
    ------
    StationError
        Where a model file is missing, or is not one rigid model with both frames.
    """
    if isinstance(tool, EraserConfig):
        eraser = AddEraser(plant, tool, model_name_prefix)
        return eraser, plant.GetFrameByName("eraser_tip", eraser)
    file = models_dir() / "spoon" / "spoon.sdf" if tool == "spoon" else Path(tool)
    if not file.is_file():
        raise StationError(
            f"there is no tool {tool}; choose eraser or spoon, or give a model file."
        )
    with in_one_line(
        f"{tool} is not a tool, one rigid model with the frames mount and tip"
    ):
        model = _AddOneModel(Parser(plant, model_name_prefix), str(file))
        frames = {plant.get_frame(i).name() for i in plant.GetFrameIndices(model)}
        if missing := {"mount", "tip"} - frames:
            raise StationError(
                f"it has no frame {' and '.join(sorted(missing))}, but "
                f"{', '.join(sorted(frames))}."
            )
        joints = [plant.get_joint(i) for i in plant.GetJointIndices(model)]
        if moving := [joint.name() for joint in joints if joint.num_positions()]:
            raise StationError(
                f'its {", ".join(moving)} can move; make it fixed (type="fixed").'
            )
    return model, plant.GetFrameByName("tip", model)


def MakeRobotModel(
    config: RobotConfig,
    tool: Tool | None = None,
    *,
    scene_graph: SceneGraph | None = None,
) -> Robot:
    """Make the model of a controller: a plant of the arm and its tool with their weight.

    Parameters
    ----------
    config : RobotConfig
    tool : EraserConfig or str, optional
    scene_graph : SceneGraph, optional
        Registers the geometry, for geometry queries.
    """
    plant = MultibodyPlant(time_step=0.0)
    plant.set_name("arm")
    if scene_graph is not None:
        plant.RegisterAsSourceForSceneGraph(scene_graph)
    robot = AddRobot(plant, config, tool)
    check_free_name(plant, "whiteboard")  # Of a station.
    with in_one_line(f"{Path(config.model).name} with its tool cannot be simulated"):
        plant.Finalize()
    if plant.num_positions() != len(config.posture):
        floating = [plant.get_body(i).name() for i in plant.GetFloatingBaseBodies()]
        raise StationError(
            f"{', '.join(floating)} is joined neither to {config.base} nor to the tool's "
            "frame mount; join it by a fixed joint."
        )
    return robot


def FilterSelfContact(robot: Robot, scene_graph: SceneGraph) -> None:
    """Exclude contact within each group of bodies that cannot touch each other."""
    plant, manager = robot.plant, scene_graph.collision_filter_manager()
    tool = [plant.get_body(i) for i in plant.GetBodyIndices(robot.tool)]
    for group in robot.config.contact_free:
        names = [b for b in group if plant.HasBodyNamed(b, robot.arm)]
        bodies = [plant.GetBodyByName(b, robot.arm) for b in names]
        bodies += tool if TOOL in group else []
        manager.Apply(
            CollisionFilterDeclaration().ExcludeWithin(
                plant.CollectRegisteredGeometries(bodies)
            )
        )


def ShowContactGeometry(robot: Robot, scene_graph: SceneGraph) -> None:
    """Show the contact geometry of links without a picture that can be drawn."""
    plant, inspector = robot.plant, scene_graph.model_inspector()
    source: Any = plant.get_source_id()
    for i in plant.GetBodyIndices(robot.arm):
        body = plant.get_body(i)
        pictures = map(inspector.GetShape, plant.GetVisualGeometriesForBody(body))
        geometries = plant.GetCollisionGeometriesForBody(body)
        if not geometries or not all(_IsUndrawn(picture) for picture in pictures):
            continue
        perception = PerceptionProperties()
        perception.AddProperty("phong", "diffuse", Rgba(*_LINK_COLOUR))
        illustration = MakePhongIllustrationProperties(np.array(_LINK_COLOUR))
        frame = plant.GetBodyFrameIdOrThrow(i)
        for role in (Role.kIllustration, Role.kPerception):
            scene_graph.RemoveRole(source, frame, role)
        for geometry in geometries:
            scene_graph.AssignRole(source, geometry, illustration)
            shape, drawn = inspector.GetShape(geometry), geometry
            # A renderer needs normals, which a mesh may lack.
            if isinstance(shape, Mesh):
                hull = GeometryInstance(
                    inspector.GetPoseInFrame(geometry),
                    Convex(shape.source(), shape.scale3()),
                    inspector.GetName(geometry),
                )
                drawn = scene_graph.RegisterGeometry(source, frame, hull)
            scene_graph.AssignRole(source, drawn, perception)


def _IsUndrawn(shape: Shape) -> bool:
    """Return whether neither the page nor a film draws a picture."""
    return isinstance(shape, Mesh) and shape.extension() not in _DRAWN
