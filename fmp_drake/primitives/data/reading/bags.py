"""Reader of ROS 1 and ROS 2 bags and of MCAP files."""

import shlex
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import Array, Indices
from fmp_drake.primitives.data.reading.table import ReadingOptions, Table, readable

# Message types that hold the position of a robot, the best first.
_POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PointStamped",
    "nav_msgs/msg/Odometry",
    "franka_msgs/msg/FrankaState",
    "sensor_msgs/msg/JointState",
)
# Names of the numbers of a pose.
_POSE = (
    *(f"position.{axis}" for axis in "xyz"),
    *(f"orientation.{axis}" for axis in "xyzw"),
)
_MOST_MESSAGES = 2_000_000
# Latest first stamp of a simulated time that begins at 0, ns.
_SIMULATED = 60 * 10**9
# The reader recognises files by these endings.
_ENDINGS = (".bag", ".mcap", ".db3")


def read_bag(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the numbers in the messages of one topic.

    The time of a message is the stamp in its header, or its time of receipt without one.
    Where the messages of a topic differ in their numbers, as for an arm and its gripper,
    those with the most numbers in total are read.

    Parameters
    ----------
    path : Path
        A ROS 1 or MCAP file, or the folder or the database of a ROS 2 bag.
    options : ReadingOptions
        Its topic is read; "" for the only topic with the position of a robot. A topic of
        transforms is followed by one of their child frames: ``/tf:tool``.

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
    hint = f"; repair it: rosbag reindex {shlex.quote(str(path))}"
    hint *= path.suffix == ".bag"
    types = get_typestore(Stores.ROS2_HUMBLE)
    with (
        readable(path, "a bag", hint=hint),
        AnyReader([path], default_typestore=types) as reader,
    ):
        requested, _, child = options.topic.partition(":")
        source = _topic(
            path, {c.topic: c.msgtype for c in reader.connections}, requested
        )
        connections = [c for c in reader.connections if c.topic == source]
        count = sum(c.msgcount for c in connections)
        if count > _MOST_MESSAGES:
            raise SkillFileError(
                f"{path}: {source} has {count} messages; at most {_MOST_MESSAGES} "
                "are read."
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
            numbers = dict(_numbers(message))
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
    is_stamped = is_stamped and stamps[0] != stamps[-1]
    times = stamps if is_stamped else received
    remark = f"{source}, {'header stamps' if is_stamped else 'times of receipt'}"
    if any(a > b for a, b in pairwise(times)):
        remark += ", sorted"
    if omissions:
        remark += f"; {', '.join(omissions)} left out, found in other messages only"
    time = np.array(times)[index]
    order = np.lexsort([index, time])
    values = np.column_stack([(time - time.min()) * 1e-9, values])[order]
    return [
        Table(
            names=("time", *names),
            units=("s",),
            values=values,
            frame=frame,
            remarks=(remark,),
        )
    ]


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
    if pose is not None:  # In column-major order.
        X = np.reshape(pose, (4, 4)).T
        quaternion = Rotation.from_matrix(X[:3, :3]).as_quat()
        yield from zip(_POSE, map(float, [*X[:3, 3], *quaternion]), strict=True)
        return
    for name in getattr(message, "__dataclass_fields__", {}):
        value = getattr(message, name)
        if name in ("header", "twist") or name.startswith("__"):
            continue
        if hasattr(value, "__dataclass_fields__"):
            yield from _numbers(value, f"{prefix}{name}.")
        elif isinstance(value, int | float):
            yield f"{prefix}{name}", float(value)
