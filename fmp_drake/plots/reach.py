"""Picture of the reachable part of a board, with a skill."""

from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.patches import Rectangle

from fmp_drake.plots.style import (
    INFEASIBLE,
    PLAYED,
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
_OUT_OF_REACH: dict[str, Any] = {
    "facecolor": "0.93",
    "edgecolor": "0.78",
    "hatch": "////",
    "zorder": 0.5,
}


def plot_reach(feasibility: "Feasibility", path: str | Path) -> None:
    """Write the picture of `draw_reach` to a file (.png, .pdf, .svg)."""
    save(draw_reach(feasibility).figure.get_figure(root=True), path)


def draw_reach(feasibility: "Feasibility") -> Axes:
    """Draw the board from above, its reachable part and the samples of the skill.

    The colour of the reachable part is the joint-limit margin. Samples that cannot be
    followed are red.

    Parameters
    ----------
    feasibility : Feasibility
        From `CheckFeasibility`.
    """
    x, y, margin = feasibility.cells
    panel = PlanePanel(Channels(("x", "y"), ("m", "m")), None)
    board = Rectangle((y[0], x[0]), float(np.ptp(y)), float(np.ptp(x)), **_OUT_OF_REACH)
    panel.ax.add_patch(board).set_label("out of reach")
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
        panel.ax.add_patch(
            Rectangle((y[0], x[0]), 0, 0, color=_SPRING_COLOR)
        ).set_label("at a joint-limit spring")
    for path in feasibility.paths:
        panel.path(path[:, :2], label="samples", color=SAMPLED, linewidth=0.3)
    infeasible_points = feasibility.paths[~feasibility.followed]
    if len(infeasible_points):
        style: dict[str, Any] = {"color": INFEASIBLE, "markersize": 2.5, "zorder": 2.5}
        x, y = infeasible_points[:, 0], infeasible_points[:, 1]
        panel.ax.plot(y, x, "o", label="cannot be followed", **style)
    ring: dict[str, Any] = {
        "markerfacecolor": "white",
        "markeredgecolor": PLAYED,
        "markersize": 8,
    }
    panel.ax.plot(
        *feasibility.start[1::-1], "o", markeredgewidth=2.0, label="start", **ring
    )
    add_colorbar(panel.ax, mesh, "joint-limit margin (rad)")
    axes = panel.finish("")
    legend_above(axes)
    axes.set_title(fill(feasibility.verdict, 70), loc="left", fontsize="small", pad=22)
    return axes
