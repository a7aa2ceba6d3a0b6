"""Recognition of poses, forces and joints in numbered columns, such as `O_T_EE_0`."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.numeric import Array
from fmp_drake.primitives.data.channels import EULER_CHANNELS
from fmp_drake.primitives.data.reading.angles import REVOLUTION, euler_option
from fmp_drake.primitives.data.reading.table import ReadingOptions, Table, standard_unit

_NUMBERED = re.compile(r"(.*?)_?(\d+)")
# Name of an element of a matrix, `r11` or `r_1_1`; rows and columns of all its elements.
_ELEMENT = re.compile(r"(.*?)_?([0-4])_?([0-4])")
_ELEMENTS = [
    [f"{i}{j}" for i in range(first, first + m) for j in range(first, first + n)]
    for first in (0, 1)
    for m, n in ((3, 3), (3, 4), (4, 4))
]
# Last words of the names before the numbers.
_TOOL = "tcp|eef?"
_POSITIONS = re.compile(rf"(.*_)?(p|pos|positions?|translations?|points?|xyz|{_TOOL})")
_QUATERNIONS = re.compile(r"(.*_)?(q|quats?|quaternions?|orientations?|rot|rotations?)")
_ORDER = re.compile(r"(.*?)_?(xyzw|wxyz)")
QUATERNION = re.compile(
    r"(.*?)_?(?:q|(?<![a-z0-9])o|quats?|quaternions?|ori(?:en(?:tations?|t)?)?|rotations?|rot)"
    r"(?:_[a-z]{1,3})?_?([xyzw])"
)
"""Name of an element of a quaternion: a prefix, if any, and its axis."""
_MATRICES = re.compile(
    r"(.*_)?(r|rotm|rotmat|(rot|rotations?|orientations?)(_matri(x|ces))?)"
)
_JOINTS = re.compile(r"(.*_)?(q|qpos|joints?|joint_positions?|theta|angles?)")
# Force and torque. Universal Robots: a position and a rotation vector. ROS: joint states.
_WRENCH = re.compile(
    r"(.*?)_?(force_torque|force|wrench|ft|(?<![a-z0-9])f|f_ext_hat_k)(?:_raw|_sensor)?"
)
_CARTESIAN = re.compile(
    rf"(?!.*joint)(.*_)?((cart|cartesian|tool|flange|pose|{_TOOL})_|{_TOOL}|pose)"
)
# Doosan: a position in mm, and angles about z, y and z in degrees.
_DOOSAN = re.compile(r"(.*_)?posx")
_TCP_POSE = re.compile(r"(.*_)?tcp_pose")
# LeRobot: a pose, and a gripper or forces.
_STATE = re.compile(r"(.*_)?state")
_JOINT_STATE = re.compile(r"(.*)_position")
JOINT = re.compile(
    r"(?:(.*)[_./])?"
    r"(?:joints?(?:_(?:pos(?:itions?)?|angles?|states?))?"
    r"|(?<!joint_)positions|qpos|jpos|posj|theta|axis|q|j|a)"
    r"[_.[ ]?(\d)\]?(?:[_./](?:pos(?:ition)?|angle))?",
    re.IGNORECASE,
)
"""Name of a joint's angle: a prefix, if any, and the joint's number."""
COMMANDED = re.compile(
    r"(^|.*_)(t_ee_[dc]|ik|des|desired|target|cmd|command|commanded|actions?|ref|reference|goal|rsol|soll|planned)"
    r"(_.*|$)"
)
"""Names of what was commanded instead of measured."""
_RATES_OF_JOINTS = ("velocity", "velocities", "accelerations", "effort")
# Greatest error of a quaternion's length, where the name does not say that it is a
# quaternion, where the elements have its names, and where the name says so.
_EXACT, _CLOSE, _STATED = 1e-3, 1e-2, 0.1
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


class Group(NamedTuple):
    """Columns that replace others.

    `sources` are the indices of the replaced ones. `values` has a column for each name.
    """

    sources: set[int]
    names: list[str]
    units: list[str]
    values: Array
    remark: str = ""


def column_groups(
    table: Table, keys: Sequence[str], options: ReadingOptions
) -> Iterator[Group]:
    """Yield the groups among the columns of a table.

    The last row of a 4 x 4 matrix shows whether it is stored by rows or by columns. 3 x 3 and
    3 x 4 matrices, without that row, are stored by rows.

    Parameters
    ----------
    table : Table
    keys : sequence of str
        Names of the columns in lower case, words joined by underscores.
    options : ReadingOptions
    """
    conversions = [standard_unit(unit) for unit in table.units]
    values = table.values * [factor for factor, _ in conversions]
    numbered: dict[str, dict[int, int]] = {}
    for i, name in enumerate(keys):
        if match := _NUMBERED.fullmatch(name):
            numbered.setdefault(match[1], {}).setdefault(int(match[2]), i)
    if not any(keys):  # A table of poses without a header.
        count = len(keys)
        width = next((n for n in (7, 12, 16) if 0 <= count - n <= 2), 0)
        numbered = {"": {n: count - width + n for n in range(width)}}
    matrices = _matrices(keys)
    numbered |= matrices
    positions = [prefix for prefix in numbered if prefix.endswith("position")]
    is_measured = not all(map(COMMANDED.fullmatch, positions))
    for prefix, members in numbered.items():
        count, numbers = len(members), sorted(members)
        if not count or numbers not in (list(range(count)), list(range(1, count + 1))):
            continue
        sources = [members[n] for n in numbers]
        is_state = prefix not in matrices and _STATE.fullmatch(prefix)
        if count in range(8, 16) and is_state:
            count, sources = 7, sources[:7]
        stem = prefix if prefix in matrices else prefix.removesuffix("position")
        are_joints = count > 3 or f"{stem}name_1" in table.words
        if any("time_from_start" in key for key in keys):  # Of a trajectory in ROS.
            stem = stem.removesuffix("positions")
        is_command = is_measured and COMMANDED.fullmatch(prefix)
        are_joints &= not (_CARTESIAN.fullmatch(stem) or is_command)
        if stem != prefix and are_joints:
            yield _numbered_joints(table, stem, members, numbered, values)
            continue
        # Coordinates of six markers, or a header with other units than Doosan's.
        is_other = f"{prefix[:-1]}y" in numbered or any(table.units[i] for i in sources)
        if is_other and _DOOSAN.fullmatch(prefix):
            continue
        recognised = _recognise(prefix, values[:, sources], options)
        if recognised is not None:
            labels, units, poses, lacks_order = recognised
            titles = [table.names[i] or f"column {table.numbers[i]}" for i in sources]
            kind = "a force and a torque" if "N" in units else "a pose"
            if len(labels) == 4:
                kind = "an orientation" + ", row by row" * (count == 9)
            if len(labels) < 4 < count:
                kind = "a position"
                if not {*EULER_CHANNELS} & {*options.columns}:
                    kind += (
                        ", and angles that are not read; if they are roll, pitch and yaw, "
                        f"add {euler_option(titles[3:])}"
                    )
            span = f"{titles[0]} to {titles[-1]}"
            remark = f"{span} are {kind}" if count > 4 else ""
            if lacks_order:
                remark = options.quaternion_remark(titles[count - 4])
            # Positions keep the unit of their header.
            unit = conversions[sources[0]][1]
            units = [u or unit * (i < 3) for i, u in enumerate(units)]
            yield Group(set(sources), labels, units, poses, remark)
    yield from _joint_states(table.names, keys, values)
    # Quaternions whose names do not say so; letters other than r may mean anything.
    for stem in dict.fromkeys(name[:-1] for name in keys if name.endswith("w")):
        axes = [f"{stem}{axis}" for axis in "xyzw"]
        is_named = QUATERNION.fullmatch(axes[3]) or (len(stem) == 1 and stem != "r")
        if is_named or not {*axes} <= {*keys}:
            continue
        sources = [len(keys) - 1 - keys[::-1].index(axis) for axis in axes]
        elements = values[:, sources]
        body = re.sub(r"(^|_)r$", r"\1", stem)
        varies = [np.unique(c[~np.isnan(c)]).size > 1 for c in elements.T]
        # Of the homogeneous coordinates of a position only w is constant.
        if varies[3] >= any(varies) and _is_unit(elements, _CLOSE):
            labels = [f"{body}{q}" for q in _POSE[3:]]
            yield Group(set(sources), labels, [""] * 4, elements)


def _matrices(keys: Sequence[str]) -> dict[str, dict[int, int]]:
    """Return prefix to number, row by row, to column of matrices such as `r11` to `r33`."""
    matrices: dict[str, dict[str, int]] = {}
    for i, name in enumerate(keys):
        if match := _ELEMENT.fullmatch(name):
            matrices.setdefault(match[1], {})[match[2] + match[3]] = i
    return {
        prefix: {n: places[place] for n, place in enumerate(sorted(places))}
        for prefix, places in matrices.items()
        if sorted(places) in _ELEMENTS
    }


def _numbered_joints(
    table: Table,
    stem: str,
    members: Mapping[int, int],
    numbered: Mapping[str, Mapping[int, int]],
    values: Array,
) -> Group:
    """Return the joint angles in `position_0` and so on, whose names may be in `name_0`.

    `members` are their columns by number.
    """
    words = {re.sub(r"\W+|_+", "", n.lower()): w for n, w in table.words.items()}
    place = f"{stem}name".replace("_", "")
    labels = [words.get(f"{place}{n}", "") for n in sorted(members)]
    unit = "rad"  # Of a message with names.
    if len(set(labels) - {""}) != len(members):
        labels, unit = [f"joint_{n}" for n in range(1, len(members) + 1)], ""
    rates = {
        i
        for kind in _RATES_OF_JOINTS
        for i in numbered.get(f"{stem}{kind}", {}).values()
    }
    sources = [members[n] for n in sorted(members)]
    return _joints(labels, sources, rates, values, unit=unit)


def _joint_states(
    names: Sequence[str], keys: Sequence[str], values: Array
) -> Iterator[Group]:
    """Yield the positions of joints that also have a velocity or an effort."""
    joints = dict[str, int]()
    rates = set[int]()
    for i, name in enumerate(keys):
        match = _JOINT_STATE.fullmatch(name)
        peers = [f"{match[1]}_{kind}" for kind in _RATES_OF_JOINTS] if match else []
        peers = [other for other in peers if other in keys]
        if peers:
            parts = re.split(r"[/.]", names[i])
            joints[parts[-2] if len(parts) > 1 else names[i]] = i
            rates |= {keys.index(other) for other in peers}
    if joints:
        yield _joints(list(joints), list(joints.values()), rates, values)


def _joints(
    labels: list[str],
    sources: list[int],
    rates: set[int],
    values: Array,
    *,
    unit: str = "rad",
) -> Group:
    """Return joint angles as a group that also replaces their velocities and efforts."""
    remark = "velocities and efforts of joints left out" if rates else ""
    units = [unit] * len(labels)
    return Group({*sources, *rates}, labels, units, values[:, sources], remark)


def _recognise(
    prefix: str, values: Array, options: ReadingOptions
) -> tuple[list[str], list[str], Array, bool] | None:
    """Return names, units, values, and whether the order of a quaternion is unknown.

    None where nothing is recognised.
    """
    count, stated = values.shape[1], _ORDER.fullmatch(prefix)
    letters = options.quaternion_order
    if stated:
        prefix, letters = stated[1], options.quaternions or stated[2]
    order = [letters.index(axis) for axis in "xyzw"]
    stem = f"{prefix}_" if prefix else ""
    if count == 7 and (both := _QUATERNIONS.fullmatch(prefix)):  # As `pos_quat`.
        stem = both[1] or ""
    pose = [f"{stem}{name}" for name in _POSE]
    units = ["m"] * 3 + [""] * 4
    if count == 3 and _POSITIONS.fullmatch(prefix):
        return pose[:3], [""] * 3, values, False
    error = _STATED if "quat" in prefix else _EXACT
    is_named = stated or _QUATERNIONS.fullmatch(prefix)
    if count == 4 and is_named and _is_unit(values, error):
        return [f"{stem}{q}" for q in _POSE[3:]], [""] * 4, values[:, order], not stated
    if count == 6 and (match := _WRENCH.fullmatch(prefix)):
        stem = f"{match[1]}_" if match[1] else ""
        names = [f"{stem}{k}_{a}" for k in ("force", "torque") for a in "xyz"]
        return names, ["N"] * 3 + ["Nm"] * 3, values, False
    if count == 6 and _DOOSAN.fullmatch(prefix):
        angles = np.nan_to_num(values[:, 3:])
        quaternions = Rotation.from_euler("ZYZ", angles, degrees=True).as_quat()
        units = ["mm"] * 3 + [""] * 4
        return pose, units, np.hstack([values[:, :3], quaternions]), False
    is_tcp = count == 6 and _TCP_POSE.fullmatch(prefix)
    vectors = np.nan_to_num(values[:, 3:])
    if is_tcp and np.max(np.linalg.norm(vectors, axis=1), initial=0.0) < REVOLUTION:
        quaternions = Rotation.from_rotvec(vectors).as_quat()
        return pose, units, np.hstack([values[:, :3], quaternions]), False
    if is_tcp or (count == 6 and _CARTESIAN.fullmatch(prefix.removesuffix("position"))):
        # Angles of an unknown convention.
        return pose[:3], [""] * 3, values[:, :3], False
    is_pose = count == 7 and (stated or not _JOINTS.fullmatch(prefix))
    if is_pose and _is_unit(values[:, 3:], _EXACT):
        numbers = np.hstack([values[:, :3], values[:, 3:][:, order]])
        return pose, [""] * 7, numbers, not stated
    first = 0
    if count == 9 and (
        _MATRICES.fullmatch(prefix) or ("cov" not in prefix and _is_turning(values))
    ):  # No position.
        first, count = 3, 12
        values = np.insert(values, [3, 6, 9], 0.0, axis=1)
    if count == 12:
        last = np.tile([0.0, 0.0, 0.0, 1.0], (len(values), 1))
        values, count = np.hstack([values, last]), 16
    if count == 16 and (poses := _matrix_poses(values)) is not None:
        return pose[first:], units[first:], poses[:, first:], False
    return None


def _is_turning(values: Array) -> bool:
    """Return whether values (N, 9) may be a rotation that changes.

    A constant one may be a covariance. Only the first one must be orthonormal.
    """
    known = values[~np.any(np.isnan(values), axis=1)]
    return are_orthonormal(known[:1].reshape(-1, 3, 3)) and bool(
        np.any(known != known[:1])
    )


def _is_unit(quaternions: Array, error: float) -> bool:
    lengths = np.linalg.norm(quaternions, axis=1)
    return bool(np.all(np.abs(lengths[~np.isnan(lengths)] - 1) < error))


def are_orthonormal(matrices: Array) -> bool:
    """Return whether matrices (N, 3, 3) are orthonormal to a hundredth, or NaN."""
    products = matrices @ np.swapaxes(matrices, 1, 2)
    return not np.any(np.abs(products - np.eye(3)) > 1e-2)


def _matrix_poses(values: Array) -> Array | None:
    """Return positions and quaternions (N, 7) of 4 x 4 poses (N, 16), or None."""
    is_known = np.all(np.isfinite(values), axis=1)
    X = np.tile(np.eye(4), (len(values), 1, 1))
    X[is_known] = values[is_known].reshape(-1, 4, 4)
    if not np.allclose(X[:, 3], [0, 0, 0, 1]):
        X = np.swapaxes(X, 1, 2)
    R = X[:, :3, :3]
    is_rigid = np.all(np.linalg.det(R) > 0)  # No reflection.
    if not (is_rigid and are_orthonormal(R)) or not np.allclose(X[:, 3], [0, 0, 0, 1]):
        return None
    out = np.hstack([X[:, :3, 3], Rotation.from_matrix(R).as_quat()])
    out[~is_known] = np.nan
    return out
