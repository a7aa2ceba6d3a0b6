"""Recognition of time, position, orientation, force and counters among the columns."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from fmp_drake.errors import DemonstrationError, SkillFileError
from fmp_drake.numeric import Array, Mask
from fmp_drake.primitives.data.channels import (
    EULER_CHANNELS,
    FORCE_CHANNEL,
    FORCE_COMPONENTS,
    POSITION_CHANNELS,
    QUATERNION_CHANNELS,
    ROTATION_CHANNELS,
    default_channels,
)
from fmp_drake.primitives.data.reading.angles import (
    angle_units,
    check_quaternions,
    continuous_angles,
    may_be_degrees,
    one_orientation,
    without_false_rotation,
)
from fmp_drake.primitives.data.reading.clock import ordered_times, time_column
from fmp_drake.primitives.data.reading.groups import (
    COMMANDED,
    JOINT,
    QUATERNION,
    column_groups,
)
from fmp_drake.primitives.data.reading.rows import (
    LEAST_COMPLETE,
    interpolated,
    steady_samples,
)
from fmp_drake.primitives.data.reading.table import (
    ANGLES,
    FORCES,
    LENGTHS,
    LONGEST_GAP,
    AxisGroups,
    Column,
    ReadingOptions,
    Table,
    axis_groups,
    column_key,
    columns_option,
    count_text,
    repeated_names,
    shown_columns,
    standard_unit,
    suffixed_unit,
)

SEVERAL = "several"
"""First word of the remark on a recording of several positions or arms."""

# Groups of columns: prefix and axis.
_WORD = r"(.*?)_?(?:(?<![a-z0-9])(?:{}))?_?{}"
# The frame of the world, or a base, may follow, as in `pos_w`.
_PLACES = "p|t|(?:pose?|position)(?:_[wb])?|translation|point|trans|xyz|ee|eef|tcp"
_TURNS = f"{_PLACES}|ori(?:en(?:tation|t)?)?|rot(?:ation)?|euler|rpy"
_POSITION = re.compile(_WORD.format(_PLACES, "([xyz])"))
_VECTORS = "rotvec|rotation_vector|axis_angle"
_ROTATION = re.compile(_WORD.format(_TURNS, rf"(?:r|(?:{_VECTORS})_)([xyz])"))
_EULER = re.compile(_WORD.format(_TURNS, "(roll|pitch|yaw)"))
# Letters of KUKA's and FANUC's controllers for roll, pitch and yaw.
_LETTERS = [
    (re.compile(_WORD.format(_TURNS, f"([{axes}])")), axes) for axes in ("cba", "wpr")
]
# Quaternions, the last two with the names of mathematics and of trackers.
_QUATERNIONS = {
    axes: re.compile(QUATERNION.pattern.replace("xyzw", axes))
    for axes in ("xyzw", "ijkw", "xyz0")
}
# Words at the end of a prefix that do not name the body, as in `left_ee`.
_NO_BODY = re.compile(rf"(?:(?:^|_)(?:{_PLACES}))+$")
# Numbers of the joints of an arm, which begin with 1 or 0.
_NUMBERS = ("1234567", "0123456", "123456", "012345")
_NO_ANGLES = "vel|acc|speed|tau|torque|effort|force|temp"
NO_MEASURED_ANGLES = re.compile(rf"{COMMANDED.pattern}|{_NO_ANGLES}|current")
"""Words in the names of numbered joint values that are not measured angles."""
_NORMAL_FORCE = re.compile(r"(.*_)?(normal_force|force_normal)")
_FORCE = re.compile(
    r"(.*?)_?(?:(?<![a-z0-9])(?:(?:net)?fts?\d*(?:_raw|_sensor)?"
    r"|f(?:_?(?:ext(?:_hat_k)?|tool)|_tip)?)|force)_?([xyz])"
)
_ANY = re.compile("(.*?)_?([xyz])")
_TORQUE = re.compile(r"(?<![a-z0-9])t(?=_?[xyz]$)")
# What differs between the names of two arms' columns.
_SIDE = re.compile(r"left|right|(?<![a-z])[lr](?=_)|\d+")
NO_POSITION = re.compile(
    r"orien|quat|rot|euler|rpy|force|torque|moment|reaction|wrench|twist|linear|vel|acc|gyro|mag"
    r"|angular|omega|speed|jerk|(?<![a-z])grav|(^|_)[a-z]_dot|offset|stiffness|damping|(^|_)([ft]|tau)_?ext(_hat_k)?$"
    r"|(^|_)(f|v|a|g|(?<!pos_)(?<!position_)w|r|q|m|d|theta|tau|ori|err|error|f_?tool|f_tip)$|^(q|v|a|w|b)_"
    r"|(^|_)((net)?fts?\d*|gyr|imu|joy(stick)?)(_|$)|(^|_)(normals?|directions?|dir)$"
)
"""Words in the names of axes that are not positions."""
# Words in the names of a tool's position.
_TOOL = re.compile(r"(^|_)(tcp|tool|ee|eef|end_?eff\w*|flange)(_|$)")
ANGLE = re.compile(
    rf"(?!.*(?:{_NO_ANGLES}|current_j_?\d))"
    r"(.*_)?(joints?(_angles?|_states?|_positions)?|theta|q|qpos|posj|j(?=_?\d)|r[xyz]"
    r"|(?<!wrist_)(?<!forearm_)(angle|roll|pitch|yaw))_?\d*(_pos(ition)?)?"
)
"""Name of an angle of a joint or an orientation, as `column_key` returns it."""
_UNITS = (
    (ANGLE, "rad"),
    (re.compile(r"(.*_)?(force(_?[xyz])?|f_?[xyz])"), "N"),
    (re.compile(r"(.*_)?torque(_?[xyz])?"), "Nm"),
)
# Width of a path above which its unit is questioned, m; fraction of the greatest width of
# several paths, up to which a body is not the moving one.
_WIDEST, _STILL = 5.0, 0.1
# Channels of which only some may be named: the rest is recognised.
_PARTS = (
    {*QUATERNION_CHANNELS, *ROTATION_CHANNELS, *EULER_CHANNELS},
    {*FORCE_COMPONENTS, FORCE_CHANNEL},
)


def recognise_columns(table: Table, options: ReadingOptions) -> Table:
    """Return the time and the channels of a table in SI units, the time first.

    An orientation is in the channels `qx`, `qy`, `qz` and `qw`. Where the options name only
    channels of an orientation or a force, the others are recognised.

    Raises
    ------
    SkillFileError
        Where the time, or a requested column, is missing.
    DemonstrationError
        Where the numbers cannot be used.
    """
    remarks = list(table.remarks)
    names, units, values = list(table.names), list(table.units), table.values
    keys = [column_key(name) for name in names]
    group_sources: set[int] = set()
    for group in column_groups(table, keys, options):
        group_sources |= group.sources
        names += group.names
        units += group.units
        values = np.hstack([values, group.values])
        remarks += [group.remark] if group.remark else []
    numbers = (*table.numbers, *[0] * (len(names) - len(table.numbers)))
    columns = [
        Column(
            i, numbers[i], name, *suffixed_unit(column_key(name)), unit, values[:, i]
        )
        for i, (name, unit) in enumerate(zip(names, units, strict=True))
    ]
    listed = shown_columns(table.names, table.numbers)
    stamp, time_columns = time_column(columns, options, listed, remarks)
    unread = group_sources | time_columns
    others = [c for c in columns if c.number not in unread and not c.is_counter]
    least = min(2, len(table.values))
    if few := [c for c in others if np.count_nonzero(~np.isnan(c.values)) < least]:
        others = [c for c in others if c not in few]
        remarks.append(f"{', '.join(c.name for c in few)} left out: less than 2 values")
    if set(options.columns) - {"time"}:
        # A column without a name is found by the name of its channel.
        for column, label in zip(others, _labels(others), strict=True):
            names[column.number] = label
    channels = {
        channel: columns[options.column(channel, tuple(names), numbers)]
        for channel in options.columns
        if channel != "time"
    }
    if set(channels) <= set.union(*_PARTS):
        sources = [column.number for column in channels.values()]
        others = [c for c in others if c.number not in sources]
        named = set[str]().union(*(part for part in _PARTS if part & set(channels)))
        recognised = _channels(others, listed, remarks)
        channels = {n: c for n, c in recognised.items() if n not in named} | channels
    channels = one_orientation(channels, remarks)
    stated = {name: _stated_unit(name, c, options) for name, c in channels.items()}
    channels = without_false_rotation(channels, stated, remarks)
    if not channels:
        raise SkillFileError(f"there is a time column but no channel; {listed}.")
    values = np.column_stack([c.values for c in channels.values()])
    rows = np.flatnonzero(~np.all(np.isnan(values), axis=1))
    if len(rows) == 0:
        raise DemonstrationError(f"there is no number in {', '.join(channels)}.")
    if len(rows) < len(values):
        count = count_text(len(values) - len(rows), "row")
        remarks.append(f"{count} without a value left out")
    time, order, origin = ordered_times(stamp, rows, values[rows], options, remarks)
    rows = rows[order]
    values, is_placed = interpolated(time, values[rows], channels, remarks)
    time, rows, values = time[is_placed], rows[is_placed], values[is_placed]
    complete = _complete_rows(values, channels, remarks)
    time, rows, values = time[complete], rows[complete], values[complete]
    units = _to_standard_units(values, channels, stated, options, remarks)
    names = [*channels]
    values = continuous_angles(values, channels, names, units, remarks)
    metres = [i for i, name in enumerate(names) if name in POSITION_CHANNELS]
    is_steady = steady_samples(time, values[:, metres], remarks)
    time, values, rows = time[is_steady], values[is_steady], rows[is_steady]
    if gaps := np.count_nonzero(np.diff(time) > LONGEST_GAP):
        remarks.append(f"gaps of more than {LONGEST_GAP} s, not bridged: {gaps}")
    if set(QUATERNION_CHANNELS) <= set(names):
        quaternions = [names.index(name) for name in QUATERNION_CHANNELS]
        check_quaternions(values[:, quaternions], rows)
    return Table(
        names=("time", *names),
        units=("s", *units),
        values=np.column_stack([time, values]),
        frame=table.frame,
        remarks=tuple(remarks),
        origin=table.origin + origin,
        has_angles=bool({*names} - {*channels}),
    )


def _complete_rows(
    values: Array, channels: Mapping[str, Column], remarks: list[str]
) -> Mask:
    """Return a mask of the samples with values of all channels; most must have them."""
    is_empty = np.isnan(values)
    complete = ~np.any(is_empty, axis=1)
    count = len(values) - int(np.count_nonzero(complete))
    incomplete = [n for n, e in zip(channels, is_empty.T, strict=True) if np.any(e)]
    choice = next((r for r in remarks if r.startswith(f"{SEVERAL} positions")), "")
    if count > (1 - LEAST_COMPLETE) * len(values) or (count and choice):
        # The channels that most samples have; in a tie, those with more position axes.
        known, counts = np.unique(~is_empty[~complete], axis=0, return_counts=True)
        is_axis = np.isin(list(channels), POSITION_CHANNELS)
        axes = np.count_nonzero(known & is_axis, axis=1)
        best = known[np.lexsort((axes, counts * np.any(known, axis=1), axes > 0))[-1]]
        others = {
            name: column.source
            for (name, column), is_known in zip(channels.items(), best, strict=True)
            if is_known
        }
        if not choice and is_axis.any() and not np.any(best & is_axis):
            choice = (
                f"a position is needed at least every {LONGEST_GAP} s, most of the time"
            )
        choice = choice or f"leave them out: {columns_option(others)}"
        raise DemonstrationError(
            f"{count} of {len(values)} samples have no value of {', '.join(incomplete)}; "
            f"{choice}"
        )
    if count:
        names = ", ".join(incomplete)
        samples = count_text(count, "sample")
        remarks.append(f"{samples} without a value of {names} left out")
    return complete


def _stated_unit(name: str, column: Column, options: ReadingOptions) -> str:
    """Return the unit of a channel that the user or the header gives, or ""."""
    return (
        (options.source(name)[1] if name in options.columns else "")
        or column.header_unit
        or (column.suffix if column.suffix in ANGLES else "")
    )


def _to_standard_units(
    values: Array,
    channels: Mapping[str, Column],
    stated: Mapping[str, str],
    options: ReadingOptions,
    remarks: list[str],
) -> list[str]:
    """Convert the values (N, C) of channels to m, rad and N, and return the new units.

    The units of angles without a unit are those of `angle_units`.
    """
    header_units = [stated[name] for name in channels]
    sources = [
        unit or _unit(column, name, options)
        for unit, (name, column) in zip(header_units, channels.items(), strict=True)
    ]
    angles = angle_units(values, channels, sources, header_units, remarks)
    for i, unit in angles.items():
        sources[i] = unit
    metres = [i for i, name in enumerate(channels) if name in POSITION_CHANNELS]
    stated_units = [unit or options.unit for unit in header_units]
    metres = [i for i in metres if sources[i] == "m" and not stated_units[i]]
    # Single samples may be far away.
    ends = np.quantile(values[:, metres], (0.01, 0.99), axis=0)
    if (width := float(np.ptp(ends, axis=0).max(initial=0))) > _WIDEST:
        remarks.append(
            f"the path is {width:.0f} m wide, if the file is in metres; give another unit, "
            "such as --unit mm"
        )
    factors, units = zip(*map(standard_unit, sources), strict=True)
    values *= factors
    for unit in dict.fromkeys(units):
        if names := [
            name
            for i, name in enumerate(channels)
            if units[i] == unit and factors[i] != 1 and i not in angles
        ]:
            remarks.append(f"{', '.join(names)} converted to {unit}")
    return list(units)


def _labels(columns: Sequence[Column]) -> tuple[str, ...]:
    """Return the names of channels; those of columns without a name are x, y, z, c0 ..."""
    if not any(column.key for column in columns):
        return default_channels(len(columns))
    return tuple(column.name or f"c{n}" for n, column in enumerate(columns))


def _channels(
    columns: Sequence[Column], listed: str, remarks: list[str]
) -> dict[str, Column]:
    """Return the column of each channel.

    Position, orientation and force get standard names.
    """
    labels = dict(zip((c.number for c in columns), _labels(columns), strict=True))
    found = (axis_groups(columns, form, axes) for axes, form in _QUATERNIONS.items())
    orientations = next(filter(None, found), {})
    lengths = [c for c in columns if _is_length(c)]
    keys = {c.key for c in columns}
    # Beside the force fx, fy and fz, tx, ty and tz are a torque, or the position of a pose
    # or of an arm beside another one without a force.
    torques = {c.number for c in lengths if _TORQUE.sub("f", c.key) in keys - {c.key}}
    arms = {_SIDE.sub("", c.key) for c in lengths if c.number not in torques}
    torques -= {c.number for c in lengths if _SIDE.sub("", c.key) in arms}
    others = [c for c in lengths if c.number not in torques or c.unit]
    turns = ((_ROTATION, "xyz"), (_EULER, EULER_CHANNELS), *_LETTERS)
    is_pose = orientations or any(axis_groups(columns, *form) for form in turns)
    if axis_groups(others, _POSITION, "xyz") or not is_pose:
        lengths = others
    positions = axis_groups(lengths, _POSITION, "xyz")
    if "l" in positions:  # Then r is the right hand, not a rotation.
        hands = axis_groups(columns, _POSITION, "xyz").items()
        positions |= {prefix: group for prefix, group in hands if prefix == "r"}
    joints = max((axis_groups(columns, JOINT, n) for n in _NUMBERS), key=len)
    joints = {p: g for p, g in joints.items() if not NO_MEASURED_ANGLES.search(p)}
    if not (positions or orientations or joints):
        in_plane = axis_groups(lengths, _POSITION, "xy")
        positions = {p: group for p, group in in_plane.items() if not p}
    # Zeros of a correction or of an absent hand are not a second position.
    moving = {p: g for p, g in positions.items() if any(c.spread for c in g)}
    if not all(map(COMMANDED.fullmatch, moving)):
        positions = moving
    positions, orientations, commanded = _without_commanded(
        positions, orientations, has_joints=bool(joints)
    )
    if len(positions) == 1:
        orientations = _of_body(orientations, *positions) or orientations
    if commanded:
        columns = [c for c in columns if c not in commanded]
        names_of_commands = ", ".join(c.name for c in commanded)
        remarks.append(f"{names_of_commands} left out: commanded, not measured")
    elif positions and all(map(COMMANDED.fullmatch, positions)):
        names_of_commands = ", ".join(c.name for c in next(iter(positions.values())))
        remarks.append(f"{names_of_commands} are commanded; no position is measured")
    angular = [c for c in columns if not c.unit or c.unit in ANGLES]
    rotations, angles, *lettered = (axis_groups(angular, *form) for form in turns)
    prefixes = {"", *positions}
    rotations = {p: group for p, group in rotations.items() if p in prefixes}
    angles = {p: group for p, group in angles.items() if p in prefixes}
    for groups in lettered:
        angles = angles or {
            p: g for p, g in groups.items() if p in positions and may_be_degrees(g)
        }
    all_forces = axis_groups(
        [c for c in columns if c.unit not in LENGTHS], _FORCE, "xyz"
    )
    in_newtons = [c for c in columns if c.unit in FORCES]
    all_forces = all_forces or axis_groups(in_newtons, _ANY, "xyz")
    # Of a Franka arm's forces, that in the frame of its base (o) goes with its pose.
    measured_forces = {
        p: group
        for p, group in all_forces.items()
        if p[-1:] != "k" or f"{p[:-1]}o" not in all_forces
    }
    roles = (
        (positions, POSITION_CHANNELS),
        (orientations, QUATERNION_CHANNELS),
        (rotations, ROTATION_CHANNELS),
        (angles, EULER_CHANNELS),
        (measured_forces, FORCE_COMPONENTS),
    )
    for groups, axes in roles:
        if len(groups) == 1:
            (group,) = groups.values()
            for column, name in zip(group, axes, strict=False):
                if column.name != name:  # It may be that of a column without the role.
                    labels |= {n: f"other {x}" for n, x in labels.items() if x == name}
                labels[column.number] = name
    normal = (c for c in columns if _NORMAL_FORCE.fullmatch(c.key))
    forces = [c for c in normal if not COMMANDED.fullmatch(c.key)]
    is_force = [c.unit in ("", *FORCES) for c in forces] == [True]
    if is_force and FORCE_CHANNEL not in labels.values():
        labels[forces[0].number] = FORCE_CHANNEL
    if len(positions) > 1:
        measured = [p for p in positions if not COMMANDED.fullmatch(p)] or positions
        widths = {p: max(c.spread for c in positions[p]) for p in measured}
        measured = [p for p in measured if widths[p] >= _STILL * max(widths.values())]
        prefix = max(measured, key=lambda p: bool(_TOOL.search(p)))
        orientation = next(iter(_of_body(orientations, prefix).values()), ())
        chosen = (*positions[prefix], *orientation)
        pose = (*POSITION_CHANNELS, *QUATERNION_CHANNELS)
        remarks.append(_choice("positions", positions, pose, chosen))
    elif len(joints) > 1:
        chosen = next(iter(joints.values()))
        names_of_joints = [f"joint{i}" for i in range(1, len(chosen) + 1)]
        remarks.append(_choice("arms", joints, names_of_joints, chosen))
    channels = {labels[column.number]: column for column in columns}
    if len(channels) < len(columns):
        raise SkillFileError(repeated_names(columns, listed))
    return channels


def _of_body(groups: AxisGroups, prefix: str) -> AxisGroups:
    """Return the groups of the body that a prefix names: `left_ee` beside `left`."""
    body = _NO_BODY.sub("", prefix)
    return {p: group for p, group in groups.items() if _NO_BODY.sub("", p) == body}


def _choice(
    what: str, groups: AxisGroups, channels: Sequence[str], chosen: Sequence[Column]
) -> str:
    """Return a remark on several groups, with the option that chooses columns of one."""
    listed = ", ".join(group[0].name for group in groups.values())
    sources = [column.source for column in chosen]
    option = columns_option(dict(zip(channels, sources, strict=False)))
    return f"{SEVERAL} {what} ({listed} ...): choose with {option}"


def _without_commanded(
    positions: AxisGroups, orientations: AxisGroups, *, has_joints: bool
) -> tuple[AxisGroups, AxisGroups, list[Column]]:
    """Return the measured groups, or all if nothing is measured, and commanded columns."""
    remaining, commanded = [], list[Column]()
    for groups in (positions, orientations):
        measured = {p: g for p, g in groups.items() if not COMMANDED.fullmatch(p)}
        if len(measured) == 1 or (has_joints and not measured):
            commanded += [c for p, g in groups.items() if p not in measured for c in g]
            groups = measured
        remaining.append(groups)
    return remaining[0], remaining[1], commanded


def _is_length(column: Column) -> bool:
    """Return whether a column may be a coordinate of a position."""
    if column.unit:
        return column.unit in LENGTHS
    return not NO_POSITION.search(column.key[:-1].strip("_"))


def _unit(column: Column, channel: str, options: ReadingOptions) -> str:
    """Return the unit that name, option or kind imply, if the header has none."""
    if channel in POSITION_CHANNELS:
        return column.suffix or options.unit or "m"
    forms = (unit for form, unit in _UNITS if form.fullmatch(column_key(channel)))
    return next(forms, "1")
