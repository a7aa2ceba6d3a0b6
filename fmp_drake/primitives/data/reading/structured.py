"""Readers of structured files: JSON, MATLAB, Excel, HDF5 (robomimic, ALOHA)."""

import csv
import io
import json
import math
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.reading.arrays import rate_in, table_of
from fmp_drake.primitives.data.reading.reading_options import ReadingOptions
from fmp_drake.primitives.data.reading.table import (
    MOST_BYTES,
    TIME_NAME,
    Table,
    check_size,
    readable,
    topic_choice,
)
from fmp_drake.primitives.data.reading.text import (
    number_in,
    read_lines,
    table_of_lines,
)

# Datasets that are read unless others are named: robomimic's pose, ALOHA's joints.
_POSE = re.compile(r"(?:.*/)?(\w*eef)_(pos|quat)")
_JOINTS = re.compile(r"(?:.*/)?observations/qpos")


def read_json(path: Path, _options: ReadingOptions) -> list[Table]:
    """Return the numbers of JSON lines, a list of objects, or an object of lists.

    Names of nested values are joined by dots: `pose.position.x`.

    Raises
    ------
    SkillFileError
        Where the file is not JSON of this form; a broken line is named.
    """
    try:
        return [table_of(path, _json_columns(path, read_lines(path)))]
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
    if isinstance(content, dict):
        lists = [value for value in content.values() if _is_objects(value)]
        content = lists[0] if len(lists) == 1 else content
    if _is_objects(content):
        rows = [dict(_flat(item)) for item in content]
        columns = {}
        for name in dict.fromkeys(name for row in rows for name in row):
            shapes = {np.shape(row[name]) for row in rows if name in row}
            if len(shapes) == 1:
                missing = np.full(shapes.pop(), np.nan)
                columns[name] = np.array([row.get(name, missing) for row in rows])
    elif isinstance(content, dict):
        columns = {name: np.asarray(value) for name, value in _flat(content)}
    elif isinstance(content, list) and all(isinstance(row, list) for row in content):
        columns = {"": np.asarray(content)}
    else:
        raise SkillFileError(
            f"{path} holds neither objects nor lists of numbers; write an object in each "
            'line, such as {"time": 0.1, "x": 0.2, "y": 0.3, "z": 0}.'
        )
    return columns


def _is_objects(content: Any) -> bool:
    """Return whether a value from JSON is a list of objects."""
    is_list = isinstance(content, list) and len(content) > 0
    return is_list and all(isinstance(item, dict) for item in content)


def read_matlab(path: Path, _options: ReadingOptions) -> list[Table]:
    """Return the arrays of one length in a MATLAB file, also those in structures."""
    from scipy.io import loadmat, whosmat  # Slow to import.

    with readable(path, "a MATLAB file"):
        # Files may be compressed: the shapes are read before the numbers.
        check_size(path, sum(8 * math.prod(shape) for _, shape, _ in whosmat(path)))
        content = loadmat(path, simplify_cells=True)
    variables = {k: v for k, v in content.items() if not k.startswith("__")}
    arrays = {k: np.asarray(v) for k, v in _flat(variables)}
    if len(arrays) == 1:  # Of one matrix the columns have no names.
        arrays = {"": next(iter(arrays.values()))}
    return [table_of(path, arrays)]


def read_excel(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the columns of the first sheet of a workbook that holds a table.

    Parameters
    ----------
    path : Path
    options : ReadingOptions
        Its topic is the name of the sheet, if given.

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
        sheets = {}
        for sheet in workbook.worksheets:
            text = io.StringIO()
            rows = sheet.iter_rows(values_only=True)
            csv.writer(text).writerows(rows)
            sheets[sheet.title] = text.getvalue().splitlines()
        workbook.close()
    if options.topic and options.topic not in sheets:
        raise SkillFileError(
            f"{path} has no sheet {options.topic}; {topic_choice(list(sheets))}"
        )
    reasons = []
    for lines in [sheets[options.topic]] if options.topic else sheets.values():
        try:
            return [table_of_lines(path, lines)]
        except SkillFileError as reason:
            reasons.append(reason)
    raise reasons[0]


def read_hdf5(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the tables of an HDF5 file: one per episode of a dataset, else one.

    Parameters
    ----------
    path : Path
    options : ReadingOptions
        Its topic is the name of a dataset in the file (or in each episode), such as
        `action`; "" for the pose of an end effector, the joints, or all arrays of one length.

    Raises
    ------
    SkillFileError
        Where the file cannot be read, the dataset is missing, or h5py is not installed.
    """
    with readable(path, "an HDF5 file", extra="hdf5"):
        import h5py

        with h5py.File(path, "r") as file:
            data = file.get("data")
            groups: Any = data if isinstance(data, h5py.Group) else {}
            episodes = {
                name: groups[name]
                for name in sorted(groups, key=_natural)
                if isinstance(groups.get(name, getlink=True), h5py.HardLink)
                and isinstance(groups[name], h5py.Group)
            }
            rate = _rate(file) or _rate(data)
            return [
                _group_table(path, group, options, rate, name)
                for name, group in (episodes or {"": file}).items()
            ]


def _group_table(
    path: Path, group: Any, options: ReadingOptions, rate: float | None, episode: str
) -> Table:
    """Return the table of one group, with a time from the rate where there is none."""
    sets, topic = dict[str, Any](), options.topic

    def visit(name: str, item: Any) -> None:  # Links into other files are not visited.
        if not hasattr(item, "dtype") or item.is_virtual or item.external:
            return  # The numbers of virtual datasets are in other files.
        if item.dtype.kind in "biuf" and item.ndim in (1, 2) and item.size > 1:
            sets[name] = item

    group.visititems(visit)
    names = [name for name in sets if topic and f"/{name}".endswith(f"/{topic}")]
    if topic and not names:
        raise SkillFileError(
            f"{path} has no dataset {topic}; {topic_choice(list(sets))}"
        )
    names = (
        names
        or [name for name in sets if _POSE.fullmatch(name)]
        or [name for name in sets if _JOINTS.fullmatch(name)]
        or list(sets)
    )
    times = [name for name in sets if TIME_NAME.fullmatch(name)]
    if times and times[0] not in names:
        names.insert(0, times[0])
    check_size(path, sum(sets[name].nbytes for name in names))
    arrays: dict[str, NDArray[Any]] = {}
    for name in names:
        arrays[name.rsplit("/", 1)[-1]] = np.asarray(sets[name])
    table = table_of(path, arrays, rate=None if times else rate)
    remark = ", ".join(names) + (f" at {rate:g} Hz" if rate and not times else "")
    remark = f"{episode}: {remark}" if episode else remark
    return replace(table, remarks=(remark, *table.remarks))


def _rate(group: Any) -> float | None:
    """Return the sample rate in the attributes of a group, Hz, if any."""
    settings = dict(getattr(group, "attrs", {}))
    try:
        settings |= json.loads(settings.get("env_args", "{}"))["env_kwargs"]
    except (KeyError, TypeError, ValueError):
        pass
    return rate_in(settings)


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts demo_2 before demo_10."""
    return [(int(part or 0), text) for text, part in re.findall(r"(\D*)(\d*)", name)]


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
