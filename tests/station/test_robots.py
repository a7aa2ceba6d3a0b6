"""Facts about the arms that come along: geometry, limits, masses, postures, contact."""

import re
import shutil
from itertools import product

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose
from pydrake.geometry import Box, Convex, Ellipsoid, Mesh, Role, SceneGraph, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from scipy.spatial.transform import Rotation

from fmp_drake.errors import StationError
from fmp_drake.station import LoadRobot, Scenario, models_dir
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.robots.collision_spheres import CollectCollisionSpheres
from fmp_drake.station.robots.robot import (
    AddRobot,
    FilterSelfContact,
    MakeRobotModel,
    RobotConfig,
)
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.station.scenario_parts import PoseConfig
from fmp_drake.systems import ImpedanceConfig, OperationalSpaceImpedanceController
from fmp_drake.systems.interface.arm_model import joint_damping

ARMS = ("panda", "iiwa14", "ur5e")
HALF = np.pi / 2

# Denavit-Hartenberg parameters (classic): d, a, alpha of each joint, m and rad.
DH = {
    "iiwa14": [
        (0.36, 0.0, -HALF),
        (0.0, 0.0, HALF),
        (0.42, 0.0, HALF),
        (0.0, 0.0, -HALF),
        (0.40, 0.0, -HALF),
        (0.0, 0.0, HALF),
        (0.126, 0.0, 0.0),
    ],
    "ur5e": [
        (0.1625, 0.0, HALF),
        (0.0, -0.425, 0.0),
        (0.0, -0.3922, 0.0),
        (0.1333, 0.0, HALF),
        (0.0997, 0.0, -HALF),
        (0.0996, 0.0, 0.0),
    ],
}
# Range (degrees, either way), speed (degrees/s), torque (Nm), mass of the link (kg).
FACTS = {
    "iiwa14": [
        (170, 85, 320, 5.76),
        (120, 85, 320, 6.35),
        (170, 100, 176, 3.5),
        (120, 75, 176, 3.5),
        (170, 130, 110, 3.5),
        (120, 135, 40, 1.8),
        (175, 135, 40, 1.2),
    ],
    "ur5e": [
        (360, 180, 150, 3.761),
        (360, 180, 150, 8.058),
        (180, 180, 150, 2.846),
        (360, 180, 28, 1.37),
        (360, 180, 28, 1.3),
        (360, 180, 28, 0.365),
    ],
}
# Centres of mass by the maker's table, in the frame after each joint, m.
UR5E_CENTRES = [
    (0, -0.02561, 0.00193),
    (0.2125, 0, 0.11336),
    (0.15, 0, 0.0265),
    (0, -0.0018, 0.01634),
    (0, 0.0018, 0.01634),
    (0, 0, -0.001159),
]


def model_of(name, scene_graph=None):
    return MakeRobotModel(LoadRobot(name), scene_graph=scene_graph)


def dh_frames(name, q):
    """Return the homogeneous transform after each joint, from the base."""
    pose, frames = np.eye(4), []
    for angle, (d, a, alpha) in zip(q, DH[name], strict=True):
        turn, twist = np.eye(4), np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
        twist[:3, :3] = Rotation.from_rotvec([alpha, 0, 0]).as_matrix()
        turn[2, 3], twist[0, 3] = d, a
        pose = pose @ turn @ twist
        frames.append(pose)
    return frames


def postures(plant, count=20):
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    return np.random.default_rng(0).uniform(lower, upper, (count, len(lower)))


@pytest.mark.parametrize("name", DH)
def test_the_flange_is_where_the_makers_table_puts_it(name):
    robot = model_of(name)
    config, plant = robot.config, robot.plant
    base = config.base_pose.transform().GetAsMatrix4()
    context = plant.CreateDefaultContext()
    for q in postures(plant):
        plant.SetPositions(context, q)
        X_WF = plant.GetFrameByName(config.flange, robot.arm).CalcPoseInWorld(context)
        expected = base @ dh_frames(name, q)[-1]
        assert_allclose(X_WF.GetAsMatrix4(), expected, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_the_lightest_joint_turns_slowly_in_the_springs_of_a_tool(name):
    # Where it turned by 0.2 rad of its oscillation a period, it became unstable.
    robot = LoadRobot(name)
    plant = MakeRobotModel(robot).plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, robot.posture)
    lightest = np.diag(plant.CalcMassMatrix(context)).min()
    stiffness, period = 60.0, 1e-3
    assert np.sqrt(stiffness / lightest) * period < 0.05


