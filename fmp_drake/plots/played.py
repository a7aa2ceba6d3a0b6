"""Pictures of a playback, in the plane and over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number
from fmp_drake.plots.learned import draw_band
from fmp_drake.plots.panels import Channels, Demonstrations, PlanePanel, TimePanels
from fmp_drake.plots.style import (
    PLAYED,
    TIME_MAP,
    add_colorbar,
    add_lines,
    component_color,
)
from fmp_drake.primitives import PlaybackState, Player

_MAX_NUMBERS = 40
_LUMA = (0.299, 0.587, 0.114)  # Weights of red, green and blue (ITU-R BT.601).


def draw_way_back(
    player: Player,
    start: ArrayLike,
    *,
    duration: float = 10.0,
    demonstrations: Demonstrations = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw the playback from a start, coloured by time (Figs. 4, 9 and 10).

    Parameters
    ----------
    player : Player
    start : array_like, shape (D,) or (S, D)
        One or several starts, each marked by a ring.
    duration : float
        Seconds.
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey in the background.
    ax : Axes, optional
        Axes of a new figure if None.
    """
    panel = PlanePanel(Channels.of_skill(player.skill), ax)
    _check_duration(player, duration)
    points = player.rollout(start, duration)[..., 0, [1, 0]]
    points = points.reshape(-1, *points.shape[-2:])
    panel.background(demonstrations)
    segments = np.stack([points[:, :-1], points[:, 1:]], axis=2)
    time = np.tile(np.arange(segments.shape[1]) * player.tick_seconds, len(segments))
    style = {"cmap": TIME_MAP, "linewidths": 1.5, "zorder": 3.0}
    lines = add_lines(panel.ax, segments.reshape(-1, 2, 2), time, **style)
    lines.set_clim(0, duration)
    panel.ax.plot(
        *points[:, 0].T,
        "o",
        markerfacecolor="white",
        markeredgecolor=PLAYED,
        markeredgewidth=2.0,
        markersize=8,
        label="start",
        zorder=4.0,
    )
    add_colorbar(panel.ax, lines, "time (s)")
    return panel.finish(f"played for {duration:g} s from the ring")


def draw_rollout_over_time(
    player: Player,
    start: ArrayLike,
    axes: Sequence[Axes],
    *,
    duration: float = 30.0,
) -> tuple[Axes, ...]:
    """Draw the playback over time, and a strip of the tracked components below it.

    Dotted lines are the instants of re-mapping. The band is 2 standard deviations of the
    tracked component (18).

    Parameters
    ----------
    player : Player
    start : array_like, shape (D,)
    axes : sequence of Axes
        One for each channel, then one for the strip.
    duration : float
        Seconds.
    """
    panels = TimePanels(Channels.of_skill(player.skill), axes)
    _check_duration(player, duration)
    states = _play(player, start, duration)
    time = player.tick_seconds * np.arange(len(states), dtype=np.float64)
    values = np.stack([player.motion(state)[0] for state in states])
    covariances = np.stack([player.covariance(state) for state in states])
    instants = time[1:][np.diff([state.remaps for state in states]) > 0]
    for ax, i in panels:
        draw_band(ax, time, values[:, i], covariances[:, i, i], PLAYED)
        ax.plot(time, values[:, i], color=PLAYED, linewidth=1.2, label="played")
        for instant in instants:
            ax.axvline(
                instant, color="0.3", linewidth=0.8, linestyle=":", label="re-mapped"
            )
    strip = axes[-1]
    _draw_strip(strip, states, np.concatenate([[0.0], instants, time[-1:]]))
    axes[0].set_xlim(0, time[-1])
    panels.finish("played", strip="component")
    strip.yaxis.label.set(rotation=0, ha="right", va="center", size="small")
    return tuple(axes)


def _play(player: Player, start: ArrayLike, duration: float) -> list[PlaybackState]:
    """Return the state at every tick of `Player.rollout`."""
    state = player.start(start)
    states = [state]
    for _ in range(int(np.floor(duration * player.skill.rate * (1 + 1e-9)))):
        state = player.advance(state, player.tick_seconds)
        states.append(state)
    return states


def _draw_strip(
    ax: Axes, states: Sequence[PlaybackState], ends: NDArray[np.float64]
) -> None:
    """Draw a coloured, numbered box for each window."""
    components: dict[int, int] = {}
    for state in states:
        components.setdefault(state.remaps, state.component)
    for left, right, component in zip(
        ends[:-1], ends[1:], components.values(), strict=True
    ):
        color = component_color(component)
        ax.add_patch(
            Rectangle(
                (left, 0.0), right - left, 1.0, facecolor=color, edgecolor="white"
            )
        )
        if len(components) <= _MAX_NUMBERS and right > left:
            ax.text(
                (left + right) / 2,
                0.5,
                str(component),
                color="white" if np.dot(to_rgb(color), _LUMA) < 0.6 else "black",
                ha="center",
                va="center",
                fontsize="small",
                clip_on=True,
            )
    ax.set_xlim(0, ends[-1])
    ax.set_ylim(0, 1)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)


def _check_duration(player: Player, duration: float) -> None:
    check_number(
        duration, "duration", least=player.tick_seconds, unit="s", error=RunError
    )
