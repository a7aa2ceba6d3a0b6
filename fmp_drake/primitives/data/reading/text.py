"""Reader of tables in text files, whatever their delimiter and header."""

import codecs
import csv
import re
from array import array
from pathlib import Path

import numpy as np

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.reading.reading_options import ReadingOptions
from fmp_drake.primitives.data.reading.table import (
    MOST_BYTES,
    Table,
    check_size,
    named_unit,
)

_COMMENT = re.compile(r"^\s*(?:#|%|//)+\s*")
_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-"}
_DELIMITERS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "spaces"}
_DATE = re.compile(
    r"(?:(\d{4}-\d\d-\d\d)[T ])?(\d\d:\d\d:\d\d(?:\.\d+)?)(?:Z|[+-]\d\d:?\d\d)?"
)
# Greatest number of lines before the numbers.
_LONGEST_PREAMBLE = 200
_UNIT = re.compile(r"[\[(]?(|[numkcd]?s|[munc]?m|m?rad|deg|°|N|N/?m|-|m/s|rad/s)[\])]?")


def read_text(path: Path, _options: ReadingOptions) -> list[Table]:
    """Return the columns of a table in a text file.

    Comments and other lines before the numbers are skipped. The last of them is the
    header where it has as many cells. Columns of words are left out.

    Raises
    ------
    SkillFileError
        Where the file is not such a table; the line is named.
    """
    text = _decoded(path)
    # A file that was not written to its end stops within a line.
    return [table_of_lines(path, text.splitlines(), is_cut=text[-1:] not in "\r\n")]


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file, whatever its encoding."""
    return _decoded(path).splitlines()


def table_of_lines(path: Path, lines: list[str], *, is_cut: bool = False) -> Table:
    """Return the table in the lines of a file; the last may be cut. See `read_text`."""
    if not any(map(str.strip, lines)):
        raise SkillFileError(f"{path} is empty.")
    start, delimiter = _first_row(path, lines)
    first = split_cells(lines[start], delimiter)
    width = len(first)
    header, units = _header(path, lines[:start], delimiter, first)
    words = [i for i, cell in enumerate(first) if number_in(cell) is None]
    numbers, remarks = array("d"), []
    has_commas = False
    for number, line in enumerate(lines[start:], start + 1):
        if not line.strip() or _COMMENT.match(line):
            continue
        cells = split_cells(line, delimiter)
        if len(cells) < width and is_cut and number == len(lines):
            remarks.append(f"line {number}, the last, is cut: left out")
            continue
        if len(cells) != width:
            raise SkillFileError(
                f"{path}: line {number} has {len(cells)} cells; line {start + 1} has "
                f"{width}. Correct or delete that line."
            )
        for i, cell in enumerate(cells):
            value = np.nan if i in words else number_in(cell)
            if value is None:
                raise SkillFileError(
                    f"{path}: line {number}: {cell!r} in the column "
                    f"{header[i] or i + 1} is not a number. Correct or delete that line."
                )
            numbers.append(value)
        has_commas = has_commas or (delimiter != "," and "," in line)
    values = np.array(numbers).reshape(-1, width)
    empty = [
        i for i in range(width) if not header[i] and np.all(np.isnan(values[:, i]))
    ]
    columns = [i for i in range(width) if i not in {*words, *empty}]
    if delimiter != "," or has_commas:
        remarks.append(
            f"{'decimal commas, ' if has_commas else ''}{_DELIMITERS[delimiter]} between "
            "the columns"
        )
    if words:
        named = ", ".join(header[i] or f"column {i + 1}" for i in words)
        remarks.append(f"{named} left out: words")
    return Table(
        names=tuple(header[i] for i in columns),
        units=tuple(units[i] for i in columns),
        values=values[:, columns],
        remarks=tuple(remarks),
    )


def _decoded(path: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 or the encoding of old spreadsheets."""
    check_size(path, path.stat().st_size, MOST_BYTES / 2)
    raw = path.read_bytes()
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ["utf-16"]
    else:
        encodings = ["utf-8-sig", "cp1252"]
    for encoding in encodings:
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
    for i, after in zip(content, [*content[1:], None], strict=True):
        if i > content[0] + _LONGEST_PREAMBLE:
            break
        if _COMMENT.match(lines[i]):
            continue
        most, best = 0.5, ""
        for delimiter in _DELIMITERS:
            if delimiter.strip() and delimiter not in lines[i]:
                continue
            cells = [cell for cell in split_cells(lines[i], delimiter) if cell]
            count = sum(number_in(cell) is not None for cell in cells)
            fraction = count / max(1, len(cells))
            if fraction > most:
                most, best = fraction, delimiter
        # A single number before rows of another length belongs to the preamble.
        alone = after is not None and len(
            split_cells(lines[after], best or " ")
        ) != len(split_cells(lines[i], best or " "))
        if best and not (alone and len(split_cells(lines[i], best)) == 1):
            return i, best
    raise SkillFileError(
        f"{path} has no line of numbers among its first {_LONGEST_PREAMBLE}; expected a "
        "table with a header such as `time,x,y,z`."
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
    for text in (cell, cell.replace(",", ".")):
        try:
            return float(text)
        except ValueError:
            pass
    match = _DATE.fullmatch(cell)
    if match is None:
        return None
    try:
        date = np.datetime64(f"{match[1] or '1970-01-01'}T{match[2]}", "ns")
    except ValueError:
        return None
    return date.astype(np.int64) / 1e9


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
    if len(names) == width - 1 and not first[-1]:  # Rows end with a delimiter ...
        names = [*names, ""]
    elif len(names) == width - 1 and first[0].isdigit():  # ... or are numbered.
        names = ["", *names]
    if len(names) != width:
        if _COMMENT.match(lines[-1]) or len(names) == 1:
            return [""] * width, [""] * width
        raise SkillFileError(
            f"{path}: line {len(before) + 1} has {width} cells; the header has "
            f"{len(names)}."
        )
    split = [named_unit(name) for name in names]
    return (
        [name for name, _ in split],
        [unit or under for (_, unit), under in zip(split, below, strict=True)],
    )
