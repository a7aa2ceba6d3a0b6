"""Readers of tables in text files, also of OptiTrack Motive and Vicon Nexus."""

import codecs
import csv
import re
import shlex
from array import array
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import Array, Mask
from fmp_drake.primitives.data.reading.table import (
    MOST_BYTES,
    ReadingOptions,
    Table,
    check_size,
    count_text,
    named_unit,
    topic_choice,
    unit_symbol,
)

_COMMENT = re.compile(r"^\s*(?:#|%|//)+\s*")
_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-"}
_DELIMITERS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "spaces"}
# Date (by year, or by day), hours, minutes, seconds; a date or the hours may be missing.
_DATE = re.compile(
    r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)[T ,]+|(\d\d?)([./])(\d\d?)[./](\d{4})[T ,]+)?"
    r"(?:(\d\d?):)?(\d\d?):(\d\d?(?:[.,]\d+)?)(?: ?([AaPp])[Mm])?"
    r"(?:Z|[+-]\d\d:?\d\d)?"
)
# List of numbers in a cell, and what separates them.
_LIST = re.compile(r'"?[\[(]([-+.\deE,; ]+)[\])]"?')
_LIST_MARK = re.compile(r"[,; ]+")
# Greatest fraction of broken rows that are left out; rows of which one may be broken.
_MOST_BROKEN, _FEW = 0.01, 20
# Greatest number of broken rows that a command deletes.
_MOST_DELETED = 20
# Greatest number of lines before the numbers.
_LONGEST_PREAMBLE = 200
_UNIT = re.compile(r"[\[(]?(|[numkcd]?s|[munc]?m|m?rad|deg|°|N|N/?m|-|m/s|rad/s)[\])]?")
# Sections of a Vicon file, the best first.
_SECTIONS = ("Objects", "Segments", "Trajectories", "Model Outputs", "Joints")
_RIGID = ("Rigid Body", "Bone")
# Columns of numbers that tell one sensor from another, and the most of them.
_SOURCE = re.compile(
    r"(.*_)?(device|sensor|source|marker|body|hand|controller|tracker|object|serial)"
    r"(_?id|_?index|_?no|_?number)?",
    re.IGNORECASE,
)
_MOST_SOURCES = 20


