"""Readers of arrays: NumPy, Parquet, MATLAB, Excel."""

import csv
import io
import math
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.channels import EULER_CHANNELS, listed
from fmp_drake.primitives.data.files import FileFormat, read_npz
from fmp_drake.primitives.data.reading.columns import ANGLE, NO_MEASURED_ANGLES
from fmp_drake.primitives.data.reading.groups import are_orthonormal
from fmp_drake.primitives.data.reading.table import (
    MOST_BYTES,
    SOURCE_NAME,
    TIME_NAME,
    ReadingOptions,
    Table,
    check_size,
    column_key,
    readable,
    rows_of_sources,
    topic_choice,
)
from fmp_drake.primitives.data.reading.text import (
    number_in,
    table_of_lines,
)

FORMAT = FileFormat(
    name="fmp-drake-demonstration",
    version=1,
    what="demonstration",
    source="an .npz with `time` and `values` or `position`, or a table such as .csv",
)
METADATA = ("channels", "units", "frame", "note", "rotation_reference")
"""Fields of a demonstration in the metadata of a saved file."""
# Names of rates, Hz, and of intervals, s.
_RATES = ("fps", "rate", "sample_rate", "frequency", "control_freq", "fs", "Fs")
_INTERVALS = ("Ts", "dt")
# Last words of the names of joint angles, and of the names of the joints.
_JOINT_ANGLES = re.compile(r"(joint_?)?(positions?|angles?|states?)|q|qpos|joints?")
_JOINT_NAMES = re.compile(r"(joint_?)?names?")
# Names of arrays of the coordinates of several points, and the most points.
_POINTS = re.compile(r"landmark|key_?point|marker|skeleton|hand(?!le)", re.IGNORECASE)
_MOST_POINTS = 100
# Fewest samples of one of several recordings in a file.
_FEWEST = 20


