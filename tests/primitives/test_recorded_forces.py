"""Facts about forces and orientations that were recorded apart from the position."""

import numpy as np
import pytest
import recorded_files as files
from numpy.testing import assert_allclose

from fmp_drake.errors import FmpError
from fmp_drake.primitives import ReadingOptions, read_demonstrations
from fmp_drake.primitives.data.channels import FORCE_COMPONENTS, ROTATION_CHANNELS
from fmp_drake.primitives.data.orientation import rotations_of
from fmp_drake.primitives.data.reading.rows import at_times


def bag_of(folder, ros=2, topic="", make=files.pose_stamped, **wrenches):
    """Write poses, or others, beside wrenches, and return what is read."""
    pytest.importorskip("rosbags")
    topics = {"/pose": lambda k: make(ros, k)}
    topics |= {f"/{name}": message for name, message in wrenches.items()}
    path = folder / ("d.bag" if ros == 1 else "d")
    files.bag(path, topics, ros=ros, storage="MCAP")
    (found,), (remark,) = read_demonstrations([path], ReadingOptions(topic=topic))
    return found, remark


def forces(found):
    return found.select(FORCE_COMPONENTS).values


def rotation_errors(found, known):
    vectors = found.select(ROTATION_CHANNELS).values
    return (rotations_of(vectors, found.rotation_reference) * known.inv()).magnitude()


@pytest.mark.parametrize("ros", [1, 2])
def test_the_force_of_a_bag_is_interpolated_at_the_times_of_its_pose(ros, tmp_path):
    def later(k):  # By 5 ms.
        return files.wrench_stamped(ros, k, start=-5_000_000)

    found, remark = bag_of(tmp_path, ros, ft=later)
    assert "/pose, header stamps; /ft interpolated at the times of /pose" in remark
    assert "1 sample without a value of force_x" in remark
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH[1:], atol=1e-12)
    known = [np.interp(files.TIME[1:], files.TIME + 0.005, f) for f in files.FORCE.T]
    assert_allclose(forces(found), np.transpose(known), atol=1e-9)
    assert found.units[3:9] == ("N",) * 3 + ("Nm",) * 3


@pytest.mark.parametrize(
    ("pose", "topic"),
    [
        (files.pose_alone, ""),
        (files.pose_alone, "/pose,/ft"),
        (files.pose_stamped, "/pose,/ft"),
    ],
)
def test_messages_without_a_header_are_read_at_their_times_of_receipt(
    pose, topic, tmp_path
):
    def wrench(k):
        return files.wrench_alone(2, k)

    found, remark = bag_of(tmp_path, topic=topic, make=pose, ft=wrench)
    assert "/pose, times of receipt" in remark
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)
    assert_allclose(forces(found), files.FORCE, atol=1e-9)


def with_covariance(ros, k):
    types, pose = files.typestore(ros).types, files.pose_stamped(ros, k)
    return types["geometry_msgs/msg/PoseWithCovarianceStamped"](
        header=pose.header,
        pose=types["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose.pose, covariance=np.zeros(36)
        ),
    )


@pytest.mark.parametrize(
    ("make", "clock"),
    [
        (with_covariance, "header stamps"),
        (lambda ros, k: files.transform_stamped(ros, k).transform, "times of receipt"),
        (lambda ros, k: files.pose_alone(ros, k).position, "times of receipt"),
    ],
)
def test_the_only_topic_of_a_position_needs_no_name(make, clock, tmp_path):
    found, remark = bag_of(tmp_path, make=make)
    assert f"/pose, {clock}" in remark
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)


def test_a_force_without_a_header_does_not_replace_the_stamps_of_a_pose(tmp_path):
    """At a third of the speed, as its bag was played."""
    pytest.importorskip("rosbags")
    topics = {
        "/pose": lambda k: files.pose_stamped(2, k),
        "/ft": lambda k: files.wrench_alone(2, k),
    }
    files.bag(tmp_path / "d", topics, storage="MCAP", slowness=3)
    (found,), (remark,) = read_demonstrations([tmp_path / "d"])
    assert "/pose, header stamps; /ft not read: to add this force, give" in remark
    assert "--topic /pose,/ft" in remark
    assert_allclose(found.time, files.TIME, atol=1e-9)


