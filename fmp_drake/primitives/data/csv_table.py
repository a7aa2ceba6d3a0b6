"""Reading recordings from tables of comma-separated values."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from fmp_drake.errors import SkillFileError


def read_recording(path: Path) -> dict[str, Any]:
    """Return time, values, channels and units of a recording in a `.csv` file.

    Its header line names `time` and the channels, with units in brackets: `x [m]`.

    Raises
    ------
    SkillFileError
        Where the file is no such table; the line is named.
    """
    try:
        # A spreadsheet's file may start with a byte order mark.
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            table = [(reader.line_num, row) for row in reader if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SkillFileError(f"{path} is not a readable .csv file ({error}).") from None
    if not table:
        raise SkillFileError(f"{path} is empty.")
    names, units = [], []
    for cell in table[0][1]:
        name, _, unit = cell.partition("[")
        names.append(name.strip())
        units.append(unit.rstrip("] ").strip() or "m")
    if "time" not in names or len(names) < 2:
        raise SkillFileError(
            f"{path} has the columns {', '.join(names)}; a demonstration needs a "
            "header line with `time` (s) and at least one channel, such as "
            "`time,x,y,z`."
        )
    numbers = np.empty((len(table) - 1, len(names)))
    for i, (line, row) in enumerate(table[1:]):
        if len(row) != len(names):
            raise SkillFileError(
                f"{path}: line {line} has {len(row)} cells; the header has "
                f"{len(names)}."
            )
        try:
            numbers[i] = [float(cell) for cell in row]
        except ValueError as error:
            raise SkillFileError(f"{path}: line {line}: {error}.") from None
    at = names.index("time")
    keep = [i for i in range(len(names)) if i != at]
    return {
        "time": numbers[:, at],
        "values": numbers[:, keep],
        "channels": tuple(names[i] for i in keep),
        "units": tuple(units[i] for i in keep),
    }
