"""Times of the samples of a recording, in seconds and in order."""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fmp_drake.errors import DemonstrationError, SkillFileError
from fmp_drake.numeric import Array, Indices
from fmp_drake.primitives.data.reading.table import (
    ANGLES,
    LENGTHS,
    TIMES,
    Column,
    ReadingOptions,
    column_key,
    columns_option,
    count_text,
)

# In order of preference: a sensor's stamp before the time of receipt, another clock last.
_TIMES = (
    re.compile(r"(.*_)?(header_)?stamp"),
    re.compile(
        r"(.*_)?(u?time|timestamps?|ts|t|tout|times|datetime|elapsed|sec|secs|seconds)"
        r"|zeit|zeitstempel|uhrzeit|datum"
    ),
    re.compile(r"(.*_)?(time|timestamps?)_(mono(tonic)?|unix|utc)"),
)
# Names of times that may be something else: times where nothing else is.
_OTHER_TIMES = re.compile(
    "date|tiempo|temps|tempo|ipoc|epoch|clock|(.*_)?time_(from|since)_start"
)
_NANOSECONDS = ("nsecs", "nsec", "nanosec")
# Ranges of absolute times, s: since 1970, for dates from 2001 on; for ticks of 100 ns,
# since the year 1 or 1601.
_EPOCHS = {
    **dict.fromkeys(("s", "ms", "us", "ns"), (1e9, 4e9)),
    "100 ns": (1.2e10, 7e10),
}
# Plausible sample intervals of a recorded movement, and the longest with absolute times, s.
_INTERVALS, _LONGEST_INTERVAL = (4e-4, 0.5), 1.0
# Greatest fraction of samples whose time repeats, with different and with any values.
_MOST_REPEATED, _MOST_EQUAL = 0.1, 0.5
# Least number of samples from whose times a rate is read to a percent.
_MEASURABLE = 100
# Samples that were received in bursts: least interval between bursts, in medians of all
# intervals, greatest number of pauses of a movement, also relative to the samples, and
# fraction of the time between.
_PAUSE, _MOST_PAUSES, _PAUSES, _PAUSED = 10.0, 4, 0.02, 0.8
# Greatest step of a counter without a name; those of stamps in us or ns are greater.
_LARGEST_COUNT = 500
# Fraction of steps of a clock that are alike.
_MOSTLY = 0.8
# Steps backwards in time, in sample intervals, up to which samples are put in order.
_LARGEST_STEP_BACK = 3.0


class Stamps(NamedTuple):
    """Times in a file.

    `unit` and `source`, the name or number of their column, are "" where unknown. `origin` was
    subtracted from them, s.
    """

    values: Array
    unit: str
    source: str
    origin: float = 0.0


def time_column(
    columns: Sequence[Column],
    options: ReadingOptions,
    listed: str,
    remarks: list[str],
) -> tuple[Stamps | None, set[int]]:
    """Return the times, and the indices of all columns of times."""
    candidates = [
        column
        for form in _TIMES
        for column in columns
        if form.fullmatch(column.key) and column.unit not in (*LENGTHS, *ANGLES)
        if not column.key.endswith("_t") or _mostly_increases(column)
    ]
    # Others may be temperatures.
    candidates = [c for c in candidates if c.unit in ("", *TIMES)] or candidates
    with_unit = [c for c in columns if c.header_unit in TIMES and c.is_increasing]
    candidates = candidates or with_unit
    stamps = _stamps(columns)
    indices = {column.number for column in (*candidates, *sum(stamps, ()))}
    if options.sample_rate is not None:
        return None, indices
    if "time" in options.columns:
        names, numbers = zip(*((c.name, c.place) for c in columns), strict=True)
        column = columns[options.column("time", names, numbers)]
        header_unit = options.source("time")[1] or column.unit
        stamp = Stamps(column.values, header_unit, column.source)
        return stamp, {*indices, column.number}
    if stamps:
        whole, rest = (column.values for column in stamps[0])
        remarks.append("the time is that of the stamps")
        unit = 1e-9 if np.max(rest) >= 1e6 else 1e-6
        relative = whole - whole[0] + unit * rest
        return Stamps(relative, "s", "", float(whole[0])), indices
    # Stamps that were never set are constant.
    changing = [c for c in candidates if np.any(c.values != c.values[0])]
    candidates = changing or candidates
    if not candidates:
        unnamed = [c for c in columns if not c.key]
        candidates = [c for c in unnamed[:1] if c.is_increasing and not _is_count(c)]
        if unnamed and _numbers_samples(unnamed[0]):
            second = [c for c in unnamed[1:2] if not _numbers_samples(c)]
            candidates = [c for c in second if _is_steady(c)]
        candidates = candidates or [
            c for c in columns if _OTHER_TIMES.fullmatch(c.key) and c.is_increasing
        ]
        if not candidates:
            raise SkillFileError(_missing_time(columns, listed, remarks))
        remarks.append(
            f"column {candidates[0].place}, which increases, is taken for the time"
        )
    column = candidates[0]
    if len(candidates) > 1:
        remarks.append(f"the time is {column.name}")
    stamp = Stamps(column.values, column.unit, column.source)
    return stamp, {*indices, column.number}


