"""Recordings as they are: over time and in the plane (Fig. 3)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.panels import PlanePanel, TimePanels
from fmp_drake.plots.style import save
from fmp_drake.primitives import Demonstration


def plot_demonstrations(demonstrations: Demonstrations, path: Path) -> None:
    """Write a picture of recordings, over time and in the plane (.png, .pdf, .svg)."""
    shown = as_list(demonstrations)
    count = len(Channels.of_demonstrations(shown).names)
    figure = Figure(figsize=(12, max(4.0, 1 + 1.3 * count)), layout="constrained")
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=[2, 1])[0]
    rows = left.subplots(count, squeeze=False, sharex=True)[:, 0]
    draw_demonstrations_over_time(shown, axes=rows)
    if count > 1:
        draw_demonstrations_in_plane(shown, ax=right.subplots())
    save(figure, path)


def draw_demonstrations_over_time(
    demonstrations: Demonstrations,
    *,
    channels: Sequence[str] | None = None,
    axes: Axes | Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw every channel of recordings over time (Fig. 3a).

    Parameters
    ----------
    demonstrations : Demonstration or sequence of Demonstration
    channels : sequence of str, optional
        The channels to draw; all where None.
    axes : sequence of Axes, optional
        One for each channel.

    Returns
    -------
    tuple of Axes
    """
    shown = as_list(demonstrations)
    panels = TimePanels(Channels.of_demonstrations(shown), channels, axes)
    for ax, i in panels:
        for one, grey in zip(shown, _greys(len(shown)), strict=True):
            ax.plot(one.time, one.values[:, i], color=grey, linewidth=0.8)
    return panels.finish(_demonstrated(shown))


def draw_demonstrations_in_plane(
    demonstrations: Demonstrations,
    *,
    plane: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the paths of recordings in the plane (Fig. 3b).

    Parameters
    ----------
    demonstrations : Demonstration or sequence of Demonstration
    plane : sequence of two str, optional
        The upward channel and the one to the left; the first two where None.
    ax : Axes, optional
    """
    shown = as_list(demonstrations)
    panel = PlanePanel(Channels.of_demonstrations(shown), plane, ax)
    for one, grey in zip(shown, _greys(len(shown)), strict=True):
        panel.path(one.values, color=grey, linewidth=0.6)
    return panel.finish(_demonstrated(shown))


def _greys(count: int) -> list[str]:
    """Return a grey for each of several recordings."""
    if count == 1:
        return ["0.45"]
    return [f"{grey:.2f}" for grey in np.linspace(0.3, 0.75, count)]


def _demonstrated(demonstrations: Sequence[Demonstration]) -> str:
    seconds = sum(d.duration for d in demonstrations)
    if len(demonstrations) == 1:
        return f"demonstrated: {seconds:.0f} s"
    return f"demonstrated: {len(demonstrations)} recordings, {seconds:.0f} s"
