"""What happened in a run: re-mappings and disturbances, as marks over time."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from fmp_drake.runs.wiping_run import WipingRun

_LEAST_FORCE = 1e-3  # N, of a disturbance.
_DISTURBED = "#CC79A7"


@dataclass(frozen=True, kw_only=True, eq=False)
class RunEvents:
    """When a run was re-mapped and disturbed.

    Attributes
    ----------
    remaps : ndarray, shape (n,)
        Re-mappings that were due, s.
    reactive : ndarray, shape (m,)
        Re-mappings after a push, s.
    disturbed : ndarray, shape (k, 2)
        Start and end of each disturbance, s.
    """

    remaps: NDArray[np.float64]
    reactive: NDArray[np.float64]
    disturbed: NDArray[np.float64]

    @classmethod
    def of(cls, run: "WipingRun") -> Self:
        """Return the events of a run; disturbances where its scenario has any."""
        time, counts = run.log_times("remaps"), run.log("remaps")
        total, after_push = rises(time, counts[:, 0]), rises(time, counts[:, 1])
        disturbed = np.zeros((0, 2))
        if "disturbance" in run.kept:
            acts = np.linalg.norm(run.log("disturbance"), axis=1) > _LEAST_FORCE
            disturbed = spans(run.log_times("disturbance"), acts)
        return cls(
            remaps=np.setdiff1d(total, after_push),
            reactive=after_push,
            disturbed=disturbed,
        )


def rises(time: NDArray[np.float64], counter: ArrayLike) -> NDArray[np.float64]:
    """Return the times (n,) of the samples at which a counter has risen."""
    return time[1:][np.diff(np.asarray(counter, dtype=float)) > 0]


def spans(time: NDArray[np.float64], on: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return start and end of each run of samples that are on, shape (k, 2)."""
    edges = np.diff(np.concatenate([[False], on, [False]]).astype(int))
    starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return np.column_stack([time[starts], time[ends]])


def draw_events(ax: Axes, events: RunEvents, *, labels: bool = True) -> None:
    """Mark events in axes over time; with labels a legend names each kind once."""
    for i, (start, end) in enumerate(events.disturbed):
        label = "disturbed" if labels and i == 0 else None
        ax.axvspan(start, end, color=_DISTURBED, alpha=0.25, linewidth=0, label=label)
    for times, style, name in (
        (events.remaps, ":", "re-mapped"),
        (events.reactive, "--", "re-mapped after a push"),
    ):
        for i, time in enumerate(times):
            ax.axvline(
                time,
                color="0.45",
                linewidth=0.7,
                linestyle=style,
                zorder=0.9,
                label=name if labels and i == 0 else None,
            )
