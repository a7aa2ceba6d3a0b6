"""Tables of numbers, which all readers return, their units, and options for reading them."""

import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import FmpError, SkillFileError
from fmp_drake.numeric import Array, Indices, check_number
from fmp_drake.primitives.data.channels import listed

# Greatest size of a recording, bytes of numbers or of text.
MOST_BYTES = 2**28
# Longest gap between samples that is bridged, s.
LONGEST_GAP = 0.5
# Factors to seconds, metres, radians and newtons.
TIMES = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "usec", "micros", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanoseconds"), 1e-9),
    "100 ns": 1e-7,
}
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
ANGLES = {"rad": 1.0, "deg": np.pi / 180, "°": np.pi / 180}
FORCES = {
    "N": 1.0,
    "kN": 1e3,
    "mN": 1e-3,
    "kgf": 9.80665,
    "gf": 9.80665e-3,
    "lbf": 4.4482216,
}
SYMBOLS = {
    **dict.fromkeys(("meters", "metres", "meter", "metre"), "m"),
    **dict.fromkeys(("centimeters", "centimetres", "centimeter", "centimetre"), "cm"),
    **dict.fromkeys(("millimeters", "millimetres", "millimeter", "millimetre"), "mm"),
    **dict.fromkeys(("inches", "inch"), "in"),
    **dict.fromkeys(("feet", "foot"), "ft"),
    **dict.fromkeys(("radians", "radian"), "rad"),
    **dict.fromkeys(("degrees", "degree"), "deg"),
    **dict.fromkeys(("newtons", "newton"), "N"),
}
"""Symbols of units of length, angle and force that headers spell out."""
# `fx_ft` is of a force-torque sensor, `left_foot` a body.
_SUFFIXES = "|".join(
    sorted(
        {*TIMES, *LENGTHS, *ANGLES, *SYMBOLS} - {"ft", "foot", "feet"},
        key=len,
        reverse=True,
    )
)
_IN_NEWTONS = re.compile(r"((?:.*_)?(?:force(?:_?[xyz])?|f_?[xyz]))_n(?:ewtons?)?")
# Names of columns that only count, and names with the axis before the word `position`.
_COUNTER = re.compile(
    r"|unnamed_0|(.*_)?(index|idx|seq(uence)?|frame|frame_num(ber)?|(time)?steps?"
    r"|iter(ation)?|sample|count|counter|row|no|num|id|i|n)"
)
_AXIS_FIRST = re.compile(
    r"(^|.*_)([xyz])_?(?:pos(?:ition)?|axis|coord(?:inate)?|tcp|eef?|act(?:ual)?|meas(?:ured)?|ist)$"
)
# Names of columns of numbers that identify a sensor; greatest number of sensors in any order;
# otherwise, least number of rows of each, and fraction of rows in the same order.
SOURCE_NAME = re.compile(
    r"((.*[ _])?(device|sensor|source|marker|body|hand|controller|tracker|object|serial|node"
    r"|landmark|keypoint|person)|joint)([ _]?(id|index|no|number))?",
    re.IGNORECASE,
)
_MOST_SOURCES, _FEWEST_ROWS, _MOSTLY = 20, 20, 0.6
# Names of arrays of times.
TIME_NAME = re.compile(r"(?:.*[/.])?(time|times|timestamps?|t|tout)")


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns of numbers.

    Attributes
    ----------
    names : tuple of str
        Names of the columns; "" for a column without a name.
    values : ndarray, shape (N, C)
        NaN in empty cells.
    units : tuple of str
        Units of the columns; "" where unknown. Those of the last columns may be missing.
    numbers : tuple of int
        Numbers of the columns in the file, from 1, where not all of them were read.
    remarks : tuple of str
        Remarks on recognised and omitted parts.
    frame : str
        Name of the frame of the values; "" where unknown.
    words : mapping from str to str
        First cell of each column of words, by its name.
    origin : float
        Time that was subtracted from the times, s.
    has_angles : bool
        Whether its quaternion was recorded as angles, which may be something else.
    saved : mapping, optional
        Fields of a demonstration that the package saved; such a table has no columns.

    Examples
    --------
    >>> Table(names=("t", "x"), values=np.zeros((4, 2))).units
    ('', '')
    """

    names: tuple[str, ...] = ()
    values: Array = field(default_factory=lambda: np.empty((0, 0)))
    units: tuple[str, ...] = ()
    numbers: tuple[int, ...] = ()
    remarks: tuple[str, ...] = ()
    frame: str = ""
    words: Mapping[str, str] = field(default_factory=dict)
    origin: float = 0.0
    has_angles: bool = False
    saved: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        """Set the missing units to unknown, and count the columns."""
        missing = ("",) * (len(self.names) - len(self.units))
        object.__setattr__(self, "units", self.units + missing)
        if not self.numbers:
            object.__setattr__(self, "numbers", tuple(range(1, len(self.names) + 1)))


def check_size(path: object, size: float, most: float = MOST_BYTES) -> None:
    """Raise where a file would take too much memory, before it is read."""
    if size > most:
        raise SkillFileError(
            f"{path} holds {size / 2**20:.0f} MB; at most {most / 2**20:.0f} MB are "
            "read. Cut it, or keep only the columns and the rate that are needed."
        )


@contextmanager
def readable(
    path: object, kind: str, *, extra: str = "", hint: str = ""
) -> Iterator[None]:
    """Convert errors that a library raises inside to one that names the file.

    Parameters
    ----------
    path : path
        For errors.
    kind : str
        Of the file, with its article, for errors.
    extra : str
        Extra of this package that installs the library, where it is optional.
    hint : str
        What to do about a broken file.
    """
    try:
        yield
    except FmpError:
        raise
    except Exception as reason:  # noqa: BLE001 - broken bytes raise anything.
        if extra and isinstance(reason, ImportError):
            message = f"{kind}; install its reader: pip install 'fmp-drake[{extra}]'"
        else:
            message = f"not a readable {kind.split(' ', 1)[1]} ({reason}){hint}"
        raise SkillFileError(f"{path} is {message}.") from None


def topic_choice(names: Sequence[str]) -> str:
    """Return the names that `--topic` may have, and an example."""
    if not names:
        return "there is nothing to choose with --topic"
    example = shlex.quote(names[0])
    return f"choose with --topic among {listed(names, most=40)}: --topic {example}"


def rows_of_sources(
    path: Path, sources: Mapping[int, tuple[str, Sequence[str]]], count: int, topic: str
) -> tuple[Indices, dict[int, str]]:
    """Return the indices of the rows that `topic` names, and its label in each column.

    Parameters
    ----------
    path : pathlib.Path
        For errors.
    sources : mapping from int to (str, sequence of str)
        Name of a column and its labels, by its number.
    count : int
        Number of rows.
    topic : str
        Label in one of the columns, or labels of several, separated by commas.

    Raises
    ------
    SkillFileError
        Where labels of the rows alternate.
    """
    rows, chosen = np.arange(count), dict[int, str]()
    columns = {i: np.array(labels) for i, (_, labels) in sources.items()}
    is_one = any(topic in labels for _, labels in sources.values())
    unknown = []
    for label in filter(None, [topic] if is_one else topic.split(",")):
        fitting = (i for i in columns if i not in chosen and label in columns[i][rows])
        if (i := next(fitting, None)) is None:
            unknown.append(label)
        else:
            rows, chosen[i] = rows[columns[i][rows] == label], label
    for i, (name, _) in sources.items():
        if i not in chosen:
            _check_one_source(path, name, columns[i][rows], [*chosen.values()])
    if chosen and unknown:
        raise SkillFileError(
            f"{path}: no column has {listed(unknown)} to choose; omit it: --topic "
            f"{shlex.quote(','.join(chosen.values()))}"
        )
    return rows, chosen


def _check_one_source(
    path: Path, name: str, labels: NDArray[Any], chosen: Sequence[str]
) -> None:
    """Refuse rows whose labels (n,) alternate; `chosen` are labels of other columns."""
    kinds = list(dict.fromkeys(labels.tolist()))
    is_few = not chosen and len(kinds) <= _MOST_SOURCES
    is_few = is_few or _recur_in_order(labels)
    if len(kinds) >= 2 and is_few and np.mean(labels[1:] != labels[:-1]) >= 0.5:
        choice = topic_choice([",".join([*chosen, kind]) for kind in kinds])
        raise SkillFileError(
            f"{path}: {name} alternates: its rows come from several sources; {choice}"
        )


def _recur_in_order(labels: NDArray[Any]) -> bool:
    """Return whether labels (n,) recur in one order, unlike the values of a measurement."""
    pairs = Counter(pairwise(labels.tolist()))
    most = {label: count for (label, _), count in reversed(pairs.most_common())}
    is_frequent = len(most) * _FEWEST_ROWS <= len(labels)
    return is_frequent and sum(most.values()) > _MOSTLY * len(labels)


def count_text(count: int, noun: str) -> str:
    """Return a number with its noun: `1 sample`, `2 samples`."""
    return f"{count} {noun}{'s' * (count != 1)}"


def named_unit(header: str) -> tuple[str, str]:
    """Split a header into name and unit: `x [mm]`, `Time (s)`; "" without a unit."""
    match = re.fullmatch(r"(.*?)[\s_]*[\[(](\D*?|(?<= \[)1)[\])]\s*", header)
    name, unit = match.groups() if match else (header, "")
    return name.strip(), unit_symbol(unit)


def unit_symbol(unit: str) -> str:
    """Return the symbol of a unit that is spelled out, such as `Millimeters`.

    It is empty for the format of a time of day, such as `hh:mm:ss`.
    """
    if ":" in unit:
        return ""
    lower = unit.strip().lower()
    known = {*TIMES, *LENGTHS, *ANGLES}
    return SYMBOLS.get(lower, lower if lower in known else unit.strip())


def suffixed_unit(name: str) -> tuple[str, str]:
    """Split a name that ends with its unit: `time_ms`, `x_meters`; "" without a unit.

    A name that is only a unit of time, other than s, is that of the time: `millis`.
    """
    if name in TIMES and name != "s":
        return "time", name
    if match := _IN_NEWTONS.fullmatch(name):
        return match[1], "N"
    match = re.fullmatch(rf"(.+?)_(?:in_)?({_SUFFIXES})", name)
    return (match[1], SYMBOLS.get(match[2], match[2])) if match else (name, "")


def standard_unit(unit: str) -> tuple[float, str]:
    """Return the factor from a unit to metres, radians or newtons, and the new unit."""
    for factors, standard in ((LENGTHS, "m"), (ANGLES, "rad"), (FORCES, "N")):
        if unit in factors:
            return factors[unit], standard
    return 1.0, unit


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """Choice of columns, and information that a file lacks.

    Attributes
    ----------
    columns : mapping from str to str
        Column of each channel and of `time`: its name, or its number from 1. A
        unit may follow in brackets: `{"time": "stamp [ms]", "x": "3"}`. All channels
        where empty. Beside an orientation or a force the other channels are recognised.
    unit : str
        Unit of positions where the file does not state it: m, cm, mm ...
    sample_rate : float, optional
        Samples per second (Hz), instead of a time column.
    topic : str
        Topic of a bag, or several (`/pose,/wrench`); feature of a dataset (`action`), or sensor in
        a table of several, by labels of one or more columns (`Left,8`).
    quaternions : {"xyzw", "wxyz"}, optional
        Order of the four numbers of an array whose file does not name them; "xyzw" where
        None. The numbers alone do not tell: either order gives unit quaternions with equal
        angles between samples.
    all_arrays : bool
        Whether to read all arrays of an `.npz` file instead of its position alone.

    Examples
    --------
    >>> ReadingOptions.parse("time=stamp [ms], x=3").columns
    {'time': 'stamp [ms]', 'x': '3'}
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    sample_rate: float | None = None
    topic: str = ""
    quaternions: str | None = None
    all_arrays: bool = False

    def __post_init__(self) -> None:
        """Check the unit and the rate."""
        if self.sample_rate is not None:
            check_number(
                self.sample_rate, "the sample rate", above=0, error=SkillFileError
            )
        if self.quaternions not in (None, "xyzw", "wxyz"):
            raise SkillFileError(
                f"the order of quaternions is {self.quaternions!r}; choose xyzw or wxyz."
            )
        if self.unit and self.unit not in LENGTHS:
            raise SkillFileError(
                f"the unit is {self.unit!r}; choose one of {', '.join(LENGTHS)}, or convert "
                "the positions to metres."
            )

    @classmethod
    def parse(cls, columns: str, **others: Any) -> "ReadingOptions":
        """Return options whose columns are written as `time=stamp,x=3`."""
        pairs = [part.partition("=") for part in columns.split(",") if part.strip()]
        wrong = [name for name, _, source in pairs if not (name and source.strip())]
        if wrong:
            raise SkillFileError(
                f"the columns are {columns!r}; write NAME=COLUMN for each, as in "
                "time=stamp,x=px,y=py,z=pz."
            )
        sources = {name.strip(): source.strip() for name, _, source in pairs}
        return cls(columns=sources, **others)

    @property
    def quaternion_order(self) -> str:
        """The order in which unnamed quaternions are read."""
        return self.quaternions or "xyzw"

    def quaternion_remark(self, name: str) -> str:
        """Return a remark on the order in which unnamed quaternions are read."""
        order = ", ".join(self.quaternion_order)
        remark = f"the quaternion from {name} is read as {order}"
        if self.quaternions is None:
            remark += "; if it is w, x, y, z, add --quaternions wxyz"
        return remark

    def source(self, channel: str) -> tuple[str, str]:
        """Return the name or number of a channel's column, and its unit or ""."""
        return named_unit(self.columns[channel])

    def column(
        self, channel: str, names: tuple[str, ...], numbers: tuple[int, ...]
    ) -> int:
        """Return the index of a channel's column, among names and numbers in the file."""
        source, _ = self.source(channel)
        lower = [name.lower() for name in names]
        for name, candidates in ((source, list(names)), (source.lower(), lower)):
            if name in candidates:
                return candidates.index(name)
        if re.fullmatch(r"[1-9]\d*", source) and int(source) in numbers:
            return numbers.index(int(source))
        raise SkillFileError(
            f"there is no column {source!r} for {channel}; "
            f"{shown_columns(names, numbers)}."
        )


