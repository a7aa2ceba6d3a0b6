"""Page about a run of a station, and the block diagram of the station."""

import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from fmp_drake.errors import RunError
from fmp_drake.plots.style import (
    DEMONSTRATED,
    PLAYED,
    SAMPLED,
    Channels,
    PlanePanel,
    add_colorbar,
    finish_times,
    legend_above,
    save,
    set_title,
)
from fmp_drake.primitives.data.channels import ROTATION_CHANNELS
from fmp_drake.primitives.data.files import check_writable, replaced, write_text

if TYPE_CHECKING:
    from pydrake.systems.framework import Diagram

    from fmp_drake.runs.station_run import StationRun, WipingRun

_AXIS_COLORS = ("#0072B2", "#D55E00", "#009E73")
_MILESTONES = (0.5, 0.9, 0.99)
_MIN_FORCE = 1e-3  # Of a disturbance, N.
_DISTURBANCE_COLOR = "#CC79A7"
_FAULT_COLORS = ("#D55E00", "#332288", "0.5", "#999933")

RUN_PAGE_SIGNALS = (
    *("measured_position", "desired_position", "normal_force"),
    *("cleaned_fraction", "remaps", "disturbance"),
    *("tracking_error", "desired_normal_force"),
)
"""Names of the signals that a run must keep for its page."""

# Formats of a block diagram.
_FORMATS = (".svg", ".png", ".pdf", ".dot")
_DOTS_PER_INCH = "110"
# The systems of the diagram, without those of its subdiagrams. The inputs and outputs of
# the plant are separate nodes, so that the loop is drawn from left to right.
_DEPTH, _OPTIONS = 1, {"plant/split": "I/O"}


def plot_run(run: "StationRun", path: str | Path) -> None:
    """Write the page of a run, see `draw_run`, to a file (.png, .pdf, .svg).

    The run keeps at least the signals `fmp_drake.plots.run_page.RUN_PAGE_SIGNALS`.
    """
    save(draw_run(run), path)


def draw_run(run: "StationRun") -> Figure:
    """Return a page: path, remaining ink; cleaned area, force and tracking error over time.

    In free space there is neither ink nor force. Skills with an orientation also have its
    error. Dotted lines are scheduled re-mappings; dashed lines are re-mappings after a
    push. Disturbances and faults are shaded; the text above describes the faults.

    Parameters
    ----------
    run : StationRun
        Its kept signals include `RUN_PAGE_SIGNALS`.
    """
    if not len(run.log_times("measured_position")):
        raise RunError("the run has not started; call its advance_to first.")
    rows: dict[str, Callable[[Axes, Any], None]] = {}
    if _has_board(run):
        rows = {"clean (%)": _draw_cleaned, "normal force (N)": _draw_force}
    rows["error (mm)"] = _draw_error
    if run.roles.rotation is not None:
        rows["error (degrees)"] = _draw_orientation_error
    figure = Figure(figsize=(11, 10.5), layout="constrained")
    ratios = [2.1] + [1.0] * len(rows)
    grid = figure.add_gridspec(len(ratios), 2, height_ratios=ratios)
    if _has_board(run):
        _draw_path(figure.add_subplot(grid[0, 0]), run)
        _draw_ink(figure.add_subplot(grid[0, 1]), run)
    else:
        _draw_path(figure.add_subplot(grid[0, :]), run)
    axes: list[Axes] = []
    for row, draw in enumerate(rows.values(), 1):
        axes.append(figure.add_subplot(grid[row, :], sharex=axes[0] if axes else None))
        draw(axes[-1], run)
    finish_times(axes, list(rows))
    axes[0].set_xlim(0, max(run.log_times("measured_position")[-1], 1e-3))
    for ax in axes:
        # The last title is short: the names of the events have room beside it.
        _draw_events(ax, run, named=ax is axes[-1])
        legend_above(ax)
    figure.align_ylabels(axes)
    sentences = "\n".join(event.text for event in run.events())
    if sentences:
        figure.suptitle(sentences, fontsize="medium", x=0.01, ha="left")
    return figure


