"""Writers of one recording in many file formats.

Each gets a folder and returns the file, and the options that it needs.
"""

import gzip
import json
import pickle
import zipfile
from collections import namedtuple
from datetime import datetime, timedelta
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

Written = namedtuple("Written", "path options", defaults=({},))

RATE = 50
TIME = np.arange(400) / RATE
PATH = 0.2 * np.column_stack(
    [np.sin(2 * TIME), np.cos(1.5 * TIME), 0.1 * np.sin(TIME) ** 2]
)
# It passes 180 degrees, and its quaternions change their signs now and then.
TURNS = Rotation.from_rotvec(np.outer(2 + 1.5 * np.sin(2 * TIME), [0, 0, 1]))
QUATERNIONS = TURNS.as_quat() * np.where(TIME % 2 < 1, 1, -1)[:, None]
JOINTS = [0, -0.8, 0, -2.3, 0, 1.6, 0.8] + 0.2 * np.sin(np.outer(TIME, np.arange(1, 8)))
STAMPS = 1_700_000_000_000_000_000 + np.round(TIME * 1e9).astype(np.int64)


SWAPPED = str.maketrans(",.", ".,")


def write(folder, text, name="d.csv", encoding="utf-8", **options):
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return Written(path, options)


def lines(*columns, delimiter=",", header=None, form=repr):
    """Return a table, its numbers in full."""
    rows = [
        delimiter.join(form(float(v)) if isinstance(v, float) else str(v) for v in row)
        for row in zip(*columns, strict=True)
    ]
    return "\n".join([*([header] if header is not None else []), *rows]) + "\n"


def xyz(time=TIME, path=PATH, **options):
    return lines(time, *path.T, **options)


def german(number):
    return repr(number).replace(".", ",")


# Tables ---------------------------------------------------------------------


def plain(folder):
    return write(folder, xyz(header="time,x,y,z"))


def zeros_at_the_end(folder):
    """As a logger that lost its power leaves them, after an incomplete line."""
    return write(folder, xyz(header="time,x,y,z") + "8.0,0.1" + 4096 * "\0")


def units_in_brackets(folder):
    return write(folder, xyz(path=1e3 * PATH, header="Time [s],x [mm],y [mm],z [mm]"))


def units_in_full(folder):
    header = "Time (Seconds),X (Millimeters),Y (Millimeters),Z (Millimeters)"
    return write(folder, xyz(path=1e3 * PATH, header=header))


def pandas_index(folder):
    counts = range(len(TIME))
    return write(folder, lines(counts, TIME, *PATH.T, header=",time,x,y,z"))


def pandas_time_index(folder):
    return write(folder, xyz(header=",x,y,z"))


def pandas_dates(folder):
    dates = np.datetime_as_string(STAMPS.astype("datetime64[ns]"), unit="us")
    dates = [f"{d.replace('T', ' ')}+00:00" for d in dates]
    return write(folder, lines(dates, *PATH.T, header="datetime,x,y,z"))


def header_of_savetxt(folder):
    """Commas in the header, in another order of the axes, and spaces in the rows."""
    columns = lines(TIME, *PATH.T[::-1], delimiter=" ", header="# t,z,y,x")
    return write(folder, columns, "d.txt", columns="x=x,y=y,z=z")


def end_effector(folder):
    return write(folder, xyz(header="time,eef_x,eef_y,eef_z"))


def words_that_begin_later(folder):
    states = ["", *["0"] * 19, *["wiping"] * (len(TIME) - 20)]
    return write(folder, lines(TIME, states, *PATH.T, header="time,state,x,y,z"))


def columns_of_words_that_begin_later(folder):
    actions, hands = (["", *[word] * (len(TIME) - 1)] for word in ("wiping", "right"))
    header = "time,x,y,z,action,hand,target"
    return write(folder, lines(TIME, *PATH.T, actions, hands, hands, header=header))


def two_topics_in_a_table(folder):
    """As of PlotJuggler: joints and positions in different rows."""
    names = [f"/joint_states/panda_joint{i}/position" for i in range(1, 8)]
    names += [f"/pose/position/{axis}" for axis in "xyz"]
    rows = [",".join(["__time", *names])]
    for t, q, p in zip(TIME.tolist(), JOINTS.tolist(), PATH.tolist(), strict=True):
        rows.append(",".join(map(repr, [t + 0.004, *q])) + ",,,")
        rows.append(f"{t!r},,,,,,,," + ",".join(map(repr, p)))
    return write(folder, "\n".join(rows))


def position_of_two_topics(folder):
    sources = ",".join(f"{axis}=/pose/position/{axis}" for axis in "xyz")
    return two_topics_in_a_table(folder)._replace(options={"columns": sources})


def stamps_without_names(folder):
    """As of `ros2 topic echo --csv`."""
    whole, rest = STAMPS // 10**9, STAMPS % 10**9
    frame = ["base"] * len(TIME)
    return write(folder, lines(whole, rest, frame, *PATH.T), columns="x=4,y=5,z=6")


def poses_behind_stamps_without_names(folder):
    whole, rest = STAMPS // 10**9, STAMPS % 10**9
    frame = ["base"] * len(TIME)
    return write(folder, lines(whole, rest, frame, *PATH.T, *QUATERNIONS.T))


def stamps_beside_the_time(folder):
    columns = lines(
        TIME, STAMPS // 10**9, STAMPS % 10**9, *PATH.T, header="time,sa,sb,x,y,z"
    )
    return write(folder, columns)


def compact_dates(folder):
    dates = [
        (datetime(2024, 5, 1, 11, 59, 57) + timedelta(seconds=t)).strftime(
            "%Y%m%d_%H%M%S.%f"
        )
        for t in TIME.tolist()
    ]
    return write(folder, lines(dates, *PATH.T, header="time,x,y,z"))


def vectors_over_several_lines(folder):
    """As pandas writes NumPy arrays."""
    rows = [
        f'{t!r},"[ {x!r}  {y!r}\n  {z!r}]"'
        for t, (x, y, z) in zip(TIME.tolist(), PATH.tolist(), strict=True)
    ]
    return write(folder, "\n".join(["time,position", *rows]))


def lists_between_semicolons(folder):
    rows = [f"{t!r};{p}" for t, p in zip(TIME.tolist(), PATH.tolist(), strict=True)]
    return write(folder, "\n".join(["time;position", *rows]))


def number_after_a_list(folder):
    rows = [
        f'{t!r},"{q}",{x!r},{y!r},{z!r}'
        for t, q, (x, y, z) in zip(
            TIME.tolist(), JOINTS.tolist(), PATH.tolist(), strict=True
        )
    ]
    columns = "\n".join(["time,joints,a,b,c", *rows])
    return write(folder, columns, columns="x=3,y=4,z=5")


def yaml_of_joints(folder):
    rows = "".join(f"- {t!r}\n- {t!r}\n- {t!r}\n" for t in TIME.tolist())
    return write(folder, rows, "d.yml")


def axis_before_the_word(folder):
    return write(folder, xyz(header="time,xPos,Y Position (m),z-axis"))


def units_in_the_singular(folder):
    header = "time,x [millimeter],y [millimeter],z [millimeter]"
    return write(folder, xyz(path=1e3 * PATH, header=header))


def number_after_a_column_of_words(folder):
    words = ["tool"] * len(TIME)
    columns = lines(words, TIME, *PATH.T, header="who,time,a,b,c")
    return write(folder, columns, columns="x=3,y=4,z=5")


def qualisys(folder):
    """Settings of two cells before the header, which ends with a tab."""
    settings = (
        f"NO_OF_FRAMES\t{len(TIME)}\nFREQUENCY\t{RATE}\n"
        "TIME_STAMP\t2026-01-19, 10:19:43.755\t2063631.96\nMARKER_NAMES\tWand\n"
    )
    header = "Frame\tTime\tWand X\tWand Y\tWand Z\t"
    columns = lines(
        range(1, len(TIME) + 1), TIME, *1e3 * PATH.T, header=header, delimiter="\t"
    )
    return write(folder, settings + columns, "d.tsv")


