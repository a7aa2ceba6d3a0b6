"""Reader of ROS 1 and ROS 2 bags and of MCAP files."""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import Array, Indices
from fmp_drake.primitives.data.channels import FORCE_CHANNEL
from fmp_drake.primitives.data.reading.rows import at_times
from fmp_drake.primitives.data.reading.table import (
    LONGEST_GAP,
    ReadingOptions,
    Table,
    readable,
)

# Message types that hold the position of a robot, the best first.
_POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PointStamped",
    "nav_msgs/msg/Odometry",
    "franka_msgs/msg/FrankaState",
    "franka_msgs/msg/FrankaRobotState",
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/Transform",
    "geometry_msgs/msg/Point",
)
# Names of the numbers of a pose.
_POSE = (
    *(f"position.{axis}" for axis in "xyz"),
    *(f"orientation.{axis}" for axis in "xyzw"),
)
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
# Message types of a force, the best first.
_WRENCHES = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench")
# Names of the numbers of a force and a torque.
_FORCE = tuple(f"wrench.{kind}.{a}" for kind in ("force", "torque") for a in "xyz")
# Least fraction of the times of a pose at which a force is known that nobody asked for.
_COVERED = 0.9
_MOST_MESSAGES = 2_000_000
# Latest first stamp of a simulated time that begins at 0, ns.
_SIMULATED = 60 * 10**9
# The reader recognises files by these endings.
_ENDINGS = (".bag", ".mcap", ".db3")


class _Topic(NamedTuple):
    """Numbers in N messages of a topic, in the order of their receipt.

    `values` is (N, C). `stamps` and `received` are times (N,), ns. `omissions` is a part of a
    remark.
    """

    source: str
    names: tuple[str, ...]
    values: Array
    stamps: Indices
    received: Indices
    is_stamped: bool
    frame: str
    omissions: str


