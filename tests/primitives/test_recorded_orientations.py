"""Facts about orientations and normal forces in files: read as they are meant, or refused."""

import re
import shlex

import numpy as np
import pytest
import recorded_files as files
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation, Slerp

from fmp_drake.errors import FmpError
from fmp_drake.primitives import ReadingOptions, read_demonstrations
from fmp_drake.primitives.data.orientation import rotations_of

ROLL, PITCH, YAW = (
    np.pi + 0.4 * np.sin(2 * files.TIME),
    0.3 * np.cos(files.TIME),
    0.5 + 0.6 * np.sin(files.TIME),
)
# As Drake's RollPitchYaw.
TURNS = (
    Rotation.from_rotvec(np.outer(YAW, [0, 0, 1]))
    * Rotation.from_rotvec(np.outer(PITCH, [0, 1, 0]))
    * Rotation.from_rotvec(np.outer(ROLL, [1, 0, 0]))
)
RADIANS = np.column_stack([(ROLL + np.pi) % (2 * np.pi) - np.pi, PITCH, YAW])
DEGREES = np.rad2deg(RADIANS)
QUATERNIONS = TURNS.as_quat()


def table(folder, *columns, header):
    """Write a table of time, x, y, z and other columns."""
    text = files.lines(
        files.TIME,
        *files.PATH.T,
        *(column for array in columns for column in np.atleast_2d(array.T)),
        header=f"time,{header}",
    )
    return files.write(folder, text).path


def read(path, columns="", **given):
    (found,), remarks = read_demonstrations(
        [path], ReadingOptions.parse(columns, **given)
    )
    return found, " ".join(remarks)


def option_in(text):
    """Return the value of the option that a message advises."""
    return shlex.split(re.search(r"--columns ('[^']*'|[^\s;)]*)", text)[0])[1]


def assert_pose(found, turns=TURNS):
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)
    vectors = found.select(["rx", "ry", "rz"]).values
    recorded = rotations_of(vectors, found.rotation_reference)
    assert np.max((recorded * turns.inv()).magnitude()) < 1e-6


@pytest.mark.parametrize(
    ("header", "angles", "columns"),
    [
        ("x,y,z,roll,pitch,yaw", RADIANS, ""),
        ("x,y,z,yaw,pitch,roll", RADIANS[:, ::-1], ""),
        ("x,y,z,roll,pitch,yaw", DEGREES, ""),
        ("x,y,z,Roll [deg],Pitch [deg],Yaw [deg]", DEGREES, ""),
        ("x,y,z,roll_deg,pitch_deg,yaw_deg", DEGREES, ""),
        ("tcp_x,tcp_y,tcp_z,tcp_roll,tcp_pitch,tcp_yaw", RADIANS, ""),
        ("c.pos.x,c.pos.y,c.pos.z,c.rpy.roll,c.rpy.pitch,c.rpy.yaw", RADIANS, ""),
        ("X,Y,Z,A,B,C", DEGREES[:, ::-1], ""),
        ("X,Y,Z,A [rad],B [rad],C [rad]", RADIANS[:, ::-1], ""),
        ("act_X,act_Y,act_Z,act_A,act_B,act_C", DEGREES[:, ::-1], ""),
        ("X,Y,Z,W,P,R", DEGREES, ""),
        ("pos.x,pos.y,pos.z,pos.w,pos.p,pos.r", DEGREES, ""),
        ("x,y,z,u,v,w", DEGREES, "roll=u,pitch=v,yaw=w"),
        ("x,y,z,u,v,w", RADIANS, "roll=5,pitch=6,yaw=7"),
        ("x,y,z,u,v,w", DEGREES, "roll=u [deg],pitch=v [deg],yaw=w [deg]"),
        ("x,y,z,A,B,C", RADIANS[:, ::-1], "roll=C [rad],pitch=B [rad],yaw=A [rad]"),
        ("x,y,z,A,B,C", RADIANS[:, ::-1], ""),  # It jumps by 2 pi.
    ],
)
def test_euler_angles_are_an_orientation(header, angles, columns, tmp_path):
    found, remarks = read(table(tmp_path, angles, header=header), columns)
    assert found.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert_pose(found)
    assert "read as Euler angles, R = Rz(yaw) Ry(pitch) Rx(roll)" in remarks


@pytest.mark.parametrize("revolution", [360.0, 2 * np.pi])
@pytest.mark.parametrize("least", [0.0, -0.5])
def test_slower_angles_that_jump_by_a_revolution_are_interpolated(
    revolution, least, tmp_path
):
    angles = (RADIANS[:, ::-1] / (2 * np.pi) - least) % 1 + least
    angles[np.arange(400) % 4 > 0] = np.nan
    path = table(tmp_path, revolution * angles, header="x,y,z,A,B,C")
    found, remarks = read(path)
    assert "yaw, pitch, roll interpolated at the times of the position" in remarks
    vectors = found.select(["rx", "ry", "rz"]).values
    recorded = rotations_of(vectors, found.rotation_reference)
    turns = TURNS[: len(recorded)]
    assert np.max((recorded * turns.inv()).magnitude()) < 2e-3


