"""Reader of HDF5 files: robomimic, ALOHA, MATLAB 7.3, and arrays of one length."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.reading.arrays import align_arrays, table_of
from fmp_drake.primitives.data.reading.table import Table, check_size, readable

# Datasets that are read unless others are named: robomimic's pose, ALOHA's joints.
_POSE = re.compile(r"(?:.*/)?(\w*eef)_(pos|quat)")
_JOINTS = re.compile(r"(?:.*/)?observations/qpos")
_TIME = re.compile(r"(?:.*/)?(time|times|timestamps?|t)")
_RATES = ("fps", "rate", "frequency", "control_freq", "sample_rate")


def read_hdf5(path: Path, topic: str) -> list[Table]:
    """Return the tables of an HDF5 file: one per episode of a dataset, else one.

    Parameters
    ----------
    path : Path
    topic : str
        Name of a dataset in the file (or in each episode), such as `action`. "" for the
        pose of an end effector, the joints, or all arrays of one length.

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
                _table(path, group, topic, rate, name)
                for name, group in (episodes or {"": file}).items()
            ]


def _table(
    path: Path, group: Any, topic: str, rate: float | None, episode: str
) -> Table:
    """Return the table of one group, with a time from the rate where there is none."""
    sets: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:  # Links into other files are not visited.
        if not hasattr(item, "dtype") or item.is_virtual or item.external:
            return  # The numbers of virtual datasets are in other files.
        if item.dtype.kind in "biuf" and item.ndim in (1, 2) and item.size > 1:
            sets[name] = item

    group.visititems(visit)
    names = [name for name in sets if topic and f"/{name}".endswith(f"/{topic}")]
    if topic and not names:
        raise SkillFileError(
            f"{path} has no dataset {topic}; choose with --topic among "
            f"{', '.join(sets) or '(none)'}."
        )
    names = (
        names
        or [name for name in sets if _POSE.fullmatch(name)]
        or [name for name in sets if _JOINTS.fullmatch(name)]
        or list(sets)
    )
    times = [name for name in sets if _TIME.fullmatch(name)]
    if times and times[0] not in names:
        names.insert(0, times[0])
    check_size(path, sum(sets[name].nbytes for name in names))
    arrays: dict[str, NDArray[Any]] = {}
    for name in names:
        arrays[name.rsplit("/", 1)[-1]] = np.asarray(sets[name])
    table = table_of(path, align_arrays(arrays), rate=None if times else rate)
    remark = ", ".join(names) + (f" at {rate:g} Hz" if rate and not times else "")
    return Table(
        names=table.names,
        units=table.units,
        values=table.values,
        remarks=(f"{episode}: {remark}" if episode else remark, *table.remarks),
    )


def _rate(group: Any) -> float | None:
    """Return the sample rate in the attributes of a group, Hz, if any."""
    settings = dict(getattr(group, "attrs", {}))
    try:
        settings |= json.loads(settings.get("env_args", "{}"))["env_kwargs"]
    except (KeyError, TypeError, ValueError):
        pass
    rates = [settings[name] for name in _RATES if name in settings]
    return float(rates[0]) if rates and np.ndim(rates[0]) == 0 else None


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts demo_2 before demo_10."""
    return [(int(part or 0), text) for text, part in re.findall(r"(\D*)(\d*)", name)]
