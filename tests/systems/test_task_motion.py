"""Facts about the motion of a tool over a surface, from a skill's channels and back."""

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SkillError, SystemsError
from fmp_drake.primitives.data.channels import channel_roles
from fmp_drake.systems.surface.surface import Surface, place, rotation
from fmp_drake.systems.task_motion import TaskMotion

XYZ, ROTATION = ("x", "y", "z"), ("rx", "ry", "rz")
REFERENCE = tuple(
    float(q) for q in Rotation.from_euler("xyz", [3.0, 0.1, 0.4]).as_quat()
)
X_WS = RigidTransform(RollPitchYaw(0.2, -0.3, 0.5), [0.5, 0.1, 0.2])
PLANE, PIPE, BOWL = Surface(), Surface(0.0, 1 / 0.3), Surface(-2.5, -2.5)
FRAMES = ("task_frame", "task_frame_velocity", "task_frame_acceleration")


def roles_of(*channels):
    units = {**dict.fromkeys(XYZ, "m"), **dict.fromkeys(ROTATION, "rad"), "force": "N"}
    reference = REFERENCE if "rx" in channels else None
    return channel_roles(
        channels, [units[c] for c in channels], rotation_reference=reference
    )


POSE = roles_of(*XYZ, *ROTATION)
ALL = roles_of(*XYZ, *ROTATION, "force")


def motion_at(t, count):
    """Return smooth channels of a stirring tool, with two derivatives."""
    size = np.array([0.1, 0.08, 0.01, 0.5, 0.4, 0.3, 5.0])[:count]
    rate = np.array([2.0, 3.0, 1.0, 2.5, 1.5, 2.0, 3.0])[:count]
    start = np.array([0.02, -0.05, 0.03, 0.2, -0.3, 0.1, 12.0])[:count]
    sine, cosine = np.sin(rate * t), np.cos(rate * t)
    return np.concatenate(
        [start + size * sine, size * rate * cosine, -size * rate**2 * sine]
    )


def outputs(system, t, **inputs):
    context = system.CreateDefaultContext()
    count = system.GetInputPort("motion").size() // 3
    values = {
        "motion": motion_at(t, count),
        "measured_pose": [1.0, 0, 0, 0, 0, 0, 0],
        "normal_force": [0.0],
        **inputs,
    }
    for name, value in values.items():
        if system.HasInputPort(name):
            system.GetInputPort(name).FixValue(context, value)
    desired = system.GetOutputPort("desired").Eval(context)
    parts = np.split(desired, np.cumsum([*system.parts.values()])[:-1])
    measured = system.GetOutputPort("measured").Eval(context)
    return {**dict(zip(system.parts, parts, strict=True)), "measured": measured}


def pose_of(wxyz_and_p):
    wxyz = np.array(wxyz_and_p[:4])
    return RigidTransform(
        RotationMatrix(Quaternion(wxyz / np.linalg.norm(wxyz))), wxyz_and_p[4:]
    )


def tool_in_world(values):
    """Return X_WE, from outputs of a TaskMotion with orientation."""
    X_TE = pose_of([*values["desired_orientation"], *values["desired_position"]])
    return pose_of(values["task_frame"]) @ X_TE


def test_parts_follow_the_roles_and_the_surface():
    motion = ["desired_position", "desired_velocity", "desired_acceleration"]
    turning = [
        "desired_orientation",
        "desired_angular_velocity",
        "desired_angular_acceleration",
    ]
    for roles, surface, expected in (
        (roles_of(*XYZ), PLANE, [*motion, "measured"]),
        (roles_of(*XYZ, "force"), PLANE, [*motion, "desired_normal_force", "measured"]),
        (POSE, PLANE, [*motion, *turning, "measured"]),
        (roles_of(*XYZ), PIPE, [*motion, *FRAMES, "measured"]),
        (ALL, BOWL, [*motion, *turning, "desired_normal_force", *FRAMES, "measured"]),
    ):
        system = TaskMotion(roles, surface, X_WS=X_WS)
        assert list(outputs(system, 0.0)) == expected
        assert system.GetOutputPort("desired").size() == sum(system.parts.values())
        assert system.GetOutputPort("measured").size() == roles.count


def test_desired_outputs_do_not_depend_on_measurements():
    system = TaskMotion(ALL, PIPE, X_WS=X_WS)
    pose = system.GetInputPort("measured_pose").get_index()
    for name in ("desired", "measured"):
        port = system.GetOutputPort(name).get_index()
        assert system.HasDirectFeedthrough(pose, port) == (name == "measured")


