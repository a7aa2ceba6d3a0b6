"""Forces and orientations that were recorded apart from the position, in files of their own."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives.data.channels import (
    FORCE_CHANNEL,
    FORCE_COMPONENTS,
    QUATERNION_CHANNELS,
    ROTATION_CHANNELS,
)
from fmp_drake.primitives.data.reading.rows import LEAST_COMPLETE, at_times, slerp
from fmp_drake.primitives.data.reading.table import Table, count_text

_TURNS = {*QUATERNION_CHANNELS, *ROTATION_CHANNELS}
_PARTS = ((FORCE_CHANNEL,), FORCE_COMPONENTS, QUATERNION_CHANNELS, ROTATION_CHANNELS)


def is_part(channels: Sequence[str], units: Sequence[str]) -> bool:
    """Return whether there is a force or an orientation, but no position and no joint."""
    others = [u for c, u in zip(channels, units, strict=True) if c not in _TURNS]
    has_part = any({*part} <= {*channels} for part in _PARTS)
    return has_part and not {"m", "rad"} & {*others}


def joined_parts(tables: Sequence[tuple[Path, Table]]) -> list[tuple[Path, Table]]:
    """Add forces and orientations to the recordings at the same absolute times.

    Times that begin at 0 do not tell whether two recordings began together. The times of a
    clock that they share begin later than the recordings last.

    Raises
    ------
    DemonstrationError
        Where there are recordings, but none at the times of a force or an orientation.
    """
    parts: list[tuple[Path, Table]] = []
    recordings: list[tuple[Path, Table]] = []
    for path, table in tables:
        is_one = not table.saved and is_part(table.names[1:], table.units[1:])
        (parts if is_one else recordings).append((path, table))
    if not parts or not recordings:
        return list(tables)
    joined = list(recordings)
    for path, part in parts:
        fitting = [
            i for i, (_, t) in enumerate(recordings) if _is_simultaneous(t, part)
        ]
        if not fitting:
            listed = ", ".join(
                other.name if table.saved else f"{other.name} ({_span_text(table)})"
                for other, table in recordings
            )
            raise DemonstrationError(
                f"{path} holds {', '.join(part.names[1:])} without a position, and "
                f"cannot be added to {listed}: its times ({_span_text(part)}) are not the "
                "absolute times of the same movement. Give stamps of one clock in both files, "
                "such as seconds since 1970, or write them into one table."
            )
        for i in fitting:
            other, table = joined[i]
            joined[i] = other, _with_part(other, table, path, part)
    return joined


def _span(table: Table) -> tuple[float, float]:
    """Return the first and the last absolute time of a table, s."""
    return table.origin + table.values[0, 0], table.origin + table.values[-1, 0]


def _is_simultaneous(table: Table, part: Table) -> bool:
    """Return whether times of one clock overlap; a saved recording has none."""
    if table.saved:
        return False
    (a, b), (c, d) = _span(table), _span(part)
    return max(a, c) < min(b, d) and a > b - a and c > d - c


def _span_text(table: Table) -> str:
    begin, end = _span(table)
    return f"{begin:.3f} s to {end:.3f} s"


def _with_part(other: Path, table: Table, path: Path, part: Table) -> Table:
    """Return a table with the channels of another one, at the times of the first."""
    if common := {*table.names[1:]} & {*part.names[1:]}:
        raise DemonstrationError(
            f"{path} and {other} both hold {', '.join(sorted(common))} at the same times; "
            "choose one of them with --columns, or leave out a file."
        )
    time, stamps = table.values[:, 0], part.values[:, 0] + (part.origin - table.origin)
    names, columns = part.names[1:], part.values.T[1:]
    added = np.column_stack(
        [
            at_times(time, stamps, column, name=name)
            for name, column in zip(names, columns, strict=True)
        ]
    )
    is_known = ~np.any(np.isnan(added), axis=1)
    known = int(np.count_nonzero(is_known))
    if known < LEAST_COMPLETE * len(time):
        raise DemonstrationError(
            f"{path} has values at only {known} of the {len(time)} samples of {other}; "
            "record both over the same times, or cut the longer one."
        )
    if set(QUATERNION_CHANNELS) <= {*part.names}:
        index = [part.names.index(name) for name in QUATERNION_CHANNELS]
        turned = slerp(time[is_known], stamps, part.values[:, index])
        added[np.ix_(is_known, np.array(index) - 1)] = turned
    values = np.column_stack([table.values, added])[is_known]
    remark = f"{', '.join(part.names[1:])} of {path.name} interpolated at its times"
    if known < len(time):
        remark += f"; {count_text(len(time) - known, 'sample')} without these left out"
    return replace(
        table,
        names=(*table.names, *part.names[1:]),
        units=(*table.units, *part.units[1:]),
        numbers=(),
        values=values,
        remarks=(
            *table.remarks,
            *(f"{path.name}: {note}" for note in part.remarks),
            remark,
        ),
        has_angles=table.has_angles or part.has_angles,
    )
