"""LeRobot datasets, by their layout: versions 2 and 3."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.reading.arrays import read_parquet
from fmp_drake.primitives.data.reading.table import MOST_BYTES, Table, check_size

_NOMINAL = "observation.state"


def read_lerobot(folder: Path, feature: str) -> list[Table]:
    """Return one feature of each episode of a dataset, over time.

    Parameters
    ----------
    folder : Path
        With `meta/info.json` and `data`.
    feature : str
        "" for the state that was observed.

    Raises
    ------
    SkillFileError
        Where the dataset is incomplete, or the feature is not in it.
    """
    feature = feature or _NOMINAL
    about = folder / "meta" / "info.json"
    try:
        info = json.loads(about.read_text(encoding="utf-8"))
        features, rate = info["features"], float(info["fps"])
        named = {str(name): dict(kind) for name, kind in features.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SkillFileError(f"{about} is no LeRobot dataset's ({error!r}).") from None
    if feature not in named:
        known = [n for n, kind in named.items() if "float" in str(kind.get("dtype"))]
        raise SkillFileError(
            f"{folder} has no feature {feature}; choose with --topic among "
            f"{', '.join(known)}."
        )
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise SkillFileError(f"{folder} has no data/**/*.parquet.")
    check_size(folder, sum(f.stat().st_size for f in files), MOST_BYTES / 4)
    needed = [feature, "timestamp", "episode_index"]
    tables = [read_parquet(file, needed) for file in files]
    first = tables[0].names
    if any(table.names != first for table in tables):
        raise SkillFileError(f"{folder}: its files have different columns.")
    values = np.concatenate([table.values for table in tables])
    missing = {"timestamp", "episode_index"} - set(first)
    at = [i for i, name in enumerate(first) if name not in needed[1:]]
    if missing or not at:
        raise SkillFileError(f"{folder} has no column {min(missing, default=feature)}.")
    episode, time = (values[:, first.index(n)] for n in ("episode_index", "timestamp"))
    names = ("time", *_names(named[feature].get("names"), len(at)))
    remark = f"{feature} at {rate:g} Hz"
    return [
        Table(
            names=names,
            units=("s", *("" for _ in at)),
            values=np.column_stack([time, values[:, at]])[episode == number],
            remarks=(f"episode {number:.0f}: {remark}",),
        )
        for number in np.unique(episode)
    ]


def _names(given: Any, count: int) -> tuple[str, ...]:
    """Return the names of a feature's parts: from a list, a group, or none."""
    if isinstance(given, dict):
        given = next(iter(given.values()), None)
    if (
        isinstance(given, list)
        and len(given) == count
        and len(set(map(str, given))) == count
    ):
        return tuple(map(str, given))
    return ("",) * count