@pytest.mark.parametrize("name", FACTS)
def test_limits_and_masses_are_the_published_ones(name):
    robot = model_of(name)
    plant = robot.plant
    ranges, speeds, torques, masses = np.array(FACTS[name]).T
    assert_allclose(plant.GetPositionUpperLimits(), np.radians(ranges), atol=1e-5)
    assert_allclose(plant.GetPositionLowerLimits(), -np.radians(ranges), atol=1e-5)
    assert_allclose(plant.GetVelocityUpperLimits(), np.radians(speeds), atol=1e-5)
    assert_allclose(plant.GetEffortUpperLimits(), torques)
    links = [plant.GetBodyByName(f"{name}_link{i + 1}") for i in range(len(masses))]
    assert_allclose([link.default_mass() for link in links], masses)


def test_the_centres_of_mass_of_a_ur5e_are_the_makers():
    robot = model_of("ur5e")
    plant, base = robot.plant, robot.config.base_pose.transform().GetAsMatrix4()
    context = plant.CreateDefaultContext()
    (q,) = postures(plant, 1)
    plant.SetPositions(context, q)
    for i, (frame, centre) in enumerate(
        zip(dh_frames("ur5e", q), UR5E_CENTRES, strict=True), start=1
    ):
        link = plant.GetBodyByName(f"ur5e_link{i}")
        p_WC = link.EvalPoseInWorld(context) @ link.default_com()
        assert_allclose(p_WC, (base @ frame @ [*centre, 1])[:3], atol=1e-5)


@pytest.mark.parametrize("name", ARMS)
def test_the_default_posture_holds_the_eraser_level_with_good_margins(name):
    robot = model_of(name)
    plant, q = robot.plant, np.array(robot.config.posture)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    level = RigidTransform(RotationMatrix(RollPitchYaw(np.pi, 0, 0)), [0.55, 0.0, 0.10])
    error = level.inverse() @ robot.tip.CalcPoseInWorld(context)
    assert np.linalg.norm(error.translation()) < 0.02
    assert error.rotation().ToAngleAxis().angle() < 0.03
    margin = np.minimum(
        q - plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits() - q
    )
    assert np.all(margin > 0.4)
    jacobian = plant.CalcJacobianSpatialVelocity(
        context,
        JacobianWrtVariable.kV,
        robot.tip,
        [0, 0, 0],
        plant.world_frame(),
        plant.world_frame(),
    )
    assert np.linalg.svd(jacobian)[1][-1] > 0.15


@pytest.mark.parametrize("name", ARMS)
def test_nothing_touches_in_the_default_posture(name):
    scene = AddBoardScene(
        builder := DiagramBuilder(), Scenario(robot=name), start=[0.0, 0.0, 0.05]
    )
    diagram = builder.Build()
    context = scene.scene_graph.GetMyContextFromRoot(diagram.CreateDefaultContext())
    query = scene.scene_graph.get_query_output_port().Eval(context)
    assert not query.ComputePointPairPenetration()


def adjacent(plant, arm):
    """Return the pairs of bodies that a joint connects, by name."""
    joints = [plant.get_joint(i) for i in plant.GetJointIndices(arm)]
    return {(j.parent_body().name(), j.child_body().name()) for j in joints}


