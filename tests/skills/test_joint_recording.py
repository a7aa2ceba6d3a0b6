"""Facts about recordings of joint angles."""

import shlex

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.multibody.plant import MultibodyPlant
from recorded_files import JOINTS, TIME
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import Demonstration, ReadingOptions
from fmp_drake.primitives.data.channels import FORCE_COMPONENTS, ROTATION_CHANNELS
from fmp_drake.primitives.data.orientation import rotations_of
from fmp_drake.skills import EraserPath, RobotJoints
from fmp_drake.skills.loading import load_as_recorded
from fmp_drake.skills.placement import place_on_board
from fmp_drake.station import AddRobot, LoadRobot, Scenario

# Denavit and Hartenberg's parameters (Craig) as Franka publishes them: a, d, alpha.
LINKS = (
    (0, 0.333, 0),
    (0, 0, -np.pi / 2),
    (0, 0.316, np.pi / 2),
    (0.0825, 0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0, 0, np.pi / 2),
    (0.088, 0, np.pi / 2),
)
FELT = 0.107 + 0.100  # From the seventh joint to the flange, to the felt, m.


def pose_of(q):
    pose = np.eye(4)
    for angle, (a, d, alpha) in zip(q, LINKS, strict=True):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        pose = pose @ [
            [c, -s, 0, a],
            [s * ca, c * ca, -sa, -d * sa],
            [s * sa, c * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
    return pose


def forward(q):
    return (pose_of(q) @ [0, 0, FELT, 1])[:3]


def turning(folder, order, joints=JOINTS, time=TIME, **given):
    """Read a file of joints, positions and quaternions; return it and the orientations."""
    base, tool = Rotation.random(2, random_state=3)
    poses = np.array([pose_of(q) for q in joints])
    turns = base * Rotation.from_matrix(poses[:, :3, :3]) * tool
    quaternions = turns.as_quat()[:, ["xyzw".index(axis) for axis in order]]
    file = folder / "d.npz"
    np.savez(
        file, time=time, position=poses[:, :3, 3], quaternion=quaternions, joints=joints
    )
    reading = ReadingOptions(all_arrays=True, **given)
    (found,), remarks = load_as_recorded([file], stretch=1.0, reading=reading)
    vectors = found.select(["rx", "ry", "rz"]).values
    return rotations_of(vectors, found.rotation_reference), turns, " ".join(remarks)


@pytest.mark.parametrize(("order", "every"), [("xyzw", 1), ("wxyz", 1), ("wxyz", 4)])
def test_joints_tell_the_order_of_quaternions(order, every, tmp_path):
    found, truth, remarks = turning(tmp_path, order, JOINTS[::every], TIME[::every])
    assert np.max((found.inv() * truth).magnitude()) < 1e-6
    assert ("agrees with the recorded joints of panda" in remarks) == (order == "wxyz")


def test_order_of_quaternions_that_is_given_is_kept(tmp_path):
    found, truth, remarks = turning(tmp_path, "wxyz", quaternions="xyzw")
    assert np.max((found.inv() * truth).magnitude()) > 0.5
    assert "the orientation disagrees with the recorded joints of panda" in remarks


@pytest.mark.parametrize("is_swapped", [True, False])
def test_named_columns_of_a_quaternion_are_kept_where_joints_disagree(
    is_swapped, tmp_path
):
    _, truth, _ = turning(tmp_path, "xyzw")
    names = ["qw", "qx", "qy", "qz"] if is_swapped else ["qx", "qy", "qz", "qw"]
    columns = dict(zip(names, truth.as_quat().T, strict=True))
    joints = {f"panda_joint{i + 1}": q for i, q in enumerate(JOINTS.T)}
    file = tmp_path / "named.npz"
    np.savez(file, time=TIME, **columns, **joints)
    (found,), remarks = load_as_recorded([file], stretch=1.0)
    vectors = found.select(["rx", "ry", "rz"]).values
    recorded = rotations_of(vectors, found.rotation_reference)
    expected = Rotation.from_quat(
        np.column_stack([columns[name] for name in ("qx", "qy", "qz", "qw")])
    )
    assert np.max((recorded.inv() * expected).magnitude()) < 1e-6
    remarks = " ".join(remarks)
    assert "read as w, x, y, z" not in remarks
    assert ("check the names of its columns" in remarks) == is_swapped


def test_a_turn_about_one_axis_does_not_tell_the_order_of_quaternions(tmp_path):
    joints = np.tile(JOINTS[0], (len(TIME), 1))
    joints[:, 6] = JOINTS[:, 6]
    _, _, remarks = turning(tmp_path, "wxyz", joints)
    assert "agrees with" not in remarks
    assert "read as x, y, z, w; if it is w, x, y, z" in remarks


def recorded(values=JOINTS, name="panda_joint{}", first=1, extra=(), count=7):
    channels = [name.format(i) for i in range(first, first + count)]
    return Demonstration(
        time=TIME,
        values=np.column_stack([values, np.zeros((len(TIME), len(extra)))]),
        channels=(*channels, *extra),
        units=("rad",) * (count + len(extra)),
    )


def test_path_is_that_of_the_published_kinematics():
    path = EraserPath(recorded(extra=("panda_finger_joint1",)))
    assert path.channels == ("x", "y", "z")
    assert path.frame == "panda_link0"
    assert_allclose(path.values, [forward(q) for q in JOINTS], atol=1e-9)
    assert np.array_equal(path.time, TIME)


@pytest.mark.parametrize(
    ("name", "first"),
    [
        ("panda_joint{}", 1),
        ("fr3_joint{}", 1),
        ("joint_{}", 0),
        ("q{}", 1),
        ("joint_{}.pos", 0),
        ("joint_positions_{}", 1),
        ("robot0_joint_pos_{}", 1),
        ("state.q[{}]", 0),
        ("joint{}_angle", 1),
        ("panda_joint{}/position", 1),
        ("observation.qpos_{}", 1),
        ("panda_joint{}_deg", 1),
        ("joint_{}_pos_in_rad", 0),
    ],
)
def test_joints_are_known_by_their_names(name, first):
    expected = [name.format(i) for i in range(first, first + 7)]
    assert RobotJoints(recorded(name=name, first=first)) == expected


@pytest.mark.parametrize("name", ["iiwa_joint_{}", "motor{}"])
def test_joints_with_the_names_of_other_robots_are_not_those_of_a_panda(name):
    assert RobotJoints(recorded(name=name)) == []
    with pytest.raises(DemonstrationError, match="are not the joints of panda"):
        EraserPath(recorded(name=name))


def test_angles_that_a_panda_cannot_have_are_refused():
    with pytest.raises(
        DemonstrationError,
        match=r"q2 is -45.8 .* joint 2 of panda is limited to -1\.76 to 1\.76 rad",
    ):
        EraserPath(recorded(values=np.rad2deg(JOINTS), name="q{}"))


def test_degrees_are_recognised_and_the_option_for_them_is_given():
    with pytest.raises(DemonstrationError, match="Degrees") as refusal:
        EraserPath(recorded(values=np.rad2deg(JOINTS), name="q{}"))
    (option,) = shlex.split(str(refusal.value).partition("--columns ")[2])
    assert option == ",".join(f"q{i}=q{i} [deg]" for i in range(1, 8))


UR_JOINTS = [
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *(f"wrist_{i}_joint" for i in (1, 2, 3)),
]


def of_robot(robot, names, *, swing=0.3):
    """Return joint angles about a robot's posture, and the tip's path by its plant."""
    plant = MultibodyPlant(time_step=0.0)
    model = AddRobot(plant, LoadRobot(robot))
    plant.Finalize()
    time = np.arange(0, 10, 0.05)
    posture = np.array(LoadRobot(robot).posture)
    angles = posture + swing * np.sin(time[:, None] + np.arange(len(posture)))
    context, path = plant.CreateDefaultContext(), []
    for q in angles:
        plant.SetPositions(context, q)
        path.append(model.tip.CalcPoseInWorld(context).translation())
    recording = Demonstration(
        time=time, values=angles, channels=names, units=("rad",) * len(names)
    )
    return recording, np.array(path)


@pytest.mark.parametrize(
    ("robot", "names"),
    [
        ("iiwa14", [f"iiwa_joint_{i}" for i in range(1, 8)]),
        ("iiwa14", [f"joints_{i}" for i in range(1, 8)]),
        ("ur5e", [f"ur5e_joint{i}" for i in range(1, 7)]),
        ("ur5e", [f"q{i}" for i in range(6)]),
        ("ur5e", [f"actual_q_{i}" for i in range(6)]),
        ("ur5e", UR_JOINTS),
        ("ur5e", [f"left_{name}" for name in UR_JOINTS]),
    ],
)
def test_joints_of_a_named_robot_give_its_eraser_s_path(robot, names):
    recording, path = of_robot(robot, tuple(names))
    assert RobotJoints(recording, robot=robot) == names
    assert_allclose(EraserPath(recording, robot=robot).values, path, atol=1e-9)
    _, remarks = place_on_board(
        recording, scenario=Scenario(robot=robot), transform=[0.0] * 6
    )
    assert f"by the forward kinematics of {robot}," in remarks[0]


@pytest.mark.parametrize(
    ("robot", "names"),
    [
        ("ur5e", UR_JOINTS),
        ("iiwa14", [f"iiwa14_joint{i}" for i in range(1, 8)]),
        ("iiwa14", [f"iiwa_joint_{i}" for i in range(1, 8)]),
        ("iiwa14", [f"lbr_A{i}" for i in range(1, 8)]),
        ("panda", [f"fr3_joint{i}" for i in range(1, 8)]),
    ],
)
def test_a_robot_of_the_package_is_found_by_the_names_of_its_joints(robot, names):
    recording, _ = of_robot(robot, tuple(names))
    for other in ("panda", "iiwa14", "ur5e"):
        _, remarks = place_on_board(
            recording, scenario=Scenario(robot=other), transform=[0.0] * 6
        )
        assert f"by the forward kinematics of {robot}," in remarks[0]


@pytest.mark.parametrize(
    ("count", "robot", "advice"),
    [
        (6, "panda", r"Joints of ur5e\? Name it: --robot ur5e$"),
        (7, "ur5e", r"Joints of iiwa14 or panda\? Name it: --robot iiwa14$"),
    ],
)
def test_numbered_joints_of_another_robot_are_refused_with_its_name(
    count, robot, advice
):
    recording = recorded(JOINTS[:, :count], name="q{}", count=count)
    with pytest.raises(DemonstrationError, match=advice):
        place_on_board(recording, scenario=Scenario(robot=robot))


@pytest.mark.parametrize(
    ("before", "other", "first"),
    [
        ("left", "right", ""),
        ("actual", "target", "actual_q1"),
        ("pos", "vel", "pos_q1"),
    ],
)
def test_only_one_arm_s_measured_joints_are_taken(before, other, first):
    names = [f"{word}_q{i}" for word in (before, other) for i in range(1, 8)]
    for order in (names, names[7:] + names[:7]):
        recording = Demonstration(
            time=np.arange(4.0),
            values=np.zeros((4, 14)),
            channels=order,
            units=("rad",) * 14,
        )
        assert RobotJoints(recording, robot="iiwa14")[:1] == ([first] if first else [])


def test_joints_in_the_order_of_the_alphabet_are_put_in_theirs():
    recording, path = of_robot("ur5e", tuple(UR_JOINTS))
    mixed = recording.select(sorted(UR_JOINTS))
    assert_allclose(EraserPath(mixed, robot="ur5e").values, path, atol=1e-9)


def test_joints_with_the_names_of_a_panda_are_not_those_of_another_robot():
    scenario = Scenario(robot="iiwa14")
    assert RobotJoints(recorded(), robot="iiwa14") == []
    assert RobotJoints(recorded(name="arm_fr3_joint{}"), robot="iiwa14") == []
    placed_recording, remarks = place_on_board(
        recorded(), scenario=scenario, transform=[0.0] * 6
    )
    assert "by the forward kinematics of panda," in remarks[0]
    assert placed_recording.channels == ("x", "y", "z")


def test_angles_that_a_named_robot_cannot_have_are_refused():
    names = tuple(f"iiwa_joint_{i}" for i in range(1, 8))
    recording, _ = of_robot("iiwa14", names, swing=3.0)
    with pytest.raises(DemonstrationError, match="of iiwa14 is limited to"):
        EraserPath(recording, robot="iiwa14")
    with pytest.raises(DemonstrationError, match="are not the joints of ur5e"):
        EraserPath(recording, robot="ur5e")


def test_a_recorded_force_is_kept_beside_the_path_of_the_joints():
    time = np.arange(4) / 20
    posture = [0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4]
    forces = np.outer(time, [1.0, 2.0, 3.0])
    joints = Demonstration(
        time=time,
        values=np.hstack([np.tile(posture, (4, 1)), forces]),
        channels=(*(f"panda_joint{i}" for i in range(1, 8)), *FORCE_COMPONENTS),
        units=("rad",) * 7 + ("N",) * 3,
    )
    path = EraserPath(joints, with_orientation=True)
    assert path.channels == ("x", "y", "z", *FORCE_COMPONENTS, *ROTATION_CHANNELS)
    np.testing.assert_array_equal(path.select(FORCE_COMPONENTS).values, forces)
