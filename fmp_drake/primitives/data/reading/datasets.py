"""Readers of datasets with episodes: LeRobot, HDF5 (robomimic, ALOHA)."""

import json
import re
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.reading.arrays import parquet_table, rate_in, table_of
from fmp_drake.primitives.data.reading.table import (
    MOST_BYTES,
    TIME_NAME,
    ReadingOptions,
    Table,
    check_size,
    readable,
    topic_choice,
)

# Fewest frames of an episode; fewer are an attempt that was broken off.
_LEAST_FRAMES = 4
# The feature of a dataset that is read unless another is named.
_STATE = "observation.state"
# Datasets that are read unless others are named: robomimic's pose, ALOHA's joints.
_POSE = re.compile(r"(?!next_)(?:.*/)?((\w*_)?ee|\w*eef|tcp)_(pos|quat)")
_JOINTS = re.compile(r"(?:.*/)?observations/qpos")
# Datasets that are read only where there are no others.
_COMMANDS = re.compile(r"actions?(/|$)")
# Names of sibling groups that contain one episode each.
_EPISODE = re.compile(r"(traj|trajectory|episode|demo|demonstration)_?\d+")


def read_lerobot(folder: Path, options: ReadingOptions) -> list[Table]:
    """Return one feature of each episode of a LeRobot dataset, version 2 or 3.

    Parameters
    ----------
    folder : Path
        With `meta/info.json` and `data`.
    options : ReadingOptions
        Its topic is the feature; "" for the observed state.

    Raises
    ------
    SkillFileError
        Where the dataset is incomplete, or the feature is not in it.
    """
    feature = options.topic or _STATE
    info_file = folder / "meta" / "info.json"
    try:
        info = json.loads(info_file.read_text(encoding="utf-8"))
        features, rate = info["features"], float(info["fps"])
        kinds = {str(name): dict(kind) for name, kind in features.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SkillFileError(
            f"{info_file} is not a LeRobot dataset's ({error!r})."
        ) from None
    if feature not in kinds:
        numeric = [n for n, kind in kinds.items() if "float" in str(kind.get("dtype"))]
        raise SkillFileError(
            f"{folder} has no feature {feature}; {topic_choice(numeric)}"
        )
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise SkillFileError(f"{folder} has no data/**/*.parquet.")
    check_size(folder, sum(f.stat().st_size for f in files), MOST_BYTES / 4)
    time_columns = ["timestamp", "episode_index"]
    tables = [parquet_table(file, [feature, *time_columns]) for file in files]
    first = tables[0].names
    if any(table.names != first for table in tables):
        raise SkillFileError(f"{folder}: its files have different columns.")
    values = np.concatenate([table.values for table in tables])
    missing = set(time_columns) - set(first)
    columns = [i for i, name in enumerate(first) if name not in time_columns]
    if missing or not columns:
        raise SkillFileError(f"{folder} has no column {min(missing, default=feature)}.")
    time, episode = (values[:, first.index(name)] for name in time_columns)
    names = ("time", *_names(kinds[feature].get("names"), len(columns)))
    remark = f"{feature} at {rate:g} Hz"
    numbers, counts = np.unique(episode, return_counts=True)
    whole = numbers[counts >= _LEAST_FRAMES]
    if 0 < len(whole) < len(numbers):
        aborted = ", ".join(f"{n:.0f}" for n in np.setdiff1d(numbers, whole))
        remark += f"; episode {aborted} left out, with too few frames"
        numbers = whole
    return [
        Table(
            names=names,
            units=("s",),
            values=np.column_stack([time, values[:, columns]])[episode == number],
            remarks=(f"episode {number:.0f}: {remark}",),
        )
        for number in numbers
    ]


def _names(names: Any, count: int) -> tuple[str, ...]:
    """Return the names of a feature's elements, from a list or a group of lists."""
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    labels = tuple(map(str, names)) if isinstance(names, list) else ()
    return labels if len(set(labels)) == len(labels) == count else ("",) * count


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
            groups: Any = data if isinstance(data, h5py.Group) else file
            episodes = {
                name: groups[name]
                for name in sorted(groups, key=_natural)
                if isinstance(groups.get(name, getlink=True), h5py.HardLink)
                and isinstance(groups[name], h5py.Group)
                and (groups is data or _EPISODE.fullmatch(name))
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
        or [name for name in sets if not _COMMANDS.match(name)]
        or list(sets)
    )
    times = [name for name in sets if TIME_NAME.fullmatch(name)]
    if times:
        names = [name for name in names if name not in times] or names
        nearest = max(times, key=lambda time: _nearness(sets, time, names[0]))
        names = list(dict.fromkeys([nearest, *names]))
    check_size(path, sum(sets[name].nbytes for name in names))
    last_words = [name.rsplit("/", 1)[-1] for name in names]
    if len(set(last_words)) < len(names):
        last_words = names
    arrays = {
        word: np.asarray(sets[name])
        for word, name in zip(last_words, names, strict=True)
    }
    table = table_of(path, arrays, rate=None if times else rate)
    remark = ", ".join(names) + (f" at {rate:g} Hz" if rate and not times else "")
    remark = f"{episode}: {remark}" if episode else remark
    return replace(table, remarks=(remark, *table.remarks))


def _nearness(sets: dict[str, Any], time: str, name: str) -> tuple[bool, int]:
    """Return how well times fit a dataset: whether as many, and the groups they share."""
    groups = zip(time.split("/")[:-1], name.split("/")[:-1], strict=False)
    shared = list(takewhile(lambda pair: pair[0] == pair[1], groups))
    return sets[time].size in sets[name].shape, len(shared)


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
