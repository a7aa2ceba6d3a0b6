"""A page about one run of the wiping station."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from fmp_drake.apps.plots.channels import Channels
from fmp_drake.apps.plots.style import (
    PLAYED,
    SAMPLED,
    add_colorbar,
    draw_grey_paths,
    draw_path,
    finish_plane,
    finish_times,
    legend_above,
    save,
    set_title,
)

if TYPE_CHECKING:
    from fmp_drake.apps.wiping_run import WipingRun

_PLANE = (0, 1)
_AXIS_COLORS = ("#0072B2", "#D55E00", "#009E73")


def plot_run(run: "WipingRun", path: Path) -> None:
    """Write the page `draw_run` draws to a file (.png, .pdf, .svg)."""
    save(draw_run(run), path)


def draw_run(run: "WipingRun") -> Figure:
    """Return a page: path, ink left, force on the board and tracking error."""
    names = Channels.of_skill(run.skill)
    figure = Figure(figsize=(12, 8), layout="constrained")
    (a, b), (c, d) = figure.subplots(2, 2, height_ratios=[1.4, 1])

    measured = run.log("measured_position")
    draw_grey_paths(a, run.demonstrated, _PLANE)
    draw_path(a, measured[::20], _PLANE, color=PLAYED, linewidth=1.0, label="measured")
    set_title(a, "path of the eraser")
    legend_above(a)
    finish_plane(a, names, _PLANE)

    nx, ny = run.grid.size
    ink = run.ink().T
    x_edges = np.linspace(-nx / 2, nx / 2, ink.shape[0] + 1)
    y_edges = np.linspace(-ny / 2, ny / 2, ink.shape[1] + 1)
    image = b.pcolormesh(
        y_edges, x_edges, ink, cmap="Blues", vmin=0, vmax=1, rasterized=True
    )
    b.contour(
        (y_edges[1:] + y_edges[:-1]) / 2,
        (x_edges[1:] + x_edges[:-1]) / 2,
        run.demonstrated_area().T.astype(float),
        levels=[0.5],
        colors=PLAYED,
        linewidths=1.2,
    )
    b.plot([], [], color=PLAYED, linewidth=1.2, label="demonstrated area")
    add_colorbar(b, image, "share of the ink")
    set_title(b, "ink left")
    legend_above(b)
    finish_plane(b, names, _PLANE)

    c.plot(
        run.log_times("normal_force"),
        run.log("normal_force")[:, 0],
        color=SAMPLED,
        linewidth=0.8,
    )
    c.set_ylim(bottom=0)
    set_title(c, "force on the board")
    finish_times([c], ["normal force (N)"])

    error = 1e3 * (measured - run.log("desired_position"))
    times = run.log_times("measured_position")
    for i, (name, color) in enumerate(zip("xyz", _AXIS_COLORS, strict=True)):
        d.plot(times[::10], error[::10, i], color=color, linewidth=0.8, label=name)
    set_title(d, "tracking error")
    legend_above(d)
    finish_times([d], ["measured - desired (mm)"])
    return figure
