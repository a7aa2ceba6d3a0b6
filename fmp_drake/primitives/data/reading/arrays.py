"""Recordings in NumPy's files, and in Parquet."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.reading.table import Table, check_size


def read_npy(path: Path) -> Table:
    """Return the columns of one array (N,), (N, D) or with named fields."""
    try:
        # Mapped, so that nothing is read that is not there.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as reason:  # noqa: BLE001 - of a dozen types.
        is_pickled = "allow_pickle" in str(reason) or "Python objects" in str(reason)
        told = (
            "it holds Python objects, which may run code; save an array of numbers"
            if is_pickled
            else str(reason)
        )
        raise SkillFileError(f"{path} is not a readable .npy file ({told}).") from None
    check_size(path, array.nbytes)
    if array.dtype.names:
        return table_of(path, {name: array[name] for name in array.dtype.names})
    return table_of(path, {"": array})


def table_of(path: Path, arrays: Mapping[str, NDArray[Any]]) -> Table:
    """Return a table of arrays (N,) and (N, k) that have one length.

    The columns of an array (N, 3) are called `name_x` and so on, those of others
    `name_1`; shorter arrays are left out.
    """
    count = max((len(a) for a in arrays.values() if a.ndim in (1, 2)), default=0)
    names, parts, left = [], [], []
    for name, array in arrays.items():
        is_numbers = array.dtype.kind in "biufM"
        if array.ndim not in (1, 2) or len(array) != count or not is_numbers:
            left.append(f"{name or 'the array'} {array.shape} of {array.dtype}")
            continue
        if array.dtype.kind == "M":
            array = array.astype("datetime64[ns]").astype(np.int64)
        columns = np.asarray(array, dtype=float).reshape(count, -1)
        axes = "xyz" if columns.shape[1] == 3 else range(1, columns.shape[1] + 1)
        names += [
            f"{name}_{axis}" if name and array.ndim == 2 else name for axis in axes
        ]
        parts.append(columns)
    if not parts or count == 0:
        raise SkillFileError(
            f"{path} holds {', '.join(left) or 'nothing'}; expected arrays of numbers, "
            "(N,) or (N, D)."
        )
    remarks = (f"{', '.join(left)} left out",) if left else ()
    return Table(names=tuple(names), values=np.column_stack(parts), remarks=remarks)


def read_parquet(path: Path, columns: list[str] | None = None) -> Table:
    """Return the columns of a Parquet file; those with lists in them one by one.

    Raises
    ------
    SkillFileError
        Where it cannot be read, or pyarrow is not installed.
    """
    try:
        from pyarrow import parquet
    except ImportError:
        raise SkillFileError(
            f"{path} is a Parquet file; install what reads it: pip install "
            "'fmp-drake[lerobot]'."
        ) from None
    try:
        file = parquet.ParquetFile(path)
        about = file.metadata
        groups = [
            about.row_group(i).total_byte_size for i in range(about.num_row_groups)
        ]
        check_size(path, max(sum(groups), 8 * about.num_rows))
        content = file.read(columns)
        arrays = {name: _array(content[name]) for name in content.column_names}
    except SkillFileError:
        raise
    except Exception as reason:  # noqa: BLE001 - of pyarrow's own types.
        raise SkillFileError(
            f"{path} is not a readable Parquet file ({reason})."
        ) from None
    return table_of(path, arrays)


def _array(column: Any) -> NDArray[Any]:
    """Return a column of Arrow as an array (N,), or (N, k) where it holds lists."""
    array: NDArray[Any] = column.to_numpy()
    if array.dtype == object and len(array) and isinstance(array[0], np.ndarray):
        return np.stack(list(array))
    return array