def _draw_path(ax: Axes, run: "StationRun") -> None:
    panel = PlanePanel(Channels.of_board(run.scenario.board), ax)
    for path in run.demonstrated:
        panel.grey_path(path[:, run.roles.position])
    measured = run.log("measured_position")[::4]  # 50 Hz.
    panel.path(measured, color=PLAYED, linewidth=0.7, label="measured")
    tool = "eraser" if _has_board(run) else "tool"
    _finish_board(panel, run, f"path of the {tool}")


def _draw_ink(ax: Axes, run: "WipingRun") -> None:
    panel = PlanePanel(Channels.of_board(run.scenario.board), ax)
    nx, ny = run.grid.size
    ink = run.ink().T
    x_edges = np.linspace(-nx / 2, nx / 2, ink.shape[0] + 1)
    y_edges = np.linspace(-ny / 2, ny / 2, ink.shape[1] + 1)
    image = ax.pcolormesh(
        y_edges, x_edges, ink, cmap="Blues", vmin=0, vmax=1, rasterized=True
    )
    area = run.demonstrated_area.T.astype(float)
    if np.ptp(area) > 0:  # Otherwise it has no outline.
        ax.contour(
            (y_edges[1:] + y_edges[:-1]) / 2,
            (x_edges[1:] + x_edges[:-1]) / 2,
            area,
            levels=[0.5],
            colors=PLAYED,
            linewidths=1.2,
        )
        ax.plot([], [], color=PLAYED, linewidth=1.2, label="demonstrated area")
    add_colorbar(ax, image, "fraction of the ink")
    _finish_board(panel, run, "ink left")


def _finish_board(panel: PlanePanel, run: "StationRun", title: str) -> None:
    """Set the limits of a picture in the plane to the edges of the board, if any."""
    ax = panel.finish(title)
    # A narrow board has no room for both in a line.
    set_title(ax, title + legend_above(ax) * "\n")
    if _has_board(run):
        nx, ny = run.grid.size
        ax.set_xlim(ny / 2, -ny / 2)
        ax.set_ylim(-nx / 2, nx / 2)


def _has_board(run: "StationRun") -> "TypeGuard[WipingRun]":
    return hasattr(run, "grid")


def _draw_cleaned(ax: Axes, run: "WipingRun") -> None:
    """Draw the clean fraction over time, with the times to 50, 90 and 99 %."""
    times = run.log_times("cleaned_fraction")
    board, demonstrated = 100 * run.log("cleaned_fraction")[:, 0], run.cleaned_by(times)
    ax.plot(times, board, color=DEMONSTRATED, linewidth=1.2, label="whole board")
    ax.set_ylim(0, 105)
    if demonstrated[0] == 1:
        set_title(ax, "clean: the demonstrated paths touch no ink")
        return
    style: dict[str, Any] = {"color": SAMPLED, "linewidth": 1.6}
    ax.plot(times, 100 * demonstrated, label="demonstrated area", **style)
    for fraction in _MILESTONES:
        if demonstrated[-1] < fraction:
            continue
        time = times[np.argmax(demonstrated >= fraction)]
        ax.plot(time, 100 * fraction, "o", color=SAMPLED, markersize=4, zorder=3)
        ax.annotate(
            f"{100 * fraction:.0f} % after {time:.1f} s",
            (time, 100 * fraction),
            xytext=(6, -5),
            textcoords="offset points",
            ha="left",
            va="top",
            fontsize="small",
            color=SAMPLED,
        )
    final = f"{100 * demonstrated[-1]:.1f} % of the demonstrated area at the end"
    set_title(ax, f"clean: {final}")


def _draw_force(ax: Axes, run: "WipingRun") -> None:
    from fmp_drake.station.scenario_parts import FORCE_TOLERANCE

    times, force = run.log_times("normal_force"), run.log("normal_force")[:, 0]
    desired = run.desired_force()
    low, high = np.maximum(desired - FORCE_TOLERANCE, 0.0), desired + FORCE_TOLERANCE
    style: dict[str, Any] = {"color": "#009E73", "alpha": 0.12, "linewidth": 0}
    if np.ptp(desired) == 0:
        label = f"desired, {low[0]:g} to {high[0]:g} N"
        ax.axhspan(low[0], high[0], label=label, **style)
    else:
        ax.fill_between(times, low, high, label="desired", **style)
    ax.plot(times, force, color=SAMPLED, linewidth=0.8)
    ax.set_ylim(0, max(1.2 * np.max(high), 1.05 * float(np.max(force, initial=0.0))))
    set_title(ax, "force on the board")


