"""Which column is the time, a position, an orientation, a counter."""

import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError, SkillFileError
from fmp_drake.primitives.data.demonstration import Demonstration, default_channels
from fmp_drake.primitives.data.reading.reading_options import (
    ReadingOptions,
    shown_columns,
)
from fmp_drake.primitives.data.reading.table import Table
from fmp_drake.primitives.data.reading.units import (
    LENGTHS,
    TIMES,
    in_our_units,
    seconds,
    suffixed_unit,
)

# In the order in which they are taken: a sensor's stamp before that of the receipt.
_TIMES = (
    re.compile(r"(.*_)?(header_)?stamp"),
    re.compile(r"(.*_)?(time|timestamps?|t|times|datetime|elapsed|sec|secs|seconds)"),
)
_STAMP = re.compile(r"(.*?)(?:secs?|nsecs|nanosec)")
_POSITION = re.compile(
    r"(.*?)_?(?:p|t|pos|position|translation|point|trans|xyz|ee|eef|tcp)?_?([xyz])"
)
_QUATERNION = re.compile(
    r"(.*?)_?(?:q|quat|quaternion|orientation|rotation|rot)_?([xyzw])"
)
_NO_POSITION = re.compile(
    r"orient|quat|rot|euler|rpy|force|torque|wrench|twist|vel|acc|gyro|mag|angular"
    r"|(^|_)(f|v|a|w|r|q|m|d|omega|tau)$"
)
_COUNTER = re.compile(
    r"|unnamed_0|(.*_)?(index|idx|seq|frame|frame_number|sample|count|counter|row|no|id|i|n)"
)
_UNITS = (
    (
        re.compile(
            r"(.*_)?(joint|theta|q|angle|roll|pitch|yaw|r[xyz])_?\d*(_pos(ition)?)?"
        ),
        "rad",
    ),
    (re.compile(r"(.*_)?(force(_?[xyz])?|f_?[xyz])"), "N"),
    (re.compile(r"(.*_)?torque(_?[xyz])?"), "Nm"),
)
QUATERNION = ("qx", "qy", "qz", "qw")
_LONGEST_REPETITION = 0.1
_UNIT_LENGTH = 0.1


def demonstration_of(table: Table, options: ReadingOptions) -> Demonstration:
    """Return the movement that the columns of a table hold.

    An orientation is in the channels `qx`, `qy`, `qz` and `qw`; what was recognised, and
    what was left out, in the note.

    Raises
    ------
    SkillFileError
        Where there is no time, or a column that was asked for.
    DemonstrationError
        Where the numbers cannot be used.
    """
    names = [_plain(name) for name in table.names]
    remarks = list(table.remarks)
    stamp, timely = _time(table, names, options, remarks)
    chosen = {c: options.column(c, table.names) for c in options.columns if c != "time"}
    if not chosen:
        left = [
            i
            for i in range(len(names))
            if i not in timely and not _counts(names[i], table.values[:, i])
        ]
        chosen = _channels(table, names, left, remarks)
    if not chosen:
        raise SkillFileError(
            f"there is a time but no channel; {shown_columns(table.names)}."
        )
    index = list(chosen.values())
    is_there = ~np.all(np.isnan(table.values[:, index]), axis=1)
    if not np.all(is_there):
        remarks.append(f"{np.sum(~is_there)} rows without a value left out")
    time, is_new = _clock(stamp, is_there, options, remarks)
    kept = np.flatnonzero(is_there)[is_new]
    channels, values, units = [], [], []
    for channel, i in chosen.items():
        stated = options.source(channel)[1] if channel in options.columns else ""
        factor, unit = in_our_units(_unit(table, names, i, channel, stated, options))
        values.append(factor * table.values[kept, i])
        channels.append(channel)
        units.append(unit)
        if factor != 1:
            remarks.append(f"{channel} was in another unit: now in {unit}")
    demonstration = Demonstration(
        time=time,
        values=np.column_stack(values),
        channels=tuple(channels),
        units=tuple(units),
        frame=table.frame,
        note="; ".join(remarks),
    )
    if set(QUATERNION) <= set(channels):
        _check_lengths(demonstration.select(QUATERNION).values)
    return demonstration