@pytest.mark.parametrize("name", ["iiwa14", "ur5e"])
def test_bodies_of_a_group_without_contact_cannot_meet_unless_they_are_neighbours(name):
    builder = DiagramBuilder()
    scene_graph = builder.AddSystem(SceneGraph())
    robot = model_of(name, scene_graph)
    plant = builder.AddSystem(robot.plant)
    builder.Connect(
        plant.get_geometry_pose_output_port(),
        scene_graph.get_source_pose_port(plant.get_source_id()),
    )
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    tool = {plant.get_body(i).name() for i in plant.GetBodyIndices(robot.tool)}
    flange = {robot.config.flange: f"{name}_link{len(robot.config.posture)}"}
    neighbours = {
        frozenset(flange.get(body, body) for body in pair)
        for pair in adjacent(plant, robot.arm)
    } | {frozenset((flange[robot.config.flange], body)) for body in tool}
    groups = [
        {b for each in group for b in (tool if each == "tool" else {each})}
        for group in robot.config.contact_free
    ]
    inspector = scene_graph.model_inspector()

    def body_of(geometry):
        return plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).name()

    for q in postures(plant, 150):
        plant.SetPositions(context, q)
        query = scene_graph.get_query_output_port().Eval(
            scene_graph.GetMyContextFromRoot(root)
        )
        for contact in query.ComputePointPairPenetration():
            pair = {body_of(contact.id_A), body_of(contact.id_B)}
            if any(pair <= group for group in groups):
                assert frozenset(pair) in neighbours, (pair, q)


@pytest.mark.parametrize("name", ["iiwa14", "ur5e"])
def test_the_groups_without_contact_filter_every_pair_of_neighbours(name):
    builder = DiagramBuilder()
    scene_graph = builder.AddSystem(SceneGraph())
    robot = model_of(name, scene_graph)
    FilterSelfContact(robot, scene_graph)
    plant, inspector = robot.plant, scene_graph.model_inspector()
    geometries = {}
    for i in plant.GetBodyIndices(robot.arm):
        body = plant.get_body(i)
        frame = plant.GetBodyFrameIdOrThrow(i)
        geometries[body.name()] = inspector.GetGeometries(frame, Role.kProximity)
    for parent, child in adjacent(plant, robot.arm):
        for a in geometries.get(parent, []):
            for b in geometries[child]:
                assert inspector.CollisionFiltered(a, b), (parent, child)


def test_a_link_named_tool_is_in_the_groups_of_the_tool(tmp_path):
    file = _own(
        tmp_path,
        {"ur5e_link6": "tool", "package://fmp_drake/ur5e": str(models_dir() / "ur5e")},
        contact_free=[["ur5e_link4", "tool"]],
    )
    scene_graph = SceneGraph()
    robot = MakeRobotModel(LoadRobot(file), scene_graph=scene_graph)
    FilterSelfContact(robot, scene_graph)
    inspector, plant = scene_graph.model_inspector(), robot.plant
    wrist, link, eraser = (
        plant.GetCollisionGeometriesForBody(plant.GetBodyByName(name, model))[0]
        for name, model in (
            ("ur5e_link4", robot.arm),
            ("tool", robot.arm),
            ("eraser", robot.tool),
        )
    )
    assert inspector.CollisionFiltered(wrist, link)
    assert inspector.CollisionFiltered(wrist, eraser)


@pytest.mark.parametrize("picture", ["", "<mesh filename='link.stl'/>", "drawn"])
def test_a_link_without_a_picture_that_can_be_drawn_is_seen_by_its_contact_geometry(
    tmp_path, picture
):
    pattern = "<visual>.*?</visual>"
    visual = f"<visual name='v'><geometry>{picture}</geometry></visual>"
    changes = {pattern: visual if picture else ""}
    if picture == "drawn":
        changes = {pattern: visual.replace(picture, "<box size='1 1 1'/>")}
    (tmp_path / "link.stl").touch()
    scenario = Scenario(robot=str(_own(tmp_path, changes)))
    scene = AddBoardScene(DiagramBuilder(), scenario, start=[0.0, 0.0, 0.1])
    plant, inspector = scene.plant, scene.scene_graph.model_inspector()
    for name in ("ur5e_link2", "ur5e_link5"):
        frame = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName(name).index())
        touched = inspector.GetGeometries(frame, Role.kProximity)
        for role in (Role.kIllustration, Role.kPerception):
            seen = inspector.GetGeometries(frame, role)
            assert seen
            assert ({*seen} == {*touched}) == (picture != "drawn")