def test_a_force_with_a_header_is_read_before_one_without(tmp_path):
    def wrench(k):
        return files.wrench_stamped(2, k)

    def other(k):
        return files.wrench_stamped(2, k, sign=-1).wrench

    found, _ = bag_of(tmp_path, bare=other, ft=wrench)
    assert_allclose(forces(found), files.FORCE, atol=1e-9)


def test_a_topic_of_forces_without_messages_hinders_nothing(tmp_path):
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer

    store, path = files.typestore(1), tmp_path / "d.bag"
    with Writer(path) as writer:
        kinds = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped")
        pose, _ = (writer.add_connection(k[-8:], k, typestore=store) for k in kinds)
        for k, stamp in enumerate(files.STAMPS.tolist()):
            raw = store.serialize_ros1(files.pose_stamped(1, k), kinds[0])
            writer.write(pose, stamp, raw)
    (found,), _ = read_demonstrations([path])
    assert found.channels == ("x", "y", "z", *ROTATION_CHANNELS)


def test_joints_of_a_bag_are_read_with_its_force(tmp_path):
    ft = lambda k: files.wrench_stamped(2, k)
    found, _ = bag_of(tmp_path, make=files.joint_state, ft=ft)
    assert found.channels[:7] == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert_allclose(forces(found), files.FORCE, atol=1e-12)


def test_a_frame_of_a_tree_of_transforms_is_read_with_the_force(tmp_path):
    def tree(ros, k):
        message = files.typestore(ros).types["tf2_msgs/msg/TFMessage"]
        return message(transforms=[files.transform_stamped(ros, k)])

    ft = lambda k: files.wrench_stamped(2, k)
    found, _ = bag_of(tmp_path, make=tree, topic="/pose:tool", ft=ft)
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)
    assert_allclose(forces(found), files.FORCE, atol=1e-12)


@pytest.mark.parametrize("stamp", [{"stamped": False}, {"start": 30 * 10**9}])
def test_topics_without_a_common_clock_are_read_at_their_times_of_receipt(
    stamp, tmp_path
):
    ft = lambda k: files.wrench_stamped(2, k, **stamp)
    found, remark = bag_of(tmp_path, ft=ft)
    assert "times of receipt, because /ft has no stamps of the same clock" in remark
    assert_allclose(forces(found), files.FORCE, atol=1e-9)


def test_one_of_several_forces_of_a_bag_is_named(tmp_path):
    pair = {
        "a": lambda k: files.wrench_stamped(2, k),
        "b": lambda k: files.wrench_stamped(2, k, sign=-1),
    }
    for name in ("all", "b", "both", "nose"):
        (tmp_path / name).mkdir()
    found, remark = bag_of(tmp_path / "all", **pair)
    assert found.channels == ("x", "y", "z", *ROTATION_CHANNELS)
    assert (
        "/a, /b not read: to add one of these forces, give --topic /pose,/a" in remark
    )
    found, _ = bag_of(tmp_path / "b", topic="/pose,/b", **pair)
    assert_allclose(forces(found), -files.FORCE, atol=1e-12)
    with pytest.raises(FmpError, match=r"/b holds wrench\.force\.x, and so does"):
        bag_of(tmp_path / "both", topic="/pose,/a,/b", **pair)
    with pytest.raises(FmpError, match="has no topic /nose; it has /a"):
        bag_of(tmp_path / "nose", topic="/pose,/nose", **pair)


