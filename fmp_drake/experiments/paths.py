"""A played path over the demonstrated one."""

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fmp_drake.plots import draw_demonstrations_in_plane
from fmp_drake.plots.style import PLAYED, set_title
from fmp_drake.primitives import Demonstration


def draw_path(
    ax: Axes, recorded: Demonstration, path: NDArray[np.float64], title: str = ""
) -> None:
    """Draw a path (ticks, D) with a ring at its start, the demonstration in grey."""
    draw_demonstrations_in_plane([recorded], ax=ax)
    x, y = path[:, 0], path[:, 1]
    ax.plot(y, x, color=PLAYED, linewidth=1.2)
    ax.plot(y[0], x[0], "o", color=PLAYED, fillstyle="none")
    set_title(ax, title)
