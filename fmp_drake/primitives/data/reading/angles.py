"""Units of recorded angles, and recorded orientations as quaternions."""

import re
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Indices, runs
from fmp_drake.primitives.data.channels import (
    EULER_CHANNELS,
    POSITION_CHANNELS,
    QUATERNION_CHANNELS,
    ROTATION_CHANNELS,
)
from fmp_drake.primitives.data.reading.table import (
    ANGLES,
    Column,
    axis_groups,
    columns_option,
)

# Angles about three axes, whose names do not say in which order the turns are made.
_ABOUT_AXES = re.compile(
    r"(.*?(?<![a-z])(?:euler(?:_angles?)?|rot(?:ation)?|theta|angles?))_?([xyz])"
)
# Greatest angle in rad, if it has no unit: two revolutions.
_LARGEST_ANGLE = 4 * np.pi
REVOLUTION = 2 * np.pi + 0.1
"""Greatest Euler angle and length of a rotation vector in rad, with a margin."""
# Change of an angle from sample to sample that is a revolution less than it seems, rad.
_JUMP = 1.5 * np.pi
# Without a unit, values within half a turn that jump by about a whole one are angles, rad.
_HALF_TURN, _TURN = np.pi + 0.01, 1.9 * np.pi
# Greatest coordinate of an arm, m.
_FARTHEST = 5.0
# Greatest error of a quaternion's length, and most runs of wrong rows that are listed.
_LENGTH_ERROR, _MOST_RUNS = 0.1, 3


def one_orientation(
    channels: dict[str, Column], remarks: list[str]
) -> dict[str, Column]:
    """Return the channels with one orientation: the quaternion, or the rotation vector.

    Without any, a remark names the columns that may be one.
    """
    kinds = (QUATERNION_CHANNELS, ROTATION_CHANNELS, EULER_CHANNELS)
    complete = [kind for kind in kinds if set(kind) <= set(channels)]
    if not complete:
        groups = axis_groups(list(channels.values()), _ABOUT_AXES, "xyz")
        remarks += map(_unread_angles, groups.values())
    for kind in complete[1:]:
        omitted = ", ".join(channels[name].name or name for name in kind)
        read = ", ".join(complete[0])
        remarks.append(f"{omitted} left out: the orientation is that of {read}")
        channels = {name: c for name, c in channels.items() if name not in kind}
    return channels


def _unread_angles(columns: Sequence[Column]) -> str:
    """Return the remark on angles that may be an orientation."""
    return (
        f"{', '.join(column.name for column in columns)} are not read as an orientation, because "
        "the order of the turns is unknown; if they are roll, pitch and yaw, "
        f"R = Rz(yaw) Ry(pitch) Rx(roll), add {euler_option([c.source for c in columns])}"
    )


def euler_option(sources: Sequence[str]) -> str:
    """Return the option that reads three columns as roll, pitch and yaw."""
    return columns_option(dict(zip(EULER_CHANNELS, sources, strict=True)))


def may_be_degrees(group: Sequence[Column]) -> bool:
    """Return whether no value in a group of columns is greater than a revolution."""
    return all(np.nanmax(np.abs(c.values), initial=0.0) <= 360 for c in group)


def angle_units(
    values: Array,
    channels: Mapping[str, Column],
    units: Sequence[str],
    stated: Sequence[str],
    remarks: list[str],
) -> dict[int, str]:
    """Return the unit of each angle without a stated one, by the index of its channel.

    Rotation vectors are in rad. Euler angles are in degrees if one is greater than a
    revolution, or if they have the names of KUKA's or FANUC's controllers, beside a position
    in mm as these write it, and do not jump by 2 pi; other angles if one is greater than two
    revolutions.
    """
    names, columns = list(channels), list(channels.values())
    rotation, euler = (
        [names.index(name) for name in kind if set(kind) <= set(names)]
        for kind in (ROTATION_CHANNELS, EULER_CHANNELS)
    )
    angles = {i: u for i, u in enumerate(units) if u == "rad" and not stated[i]}
    others = [i for i in angles if i not in (*rotation, *euler)]
    euler = [i for i in angles if i in euler]
    letters = {columns[i].key[-1:] for i in euler}
    largest_step = np.max(np.abs(np.diff(values[:, euler], axis=0)), initial=0.0)
    position = [i for i, name in enumerate(names) if name in POSITION_CHANNELS]
    farthest = float(np.max(np.abs(values[:, position]), initial=0.0))
    are_metres = {units[i] for i in position} == {"m"} and farthest < _FARTHEST
    by_controller = letters in ({*"abc"}, {*"wpr"})
    is_controller = by_controller and not are_metres and largest_step < _TURN
    limit = 0.0 if is_controller else REVOLUTION
    for group, most in ((others, _LARGEST_ANGLE), (euler, limit)):
        largest = float(np.max(np.abs(values[:, group]), initial=0.0))
        unit, other = ("deg", "rad") if largest > most else ("rad", "deg")
        if group and (unit == "deg" or group is euler):
            angles |= dict.fromkeys(group, unit)
            labels = [columns[i].name or names[i] for i in group]
            words = {"deg": "degrees", "rad": "radians"}
            remarks.append(
                f"{', '.join(labels)} reach {largest:.3g} and are taken for {words[unit]}; if "
                f"they are {words[other]}, write so in the header or in --columns: "
                f"{labels[0]} [{other}]"
            )
    return angles