def qualisys_without_names(folder):
    """Only the coordinates of the marker below the settings."""
    settings = f"NO_OF_FRAMES\t{len(TIME)}\nFREQUENCY\t{RATE}\nMARKER_NAMES\tWand\n"
    return write(folder, settings + lines(*1e3 * PATH.T, delimiter="\t"), "d.tsv")


def qualisys_bodies(folder, turns=TURNS, *, by_rows=False):
    """Position, roll, pitch, yaw, a residual and a matrix of a rigid body."""
    settings = f"FILE_VERSION\t2.0.0\nFREQUENCY\t{RATE}\nBODY_NAMES\tTool\n"
    names = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual"]
    names += [f"Rot[{i}]" for i in range(9)]
    angles = turns.as_euler("XYZ", degrees=True)
    matrices = (turns if by_rows else turns.inv()).as_matrix().reshape(-1, 9)
    columns = lines(
        *1e3 * PATH.T,
        *angles.T,
        0 * TIME,
        *matrices.T,
        header="\t".join(names),
        delimiter="\t",
    )
    return write(folder, settings + columns, "d.tsv")


def hands_in_turn(folder):
    """Rows of two hands in turn, with a time of their own each."""
    hands = np.tile(["left", "right"], len(TIME))
    path = np.repeat(PATH, 2, axis=0)
    path[1::2] += 1.0
    columns = lines(hands, np.repeat(TIME, 2), *path.T, header="hand,time,x,y,z")
    return write(folder, columns, topic="left")


def numbered_sensors_in_turn(folder):
    numbers = np.tile([3, 7], len(TIME))
    path = np.repeat(PATH, 2, axis=0)
    path[0::2] += 1.0
    columns = lines(numbers, np.repeat(TIME, 2), *path.T, header="sensor_id,t,x,y,z")
    return write(folder, columns, topic="7")


def sensors_in_turn_without_a_choice(folder):
    return numbered_sensors_in_turn(folder)._replace(options={})


def _landmarks_of_hands():
    """Return the rows of 21 landmarks of two hands, of which one is on the path."""
    return [
        {"hand": hand, "landmark": k, "t": t, **dict(zip("xyz", place, strict=True))}
        for t, point in zip(TIME.tolist(), PATH, strict=True)
        for i, hand in enumerate(("Left", "Right"))
        for k in range(21)
        for place in [(point + 0.02 * (k - 8) + 0.4 * i).tolist()]
    ]


def landmarks_of_hands(folder):
    rows = _landmarks_of_hands()
    columns = zip(*(row.values() for row in rows), strict=True)
    text = lines(*columns, header=",".join(rows[0]))
    return write(folder, text, topic="Left,8")


def json_of_landmarks_of_hands(folder):
    text = "\n".join(map(json.dumps, _landmarks_of_hands()))
    return write(folder, text, "d.jsonl", topic="8,Left")


def _points_of_a_hand():
    """Return the positions (400, 21, 3) of landmarks of a hand, of which 8 is on the path."""
    return PATH[:, None] + 0.02 * (np.arange(21) - 8)[:, None]


def json_of_landmarks_in_frames(folder):
    frames = [
        {
            "timestamp": t,
            "landmarks": [dict(zip("xyz", p, strict=True)) for p in points],
        }
        for t, points in zip(TIME.tolist(), _points_of_a_hand().tolist(), strict=True)
    ]
    columns = ",".join(f"{axis}=landmarks.8.{axis}" for axis in "xyz")
    return write(folder, json.dumps(frames), "d.json", columns=columns)


def json_of_arrays_of_landmarks(folder):
    frames = [
        {"t": t, "hands": [{"label": "Left", "landmarks": points}]}
        for t, points in zip(TIME.tolist(), _points_of_a_hand().tolist(), strict=True)
    ]
    columns = ",".join(f"{axis}=hands.0.landmarks_8_{axis}" for axis in "xyz")
    return write(folder, json.dumps({"frames": frames}), "d.json", columns=columns)


def npz_of_landmarks(folder):
    points, turns = _points_of_a_hand(), TURNS.as_matrix()
    np.savez(folder / "d.npz", timestamps=TIME, landmarks=points, hand_rotation=turns)
    columns = ",".join(f"{axis}=landmarks_8_{axis}" for axis in "xyz")
    return Written(folder / "d.npz", {"columns": columns})


def landmarks_without_a_choice(folder):
    return landmarks_of_hands(folder)._replace(options={})


def landmarks_of_both_hands(folder):
    return landmarks_of_hands(folder)._replace(options={"topic": "8"})


def landmarks_of_an_unknown_label(folder):
    return landmarks_of_hands(folder)._replace(options={"topic": "8,Left,99"})


def json_of_landmarks_of_both_hands(folder):
    return json_of_landmarks_of_hands(folder)._replace(options={"topic": "8"})


def rostopic_echo_in_yaml(folder):
    """Messages as ROS prints them, one that was lost, and one that was cut off."""
    messages = [
        f"header: \n  seq: {i}\n  stamp: \n    secs: {stamp // 10**9}\n"
        f'    nsecs: {stamp % 10**9:9d}\n  frame_id: "base"\npose: \n  position: \n'
        + "".join(f"    {a}: {v!r}\n" for a, v in zip("xyz", place, strict=True))
        + "  orientation: \n"
        + "".join(f"    {a}: {v!r}\n" for a, v in zip("xyzw", turn, strict=True))
        + "---\n"
        for i, (stamp, place, turn) in enumerate(
            zip(STAMPS.tolist(), PATH.tolist(), QUATERNIONS.tolist(), strict=True)
        )
    ]
    lost = "A message was lost!!!\n\ttotal count change:1\n---\n"
    return write(folder, "".join([*messages[:9], lost, *messages[9:], "header: {"]))


def header_in_yaml(stamp):
    sec, nanosec = divmod(stamp, 10**9)
    return f"header:\n  stamp:\n    sec: {sec}\n    nanosec: {nanosec}\n"


def ros2_topic_echo_of_joints(folder):
    """Numbers such as 1e-05, which YAML takes for words."""
    angles = np.where(np.arange(7) == 2, 1e-5 * (1 + JOINTS), JOINTS)
    messages = [
        f"{header_in_yaml(stamp)}  frame_id: ''\nname:\n"
        + "".join(f"- joint_{i}\n" for i in range(1, 8))
        + "position:\n"
        + "".join(f"- {angle:.0e}\n" for angle in q)
        + "velocity: []\neffort: []\n---\n"
        for stamp, q in zip(STAMPS.tolist(), angles.tolist(), strict=True)
    ]
    return write(folder, "".join(messages), "d.yaml")


def yaml_with_aliases(folder):
    return write(folder, "a: &-a [1, 2]\nb: [*-a, *-a]\n", "d.yaml")


def deep_yaml(folder):
    return write(folder, 500_000 * "{ ", "d.yaml")


def deep_keys_in_yaml(folder):
    return write(folder, 90 * "? " + "\n", "d.yaml")


def table_that_is_named_yaml(folder):
    return write(folder, xyz(header="time,x,y,z"), "d.yaml")


def json_lines_that_are_named_yaml(folder):
    return write(folder, json_lines(folder).path.read_text(), "d.yaml")


def yaml_documents(folder):
    """With comments, tags, and values in flow style."""
    documents = [
        f"--- # {i}\n!sample\ntime: {t!r}\nplace: {{x: {x!r}, y: {y!r}, z: {z!r}}}\n"
        "note: |\n  - *no* alias\n"
        for i, (t, (x, y, z)) in enumerate(
            zip(TIME.tolist(), PATH.tolist(), strict=True)
        )
    ]
    return write(folder, "".join(documents), "d.yaml")


