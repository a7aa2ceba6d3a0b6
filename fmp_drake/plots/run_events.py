"""What happened in a run: re-mappings, disturbances, faults, as marks over time."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

if TYPE_CHECKING:
    from fmp_drake.runs.wiping_run import WipingRun

_LEAST_FORCE = 1e-3  # N, of a disturbance.
_DISTURBED = "#CC79A7"
_WRONG = "#D55E00"


def draw_events(ax: Axes, run: "WipingRun") -> None:
    """Mark the re-mappings and the disturbances of a run in axes over time.

    Dotted lines are re-mappings that were due, dashed ones those after a push, and
    shaded times are those of a disturbance, or of what went wrong.
    """
    time, counts = run.log_times("remaps"), run.log("remaps")
    total, after_push = (time[1:][risen] for risen in np.diff(counts, axis=0).T > 0)
    for times, style, label in (
        (np.setdiff1d(total, after_push), ":", "re-mapped"),
        (after_push, "--", "re-mapped after a push"),
    ):
        for at in times:
            ax.axvline(
                at,
                color="0.45",
                linewidth=0.7,
                linestyle=style,
                zorder=0.9,
                label=label,
            )
    for start, end, kind, _ in run.events():
        if not kind.startswith("board"):
            ax.axvspan(start, end, color=_WRONG, alpha=0.15, linewidth=1, label=kind)
    if "disturbance" not in run.kept:
        return
    disturbed = np.linalg.norm(run.log("disturbance"), axis=1) > _LEAST_FORCE
    if np.any(disturbed):
        ax.fill_between(
            run.log_times("disturbance"),
            0,
            1,
            where=disturbed,
            transform=ax.get_xaxis_transform(),
            color=_DISTURBED,
            alpha=0.25,
            linewidth=0,
            label="disturbed",
        )
