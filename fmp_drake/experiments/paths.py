"""Played paths over the demonstrated one."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fmp_drake.plots import draw_demonstrations_in_plane
from fmp_drake.plots.style import PLAYED, set_title
from fmp_drake.primitives import Demonstration


def draw_paths(
    recorded: Demonstration, paths: Mapping[str, NDArray[np.float64]], *, rows: int = 1
) -> Figure:
    """Draw paths (ticks, D) side by side, each over the demonstration in grey.

    Parameters
    ----------
    recorded : Demonstration
    paths : mapping of str to ndarray, shape (ticks, D)
        By their titles; a ring marks the start of each.
    rows : int
        Rows of pictures.
    """
    columns = len(paths) // rows
    figure = Figure(figsize=(5 * columns, 4.5 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, (title, path) in zip(axes, paths.items(), strict=True):
        draw_demonstrations_in_plane([recorded], ax=ax)
        x, y = path[:, 0], path[:, 1]
        ax.plot(y, x, color=PLAYED, linewidth=1.2)
        ax.plot(y[0], x[0], "o", color=PLAYED, fillstyle="none")
        set_title(ax, title)
    return figure
