"""What every reader makes of a file: columns of numbers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError

# No recording is larger, in bytes of numbers or of text.
MOST_BYTES = 2**28


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns of numbers, as they are in a file.

    Attributes
    ----------
    names : tuple of str
        Of each column; "" where it has none.
    values : ndarray, shape (N, C)
        NaN where a cell is empty.
    units : tuple of str
        "" where unstated; all where not given.
    remarks : tuple of str
        What was recognised, and what was left out.
    frame : str

    Examples
    --------
    >>> Table(names=("t", "x"), values=np.zeros((4, 2))).units
    ('', '')
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    units: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    frame: str = ""

    def __post_init__(self) -> None:
        """Fill in units that were not given."""
        object.__setattr__(self, "units", self.units or ("",) * len(self.names))


def check_size(path: object, size: float, most: float = MOST_BYTES) -> None:
    """Refuse what would take too much memory, before it is read."""
    if size > most:
        raise SkillFileError(
            f"{path} holds {size / 2**20:.0f} MB; at most {most / 2**20:.0f} MB are "
            "read. Cut it, or keep only the columns and the rate that are needed."
        )