def test_a_force_of_a_part_of_a_bag_is_read_where_it_is_named(tmp_path):
    ft = lambda k: files.wrench_stamped(2, k) if k < 300 else None
    for name in ("all", "named", "none"):
        (tmp_path / name).mkdir()
    found, remark = bag_of(tmp_path / "all", ft=ft)
    assert len(found.time) == 400
    assert "force_x" not in found.channels
    assert "/ft not read: it has values at 75 % of the times of /pose" in remark
    found, _ = bag_of(tmp_path / "named", topic="/pose,/ft", ft=ft)
    assert_allclose(forces(found), files.FORCE[:300], atol=1e-12)
    before = lambda k: None if k else files.wrench_stamped(2, k, start=5_000_000)
    with pytest.raises(FmpError, match="/ft has no values at the times of /pose; name"):
        bag_of(tmp_path / "none", topic="/pose,/ft", ft=before)


def test_the_force_of_a_faster_topic_of_a_bag_is_averaged(tmp_path):
    slow = lambda ros, k: None if k % 4 else files.pose_stamped(ros, k)
    ft = lambda k: files.wrench_stamped(2, k, sign=(-1) ** k)
    found, _ = bag_of(tmp_path, make=slow, ft=ft)
    # Single samples at the times of the poses are all of one sign.
    assert np.all(np.abs(forces(found)[1:-1, 2]) < 0.3 * -files.FORCE[::4, 2][1:-1])


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("topic", ["", "/franka,/ft"])
def test_the_force_of_a_franka_arm_is_read_unless_another_is_named(
    topic, ros, tmp_path
):
    pytest.importorskip("rosbags")
    ft = lambda k: files.wrench_stamped(ros, k, sign=-1)
    state = files.franka_state if ros == 1 else files.franka_robot_state
    topics = {"/franka": state, "/ft": ft}
    path = tmp_path / ("d.bag" if ros == 1 else "bag")
    path = files.bag(path, topics, ros=ros, storage="MCAP")
    (found,), _ = read_demonstrations([path], ReadingOptions(topic=topic))
    sign = -1 if topic else 1
    assert_allclose(forces(found), sign * files.FORCE, atol=1e-12)
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH, atol=1e-12)
    assert np.max(rotation_errors(found, files.TURNS)) < 1e-6


@pytest.mark.parametrize("form", ["{}_F_ext_hat_K[{}]", "{}_F_ext_{}"])
@pytest.mark.parametrize("has_sensor", [False, True])
def test_of_two_wrenches_of_a_franka_arm_that_in_its_base_is_the_force(
    form, has_sensor, tmp_path
):
    names = ["time", *"xyz"]
    axes = range(6) if "[" in form else "xyz"
    wrenches = np.hstack([files.FORCE, 0 * files.FORCE])[:, : len(axes)]
    columns = [files.TIME, *files.PATH.T]
    for frame, sign in (("K", 3), ("O", 1)):
        names += [form.format(frame, axis) for axis in axes]
        columns += [*(sign * wrenches.T)]
    if has_sensor:
        names += [f"wrench_{axis}" for axis in range(6)]
        columns += [*(10 * files.FORCE.T), *(0 * files.FORCE.T)]
    text = files.lines(*columns, header=",".join(names))
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    factor = 10 if has_sensor else 1
    assert_allclose(forces(found), factor * files.FORCE, atol=1e-12)


def force_file(folder, time, name="force.csv", force=files.FORCE):
    """Write a table as `rostopic echo -p` prints a wrench, and return its path."""
    names = [f"field.wrench.force.{axis}" for axis in "xyz"]
    stamps = np.round(time * 1e9).astype(np.int64)
    header = ",".join(["%time", "field.header.stamp", *names])
    text = files.lines(stamps + 2 * 10**6, stamps, *force.T, header=header)
    return files.write(folder, text, name).path


