"""Options for reading files that lack a unit, a rate or the names of columns."""

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.reading.table import LENGTHS, named_unit


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """Choice of columns, and information that a file lacks.

    Attributes
    ----------
    columns : mapping from str to str
        Column of each channel and of `time`: its name, or its number from 1. A
        unit may follow in brackets: `{"time": "stamp [ms]", "x": "3"}`. All channels
        where empty.
    unit : str
        Unit of positions where the file does not state it: m, cm, mm ...
    sample_rate : float, optional
        Samples per second (Hz), instead of a time column.
    topic : str
        Topic of a bag, or feature of a dataset (`action`).
    quaternions : {"xyzw", "wxyz"}
        Order of the four numbers of an array whose file does not name them. Either order
        gives unit quaternions and equal angles between samples: only the arm can tell.
    all_arrays : bool
        Whether to read all arrays of an `.npz` file instead of its position alone.

    Examples
    --------
    >>> ReadingOptions.parse("time=stamp [ms], x=3").columns
    {'time': 'stamp [ms]', 'x': '3'}
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    sample_rate: float | None = None
    topic: str = ""
    quaternions: str = "xyzw"
    all_arrays: bool = False

    def __post_init__(self) -> None:
        """Check the unit and the rate."""
        if self.sample_rate is not None:
            check_number(
                self.sample_rate, "the sample rate", above=0, error=SkillFileError
            )
        if self.quaternions not in ("xyzw", "wxyz"):
            raise SkillFileError(
                f"the order of quaternions is {self.quaternions!r}; choose xyzw or wxyz."
            )
        if self.unit and self.unit not in LENGTHS:
            raise SkillFileError(
                f"the unit is {self.unit!r}; choose one of {', '.join(LENGTHS)}."
            )

    @classmethod
    def parse(cls, columns: str, **others: Any) -> "ReadingOptions":
        """Return options whose columns are written as `time=stamp,x=3`."""
        pairs = [part.partition("=") for part in columns.split(",") if part.strip()]
        wrong = [name for name, _, source in pairs if not (name and source.strip())]
        if wrong:
            raise SkillFileError(
                f"the columns are {columns!r}; write NAME=COLUMN for each, as in "
                "time=stamp,x=px,y=py,z=pz."
            )
        sources = {name.strip(): source.strip() for name, _, source in pairs}
        return cls(columns=sources, **others)

    def quaternion_remark(self, name: str) -> str:
        """Return in which order four numbers without names are read, and the other one."""
        other = "wxyz" if self.quaternions == "xyzw" else "xyzw"
        return (
            f"the quaternion from {name} is read as {', '.join(self.quaternions)}; if it is "
            f"{', '.join(other)}, add --quaternions {other}"
        )

    def source(self, channel: str) -> tuple[str, str]:
        """Return the name or number of a channel's column, and its unit or ""."""
        return named_unit(self.columns[channel])

    def column(self, channel: str, names: tuple[str, ...]) -> int:
        """Return the index of a channel's column."""
        source, _ = self.source(channel)
        lower = [name.lower() for name in names]
        for name, candidates in ((source, list(names)), (source.lower(), lower)):
            if name in candidates:
                return candidates.index(name)
        if re.fullmatch(r"\d+", source) and 1 <= int(source) <= len(names):
            return int(source) - 1
        raise SkillFileError(
            f"there is no column {source!r} for {channel}; {shown_columns(names)}."
        )


def columns_option(sources: Mapping[str, str]) -> str:
    """Return the option of the command line that reads channels from columns."""
    pairs = ",".join(f"{channel}={source}" for channel, source in sources.items())
    return f"--columns {shlex.quote(pairs)}"


def shown_columns(names: tuple[str, ...]) -> str:
    """Return the names of columns, for errors."""
    if not any(names):
        return f"the {len(names)} columns have no names; give their numbers from 1"
    labels = [name or f"(column {i})" for i, name in enumerate(names, 1)]
    more = f" and {len(labels) - 20} more" if len(labels) > 20 else ""
    return f"the columns are {', '.join(labels[:20])}{more}"