def columns_option(sources: Mapping[str, str]) -> str:
    """Return the option of the command line that reads channels from columns."""
    pairs = ",".join(f"{channel}={source}" for channel, source in sources.items())
    return f"--columns {shlex.quote(pairs)}"


def shown_columns(names: tuple[str, ...], numbers: tuple[int, ...]) -> str:
    """Return the names of columns, or their numbers in the file, for errors."""
    if not any(names):
        return f"the {len(names)} columns have no names; give their numbers from 1"
    labels = [
        name or f"(column {number})"
        for name, number in zip(names, numbers, strict=True)
    ]
    return f"the columns are {listed(labels, most=20)}"


def without_copies(table: Table) -> Table:
    """Return a table without columns that repeat the name, unit and values of another."""
    labels = list(zip(table.names, table.units, strict=True))
    columns = table.values.T
    copies = [
        i
        for i, label in enumerate(labels)
        if label[0]
        and (first := labels.index(label)) < i
        and np.array_equal(columns[i], columns[first], equal_nan=True)
    ]
    if not copies:
        return table
    kept = [i for i in range(len(table.names)) if i not in copies]
    repeated = dict.fromkeys(table.names[i] for i in copies)
    return replace(
        table,
        names=tuple(table.names[i] for i in kept),
        units=tuple(table.units[i] for i in kept),
        numbers=tuple(table.numbers[i] for i in kept),
        values=table.values[:, kept],
        remarks=(*table.remarks, f"{listed([*repeated])} repeated: read once"),
    )


