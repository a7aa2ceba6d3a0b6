"""A page about one run of the wiping station."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmp_drake.plots.channels import Channels
from fmp_drake.plots.panels import PlanePanel
from fmp_drake.plots.run_events import draw_events
from fmp_drake.plots.style import (
    DEMONSTRATED,
    PLAYED,
    SAMPLED,
    add_colorbar,
    finish_times,
    legend_above,
    save,
    set_title,
)

if TYPE_CHECKING:
    from fmp_drake.runs.wiping_run import WipingRun

_AXIS_COLORS = ("#0072B2", "#D55E00", "#009E73")
_MILESTONES = (0.5, 0.9, 0.99)

RUN_PAGE_SIGNALS = (
    *("measured_position", "desired_position", "normal_force"),
    *("cleaned_fraction", "remaps", "disturbance"),
)
"""Names of the signals that a run must keep for its page."""


def plot_run(run: "WipingRun", path: Path) -> None:
    """Write the page `draw_run` draws to a file (.png, .pdf, .svg)."""
    save(draw_run(run), path)


def draw_run(run: "WipingRun") -> Figure:
    """Return a page: path, ink left; cleaned area, force and tracking error over time.

    Dotted lines are re-mappings, dashed ones those after a push, and shaded times are
    those of a disturbance, or of what went wrong; above is said what.

    Parameters
    ----------
    run : WipingRun
        Which has kept `RUN_PAGE_SIGNALS`.
    """
    figure = Figure(figsize=(11, 10.5), layout="constrained")
    grid = figure.add_gridspec(4, 2, height_ratios=[2.1, 1, 1, 1])
    _draw_path(figure.add_subplot(grid[0, 0]), run)
    _draw_ink(figure.add_subplot(grid[0, 1]), run)
    cleaned = figure.add_subplot(grid[1, :])
    force = figure.add_subplot(grid[2, :], sharex=cleaned)
    error = figure.add_subplot(grid[3, :], sharex=cleaned)
    _draw_cleaned(cleaned, run)
    _draw_force(force, run)
    _draw_error(error, run)
    finish_times(
        [cleaned, force, error],
        ["clean (%)", "normal force (N)", "measured - desired (mm)"],
    )
    cleaned.set_xlim(0, run.log_times("measured_position")[-1])
    for ax in (cleaned, force, error):
        draw_events(ax, run)
        legend_above(ax)
    figure.align_ylabels([cleaned, force, error])
    sentences = "\n".join(event.text for event in run.events())
    if sentences:
        figure.suptitle(sentences, fontsize="medium", x=0.01, ha="left")
    return figure


def _draw_path(ax: Axes, run: "WipingRun") -> None:
    panel = PlanePanel(Channels.of_skill(run.skill), None, ax)
    for path in run.demonstrated:
        panel.grey_path(path)
    measured = run.log("measured_position")[::4]  # 50 Hz.
    panel.path(measured, color=PLAYED, linewidth=0.7, label="measured")
    _finish_board(panel, run, "path of the eraser")


def _draw_ink(ax: Axes, run: "WipingRun") -> None:
    panel = PlanePanel(Channels.of_skill(run.skill), None, ax)
    nx, ny = run.grid.size
    ink = run.ink().T
    x_edges = np.linspace(-nx / 2, nx / 2, ink.shape[0] + 1)
    y_edges = np.linspace(-ny / 2, ny / 2, ink.shape[1] + 1)
    image = ax.pcolormesh(
        y_edges, x_edges, ink, cmap="Blues", vmin=0, vmax=1, rasterized=True
    )
    ax.contour(
        (y_edges[1:] + y_edges[:-1]) / 2,
        (x_edges[1:] + x_edges[:-1]) / 2,
        run.demonstrated_area.T.astype(float),
        levels=[0.5],
        colors=PLAYED,
        linewidths=1.2,
    )
    ax.plot([], [], color=PLAYED, linewidth=1.2, label="demonstrated area")
    add_colorbar(ax, image, "fraction of the ink")
    _finish_board(panel, run, "ink left")


def _finish_board(panel: PlanePanel, run: "WipingRun", title: str) -> None:
    """Let a picture in the plane show the whole board, and no more."""
    ax = panel.finish(title)
    legend_above(ax)
    nx, ny = run.grid.size
    ax.set_xlim(ny / 2, -ny / 2)
    ax.set_ylim(-nx / 2, nx / 2)


def _draw_cleaned(ax: Axes, run: "WipingRun") -> None:
    """Draw how much of the ink is gone, with the times to 50, 90 and 99 %."""
    # Where the run is made Drake is there; the other pictures need none.
    from fmp_drake.systems.ink.grid import CLEAN_BELOW

    inked = run.initial_ink.reshape(run.grid.shape) >= CLEAN_BELOW
    area = run.demonstrated_area & inked
    end = float(run.log_times("measured_position")[-1])
    erased = run.erase_time()
    times = np.sort(erased[area & np.isfinite(erased)])
    count = max(1, int(np.count_nonzero(area)))
    fractions = np.arange(len(times) + 1) / count
    ax.plot(
        run.log_times("cleaned_fraction"),
        100 * run.log("cleaned_fraction")[:, 0],
        color=DEMONSTRATED,
        linewidth=1.2,
        label="whole board",
    )
    ax.step(
        np.concatenate([[0.0], times, [end]]),
        100 * np.concatenate([fractions, fractions[-1:]]),
        where="post",
        color=SAMPLED,
        linewidth=1.6,
        label="demonstrated area",
    )
    for fraction in _MILESTONES:
        needed = int(np.ceil(fraction * count - 1e-9))
        if needed > len(times):
            continue
        at = float(times[needed - 1])
        ax.plot(at, 100 * fraction, "o", color=SAMPLED, markersize=4, zorder=3)
        ax.annotate(
            f"{100 * fraction:.0f} % after {at:.1f} s",
            (at, 100 * fraction),
            xytext=(6, -5),
            textcoords="offset points",
            ha="left",
            va="top",
            fontsize="small",
            color=SAMPLED,
        )
    ax.set_ylim(0, 105)
    set_title(
        ax, f"clean area: {100 * fractions[-1]:.1f} % of the demonstrated at the end"
    )


def _draw_force(ax: Axes, run: "WipingRun") -> None:
    from fmp_drake.runs.metrics import NEAR_FORCE

    wanted = run.scenario.press.force
    low, high = max(0.0, wanted - NEAR_FORCE), wanted + NEAR_FORCE
    ax.axhspan(
        low,
        high,
        color="#009E73",
        alpha=0.12,
        linewidth=0,
        label=f"wanted, {low:g} to {high:g} N",
    )
    force = run.log("normal_force")[:, 0]
    ax.plot(run.log_times("normal_force"), force, color=SAMPLED, linewidth=0.8)
    ax.set_ylim(0, max(1.2 * high, 1.05 * float(np.max(force, initial=0.0))))
    set_title(ax, "force on the board")


def _draw_error(ax: Axes, run: "WipingRun") -> None:
    error = 1e3 * (run.log("measured_position") - run.log("desired_position"))
    times = run.log_times("measured_position")
    for i, (name, color) in enumerate(zip("xyz", _AXIS_COLORS, strict=True)):
        ax.plot(times[::10], error[::10, i], color=color, linewidth=0.8, label=name)
    set_title(ax, "tracking error")
