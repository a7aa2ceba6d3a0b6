"""Picture of the reachable part of a board, with a skill."""

from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, cast

import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from fmp_drake.plots.style import (
    INFEASIBLE,
    SAMPLED,
    Channels,
    PlanePanel,
    add_colorbar,
    legend_above,
    save,
)

if TYPE_CHECKING:
    from fmp_drake.station.reach.feasibility import Feasibility

_MARGIN_MAP: Colormap = LinearSegmentedColormap.from_list(
    "fmp_margin", ["#FFF7D6", "#B9DDB0", "#5FB08A"]
)
_SPRING_COLOR = "#F0C9CD"
_MAX_MARGIN = 0.8  # End of the colour scale, rad.


def plot_reach(feasibility: "Feasibility", path: str | Path) -> None:
    """Write a picture of a board from above, its reachable part and the skill's samples.

    The colour of the reachable part is the joint-limit margin. Samples that cannot be
    followed are red.

    Parameters
    ----------
    feasibility : Feasibility
        From `CheckFeasibility`.
    path : str or Path
        Ends in .png, .pdf or .svg.
    """
    from fmp_drake.station import ParseScenario

    x, y, margin = feasibility.cells
    board = ParseScenario(feasibility.scenario, name="the checked scenario").board
    panel = PlanePanel(Channels.of_board(board), None)
    dx, dy = x[1] - x[0], y[1] - y[0]  # Cells are drawn around their middles.
    area = Rectangle(
        (y[0] - dy / 2, x[0] - dx / 2),
        float(np.ptp(y) + dy),
        float(np.ptp(x) + dx),
        facecolor="0.93",
        edgecolor="0.78",
        hatch="////",
        label="out of reach",
        zorder=0.5,
    )
    panel.ax.add_patch(area)
    shades = _MARGIN_MAP.with_extremes(under=_SPRING_COLOR)
    mesh = panel.ax.pcolormesh(
        y,
        x,
        np.ma.masked_invalid(margin),
        cmap=shades,
        vmin=0,
        vmax=_MAX_MARGIN,
        shading="nearest",
        rasterized=True,
    )
    if np.any(margin[np.isfinite(margin)] < 0):
        # Nothing but an entry of the legend.
        label = "at a joint-limit spring"
        spring = Rectangle((y[0], x[0]), 0, 0, color=_SPRING_COLOR, label=label)
        panel.ax.add_patch(spring)
    for samples in feasibility.paths:
        panel.path(samples, label="samples", color=SAMPLED, linewidth=0.3)
    infeasible_points = feasibility.paths[~feasibility.followed]
    if len(infeasible_points):
        style = {"linestyle": "", "marker": "o", "markersize": 2.5, "zorder": 2.5}
        label = "cannot be followed"
        panel.path(infeasible_points, label=label, color=INFEASIBLE, **style)
    panel.starts(feasibility.start[None])
    add_colorbar(panel.ax, mesh, "joint-limit margin (rad)")
    axes = panel.finish("")
    rows = legend_above(axes)
    verdict = fill(feasibility.verdict, 70)
    axes.set_title(verdict, loc="left", fontsize="small", pad=6 + 16 * rows)
    save(cast(Figure, axes.figure), path)