@pytest.mark.parametrize(
    ("header", "largest", "unit"),
    [
        ("x,y,z,roll,pitch,yaw", 6.28, "radians"),
        ("x,y,z,roll,pitch,yaw", 6.5, "degrees"),
        ("x,y,z,C,B,A", 6.28, "radians"),
    ],
)
def test_unit_of_euler_angles_that_is_assumed_is_reported(
    header, largest, unit, tmp_path
):
    angles = np.zeros((400, 3))
    angles[:, 0] = largest - 0.3 * np.sin(files.TIME) ** 2
    found, remarks = read(table(tmp_path, angles, header=header))
    assert f"reach {largest} and are taken for {unit}" in remarks
    factor = np.pi / 180 if unit == "degrees" else 1.0
    assert_pose(found, Rotation.from_rotvec(factor * angles))
    other = "rad" if unit == "degrees" else "deg"
    assert f"{header.split(',')[3]} [{other}]" in remarks
    stated = ",".join(
        name + f" [{other}]" * (name not in "xyz") for name in header.split(",")
    )
    found, remarks = read(table(tmp_path, angles, header=stated))
    factor = np.pi / 180 if other == "deg" else 1.0
    assert_pose(found, Rotation.from_rotvec(factor * angles))
    assert "are taken for" not in remarks


@pytest.mark.parametrize("by_rows", [True, False])
def test_a_matrix_of_qualisys_is_by_columns_unless_its_angles_contradict(
    by_rows, tmp_path
):
    found, _ = read(files.qualisys_bodies(tmp_path, TURNS, by_rows=by_rows).path)
    assert_pose(found)


@pytest.mark.parametrize("body", ["", "tcp_"])
def test_an_array_of_roll_pitch_and_yaw_is_an_orientation(body, tmp_path):
    path = tmp_path / "d.npz"
    arrays = {f"{body}pos": files.PATH, f"{body}rpy": RADIANS}
    np.savez(path, t=files.TIME, **arrays)
    found, _ = read(path)
    assert_pose(found)


@pytest.mark.parametrize(
    "header",
    [
        "x,y,z,shoulder_roll,shoulder_pitch,shoulder_yaw",
        "u,v,w,a,b,c",
        "u,v,q,w,p,r",
        "x,y,z,p,q,r",
        "x,y,z,k_a,k_b,k_c",
        "x,y,z,roll,pitch,heading",
    ],
)
def test_other_angles_are_no_orientation(header, tmp_path):
    found, _ = read(table(tmp_path, RADIANS, header=header))
    assert found.channels == tuple(header.split(","))
    assert found.rotation_reference is None


@pytest.mark.parametrize("letters", ["A,B,C", "W,P,R"])
@pytest.mark.parametrize("unit", ["m", "mm", "mm in the header", "mm by option"])
def test_small_angles_of_a_controller_are_degrees_beside_millimetres(
    unit, letters, tmp_path
):
    angles = np.sin(files.TIME)[:, None] * [1, 0, 0]
    names = "x [mm],y [mm],z [mm]" if "header" in unit else "x,y,z"
    scale = 1.0 if unit == "m" else 1e3
    columns = (files.TIME, *(scale * files.PATH).T, *angles.T)
    text = files.lines(*columns, header=f"time,{names},{letters}")
    given = {"unit": "mm"} if "option" in unit else {}
    found, remark = read(files.write(tmp_path, text).path, **given)
    kind = "radians" if unit == "m" else "degrees"
    assert f"{letters.replace(',', ', ')} reach 1 and are taken for {kind}" in remark
    turns = rotations_of(
        found.select(["rx", "ry", "rz"]).values, found.rotation_reference
    )
    largest = 1.0 if unit == "m" else np.deg2rad(1.0)
    assert np.max(turns.magnitude()) == pytest.approx(largest, rel=1e-3)


@pytest.mark.parametrize(
    ("unit", "largest", "is_kuka"),
    [("", 359.0, True), ("", 361.0, False), (" [V]", 90.0, False)],
)
def test_columns_a_b_c_are_angles_unless_too_large_or_in_another_unit(
    unit, largest, is_kuka, tmp_path
):
    angles = np.zeros((400, 3))
    angles[:, 0] = largest - np.sin(files.TIME) ** 2
    header = "x,y,z," + ",".join(f"{name}{unit}" for name in "abc")
    found, _ = read(table(tmp_path, angles, header=header))
    assert ("rx" in found.channels) == is_kuka
    assert ("a" in found.channels) != is_kuka


