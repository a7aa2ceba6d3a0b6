"""Facts about recordings of a Panda's joints."""

import shlex

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.multibody.plant import MultibodyPlant
from recorded_files import JOINTS, TIME

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import Demonstration
from fmp_drake.skills import EraserPath, RobotJoints
from fmp_drake.skills.placement import lay_on_board
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


def forward(q):
    pose = np.eye(4)
    for angle, (a, d, alpha) in zip(q, LINKS, strict=True):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        pose = pose @ [
            [c, -s, 0, a],
            [s * ca, c * ca, -sa, -d * sa],
            [s * sa, c * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
    return (pose @ [0, 0, FELT, 1])[:3]


def recorded(values=JOINTS, name="panda_joint{}", first=1, extra=()):
    channels = [name.format(i) for i in range(first, first + 7)]
    return Demonstration(
        time=TIME,
        values=np.column_stack([values, np.zeros((len(TIME), len(extra)))]),
        channels=(*channels, *extra),
        units=("rad",) * (7 + len(extra)),
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
    ],
)
def test_joints_are_known_by_their_names(name, first):
    expected = [name.format(i) for i in range(first, first + 7)]
    assert RobotJoints(recorded(name=name, first=first)) == expected


@pytest.mark.parametrize("name", ["iiwa_joint_{}", "motor{}"])
def test_joints_of_other_robots_are_not_taken_for_a_panda_s(name):
    assert RobotJoints(recorded(name=name)) == []
    with pytest.raises(DemonstrationError, match="are no Panda's joints"):
        EraserPath(recorded(name=name))


def test_angles_that_a_panda_cannot_have_are_refused():
    with pytest.raises(
        DemonstrationError, match=r"q2 is -45.8 .* from -1\.76 to 1\.76 rad"
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
    _, remarks = lay_on_board(
        recording, scenario=Scenario(robot=robot), transform=[0.0] * 6
    )
    assert f"by a {robot}'s kinematics" in remarks[0]


def test_joints_of_another_robot_are_refused_with_its_name():
    recording, _ = of_robot("ur5e", tuple(UR_JOINTS))
    with pytest.raises(DemonstrationError, match=r"a ur5e\? Name it: --robot ur5e$"):
        lay_on_board(recording, scenario=Scenario())


def test_joints_in_the_order_of_the_alphabet_are_put_in_theirs():
    recording, path = of_robot("ur5e", tuple(UR_JOINTS))
    mixed = recording.select(sorted(UR_JOINTS))
    assert_allclose(EraserPath(mixed, robot="ur5e").values, path, atol=1e-9)


def test_a_panda_s_joints_stay_a_panda_s_for_another_robot():
    scenario = Scenario(robot="iiwa14")
    assert RobotJoints(recorded(), robot="iiwa14") == []
    placed_recording, remarks = lay_on_board(
        recorded(), scenario=scenario, transform=[0.0] * 6
    )
    assert "by a Panda's kinematics" in remarks[0]
    assert placed_recording.channels == ("x", "y", "z")


def test_angles_that_a_named_robot_cannot_have_are_refused():
    names = tuple(f"iiwa_joint_{i}" for i in range(1, 8))
    recording, _ = of_robot("iiwa14", names, swing=3.0)
    with pytest.raises(DemonstrationError, match="a iiwa14's joint"):
        EraserPath(recording, robot="iiwa14")
    with pytest.raises(DemonstrationError, match="are no ur5e's joints"):
        EraserPath(recording, robot="ur5e")
