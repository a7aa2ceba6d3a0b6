"""Windows: what a skill is learned from."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from numpy.typing import NDArray

from fmp_drake.errors import SkillError
from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.style import (
    TIME_MAP,
    add_colorbar,
    add_lines,
    component_color,
    finish_plane,
    finish_times,
    plane_axes,
    set_title,
    time_axes,
)
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.data.windows import demonstration_windows, sliding_windows

type ColorBy = Literal["start", "component"]


class _Coloring(NamedTuple):
    """A number for each window, how numbers are coloured, and what they mean."""

    numbers: NDArray[np.float64]
    cmap: Colormap
    norm: Normalize
    label: str
    ticks: list[float] | None


def draw_windows_over_time(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    *,
    color_by: ColorBy = "component",
    channels: Sequence[str] | None = None,
    most: int = 60,
    colorbar: bool = True,
    axes: Axes | Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw the windows that a skill learns from, one over the other.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted: it says how long the windows are.
    demonstrations : Demonstration or sequence of Demonstration
    color_by : {"component", "start"}
        Its most probable component, or when it starts in its recording.
    most : int
        Not more windows are drawn, evenly chosen: else nothing could be seen.
    channels : sequence of str, optional
        The channels to draw; all where None.
    colorbar : bool
    axes : sequence of Axes, optional
        One for each channel.

    Returns
    -------
    tuple of Axes
    """
    names = Channels.of_skill(skill)
    windows, starts = cut_windows(skill, as_list(demonstrations), names)
    indices = names.indices(channels)
    made = time_axes(axes, names, len(indices))
    shown = _evenly(len(windows), most)
    coloring = _coloring(skill, windows[shown], starts[shown], color_by)
    time = np.arange(skill.n_steps) / skill.rate
    for ax, i in zip(made, indices, strict=True):
        lines = np.stack(np.broadcast_arrays(time, windows[shown, :, i]), axis=-1)
        add_lines(
            ax,
            lines,
            coloring.numbers,
            cmap=coloring.cmap,
            norm=coloring.norm,
            linewidths=0.7,
            alpha=0.8,
        )
    if colorbar:
        _add_colorbar(made, coloring)
    set_title(made[0], _windowed(skill, len(windows), len(shown)))
    labels = [names.label(i) for i in indices]
    finish_times(made, labels, xlabel="time in the window (s)")
    return made


def draw_windows_in_plane(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    *,
    color_by: ColorBy = "component",
    plane: Sequence[str] | None = None,
    most: int = 60,
    colorbar: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the windows that a skill learns from in the plane (Fig. 3b).

    Parameters
    ----------
    skill, demonstrations, color_by, most, colorbar
        As for `draw_windows_over_time`.
    plane, ax
        As for `draw_demonstrations_in_plane`.
    """
    names = Channels.of_skill(skill)
    up, left = names.plane(plane)
    windows, starts = cut_windows(skill, as_list(demonstrations), names)
    fit = ax is None
    ax = plane_axes(ax)
    shown = _evenly(len(windows), most)
    coloring = _coloring(skill, windows[shown], starts[shown], color_by)
    add_lines(
        ax,
        windows[shown][:, :, [left, up]],
        coloring.numbers,
        cmap=coloring.cmap,
        norm=coloring.norm,
        linewidths=0.6,
        alpha=0.8,
    )
    if colorbar:
        _add_colorbar(ax, coloring)
    set_title(ax, _windowed(skill, len(windows), len(shown)))
    finish_plane(ax, names, (up, left), fit=fit)
    return ax


def cut_windows(
    skill: FourierMovementPrimitive,
    demonstrations: Sequence[Demonstration],
    names: Channels,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return windows (N, T, D) and the start of each in its recording, s, (N,)."""
    names.check(demonstrations)
    n_steps, stride, rate = skill.n_steps, skill.window_stride, skill.rate
    windows = demonstration_windows(
        demonstrations, n_steps=n_steps, stride=stride, rate=rate, at_least=1
    )
    times = [d.resample(rate).time[:, None] for d in demonstrations]
    starts = [
        sliding_windows(t - t[0], n_steps=n_steps, stride=stride)[:, 0, 0]
        for t in times
    ]
    return windows, np.concatenate(starts)


def _coloring(
    skill: FourierMovementPrimitive,
    windows: NDArray[np.float64],
    starts: NDArray[np.float64],
    color_by: ColorBy,
) -> _Coloring:
    """Give every window a number, and the numbers colours."""
    if color_by == "start":
        norm = Normalize(0.0, max(float(starts.max()), 1e-9))
        return _Coloring(starts, TIME_MAP, norm, "start of the window (s)", None)
    if color_by != "component":
        raise SkillError(f"color_by is {color_by!r}; choose 'start' or 'component'.")
    weights = skill.analyze(windows)
    densities = np.stack([c.log_density(weights) for c in skill.components_], axis=-1)
    numbers = np.argmax(densities + np.log(skill.proportions_), axis=-1).astype(float)
    m = len(skill.components_)
    return _Coloring(
        numbers,
        ListedColormap([component_color(j) for j in range(m)]),
        BoundaryNorm(np.arange(m + 1) - 0.5, m),
        "component",
        list(range(0, m, max(1, m // 10))),
    )


def _add_colorbar(axes: Axes | Sequence[Axes], coloring: _Coloring) -> None:
    mappable = ScalarMappable(cmap=coloring.cmap, norm=coloring.norm)
    add_colorbar(axes, mappable, coloring.label, ticks=coloring.ticks)


def _evenly(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` of `count` indices."""
    if most < 1:
        raise SkillError(f"most is {most}; at least 1 window must be drawn.")
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _windowed(skill: FourierMovementPrimitive, count: int, shown: int) -> str:
    part = "" if shown == count else f"{shown} of "
    return f"{part}{count} windows of {skill.n_steps / skill.rate:g} s"
