"""Readers of motion-capture tables: OptiTrack Motive, Vicon Nexus, Qualisys, TRC."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import Array
from fmp_drake.primitives.data.reading.table import (
    ReadingOptions,
    Table,
    count_text,
    unit_symbol,
)
from fmp_drake.primitives.data.reading.text import (
    number_in,
    read_lines,
    read_text,
    split_cells,
)

# Sections of a Vicon file, the best first.
_SECTIONS = ("Objects", "Segments", "Trajectories", "Model Outputs", "Joints")
_RIGID = ("Rigid Body", "Bone")
# A setting in the header of Qualisys, and the columns of a marker and of a rigid body.
_SETTING = re.compile(r"[A-Z_]{3,}\t")
_MARKER, _BODY = 3, 16
# Greatest error of the elements of a rotation from rounded angles.
_ROUNDED = 1e-2


def is_vicon(text: bytes) -> bool:
    """Return whether the first bytes of a file are those of a Vicon export."""
    title, *lines = text.decode("utf-8-sig", "replace").splitlines()[:2] or [""]
    rate = lines[0].strip(",; \t") if lines else ""
    return title.strip(",; \t") in (*_SECTIONS, "Devices") and rate.isdecimal()


def read_optitrack(path: Path, _options: ReadingOptions) -> list[Table]:
    """Return the rigid bodies of an OptiTrack export, or its markers if it has none.

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


def read_qualisys(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the markers or rigid bodies of a Qualisys export, in mm.

    Names above the columns, frames and times may be missing. Other exports, such as of angles,
    are read as text. Lost markers are zeros.
    """
    lines = read_lines(path)
    rows = [split_cells(line.rstrip("\t"), "\t") for line in lines]
    count = next((i for i, s in enumerate(lines) if not _SETTING.match(s)), len(lines))
    settings = {row[0]: row[1:] for row in rows[:count]}
    numbers = (i for i in range(count, len(rows)) if rows[i] and _is_number(rows[i][0]))
    start = next(numbers, None)
    kind = "BODY_NAMES" if "BODY_NAMES" in settings else "MARKER_NAMES"
    size = _BODY if kind == "BODY_NAMES" else _MARKER
    names, rate = settings.get(kind, []), number_in(settings.get("FREQUENCY", [""])[0])
    first = -1 if start is None else len(rows[start]) - size * len(names)
    if start is None or not (names and rate and first in (0, 1, 2)):
        return read_text(path, options)
    columns = range(first, first + size * len(names))
    values = _numbers(path, rows[start:], columns, start + 1)
    parts, labels, places = [np.arange(len(values))[:, None] / rate], ["time"], [0]
    units = ["s"]
    for i, name in enumerate(names):
        block = values[:, size * i : size * (i + 1)]
        block[np.all(block[:, :3] == 0, axis=1)] = np.nan
        parts.append(block[:, :3])
        labels += [f"{name} {axis}" for axis in "XYZ"]
        units += ["mm"] * 3
        places += [first + size * i + k for k in (1, 2, 3)]
        if size == _BODY:
            parts.append(_qualisys_turns(block))
            labels += [f"{name} q{axis}" for axis in "xyzw"]
            units += [""] * 4
            places += [0] * 4
    table = Table(
        names=tuple(labels),
        units=tuple(units),
        numbers=tuple(places),
        values=np.hstack(parts),
        remarks=(f"Qualisys, {', '.join(names)} at {rate:g} Hz",),
    )
    return [table]


def _is_number(cell: str) -> bool:
    return bool(cell) and number_in(cell) is not None


def _qualisys_turns(block: Array) -> Array:
    """Return the quaternions (N, 4) of a rigid body's columns (N, 16); NaN where it was lost.

    They hold the position, roll, pitch and yaw, R = Rx Ry Rz, a residual, and R by columns,
    or by rows where that agrees with the angles.
    """
    angles = np.nan_to_num(block[:, 3:6])
    rows = np.nan_to_num(block[:, 7:]).reshape(-1, 3, 3)
    is_known = np.linalg.det(rows) > 0.5
    rows[~is_known] = np.eye(3)
    expected = Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()
    errors = np.abs(rows - expected)[is_known]
    is_by_rows = np.max(errors, initial=0.0) < _ROUNDED
    matrices = rows if is_by_rows else np.swapaxes(rows, 1, 2)
    turns: Array = Rotation.from_matrix(matrices).as_quat()
    turns[~is_known] = np.nan
    return turns


def read_trc(path: Path, _options: ReadingOptions) -> list[Table]:
    """Return the markers of a TRC file, the format of OpenSim.

    Raises
    ------
    SkillFileError
        Where the file has no row `Frame#, Time, ...`, or no numbers.
    """
    rows = [split_cells(line, "\t") for line in read_lines(path)]
    head = next((i for i, row in enumerate(rows) if row[:1] == ["Frame#"]), None)
    if head is None or head < 2:
        raise SkillFileError(
            f"{path} has no row `Frame#`, `Time` ... below its settings."
        )
    settings = dict(zip(rows[head - 2], rows[head - 1], strict=False))
    # A name stands over the first of its three columns.
    markers = [name for name in rows[head][2:] if name]
    columns = list(range(2, 2 + 3 * len(markers)))
    unit = unit_symbol(settings.get("Units", ""))
    table = Table(
        names=("time", *(f"{marker} {axis}" for marker in markers for axis in "xyz")),
        units=("s", *[unit] * len(columns)),
        numbers=(2, *(i + 1 for i in columns)),
        values=_numbers(path, rows[head + 2 :], [1, *columns], head + 3),
        remarks=(f"TRC, {count_text(len(markers), 'marker')}",),
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