def collision_spheres(shape=None):
    """Return the spheres of a body with a shape 0.2 m beside it."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), builder)
    model = plant.AddModelInstance("arm")
    body = plant.AddRigidBody("link", model)
    if shape is not None:
        X_BodyG = RigidTransform([0.2, 0.0, 0.0])
        friction = CoulombFriction(0.5, 0.5)
        plant.RegisterCollisionGeometry(body, X_BodyG, shape, "bulge", friction)
    plant.Finalize()
    return CollectCollisionSpheres(plant, scene_graph, model)


def test_a_sphere_is_one_of_the_collision_spheres():
    found = collision_spheres(Sphere(0.03))
    assert_allclose(found.points, [[0.2, 0.0, 0.0]])
    assert_allclose(found.radii, [0.03])


def test_a_link_of_a_mesh_without_a_picture_is_seen_by_a_renderer(tmp_path):
    corners = product((-0.05, 0.05), repeat=3)
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    (tmp_path / "link.obj").write_text(vertices + "f 1 2 3\n")  # Without normals.
    mesh = "<mesh filename='link.obj'/>"
    changes = {"<visual>.*?</visual>": "", "<drake:capsule[^>]*/>": mesh}
    file = _own(tmp_path, changes)
    scene = AddBoardScene(
        DiagramBuilder(), Scenario(robot=str(file)), start=[0.0, 0.0, 0.1]
    )
    plant, inspector = scene.plant, scene.scene_graph.model_inspector()
    frame = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName("ur5e_link2").index())
    seen = inspector.GetGeometries(frame, Role.kPerception)
    assert len(seen) == len(inspector.GetGeometries(frame, Role.kProximity)) >= 2
    assert all(isinstance(inspector.GetShape(hull), Convex) for hull in seen)


def test_a_mesh_has_spheres_all_over_its_hull_as_a_box_has(tmp_path):
    corners = np.array([*product((-15.0, 15.0), (-20.0, 20.0), (-25.0, 25.0))])
    inside = np.full((1, 3), 5.0)
    file = tmp_path / "box_in_mm.obj"
    points = np.vstack([corners, inside])
    lines = [f"v {x} {y} {z}\n" for x, y, z in points]
    file.write_text("".join(lines) + "f 1 2 3\nf 1 3 9\n")  # Open.
    shapes = Mesh(str(file), 0.001), Convex(0.001 * points.T, "box")
    for shape in shapes:
        found = collision_spheres(shape)
        expected = collision_spheres(Box(0.03, 0.04, 0.05)).points
        points = np.unique(found.points.round(9), axis=0)
        assert_allclose(points, expected[np.lexsort(expected.T[::-1])], atol=1e-9)
        assert not np.any(found.radii)
    directions = np.random.default_rng(0).normal(size=(400, 3))
    ball = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    found = collision_spheres(Convex(ball.T, "ball"))
    assert len(found.points) <= 98 + 27
    farthest = np.max((found.points - [0.2, 0.0, 0.0]) @ ball.T, axis=0)
    assert np.min(farthest) > 0.9


def test_collision_geometry_that_cannot_be_checked_is_refused():
    with pytest.raises(StationError, match="bulge of link is of type Ellipsoid; use"):
        collision_spheres(Ellipsoid(0.1, 0.2, 0.3))
    with pytest.raises(StationError, match="the robot arm has no collision geometry"):
        collision_spheres()


def _own(folder, changes, **fields):
    """Write a UR5e of one's own, with changes of its URDF's text, and return its file."""
    urdf = (models_dir() / "ur5e" / "ur5e.urdf").read_text()
    for pattern, new in changes.items():
        urdf, count = re.subn(pattern, new, urdf, flags=re.DOTALL)
        assert count
    (folder / "own.urdf").write_text(urdf)
    config = yaml.safe_load((models_dir() / "ur5e" / "ur5e.yaml").read_text())
    (folder / "own.yaml").write_text(
        yaml.safe_dump({**config, "model": "own.urdf", **fields})
    )
    return folder / "own.yaml"


def test_a_robot_that_is_changed_or_whose_file_is_changed_is_loaded_anew(tmp_path):
    file = _own(tmp_path, {})
    robot = LoadRobot(file)
    posture = [*robot.posture]
    robot.posture[0] += 1.0
    assert LoadRobot(file).posture == posture
    assert LoadRobot(_own(tmp_path, {}, posture=[0.1] * 6)).posture == [0.1] * 6


FINGER = """<link name="finger"/><joint name="grip" type="{}"><parent link="ur5e_flange"/>
<child link="finger"/><axis xyz="0 1 0"/><limit lower="0" upper="1" effort="9"
velocity="1"/></joint></robot>"""

WORLD = """<link name="world"/><joint name="fixed_base" type="fixed">
<parent link="world"/><child link="ur5e_link0"/></joint></robot>"""

LOOP = """<joint name="back" type="fixed"><parent link="ur5e_link6"/>
<child link="ur5e_{}"/></joint></robot>"""


@pytest.mark.parametrize(
    ("changes", "fields", "message"),
    [
        (
            {' velocity="[^"]*"': ""},
            {},
            "velocity limit of ur5e_joint1.* is missing or 0",
        ),
        (
            {' effort="[^"]*"': ""},
            {},
            "the effort limit of ur5e_joint1, .* is missing; give",
        ),
        (
            {"<inertial>.*?</inertial>": ""},
            {},
            "links of own.urdf have no mass: ur5e_link1, ",
        ),
        (
            {'(<joint name="ur5e_joint6"[^>]*>)': r'\1<mimic joint="ur5e_joint5"/>'},
            {},
            "^ur5e_joint6 of own.urdf cannot mimic another joint; make it fixed",
        ),
        (  # Drake reads this comment, which is not strict XML.
            {
                '(<joint name="ur5e_joint6"[^>]*>)': r'\1<mimic joint="ur5e_joint5"/>',
                "</robot>": "<!-- a -- b --></robot>",
            },
            {},
            "^a joint of own.urdf cannot mimic another joint; make it fixed",
        ),
        (
            {
                r'(joint3".*?)lower="([^"]*)" upper="([^"]*)"': r'\1lower="\3" upper="\2"',
                "</robot>": "<!-- a -- b --></robot>",
            },
            {},
            "own.urdf cannot be read: Failure at .*joint.h",
        ),
        (  # One that is fixed mimics nothing.
            {
                '(<joint name="ur5e_joint6"[^>]*>)': r'\1<mimic joint="ur5e_joint5"/>',
                "</robot>": FINGER.format("fixed").replace(
                    "</joint>", '<mimic joint="ur5e_flange_joint"/></joint>'
                ),
            },
            {},
            "^ur5e_joint6 of own.urdf cannot mimic another joint; make it fixed",
        ),
        (  # Such a joint has no motor of its own.
            {
                '(<joint name="ur5e_joint6" [^>]*>)': r'\1<mimic joint="ur5e_joint5"/>',
                '<transmission name="ur5e_transmission6".*?</transmission>': "",
            },
            {},
            "^ur5e_joint6 of own.urdf cannot mimic another joint; make it fixed",
        ),
        (
            {
                r'(joint3".*?)lower="([^"]*)" upper="([^"]*)"': r'\1lower="\3" upper="\2"'
            },
            {},
            "ur5e_joint3 has the limits lower 3.14159, upper -3.14159 and velocity 3",
        ),
        (
            {
                r'(joint2".*?)velocity="': r'\1velocity="-',
                "xmlns:drake": "title",  # Drake does not need the declaration of a prefix.
            },
            {},
            "ur5e_joint2 has the limits .* velocity -3.14159; lower .* velocity above 0",
        ),
        ({"</robot>": ""}, {}, r"own\.urdf cannot be read: .*XML"),
        ({}, {"flange": "tool0"}, r"flange names tool0, .* choose from: ur5e_flange, "),
        ({}, {"base": "base_link"}, "base names base_link, which own.urdf does not"),
        ({}, {"contact_free": [["hand"]]}, "contact_free names hand, .* tool, ur5e"),
        ({"</robot>": FINGER.format("prismatic")}, {}, "grip .* revolute joints only"),
        (
            {"</robot>": FINGER.format("revolute")},
            {},
            "^grip of own.urdf cannot be .* from the base ur5e_link0 to .* ur5e_flange",
        ),
        ({}, {"base": "ur5e_link2"}, "^ur5e_joint1, ur5e_joint2 of own.urdf cannot be"),
        (
            {"</robot>": LOOP.format("link2")},
            {},
            "^back, .*joint3, .*joint6 of own.urdf are a l",
        ),
        (
            {"</robot>": LOOP.format("link0")},
            {},
            "joint1, .*, back of own.urdf are a loop",
        ),
        ({}, {"flange": "ur5e_link4"}, "^ur5e_joint5, ur5e_joint6 of own.urdf cannot"),
        ({}, {"base": "ur5e_flange", "flange": "ur5e_link0"}, "1, .*6 of own.urdf can"),
        (
            {},
            {"posture": [0.0] * 5, "joint_names": []},
            "each of the 6 joints of own.urdf, ur5e_joint1, ur5e_.* fixed",
        ),
        ({"<transmission.*?</transmission>": ""}, {}, "joint1, .* a transmission"),
        (
            {r' velocity="[^"]*"': ' velocity="0"'},
            {},
            "the velocity limit of ur5e_joint1",
        ),
        (
            {"</robot>": WORLD},
            {},
            "own.urdf is joined to the world; remove this joint, because ur5e",
        ),
        (
            {"</robot>": '<link name="loose"/></robot>'},
            {},
            "loose is joined neither to ur5e_.* fixed joint",
        ),
        (
            {'<robot name="[^"]*"': '<robot name="eraser"'},
            {},
            "already has a model named eraser, .* <robot> in a URDF",
        ),
        (
            {'<robot name="[^"]*"': '<robot name="whiteboard"'},
            {},
            "already has a model named whiteboard",
        ),
        ({}, {"posture": [9.0, 0, 0, 0, 0, 0]}, "9 for ur5e_joint1, whose range is -6"),
    ],
)
def test_a_model_that_does_not_fit_its_file_is_refused_with_what_to_do(
    tmp_path, changes, fields, message
):
    with pytest.raises(StationError, match=message):
        MakeRobotModel(LoadRobot(_own(tmp_path, changes, **fields)))


def test_a_missing_model_is_named_with_its_folder(tmp_path):
    file = _own(tmp_path, {}, model="urdf/other.urdf")
    with pytest.raises(
        StationError, match=r"^there is no model .*/urdf/other\.urdf; .*Y"
    ):
        MakeRobotModel(LoadRobot(file))


def test_a_model_of_mujoco_is_refused_because_it_has_no_velocity_limits(tmp_path):
    file = _own(tmp_path, {})
    file.write_text(file.read_text().replace("own.urdf", "own.xml"))
    with pytest.raises(
        StationError, match=r"own\.xml is read as MJCF.* \(\.sdf\) file"
    ):
        MakeRobotModel(LoadRobot(file))


def test_a_model_with_macros_is_refused_with_the_command_that_expands_them(tmp_path):
    file = _own(tmp_path, {})
    file.write_text(file.read_text().replace("own.urdf", "own.urdf.xacro"))
    with pytest.raises(StationError, match=r"`xacro own\.urdf\.xacro > own\.urdf`"):
        MakeRobotModel(LoadRobot(file))


def test_warnings_about_a_model_are_logged_once_until_it_changes(
    tmp_path, caplog, capfd
):
    friction = {"(<joint [^>]*revolute[^>]*>)": r'\1<dynamics friction="1"/>'}
    file = _own(tmp_path, friction)

    def warnings():
        caplog.clear()
        MakeRobotModel(LoadRobot(file))
        # Drake's own log, or Python's.
        return (capfd.readouterr().err + caplog.text).count("non-zero joint friction")

    assert warnings() >= 6
    assert warnings() == 0
    _own(tmp_path, friction)
    assert warnings() >= 6


def test_a_file_of_nested_models_is_refused_with_their_names(tmp_path):
    (tmp_path / "two.sdf").write_text(
        '<sdf version="1.9"><model name="cell"><link name="floor"/><model name="arm">'
        '<link name="base"/></model></model></sdf>'
    )
    config = RobotConfig(
        model=f"{tmp_path}/two.sdf", base="b", flange="f", posture=[0.0]
    )
    words = r"^two\.sdf cannot be read: it has 2 models \(cell, cell::arm\); put all"
    with pytest.raises(StationError, match=words):
        MakeRobotModel(config)


def test_error_in_the_file_of_a_robot_names_this_file_only(tmp_path):
    file = _own(tmp_path, {}, max_torque=3.0)
    with pytest.raises(
        StationError, match=r"^own\.yaml is not a robot: .*'max_torque'"
    ):
        LoadScenario("table_top", robot=str(file))


def test_values_of_joints_are_in_their_order_on_the_arm(tmp_path):
    file = _own(tmp_path, {}, reflected_inertia=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    text = (tmp_path / "own.urdf").read_text()
    pattern = r'<joint name="ur5e_joint\d" type.*?</joint>'
    joints = re.findall(pattern, text, re.DOTALL)
    assert len(joints) == 6
    (tmp_path / "own.urdf").write_text(
        re.sub(pattern, lambda _: joints.pop(), text, flags=re.DOTALL)
    )
    plant = MakeRobotModel(LoadRobot(file)).plant
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    inertias = {a.joint().name(): a.default_rotor_inertia() for a in actuators}
    assert [inertias[f"ur5e_joint{i}"] for i in range(1, 7)] == [
        *(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    ]


def test_damping_of_an_own_model_is_read_in_the_order_of_the_joints(tmp_path):
    values = iter("123456")
    file = _own(
        tmp_path, {"(<joint [^>]*revolute[^>]*>)": r'\1<dynamics damping="?"/>'}
    )
    text = (tmp_path / "own.urdf").read_text()
    text = re.sub(r"damping=.\?", lambda _: f'damping="{next(values)}', text)
    (tmp_path / "own.urdf").write_text(text)
    found = joint_damping(MakeRobotModel(LoadRobot(file)).plant)
    assert_allclose(found, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])


def test_misspelled_settings_of_a_robot_and_a_scenario_are_refused():
    config, scenario = LoadRobot("panda"), LoadScenario("table_top")
    config.modle, scenario.tempo = "panda.urdf", 0.5
    with pytest.raises(StationError, match="there is no modle: RobotConfig has descr"):
        AddRobot(MultibodyPlant(time_step=0.001), config)
    with pytest.raises(StationError, match="there is no tempo: Scenario has "):
        AddBoardScene(DiagramBuilder(), scenario, start=[0.0, 0.0, 0.1])


def test_a_finalized_plant_takes_no_robot():
    plant = MultibodyPlant(time_step=0.001)
    plant.Finalize()
    with pytest.raises(StationError, match=r"^the plant is finalized; add the robot"):
        AddRobot(plant, LoadRobot("panda"))


@pytest.mark.parametrize(
    ("robot", "tool", "name"),
    [
        ("panda", None, "panda"),
        ("iiwa14", None, "eraser"),
        ("iiwa14", "spoon", "spoon"),
    ],
)
def test_a_second_model_of_one_name_in_a_plant_is_refused_by_its_name(
    robot, tool, name
):
    plant = MultibodyPlant(time_step=0.001)
    AddRobot(plant, LoadRobot("panda"), tool)
    with pytest.raises(StationError) as caught:
        AddRobot(plant, LoadRobot(robot), tool)
    assert f"the plant already has a model named {name}," in str(caught.value)
    assert "esh" not in str(caught.value)
    second = AddRobot(plant, LoadRobot(robot), tool, model_name_prefix="left")
    assert plant.GetModelInstanceName(second.arm) == f"left::{robot}"


def test_two_arms_of_a_plant_follow_controllers_of_their_own():
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(time_step=0.001))
    robots = []
    for side, y in (("left", 0.6), ("right", -0.6)):
        config = LoadRobot("panda")
        config.base_pose = PoseConfig(translation=[0.0, y, 0.0])
        robots.append(AddRobot(plant, config, model_name_prefix=side))
        assert plant.GetModelInstanceName(robots[-1].tool) == f"{side}::eraser"
        for instance in (robots[-1].arm, robots[-1].tool):  # It bears its own weight.
            plant.set_gravity_enabled(instance, False)
    plant.Finalize()
    targets = []
    for robot, rise in zip(robots, (0.03, -0.03), strict=True):
        model = MakeRobotModel(robot.config)
        (X_WE,) = model.tip_poses([robot.config.posture])
        targets.append(X_WE.translation() + np.array([0.0, 0.0, rise]))
        controller = builder.AddNamedSystem(
            f"{plant.GetModelInstanceName(robot.arm)}_controller",
            OperationalSpaceImpedanceController(
                model.plant,
                end_effector=model.tip,
                X_WT=RigidTransform(),
                config=robot.config.complete(ImpedanceConfig()),
                q_posture=np.array(robot.config.posture),
            ),
        )
        for name, value in {
            "desired_position": targets[-1],
            "desired_orientation": X_WE.rotation().ToQuaternion().wxyz(),
            "desired_velocity": np.zeros(3),
            "desired_acceleration": np.zeros(3),
        }.items():
            source = builder.AddSystem(ConstantVectorSource(value))
            builder.Connect(source.get_output_port(), controller.GetInputPort(name))
        state = plant.get_state_output_port(robot.arm)
        builder.Connect(state, controller.GetInputPort("state"))
        torque = controller.GetOutputPort("torque")
        builder.Connect(torque, plant.get_actuation_input_port(robot.arm))
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    for robot in robots:
        plant.SetPositions(context, robot.arm, robot.config.posture)
    simulator.AdvanceTo(2.0)
    for robot, target in zip(robots, targets, strict=True):
        p_WE = robot.tip.CalcPoseInWorld(context).translation()
        assert_allclose(p_WE, target, atol=2e-3)


def test_a_second_scene_in_a_builder_is_refused():
    builder = DiagramBuilder()
    AddBoardScene(builder, Scenario(), start=[0.0, 0.0, 0.1])
    with pytest.raises(StationError, match=r"a system named plant, .* of its own"):
        AddBoardScene(builder, Scenario(), start=[0.0, 0.0, 0.1])
    builder.Build()  # It still has what it had.


def test_a_name_in_place_of_a_robot_or_a_scenario_is_refused_with_the_expected_type():
    with pytest.raises(StationError, match=r"config is 'panda'; .* RobotConfig"):
        AddRobot(MultibodyPlant(time_step=0.001), "panda")
    with pytest.raises(StationError, match=r"scenario is 'table_top'; .* Scenario"):
        AddBoardScene(DiagramBuilder(), "table_top", start=[0.0, 0.0, 0.1])


def test_meshes_are_found_in_the_package_around_a_model(tmp_path):
    (tmp_path / "urdf").mkdir()
    changes = {"package://fmp_drake/ur5e": "package://my_arm"}
    config = LoadRobot(_own(tmp_path / "urdf", changes))
    with pytest.raises(
        StationError, match=r"unknown package 'my_arm'.* a package\.xml"
    ):
        MakeRobotModel(config, scene_graph=SceneGraph())
    shutil.copytree(models_dir() / "ur5e" / "meshes", tmp_path / "meshes")
    (tmp_path / "package.xml").write_text("<package><name>my_arm</name></package>")
    robot = MakeRobotModel(config, scene_graph=SceneGraph())
    assert robot.plant.num_positions() == 6


def test_a_model_in_a_copy_of_the_package_s_folder_is_read(tmp_path):
    shutil.copy(models_dir() / "package.xml", tmp_path)
    assert MakeRobotModel(LoadRobot(_own(tmp_path, {}))).plant.num_positions() == 6


def test_an_own_model_with_a_fixed_gripper_and_without_its_meshes_is_an_arm(tmp_path):
    changes = {
        "</robot>": FINGER.format("fixed"),
        "package://fmp_drake": "package://other",
    }
    robot = MakeRobotModel(LoadRobot(_own(tmp_path, changes)))
    assert robot.plant.num_positions() == 6


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (
            "base_pose: {xyz: [0, 0, 1]}",
            "base_pose has no key 'xyz'; allowed are: tran",
        ),
        (
            "flanche: here",
            "it has no key 'flanche'; did you mean flange\\? All are: description, model, b",
        ),
        (
            "base_pose: {rpy: [180, 0, 0]}",
            r"base_pose\.rpy\[0\] is 180.0; .*not degrees",
        ),
    ],
)
def test_mistakes_in_a_robot_s_file_are_named(tmp_path, line, reason):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "model: a.urdf\nbase: b\nflange: f\nposture: [0.0]" + f"\n{line}\n",
        encoding="utf-8",
    )
    with pytest.raises(StationError, match=reason):
        LoadRobot(file)
