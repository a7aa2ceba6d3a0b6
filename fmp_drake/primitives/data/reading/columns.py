"""Recognition of time, position, orientation and counters among the columns."""

import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError, SkillFileError
from fmp_drake.primitives.data.channels import (
    POSITION_CHANNELS,
    QUATERNION_CHANNELS,
    default_channels,
)
from fmp_drake.primitives.data.reading.reading_options import (
    ReadingOptions,
    shown_columns,
)
from fmp_drake.primitives.data.reading.table import (
    LENGTHS,
    TIMES,
    Table,
    seconds,
    standard_unit,
    suffixed_unit,
)

# In order of preference: a sensor's stamp before the time of receipt.
_TIMES = (
    re.compile(r"(.*_)?(header_)?stamp"),
    re.compile(r"(.*_)?(time|timestamps?|t|times|datetime|elapsed|sec|secs|seconds)"),
)
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
# Greatest fraction of samples whose time repeats, and error of a quaternion's length.
_MOST_REPEATED = 0.1
_LENGTH_ERROR = 0.1


def recognise_columns(table: Table, options: ReadingOptions) -> Table:
    """Return the time and the channels of a table in SI units, the time first.

    An orientation is in the channels `qx`, `qy`, `qz` and `qw`.

    Raises
    ------
    SkillFileError
        Where the time, or a requested column, is missing.
    DemonstrationError
        Where the numbers cannot be used.
    """
    names = [_plain(name) for name in table.names]
    remarks = list(table.remarks)
    stamp, time_columns = _time(table, names, options, remarks)
    index = {c: options.column(c, table.names) for c in options.columns if c != "time"}
    if not index:
        others = [
            i
            for i in range(len(names))
            if i not in time_columns and not _counts(names[i], table.values[:, i])
        ]
        index = _channels(table, names, others, remarks)
    if not index:
        raise SkillFileError(
            f"there is a time but no channel; {shown_columns(table.names)}."
        )
    has_value = ~np.all(np.isnan(table.values[:, list(index.values())]), axis=1)
    if not np.all(has_value):
        remarks.append(f"{np.sum(~has_value)} rows without a value left out")
    time, is_new = _clock(stamp, has_value, options, remarks)
    rows = np.flatnonzero(has_value)[is_new]
    columns, units = [time], ["s"]
    converted: dict[str, list[str]] = {}
    for channel, i in index.items():
        stated = options.source(channel)[1] if channel in options.columns else ""
        factor, unit = standard_unit(_unit(table, names, i, channel, stated, options))
        columns.append(factor * table.values[rows, i])
        units.append(unit)
        if factor != 1:
            converted.setdefault(unit, []).append(channel)
    for unit, channels in converted.items():
        were = "were" if len(channels) > 1 else "was"
        remarks.append(f"{', '.join(channels)} {were} in another unit: now in {unit}")
    return Table(
        names=("time", *index),
        units=tuple(units),
        values=np.column_stack(columns),
        frame=table.frame,
        remarks=tuple(remarks),
    )