def test_outputs_are_the_same_without_caching():
    system = TaskMotion(ALL, BOWL, X_WS=X_WS)
    context = system.CreateDefaultContext()
    context.DisableCaching()
    system.GetInputPort("motion").FixValue(context, motion_at(0.3, 7))
    expected = [part for n, part in outputs(system, 0.3).items() if n != "measured"]
    desired = system.GetOutputPort("desired").Eval(context)
    np.testing.assert_array_equal(desired, np.concatenate(expected))


def test_plane_passes_positions_and_rotations_of_the_skill():
    values = outputs(TaskMotion(POSE, PLANE, X_WS=X_WS), 0.7)
    motion = motion_at(0.7, 6)
    np.testing.assert_array_equal(values["desired_position"], motion[:3])
    np.testing.assert_array_equal(values["desired_acceleration"], motion[12:15])
    expected = Rotation.from_rotvec(motion[3:6]) * Rotation.from_quat(REFERENCE)
    actual = Rotation.from_quat(values["desired_orientation"], scalar_first=True)
    assert (actual * expected.inv()).magnitude() < 1e-12


@pytest.mark.parametrize("surface", [PIPE, BOWL], ids=["pipe", "bowl"])
def test_pose_over_the_surface_follows_from_the_channels(surface):
    values = outputs(TaskMotion(POSE, surface, X_WS=X_WS), 0.7)
    motion = motion_at(0.7, 6)
    p_SE = place(surface, motion[None, :3])[0]
    X_WE = tool_in_world(values)
    np.testing.assert_allclose(X_WE.translation(), X_WS @ p_SE, atol=1e-12)
    local = Rotation.from_rotvec(motion[3:6]) * Rotation.from_quat(REFERENCE)
    R_WE = X_WS.rotation().matrix() @ rotation(surface, *motion[:2]) @ local.as_matrix()
    np.testing.assert_allclose(X_WE.rotation().matrix(), R_WE, atol=1e-12)


def moving_surface(t):
    """Return inputs of a surface that turns and slides."""
    turn = np.array([0.1, 0.3, 0.2])
    R = Rotation.from_rotvec(turn * np.sin(t)).as_matrix() @ X_WS.rotation().matrix()
    p = np.array([0.5, 0.1, 0.2]) + 0.1 * np.sin(2 * t) * np.array([1.0, 0.5, 0.0])
    return {
        "surface_frame": [*RotationMatrix(R).ToQuaternion().wxyz(), *p],
        "surface_frame_velocity": [
            *turn * np.cos(t), *0.2 * np.cos(2 * t) * np.array([1.0, 0.5, 0.0])
        ],
        "surface_frame_acceleration": [
            *-turn * np.sin(t), *-0.4 * np.sin(2 * t) * np.array([1.0, 0.5, 0.0])
        ],
    }  # fmt: skip


@pytest.mark.parametrize("surface", [PLANE, PIPE, BOWL], ids=["plane", "pipe", "bowl"])
@pytest.mark.parametrize("is_moving", [False, True], ids=["still", "moving"])
def test_velocities_and_accelerations_are_derivatives(surface, is_moving):
    if surface is PLANE and not is_moving:
        return
    system = TaskMotion(ALL, surface, X_WS=X_WS, is_moving=is_moving)

    def at(t):
        return outputs(system, t, **(moving_surface(t) if is_moving else {}))

    step, t = 1e-5, 0.6
    before, now, after = at(t - step), at(t), at(t + step)
    X, Y = (pose_of(each["task_frame"]) for each in (before, after))
    V = now["task_frame_velocity"]
    np.testing.assert_allclose(
        (Y.translation() - X.translation()) / (2 * step), V[3:], atol=1e-7
    )
    R = Rotation.from_matrix(Y.rotation().matrix() @ X.rotation().matrix().T)
    np.testing.assert_allclose(R.as_rotvec() / (2 * step), V[:3], atol=1e-7)
    change = after["task_frame_velocity"] - before["task_frame_velocity"]
    np.testing.assert_allclose(
        change / (2 * step), now["task_frame_acceleration"], atol=1e-6
    )
    turned = [
        Rotation.from_quat(each["desired_orientation"], scalar_first=True)
        for each in (before, after)
    ]
    np.testing.assert_allclose(
        (turned[1] * turned[0].inv()).as_rotvec() / (2 * step),
        now["desired_angular_velocity"],
        atol=1e-7,
    )
    change = after["desired_angular_velocity"] - before["desired_angular_velocity"]
    np.testing.assert_allclose(
        change / (2 * step), now["desired_angular_acceleration"], atol=1e-6
    )