def _missing_time(
    columns: Sequence[Column], listed: str, remarks: Sequence[str]
) -> str:
    """Return the error message for a missing time, with advice."""
    others = [remark for remark in remarks if remark.endswith("left out: not numeric")]
    beside = f" ({others[0]})" if others else ""
    clock = next((c for c in columns if _is_steady(c) and not c.is_counter), None)
    option = columns_option({"time": clock.source}) if clock else ""
    advice = f", or the column: {option}" if option else ""
    return (
        f"no column holds the time; {listed}"
        f"{beside}. Give the sample rate in Hz, such as --sample-rate 100{advice}"
    )


def _mostly_increases(column: Column) -> bool:
    """Return whether a column increases, mostly or on the whole, unlike `x_t`, `mag_x_uT`."""
    steps = np.diff(column.values[~np.isnan(column.values)])
    is_rising = 2 * np.sum(steps) >= np.sum(np.abs(steps))
    return bool(is_rising or np.mean(steps >= 0) > _MOSTLY)


def _is_steady(column: Column) -> bool:
    """Return whether a column increases in steps that are mostly alike, as time does."""
    if not column.is_increasing:
        return False
    steps = np.diff(column.values)
    is_alike = np.abs(steps - np.median(steps)) <= 0.5 * np.median(steps)
    return bool(np.mean(is_alike) > _MOSTLY)


def _is_count(column: Column) -> bool:
    """Return whether a column counts rows or messages, unlike stamps in us, ns or since 1970."""
    start, step = column.values[0], np.median(np.diff(column.values))
    is_clock = step > _LARGEST_COUNT and _is_steady(column)
    return column.is_counter and not is_clock and bool(start < _EPOCHS["s"][0])


def _numbers_samples(column: Column) -> bool:
    """Return whether a column counts in steps of 1."""
    return bool(np.all(np.diff(column.values) == 1))


def _stamps(columns: Sequence[Column]) -> list[tuple[Column, ...]]:
    """Return pairs of columns of the seconds and nanoseconds, or microseconds, of stamps."""
    named = {column_key(column.name): column for column in reversed(columns)}
    stamps: list[tuple[Column, ...]] = []
    for column in columns:
        match = re.fullmatch(r"(.*_)?secs?", column_key(column.name))
        names = [f"{match[1] or ''}{n}" for n in _NANOSECONDS] if match else []
        stamps += [(column, named[name]) for name in names if name in named]
    return stamps or [pair for pair in pairwise(columns) if _is_stamp(*pair)]


def _is_stamp(seconds: Column, fraction: Column) -> bool:
    """Return whether whole seconds increase where their fraction wraps, as in a clock."""
    values = np.column_stack([seconds.values, fraction.values])
    if not np.all(values % 1 == 0) or np.min(values) < 0 or np.max(values[:, 1]) < 1e4:
        return False
    steps, rises = np.diff(values, axis=0).T
    return bool(
        np.all(steps >= 0)
        and np.any(steps > 0)
        and np.max(values[:, 1]) < 1e9
        and np.all(rises[steps == 0] >= 0)
        and np.any(rises[steps > 0] < 0)
        and np.any(rises > 0)
    )


