"""Readers of structured files: JSON, JSON lines, MATLAB, Excel."""

import csv
import io
import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.reading.arrays import align_arrays, table_of
from fmp_drake.primitives.data.reading.table import (
    MOST_BYTES,
    Table,
    check_size,
    readable,
)
from fmp_drake.primitives.data.reading.text import (
    number_in,
    read_lines,
    table_of_lines,
)


def read_json(path: Path) -> Table:
    """Return the numbers of JSON lines, a list of objects, or an object of lists.

    Names of nested values are joined by dots: `pose.position.x`.

    Raises
    ------
    SkillFileError
        Where the file is not JSON of this form; a broken line is named.
    """
    try:
        return table_of(path, _json_columns(path, read_lines(path)))
    except (ValueError, RecursionError) as reason:
        if isinstance(reason, SkillFileError):
            raise
        raise SkillFileError(
            f"{path} is not readable JSON ({reason}); write an object of numbers in each "
            'line, such as {"time": 0.1, "x": 0.2, "y": 0.3, "z": 0}.'
        ) from None


def _json_columns(path: Path, lines: list[str]) -> dict[str, NDArray[Any]]:
    """Return the arrays in the lines of a JSON file."""
    try:
        content = json.loads("\n".join(lines))
    except ValueError:
        content = []
        for number, line in enumerate(lines, 1):
            try:
                content += [json.loads(line)] if line.strip() else []
            except ValueError as reason:
                raise SkillFileError(
                    f"{path}: line {number} is not JSON ({reason}); expected an object "
                    'in each line, such as {"time": 0.1, "x": 0.2, "y": 0.3, "z": 0}.'
                ) from None
    if isinstance(content, list) and all(isinstance(item, dict) for item in content):
        rows = [dict(_flat(item)) for item in content]
        columns = {}
        for name in dict.fromkeys(name for row in rows for name in row):
            shapes = {np.shape(row[name]) for row in rows if name in row}
            if len(shapes) == 1:
                missing = np.full(shapes.pop(), np.nan)
                columns[name] = np.array([row.get(name, missing) for row in rows])
    elif isinstance(content, dict):
        columns = {name: np.asarray(value) for name, value in _flat(content)}
    else:
        raise SkillFileError(
            f"{path} holds neither objects nor lists of numbers; write an object in each "
            'line, such as {"time": 0.1, "x": 0.2, "y": 0.3, "z": 0}.'
        )
    return columns


def read_matlab(path: Path) -> Table:
    """Return the arrays of one length in a MATLAB file, also those in structures."""
    from scipy.io import loadmat, whosmat  # Slow to import.

    with readable(path, "a MATLAB file"):
        # Files may be compressed: the shapes are read before the numbers.
        check_size(path, sum(8 * math.prod(shape) for _, shape, _ in whosmat(path)))
        content = loadmat(path, simplify_cells=True)
    variables = {k: v for k, v in content.items() if not k.startswith("__")}
    arrays = {k: np.asarray(v) for k, v in _flat(variables)}
    return table_of(path, align_arrays(arrays))


def read_excel(path: Path) -> Table:
    """Return the columns of the first sheet of a workbook.

    Raises
    ------
    SkillFileError
        Where it cannot be read, or openpyxl is not installed.
    """
    with readable(path, "an Excel file", extra="excel", hint="; save it as .csv"):
        import openpyxl

        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        check_size(path, size, MOST_BYTES / 2)
        workbook = openpyxl.load_workbook(path, read_only=True, data_only=True)
        text = io.StringIO()
        writer = csv.writer(text)
        for row in workbook.worksheets[0].iter_rows(values_only=True):
            writer.writerow(["" if cell is None else cell for cell in row])
        workbook.close()
    return table_of_lines(path, text.getvalue().splitlines())


def _flat(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values in nested mappings with their names joined by dots."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        elif isinstance(value, str):  # A date is a time.
            number = number_in(value)
            yield f"{prefix}{name}", value if number is None else number
        else:
            yield f"{prefix}{name}", np.nan if value is None else value