def _draw_error(ax: Axes, run: "StationRun") -> None:
    error = 1e3 * (run.log("measured_position") - run.log("desired_position"))
    names = Channels.of_board(run.scenario.board).names
    _draw_axes(ax, run.log_times("measured_position"), error, names)
    set_title(ax, "tracking error")


def _draw_orientation_error(ax: Axes, run: "StationRun") -> None:
    # The controller's error is desired - measured.
    error = -np.rad2deg(run.log("tracking_error")[:, :3])
    _draw_axes(ax, run.log_times("tracking_error"), error, ROTATION_CHANNELS)
    set_title(ax, "error of the orientation")


def _draw_axes(
    ax: Axes, times: ArrayLike, values: ArrayLike, names: Sequence[str]
) -> None:
    """Draw three columns over time, at every tenth sample, in the colours of the axes."""
    times, values = np.asarray(times)[::10], np.asarray(values)[::10]
    for name, column, color in zip(names, values.T, _AXIS_COLORS, strict=True):
        ax.plot(times, column, color=color, linewidth=0.8, label=name)


def _draw_events(ax: Axes, run: "StationRun", *, named: bool) -> None:
    """Mark the re-mappings, disturbances and faults of a run in axes over time."""
    time, counts = run.log_times("remaps"), run.log("remaps")
    total, after_push = (time[1:][steps] for steps in np.diff(counts, axis=0).T > 0)
    for instants, style, label in (
        (np.setdiff1d(total, after_push), ":", "re-mapped"),
        (after_push, "--", "re-mapped after a push"),
    ):
        for instant in instants:
            ax.axvline(
                instant,
                color="0.45",
                linewidth=0.7,
                linestyle=style,
                zorder=0.9,
                label=label if named else None,
            )
    faults = run.events()
    kinds = list(dict.fromkeys(event.kind for event in faults))
    for start, end, kind, _ in faults:
        ax.axvspan(
            start,
            end,
            color=_FAULT_COLORS[kinds.index(kind) % len(_FAULT_COLORS)],
            alpha=0.2,
            linewidth=1,
            label=kind if named else None,
        )
    if "disturbance" not in run.kept:
        return
    is_disturbed = np.linalg.norm(run.log("disturbance"), axis=1) > _MIN_FORCE
    if np.any(is_disturbed):
        ax.fill_between(
            run.log_times("disturbance"),
            0,
            1,
            where=is_disturbed,
            transform=ax.get_xaxis_transform(),
            color=_DISTURBANCE_COLOR,
            alpha=0.25,
            linewidth=0,
            label="disturbed" if named else None,
        )


def check_graph(path: Path | None) -> None:
    """Check that a picture of a diagram can be made, before any work is done."""
    if path is None:
        return
    check_writable(path, "a picture of a diagram", _FORMATS, RunError)
    if path.suffix.lower() != ".dot" and shutil.which("dot") is None:
        raise RunError(
            f"{path.name} needs the program dot of Graphviz; install it (on Ubuntu "
            "and Debian: apt-get install graphviz), or write a .dot."
        )


def write_graph(diagram: "Diagram", path: Path) -> None:
    """Write a picture of a diagram: its systems, their ports and connections.

    Parameters
    ----------
    diagram : Diagram
    path : pathlib.Path
        Ends in .svg, .png, .pdf or .dot.

    Raises
    ------
    RunError
        If it cannot be made; an existing file then remains unchanged.
    """
    path = Path(path)
    check_graph(path)
    text = diagram.GetGraphvizString(max_depth=_DEPTH, options=_OPTIONS)
    suffix = path.suffix.lower()
    if suffix == ".dot":
        write_text(path, text, RunError)
        return
    try:
        with replaced(path, RunError) as part:
            command = ["dot", f"-T{suffix[1:]}", "-o", str(part)]
            if suffix == ".png":
                command.append(f"-Gdpi={_DOTS_PER_INCH}")
            subprocess.run(
                command, input=text.encode(), capture_output=True, check=True
            )
    except subprocess.CalledProcessError as error:
        message = error.stderr.decode(errors="replace").strip() or error.returncode
        raise RunError(f"dot could not make {path}: {message}.") from None