@pytest.mark.parametrize(
    ("header", "angles", "reason"),
    [
        ("rx [deg],ry [deg],rz [deg]", DEGREES, "are in degrees"),
        ("rx_deg,ry_deg,rz_deg", DEGREES, "are in degrees"),
        ("Rx,Ry,Rz", DEGREES, "reach 190"),
        ("rx,ry,rz", DEGREES, "reach 190"),
    ],
)
def test_rotation_vectors_in_degrees_are_not_read_and_the_option_that_works_is_told(
    header, angles, reason, tmp_path
):
    path = table(tmp_path, angles, header=f"x,y,z,{header}")
    found, remarks = read(path)
    assert found.rotation_reference is None
    assert f"{reason} and are left out" in remarks
    assert_pose(read(path, option_in(remarks))[0])


@pytest.mark.parametrize(
    ("length", "unit", "is_read"),
    [(6.3, "", True), (6.5, "", False), (6.5, " [rad]", True)],
)
def test_a_rotation_vector_is_at_most_a_revolution_unless_its_unit_is_stated(
    length, unit, is_read, tmp_path
):
    vectors = np.outer(length - 0.3 * np.sin(files.TIME) ** 2, [0, 0, 1])
    header = ",".join(f"{name}{unit}" for name in ("rx", "ry", "rz"))
    path = table(tmp_path, vectors, header=f"x,y,z,{header}")
    if is_read:
        assert_pose(read(path)[0], Rotation.from_rotvec(vectors))
    else:
        found, remarks = read(path)
        assert "reach 6.5 and are left out" in remarks
        assert found.rotation_reference is None


@pytest.mark.parametrize("header", ["rx,ry,rz", "Rx,Ry,Rz", "tcp_rx,tcp_ry,tcp_rz"])
def test_remark_on_a_rotation_vector_tells_how_to_read_euler_angles(header, tmp_path):
    path = table(tmp_path, RADIANS, header=f"x,y,z,{header}")
    found, remarks = read(path)
    assert f"{header.replace(',', ', ')} read as a rotation vector; if they" in remarks
    assert_pose(found, Rotation.from_rotvec(RADIANS))
    assert_pose(read(path, option_in(remarks))[0])


@pytest.mark.parametrize(
    "header", ["roll,pitch,yaw,qx,qy,qz,qw", "rx,ry,rz,qx,qy,qz,qw"]
)
def test_a_quaternion_is_preferred_to_other_angles(header, tmp_path):
    found, remarks = read(
        table(tmp_path, RADIANS, QUATERNIONS, header=f"x,y,z,{header}")
    )
    assert found.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert_pose(found)
    assert "left out: the orientation is that of qx, qy, qz, qw" in remarks


@pytest.mark.parametrize(
    "header", ["euler_x,euler_y,euler_z", "ThetaX,ThetaY,ThetaZ", "rot.x,rot.y,rot.z"]
)
def test_remark_on_angles_of_an_unknown_order_tells_how_to_read_them(header, tmp_path):
    path = table(tmp_path, RADIANS, header=f"x,y,z,{header}")
    remarks = read(path)[1]
    assert f"{header.replace(',', ', ')} are not read as an orientation" in remarks
    found, remarks = read(path, option_in(remarks))
    assert_pose(found)
    assert "not read" not in remarks
    both = f"x,y,z,{header},qx,qy,qz,qw"
    assert "not read" not in read(table(tmp_path, RADIANS, QUATERNIONS, header=both))[1]


@pytest.mark.parametrize(
    "header", ["angular_x,angular_y,angular_z", "euler_x,euler_y,euler", "wx,wy,wz"]
)
def test_rates_and_single_angles_are_not_taken_for_an_orientation(header, tmp_path):
    remarks = read(table(tmp_path, RADIANS, header=f"x,y,z,{header}"))[1]
    assert "not read as an orientation" not in remarks


def test_angles_of_a_numbered_pose_are_read_by_the_advised_option(tmp_path):
    path = tmp_path / "d.npz"
    pose = np.hstack([files.PATH, RADIANS])
    np.savez(path, time=files.TIME, cartesian_position=pose)
    found, remarks = read(path)
    assert found.channels == ("x", "y", "z")
    assert "angles that are not read; if they are roll, pitch and yaw, add" in remarks
    found, remarks = read(path, option_in(remarks))
    assert_pose(found)
    assert "not read" not in remarks


@pytest.mark.parametrize("angles", [TURNS.as_rotvec(), DEGREES])
def test_a_numbered_pose_of_a_tool_has_a_rotation_vector_unless_in_degrees(
    angles, tmp_path
):
    path = tmp_path / "d.npz"
    np.savez(path, time=files.TIME, tcp_pose=np.hstack([files.PATH, angles]))
    found, remarks = read(path)
    if angles is DEGREES:
        assert found.channels == ("x", "y", "z")
        found, _ = read(path, option_in(remarks))
    assert_pose(found)


