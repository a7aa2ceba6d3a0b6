"""Played paths over the demonstrated one."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fmp_drake.plots import draw_demonstrations_in_plane
from fmp_drake.plots.style import DEMONSTRATED, PLAYED, same_limits, set_title, shape_of
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
    points = np.concatenate([recorded.values, *paths.values()])[:, :2]
    height = 0.9 + 3.8 * shape_of(*np.ptp(points, axis=0))
    figure = Figure(figsize=(5 * columns, 0.4 + height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, (title, path) in zip(axes, paths.items(), strict=True):
        draw_demonstrations_in_plane([recorded], ax=ax)
        ax.lines[-1].set(color=DEMONSTRATED, label="demonstrated")
        x, y = path[:, 0], path[:, 1]
        ax.plot(y, x, color=PLAYED, linewidth=1.2, label="played")
        ax.plot(y[0], x[0], "o", color=PLAYED, fillstyle="none", label="start")
        set_title(ax, title)
    same_limits(list(axes))
    figure.legend(
        handles=axes[0].lines, loc="outside upper right", ncols=3, frameon=False
    )
    return figure