class Column(NamedTuple):
    """A column of a table, with its number from 0.

    `place` is its number in the file, from 1; 0 for a computed one. `key` is its name in
    lower case, words joined by underscores, without the unit at its end, which is the
    `suffix`. `header_unit` is the unit of its header.
    """

    number: int
    place: int
    name: str
    key: str
    suffix: str
    header_unit: str
    values: Array

    @property
    def unit(self) -> str:
        """Unit of the header, or of the name."""
        return self.header_unit or self.suffix

    @property
    def source(self) -> str:
        """Name or number of the column for the option `--columns`."""
        is_safe = self.name and not set(self.name) & set(",=[(")
        return self.name if is_safe else str(self.place)

    @property
    def spread(self) -> float:
        """Greatest minus least value."""
        return float(np.nanmax(self.values) - np.nanmin(self.values))

    @property
    def is_increasing(self) -> bool:
        """Whether the values increase strictly."""
        return len(self.values) > 1 and bool(np.all(np.diff(self.values) > 0))

    @property
    def is_counter(self) -> bool:
        """Whether the column only counts rows or messages."""
        return bool(
            _COUNTER.fullmatch(self.key)
            and self.is_increasing
            and np.all(self.values % 1 == 0)
        )


def repeated_names(columns: Sequence[Column], shown: str) -> str:
    """Return the error message for columns with equal names; `shown` lists all of them."""
    places: dict[str, list[int]] = {}
    for column in columns:
        places.setdefault(column.name, []).append(column.place)
    repeated = [
        f"{name} ({', '.join(map(str, numbers))})"
        for name, numbers in places.items()
        if len(numbers) > 1
    ]
    return (
        f"names of columns repeat: {listed(repeated)}; {shown}. Choose columns by names that do "
        "not repeat, or by their numbers from 1, such as --columns time=1,x=2"
    )


