"""The result of an experiment, and measures of trajectories that it is judged by."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """One figure or table, what it shows, and whether the paper's claim is true here.

    Attributes
    ----------
    name : str
        Such as "fig4", the name of the picture's file.
    title : str
    shows : str
        One sentence, with the numbers.
    claim : str
        The paper's claim; "" where it makes none.
    agrees : bool or None
        Whether it is true of this run; None where there is no claim.
    figure : Figure or None
    table : list of rows of str, or None
        The first row is the header.

    Examples
    --------
    >>> finding = Finding(
    ...     name="table_1", title="Table I", shows="Divergences.", agrees=True
    ... )
    >>> finding.agrees
    True
    """

    name: str
    title: str
    shows: str
    claim: str = ""
    agrees: bool | None = None
    figure: Figure | None = None
    table: list[list[str]] | None = None


class Closeness:
    """Distances from trajectories to a demonstrated path.

    Parameters
    ----------
    demonstrated : ndarray, shape (..., D)
        Samples of the path.
    """

    def __init__(self, demonstrated: NDArray[np.float64]) -> None:
        self._tree = cKDTree(demonstrated.reshape(-1, demonstrated.shape[-1]))

    def distances(self, trajectories: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance of each sample (..., D) to the nearest one, (...)."""
        flat = trajectories.reshape(-1, trajectories.shape[-1])
        return self._tree.query(flat)[0].reshape(trajectories.shape[:-1])


def roughness(trajectories: NDArray[np.float64], rate: float) -> float:
    """Return the rms jerk of trajectories (..., ticks, D), in units per s^3."""
    third = np.diff(trajectories, n=3, axis=-2) * rate**3
    return float(np.sqrt(np.mean(np.sum(third**2, axis=-1))))


def millimetres(value: Any) -> str:
    """Return a length in metres as text in millimetres."""
    return f"{1e3 * float(value):.1f} mm"