def read_text(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the columns of a table in a text file.

    Comments and other lines before the numbers are skipped. The last of them is the
    header where it has as many cells. Columns that are not numeric are left out. Of rows
    of several sensors in turn those that the option `topic` names are read.

    Raises
    ------
    SkillFileError
        Where the file is not such a table; the line is named.
    """
    text = _decoded(path)
    # A file that was not written to its end stops within a line.
    return [
        table_of_lines(
            path,
            text.splitlines(),
            topic=options.topic,
            may_be_incomplete=text[-1:] not in "\r\n",
        )
    ]


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file, whatever its encoding."""
    return _decoded(path).splitlines()


def table_of_lines(
    path: Path, lines: list[str], *, topic: str = "", may_be_incomplete: bool = False
) -> Table:
    """Return the table in the lines of a file; see `read_text`."""
    if not any(map(str.strip, lines)):
        raise SkillFileError(
            f"{path} is empty: nothing was recorded. Record one to try with: "
            "fmp-drake record --out demo.csv"
        )
    lines = _without_lists(lines)
    start, delimiter = _first_row(path, lines)
    first = split_cells(lines[start], delimiter)
    width = len(first)
    is_first = not any(map(str.strip, lines[:start])) and len(lines) > start + 1
    if is_first and width > 1 and first == [str(i) for i in range(width)]:
        start += 1  # Numbers instead of names, as by pandas.
        first = split_cells(lines[start], delimiter)
        header, units = [""] * width, [""] * width
    else:
        header, units = _header(path, lines[:start], delimiter, first)
    not_numeric = [i for i, cell in enumerate(first) if number_in(cell) is None]
    numbers, remarks = array("d"), []
    has_commas = False
    broken: list[tuple[int, str]] = []
    words: dict[int, list[str]] = {i: [] for i in not_numeric}
    for number, line in enumerate(lines[start:], start + 1):
        if not line.strip() or _COMMENT.match(line):
            continue
        cells = split_cells(line, delimiter)
        row = [
            0.0 if i in not_numeric else number_in(cell) for i, cell in enumerate(cells)
        ]
        if len(row) < width and may_be_incomplete and number == len(lines):
            remarks.append(f"line {number}, the last, is incomplete: left out")
        elif len(row) != width:
            broken.append((number, f"{len(cells)} cells instead of {width}"))
        elif None in row:
            i = row.index(None)
            broken.append((number, f"{cells[i]!r} in the column {header[i] or i + 1}"))
        else:
            numbers.extend(x for x in row if x is not None)
            for i in not_numeric:
                words[i].append(cells[i])
            has_commas = has_commas or (delimiter != "," and "," in line)
    if broken:
        remarks.append(_without_broken(path, broken, len(numbers) // width))
    values = np.array(numbers).reshape(-1, width)
    unused = {
        i for i in range(width) if not header[i] and np.all(np.isnan(values[:, i]))
    }
    sources = words | {
        i: [f"{value:g}" for value in values[:, i]]
        for i, name in enumerate(header)
        if i not in words and _SOURCE.fullmatch(name)
    }
    for i, labels in sources.items():
        if (rows := _rows_of_one(path, header[i], labels, topic)) is not None:
            values = values[rows]
            unused.add(i)
            remarks.append(f"only rows with {topic} as {header[i]}")
            break
    columns = [i for i in range(width) if i not in unused.union(not_numeric)]
    if delimiter != "," or has_commas:
        remarks.append(
            f"{'decimal commas, ' if has_commas else ''}{_DELIMITERS[delimiter]} between "
            "the columns"
        )
    if not_numeric:
        named = ", ".join(header[i] or f"column {i + 1}" for i in not_numeric)
        remarks.append(f"{named} left out: not numeric")
    return Table(
        names=tuple(header[i] for i in columns),
        units=tuple(units[i] for i in columns),
        numbers=tuple(i + 1 for i in columns),
        values=values[:, columns],
        remarks=tuple(remarks),
        words={header[i]: first[i] for i in not_numeric},
    )


def _rows_of_one(
    path: Path, name: str, labels: Sequence[str], topic: str
) -> Mask | None:
    """Return a mask of the rows with one label, or None where labels do not alternate."""
    column = np.array(labels)
    kinds = list(dict.fromkeys(labels))
    if not 2 <= len(kinds) <= _MOST_SOURCES or np.mean(column[1:] != column[:-1]) < 0.5:
        return None
    if topic not in kinds:
        raise SkillFileError(
            f"{path}: {name or 'a column'} alternates: its rows are of several things; "
            f"{topic_choice(kinds)}"
        )
    return np.asarray(column == topic)


def _without_lists(lines: list[str]) -> list[str]:
    """Return lines in which the numbers of a list in one cell are columns of their own."""
    rows = [split_cells(line, ",") for line in lines[:2]]
    lists = [_LIST.fullmatch(cell) for cell in rows[-1]]
    if len(rows) < 2 or len(rows[0]) != len(lists) or not any(lists):
        return lines
    names: list[str] = []
    for name, match in zip(rows[0], lists, strict=True):
        count = len(_LIST_MARK.split(match[1].strip())) if match else 0
        names += [f"{name}_{i}" for i in range(count)] if match else [name]
    body = (
        _LIST.sub(lambda match: _LIST_MARK.sub(",", match[1].strip()), line)
        for line in lines[1:]
    )
    return [",".join(names), *body]


def _without_broken(path: Path, broken: list[tuple[int, str]], rows: int) -> str:
    """Return a remark that broken lines are left out; raise where they are many."""
    (line, reason), count = broken[0], len(broken)
    example = f"line {line}: {reason}"
    if count <= max(_MOST_BROKEN * rows, rows >= _FEW):
        return f"{count_text(count, 'broken line')} left out ({example})"
    commands = ";".join(f"{number}d" for number, _ in broken[:_MOST_DELETED])
    advice = (
        f"delete them: sed -i.orig {shlex.quote(commands)} {shlex.quote(str(path))}"
        if count <= _MOST_DELETED
        else "export the table again"
    )
    raise SkillFileError(
        f"{path}: {count} of {rows + count} rows broken ({example}); {advice}"
    )


def _decoded(path: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 or the encoding of old spreadsheets."""
    check_size(path, path.stat().st_size, MOST_BYTES / 2)
    raw = path.read_bytes()
    is_utf_16 = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if is_utf_16 else ("utf-8-sig", "cp1252"):
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise SkillFileError(f"{path} is not a text file: no table can be read from it.")


def _first_row(path: Path, lines: list[str]) -> tuple[int, str]:
    """Return the index of the first line of numbers, and the delimiter."""
    content = [i for i, line in enumerate(lines) if line.strip()]
    for n, i in enumerate(content):
        if i > content[0] + _LONGEST_PREAMBLE:
            break
        if _COMMENT.match(lines[i]):
            continue
        most, best = 0.5, ""
        for delimiter in _DELIMITERS:
            if delimiter != " " and delimiter not in lines[i]:
                continue
            cells = [cell for cell in split_cells(lines[i], delimiter) if cell]
            count = sum(number_in(cell) is not None for cell in cells)
            fraction = count / max(1, len(cells))
            if fraction > most:
                most, best = fraction, delimiter
        # Numbers before rows of another length belong to the preamble.
        following = content[n + 1 : n + 3]
        width = len(split_cells(lines[i], best)) if best else 0
        if best and (
            not following
            or any(len(split_cells(lines[k], best)) == width for k in following)
        ):
            return i, best
    if any(line.startswith(("---", "header:")) for line in lines[:_LONGEST_PREAMBLE]):
        raise SkillFileError(
            f"{path} is what `rostopic echo` prints; name the bag, or print a table: "
            "rostopic echo -p TOPIC > table.csv"
        )
    raise SkillFileError(
        f"{path} has no line of numbers among its first {_LONGEST_PREAMBLE}; expected a "
        "table with a header such as `time,x,y,z`, as this writes: "
        "fmp-drake record --out demo.csv"
    )


def split_cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line."""
    if delimiter == " ":
        return [cell.strip('"') for cell in line.split()]
    try:
        cells = next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error as error:
        raise SkillFileError(f"a line cannot be split into cells ({error}).") from None
    return [cell.strip() for cell in cells]


def number_in(cell: str) -> float | None:
    """Return the number or the time in a cell, or None for words."""
    if cell.lower() in _EMPTY:
        return float("nan")
    if "." in cell and "," in cell:  # The last one is the decimal mark.
        whole, mark, rest = cell.rpartition(max(".,", key=cell.rfind))
        cell = re.sub(r"[.,](?=\d{3}(\D|$))", "", whole) + mark + rest
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return _date_in(cell)


def _date_in(cell: str) -> float | None:
    """Return a date and time in seconds since 1970, or a time of day in seconds.

    Days come before months with dots, months before days with slashes.
    """
    match = _DATE.fullmatch(cell)
    if match is None:
        return None
    year, month, day, one, mark, two, late_year, *clock, half = match.groups()
    if one:
        year, day, month = late_year, *((one, two) if mark == "." else (two, one))
    hours, minutes, seconds = (float((c or "0").replace(",", ".")) for c in clock)
    if half:
        hours = hours % 12 + 12 * (half in "Pp")
    time = 3600 * hours + 60 * minutes + seconds
    if not year:
        return time
    for number, other in ((month, day), (day, month)):  # Only one may be a month.
        try:
            return (
                time
                + datetime(int(year), int(number), int(other), tzinfo=UTC).timestamp()
            )
        except ValueError:
            continue
    return None


def _header(
    path: Path, before: list[str], delimiter: str, first: list[str]
) -> tuple[list[str], list[str]]:
    """Return names and units of columns from the last lines before the numbers."""
    width = len(first)
    lines = [line for line in before if line.strip()]
    rows = [split_cells(_COMMENT.sub("", line), delimiter) for line in lines]
    if delimiter == " ":  # `x [mm]` is one cell.
        rows = [re.sub(r"\s+([\[(])", r"\1", " ".join(row)).split() for row in rows]
    if not rows:
        return [""] * width, [""] * width
    below = [""] * width
    if len(rows) > 1 and len(rows[-2]) == width == len(rows[-1]):
        units = [_UNIT.fullmatch(cell) for cell in rows[-1]]
        if all(units):
            below = [unit[1] if unit else "" for unit in units]
            rows.pop()
    names = rows[-1]
    while len(names) > width and not names[-1]:
        names = names[:-1]
    if len(names) == width - 1 and not first[-1]:  # Rows end with a delimiter ...
        names = [*names, ""]
    elif len(names) == width - 1 and first[0].isdigit():  # ... or are numbered.
        names = ["", *names]
    if len(names) != width:
        if _COMMENT.match(lines[-1]) or len(names) == 1:
            return [""] * width, [""] * width
        raise SkillFileError(
            f"{path}: line {len(before) + 1} has {width} cells; the header has "
            f"{len(names)}. Correct the header, or delete it and name the columns by their "
            "numbers, such as --columns time=1,x=2,y=3,z=4."
        )
    split = [named_unit(name) for name in names]
    return (
        [name for name, _ in split],
        [unit or under for (_, unit), under in zip(split, below, strict=True)],
    )


def is_vicon(text: bytes) -> bool:
    """Return whether the first bytes of a file are those of a Vicon export."""
    title, *lines = text.decode("utf-8-sig", "replace").splitlines()[:2] or [""]
    rate = lines[0].strip(",; \t") if lines else ""
    return title.strip(",; \t") in (*_SECTIONS, "Devices") and rate.isdecimal()


def read_optitrack(path: Path, _options: ReadingOptions) -> list[Table]:
    """Return the rigid bodies of an OptiTrack export, or its markers without any.

    Raises
    ------
    SkillFileError
        Where the file has no row `Frame, Time (Seconds), ...`.
    """
    rows = [split_cells(line, ",") for line in read_lines(path)]
    head = next(
        (i for i, row in enumerate(rows) if len(row) > 2 and row[0] == "Frame"), None
    )
    if head is None:
        raise SkillFileError(
            f"{path} has no row `Frame,Time (Seconds),X,...`; export it from Motive as "
            ".csv with rigid bodies."
        )
    settings = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    labels = {row[1]: row for row in rows[1:head] if len(row) > 2}
    axes = rows[head]
    types, bodies, kinds = (
        [*labels.get(key, []), *[""] * len(axes)] for key in ("Type", "Name", "")
    )
    pose_columns = [
        i for i in range(2, len(axes)) if kinds[i] in ("Position", "Rotation")
    ]
    columns = [i for i in pose_columns if types[i] in _RIGID] or pose_columns
    omitted_bodies = {bodies[i] for i in pose_columns} - {bodies[i] for i in columns}
    remark = "OptiTrack, " + ", ".join(dict.fromkeys(bodies[i] for i in columns))
    if omitted_bodies:
        remark += f"; {count_text(len(omitted_bodies), 'marker')} left out"
    units = {
        "Position": unit_symbol(settings.get("Length Units", "")),
        "Rotation": "" if "W" in axes else "deg",
    }
    table = Table(
        names=("time", *(f"{bodies[i]} {kinds[i]} {axes[i]}" for i in columns)),
        units=("s", *(units[kinds[i]] for i in columns)),
        numbers=(2, *(i + 1 for i in columns)),
        values=_numbers(path, rows[head + 1 :], [1, *columns], head + 2),
        remarks=(remark,),
    )
    return [table]


def read_vicon(path: Path, _options: ReadingOptions) -> list[Table]:
    """Return the objects, segments or trajectories of a Vicon export over time.

    Raises
    ------
    SkillFileError
        Where the file has none of these sections.
    """
    lines = read_lines(path)
    delimiter = "\t" if any("\t" in line for line in lines[:5]) else ","
    rows = [split_cells(line, delimiter) for line in lines]
    starts = {
        row[0]: i
        for i, row in reversed(list(enumerate(rows[:-5])))
        if row and row[0] in _SECTIONS and not any(row[1:])
    }
    title = next((name for name in _SECTIONS if name in starts), None)
    if title is None:
        raise SkillFileError(
            f"{path} has none of the sections {', '.join(_SECTIONS)}; export the "
            "trajectories from Nexus as ASCII."
        )
    start = starts[title]
    rate = number_in(rows[start + 1][0])
    subjects, axes, units = (rows[start + k] for k in (2, 3, 4))
    # A name stands over the first of its columns.
    subjects = [*subjects, *[""] * len(axes)]
    for i in range(1, len(subjects)):
        subjects[i] = subjects[i] or subjects[i - 1]
    body = rows[start + 5 :]
    body = body[: next((i for i, row in enumerate(body) if not any(row)), len(body))]
    columns = [i for i, axis in enumerate(axes) if axis and i > 1]
    values = _numbers(path, body, [0, 1, *columns], start + 6)
    if not rate or not columns:
        raise SkillFileError(f"{path} has no rate, or no columns, in {title}.")
    values[:, 1] = (values[:, 0] - values[0, 0]) / rate
    table = Table(
        names=("time", *(_vicon_name(subjects[i], axes[i]) for i in columns)),
        units=("s", *(units[i] if i < len(units) else "" for i in columns)),
        numbers=(2, *(i + 1 for i in columns)),
        values=values[:, 1:],
        remarks=(f"Vicon, {title} at {rate:g} Hz",),
    )
    return [table]


def _vicon_name(subject: str, axis: str) -> str:
    """Return the name of a column; RX and TX become a rotation and a position."""
    kind = {"R": "Rotation", "T": "Position"}.get(axis[0])
    return f"{subject} {kind} {axis[1]}" if kind and axis[1:] else f"{subject} {axis}"


def _numbers(
    path: Path, rows: Sequence[Sequence[str]], columns: Sequence[int], first: int
) -> Array:
    """Return the numbers in some columns, NaN in empty cells, shape (N, len(columns))."""
    out = []
    for line, row in enumerate(rows, first):
        if not any(row):
            continue
        cells = [row[i] if i < len(row) else "" for i in columns]
        numbers = [number_in(cell) for cell in cells]
        if None in numbers:
            raise SkillFileError(
                f"{path}: line {line}: {cells[numbers.index(None)]!r} is not a number."
            )
        out.append(numbers)
    return np.array(out, dtype=float).reshape(-1, len(columns))