AxisGroups = dict[str, tuple[Column, ...]]
"""Columns of the axes, by the prefix of their names."""


def axis_groups(
    columns: Sequence[Column], form: re.Pattern[str], axes: Sequence[str]
) -> AxisGroups:
    """Return groups of columns by their prefixes, with one column for each axis.

    Columns whose names differ in the axis alone, unlike `x` and `tcp_y`, come first.
    """
    groups: dict[str, dict[str, Column]] = {}
    keys = {column.key for column in columns}
    found = [(match, c) for c in columns if (match := form.fullmatch(c.key))]
    for are_alike in (True, False):
        for match, column in found:
            start, end = match.span(2)
            alike = {f"{column.key[:start]}{axis}{column.key[end:]}" for axis in axes}
            if (alike <= keys) == are_alike:
                groups.setdefault(match[1] or "", {}).setdefault(match[2], column)
    complete = {
        prefix: tuple(group[axis] for axis in axes)
        for prefix, group in groups.items()
        if set(group) == set(axes)
    }
    return {"": complete[""]} if "" in complete else complete


def column_key(name: str) -> str:
    """Return a name in lower case, its words joined by underscores: `X Position`, `pos_x`."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    words = re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")
    return _AXIS_FIRST.sub(r"\1pos_\2", words)
