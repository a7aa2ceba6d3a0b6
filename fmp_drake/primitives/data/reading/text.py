"""Readers of tables in text files."""

import codecs
import csv
import re
import shlex
from array import array
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import Array
from fmp_drake.primitives.data.reading.table import (
    FORCES,
    MOST_BYTES,
    SOURCE_NAME,
    SYMBOLS,
    ReadingOptions,
    Table,
    check_size,
    count_text,
    named_unit,
    rows_of_sources,
    unit_symbol,
)

_COMMENT = re.compile(r"^\s*(?:#|%|//)+\s*")
_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-"}
_DELIMITERS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "spaces"}
# Date (by year, or by day), hours, minutes, seconds; a date or the hours may be missing.
_DATE = re.compile(
    r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)[T ,/_-]+|(\d\d?)([./])(\d\d?)[./](\d{4})[T ,]+)?"
    r"(?:(\d\d?):)?(\d\d?):(\d\d?(?:[.,]\d+|:\d{3,})?)(?: ?([AaPp])[Mm])?"
    r"(?:Z|[+-]\d\d:?\d\d)?"
)
# The same with the name of the month, as MATLAB writes it.
_MONTHS = "jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec"
_MONTH = re.compile(rf"(\d\d?)-({_MONTHS})-(?=\d{{4}} )", re.IGNORECASE)
_COMPACT_DATE = re.compile(r"(\d{4})(\d\d)(\d\d)[_T-](\d\d)(\d\d)(\d\d)")
# List of numbers in a cell, and what separates them.
_LIST = re.compile(r""""?(?:array\()?(?:'d', ?)?[\[(]([-+.\deE,; \[\]]+)[\])]+"?""")
_LIST_MARK = re.compile(r"[,; \[\]]+")
# Header of OpenSim, and its columns that are not angles of joints.
_IN_DEGREES = re.compile(r"^inDegrees\s*=\s*(yes|no)\s*$", re.IGNORECASE | re.MULTILINE)
_NO_ANGLE = re.compile(r"time|.*_t[xyz]|[pt]?[xyz]", re.IGNORECASE)
# Greatest fraction of broken rows that are left out; number of rows that allows one.
_MOST_BROKEN, _FEW = 0.01, 20
# Greatest number of broken rows that a command deletes.
_MOST_DELETED = 20
# Most lines of a table whose samples are beside one another, and fewest samples.
_MOST_ROWS, _FEWEST_SAMPLES = 20, 50
# Greatest number of lines before the numbers.
_LONGEST_PREAMBLE = 200
# Beginnings of lines in YAML, as ROS prints messages and trajectories.
_YAML = ("---", "header:", "- ", "joint_names:")
_UNIT = re.compile(
    r"[\[(]?(|[numkcd]?s|[munc]?m|in|ft|m?rad|deg|°|N[/ ]?m|-|m/s|rad/s"
    rf"|{'|'.join(FORCES)}|(?i:sec|seconds|{'|'.join(SYMBOLS)}))[\])]?"
)


class YamlError(SkillFileError):
    """A text file is YAML instead of a table."""


