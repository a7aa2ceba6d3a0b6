"""Page about a skill: demonstrated, learned and played movements; its reach on a board."""

from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, cast

import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from fmp_drake.plots.demonstrations import (
    draw_demonstrations_in_plane,
    draw_demonstrations_over_time,
    draw_spectra,
    learned_parts,
)
from fmp_drake.plots.learned import (
    draw_component_in_plane,
    draw_component_over_time,
    draw_heatmaps,
    draw_phase,
    draw_rollout_in_plane,
    draw_rollout_over_time,
    draw_samples_in_plane,
)
from fmp_drake.plots.style import (
    INFEASIBLE,
    SAMPLED,
    Channels,
    Demonstrations,
    PlanePanel,
    add_colorbar,
    legend_above,
    same_limits,
    save,
    shape_of,
)
from fmp_drake.primitives import FourierMovementPrimitive, Player
from fmp_drake.primitives.data.windows import demonstration_list

if TYPE_CHECKING:
    from fmp_drake.station.reach.feasibility import Feasibility

# Width, inches: letters are legible on a page of 800 pixels.
_WIDTH = 11.5
_TUBE = (
    "Tube: 95 % of the windows of a component. Their tempo differs, so the tube is wider "
    "along the movement, and extends beyond it at turning points."
)
_MARGIN_MAP: Colormap = LinearSegmentedColormap.from_list(
    "fmp_margin", ["#FFF7D6", "#B9DDB0", "#5FB08A"]
)
_SPRING_COLOR = "#F0C9CD"
_MAX_MARGIN = 0.8  # End of the colour scale, rad.


def plot_skill(
    skill: FourierMovementPrimitive, demonstrations: Demonstrations, path: str | Path
) -> None:
    """Write the page of a skill, see `draw_skill`, to a file (.png, .pdf, .svg)."""
    save(draw_skill(skill, demonstrations), path)


def draw_skill(
    skill: FourierMovementPrimitive, demonstrations: Demonstrations
) -> Figure:
    """Return a page about a skill and its demonstrations.

    The demonstrations and the first component of a skill of one channel are drawn over
    time instead of in the plane. The pictures of a phase model, if any, follow. Parts of a
    recording that were left out are drawn once only, with limits of their own.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    demonstrations : Demonstration or sequence of Demonstration
    """
    channels = len(Channels.of_skill(skill).names)
    learned = demonstration_list(demonstrations, "a picture")
    is_cut = bool(skill.paths_ and skill.rhythm_ and skill.rhythm_.left_out)
    if is_cut:
        learned = learned_parts(skill, learned[0])
    low, high = skill.extent_
    start = high + 0.5 * (high - low)
    player = Player(skill)
    ratio = 0.4
    if channels > 1:
        # Two rows of four pictures in the plane, with the aspect ratio of samples.
        samples = skill.sample(200, with_noise=False)
        ratio = shape_of(*np.ptp(samples, axis=(0, 1))[:2])
    heights = [2 * (0.9 + 2.1 * ratio), 1 + 1.3 * channels]
    if skill.phase_model_ is not None:
        heights.append(3.4)
    figure = Figure(figsize=(_WIDTH, sum(heights)), layout="constrained")
    parts = figure.subfigures(len(heights), squeeze=False, height_ratios=heights)
    top, bottom = parts[:2, 0]
    figure.suptitle(
        f"Learned skill: {skill.model_} model, {len(skill.components_)} components, "
        f"windows of {skill.window:.3g} s"
    )
    if skill.phase_model_ is not None:
        draw_phase(skill, parts[2, 0].subplots(1, 3), demonstrations=learned)
    if channels > 1:
        axes = top.subplots(2, 4)
        draw_demonstrations_in_plane(demonstrations, ax=axes[0, 0])
        draw_samples_in_plane(skill, demonstrations=learned, ax=axes[0, 1])
        draw_heatmaps(skill, learned, axes[0, 2:])
        component_count = min(3, len(skill.components_))
        for component, ax in enumerate(axes[1, :3]):
            if component < component_count:
                draw_component_in_plane(skill, component, ax, demonstrations=learned)
            else:
                ax.remove()
        draw_rollout_in_plane(player, start, demonstrations=learned, ax=axes[1, 3])
        # Wide tubes of few cycles would make the paths too small to be seen.
        same_limits(axes[0, int(is_cut) :])
        same_limits(axes[1, :component_count])
        top.supxlabel(_TUBE, fontsize="small")
    else:
        a, b = top.subplots(2, 1)
        draw_demonstrations_over_time(demonstrations, [a])
        draw_component_over_time(skill, 0, [b])
    left, right = bottom.subfigures(1, 2, width_ratios=[2, 3])
    axes = left.subplots(channels, sharex=True, squeeze=False)[:, 0]
    draw_spectra(skill, demonstrations, axes)
    ratios = [1.0] * channels + [0.25]
    rows = right.subplots(channels + 1, sharex=True, height_ratios=ratios)
    draw_rollout_over_time(player, start, rows)
    return figure


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