def read_bag(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the numbers in the messages of one topic, and of forces beside it.

    The time of a message is the stamp in its header, or its time of receipt without one.
    Where the messages of a topic differ in their numbers, as for an arm and its gripper,
    those with the most numbers in total are read.

    Parameters
    ----------
    path : Path
        A ROS 1 or MCAP file, or the folder or the database of a ROS 2 bag.
    options : ReadingOptions
        Its topic is read; "" for the only topic with the position of a robot. A topic of
        transforms is followed by one of their child frames: ``/tf:tool``. Other topics may
        follow after commas, and are interpolated at its times: ``/tf:tool,/wrench``. Without
        these, the only topic of a force is added to a position, unless only the position has
        header stamps.

    Raises
    ------
    SkillFileError
        Where it cannot be read, the topic is not there, or rosbags is not installed.
    """
    with readable(path, "a bag", extra="bags"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

    if path.is_file() and path.suffix not in _ENDINGS:
        raise SkillFileError(
            f"{path} is a bag; give it a name that ends with {', '.join(_ENDINGS[:-1])} "
            f"or {_ENDINGS[-1]}, as it was recorded."
        )
    if path.is_dir() and path.suffix == _ENDINGS[0]:
        raise SkillFileError(
            f"{path} is the folder of a ROS 2 bag; give it a name without {_ENDINGS[0]}, "
            "which is for files of ROS 1."
        )
    hint = f"; repair it: rosbag reindex {shlex.quote(str(path))}"
    hint *= path.suffix == ".bag"
    types = get_typestore(Stores.ROS2_HUMBLE)
    with (
        readable(path, "a bag", hint=hint),
        AnyReader([path], default_typestore=types) as reader,
    ):
        kinds = {c.topic: c.msgtype for c in reader.connections}
        requested, *named = (name.strip() for name in options.topic.split(","))
        requested, _, child = requested.partition(":")
        source = _topic(path, kinds, requested)
        main = _messages(path, reader, source, child)
        main = main._replace(source=f"{source}:{child}" if child else source)
        beside, remarks = [*filter(None, named)], list[str]()
        if not named and kinds[source] in (*_POSES, _TRANSFORMS):
            beside, remarks = _wrenches(main, reader.connections)
        others = [_messages(path, reader, _topic(path, kinds, t), "") for t in beside]
    return [_joined(main, others, needs_all=bool(named), remarks=remarks)]


def _messages(path: Path, reader: Any, source: str, child: str) -> _Topic:
    """Return the numbers in the messages of a topic, and in these of one child frame."""
    connections = [c for c in reader.connections if c.topic == source]
    count = sum(c.msgcount for c in connections)
    if count > _MOST_MESSAGES:
        raise SkillFileError(
            f"{path}: {source} has {count} messages; at most {_MOST_MESSAGES} are read."
        )
    # Rows by the names of their numbers, each with the index of its message.
    kinds: dict[tuple[str, ...], list[tuple[float, ...]]] = {}
    stamps: list[int] = []
    received: list[int] = []
    frame, children = "", set[str]()
    for connection, receipt, raw in reader.messages(connections=connections):
        message = reader.deserialize(raw, connection.msgtype)
        if hasattr(message, "transforms"):  # Of a tree of frames, as in /tf.
            frames = {t.child_frame_id: t for t in message.transforms}
            children |= frames.keys()
            if len(children) > 1 and not child:
                continue
            message = frames.get(child or min(children))
            if message is None:
                continue
        header = getattr(message, "header", None)
        stamp = getattr(header, "stamp", None)
        stamps.append(0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec)
        received.append(receipt)
        frame = frame or getattr(header, "frame_id", "")
        is_bare_wrench = connection.msgtype == _WRENCHES[1]
        numbers = dict(_numbers(message, "wrench." if is_bare_wrench else ""))
        rows = kinds.setdefault(tuple(numbers), [])
        rows.append((len(received) - 1, *numbers.values()))
    if child and not children:
        raise SkillFileError(
            f"{path}: {source} has no frames to choose from; give --topic {source}."
        )
    if children and (not kinds or (not child and len(children) > 1)):
        raise SkillFileError(
            f"{path}: {source} has the frames {', '.join(sorted(children))}; choose one "
            f"with --topic, such as --topic {source}:{min(children)}"
        )
    if not any(kinds):
        raise SkillFileError(
            f"{path}: {source} has no message with numbers; of joint states only "
            "positions are read, of lists of messages only transforms."
        )
    names, index, values = _largest_kind(kinds)
    omissions = sorted({name for kind in kinds for name in kind} - set(names))
    # A stamp of 0 is missing, unless simulated time has just begun.
    earliest = min(filter(None, stamps), default=0)
    is_stamped = all(stamps) or 0 < earliest < _SIMULATED
    return _Topic(
        source,
        names,
        values,
        np.array(stamps)[index],
        np.array(received)[index],
        is_stamped and stamps[0] != stamps[-1],
        frame,
        f"; {', '.join(omissions)} left out, found in other messages only"
        * bool(omissions),
    )


def _wrenches(main: _Topic, connections: Any) -> tuple[list[str], list[str]]:
    """Return the topic of forces to be read beside a pose, if it is the only one; remarks.

    A force without a header is not, where the pose would lose its header stamps.
    """
    filled = [c for c in connections if c.msgcount]
    kind = next((k for k in _WRENCHES if any(c.msgtype == k for c in filled)), "")
    counts = {c.topic: c.msgcount for c in filled if c.msgtype == kind}
    found = sorted(counts)
    is_small = sum(counts.values()) <= _MOST_MESSAGES
    keeps_times = kind == _WRENCHES[0] or not main.is_stamped
    if len(found) == 1 and is_small and keeps_times and _FORCE[0] not in main.names:
        return found, []
    option = f"--topic {main.source},{found[0]}" if found else ""
    added = "this force" if len(found) == 1 else "one of these forces"
    remark = f"{', '.join(found)} not read: to add {added}, give {option}"
    return [], [remark] * bool(found)


def _joined(
    main: _Topic, others: Sequence[_Topic], *, needs_all: bool, remarks: list[str]
) -> Table:
    """Return a table of a topic and of others, interpolated at its times.

    All times are header stamps, or times of receipt unless all topics have stamps of one
    clock. Without `needs_all`, topics that do not cover its times are left out.
    """
    is_stamped = main.is_stamped and all(_has_clock_of(main, o) for o in others)
    times = main.stamps if is_stamped else main.received
    start = int(times.min())
    time = (times - start).astype(float) * 1e-9
    replaced = {name for other in others for name in other.names} & {*_FORCE}
    columns = {
        name: column
        for name, column in zip(main.names, main.values.T, strict=True)
        if name not in replaced
    }
    for other in others:
        if common := {*columns} & {*other.names}:
            raise SkillFileError(
                f"{other.source} holds {min(common)}, and so does a topic before it; name one "
                "of them with --topic."
            )
        there, rows = np.unique(
            other.stamps if is_stamped else other.received, return_index=True
        )
        stamps = (there - start).astype(float) * 1e-9
        added = [
            at_times(
                time, stamps, column, name=FORCE_CHANNEL if name in _FORCE else name
            )
            for name, column in zip(other.names, other.values[rows].T, strict=True)
        ]
        covered = float(np.mean(~np.isnan(added[0])))
        if not needs_all and covered < _COVERED:
            remark = (
                f"{other.source} not read: it has values at {100 * covered:.0f} % of the "
                f"times of {main.source}"
            )
            if covered > 0:
                remark += (
                    f"; to learn these alone, give --topic {main.source},{other.source}"
                )
            remarks.append(remark)
            return _joined(main, [], needs_all=True, remarks=remarks)
        if covered == 0:
            raise SkillFileError(
                f"{other.source} has no values at the times of {main.source}; name "
                "topics that were recorded together."
            )
        columns |= dict(zip(other.names, added, strict=True))
        remarks.append(f"{other.source} interpolated at the times of {main.source}")
    kind = "header stamps" if is_stamped else "times of receipt"
    if main.is_stamped and not is_stamped:
        names = " or ".join(other.source for other in others)
        kind += f", because {names} has no stamps of the same clock"
    if any(np.diff(times) < 0):
        kind += ", sorted"
    order = np.argsort(times, kind="stable")
    return Table(
        names=("time", *columns),
        units=("s",),
        values=np.column_stack([time, *columns.values()])[order],
        frame=main.frame,
        origin=start * 1e-9,
        remarks=(f"{main.source}, {kind}{main.omissions}", *remarks),
    )


def _has_clock_of(main: _Topic, other: _Topic) -> bool:
    """Return whether stamps of two topics agree where both were received."""
    first, last = main.received[[0, -1]]
    is_common = (first <= other.received) & (other.received <= last)
    if not np.any(is_common):
        return False
    expected = np.interp(
        other.received - first, main.received - first, main.stamps - main.stamps[0]
    )
    shifts = other.stamps - main.stamps[0] - expected
    return bool(abs(np.median(shifts[is_common])) < LONGEST_GAP * 1e9)


def _largest_kind(
    kinds: dict[tuple[str, ...], list[tuple[float, ...]]],
) -> tuple[tuple[str, ...], Indices, Array]:
    """Return names, message indices and numbers of the kind with the most numbers."""
    names = max(kinds, key=lambda kind: len(kinds[kind]) * len(kind))
    rows = np.concatenate(
        [
            np.array(rows)[:, [0, *(1 + kind.index(name) for name in names)]]
            for kind, rows in kinds.items()
            if set(names) <= set(kind)
        ]
    )
    rows = rows[np.argsort(rows[:, 0])]
    return names, rows[:, 0].astype(np.int64), rows[:, 1:]


def _topic(path: Path, types: dict[str, str], requested: str) -> str:
    """Return the topic to read."""
    listed = ", ".join(f"{t} ({k.split('/')[-1]})" for t, k in sorted(types.items()))
    if requested:
        if requested not in types:
            raise SkillFileError(f"{path} has no topic {requested}; it has {listed}.")
        return requested
    for kind in _POSES:
        topics = [t for t, name in types.items() if name == kind]
        if len(topics) == 1:
            return topics[0]
        if topics:
            break
    raise SkillFileError(
        f"{path} has the topics {listed or '(none)'}; choose one with "
        f"--topic, such as --topic {next(iter(sorted(types)), 'NAME')}"
    )


def _numbers(message: Any, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message and their names, without header and covariances."""
    joints = getattr(message, "name", None)
    if isinstance(joints, list) and hasattr(message, "position"):
        if len(message.position) == len(joints):
            yield from zip(joints, map(float, message.position), strict=True)
        return
    pose = getattr(message, "O_T_EE", None)
    if pose is not None:  # In column-major order; read-only, unlike a copy.
        X = np.array(pose).reshape(4, 4).T
        quaternion = Rotation.from_matrix(X[:3, :3]).as_quat()
        yield from zip(_POSE, map(float, [*X[:3, 3], *quaternion]), strict=True)
        # Estimated from the torques of the joints, in the frame of the base.
        wrench = getattr(message, "O_F_ext_hat_K", ())
        yield from zip(_FORCE, map(float, wrench), strict=False)
        return
    if hasattr(message, "o_t_ee"):  # The same in ROS 2.
        yield from _numbers(message.o_t_ee.pose)
        yield from _numbers(message.o_f_ext_hat_k)
        return
    for name in getattr(message, "__dataclass_fields__", {}):
        value = getattr(message, name)
        if name in ("header", "twist") or name.startswith("__"):
            continue
        if hasattr(value, "__dataclass_fields__"):
            yield from _numbers(value, f"{prefix}{name}.")
        elif isinstance(value, int | float):
            yield f"{prefix}{name}", float(value)