def read_text(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the columns of a table in a text file.

    Comments and other lines before the numbers are skipped. The last of them is the
    header where it has as many cells. Columns that are not numeric are left out. Where
    the rows of several sensors alternate, those that the option `topic` names are read.

    Raises
    ------
    SkillFileError
        Where the file is not such a table; the line is named.
    """
    text = _decoded(path)
    # A file that was not written to its end stops within a line.
    lines, is_cut = text.splitlines(), text[-1:] not in "\r\n"
    return [table_of_lines(path, lines, topic=options.topic, may_be_incomplete=is_cut)]


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
    in_rows = _with_samples_in_rows(lines)
    lines, numbers_in_file = _without_lists(_with_whole_cells(in_rows or lines))
    start, delimiter = _first_row(path, lines)
    first = split_cells(lines[start], delimiter)
    width = len(first)
    is_first = not any(map(str.strip, lines[:start])) and len(lines) > start + 1
    second = split_cells(lines[start + 1], delimiter) if is_first else []
    if _numbers_columns(first, second):
        start, first = start + 1, second
    header, units = _header(path, lines[:start], delimiter, first)
    header = ["" if name.isdecimal() else name for name in header]
    labels = [name or f"column {i}" for i, name in enumerate(header, 1)]
    words = [i for i, cell in enumerate(first) if number_in(cell) is None]
    rows = _read_rows(lines, start, delimiter, labels, words)
    while more := _columns_of_words(rows):
        words = sorted({*words, *more})
        rows = _read_rows(lines, start, delimiter, labels, words)
    values, broken = rows.values, rows.broken
    remarks = ["each line is a channel"] if in_rows else []
    if may_be_incomplete and broken and broken[-1][0] == len(lines):
        *broken, (number, _, _) = broken
        remarks.append(f"line {number}, the last, is incomplete: left out")
    if broken:
        remarks.append(_without_broken(path, broken, len(values)))
    unused = {
        i for i in range(width) if not header[i] and np.all(np.isnan(values[:, i]))
    }
    sources = dict(zip(words, rows.words, strict=True)) | {
        i: [f"{value:g}" for value in values[:, i]]
        for i, name in enumerate(header)
        if i not in words
        and SOURCE_NAME.fullmatch(name)
        and np.all(values[:, i] % 1 == 0)
    }
    named = {i: (labels[i], cells) for i, cells in sources.items()}
    chosen, topics = rows_of_sources(path, named, len(values), topic)
    values = values[chosen]
    unused.update(topics)
    remarks += [f"only rows with {name} as {labels[i]}" for i, name in topics.items()]
    if topic and not topics:
        remarks.append(f"no column has {topic} to choose: --topic is not used")
    columns = [i for i in range(width) if i not in unused.union(words)]
    if len(header) > 1 and (delimiter != "," or rows.has_commas):
        remarks.append(
            f"{'decimal commas, ' if rows.has_commas else ''}{_DELIMITERS[delimiter]} "
            "between the columns"
        )
    if words:
        remarks.append(f"{', '.join(labels[i] for i in words)} left out: not numeric")
    return Table(
        names=tuple(header[i] for i in columns),
        units=tuple(units[i] for i in columns),
        numbers=tuple(
            numbers_in_file[i] if numbers_in_file else i + 1 for i in columns
        ),
        values=values[:, columns],
        remarks=tuple(remarks),
        words={header[i]: first[i] for i in words},
    )


def _numbers_columns(first: list[str], second: list[str]) -> bool:
    """Return whether the first row of a table numbers its columns, as pandas does.

    The cells above other columns of numbers, such as the time, may be words or empty.
    """
    numbers = [cell for cell in first if cell.isdecimal()]
    others = [i for i, cell in enumerate(first) if not cell.isdecimal()]
    if len(first) != len(second) or len(numbers) < 2:
        return False
    counts = [[str(i + k) for i in range(len(numbers))] for k in (0, 1)]
    are_names = all(
        (not first[i] or number_in(first[i]) is None)
        and second[i]
        and number_in(second[i]) is not None
        for i in others
    )
    return are_names and numbers in counts[: 1 + bool(others)]


class _Rows(NamedTuple):
    """Rows of a table.

    `values` (N, C) are 0 in columns of words; `words` contains their cells. `broken` has
    the number of each line that cannot be read, the reason, and its column, if it is one.
    """

    values: Array
    words: list[list[str]]
    broken: list[tuple[int, str, int | None]]
    has_commas: bool


def _read_rows(
    lines: list[str], start: int, delimiter: str, labels: list[str], words: list[int]
) -> _Rows:
    """Return the rows from a line on; `words` are the indices of columns of words."""
    width, numbers, has_commas = len(labels), array("d"), False
    broken: list[tuple[int, str, int | None]] = []
    found: list[list[str]] = [[] for _ in words]
    for number, line in enumerate(lines[start:], start + 1):
        if not line.strip() or _COMMENT.match(line):
            continue
        cells = split_cells(line, delimiter)
        row = [0.0 if i in words else number_in(cell) for i, cell in enumerate(cells)]
        if len(row) != width:
            broken.append((number, f"{len(cells)} cells instead of {width}", None))
        elif None in row:
            i = row.index(None)
            broken.append((number, f"{cells[i]!r} in {labels[i]}", i))
        else:
            numbers.extend(x for x in row if x is not None)
            for i, known in zip(words, found, strict=True):
                known.append(cells[i])
            has_commas = has_commas or (delimiter != "," and "," in line)
    return _Rows(np.array(numbers).reshape(-1, width), found, broken, has_commas)


def _columns_of_words(rows: _Rows) -> list[int]:
    """Return columns of words whose first cells are empty, or numbers.

    Of several in a row only the first is found.
    """
    unread = Counter(i for _, _, i in rows.broken if i is not None)
    most = max(_FEW, _most_broken(len(rows.values)))
    return [i for i, n in unread.items() if n > most]


def _with_samples_in_rows(lines: list[str]) -> list[str]:
    """Return the lines of a table whose samples are beside one another, or nothing.

    MATLAB's matrices (D, N) are saved like this; their rows may begin with names.
    """
    if len(lines) > _LONGEST_PREAMBLE + _MOST_ROWS:
        return []
    content = [line for line in lines if line.strip() and not _COMMENT.match(line)]
    if not 1 < len(content) <= _MOST_ROWS:
        return []
    for delimiter in _DELIMITERS:
        if delimiter != " " and delimiter not in content[0]:
            continue
        rows = [split_cells(line, delimiter) for line in content]
        width = len(rows[0])
        if width > _FEWEST_SAMPLES and all(len(row) == width for row in rows):
            are_channels = _are_channels(rows) and not any(
                len(split_cells(_COMMENT.sub("", line), delimiter)) == width
                for line in lines
                if _COMMENT.match(line)
            )
            cells = zip(*rows, strict=True) if are_channels else ()
            return [delimiter.join(row) for row in cells]
    return []


def _are_channels(rows: list[list[str]]) -> bool:
    """Return whether rows are channels, not samples with a time in the first column."""
    values = [list(map(number_in, row[:_FEWEST_SAMPLES])) for row in rows]
    if any(value is None for row in values for value in row[1:]):
        return False
    firsts = [row[0] for row in values]
    return any(_increase(row[1:]) for row in values) or not _increase(firsts)


def _increase(values: Sequence[float | None]) -> bool:
    """Return whether all values are numbers that increase."""
    return all(a is not None and b is not None and a < b for a, b in pairwise(values))


def _with_whole_cells(lines: list[str]) -> list[str]:
    """Return lines that do not end within quotes."""
    if not any(line.count('"') % 2 for line in lines):
        return lines
    whole: list[str] = []
    is_open = False
    for line in lines:
        if is_open:
            whole[-1] += f" {line}"
        else:
            whole.append(line)
        is_open ^= line.count('"') % 2 == 1
    return whole


def _without_lists(lines: list[str]) -> tuple[list[str], list[int]]:
    """Return lines in which the numbers of a list in one cell are columns of their own.

    The second value lists the numbers of these columns in the file, from 1, with 0 for
    further elements of a list; it is empty where there is no list.
    """
    for delimiter in (",", ";", "\t"):
        rows = [split_cells(line, delimiter) for line in lines[:2]]
        lists = [_LIST.fullmatch(cell) for cell in rows[-1]]
        if len(rows) == 2 and len(rows[0]) == len(lists) and any(lists):
            break
    else:
        return lines, []
    names: list[str] = []
    numbers: list[int] = []
    cells = list(zip(rows[0], lists, strict=True))
    has_header = not all(_LIST.fullmatch(cell) for cell, match in cells if match)
    if len(cells) == 1:
        delimiter = ","
    for number, (name, match) in enumerate(cells, 1):
        count = len(_LIST_MARK.split(match[1].strip(" []"))) if match else 1
        names += [f"{name}_{i}" for i in range(count)] if match else [name]
        numbers += [number, *[0] * (count - 1)]
    body = [
        _LIST.sub(lambda match: _LIST_MARK.sub(delimiter, match[1].strip(" []")), line)
        for line in lines[has_header:]
    ]
    return ([delimiter.join(names), *body], numbers) if has_header else (body, [])


def _most_broken(rows: int) -> float:
    """Return the allowed number of broken lines beside a number of intact rows."""
    return max(_MOST_BROKEN * rows, rows >= _FEW)


def _without_broken(
    path: Path, broken: list[tuple[int, str, int | None]], rows: int
) -> str:
    """Return a remark that broken lines are left out; raise where they are many."""
    (line, reason, _), count = broken[0], len(broken)
    example = f"line {line}: {reason}"
    if count <= _most_broken(rows):
        return f"{count_text(count, 'broken line')} left out ({example})"
    commands = ";".join(f"{number}d" for number, _, _ in broken[:_MOST_DELETED])
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
    if not is_utf_16:  # A file that was not closed may end with zeros.
        raw = raw.rstrip(b"\0")
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
        # Numbers between rows of another length belong to the preamble.
        beside = [*content[max(n - 1, 0) : n], *content[n + 1 : n + 3]]
        cells = split_cells(lines[i], best) if best else [""]
        width = len(cells)
        is_item = best == " " and lines[i].lstrip().startswith("- ")
        # A property of each column, such as `Rate (Hz)`.
        is_property = best != " " and number_in(cells[0]) is None
        if is_property:  # Not the name of a row.
            last = number_in(split_cells(lines[content[-1]], best)[0])
            is_property = last is not None and np.isfinite(last)
        if (
            best
            and not (is_item or is_property)
            and (
                len(content) == n + 1
                or any(len(split_cells(lines[k], best)) == width for k in beside)
            )
        ):
            return i, best
    if any(line.startswith(_YAML) for line in lines[:_LONGEST_PREAMBLE]):
        raise YamlError(
            f"{path} is YAML that cannot be read; expected messages, as `ros2 topic echo` "
            "prints them, or lists of numbers."
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
        # MATLAB writes durations as `0.02 sec`.
        number = cell.removesuffix(" sec").replace(",", ".")
        return _date_in(cell) if "_" in cell else float(number)
    except ValueError:
        return _date_in(cell)


def _date_in(cell: str) -> float | None:
    """Return a date and time in seconds since 1970, or a time of day in seconds.

    With dots, the day comes before the month; with slashes, the month before the day.
    """
    cell = _MONTH.sub(lambda m: f"{m[1]}.{_MONTHS.find(m[2].lower()) // 4 + 1}.", cell)
    match = _DATE.fullmatch(_COMPACT_DATE.sub(r"\1-\2-\3 \4:\5:\6", cell))
    if match is None:
        return None
    year, month, day, one, mark, two, late_year, *clock, half = match.groups()
    if one:
        year, day, month = late_year, *((one, two) if mark == "." else (two, one))
    hours, minutes, seconds = (float(re.sub("[,:]", ".", c or "0")) for c in clock)
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
            below = [unit_symbol(unit[1]) if unit else "" for unit in units]
            rows.pop()
    names = rows[-1]
    if len(names) != width:  # As `numpy.savetxt` writes: commas above, spaces below.
        line = _COMMENT.sub("", lines[-1])
        splits = (split_cells(line, other) for other in _DELIMITERS)
        names = next((cells for cells in splits if len(cells) == width), names)
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
    in_degrees = _IN_DEGREES.search("\n".join(before))
    if in_degrees and lines[0].strip() == "Coordinates":  # Of OpenSim.
        unit = "deg" if in_degrees[1].lower() == "yes" else "rad"
        below = ["" if _NO_ANGLE.fullmatch(name) else unit for name in names]
    return (
        [name for name, _ in split],
        [unit or under for (_, unit), under in zip(split, below, strict=True)],
    )