def odometry_in_yaml(folder):
    """Each message has a list of 36 covariances."""
    messages = [
        f"{header_in_yaml(stamp)}pose:\n  pose:\n    position:\n"
        + "".join(f"      {a}: {v!r}\n" for a, v in zip("xyz", place, strict=True))
        + "  covariance:\n"
        + 36 * "  - .nan\n"
        + "---\n"
        for stamp, place in zip(STAMPS.tolist(), PATH.tolist(), strict=True)
    ]
    return write(folder, "".join(messages), "d.txt")


def broken_yaml(folder):
    return write(folder, "{[", "d.yaml")


def bursts(folder):
    """Twelve samples every 0.24 s, as a network delivers them."""
    k = np.arange(len(TIME))
    return write(folder, xyz(k // 12 * 0.24 + k % 12 * 1e-4, header="time,x,y,z"))


def short_t(folder):
    return write(folder, xyz(header="t,x,y,z"))


def capitals(folder):
    return write(folder, xyz(header="Time,X,Y,Z"), "RUN 3.CSV")


def semicolons(folder):
    return write(folder, xyz(header="time;x;y;z", delimiter=";"))


def decimal_commas(folder):
    text = xyz(header="Zeit;x;y;z", delimiter=";", form=german)
    return write(folder, text, columns="time=Zeit,x=x,y=y,z=z")


def tabs(folder):
    return write(folder, xyz(header="time\tx\ty\tz", delimiter="\t"), "d.tsv")


def spaces(folder):
    np.savetxt(folder / "d.txt", np.column_stack([TIME, PATH]), header="time x y z")
    return Written(folder / "d.txt")


def no_header(folder):
    return write(folder, xyz(), "d.dat")


def comments(folder):
    text = "# recorded by hand\n# on a Monday\n" + xyz(header="time,x,y,z")
    return write(folder, text.replace("\n0.02,", "\n# a remark\n\n0.02,"))


def preamble_and_units_below(folder):
    text = "Motion capture,1.2\nRate,50\n\nTime,X,Y,Z\ns,mm,mm,mm\n"
    return write(folder, text + xyz(path=1e3 * PATH))


def spreadsheet(folder):
    text = "sep=;\n" + xyz(header="time;x;y;z;", delimiter=";")
    text = text.replace("\n", ";\n").replace("sep=;;", "sep=;").replace("z;;", "z;")
    return write(folder, text.replace("\n", "\r\n"), encoding="utf-16")


def old_spreadsheet(folder):
    text = xyz(header="time;x;y;z;größe", delimiter=";").replace("\n", ";0\n")
    text = text.replace("größe;0", "größe")
    return write(folder, text, encoding="cp1252", columns="time=time,x=x,y=y,z=z")


def milliseconds(folder):
    return write(folder, xyz(1e3 * TIME, header="t,x,y,z"))


def milliseconds_in_the_name(folder):
    return write(folder, xyz(1e3 * TIME, header="time_ms,x,y,z"))


def nanoseconds(folder):
    return write(folder, xyz(STAMPS, header="timestamp,x,y,z"))


def millimetres(folder):
    return write(folder, xyz(path=1e3 * PATH, header="time,x,y,z"), unit="mm")


def columns_by_name(folder):
    other = np.cos(TIME)
    text = lines(other, *PATH.T, STAMPS // 10**6, header="foo,a,b,c,when")
    return write(folder, text, columns="time=when [ms], x=a [m], y=b, z=c")


def columns_by_number(folder):
    text = lines(*PATH.T, TIME)
    return write(folder, text, columns="time=4,x=1,y=2,z=3")


def rate_instead_of_time(folder):
    return write(folder, lines(*PATH.T, header="x,y,z"), **{"sample-rate": RATE})


def samples_counted(folder):
    counts = range(len(TIME))
    text = lines(counts, *PATH.T, header="frame,x,y,z")
    return write(folder, text, **{"sample-rate": RATE})


def repeated_stamps(folder):
    twice = np.sort(np.r_[np.arange(400), 17, 200])
    return write(folder, xyz(TIME[twice], PATH[twice], header="time,x,y,z"))


def gaps_between_topics(folder):
    rows = xyz(header="__time,/a/x,/a/y,/a/z").split("\n")
    mixed = [row for r in rows[1:-1] for row in (r + ",", f"{r.split(',')[0]},,,,7")]
    header = rows[0] + ",/b"
    options = {"columns": "time=__time,x=/a/x,y=/a/y,z=/a/z"}
    return write(folder, "\n".join([header, *mixed]), **options)


def words_beside(folder):
    words = ["wiping"] * len(TIME)
    return write(folder, lines(TIME, words, *PATH.T, header="time,task,x,y,z"))


def ros_topic_echo(folder):
    header = (
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
        + ",".join(
            [
                *(f"field.pose.position.{a}" for a in "xyz"),
                *(f"field.pose.orientation.{a}" for a in "xyzw"),
            ]
        )
    )
    frames = ["base"] * len(TIME)
    columns = (STAMPS + 10**6, range(400), STAMPS, frames, *PATH.T, *QUATERNIONS.T)
    return write(folder, lines(*columns, header=header))


def bagpy(folder):
    header = "Time,header.seq,header.stamp.secs,header.stamp.nsecs,header.frame_id," + (
        ",".join(
            [
                *(f"transform.translation.{a}" for a in "xyz"),
                *(f"transform.rotation.{a}" for a in "xyzw"),
            ]
        )
    )
    whole, rest = STAMPS // 10**9, STAMPS % 10**9
    frames = ["base"] * len(TIME)
    columns = (TIME + 1e9, range(400), whole, rest, frames, *PATH.T, *QUATERNIONS.T)
    return write(folder, lines(*columns, header=header))


def tum(folder):
    header = "# timestamp tx ty tz qx qy qz qw"
    text = lines(TIME, *PATH.T, *QUATERNIONS.T, header=header, delimiter=" ")
    return write(folder, text, "d.txt")


def time_by_its_unit(folder):
    return write(folder, xyz(header="Zeit [s],x,y,z"))


def rows_twice(folder):
    """Write a table in which every fourth row is there twice."""
    twice = np.sort(np.r_[np.arange(400), np.arange(0, 400, 4)])
    return write(folder, xyz(TIME[twice], PATH[twice], header="time,x,y,z"))


def rows_out_of_order(folder):
    """Write a table whose rows are swapped two by two."""
    order = [0, *(np.arange(1, 399).reshape(-1, 2)[:, ::-1].ravel()), 399]
    return write(folder, xyz(TIME[order], PATH[order], header="time,x,y,z"))


def columns_by_the_names_of_channels(folder):
    """Write numbers without names: `inspect` calls them c0 to c3."""
    text = lines(TIME, np.cos(TIME), *PATH.T)
    return write(folder, text, columns="x=c1,y=c2,z=c3")


def dates_by_day(folder):
    """Write German dates, that begin shortly before midnight."""
    moments = [datetime(2024, 3, 31, 23, 59, 58) + timedelta(seconds=t) for t in TIME]
    dates = [f"{m:%d.%m.%Y %H:%M:%S},{m.microsecond // 1000:03d}" for m in moments]
    text = lines(dates, *PATH.T, delimiter=";", header="Zeit;x;y;z", form=german)
    return write(folder, text)


def dates_by_month(folder):
    moments = [datetime(2024, 3, 25, 12, 59, 58) + timedelta(seconds=t) for t in TIME]
    dates = [f"{m:%m/%d/%Y %I:%M:%S.%f %p}" for m in moments]
    return write(folder, lines(dates, *PATH.T, header="Time,x,y,z"))


def points_between_thousands(folder):
    """Write micrometres as `12.345,6`."""
    rows = [
        [german(float(t)), *(f"{1e6 * v:,.9f}".translate(SWAPPED) for v in p)]
        for t, p in zip(TIME, PATH, strict=True)
    ]
    text = "\n".join(["time;x (UM);y (UM);z (UM)", *map(";".join, rows)])
    return write(folder, text + "\n")


def units_in_words(folder):
    return write(
        folder, xyz(path=1e3 * PATH, header="time in s,x in mm,y in mm,z in mm")
    )


def header_of_numbers(folder):
    return write(folder, xyz(header="0,1,2,3"))


def header_of_a_time_and_numbers(folder):
    return write(folder, xyz(header="time,0,1,2"))


def header_of_a_time_in_milliseconds_and_numbers(folder):
    time = np.round(1e3 * TIME)
    return write(folder, xyz(time, header="t [ms];1;2;3", delimiter=";"))


def list_in_each_line(folder):
    """Positions as Python prints them."""
    text = "\n".join(map(str, np.column_stack([TIME, PATH]).tolist()))
    return write(folder, text, "d.txt")


def index_of_pandas_above_numbers(folder):
    text = lines(range(len(TIME)), TIME, *PATH.T, header=",0,1,2,3")
    return write(folder, text)


def measured_and_commanded(folder):
    names = [f"{kind}_{axis}" for kind in ("target", "actual") for axis in "xyz"]
    columns = (TIME, *(PATH + 0.01).T, *PATH.T)
    return write(folder, lines(*columns, header=",".join(["time", *names])))


def numbered(name, count, first=0):
    return [f"{name}{i}" for i in range(first, first + count)]


def positions_by_number(folder):
    names = [f"{name} [mm]" for name in numbered("ee_pos_", 3)]
    text = xyz(path=1e3 * PATH, header=",".join(["time", *names]))
    return write(folder, text, unit="mm")


def matrices():
    X = np.tile(np.eye(4), (len(TIME), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = TURNS.as_matrix(), PATH
    return X


def libfranka(folder, name="O_T_EE_{}", *others):
    """Write the matrices of a Franka arm by columns."""
    poses = np.swapaxes(matrices(), 1, 2).reshape(-1, 16)
    names = [n.format(i) for n in (name, *others) for i in range(16)]
    columns = (TIME, *poses.T, *(c for _ in others for c in poses[::-1].T))
    return write(folder, lines(*columns, header=",".join(["time", *names])))


def libfranka_desired_too(folder):
    return libfranka(folder, "O_T_EE[{}]", "O_T_EE_d[{}]")


def rostopic_of_franka(folder):
    return libfranka(folder, "field.O_T_EE{}")


def npz_of_matrices(folder):
    np.savez(folder / "d.npz", time=TIME, pose=matrices())
    return Written(folder / "d.npz")


def npz_of_matrices_without_the_last_row(folder):
    np.savez(folder / "d.npz", time=TIME, pose=matrices()[:, :3])
    return Written(folder / "d.npz")


def table_of_matrices_without_a_header(folder):
    return write(folder, lines(TIME, *matrices()[:, :3].reshape(-1, 12).T))


def npz_of_poses(folder):
    np.savez(folder / "d.npz", time=TIME, pose=np.hstack([PATH, QUATERNIONS]))
    return Written(folder / "d.npz")


def tum_without_header(folder):
    columns = (TIME, *PATH.T, *QUATERNIONS.T)
    return write(folder, lines(*columns, delimiter=" "), "d.txt")


def quaternion_from_1(folder):
    names = ["time", *"xyz", *numbered("q", 4, 1)]
    columns = (TIME, *PATH.T, *QUATERNIONS.T)
    return write(folder, lines(*columns, header=",".join(names)))


def quaternion_of_one_letter(folder):
    columns = (TIME, *PATH.T, *QUATERNIONS.T)
    return write(folder, lines(*columns, header="time,px,py,pz,ox,oy,oz,ow"))


def quaternion_without_a_word(folder):
    columns = (TIME, *PATH.T, *np.roll(QUATERNIONS, 1, 1).T)
    return write(folder, lines(*columns, header="time,px,py,pz,w,x,y,z"))


def ur_rtde(folder):
    """Write what Universal Robots' recorder writes, rotation vectors among it."""
    names = [
        "timestamp",
        *numbered("actual_q_", 6),
        *numbered("actual_TCP_pose_", 6),
        *numbered("actual_TCP_force_", 6),
        *numbered("target_TCP_pose_", 6),
    ]
    poses = np.hstack([PATH, TURNS.as_rotvec()])
    columns = (*JOINTS[:, :6].T, *poses.T, *(10 * poses).T, *poses[::-1].T)
    text = lines(TIME, *columns, delimiter=" ", header=" ".join(names))
    return write(folder, text)


def joint_states(folder, name, *, joints=7, words=()):
    """Write positions, velocities and efforts of joints, by the names of the columns."""
    kinds = {"position": JOINTS[:, :joints]}
    kinds |= dict.fromkeys(("velocity", "effort"), 0 * JOINTS[:, :joints])
    names = ["%time", *(name.format("name", i) for i in range(len(words)))]
    columns = [STAMPS, *([word] * len(TIME) for word in words)]
    for kind, values in kinds.items():
        names += [name.format(kind, i) for i in range(joints)]
        columns += list(values.T)
    return write(folder, lines(*columns, header=",".join(names)))


def lists_in_cells(folder):
    """Write a table as pandas does whose cells are lists, or arrays without commas."""
    positions = [f'"{p}"' for p in PATH.tolist()]
    quaternions = [f"[{' '.join(map(repr, q))}]" for q in QUATERNIONS.tolist()]
    text = lines(TIME, positions, quaternions, header="time,position,quat")
    return write(folder, text)


def sheet_after_notes(folder):
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["Wiping by hand"])
    sheet = book.create_sheet("run")
    for row in [["time", "x", "y", "z"], *np.column_stack([TIME, PATH]).tolist()]:
        sheet.append(row)
    book.save(folder / "d.xlsx")
    return Written(folder / "d.xlsx")


def npz_with_a_rate(folder):
    np.savez(folder / "d.npz", xyz=PATH.T, dt=1 / RATE)
    return Written(folder / "d.npz")


# Arrays ---------------------------------------------------------------------


def npz_of_the_package(folder):
    from fmp_drake.primitives import Demonstration

    Demonstration(time=TIME, values=PATH).save(folder / "d.npz")
    return Written(folder / "d.npz")


def npz_of_someone(folder):
    np.savez(folder / "d.npz", t=STAMPS, pos=PATH, note="of someone", gains=np.ones(7))
    return Written(folder / "d.npz")


def npz_in_milliseconds(folder):
    np.savez(folder / "d.npz", time=1e3 * TIME, position=PATH)
    return Written(folder / "d.npz")


def npy_with_a_rate(folder):
    np.save(folder / "d.npy", PATH)
    return Written(folder / "d.npy", {"sample-rate": RATE})


def npy_with_times(folder):
    np.save(folder / "d.npy", np.column_stack([TIME, PATH]))
    return Written(folder / "d.npy")


def npy_with_fields(folder):
    kind = [(name, float) for name in ("time", "x", "y", "z")]
    rows = [tuple(row) for row in np.column_stack([TIME, PATH])]
    np.save(folder / "d.npy", np.array(rows, dtype=kind))
    return Written(folder / "d.npy")


def parquet(folder):
    import pyarrow as pa
    from pyarrow.parquet import write_table

    table = {
        "time": STAMPS.astype("datetime64[ns]"),
        **dict(zip("xyz", PATH.T, strict=True)),
    }
    write_table(pa.table(table), folder / "d.parquet")
    return Written(folder / "d.parquet")


# Bags -----------------------------------------------------------------------


@cache
def typestore(ros):
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)


def header(ros, k, stamped=True, start=0):
    types = typestore(ros).types
    sec, nanosec = divmod(int(STAMPS[k]) - start if stamped else 0, 10**9)
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    seq = {"seq": k} if ros == 1 else {}
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **seq)


def pose_stamped(ros, k, **stamp):
    types = typestore(ros).types
    return types["geometry_msgs/msg/PoseStamped"](
        header=header(ros, k, **stamp),
        pose=types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](*PATH[k]),
            orientation=types["geometry_msgs/msg/Quaternion"](*QUATERNIONS[k]),
        ),
    )


