"""What a user says about a file that does not say it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.reading.units import LENGTHS, named_unit


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """What to read of a file, and what it does not say itself.

    Attributes
    ----------
    columns : mapping from str to str
        The column of each channel, and of `time`: by its name, or its number from 1. A
        unit may follow in brackets: `{"time": "stamp [ms]", "x": "3"}`. All channels
        are taken where empty.
    unit : str
        Of positions whose unit the file does not state: m, cm, mm ...
    rate : float, optional
        Samples per second (Hz), instead of a time column.
    topic : str
        Of a bag, or the feature of a dataset (`action`).

    Examples
    --------
    >>> ReadingOptions.parse("time=stamp [ms], x=3").columns
    {'time': 'stamp [ms]', 'x': '3'}
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    rate: float | None = None
    topic: str = ""

    def __post_init__(self) -> None:
        """Refuse a unit or a rate that means nothing."""
        if self.rate is not None:
            check_number(self.rate, "the sample rate", above=0, error=SkillFileError)
        if self.unit and self.unit not in LENGTHS:
            raise SkillFileError(
                f"the unit is {self.unit!r}; choose one of {', '.join(LENGTHS)}."
            )

    @classmethod
    def parse(
        cls, columns: str, *, unit: str = "", rate: float | None = None, topic: str = ""
    ) -> "ReadingOptions":
        """Return the options whose columns are written as `time=stamp,x=3`."""
        pairs = [part.partition("=") for part in columns.split(",") if part.strip()]
        wrong = [name for name, _, source in pairs if not (name and source.strip())]
        if wrong:
            raise SkillFileError(
                f"the columns are {columns!r}; write NAME=COLUMN for each, as in "
                "time=stamp,x=px,y=py,z=pz."
            )
        chosen = {name.strip(): source.strip() for name, _, source in pairs}
        return cls(columns=chosen, unit=unit, rate=rate, topic=topic)

    def source(self, channel: str) -> tuple[str, str]:
        """Return the name or number of a channel's column, and its unit or ""."""
        return named_unit(self.columns[channel])

    def column(self, channel: str, names: tuple[str, ...]) -> int:
        """Return the index of a channel's column."""
        source, _ = self.source(channel)
        lower = [name.lower() for name in names]
        for form, candidates in ((source, list(names)), (source.lower(), lower)):
            if form in candidates:
                return candidates.index(form)
        if re.fullmatch(r"\d+", source) and 1 <= int(source) <= len(names):
            return int(source) - 1
        raise SkillFileError(
            f"there is no column {source!r} for {channel}; {shown_columns(names)}."
        )


def shown_columns(names: tuple[str, ...]) -> str:
    """Return the names of columns, for errors."""
    if not any(names):
        return f"the {len(names)} columns have no names; give their numbers from 1"
    shown = [name or f"(column {i})" for i, name in enumerate(names, 1)]
    more = f" and {len(shown) - 20} more" if len(shown) > 20 else ""
    return f"the columns are {', '.join(shown[:20])}{more}"