START = files.STAMPS[0] * 1e-9
LATER = files.TIME + START + 0.005


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("make", [files.ros_topic_echo, files.bagpy, files.ros1_poses])
def test_a_file_of_a_force_is_added_to_the_position_at_the_same_times(
    make, order, tmp_path
):
    pytest.importorskip("rosbags")
    paths = [make(tmp_path).path, force_file(tmp_path, LATER)]
    (found,), (remark,) = read_demonstrations(paths[::order])
    assert "force_z of force.csv interpolated at its times; 1 sample" in remark
    known = [np.interp(files.TIME[1:], files.TIME + 0.005, f) for f in files.FORCE.T]
    assert_allclose(forces(found), np.transpose(known), atol=1e-5)
    assert_allclose(found.select(["x", "y", "z"]).values, files.PATH[1:], atol=1e-12)
    assert found.rotation_reference is not None


def test_vibrations_of_a_faster_force_are_averaged(tmp_path):
    place = files.write(tmp_path, files.xyz(files.STAMPS, header="time,x,y,z"), "p.csv")
    fast = np.arange(0.0, files.TIME[-1], 1e-3)
    # At the 50 Hz of the position it would look like one of 4 Hz.
    force = 10 + np.sin(fast) + 8 * np.sin(2 * np.pi * 96 * fast)
    force = force_file(tmp_path, fast + START, force=np.tile(force, (3, 1)).T)
    (found,), _ = read_demonstrations([place.path, force])
    known = 10 + np.sin(found.time - found.time[0])
    error = forces(found)[5:-5] - known[5:-5, None]
    assert np.max(np.abs(error)) < 0.7


@pytest.mark.parametrize("shift", [0.0, 3e-4])
def test_a_faster_force_is_averaged_in_a_table_of_several_sensors(shift, tmp_path):
    fast = np.round(np.arange(8000) * 1e-3, 6)
    force = 10 + np.sin(fast) + 8 * np.sin(2 * np.pi * 96 * fast)
    # All positions, or every other one, have a force at their times.
    place = files.TIME + shift * (np.arange(400) % 2)
    turn = np.arange(0, 8, 0.002) + 1e-4
    times = np.unique(np.round(np.concatenate([fast, place, turn]), 6))
    values = np.full((len(times), 10), np.nan)
    values[np.searchsorted(times, np.round(place, 6)), :3] = files.PATH
    values[np.searchsorted(times, np.round(turn, 6)), 3:7] = [0.0, 0.0, 0.0, 1.0]
    values[np.searchsorted(times, fast), 7:] = force[:, None]
    header = "time,x,y,z,qx,qy,qz,qw,fx,fy,fz"
    path = files.write(tmp_path, files.lines(times, *values.T, header=header)).path
    (found,), _ = read_demonstrations([path])
    error = forces(found)[5:-5] - (10 + np.sin(found.time[5:-5, None]))
    assert np.max(np.abs(error)) < 0.7


def test_stamps_in_bursts_change_no_average():
    stamps = 0.02 * np.repeat(np.arange(100), 20) + np.tile(5e-5 * np.arange(20), 100)
    values = np.sin(2 * np.pi * 2 * stamps)
    values[777] = np.nan
    found = at_times(np.arange(10, 90) * 0.02, stamps, values, name="force_x")
    known = np.sin(2 * np.pi * 2 * np.arange(10, 90) * 0.02)
    assert np.nanmax(np.abs(found - known)) < 0.05
    assert np.count_nonzero(np.isnan(found)) <= 1


def test_a_force_is_added_to_a_position_with_dates(tmp_path):
    paths = [files.npz_with_dates(tmp_path).path, force_file(tmp_path, LATER)]
    (found,), _ = read_demonstrations(paths)
    known = [np.interp(files.TIME[1:], files.TIME + 0.005, f) for f in files.FORCE.T]
    assert_allclose(forces(found), np.transpose(known), atol=1e-5)


def test_a_force_is_added_to_each_recording_at_its_times(tmp_path):
    halves = []
    for name, rows in (("a.csv", slice(0, 200)), ("b.csv", slice(200, 400))):
        text = files.xyz(files.STAMPS[rows], files.PATH[rows], header="time,x,y,z")
        halves.append(files.write(tmp_path, text, name).path)
    one, other = read_demonstrations([*halves, force_file(tmp_path, LATER)])[0]
    assert_allclose(forces(one)[:, 2], -5 - files.TIME[1:200] + 0.005, atol=1e-5)
    assert_allclose(forces(other)[:, 2], -5 - files.TIME[200:] + 0.005, atol=1e-5)


