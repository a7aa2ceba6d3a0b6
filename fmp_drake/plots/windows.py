"""Windows: what a skill is learned from."""

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from numpy.typing import ArrayLike, NDArray

from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.panels import PlanePanel, TimePanels
from fmp_drake.plots.style import add_colorbar, add_lines, component_color
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.data.windows import as_windows

_MOST = 60  # More windows could not be told apart.


def draw_windows_over_time(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    *,
    channels: Sequence[str] | None = None,
    axes: Axes | Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw the windows that a skill learns from, one over the other.

    At most 60, evenly chosen, each in the colour of its most probable component.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted: its parameters are those of the windows.
    demonstrations : Demonstration or sequence of Demonstration
    channels : sequence of str, optional
        The channels to draw; all where None.
    axes : sequence of Axes, optional
        One for each channel.

    Returns
    -------
    tuple of Axes
    """
    panels = TimePanels(Channels.of_skill(skill), channels, axes)
    windows, title = _shown(skill, demonstrations)
    time = np.arange(skill.n_steps) / skill.rate
    lines = [
        np.stack(np.broadcast_arrays(time, windows[..., i]), -1) for _, i in panels
    ]
    _draw(skill, windows, zip((ax for ax, _ in panels), lines, strict=True))
    return panels.finish(title, xlabel="time in the window (s)")


def draw_windows_in_plane(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    *,
    plane: Sequence[str] | None = None,
    colorbar: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the windows that a skill learns from in the plane (Fig. 3b).

    At most 60, evenly chosen, each in the colour of its most probable component.

    Parameters
    ----------
    skill, demonstrations
        As for `draw_windows_over_time`.
    plane, ax
        As for `draw_demonstrations_in_plane`.
    colorbar : bool
    """
    panel = PlanePanel(Channels.of_skill(skill), plane, ax)
    windows, title = _shown(skill, demonstrations)
    up, left = panel.plane
    lines = [(panel.ax, windows[:, :, [left, up]])]
    _draw(skill, windows, lines, colorbar=colorbar)
    return panel.finish(title)


def cut_windows(
    skill: FourierMovementPrimitive, demonstrations: Sequence[Demonstration]
) -> NDArray[np.float64]:
    """Return the windows (N, T, D) that a skill would learn from demonstrations."""
    Channels.of_skill(skill).check(demonstrations)
    return as_windows(
        demonstrations,
        n_steps=skill.n_steps,
        stride=skill.window_stride,
        rate=skill.rate,
        at_least=1,
    ).values


def _shown(
    skill: FourierMovementPrimitive, demonstrations: Demonstrations
) -> tuple[NDArray[np.float64], str]:
    """Return the windows to draw and the title."""
    windows = cut_windows(skill, as_list(demonstrations))
    count, seconds = len(windows), skill.n_steps / skill.rate
    title = f"{count} windows of {seconds:g} s"
    if count > _MOST:
        title = f"{_MOST} of {title}"
        windows = windows[np.linspace(0, count - 1, _MOST).round().astype(int)]
    return windows, title


def _draw(
    skill: FourierMovementPrimitive,
    windows: NDArray[np.float64],
    pictures: Iterable[tuple[Axes, ArrayLike]],
    *,
    colorbar: bool = True,
) -> None:
    """Draw lines (N, T, 2) for windows (N, T, D) into each of several axes."""
    weights = skill.analyze(windows)
    densities = np.stack([c.log_density(weights) for c in skill.components_], axis=-1)
    numbers = np.argmax(densities + np.log(skill.proportions_), axis=-1)
    m = len(skill.components_)
    cmap = ListedColormap([component_color(j) for j in range(m)])
    norm = BoundaryNorm(np.arange(m + 1) - 0.5, m)
    style = {"cmap": cmap, "norm": norm, "linewidths": 0.7, "alpha": 0.8}
    drawn = list(pictures)
    for ax, lines in drawn:
        add_lines(ax, lines, numbers, **style)
    if colorbar:
        axes = [ax for ax, _ in drawn]
        add_colorbar(
            axes if len(axes) > 1 else axes[0],
            ScalarMappable(cmap=cmap, norm=norm),
            "component",
            ticks=range(0, m, max(1, m // 10)),
        )