def _plain(name: str) -> str:
    """Return a name in lower case, its words joined by underscores."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _counts(name: str, values: NDArray[np.float64]) -> bool:
    """Return whether a column only counts the rows, or the messages."""
    return bool(
        _COUNTER.fullmatch(name)
        and len(values) > 1
        and np.all(np.diff(values) >= 1)
        and np.all(values % 1 == 0)
    )


def _grows(values: NDArray[np.float64]) -> bool:
    return len(values) > 1 and bool(np.all(np.diff(values) > 0))


def _time(
    table: Table, names: Sequence[str], options: ReadingOptions, remarks: list[str]
) -> tuple[tuple[NDArray[np.float64], str] | None, set[int]]:
    """Return the times with their unit, and all the columns that tell a time."""
    bare = [suffixed_unit(name) for name in names]
    found = [
        i
        for form in _TIMES
        for i, (name, unit) in enumerate(bare)
        if form.fullmatch(name) and (not unit or unit in TIMES)
    ]
    parts = _stamp_parts(names)
    timely = {*found, *parts}
    if len(table.values) > 1:  # Stamps may be unset.
        found = [i for i in found if np.ptp(table.values[:, i]) != 0] or found
    if options.rate is not None:
        return None, timely
    if "time" in options.columns:
        i = options.column("time", table.names)
        stated = options.source("time")[1] or table.units[i] or bare[i][1]
        return (table.values[:, i], stated), {*timely, i}
    if parts:
        whole, rest = (table.values[:, i] for i in parts)
        remarks.append("the time is that of the stamps")
        return (whole - whole[0] + 1e-9 * rest, "s"), timely
    if not found:
        unnamed = [i for i, name in enumerate(names) if not name][:1]
        found = [
            i
            for i in unnamed
            if _grows(table.values[:, i]) and not _counts(names[i], table.values[:, i])
        ]
        if not found:
            raise SkillFileError(
                f"no column tells the time; {shown_columns(table.names)}. Name it "
                "(--columns time=NAME), or give the sample rate (--sample-rate HZ)."
            )
        remarks.append(f"column {found[0] + 1}, which grows, is taken for the time")
    i = found[0]
    if len(found) > 1:
        remarks.append(f"the time is {table.names[i]}")
    return (table.values[:, i], table.units[i] or bare[i][1]), {*timely, i}


def _stamp_parts(names: Sequence[str]) -> list[int]:
    """Return the columns of seconds and nanoseconds of one stamp, or none."""
    for i, name in enumerate(names):
        found = re.fullmatch(r"(.*_)?(secs?)", name)
        if found:
            begin = found[1] or ""
            rest = [
                names.index(begin + n)
                for n in ("nsecs", "nsec", "nanosec")
                if begin + n in names
            ]
            if rest:
                return [i, rest[0]]
    return []


def _channels(
    table: Table, names: Sequence[str], left: Sequence[int], remarks: list[str]
) -> dict[str, int]:
    """Return the column of each channel, those of position and orientation renamed."""
    if not any(names[i] for i in left):
        return dict(zip(default_channels(len(left)), left, strict=True))
    renamed: dict[int, str] = {}
    bare = {i: suffixed_unit(names[i]) for i in left}
    positions = _groups(
        (i, name)
        for i, (name, unit) in bare.items()
        if not unit or unit in LENGTHS
        if not _NO_POSITION.search(name[:-1].strip("_"))
    )
    if len(positions) > 1:
        named = ", ".join(table.names[group[0]] for group in positions)
        remarks.append(
            f"several positions ({named} ...): choose with --columns x=NAME,y=NAME,z=NAME"
        )
    elif positions:
        renamed.update(zip(positions[0], "xyz", strict=True))
    turned = _groups(((i, names[i]) for i in left), _QUATERNION, "xyzw")
    if len(turned) == 1:
        renamed.update(zip(turned[0], ("qx", "qy", "qz", "qw"), strict=True))
    channels = {
        renamed.get(i) or table.names[i] or f"c{n}": i for n, i in enumerate(left)
    }
    if len(channels) < len(left):
        raise SkillFileError(
            f"names of columns repeat: {shown_columns(table.names)}. Choose by their "
            "numbers from 1 (--columns time=1,x=2)."
        )
    return channels


def _groups(
    names: Iterable[tuple[int, str]],
    form: re.Pattern[str] = _POSITION,
    axes: str = "xyz",
) -> list[tuple[int, ...]]:
    """Return the columns that belong together: one for each axis."""
    found: dict[str, dict[str, int]] = {}
    for i, name in names:
        match = form.fullmatch(name)
        if match:
            found.setdefault(match[1], {}).setdefault(match[2], i)
    whole = {k: g for k, g in found.items() if set(g) == set(axes)}
    if "" in whole:
        whole = {"": whole[""]}
    return [tuple(group[axis] for axis in axes) for group in whole.values()]


def _clock(
    stamp: tuple[NDArray[np.float64], str] | None,
    is_there: NDArray[np.bool_],
    options: ReadingOptions,
    remarks: list[str],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the times in seconds of the rows that are kept, and which rows are."""
    count = int(np.sum(is_there))
    if stamp is None:
        return np.arange(count) / (options.rate or 1.0), np.ones(count, dtype=bool)
    time, unit = seconds(stamp[0][is_there], stamp[1])
    if unit != "s":
        remarks.append(f"the time is in {unit}")
    is_new = np.concatenate([[True], np.diff(time) != 0])[:count]
    repeated = count - int(np.sum(is_new))
    if repeated > _LONGEST_REPETITION * count:
        raise DemonstrationError(
            f"the time stays the same in {repeated} of {count} samples: it is too coarse. "
            "Give the sample rate instead (--sample-rate HZ)."
        )
    if repeated:
        remarks.append(f"{repeated} samples with the time of the one before left out")
    return time[is_new], is_new


def _unit(
    table: Table,
    names: Sequence[str],
    i: int,
    channel: str,
    stated: str,
    options: ReadingOptions,
) -> str:
    """Return the unit of a channel: stated, in its name, given, or that of its kind."""
    if stated or table.units[i]:
        return stated or table.units[i]
    if channel in ("x", "y", "z"):
        return suffixed_unit(names[i])[1] or options.unit or "m"
    for form, unit in _UNITS:
        if form.fullmatch(_plain(channel)):
            return unit
    return "1"


def _check_lengths(quaternions: NDArray[np.float64]) -> None:
    lengths = np.linalg.norm(quaternions, axis=1)
    worst = float(np.max(np.abs(lengths - 1), initial=0.0))
    if not worst < _UNIT_LENGTH:
        raise DemonstrationError(
            f"qx, qy, qz and qw are no unit quaternions (lengths from {lengths.min():.3g} "
            f"to {lengths.max():.3g}); give the columns of the channels (--columns)."
        )