@pytest.mark.parametrize(
    ("columns", "channels"),
    [
        ("qx=ux,qy=uy,qz=uz,qw=uw", "x y z force_x force_y force_z rx ry rz"),
        ("force=fz", "x y z ux uy uz uw fx fy force"),
        ("qx=ux,qy=uy,qz=uz,qw=uw,force=fz", "x y z fx fy force rx ry rz"),
        ("time=time", "x y z ux uy uz uw force_x force_y force_z"),
        ("x=px,y=py,z=pz", "x y z"),
        ("x=px,y=py,z=pz,qx=ux,qy=uy,qz=uz,qw=uw", "x y z rx ry rz"),
    ],
)
def test_the_rest_is_recognised_where_only_an_orientation_or_a_force_is_named(
    columns, channels, tmp_path
):
    header = "px,py,pz,ux,uy,uz,uw,fx,fy,fz"
    path = table(tmp_path, QUATERNIONS, 9 + files.PATH, header=header)
    found, _ = read(path, columns)
    assert found.channels == tuple(channels.split())
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)
    if "rx" in found.channels:
        assert_pose(found)
    if "force" in found.channels:
        assert_allclose(found.select(["force"]).values[:, 0], 9 + files.PATH[:, 2])


@pytest.mark.parametrize("extra", [0, 1, 3])
def test_a_measured_state_is_preferred_to_an_action(extra, tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow.parquet import write_table

    path = tmp_path / "d.parquet"
    state = np.hstack([files.PATH, QUATERNIONS, 5 + files.PATH[:, :extra]])
    action = np.hstack([files.PATH + 0.1, QUATERNIONS])
    columns = {"observation.state": list(state), "action": list(action)}
    write_table(pa.table({"timestamp": files.TIME, **columns}), path)
    found, remarks = read(path)
    assert_pose(found)
    assert re.search("action_x, .*action_qw left out: commanded, not meas", remarks)
    rest = [f"observation.state_{8 + i}" for i in range(extra)]
    assert [name for name in found.channels if "state" in name] == rest
    if rest:
        assert_allclose(found.select(rest).values, 5 + files.PATH[:, :extra])


def test_positions_that_are_only_commanded_are_reported(tmp_path):
    path = table(tmp_path, header="action_x,action_y,action_z")
    found, remarks = read(path)
    assert_allclose(found.values, files.PATH)
    assert "action_z are commanded; no position is measured" in remarks


@pytest.mark.parametrize(
    ("header", "channel"),
    [
        ("normal_force", "force"),
        ("Normal Force (N)", "force"),
        ("sensor.force_normal", "force"),
        ("normal_force [V]", "normal_force"),
        ("fz", "fz"),
        ("force_z", "force_z"),
    ],
)
def test_only_a_normal_force_is_one_by_its_name(header, channel, tmp_path):
    path = table(tmp_path, 9 + files.PATH[:, :1], header=f"x,y,z,{header}")
    assert read(path)[0].channels == ("x", "y", "z", channel)


def test_a_column_named_force_is_preferred_to_a_normal_force(tmp_path):
    path = table(tmp_path, files.PATH[:, :2], header="x,y,z,normal_force,force")
    assert read(path)[0].channels == ("x", "y", "z", "normal_force", "force")


@pytest.mark.parametrize(
    ("wrong", "rows"),
    [
        ([0, 1, 2, 3, 4], "1 to 5"),
        ([7, 200, 201], "8, 201 to 202"),
        ([1, 3, 5, 7], r"2, 4, 6, \.\.\."),
    ],
)
def test_rows_without_a_unit_quaternion_are_named(wrong, rows, tmp_path):
    quaternions, force = QUATERNIONS.copy(), files.PATH[:, 0].copy()
    quaternions[wrong] = 0
    force[399] = np.nan  # A row that is left out does not move the others.
    path = table(tmp_path, quaternions, force, header="x,y,z,qx,qy,qz,qw,force")
    with pytest.raises(FmpError, match=rf"from 0 to 0\); delete .* from 1: {rows}\.$"):
        read(path)


def test_rows_of_wrong_quaternions_are_counted_in_the_file(tmp_path):
    quaternions, force = QUATERNIONS.copy(), files.PATH[:, 0].copy()
    quaternions[10], force[:5] = 0, np.nan
    path = table(tmp_path, quaternions, force, header="x,y,z,qx,qy,qz,qw,force")
    with pytest.raises(FmpError, match=r"counted from 1: 11\.$"):
        read(path)


@pytest.mark.parametrize(
    ("header", "hint"),
    [
        (
            "rx,ry,rz",
            r"\(rx, ry, rz read as a rotation vector; if they are Euler .*yaw=rz\)",
        ),
        ("roll,pitch,yaw", r"roll, pitch, yaw read as Euler angles, R = .*\)"),
        ("q1,q2,q3,q4", r"\(the quaternion from q1 is read as x, y, z, w; .*wxyz\)"),
        ("qx,qy,qz,qw", "check how the orientation is read."),
    ],
)
def test_refusal_of_a_jump_tells_how_the_orientation_was_read(header, hint, tmp_path):
    angles = np.zeros((400, header.count(",") + 1))
    angles[:, -1] = 1.0
    angles[200:] = np.eye(len(angles[0]))[0] * (3.0 if len(angles[0]) == 3 else 1.0)
    path = table(tmp_path, angles, header=f"x,y,z,{header}")
    words = f"after sample 199; at most 90 .*{hint}$"
    if "q" in header:
        with pytest.raises(FmpError, match=words):
            read(path)
        return
    # Angles may be those of something else: the path can be learned without them.
    found, remarks = read(path)
    for text in (remarks, found.note):
        assert re.search(f"orientation left out: .*{words}", text)
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.values, files.PATH, atol=1e-12)