def without_false_rotation(
    channels: dict[str, Column], stated: Mapping[str, str], remarks: list[str]
) -> dict[str, Column]:
    """Leave out a rotation vector that is in degrees, or longer than a revolution.

    `stated` are the units that the file or the user gives, "" where there is none.
    """
    if not set(ROTATION_CHANNELS) <= set(channels):
        return channels
    columns = [channels[name] for name in ROTATION_CHANNELS]
    lengths = np.linalg.norm([column.values for column in columns], axis=0)
    largest = float(np.max(lengths[np.isfinite(lengths)], initial=0.0))
    units = {stated[name] for name in ROTATION_CHANNELS}
    are_degrees = bool(units & set(ANGLES) - {"rad"})
    if not are_degrees and (largest <= REVOLUTION or any(units)):
        return channels
    found = "are in degrees" if are_degrees else f"reach {largest:.3g}"
    remarks.append(
        f"{', '.join(column.name for column in columns)} {found} and are left out: a rotation "
        "vector is in radians. For roll, pitch and yaw, R = Rz(yaw) Ry(pitch) Rx(roll), add "
        f"{euler_option([c.source for c in columns])}; convert other angles to quaternions"
    )
    return {n: c for n, c in channels.items() if n not in ROTATION_CHANNELS}


def continuous_angles(
    values: Array,
    channels: Mapping[str, Column],
    names: list[str],
    units: list[str],
    remarks: list[str],
) -> Array:
    """Return the values (N, C) without jumps by a revolution; change names and units.

    A rotation vector and Euler angles become a quaternion. Other angles are unwrapped.
    """
    for kind in (ROTATION_CHANNELS, EULER_CHANNELS):
        index = [names.index(name) for name in kind if name in names]
        if [units[i] for i in index] != ["rad"] * 3:
            continue
        columns = [channels[name] for name in kind]
        labels = [c.name or name for c, name in zip(columns, kind, strict=True)]
        rotations = Rotation.from_rotvec(values[:, index])
        read = "a rotation vector; if they are Euler angles, add "
        read += euler_option([column.source for column in columns])
        if kind == EULER_CHANNELS:
            rotations = Rotation.from_euler("xyz", values[:, index])
            read = "Euler angles, R = Rz(yaw) Ry(pitch) Rx(roll)"
        remarks.append(f"{', '.join(labels)} read as {read}")
        values = np.hstack([np.delete(values, index, axis=1), rotations.as_quat()])
        kept = [i for i in range(len(names)) if i not in index]
        names[:] = [*(names[i] for i in kept), *QUATERNION_CHANNELS]
        units[:] = [*(units[i] for i in kept), *["1"] * 4]
    jumps = np.max(np.abs(np.diff(values, axis=0)), axis=0, initial=0.0)
    sizes = np.max(np.abs(values), axis=0, initial=0.0)
    wrapped = [
        i
        for i, unit in enumerate(units)
        if (unit == "rad" and jumps[i] > _JUMP)
        or (unit == "1" and jumps[i] > _TURN and sizes[i] < _HALF_TURN)
    ]
    if wrapped:
        values[:, wrapped] = np.unwrap(values[:, wrapped], axis=0)
        listed = ", ".join(names[i] for i in wrapped)
        remarks.append(f"{listed} unwrapped where they jump by a revolution")
    return values


def check_quaternions(quaternions: Array, rows: Indices) -> None:
    """Refuse quaternions (N, 4) whose length differs from 1 by a tenth or more.

    Parameters
    ----------
    quaternions : ndarray, shape (N, 4)
    rows : ndarray, shape (N,)
        Rows of the table that they are from, from 0.
    """
    lengths = np.linalg.norm(quaternions, axis=1)
    is_wrong = ~(np.abs(lengths - 1) < _LENGTH_ERROR)
    if not np.any(is_wrong):
        return
    wrong = [(rows[a] + 1, rows[b - 1] + 1) for a, b in runs(is_wrong)]
    listed = ", ".join(
        f"{a} to {b}" if b > a else f"{a}" for a, b in wrong[:_MOST_RUNS]
    )
    advice = "give the columns of the channels (--columns)"
    if 2 * np.count_nonzero(is_wrong) < len(rows):
        more = ", ..." * (len(wrong) > _MOST_RUNS)
        advice = f"delete these rows of numbers, counted from 1: {listed}{more}"
    lengths = lengths[is_wrong]
    raise DemonstrationError(
        f"qx, qy, qz and qw are not unit quaternions (lengths from {lengths.min():.3g} "
        f"to {lengths.max():.3g}); {advice}."
    )