def test_a_file_of_an_orientation_is_added_to_the_position(tmp_path):
    place = files.write(tmp_path, files.xyz(files.STAMPS, header="time,x,y,z"), "p.csv")
    slow = slice(None, None, 10)  # The arm turns by up to 35 degrees in between.
    text = files.lines(
        files.STAMPS[slow], *files.QUATERNIONS[slow].T, header="time,qx,qy,qz,qw"
    )
    turns = files.write(tmp_path, text, "q.csv")
    (found,), _ = read_demonstrations([place.path, turns.path])
    errors = rotation_errors(found, files.TURNS[:391])
    assert np.degrees(np.max(errors)) < 2
    assert np.max(errors[slow]) < 1e-6


def relative(folder):
    return files.plain(folder).path, files.write(
        folder,
        files.lines(files.TIME, *files.FORCE.T, header="time,fx,fy,fz"),
        "force.csv",
    ).path


def an_hour_later(folder):
    return files.nanoseconds(folder).path, force_file(folder, LATER + 3600)


def mostly_later(folder):
    return files.nanoseconds(folder).path, force_file(folder, LATER + 5)


def twice(folder):
    text = files.xyz(files.STAMPS, header="time,x,y,z,force_x")
    text = text.replace("\n", ",1\n").replace("force_x,1", "force_x")
    pose = files.write(folder, text).path
    return pose, force_file(folder, LATER)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            relative,
            r"force\.csv holds force_x, .* added to d\.csv \(0\.000 s to 7\.980 s\): ",
        ),
        (
            relative,
            "Give stamps of one clock in both files, such as seconds since 1970",
        ),
        (an_hour_later, r"cannot be added to d\.csv .* \(1700003600\.005 s to "),
        (
            mostly_later,
            r"values at only 149 of the 400 samples of \S+d\.csv; record both",
        ),
        (twice, r"d\.csv both hold force_x at the same times; choose one"),
    ],
)
def test_a_force_of_another_time_is_refused(make, message, tmp_path):
    with pytest.raises(FmpError, match=message):
        read_demonstrations(make(tmp_path))


@pytest.mark.parametrize(
    "name", ["f", "ft_raw", "ft_sensor", "force_torque", "ee_force_torque"]
)
def test_six_numbers_of_a_sensor_are_a_force_and_a_torque(name, tmp_path):
    arrays = {"time": files.TIME, "ee_pos": files.PATH}
    wrench = np.hstack([files.FORCE, files.PATH])
    np.savez(tmp_path / "d.npz", **arrays, **{name: wrench}, stiff=wrench)
    (found,), (remark,) = read_demonstrations([tmp_path / "d.npz"])
    assert f"{name}_1 to {name}_6 are a force and a torque" in remark
    assert "stiff_1" in found.channels
    assert_allclose(forces(found), files.FORCE)


@pytest.mark.parametrize("name", ["rotvec", "ee_rotation_vector", "axis_angle"])
def test_an_array_of_rotation_vectors_is_an_orientation(name, tmp_path):
    arrays = {"time": files.TIME, "ee_pos": files.PATH, name: files.TURNS.as_rotvec()}
    np.savez(tmp_path / "d.npz", **arrays)
    (found,), _ = read_demonstrations([tmp_path / "d.npz"])
    assert np.max(rotation_errors(found, files.TURNS)) < 1e-6


@pytest.mark.parametrize("rows", [3, 4])
def test_matrices_of_a_reflection_are_not_a_pose(rows, tmp_path):
    mirrored = files.matrices()[:, :rows] * [1, 1, -1, 1]
    np.savez(tmp_path / "d.npz", time=files.TIME, pose=mirrored)
    (found,), _ = read_demonstrations([tmp_path / "d.npz"])
    assert found.channels == tuple(f"pose_{i}" for i in range(1, 4 * rows + 1))