def pose_alone(ros, k):
    return pose_stamped(ros, k).pose


def transform_stamped(ros, k):
    types = typestore(ros).types
    return types["geometry_msgs/msg/TransformStamped"](
        header=header(ros, k),
        child_frame_id="tool",
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](*PATH[k]),
            rotation=types["geometry_msgs/msg/Quaternion"](*QUATERNIONS[k]),
        ),
    )


def joint_state(ros, k):
    return typestore(ros).types["sensor_msgs/msg/JointState"](
        header=header(ros, k),
        name=[f"panda_joint{i}" for i in range(1, 8)],
        position=JOINTS[k],
        velocity=np.zeros(7),
        effort=np.zeros(7),
    )


def bag(path, topics, ros=2, storage=None, late=0, slowness=1):
    """Write messages of topics, received 3 ms after their stamps, or never the same.

    There is none where the function of a topic returns None.
    """
    if ros == 1:
        from rosbags.rosbag1 import Writer

        writer = Writer(path)
        raw = typestore(1).serialize_ros1
    else:
        from rosbags.rosbag2 import StoragePlugin, Writer

        writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage])
        raw = typestore(2).serialize_cdr
    with writer:
        for topic, message in topics.items():
            kind = message(0).__msgtype__
            connection = writer.add_connection(topic, kind, typestore=typestore(ros))
            for k in range(len(TIME)):
                receipt = int(STAMPS[0] + slowness * (STAMPS[k] - STAMPS[0])) + late
                if (content := message(k)) is not None:
                    writer.write(connection, receipt, raw(content, kind))
    return path