def _plain(name: str) -> str:
    """Return a name in lower case, its words joined by underscores."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _counts(name: str, values: NDArray[np.float64]) -> bool:
    """Return whether a column only counts rows or messages."""
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
    """Return the times with their unit, and the indices of all columns of times."""
    bare = [suffixed_unit(name) for name in names]
    candidates = [
        i
        for form in _TIMES
        for i, (name, unit) in enumerate(bare)
        if form.fullmatch(name) and (not unit or unit in TIMES)
    ]
    parts = _stamp_parts(names)
    time_columns = {*candidates, *parts}
    if len(table.values) > 1:  # Stamps that were never set are constant.
        changing = [i for i in candidates if np.ptp(table.values[:, i]) != 0]
        candidates = changing or candidates
    if options.rate is not None:
        return None, time_columns
    if "time" in options.columns:
        i = options.column("time", table.names)
        stated = options.source("time")[1] or table.units[i] or bare[i][1]
        return (table.values[:, i], stated), {*time_columns, i}
    if parts:
        whole, nanoseconds = (table.values[:, i] for i in parts)
        remarks.append("the time is that of the stamps")
        return (whole - whole[0] + 1e-9 * nanoseconds, "s"), time_columns
    if not candidates:
        unnamed = [i for i, name in enumerate(names) if not name][:1]
        candidates = [
            i
            for i in unnamed
            if _grows(table.values[:, i]) and not _counts(names[i], table.values[:, i])
        ]
        if not candidates:
            raise SkillFileError(
                f"no column tells the time; {shown_columns(table.names)}. Name it "
                "(--columns time=NAME), or give the sample rate (--sample-rate HZ)."
            )
        remarks.append(
            f"column {candidates[0] + 1}, which grows, is taken for the time"
        )
    i = candidates[0]
    if len(candidates) > 1:
        remarks.append(f"the time is {table.names[i]}")
    return (table.values[:, i], table.units[i] or bare[i][1]), {*time_columns, i}


def _stamp_parts(names: Sequence[str]) -> list[int]:
    """Return the columns of seconds and nanoseconds of one stamp, or an empty list."""
    for i, name in enumerate(names):
        match = re.fullmatch(r"(.*_)?(secs?)", name)
        if match:
            prefix = match[1] or ""
            nanoseconds = [
                names.index(prefix + n)
                for n in ("nsecs", "nsec", "nanosec")
                if prefix + n in names
            ]
            if nanoseconds:
                return [i, nanoseconds[0]]
    return []


def _channels(
    table: Table, names: Sequence[str], indices: Sequence[int], remarks: list[str]
) -> dict[str, int]:
    """Return the column of each channel; position and orientation get standard names."""
    if not any(names[i] for i in indices):
        return dict(zip(default_channels(len(indices)), indices, strict=True))
    renamed: dict[int, str] = {}
    bare = {i: suffixed_unit(names[i]) for i in indices}
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
        renamed.update(zip(positions[0], POSITION_CHANNELS, strict=True))
    orientations = _groups(((i, names[i]) for i in indices), _QUATERNION, "xyzw")
    if len(orientations) == 1:
        renamed.update(zip(orientations[0], QUATERNION_CHANNELS, strict=True))
    channels = {
        renamed.get(i) or table.names[i] or f"c{n}": i for n, i in enumerate(indices)
    }
    if len(channels) < len(indices):
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
    """Return groups of columns that belong together, one column for each axis."""
    groups: dict[str, dict[str, int]] = {}
    for i, name in names:
        match = form.fullmatch(name)
        if match:
            groups.setdefault(match[1], {}).setdefault(match[2], i)
    whole = {k: g for k, g in groups.items() if set(g) == set(axes)}
    if "" in whole:
        whole = {"": whole[""]}
    return [tuple(group[axis] for axis in axes) for group in whole.values()]


def _clock(
    stamp: tuple[NDArray[np.float64], str] | None,
    has_value: NDArray[np.bool_],
    options: ReadingOptions,
    remarks: list[str],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the times of the rows with a new time, s, and which of the rows these are."""
    count = int(np.sum(has_value))
    if stamp is None:
        return np.arange(count) / (options.rate or 1.0), np.ones(count, dtype=bool)
    time, unit = seconds(stamp[0][has_value], stamp[1])
    if unit != "s":
        remarks.append(f"the time is in {unit}")
    is_new = np.concatenate([[True], np.diff(time) != 0])[:count]
    repeated = count - int(np.sum(is_new))
    if repeated > _MOST_REPEATED * count:
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
    """Return the unit of a channel: stated, in its name, by option, or by its kind."""
    if stated or table.units[i]:
        return stated or table.units[i]
    if channel in POSITION_CHANNELS:
        return suffixed_unit(names[i])[1] or options.unit or "m"
    for form, unit in _UNITS:
        if form.fullmatch(_plain(channel)):
            return unit
    return "1"


def check_quaternions(quaternions: NDArray[np.float64]) -> None:
    """Refuse quaternions (N, 4) that are not of unit length, to a tenth."""
    lengths = np.linalg.norm(quaternions, axis=1)
    worst = float(np.max(np.abs(lengths - 1), initial=0.0))
    if not worst < _LENGTH_ERROR:
        raise DemonstrationError(
            f"qx, qy, qz and qw are not unit quaternions (lengths from {lengths.min():.3g} "
            f"to {lengths.max():.3g}); give the columns of the channels (--columns)."
        )