@pytest.mark.parametrize(
    ("header", "has_position"),
    [
        ("fx,fy,fz,tx,ty,tz", False),
        ("ft_Fx,ft_Fy,ft_Fz,ft_Tx,ft_Ty,ft_Tz", False),
        ("F_x,F_y,F_z,T_x,T_y,T_z,x,y,z", True),
        ("fx,fy,fz,tx,ty,tz,qx,qy,qz,qw", True),  # The position of a pose.
        ("fx,fy,fz,tx,ty,tz,rx,ry,rz", True),
        ("fx,fy,fz,tx,ty,tz,roll,pitch,yaw", True),
        ("fx,fy,fz,tx,ty,tz,A,B,C", True),
        ("fx,fy,fz,tx [m],ty [m],tz [m]", True),
        ("ft_fx,ft_fy,ft_fz,ft_tx,ft_ty,ft_tz,tool_tx,tool_ty,tool_tz", True),
    ],
)
def test_columns_t_beside_a_force_are_a_torque(header, has_position, tmp_path):
    names = header.split(",")
    values = [files.PATH.T[k % 3] for k in range(6)]
    values += [files.PATH.T[k] + 1 for k in range(3) if "x" in names]
    values += [0 * files.TIME + (k == 3) for k in range(len(names) - len(values))]
    text = files.lines(files.TIME, *values, header=f"time,{header}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert ({"x", "y", "z"} <= set(found.channels)) == has_position
    if "x" in names:
        assert_allclose(found.select(["x", "y", "z"]).values, files.PATH + 1)


@pytest.mark.parametrize(
    ("header", "newtons"),
    [
        ("fx [N],fy [N],fz [N]", 1),
        ("Force X (Newtons),Force Y (Newtons),Force Z (Newtons)", 1),
        ("fx_N,fy_N,fz_N", 1),
        ("netft_x,netft_y,netft_z", 1),
        ("F_tip_x,F_tip_y,F_tip_z", 1),
        ("Ftool_x,Ftool_y,Ftool_z", 1),
        ("fx [kN],fy [kN],fz [kN]", 1000),
        ("fx [mN],fy [mN],fz [mN]", 0.001),
        ("fx [kgf],fy [kgf],fz [kgf]", 9.80665),
        ("Fx (lbf),Fy (lbf),Fz (lbf)", 4.4482216),
    ],
)
def test_forces_are_converted_to_newtons(header, newtons, tmp_path):
    text = files.lines(
        files.TIME, *files.PATH.T, *files.FORCE.T, header=f"time,x,y,z,{header}"
    )
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert_allclose(forces(found), newtons * files.FORCE)
    assert found.select(FORCE_COMPONENTS).units == ("N",) * 3


@pytest.mark.parametrize(
    "form",
    ["f_ee_{}", "fbase_{}", "ftip_{}", "f_hand_{}", "red_dot_{}", "ftool_{} [m]"],
)
def test_a_position_may_have_a_name_with_f_or_dot(form, tmp_path):
    header = ",".join(form.format(axis) for axis in "xyz")
    text = files.xyz(header=f"time,{header}")
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert found.channels == ("x", "y", "z")
    assert_allclose(found.values, files.PATH)


@pytest.mark.parametrize(
    "header", ["time,x,y,z,normal_force\ns,m,m,m,kN", "time,x,y,z,normal_force [kN]"]
)
def test_a_normal_force_is_converted_to_newtons(header, tmp_path):
    force = files.FORCE[:, 2]
    text = files.lines(files.TIME, *files.PATH.T, force, header=header)
    (found,), _ = read_demonstrations([files.write(tmp_path, text).path])
    assert (found.channels[3], found.units[3]) == ("force", "N")
    assert_allclose(found.values[:, 3], 1000 * force)