def test_an_orientation_that_turns_on_is_left_out_beside_a_position(tmp_path):
    angles = np.outer(6 * files.TIME, [0, 0, 1])
    quaternions = Rotation.from_rotvec(angles).as_quat()
    found, remarks = read(table(tmp_path, quaternions, header="x,y,z,qx,qy,qz,qw"))
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.values, files.PATH, atol=1e-12)
    assert remarks.startswith("d.csv: orientation left out: sample")
    assert found.note in remarks
    text = files.lines(files.TIME, *quaternions.T, header="time,qx,qy,qz,qw")
    path = files.write(tmp_path, text).path
    with pytest.raises(FmpError, match=r"is rotated by .* from the reference"):
        read(path)


@pytest.mark.parametrize("length", [1.0, 0.9983])
def test_w_x_y_and_z_are_a_quaternion_of_about_unit_length(length, tmp_path):
    numbers = length * np.roll(QUATERNIONS, 1, axis=1)
    text = files.lines(files.TIME, *numbers.T, header="Time (s),W,X,Y,Z")
    found, _ = read(files.write(tmp_path, text).path)
    assert found.channels == ("rx", "ry", "rz")
    recorded = rotations_of(found.values, found.rotation_reference)
    assert np.max((recorded * TURNS.inv()).magnitude()) < 1e-6


@pytest.mark.parametrize(
    "header",
    [
        "X,Y,Z,RX,RY,RZ,RW",  # Not a rotation vector.
        "PosX,PosY,PosZ,OrienX,OrienY,OrienZ,OrienW",
        "PosX,PoseY,PoseZ,OrienX,OrienY,OrienZ,OrienW",  # Not several positions.
        "px,py,pz,turned x,turned y,turned z,turned w",
        "tool_x,tool_y,tool_z,tool_rx,tool_ry,tool_rz,tool_rw",
        "Tx,Ty,Tz,Qx,Qy,Qz,Q0",
    ],
)
def test_x_y_z_and_w_of_unit_length_are_a_quaternion_by_any_name(header, tmp_path):
    found, _ = read(table(tmp_path, QUATERNIONS, header=header))
    assert found.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert_pose(found)


def test_homogeneous_coordinates_are_a_position(tmp_path):
    path = np.column_stack([0.1 * files.PATH, np.ones(len(files.TIME))])
    text = files.lines(files.TIME, *path.T, header="time,x,y,z,w")
    found, _ = read(files.write(tmp_path, text).path)
    assert found.channels[:3] == ("x", "y", "z")


def test_angles_without_a_name_do_not_jump_by_a_revolution(tmp_path):
    states = np.column_stack([files.PATH, RADIANS])
    np.savez(tmp_path / "d.npz", timestamp=files.TIME, state=states)
    found, remarks = read(tmp_path / "d.npz")
    assert "state_4 unwrapped where they jump by a revolution" in remarks
    assert_allclose(np.ptp(found.values[:, 3]), np.ptp(ROLL), atol=1e-9)


@pytest.mark.parametrize("size", [2.9, 4.0])
def test_other_values_that_jump_are_not_unwrapped(size, tmp_path):
    state = size * np.where(np.arange(len(files.TIME)) % 40 < 20, 1.0, -1.0)
    found, _ = read(table(tmp_path, state, header="x,y,z,state"))
    assert_allclose(found.select(["state"]).values[:, 0], state, atol=1e-12)