FORCE = np.column_stack([np.sin(TIME), 2 * np.cos(TIME), -5 - TIME])


def wrench_stamped(ros, k, sign=1, **stamp):
    types = typestore(ros).types
    vector = types["geometry_msgs/msg/Vector3"]
    wrench = types["geometry_msgs/msg/Wrench"](
        force=vector(*(sign * FORCE[k])), torque=vector(0.1, 0.2, 0.3)
    )
    return types["geometry_msgs/msg/WrenchStamped"](
        header=header(ros, k, **stamp), wrench=wrench
    )


def wrench_alone(ros, k):
    return wrench_stamped(ros, k).wrench


def ros1_poses(folder):
    topics = {"/pose": lambda k: pose_stamped(1, k)}
    return Written(bag(folder / "d.bag", topics, ros=1, late=3 * 10**6))


def ros1_one_topic_of_two(folder):
    topics = {
        "/a": lambda k: pose_stamped(1, len(TIME) - 1 - k),
        "/b": lambda k: pose_stamped(1, k),
    }
    return Written(bag(folder / "d.bag", topics, ros=1), {"topic": "/b"})


def ros2_transforms(folder):
    topics = {"/tool": lambda k: transform_stamped(2, k)}
    return Written(bag(folder / "bag", topics, storage="SQLITE3"))


def mcap_file(folder):
    topics = {
        "/pose": lambda k: pose_stamped(2, k),
        "/joints": lambda k: joint_state(2, k),
    }
    bag(folder / "bag", topics, storage="MCAP")
    return Written(folder / "bag" / "bag.mcap")


def bag_of_simulated_time(folder):
    """Its clock begins at 0, and runs at twice the speed of the receiver's."""
    topics = {"/pose": lambda k: pose_stamped(1, k, start=int(STAMPS[0]))}
    return Written(bag(folder / "d.bag", topics, ros=1, slowness=2))


def ros2_without_stamps(folder):
    topics = {"/pose": lambda k: pose_stamped(2, k, stamped=False)}
    return Written(bag(folder / "bag", topics, storage="SQLITE3"))


def ros2_joints(folder):
    topics = {"/joint_states": lambda k: joint_state(2, k)}
    return Written(bag(folder / "bag", topics, storage="MCAP"))


def ros1_two_poses(folder):
    topics = {
        "/left": lambda k: pose_stamped(1, k),
        "/right": lambda k: pose_stamped(1, k),
    }
    return Written(bag(folder / "d.bag", topics, ros=1))


@cache
def franka_type(kind, fields):
    from rosbags.typesys import get_types_from_msg

    store = typestore(1 if kind == "FrankaState" else 2)
    kind = f"franka_msgs/msg/{kind}"
    store.register(get_types_from_msg(f"std_msgs/Header header\n{fields}", kind))
    return store.types[kind]