def ordered_times(
    stamp: Stamps | None,
    rows: Indices,
    values: Array,
    options: ReadingOptions,
    remarks: list[str],
) -> tuple[Array, Indices, float]:
    """Return increasing times, s, the indices of their rows, and the subtracted time, s.

    The stamp is None for a known rate.
    """
    count = len(rows)
    if stamp is None:
        time = np.arange(count) / (options.sample_rate or 1.0)
        return time, np.arange(count), 0.0
    time, unit, start = _seconds(stamp.values[rows], stamp.unit, stamp.source)
    if unit != "s":
        remarks.append(f"the time is in {unit}")
    order, steps = np.arange(count), np.diff(time)
    forward = steps[steps > 0]
    interval = float(np.median(forward)) if len(forward) else 0.0
    step_back = -float(np.min(steps, initial=0.0))
    if step_back > _LARGEST_STEP_BACK * interval:
        row = int(np.argmax(steps < 0))
        raise DemonstrationError(
            f"time does not increase after sample {row} ({time[row]:g} s, then "
            f"{time[row + 1]:g} s). Cut the file there, or, if the samples are at equal "
            f"intervals, give their rate: --sample-rate {_rate(interval)}"
        )
    if step_back > 0:
        remarks.append("samples sorted by time")
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
    is_new = np.concatenate([[True], np.diff(time) != 0])
    has_other_values = np.concatenate(
        [[False], np.any(np.diff(values, axis=0) != 0, axis=1)]
    )
    repeated = int(np.count_nonzero(~is_new))
    is_coarse = np.count_nonzero(~is_new & has_other_values) > _MOST_REPEATED * count
    if is_coarse or repeated > _MOST_EQUAL * count:
        # Samples with the first and the last time may be missing.
        changes = np.flatnonzero(is_new)[1:]
        span = int(np.ptp(changes)) if len(changes) else 0
        is_known = span >= _MEASURABLE
        rate = _rate(float(np.ptp(time[changes])) / span) if is_known else "HZ"
        raise DemonstrationError(
            f"the time stays the same in {repeated} of {count} samples: it is too coarse. "
            f"Give the sample rate instead: --sample-rate {rate}"
        )
    pauses = forward[forward > _PAUSE * interval]
    is_frequent = len(pauses) > max(_MOST_PAUSES, _PAUSES * count)
    if is_frequent and np.sum(pauses) > _PAUSED * np.sum(forward):
        mean = float(np.sum(forward) / count)
        raise DemonstrationError(
            f"the samples come in bursts, {1e3 * interval:.3g} ms apart and "
            f"{1e3 * np.median(pauses):.3g} ms between bursts: these are times of receipt. Give "
            f"the sample rate instead: --sample-rate {_rate(mean)}"
        )
    if repeated:
        samples = count_text(repeated, "sample")
        remarks.append(f"{samples} with the time of the one before left out")
    return time[is_new], order[is_new], stamp.origin + start


def _rate(interval: float) -> str:
    """Return the sample rate of an interval in s, for a command."""
    return f"{1 / interval:.6g}" if interval > 0 else "100"


def _seconds(time: Array, stated_unit: str, source: str) -> tuple[Array, str, float]:
    """Return times in seconds, their unit in the file, and the subtracted time, s.

    Times since 1970 start at 0.

    Parameters
    ----------
    time : ndarray, shape (N,)
    stated_unit : str
        "" to infer it from the numbers.
    source : str
        Name or number of the column.

    Raises
    ------
    DemonstrationError
        Where the unit is unknown or cannot be inferred.
    """
    if stated_unit and stated_unit not in TIMES:
        raise DemonstrationError(
            f"the time is in {stated_unit!r}; expected s, ms, us or ns."
        )
    steps = np.abs(np.diff(time))
    steps = steps[steps > 0]
    unit = stated_unit
    if not unit and len(steps):
        step, start = float(np.median(steps)), abs(float(time[0]))
        if 2 * len(steps) < len(time):  # Several samples have the same time.
            step = float(np.ptp(time)) / len(time)
        since_epoch = [
            name
            for name, (least, most) in _EPOCHS.items()
            if least <= start * TIMES[name] <= most
            and step * TIMES[name] <= _LONGEST_INTERVAL
        ]
        if since_epoch:
            unit = since_epoch[0]
        elif step < 1:
            unit = "s"
        elif np.all(np.diff(time) == 1):
            raise DemonstrationError(
                "the time column counts 1, 2, 3 ...: samples or milliseconds. Give the sample "
                "rate (--sample-rate 1000), or the unit: "
                f"{columns_option({'time': f'{source} [ms]'})}"
            )
        else:
            low, high = _INTERVALS
            units = (u for u in ("ms", "us", "ns") if low <= step * TIMES[u] <= high)
            unit = next(units, "s")
    start = time[0] if abs(time[0]) * TIMES[unit or "s"] > 1e8 else 0.0
    factor = TIMES[unit or "s"]
    return (time - start) * factor, unit or "s", float(start * factor)