def test_samples_without_an_angle_are_left_out(tmp_path):
    angles = RADIANS.copy()
    angles[[5, 6], 1] = np.nan
    found, remarks = read(table(tmp_path, angles, header="x,y,z,roll,pitch,yaw"))
    assert_allclose(found.time, np.delete(files.TIME, [5, 6]), atol=1e-9)
    assert "2 samples without a value of pitch left out" in remarks


@pytest.mark.parametrize(("largest", "is_degrees"), [(12.5, False), (12.6, True)])
@pytest.mark.parametrize("name", ["joint_1", "right_j0"])
def test_joints_are_in_degrees_above_two_revolutions(
    largest, is_degrees, name, tmp_path
):
    angles = largest - np.sin(files.TIME)[:, None] ** 2
    found, _ = read(table(tmp_path, angles, header=f"x,y,z,{name}"))
    factor = np.pi / 180 if is_degrees else 1.0
    assert_allclose(found.select([name]).values, factor * angles)
    assert found.units[3] == "rad"


@pytest.mark.parametrize(
    ("length", "count", "advice"),
    [
        (1.09, 400, ""),
        (1.11, 199, "delete these rows"),
        (1.11, 201, "give the columns"),
        (0.89, 201, "give the columns"),
    ],
)
def test_quaternions_may_differ_by_a_tenth_from_unit_length(
    length, count, advice, tmp_path
):
    quaternions = QUATERNIONS.copy()
    quaternions[:count] *= length
    path = table(tmp_path, quaternions, header="x,y,z,qx,qy,qz,qw")
    if advice:
        with pytest.raises(FmpError, match=rf"lengths from {length} to .*{advice}"):
            read(path)
    else:
        assert_pose(read(path)[0])


@pytest.mark.parametrize(("every", "sign"), [(1, -1.0), (20, 1.0)])
def test_an_orientation_in_rows_of_its_own_follows_the_rotation(every, sign, tmp_path):
    stamps = files.TIME[::every] + 0.004
    angles = np.column_stack([0.5 * np.sin(4 * stamps), np.sin(3 * stamps + 1)])
    turns = Rotation.from_euler("xy", angles)
    quaternions = turns.as_quat()
    quaternions[::2] *= sign  # Both signs are the same rotation.
    lines = [
        (t, f"{t},{x},{y},{z},,,,")
        for t, (x, y, z) in zip(files.TIME, files.PATH, strict=True)
    ]
    lines += [
        (t, f"{t},,,,{x},{y},{z},{w}")
        for t, (x, y, z, w) in zip(stamps, quaternions, strict=True)
    ]
    text = "\n".join(["time,x,y,z,qx,qy,qz,qw", *(line for _, line in sorted(lines))])
    found, remark = read(files.write(tmp_path, text).path)
    assert "qx, qy, qz, qw interpolated at the times of the position" in remark
    recorded = rotations_of(
        found.select(["rx", "ry", "rz"]).values, found.rotation_reference
    )
    known = Slerp(stamps, turns)(found.time)
    assert np.max((recorded * known.inv()).magnitude()) < 1e-6


def test_quaternions_in_rows_of_their_own_may_lack_components_at_the_ends(tmp_path):
    # Each component is known before the second of these positions, but not all at once.
    lines = [f"{t},0,0,{t},,,," for t in files.TIME]
    lines[1::2] = [f"{t},,,,0,0,0,1" for t in files.TIME[1::2]]
    lines[1], lines[3] = f"{files.TIME[1]},,,,0,0,,", f"{files.TIME[3]},,,,,,0,1"
    text = "\n".join(["time,x,y,z,qx,qy,qz,qw", *lines])
    found, _ = read(files.write(tmp_path, text).path)
    assert_allclose(found.select(["rx", "ry", "rz"]).values, 0, atol=1e-9)


def test_quaternions_in_rows_of_their_own_must_be_unit_quaternions(tmp_path):
    lines = [f"{t},0,0,{t},,,," for t in files.TIME]
    lines[1::2] = [
        f"{t},,,,0,0,0,{1.5 * (i > 0)}" for i, t in enumerate(files.TIME[1::2])
    ]
    text = "\n".join(["time,x,y,z,qx,qy,qz,qw", *lines])
    with pytest.raises(FmpError, match="not unit quaternions"):
        read(files.write(tmp_path, text).path)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("quat_wxyz", np.roll(QUATERNIONS, 1, axis=1)),
        ("ee_quaternion_xyzw", QUATERNIONS),
        ("rotation", TURNS.as_matrix()),
        ("ee_rotation_matrix", TURNS.as_matrix()),
        ("R", TURNS.as_matrix()),
    ],
)
def test_a_name_that_tells_the_order_and_matrices_need_no_option(name, array, tmp_path):
    path = tmp_path / "d.npz"
    np.savez(path, time=files.TIME, ee_position=files.PATH, **{name: array})
    found, remarks = read(path)
    assert_pose(found)
    assert "--quaternions" not in remarks