def read_npz_file(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the arrays of an `.npz` file.

    Where there are `time` and `position` (or `values`), other arrays are read only if
    the options ask for them. A demonstration that the package saved is returned
    unchanged.

    Raises
    ------
    SkillFileError
        Where the file cannot be read, or a saved demonstration is incomplete.
    """
    arrays = read_npz(path, f"a demonstration is {FORMAT.source}", most=MOST_BYTES)
    name = "values" if "values" in arrays else "position"
    if "metadata" not in arrays and not {"time", name} <= set(arrays):
        return _tables_of(path, arrays, options)
    metadata = FORMAT.parse(path, arrays["metadata"]) if "metadata" in arrays else None
    time, values = (arrays.get(key) for key in ("time", name))
    origin = 0.0
    if time is not None and time.dtype.kind in "mM":
        second, zero = np.timedelta64(1, "s"), np.zeros(1, time.dtype)
        origin = float(np.sum((time[:1] - zero) / second))
        time = (time - time[:1]) / second
    if time is None or values is None:
        raise SkillFileError(f"{path} holds no `time` or no `values`.")
    for key, array in (("time", time), ("values", values)):
        if not np.can_cast(array.dtype, float, "same_kind"):
            raise SkillFileError(f"{path}: `{key}` does not hold numbers.")
    fields: dict[str, Any] = {"time": time, "values": values}
    if metadata is not None:
        fields |= {key: metadata[key] for key in METADATA if key in metadata}
        return [Table(saved=fields)]
    if options.columns or (options.all_arrays and len(arrays) > 2):
        return [table_of(path, arrays, topic=options.topic)]
    if time.shape != values.shape[:1] or values.ndim > 2 or len(time) < 2:
        return [Table(saved=fields)]  # The demonstration names the error.
    table = table_of(path, {"time": time, "": values}, count=len(time))
    units = ("s",) if np.all(np.diff(time) == 1) else ()
    omissions = sorted(set(arrays) - {"time", name})
    remarks = (f"{listed(omissions)} left out",) if omissions else ()
    return [replace(table, units=units, remarks=remarks, origin=origin)]


def read_npy(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the columns of one array (N,), (N, D) or with named fields."""
    try:
        # Mapped: a truncated file is refused before memory is allocated.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as reason:  # noqa: BLE001 - broken bytes raise anything.
        is_pickled = "allow_pickle" in str(reason) or "Python objects" in str(reason)
        message = (
            "it holds Python objects, which may run code; save an array of numbers"
            if is_pickled
            else str(reason)
        )
        raise SkillFileError(
            f"{path} is not a readable .npy file ({message})."
        ) from None
    check_size(path, array.nbytes)
    names = array.dtype.names
    arrays = {name: array[name] for name in names} if names else {"": array}
    return _tables_of(path, arrays, options)


def _sample_count(arrays: Mapping[str, NDArray[Any]]) -> int:
    """Return the number N of samples of arrays (N,), (N, k), (k, N) and others.

    It is that of the times, where another array has as many. Otherwise it is the greatest
    length of an axis, unless that is only the width of arrays whose rows are as many as
    those of others.
    """
    lengths = [n for name, a in arrays.items() if not _is_time(name) for n in a.shape]
    times = [a.size for name, a in arrays.items() if _is_time(name) and a.size > 1]
    if common := set(times).intersection(lengths):
        return max(common)
    count = max([*lengths, *times], default=0)
    firsts = [a.shape[0] for a in arrays.values() if a.ndim]
    wide = [a.shape[0] for a in arrays.values() if a.ndim == 2 and count in a.shape]
    rows = max(wide, default=0)
    is_width = count not in firsts and firsts.count(rows) > wide.count(rows)
    return rows if is_width and rows >= _FEWEST else count


def _is_time(name: str) -> bool:
    return TIME_NAME.fullmatch(name) is not None


def _aligned(arrays: Mapping[str, NDArray[Any]], count: int) -> dict[str, NDArray[Any]]:
    """Return arrays with the `count` samples along the first axis: (N,), (N, k).

    Arrays (1, N) and (N, 1) become (N,), matrices (N, 4, 4) and (N, 1, 4, 4) become
    (N, 16), matrices (N, 3, 4) become (N, 12), and rotations (N, 3, 3) become (N, 9).
    """
    aligned = {}
    for name, array in arrays.items():
        if array.shape[1:] == (1, 4, 4):
            array = array[:, 0]
        # Covariances, too, are (N, 3, 3).
        has_rotations = array.shape[1:] == (3, 3) and array.dtype.kind in "iuf"
        has_rotations = has_rotations and are_orthonormal(array)
        if array.shape[1:] in ((3, 4), (4, 4)) or has_rotations:
            array = array.reshape(len(array), -1)
        if array.ndim == 2 and 1 in array.shape:
            array = array.ravel()
        is_transposed = array.ndim == 2 and array.shape[1] == count != array.shape[0]
        aligned[name] = array.T if is_transposed else array
    return aligned


def _of_points(
    arrays: Mapping[str, NDArray[Any]], count: int
) -> dict[str, NDArray[Any]]:
    """Split coordinates of points, (`count`, k, 2) or (`count`, k, 3), into an array a point."""
    out: dict[str, NDArray[Any]] = {}
    for name, array in arrays.items():
        width = array.shape[1] if array.ndim == 3 else 0
        is_points = array.shape[2:] in ((2,), (3,)) and width <= _MOST_POINTS
        is_points = is_points and width != array.shape[2]  # No rotations.
        if is_points and len(array) == count and _POINTS.search(name):
            out |= {f"{name}_{k}": array[:, k] for k in range(width)}
        else:
            out[name] = array
    return out


def _tables_of(
    path: Path, content: Mapping[str, Any], options: ReadingOptions
) -> list[Table]:
    """Return a table of each recording in nested mappings of arrays."""
    tables = []
    for recording in recordings_in(content):
        arrays = {name: np.asarray(value) for name, value in flat_values(recording)}
        if len(arrays) == 1:  # The columns of a single matrix have no names.
            arrays = {"": next(iter(arrays.values()))}
        tables.append(table_of(path, arrays, topic=options.topic))
    return tables


def recordings_in(content: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the content of each recording in a list of them, or the content itself.

    A list may be an array (K, N, D), and its items mappings of arrays. Single numbers and
    times beside it belong to all recordings.
    """
    while len(content) == 1 and isinstance(
        inner := next(iter(content.values())), Mapping
    ):
        content = inner
    lists, others = dict[str, Any](), dict[str, Any]()
    for name, value in content.items():
        is_listed = isinstance(value, list) or (
            isinstance(value, np.ndarray) and (value.dtype == object or value.ndim == 3)
        )
        is_several = is_listed and len(value) > 1 and all(map(_is_recording, value))
        is_several = is_several and not _are_samples(value, content)
        (lists if is_several else others)[name] = value
    count = min(map(len, lists.values()), default=0)
    if any(len(value) != count for value in lists.values()):
        return [content]
    shared = {
        name: value
        for name, value in others.items()
        if (not isinstance(value, list | Mapping) and np.size(value) == 1)
        or (_is_time(name) and _fits_all(value, lists))
    }
    recordings: list[Mapping[str, Any]] = []
    for i in range(count):
        items = {name: value[i] for name, value in lists.items()}
        first = next(iter(items.values()))
        is_one = len(items) == 1 and isinstance(first, Mapping)
        recordings.append({**shared, **(first if is_one else items)})
    return recordings or [content]


def _are_samples(items: Any, content: Mapping[str, Any]) -> bool:
    """Return whether items are samples of fewer points, with increasing times of their own."""
    if isinstance(items, np.ndarray):
        sizes = [np.size(value) for name, value in content.items() if _is_time(name)]
        is_timed = len(items) in sizes and items.shape[1] not in sizes
        return items.ndim == 3 and is_timed and len(items) > items.shape[1]
    if len(items) < _FEWEST or not all(isinstance(item, Mapping) for item in items):
        return False
    times = [[v for name, v in item.items() if _is_time(name)][:1] for item in items]
    are_numbers = all(t and isinstance(t[0], int | float) for t in times)
    counts = {tuple(len(v) for v in i.values() if isinstance(v, list)) for i in items}
    is_one = len(counts) == 1 and max(*counts, default=0) < len(items)
    return are_numbers and is_one and all(a < b for a, b in pairwise(times))


def _fits_all(times: Any, lists: Mapping[str, Any]) -> bool:
    """Return whether all recordings have as many samples as there are times."""
    items = (item for value in lists.values() for item in value)
    return all(np.size(times) in np.shape(item) for item in items)


def _is_recording(item: Any) -> bool:
    """Return whether a value is a matrix over time, or a mapping with values over time."""
    if isinstance(item, Mapping):
        header = item.get("header")
        if isinstance(header, Mapping) and "stamp" in header:
            return False  # A message of ROS, with a covariance.
        lists = (v for v in item.values() if isinstance(v, list | np.ndarray | Mapping))
        return any(
            _is_recording(v) or (not isinstance(v, Mapping) and len(v) >= _FEWEST)
            for v in lists
        )
    shape = np.shape(item) if isinstance(item, np.ndarray) else ()
    if isinstance(item, list) and item and isinstance(item[0], list):
        shape = (len(item), len(item[0]))
    return len(shape) == 2 and max(shape) >= _FEWEST


def table_of(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    *,
    rate: float | None = None,
    topic: str = "",
    count: int | None = None,
) -> Table:
    """Return a table of arrays (N,) and (N, k) of equal length.

    The columns of an array (N, 3) are named `name_x` and so on, those of others `name_1`.
    The columns of landmarks (N, k, 3) are named `name_0_x` and so on. Matrices (N, 4, 4) have
    16 columns, (N, 3, 4) 12, and rotations (N, 3, 3) 9. Names of joints, (N, k) or (k,), name
    their columns. Other arrays are left out. A rate (Hz), given or found among the arrays,
    adds a column of times. Where the rows of several sources alternate, those of the topic
    are read. Without `count`, N is found.
    """
    count = _sample_count(arrays) if count is None else count
    if arrays and not count:
        raise SkillFileError(f"{path} holds no samples.")
    arrays = _aligned(_of_points(arrays, count), count)
    names, parts, omissions, remarks = [], [], [], []
    words: dict[str, str] = {}
    place, angles, joints = _joint_names(arrays, count)
    sources = {
        i: (name, labels)
        for i, (name, array) in enumerate(arrays.items())
        if array.shape == (count,) and (labels := _sources(name, array))
    }
    chosen, topics = rows_of_sources(path, sources, count, topic)
    remarks += [
        f"only rows with {label} as {sources[i][0]}" for i, label in topics.items()
    ]
    if rate is None and not any(map(_is_time, arrays)):
        rate = rate_in({n.rsplit(".", 1)[-1]: array for n, array in arrays.items()})
        remarks += [f"at {rate:g} Hz, as the file says"] if rate else []
    for i, (name, array) in enumerate(arrays.items()):
        if array.ndim == 0 or name == place or i in topics:  # A setting, or names.
            continue
        is_table = array.ndim == 2 and len(array) == count and array.dtype.kind in "OU"
        if is_table and _is_of(name, _JOINT_NAMES) and np.all(array == array[0]):
            words |= {f"{name}_{k}": str(word) for k, word in enumerate(array[0], 1)}
            continue
        is_numbers = array.dtype.kind in "biufmM"
        if array.ndim not in (1, 2) or len(array) != count or not is_numbers:
            omissions.append(f"{name or 'the array'} {array.shape} of {array.dtype}")
            continue
        if array.dtype.kind == "M":
            array = array.astype("datetime64[ns]").astype(np.int64)
        elif array.dtype.kind == "m":
            array = array / np.timedelta64(1, "s")
        columns = np.asarray(array, dtype=float).reshape(count, -1)
        width = columns.shape[1]
        parts.append(columns)
        if name == angles and not name.endswith("position"):
            names += joints
            continue
        if name == angles:  # Numbered as the velocities beside it.
            stem = name.removesuffix("position")
            words |= {f"{stem}name_{k}": word for k, word in enumerate(joints, 1)}
        is_named = f"{name[: name.rfind('.') + 1]}name_1" in words  # Joints.
        is_place = width == 3 and not is_named
        axes: Sequence[Any] = "xyz" if is_place else range(1, width + 1)
        if is_place and column_key(name).endswith("rpy"):
            axes = EULER_CHANNELS
        names += [
            f"{name}_{axis}" if name and array.ndim == 2 else name for axis in axes
        ]
    if not parts:
        raise SkillFileError(
            f"{path} holds {listed(omissions) or 'nothing'}; expected arrays of numbers, "
            "(N,) or (N, D)."
        )
    if rate is not None:
        names.insert(0, "time")
        parts.insert(0, np.arange(count)[:, None] / rate)
    if omissions:
        remarks.append(f"{listed(omissions)} left out")
    return Table(
        names=tuple(names),
        values=np.column_stack(parts)[chosen],
        units=() if rate is None else ("s",),
        remarks=tuple(remarks),
        words=words,
    )


def _joint_names(
    arrays: Mapping[str, NDArray[Any]], count: int
) -> tuple[str | None, str | None, list[str]]:
    """Return the names of joints, after those of their array and of the joints' angles.

    There are none where it is unclear which of the arrays (`count`, k) is meant, or where
    not all the words are different names of joints.
    """
    for name, array in arrays.items():
        is_list = array.ndim == 1 and array.dtype.kind in "OU" and len(array) != count
        if not (is_list and _is_of(name, _JOINT_NAMES)):
            continue
        joints = [str(word) for word in array]
        angles = [
            other
            for other, values in arrays.items()
            if values.shape == (count, len(joints))
            and _is_of(other, _JOINT_ANGLES)
            and not NO_MEASURED_ANGLES.search(column_key(other))
        ]
        are_joints = all(ANGLE.fullmatch(column_key(joint)) for joint in joints)
        if are_joints and len({*joints}) == len(joints) and len(angles) == 1:
            return name, angles[0], joints
    return None, None, []


def _is_of(name: str, form: re.Pattern[str]) -> bool:
    """Return whether the last word of a name has a form."""
    return form.fullmatch(name.rsplit(".", 1)[-1]) is not None


def _sources(name: str, array: NDArray[Any]) -> list[str]:
    """Return the words of an array (N,) that may name what each row is of, or nothing."""
    if array.dtype.kind in "OU":
        words = list(array)
        return words if all(isinstance(word, str) for word in words) else []
    is_named = _is_of(name, SOURCE_NAME)
    is_number = array.dtype.kind in "iuf" and bool(np.all(array % 1 == 0))
    return [f"{number:g}" for number in array] if is_named and is_number else []


def rate_in(settings: Mapping[str, Any]) -> float | None:
    """Return the sample rate among the settings of a file, Hz, if any."""
    for name in (*_RATES, *_INTERVALS):
        number = np.asarray(settings.get(name))
        if number.dtype.kind in "iuf" and number.size == 1 and number.item() > 0:
            return 1 / number.item() if name in _INTERVALS else float(number.item())
    return None


def read_parquet(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the columns of a Parquet file; columns of lists are split.

    Raises
    ------
    SkillFileError
        Where it cannot be read, or pyarrow is not installed.
    """
    return [parquet_table(path, None, topic=options.topic)]


def parquet_table(path: Path, columns: list[str] | None, *, topic: str = "") -> Table:
    """Return some columns of a Parquet file, or all; see `table_of` for the topic."""
    with readable(path, "a Parquet file", extra="parquet"):
        from pyarrow import parquet

        file = parquet.ParquetFile(path)
        metadata = file.metadata
        groups = [
            metadata.row_group(i).total_byte_size
            for i in range(metadata.num_row_groups)
        ]
        check_size(path, max(sum(groups), 8 * metadata.num_rows))
        content = file.read(columns)
        arrays = {name: _array(content[name]) for name in content.column_names}
    return table_of(path, arrays, topic=topic, count=metadata.num_rows)


def _array(column: Any) -> NDArray[Any]:
    """Return a column of Arrow as an array (N,), or (N, k) where it holds lists."""
    array: NDArray[Any] = column.to_numpy()
    if array.dtype == object and len(array) and isinstance(array[0], np.ndarray):
        return np.stack(list(array))
    return array


def read_matlab(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the arrays of one length in a MATLAB file, also those in structures."""
    from scipy.io import loadmat, whosmat  # Slow to import.

    with readable(path, "a MATLAB file"):
        # Files may be compressed: the shapes are read before the numbers.
        check_size(path, sum(8 * math.prod(shape) for _, shape, _ in whosmat(path)))
        content = loadmat(path, simplify_cells=True)
    content = {k: v for k, v in content.items() if k[:2] != "__"}
    return _tables_of(path, content, options)


def read_excel(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the columns of the first sheet with a table in a workbook.

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


def flat_values(
    content: Mapping[str, Any], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield the values in nested mappings with their names joined by dots."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from flat_values(value, f"{prefix}{name}.")
        elif isinstance(value, str):  # A date is a time.
            number = number_in(value)
            yield f"{prefix}{name}", value if number is None else number
        else:
            yield f"{prefix}{name}", value
