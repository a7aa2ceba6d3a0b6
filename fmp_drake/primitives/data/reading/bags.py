"""Recordings in ROS 1 and ROS 2 bags and in MCAP files."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fmp_drake.errors import FmpError, SkillFileError
from fmp_drake.primitives.data.reading.table import Table

# The message types that tell where a robot is, the best first.
_POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PointStamped",
    "nav_msgs/msg/Odometry",
    "franka_msgs/msg/FrankaState",
    "sensor_msgs/msg/JointState",
)
_MOST_MESSAGES = 2_000_000
# By these the reader knows what a file is.
_ENDINGS = (".bag", ".mcap", ".db3")


def read_bag(path: Path, topic: str) -> Table:
    """Return the numbers in the messages of one topic.

    The stamp in a message's header is its time, that of its receipt where there is none.
    Where messages of one topic hold different numbers, as those of an arm and of its
    gripper, those are read that tell most.

    Parameters
    ----------
    path : Path
        A ROS 1 or MCAP file, or the folder or the database of a ROS 2 bag.
    topic : str
        "" for the only one that tells where a robot is.

    Raises
    ------
    SkillFileError
        Where it cannot be read, the topic is not there, or rosbags is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise SkillFileError(
            f"{path} is a bag; install what reads it: pip install 'fmp-drake[bags]'."
        ) from None
    if path.is_file() and path.suffix not in _ENDINGS:
        raise SkillFileError(
            f"{path} is a bag; give it a name that ends with {', '.join(_ENDINGS[:-1])} "
            f"or {_ENDINGS[-1]}, as it was recorded."
        )
    types = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with AnyReader([path], default_typestore=types) as reader:
            chosen = _topic(
                path, {c.topic: c.msgtype for c in reader.connections}, topic
            )
            connections = [c for c in reader.connections if c.topic == chosen]
            count = sum(c.msgcount for c in connections)
            if count > _MOST_MESSAGES:
                raise SkillFileError(
                    f"{path}: {chosen} has {count} messages; at most {_MOST_MESSAGES} "
                    "are read."
                )
            # By the names of the numbers, each row after the place of its message.
            kinds: dict[tuple[str, ...], list[tuple[float, ...]]] = {}
            stamps: list[int] = []
            received: list[int] = []
            frame = ""
            for connection, receipt, raw in reader.messages(connections=connections):
                message = reader.deserialize(raw, connection.msgtype)
                header = getattr(message, "header", None)
                stamp = getattr(header, "stamp", None)
                stamps.append(0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec)
                received.append(receipt)
                frame = frame or getattr(header, "frame_id", "")
                told_by_it = dict(_numbers(message))
                rows = kinds.setdefault(tuple(told_by_it), [])
                rows.append((len(received) - 1, *told_by_it.values()))
    except FmpError:
        raise
    except Exception as reason:  # noqa: BLE001 - broken bytes raise anything.
        raise SkillFileError(f"{path} is not a readable bag ({reason}).") from None
    if not any(kinds):
        raise SkillFileError(
            f"{path}: {chosen} has no message with numbers; of joints the positions are "
            "read."
        )
    names, at, numbers = _of_most(kinds)
    left = sorted({name for kind in kinds for name in kind} - set(names))
    is_stamped = all(stamps) and stamps[0] != stamps[-1]
    told = stamps if is_stamped else received
    remark = f"{chosen}, {'header stamps' if is_stamped else 'times of receipt'}"
    if any(a > b for a, b in pairwise(told)):
        remark += ", put in order"
    if left:
        remark += f"; {', '.join(left)} left out, which other messages hold"
    time = np.array(told)[at]
    order = np.lexsort([at, time])
    values = np.column_stack([(time - time.min()) * 1e-9, numbers])[order]
    return Table(
        names=("time", *names),
        units=("s", *("" for _ in names)),
        values=values,
        frame=frame,
        remarks=(remark,),
    )


def _of_most(
    kinds: dict[tuple[str, ...], list[tuple[float, ...]]],
) -> tuple[tuple[str, ...], NDArray[np.int64], NDArray[np.float64]]:
    """Return the names that are read, the places of their messages, and the numbers.

    The names are those of the messages that tell most numbers altogether.
    """
    names = max(kinds, key=lambda kind: len(kinds[kind]) * len(kind))
    rows = np.concatenate(
        [
            np.array(rows)[:, [0, *(1 + kind.index(name) for name in names)]]
            for kind, rows in kinds.items()
            if set(names) <= set(kind)
        ]
    )
    return names, rows[:, 0].astype(np.int64), rows[:, 1:]


def _topic(path: Path, types: dict[str, str], wanted: str) -> str:
    """Return the topic that is read."""
    listed = ", ".join(f"{t} ({k.split('/')[-1]})" for t, k in sorted(types.items()))
    if wanted:
        if wanted not in types:
            raise SkillFileError(f"{path} has no topic {wanted}; it has {listed}.")
        return wanted
    for kind in _POSES:
        fit = [t for t, each in types.items() if each == kind]
        if len(fit) == 1:
            return fit[0]
        if fit:
            break
    raise SkillFileError(
        f"{path} has the topics {listed or '(none)'}; choose one with --topic."
    )


def _numbers(message: Any, begin: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message with their names; no headers and covariances."""
    joints = getattr(message, "name", None)
    if isinstance(joints, list) and hasattr(message, "position"):
        if len(message.position) == len(joints):
            yield from zip(joints, map(float, message.position), strict=True)
        return
    pose = getattr(message, "O_T_EE", None)
    if pose is not None:  # By columns.
        X = np.reshape(pose, (4, 4)).T
        quaternion = Rotation.from_matrix(X[:3, :3]).as_quat()
        yield from _named("position", "xyz", X[:3, 3])
        yield from _named("orientation", "xyzw", quaternion)
        return
    for name in getattr(message, "__dataclass_fields__", {}):
        value = getattr(message, name)
        if name in ("header", "twist") or name.startswith("__"):
            continue
        if hasattr(value, "__dataclass_fields__"):
            yield from _numbers(value, f"{begin}{name}.")
        elif isinstance(value, int | float):
            yield f"{begin}{name}", float(value)


def _named(
    begin: str, axes: str, values: Sequence[float] | np.ndarray[Any, Any]
) -> Iterator[tuple[str, float]]:
    for axis, value in zip(axes, values, strict=True):
        yield f"{begin}.{axis}", float(value)