@pytest.mark.parametrize("name", ["wxyz", "R_WE", "dcm", "rotation_mat"])
def test_columns_of_a_stated_order_or_of_a_rotation_matrix_are_an_orientation(
    name, tmp_path
):
    numbers = TURNS.as_matrix().reshape(-1, 9)
    numbers = np.roll(QUATERNIONS, 1, axis=1) if name == "wxyz" else numbers
    names = ",".join(f"{name}_{i}" for i in range(numbers.shape[1]))
    found, remarks = read(table(tmp_path, numbers, header=f"x,y,z,{names}"))
    assert found.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert_pose(found)
    if name != "wxyz":
        assert f"{name}_0 to {name}_8 are an orientation, row by row" in remarks


@pytest.mark.parametrize("form", ["r{}{}", "R_{}_{}", "dcm[{}][{}]", "O_R_EE_{}{}"])
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("by_columns", [False, True])
def test_elements_of_a_matrix_are_found_by_their_row_and_column(
    form, first, by_columns, tmp_path
):
    matrices, order = TURNS.as_matrix(), [(i, j) for i in range(3) for j in range(3)]
    order = [(i, j) for j, i in order] if by_columns else order
    names = ",".join(form.format(i + first, j + first) for i, j in order)
    columns = np.column_stack([matrices[:, i, j] for i, j in order])
    found, _ = read(table(tmp_path, columns, header=f"x,y,z,{names}"))
    assert found.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert_pose(found)


def test_elements_of_a_pose_include_its_position(tmp_path):
    matrices = np.dstack([TURNS.as_matrix(), files.PATH])
    names = ",".join(f"T{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3, 4))
    text = files.lines(files.TIME, *matrices.reshape(-1, 12).T, header=f"time,{names}")
    found, _ = read(files.write(tmp_path, text).path)
    assert_pose(found)


@pytest.mark.parametrize("names", ["q_i,q_j,q_k,q_w", "quat_w,quat_i,quat_j,quat_k"])
def test_a_quaternion_may_have_the_elements_i_j_k_and_w(names, tmp_path):
    quaternions = np.roll(QUATERNIONS, names.startswith("quat_w"), axis=1)
    found, _ = read(table(tmp_path, quaternions, header=f"x,y,z,{names}"))
    assert_pose(found)


@pytest.mark.parametrize("other", ["ee_ok", "ee_q_k"])
def test_a_quaternion_is_read_beside_a_column_that_ends_with_i_j_or_k(other, tmp_path):
    names = "ee_qx,ee_qy,ee_qz,ee_qw"
    columns = np.column_stack([QUATERNIONS, np.ones(len(files.TIME))])
    found, _ = read(table(tmp_path, columns, header=f"x,y,z,{names},{other}"))
    assert found.channels == ("x", "y", "z", other, "rx", "ry", "rz")
    assert_pose(found)


@pytest.mark.parametrize("form", ["position_{}_{}", "joint_position_{}{}", "state{}{}"])
def test_elements_of_a_constant_matrix_are_neither_joints_nor_a_pose(form, tmp_path):
    names = [form.format(i, j) for i in (1, 2, 3) for j in (1, 2, 3)]
    values = np.tile(np.eye(3).ravel(), (len(files.TIME), 1))
    found, _ = read(table(tmp_path, values, header=",".join(["x,y,z", *names])))
    assert found.channels == ("x", "y", "z", *names)


@pytest.mark.parametrize("kind", ["torque", "vel", "temp", "current"])
def test_values_of_joints_that_are_not_angles_do_not_change_the_unit_of_angles(
    kind, tmp_path
):
    names = [f"{name}{i}" for name in ("q", f"{kind}_j") for i in range(1, 7)]
    angles = files.JOINTS[:, :6]
    values = np.hstack([angles, 50 + angles])
    found, _ = read(table(tmp_path, values, header=",".join(["x,y,z", *names])))
    assert_allclose(found.select(names).values, values)
    assert found.units == ("m",) * 3 + ("rad",) * 6 + ("1",) * 6
    # The current angles are not currents.
    names = [f"current_joint_{i}" for i in range(1, 7)]
    found, _ = read(table(tmp_path, angles, header=",".join(["x,y,z", *names])))
    assert found.units[3:] == ("rad",) * 6


def test_a_position_has_the_orientation_of_its_body(tmp_path):
    names = ",".join(f"ee_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw"))
    other = names.replace("ee", "uav")
    one, two = (*files.PATH.T, *QUATERNIONS.T), (*files.PATH.T, *files.QUATERNIONS.T)
    text = files.lines(files.TIME, *two, *one, header=f"time,{other},{names}")
    found, _ = read(files.write(tmp_path, text).path)
    assert_pose(found)


