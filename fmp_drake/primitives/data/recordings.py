"""Demonstrations from files of all kinds."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError, FmpError, SkillFileError
from fmp_drake.primitives.data.demonstration import (
    FORMAT,
    NAMES,
    ROTATION_CHANNELS,
    Demonstration,
)
from fmp_drake.primitives.data.files import read_npz
from fmp_drake.primitives.data.reading.arrays import read_npy, read_parquet, table_of
from fmp_drake.primitives.data.reading.bags import read_bag
from fmp_drake.primitives.data.reading.columns import recording_of
from fmp_drake.primitives.data.reading.kinds import kind_of
from fmp_drake.primitives.data.reading.lerobot import read_lerobot
from fmp_drake.primitives.data.reading.reading_options import ReadingOptions
from fmp_drake.primitives.data.reading.recording import Recording
from fmp_drake.primitives.data.reading.table import MOST_BYTES, Table
from fmp_drake.primitives.data.reading.text import read_text
from fmp_drake.primitives.editing.orientation import (
    as_rotation,
    mean_rotation,
    rotation_vectors,
)


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
    demonstrations: list[Demonstration | Recording] = []
    sources: list[Path] = []
    remarks = []
    for path in map(Path, paths):
        try:
            with np.errstate(all="ignore"):  # A demonstration refuses what is infinite.
                found = _read(path, options)
        except (DemonstrationError, SkillFileError) as error:
            raise _naming(path, error) from None
        demonstrations += found
        sources += [path] * len(found)
        remarks += [
            f"{path.name}: {'; '.join(r.remarks)}"
            for r in found
            if isinstance(r, Recording) and r.remarks
        ]
    rotations = [
        d.quaternions
        for d in demonstrations
        if isinstance(d, Recording) and d.quaternions is not None
    ]
    out = []
    for path, each in zip(sources, demonstrations, strict=True):
        try:
            out.append(
                each
                if isinstance(each, Demonstration)
                else _demonstration(each, rotations)
            )
        except DemonstrationError as error:
            raise _naming(path, error) from None
    return out, remarks


def _read(path: Path, options: ReadingOptions) -> list[Demonstration | Recording]:
    """Return what one file holds."""
    kind = kind_of(path)
    if kind == "lerobot":
        tables = read_lerobot(path, options.topic)
    elif kind == "bag":
        tables = [read_bag(path, options.topic)]
    elif kind == "npz":
        found = _read_npz(path, options)
        if isinstance(found, Demonstration):
            return [found]
        tables = [found]
    else:
        read = {"npy": read_npy, "parquet": read_parquet, "text": read_text}[kind]
        tables = [read(path)]
    return [recording_of(table, options) for table in tables]


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


def _demonstration(
    recording: Recording, rotations: Sequence[NDArray[np.float64]]
) -> Demonstration:
    """Return a recording as a demonstration; all orientations have one reference."""
    values, channels, units = recording.values, recording.channels, recording.units
    reference = None
    if recording.quaternions is not None:
        reference = mean_rotation(np.concatenate(rotations), order="xyzw")
        rotation = as_rotation(recording.quaternions, order="xyzw")
        vectors = rotation_vectors(rotation, reference)
        values = np.concatenate([values, vectors], axis=1)
        channels = (*channels, *ROTATION_CHANNELS)
        units = (*units, "rad", "rad", "rad")
    return Demonstration(
        time=recording.time,
        values=values,
        channels=channels,
        units=units,
        frame=recording.frame,
        note="; ".join(recording.remarks),
        rotation_reference=reference,
    )


def _naming(path: Path, error: FmpError) -> FmpError:
    """Return an error that names the file."""
    return error if str(path) in str(error) else type(error)(f"{path}: {error}")