def franka_state(k):
    """Return the state of a Franka arm, its pose a matrix by columns."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = TURNS[k].as_matrix(), PATH[k]
    wrench = np.r_[FORCE[k], 0.1, 0.2, 0.3]
    fields = "float64[16] O_T_EE\nfloat64[7] q\nfloat64[6] O_F_ext_hat_K"
    return franka_type("FrankaState", fields)(
        header=header(1, k), O_T_EE=X.T.ravel(), q=JOINTS[k], O_F_ext_hat_K=wrench
    )


def franka_robot_state(k):
    """Return the state of a Franka arm in ROS 2, with a force in another frame."""
    wrenches = {"k": wrench_stamped(2, k, sign=3), "o": wrench_stamped(2, k)}
    messages = {
        "sensor_msgs/JointState measured_joint_state": joint_state(2, k),
        **{
            f"geometry_msgs/WrenchStamped {frame}_f_ext_hat_k": wrench
            for frame, wrench in wrenches.items()
        },
        "geometry_msgs/PoseStamped f_t_ee": pose_stamped(2, 0),
        "geometry_msgs/PoseStamped o_t_ee": pose_stamped(2, k),
    }
    values = {field.split()[1]: message for field, message in messages.items()}
    kind = franka_type("FrankaRobotState", "\n".join(messages))
    return kind(header=header(2, k), **values)


def ros1_out_of_order(folder):
    """Write a bag of poses, two and two of them in the wrong order."""
    order = [0, *(np.arange(1, 399).reshape(-1, 2)[:, ::-1].ravel()), 399]
    topics = {"/pose": lambda k: pose_stamped(1, order[k])}
    return Written(bag(folder / "d.bag", topics, ros=1))


def npz_of_one_array(folder):
    np.savez(folder / "d.npz", np.column_stack([TIME, PATH]))
    return Written(folder / "d.npz")


def npz_by_columns(folder):
    np.savez(folder / "d.npz", time=TIME, position=np.fliplr(PATH))
    chosen = "x=position_z,y=position_y,z=position_x"
    return Written(folder / "d.npz", {"columns": chosen})


def two_hands(folder):
    names = [f"{hand}_{axis}" for hand in ("left", "right") for axis in "xyz"]
    columns = (TIME, *PATH.T, *PATH.T)
    return write(folder, lines(*columns, header=",".join(["time", *names])))


def two_arms_one_force(folder):
    arms = [("left", "t"), ("right", "t"), ("right", "f")]
    names = [f"{arm}_{kind}{axis}" for arm, kind in arms for axis in "xyz"]
    columns = (TIME, *PATH.T, *PATH.T, *PATH.T)
    return write(folder, lines(*columns, header=",".join(["time", *names])))


def left_and_right(folder):
    names = [f"{hand}_{axis}" for axis in "xyz" for hand in "lr"]
    columns = (TIME, *np.repeat(PATH.T, 2, axis=0))
    return write(folder, lines(*columns, header=",".join(["time", *names])))


def two_arms(folder):
    names = [f"{hand}_arm_q{i}" for hand in ("left", "right") for i in range(1, 8)]
    columns = (TIME, *np.tile(PATH[:, :1], 14).T)
    return write(folder, lines(*columns, header=",".join(["time", *names])))


def ros1_cut(folder):
    path = ros1_poses(folder).path
    path.write_bytes(path.read_bytes()[:20_000])
    return Written(path)


# Datasets -------------------------------------------------------------------


def dataset(folder, version, names, values, **kept):
    """Write two episodes, the second a shifted copy of the first."""
    import pyarrow as pa
    from pyarrow.parquet import write_table

    folder = folder / "dataset"
    (folder / "meta").mkdir(parents=True)
    state = {"dtype": "float64", "shape": [values.shape[1]], "names": names}
    info = {
        "codebase_version": version,
        "fps": RATE,
        "features": {"observation.state": state},
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info | kept))
    tables = [
        pa.table(
            {
                "observation.state": list(values + 0.1 * episode),
                "timestamp": TIME,
                "frame_index": np.arange(len(TIME)),
                "episode_index": np.full(len(TIME), episode),
            }
        )
        for episode in range(2)
    ]
    chunk = folder / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    if version == "v3.0":
        write_table(pa.concat_tables(tables), chunk / "file-000.parquet")
    else:
        for i, table in enumerate(tables):
            write_table(table, chunk / f"episode_{i:06d}.parquet")
    return Written(folder)


def lerobot_2(folder):
    return dataset(folder, "v2.1", ["x", "y", "z"], PATH)


def lerobot_3(folder):
    return dataset(folder, "v3.0", {"motors": ["x", "y", "z"]}, PATH)


def lerobot_without_names(folder):
    return dataset(folder, "v3.0", None, JOINTS)


# What cannot be read --------------------------------------------------------


def bytes_of(name, content):
    def make(folder):
        (folder / name).write_bytes(content)
        return Written(folder / name)

    return make


def hollow_archive(folder):
    """An archive of 1 MB that would take 288 MB."""
    with zipfile.ZipFile(
        folder / "d.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1
    ) as archive:
        for name in ("time", "position"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array_header_1_0(
                    stream,
                    {"descr": "<f8", "fortran_order": False, "shape": (18 * 2**20,)},
                )
                for _ in range(144):
                    stream.write(bytes(2**20))
    return Written(folder / "d.npz")


def boasting_archive(folder):
    """An array whose header claims a terabyte."""
    with zipfile.ZipFile(folder / "d.npz", "w") as archive:
        for name in ("time", "position"):
            with archive.open(f"{name}.npy", "w") as stream:
                np.lib.format.write_array_header_1_0(
                    stream,
                    {"descr": "<f8", "fortran_order": False, "shape": (2**37,)},
                )
    return Written(folder / "d.npz")


def objects(folder):
    np.save(folder / "d.npy", np.array([{"x": 1}], dtype=object), allow_pickle=True)
    return Written(folder / "d.npy")


def empty_array(folder):
    np.save(folder / "d.npy", np.zeros(0))
    return Written(folder / "d.npy")


def pickled(folder):
    (folder / "d.pkl").write_bytes(pickle.dumps(PATH))
    return Written(folder / "d.pkl")


def pickled_as_text(folder):
    (folder / "d.pkl").write_bytes(pickle.dumps(PATH.tolist(), protocol=0))
    return Written(folder / "d.pkl")


def excel(folder):
    with zipfile.ZipFile(folder / "d.csv", "w") as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
    return Written(folder / "d.csv")


def windows(folder):
    np.save(folder / "d.npy", np.zeros((5, 3, 3, 120)))
    return Written(folder / "d.npy", {"sample-rate": RATE})


# Motion capture -------------------------------------------------------------


OPTITRACK = (
    "Format Version,1.23,Take Name,wipe,Capture Frame Rate,50.000000,Export Frame Rate,"
    "50.000000,Total Frames in Take,400,Rotation Type,Quaternion"
)


def optitrack_rows(units="Meters", scale=1.0, bodies=("Eraser",), start=0.0):
    """Return the header and the cells of each frame, as Motive exports them."""
    path = scale * PATH
    axes = ["X", "Y", "Z", "W", "X", "Y", "Z", ""]
    kinds = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    marker = ["X", "Y", "Z"], ["Position"] * 3
    names = [name for name in bodies for _ in axes] + ["Eraser:Marker1"] * 3
    types = ["Rigid Body"] * len(bodies) * len(axes) + ["Rigid Body Marker"] * 3
    head = [
        f"{OPTITRACK},Length Units,{units},Coordinate Space,Global",
        "",
        ",".join(["", "Type", *types]),
        ",".join(["", "Name", *names]),
        ",".join(["", "ID", *["12"] * len(names)]),
        ",".join(["", "", *kinds * len(bodies), *marker[1]]),
        ",".join(["Frame", "Time (Seconds)", *axes * len(bodies), *marker[0]]),
    ]
    body = [
        [k, start + t, *([*q, *p, 0.0003] * len(bodies)), *(p + 0.01)]
        for k, (t, q, p) in enumerate(zip(TIME, QUATERNIONS, path, strict=True))
    ]
    return head, [
        [repr(v) if k == 0 else str(v) for k, v in enumerate(r)] for r in body
    ]


def optitrack(folder, **options):
    head, body = optitrack_rows(**options)
    return write(folder, "\n".join([*head, *map(",".join, body)]) + "\n", "take.csv")


def optitrack_in_millimetres(folder):
    return optitrack(folder, units="Millimeters", scale=1e3)


def optitrack_two_bodies(folder):
    file = optitrack(folder, bodies=("Eraser", "Board"))
    columns = ",".join(f"{a}=Eraser Position {a.upper()}" for a in "xyz")
    return Written(file.path, {"columns": columns})


def optitrack_without_header(folder):
    return write(folder, "Format Version,1.23\n\n1,2,3\n", "take.csv")


def vicon_section(title, subject, axes, units, columns):
    width = len(axes)
    rows = [
        ",".join([str(k + 1), "0", *(repr(float(v)) for v in row)])
        for k, row in enumerate(columns)
    ]
    return "\n".join(
        [
            title,
            str(RATE),
            ",".join(["", "", subject, *[""] * (width - 1)]),
            ",".join(["Frame", "Sub Frame", *axes]),
            ",".join(["", "", *units]),
            *rows,
            "",
        ]
    )


def trc(folder):
    settings = (
        "PathFileType\t4\t(X/Y/Z)\td.trc\n"
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\n"
        f"{RATE}\t{RATE}\t{len(TIME)}\t1\tmm\t{RATE}\n"
        "Frame#\tTime\tWand\t\t\t\n\t\tX1\tY1\tZ1\t\n\n"
    )
    counts = range(1, len(TIME) + 1)
    columns = lines(counts, TIME, *1e3 * PATH.T, delimiter="\t")
    return write(folder, settings + columns, "d.trc")


def trc_without_header(folder):
    return write(folder, "PathFileType\t4\t(X/Y/Z)\td.trc\n1\t0.0\t1.0\n", "d.trc")


def vicon_trajectories(folder):
    devices = vicon_section("Devices", "Plate", ["Fx"], ["N"], np.ones((4000, 1)))
    markers = vicon_section(
        "Trajectories", "Wand:Tip", ["X", "Y", "Z"], ["mm"] * 3, 1e3 * PATH
    )
    return write(folder, f"{devices}\n{markers}\n")


def vicon_two_markers(folder):
    """Write markers A and B, the second with a gap."""
    second = 1e3 * PATH + 100
    second[50:80] = np.nan
    section = vicon_section(
        "Trajectories",
        "Wand:A,,,Wand:B",
        ["X", "Y", "Z"] * 2,
        ["mm"] * 6,
        np.column_stack([1e3 * PATH, second]),
    )
    return write(folder, f"{section}\n".replace("nan", ""))


def vicon_one_marker_of_two(folder):
    file = vicon_two_markers(folder)
    columns = ",".join(f"{a}=Wand:A {a.upper()}" for a in "xyz")
    return Written(file.path, {"columns": columns})


def vicon_objects(folder):
    angles = np.rad2deg(TURNS.as_euler("xyz"))
    text = vicon_section(
        "Objects",
        "Global Angle Wand:Wand",
        ["RX", "RY", "RZ", "TX", "TY", "TZ"],
        ["deg"] * 3 + ["mm"] * 3,
        np.column_stack([angles, 1e3 * PATH]),
    )
    name = "Global Angle Wand:Wand Position"
    columns = ",".join(f"{a}={name} {a.upper()}" for a in "xyz")
    return write(folder, text, encoding="utf-8-sig", columns=columns)


def vicon_without_positions(folder):
    text = vicon_section("Devices", "Plate", ["Fx"], ["N"], np.ones((40, 1)))
    return write(folder, text)


# HDF5, MATLAB, JSON, Excel --------------------------------------------------


def hdf5(path, arrays, attributes=()):
    import h5py

    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file[name] = array
        for name, value in attributes:
            file[name].attrs["env_args"] = value
    return Written(path)


def robomimic(folder):
    """Two episodes, the second 0.1 m higher."""
    arrays = {}
    for k in (2, 10):
        here = f"data/demo_{k}"
        arrays |= {
            f"{here}/obs/robot0_eef_pos": PATH + (0.1 if k == 10 else 0),
            f"{here}/obs/robot0_eef_quat": QUATERNIONS,
            f"{here}/obs/agentview_image": np.zeros((400, 2, 2, 3), np.uint8),
            f"{here}/actions": np.zeros((400, 7)),
            f"{here}/rewards": np.zeros(400),
        }
    settings = json.dumps({"env_kwargs": {"control_freq": RATE}})
    return hdf5(folder / "demo.hdf5", arrays, [("data", settings)])


def aloha(folder):
    arrays = {
        "observations/qpos": JOINTS,
        "observations/qvel": JOINTS,
        "observations/knee_pos": np.zeros((400, 3)),
        "observations/images/top": np.zeros((400, 2, 2, 3), np.uint8),
        "action": JOINTS,
    }
    return hdf5(folder / "episode_0.hdf5", arrays)


def hdf5_of_someone(folder):
    arrays = {"time": TIME, "position": PATH, "gains": np.ones(3)}
    return hdf5(folder / "d.h5", arrays)


def hdf5_of_matlab(folder):
    arrays = {"log/time": TIME[None], "log/position": PATH.T}
    return hdf5(folder / "d.mat", arrays)


def hdf5_of_matlab_7_3(folder):
    import h5py

    with h5py.File(folder / "d.mat", "w", userblock_size=512) as file:
        file["t"], file["pos"] = TIME[None], PATH.T
    with (folder / "d.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    return Written(folder / "d.mat")


def hdf5_with_the_clock_of_a_camera(folder):
    arrays = {
        "camera/timestamps": TIME / 2,
        "lights/timestamps": TIME[::2],
        "robot/timestamps": TIME,
        "robot/tcp_pos": PATH,
    }
    return hdf5(folder / "d.h5", arrays)


def hdf5_of_two_arms(folder):
    arrays = {"left/pose": PATH, "right/pose": PATH + 1.0, "timestamp": TIME}
    columns = ",".join(f"{a}=left/pose_{a}" for a in "xyz")
    return hdf5(folder / "d.h5", arrays)._replace(options={"columns": columns})


def hdf5_of_angles_beside_a_position(folder):
    pose = np.column_stack([PATH, TURNS.as_euler("xyz")])
    state = "observation/robot_state"
    arrays = {f"{state}/cartesian_position": pose, "action/joint_position": JOINTS}
    file = hdf5(folder / "d.h5", arrays)
    return file._replace(options={"sample-rate": RATE})


def hdf5_of_episodes(folder):
    arrays = {
        f"traj_{k}/{name}": array
        for k in (0, 1)
        for name, array in (("time", TIME), ("position", PATH + k))
    }
    return hdf5(folder / "d.h5", arrays)


def hdf5_of_links(folder):
    """A file whose numbers are in other files."""
    import h5py

    other = hdf5_of_someone(folder).path
    with h5py.File(folder / "links.h5", "w") as file:
        file["data/demo_0"] = h5py.ExternalLink(other, "/")
        file["position"] = h5py.ExternalLink(other, "/position")
        raw = [(str(other), 0, 1600)]
        file.create_dataset("raw", (200,), np.float64, external=raw)
    return Written(folder / "links.h5")


def matlab_too_large(folder):
    from scipy.io import savemat

    zeros = np.zeros(40_000_000)
    savemat(folder / "d.mat", {"x": zeros}, do_compression=True)
    return Written(folder / "d.mat")


def matlab(folder):
    from scipy.io import savemat

    savemat(folder / "d.mat", {"log": {"time": TIME[:, None], "position": PATH.T}})
    return Written(folder / "d.mat")


def matlab_matrix(folder):
    from scipy.io import savemat

    savemat(folder / "d.mat", {"data": np.column_stack([TIME, PATH])})
    return Written(folder / "d.mat")


def npz_beside_a_scan(folder):
    """An array with more columns than rows."""
    scan = np.ones((len(TIME), 720))
    np.savez(folder / "d.npz", stamp=TIME, pos=PATH, scan=scan)
    columns = ",".join(["time=stamp", *(f"{a}=pos_{a}" for a in "xyz")])
    return Written(folder / "d.npz", {"columns": columns})


def npz_with_dates(folder):
    dates = STAMPS.astype("datetime64[ns]").astype("datetime64[us]")
    np.savez(folder / "d.npz", time=dates, position=PATH)
    return Written(folder / "d.npz")


def npz_with_durations(folder):
    time = np.round(TIME * 1e6).astype("timedelta64[us]")
    np.savez(folder / "d.npz", t=time, pos=PATH)
    return Written(folder / "d.npz")


def npz_of_recordings(folder):
    paths = np.stack([PATH, PATH + 1])
    np.savez(folder / "d.npz", demos=paths, t=TIME)
    return Written(folder / "d.npz")


def _recordings():
    return [{"t": TIME[None], "pos": (PATH + k).T} for k in (0, 1)]


def matlab_structures(folder):
    """As of many authors: a list of structures, each a recording."""
    from scipy.io import savemat

    savemat(folder / "d.mat", {"demos": _recordings(), "dt": 1 / RATE, "name": "S"})
    return Written(folder / "d.mat")


def matlab_cells(folder):
    from scipy.io import savemat

    cells = np.empty(2, object)
    for k in (0, 1):
        cells[k] = np.column_stack([TIME, PATH + k])
    savemat(folder / "d.mat", {"demos": cells})
    return Written(folder / "d.mat")


def npy_of_recordings(folder):
    np.save(folder / "d.npy", [np.column_stack([TIME, PATH + k]) for k in (0, 1)])
    return Written(folder / "d.npy")


def json_recordings(folder):
    recordings = [
        {"header": {"operator": 1}} | {n: a.T.squeeze().tolist() for n, a in r.items()}
        for r in _recordings()
    ]
    return write(folder, json.dumps({"demos": recordings}), "d.json")


def _rows_in_turn(names):
    return [
        {"body": names[k % 2], "t": TIME[k // 2], "xyz": list(PATH[k // 2] + k % 2)}
        for k in range(2 * len(TIME))
    ]


def json_of_bodies_in_turn(folder):
    rows = "\n".join(map(json.dumps, _rows_in_turn("ab")))
    return write(folder, rows, "d.jsonl", topic="a")


def json_of_numbered_bodies_in_turn(folder):
    return write(folder, json.dumps(_rows_in_turn([3, 7])), "d.json", topic="3")


def json_of_bodies_without_a_choice(folder):
    return json_of_bodies_in_turn(folder)._replace(options={})


def parquet_of_bodies_in_turn(folder):
    import pyarrow as pa
    from pyarrow.parquet import write_table

    write_table(pa.Table.from_pylist(_rows_in_turn("ab")), folder / "d.parquet")
    return Written(folder / "d.parquet", {"topic": "a"})


def json_with_gaps(folder):
    """A tracker that lost its target three times."""
    position = PATH.tolist()
    position[0], position[9], position[10] = None, None, []
    rows = [{"t": t, "position": p} for t, p in zip(TIME, position, strict=True)]
    return write(folder, json.dumps(rows), "d.json")


def json_beside_a_list(folder):
    rows = [{"pose": {"position": p}} for p in PATH.tolist()]
    content = {"poses": rows, "timestamps": TIME.tolist(), "events": [{"id": 3}]}
    return write(folder, json.dumps(content), "d.json")


def json_with_a_rate(folder):
    content = {"fps": RATE, "frames": [{"xyz": p} for p in PATH.tolist()]}
    return write(folder, json.dumps(content), "d.json")


def json_of_pandas(folder):
    content = {
        name: {str(i): value for i, value in enumerate(column)}
        for name, column in zip("txyz", [TIME.tolist(), *PATH.T.tolist()], strict=True)
    }
    return write(folder, json.dumps(content), "d.json")


def json_columns_with_gaps(folder):
    position = PATH.tolist()
    position[0], position[9], position[10] = None, None, []
    content = {"time": TIME.tolist(), "position": position}
    return write(folder, json.dumps(content), "d.json")


def json_lines(folder):
    rows = [
        {"time": t, "pose": {"position": dict(zip("xyz", p, strict=True))}, "who": "me"}
        for t, p in zip(TIME, PATH.tolist(), strict=True)
    ]
    return write(folder, "\n".join(map(json.dumps, rows)) + "\n", "d.jsonl")


def json_list(folder):
    rows = [
        {"timestamp": int(s), "position": p}
        for s, p in zip(STAMPS, PATH.tolist(), strict=True)
    ]
    return write(folder, json.dumps(rows, indent=1), "d.json")


def json_rows(folder):
    rows = np.column_stack([TIME, PATH]).tolist()
    return write(folder, json.dumps(rows), "d.json")


def json_list_in_an_object(folder):
    rows = [{"t": t, "xyz": p} for t, p in zip(TIME, PATH.tolist(), strict=True)]
    return write(folder, json.dumps({"robot": "a", "samples": rows}), "d.json")


def json_columns(folder):
    columns = {"time": TIME.tolist(), "xyz": PATH.tolist()}
    return write(folder, json.dumps(columns), "d.json")


def excel_sheet(folder):
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["Wiping by hand"])
    book.active.append(["time [s]", "x [mm]", "y [mm]", "z [mm]"])
    for t, p in zip(TIME, 1e3 * PATH, strict=True):
        book.active.append([t, *p])
    book.save(folder / "d.xlsx")
    return Written(folder / "d.xlsx")


# Compressed -----------------------------------------------------------------


def npz_by_gzip(folder):
    np.savez(folder / "d.npz", time=TIME, position=PATH)
    path = folder / "d.npz.gz"
    path.write_bytes(gzip.compress((folder / "d.npz").read_bytes()))
    return Written(path)


def table_in_zip_of_a_mac(folder):
    with zipfile.ZipFile(folder / "d.zip", "w") as archive:
        archive.writestr("d.csv", xyz(header="time,x,y,z"))
        archive.writestr("__MACOSX/._d.csv", b"\0")
    return Written(folder / "d.zip")


def table_by_gzip(folder):
    path = folder / "d.csv.gz"
    path.write_bytes(gzip.compress(xyz(header="time,x,y,z").encode()))
    return Written(path)


def array_by_gzip(folder):
    np.save(folder / "d.npy", np.column_stack([TIME, PATH]))
    path = folder / "d.npy.gz"
    path.write_bytes(gzip.compress((folder / "d.npy").read_bytes()))
    return Written(path)


def table_in_zip(folder):
    with zipfile.ZipFile(folder / "d.zip", "w") as archive:
        archive.writestr("run/d.csv", xyz(header="time,x,y,z"))
    return Written(folder / "d.zip")


def tables_in_zip(folder):
    with zipfile.ZipFile(folder / "d.zip", "w") as archive:
        archive.writestr("a.csv", xyz(header="time,x,y,z"))
        archive.writestr("b.csv", xyz(header="time,x,y,z"))
    return Written(folder / "d.zip")


def bag_in_zip(folder):
    with zipfile.ZipFile(folder / "d.zip", "w") as archive:
        for name in ("run/", "run/run_0.mcap", "run/metadata.yaml"):
            archive.writestr(name, "")
    return Written(folder / "d.zip")


def letter_by_gzip(folder):
    path = folder / "d.txt.gz"
    path.write_bytes(gzip.compress(b"Dear Sir,\nhere is\nmy motion.\n"))
    return Written(path)


def bomb_by_gzip(folder):
    path = folder / "d.csv.gz"
    path.write_bytes(gzip.compress(bytes(300 * 2**20), 1))
    return Written(path)


# Refused --------------------------------------------------------------------


def no_time(folder):
    return write(folder, lines(*PATH.T, header="x,y,z"))


def counted_time(folder):
    return write(folder, xyz(np.arange(400.0), header="time,x,y,z"))


def coarse_time(folder):
    return write(folder, xyz(np.floor(TIME + 0.3), header="time,x,y,z"))


def coarser_time(folder):
    return write(folder, xyz(10 * np.round(TIME / 10), header="time,x,y,z"))


def time_backwards(folder):
    return write(folder, xyz(np.r_[TIME[:200], TIME[:200]], header="time,x,y,z"))


def edited(folder, rows, edit):
    """Write a table with some of its lines changed."""
    text = xyz(header="time,x,y,z").split("\n")
    for row in rows:
        text[row] = edit(text[row])
    return write(folder, "\n".join(text))


def values_missing(folder, rows=range(8, 260)):
    return edited(folder, rows, lambda line: line.rsplit(",", 1)[0] + ",")


def broken_lines(folder, rows=range(8, 20)):
    return edited(folder, rows, lambda line: line.rsplit(",", 2)[0])


def unknown_column(folder):
    return write(folder, xyz(header="time,x,y,z"), columns="time=time,x=px")


def repeated_names(folder):
    return write(folder, xyz(header="time,a,a,a"))


def column_twice(folder):
    """A program that writes a column of zeros twice, before and after the path."""
    zeros, header = 0 * TIME, "time,current,x,y,z,current"
    return write(folder, lines(TIME, zeros, *PATH.T, zeros, header=header))


def no_quaternions(folder):
    text = lines(TIME, *PATH.T, *(QUATERNIONS.T * 5), header="time,x,y,z,qx,qy,qz,qw")
    return write(folder, text)


def letter(folder):
    return write(folder, "Dear Sir,\nhere is\nmy motion.\n", "d.txt")


def empty_folder(folder):
    return Written(folder)


def half_a_dataset(folder):
    return dataset(
        folder, "v3.0", None, JOINTS, features={"action": {"dtype": "float32"}}
    )
