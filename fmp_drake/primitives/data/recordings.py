"""Demonstrations from files of all kinds."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fmp_drake.errors import DemonstrationError, SkillFileError
from fmp_drake.primitives.data.demonstration import (
    FORMAT,
    NAMES,
    Demonstration,
)
from fmp_drake.primitives.data.files import read_npz
from fmp_drake.primitives.data.reading.arrays import read_npy, read_parquet, table_of
from fmp_drake.primitives.data.reading.bags import read_bag
from fmp_drake.primitives.data.reading.columns import QUATERNION, demonstration_of
from fmp_drake.primitives.data.reading.kinds import kind_of
from fmp_drake.primitives.data.reading.lerobot import read_lerobot
from fmp_drake.primitives.data.reading.reading_options import ReadingOptions
from fmp_drake.primitives.data.reading.table import MOST_BYTES, Table
from fmp_drake.primitives.data.reading.text import read_text
from fmp_drake.primitives.editing.orientation import add_orientation, mean_rotation


def read_demonstrations(
    paths: Sequence[str | Path], options: ReadingOptions | None = None
) -> tuple[list[Demonstration], list[str]]:
    """Read demonstrations from files as people have them.

    Tables in text files (`.csv` and others, whatever delimits their columns), `.npz`,
    `.npy`, `.parquet`, ROS 1 and ROS 2 bags, MCAP, and folders with a LeRobot dataset,
    which give one demonstration for each episode.
    Quaternions become the orientation channels `rx`, `ry` and `rz`; all demonstrations
    have one reference. Lengths become metres, degrees radians.

    Parameters
    ----------
    paths : sequence of str or Path
    options : ReadingOptions, optional
        What the files do not say.

    Returns
    -------
    demonstrations : list of Demonstration
    remarks : list of str
        What was recognised in which file, and what was left out.

    Raises
    ------
    SkillFileError
        Where a file is missing, broken or of another kind, which is named.
    DemonstrationError
        Where its numbers cannot be used.
    """
    options = options or ReadingOptions()
    found: list[Demonstration] = []
    sources: list[Path] = []
    remarks = []
    turning = []
    for path in map(Path, paths):
        with _naming(path), np.errstate(all="ignore"):  # What is infinite is refused.
            read = _read(path, options)
            if isinstance(read, Demonstration):
                found.append(read)
            else:
                each = [demonstration_of(table, options) for table in read]
                turning += [
                    i
                    for i, d in enumerate(each, len(found))
                    if set(QUATERNION) <= set(d.channels)
                ]
                remarks += [f"{path.name}: {d.note}" for d in each if d.note]
                found += each
        sources += [path] * (len(found) - len(sources))
    if turning:
        quaternions = [found[i].select(QUATERNION).values for i in turning]
        reference = mean_rotation(np.concatenate(quaternions), order="xyzw")
        for i, rotations in zip(turning, quaternions, strict=True):
            with _naming(sources[i]):
                turned = add_orientation(
                    found[i], rotations, order="xyzw", reference=reference
                )
                kept = [name for name in turned.channels if name not in QUATERNION]
                found[i] = turned.select(kept)
    return found, remarks


def _read(path: Path, options: ReadingOptions) -> list[Table] | Demonstration:
    """Return what one file holds: tables, or a demonstration as it was saved."""
    kind = kind_of(path)
    if kind == "lerobot":
        return read_lerobot(path, options.topic)
    if kind == "bag":
        return [read_bag(path, options.topic)]
    if kind == "npz":
        saved = _read_npz(path, options)
        return saved if isinstance(saved, Demonstration) else [saved]
    read = {"npy": read_npy, "parquet": read_parquet, "text": read_text}[kind]
    return [read(path)]


def _read_npz(path: Path, options: ReadingOptions) -> Demonstration | Table:
    arrays = read_npz(path, f"a demonstration is {FORMAT.source}", most=MOST_BYTES)
    name = "values" if "values" in arrays else "position"
    if "metadata" not in arrays and not {"time", name} <= set(arrays):
        if len(arrays) == 1:
            arrays = {"": next(iter(arrays.values()))}
        return table_of(path, arrays)
    time, values = (arrays.get(key) for key in ("time", name))
    if time is None or values is None:
        raise SkillFileError(f"{path} holds no `time` or no `values`.")
    for key, array in (("time", time), ("values", values)):
        if not np.can_cast(array.dtype, float, "same_kind"):
            raise SkillFileError(f"{path}: `{key}` does not hold numbers.")
    if "metadata" in arrays:
        metadata = FORMAT.parse(path, arrays["metadata"])
        kept = {key: metadata[key] for key in NAMES if key in metadata}
        return Demonstration(time=time, values=values, **kept)
    if options.columns:
        return table_of(path, arrays)
    if time.shape != values.shape[:1] or values.ndim > 2:
        return Demonstration(time=time, values=values)  # Which says what is wrong.
    values = values.reshape(len(time), -1)
    left = sorted(set(arrays) - {"time", name})
    counts = len(time) > 1 and np.all(np.diff(time) == 1)
    return Table(
        names=("time", *("" for _ in range(values.shape[1]))),
        units=("s" if counts else "", *("" for _ in range(values.shape[1]))),
        values=np.column_stack([time, values]),
        remarks=(f"{', '.join(left)} left out",) if left else (),
    )


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Let errors name the file."""
    try:
        yield
    except (DemonstrationError, SkillFileError) as error:
        if str(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from None