@pytest.mark.parametrize("surface", [PLANE, PIPE, BOWL], ids=["plane", "pipe", "bowl"])
def test_a_tool_at_its_target_is_measured_there(surface):
    system = TaskMotion(ALL, surface, X_WS=X_WS)
    now = outputs(system, 0.4)
    pose = [*now["desired_orientation"], *now["desired_position"]]
    measured = outputs(system, 0.4, measured_pose=pose, normal_force=[7.0])["measured"]
    np.testing.assert_allclose(measured[:6], motion_at(0.4, 7)[:6], atol=1e-12)
    assert measured[6] == 7.0


def test_a_tool_beside_its_target_is_measured_along_the_pipe_and_against_its_normal():
    system = TaskMotion(POSE, PIPE, X_WS=X_WS)
    other = np.array([0.07, 0.06, 0.02, 0.3, -0.2, 0.1])
    target = pose_of(outputs(system, 0.4)["task_frame"])
    X_WE = tool_in_world(outputs(system, 0.0, motion=[*other, *np.zeros(12)]))
    X_TE = target.inverse() @ X_WE
    pose = [*X_TE.rotation().ToQuaternion().wxyz(), *X_TE.translation()]
    measured = outputs(system, 0.4, measured_pose=pose)["measured"]
    np.testing.assert_allclose(measured, other, atol=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_measured_rotation_is_continuous_beyond_half_a_turn(sign):
    motion = np.zeros(18)
    motion[3:6] = sign * np.array([0.0, 0.0, 3.6])
    system = TaskMotion(POSE, PLANE, X_WS=X_WS)
    pose = [*outputs(system, 0, motion=motion)["desired_orientation"], 0, 0, 0]
    # The quaternion's sign means nothing.
    for each in (pose, [-q for q in pose]):
        measured = outputs(system, 0, motion=motion, measured_pose=each)["measured"]
        np.testing.assert_allclose(measured[3:], motion[3:6], atol=1e-9)


def test_desired_force_is_never_negative():
    roles = roles_of(*XYZ, "force")
    motion = np.zeros(12)
    for force, expected in ((8.0, 8.0), (-3.0, 0.0)):
        motion[3] = force
        values = outputs(TaskMotion(roles, PLANE, X_WS=X_WS), 0, motion=motion)
        assert values["desired_normal_force"] == [expected]


@pytest.mark.parametrize(
    ("channels", "units", "words"),
    [
        (("x", "y"), ("m", "m"), "needs z"),
        (("x", "y", "z", "grip"), ("m", "m", "m", "1"), "channel grip has no role"),
        (("x", "y", "z"), ("m", "mm", "m"), "channel y is in mm; expected m"),
        ((*XYZ, "rx"), ("m", "m", "m", "rad"), "expected rx, ry and rz"),
        ((*XYZ, *ROTATION), ("m",) * 3 + ("rad",) * 3, "with their reference"),
    ],
)
def test_channels_without_a_role_are_refused(channels, units, words):
    with pytest.raises(SkillError, match=words):
        channel_roles(channels, units)


def test_roles_are_found_in_any_order():
    roles = channel_roles(
        ("force", "z", "rz", "y", "ry", "x", "rx"),
        ("N", "m", "rad", "m", "rad", "m", "rad"),
        rotation_reference=REFERENCE,
    )
    assert (roles.position, roles.rotation, roles.force) == ((5, 3, 1), (6, 4, 2), 0)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"roles": None}, "roles is None; its type must be ChannelRoles"),
        ({"surface": (0.0, 0.0)}, r"surface is .* its type must be Surface"),
        ({"X_WS": np.eye(4)}, "X_WS is array.* its type must be RigidTransform"),
    ],
)
def test_an_argument_of_another_type_is_refused(wrong, words):
    arguments = {"roles": POSE, "surface": Surface(0.0, 0.0), "X_WS": X_WS}
    with pytest.raises(SystemsError, match=words):
        TaskMotion(**arguments | wrong)


@pytest.mark.parametrize("surface", [Surface(2.0, 3.0), Surface(np.nan, 0.0)])
def test_a_surface_of_no_known_kind_is_refused(surface):
    with pytest.raises(SystemsError, match=r"one to be 0 \(a cylinder\)"):
        TaskMotion(POSE, surface, X_WS=X_WS)