def test_measured_values_of_a_kuka_and_a_kinova_are_read(tmp_path):
    measured = np.hstack([files.PATH, DEGREES[:, ::-1]])
    names = [f"R{kind}_{axis}" for kind in ("Ist", "Sol") for axis in "XYZABC"]
    clock = 4_208_163_634 + np.round(1000 * files.TIME)
    columns = (clock, *measured.T, *(measured + 1).T)
    text = files.lines(*columns, header=",".join(["IPOC", *names]))
    found, _ = read(files.write(tmp_path, text).path)
    assert_pose(found)
    assert_allclose(found.time - found.time[0], files.TIME, atol=1e-9)
    names = [f"tool_pose_{kind}{axis}" for kind in ("", "theta_") for axis in "xyz"]
    columns = (files.TIME, *files.PATH.T, *DEGREES.T)
    text = files.lines(*columns, header=",".join(["time", *names]))
    found, _ = read(files.write(tmp_path, text).path)
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)


def test_advice_on_two_arms_keeps_the_orientation(tmp_path):
    names = ",".join(
        f"left_ee_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")
    )
    header = f"time,{names},{names.replace('left', 'right')}"
    arm = [*files.PATH.T, *QUATERNIONS.T]
    path = files.write(
        tmp_path, files.lines(files.TIME, *arm, *arm, header=header)
    ).path
    _, remarks = read(path)
    found, _ = read(path, option_in(remarks))
    assert_pose(found)


@pytest.mark.parametrize(
    ("name", "order"),
    [("pos_quat", "xyzw"), ("pos_quat_wxyz", "wxyz"), ("pos_q_xyzw", "xyzw")],
)
def test_seven_numbers_named_as_position_and_quaternion_are_a_pose(
    name, order, tmp_path
):
    path, turns = tmp_path / "d.npz", np.roll(QUATERNIONS, order == "wxyz", axis=1)
    np.savez(path, time=files.TIME, **{name: np.hstack([files.PATH, turns])})
    found, remarks = read(path)
    assert_pose(found)
    assert ("--quaternions" in remarks) == (name == "pos_quat")


@pytest.mark.parametrize(
    ("name", "matrix", "channels"),
    [
        ("rotation", np.ones(9), 12),
        ("covariance_matrix", np.eye(3).ravel(), 12),
        ("covariance", 0.1 * np.eye(3), 3),
    ],
)
def test_other_nine_numbers_are_no_orientation(name, matrix, channels, tmp_path):
    path, numbers = tmp_path / "d.npz", np.tile(matrix, (len(files.TIME), 1, 1))
    numbers = numbers.reshape(-1, *matrix.shape)
    np.savez(path, time=files.TIME, ee_position=files.PATH, **{name: numbers})
    found, _ = read(path)
    assert "rx" not in found.channels
    assert len(found.channels) == channels


@pytest.mark.parametrize("stem", ["", "current_"])
def test_a_pose_of_doosan_is_in_mm_and_in_degrees_about_z_y_and_z(stem, tmp_path):
    turns = files.TURNS * Rotation.from_euler("y", 0.5)
    numbers = np.hstack([1e3 * files.PATH, turns.as_euler("ZYZ", degrees=True)])
    joints = np.degrees(files.JOINTS[:, :6])
    names = [f"{stem}{kind}_{i}" for kind in ("posx", "posj") for i in range(6)]
    header = ",".join(["time", *names])
    text = files.lines(files.TIME, *numbers.T, *joints.T, header=header)
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    pose = found.select(["x", "y", "z", "rx", "ry", "rz"])
    assert_allclose(pose.values[:, :3], files.PATH, atol=1e-12)
    found_turns = rotations_of(pose.values[:, 3:], found.rotation_reference)
    assert np.max((found_turns * turns.inv()).magnitude()) < 1e-6
    angles = found.select(names[6:])
    assert angles.units == ("rad",) * 6
    assert_allclose(angles.values, files.JOINTS[:, :6], atol=1e-12)


@pytest.mark.parametrize("form", ["markers", "units"])
def test_other_six_numbers_named_as_doosan_names_a_pose_are_none(form, tmp_path):
    numbers = np.hstack([files.PATH + i for i in range(6)])
    names = [f"pos{axis}_{i}" for i in range(6) for axis in "xyz"]
    if form == "units":
        numbers = numbers[:, :6]
        names = [f"posx_{i} [{'m' if i < 3 else 'rad'}]" for i in range(6)]
    header = ",".join(["time", *names])
    text = files.lines(files.TIME, *numbers.T, header=header)
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == tuple(name.partition(" ")[0] for name in names)
    assert_allclose(found.values, numbers, atol=1e-12)
