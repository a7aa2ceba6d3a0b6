"""Pictures of what is played: the way back to the skill, and a rollout over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.style import (
    PLAYED,
    TIME_MAP,
    add_colorbar,
    add_lines,
    component_color,
    draw_grey_paths,
    finish_plane,
    finish_times,
    legend_above,
    lighten,
    plane_axes,
    set_title,
    time_axes,
)
from fmp_drake.primitives import PlaybackState, Player

_MOST_NUMBERS = 40
_LUMA = (0.299, 0.587, 0.114)


def draw_way_back(
    player: Player,
    start: ArrayLike,
    *,
    duration: float = 10.0,
    demonstrations: Demonstrations = (),
    plane: Sequence[str] | None = None,
    colorbar: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw what is played from a start, coloured by time (Figs. 4, 9 and 10).

    Parameters
    ----------
    player : Player
    start : array_like, shape (D,) or (S, D)
        One or several, each marked by a ring.
    duration : float
        Seconds.
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey behind.
    plane : sequence of two str, optional
        The upward channel and the one to the left; the first two where None.
    colorbar : bool
    ax : Axes, optional
    """
    names = Channels.of_skill(player.skill)
    up, left = names.plane(plane)
    recorded = as_list(demonstrations)
    names.check(recorded)
    played = player.rollout(start, _checked(player, duration))
    points = played[..., 0, [left, up]]
    points = points.reshape(-1, *points.shape[-2:])
    fit = ax is None
    ax = plane_axes(ax)
    draw_grey_paths(ax, [d.values for d in recorded], (up, left))
    pieces = np.stack([points[:, :-1], points[:, 1:]], axis=2)
    time = np.tile(np.arange(pieces.shape[1]) * player.tick_seconds, len(pieces))
    lines = add_lines(
        ax, pieces.reshape(-1, 2, 2), time, cmap=TIME_MAP, linewidths=1.5, zorder=3.0
    )
    lines.set_clim(0, duration)
    ax.plot(
        *points[:, 0].T,
        "o",
        markerfacecolor="white",
        markeredgecolor=PLAYED,
        markeredgewidth=2.0,
        markersize=8,
        label="start",
        zorder=4.0,
    )
    if colorbar:
        add_colorbar(ax, lines, "time (s)")
    set_title(ax, f"played for {duration:g} s from the ring")
    finish_plane(ax, names, (up, left), fit=fit)
    return ax


def draw_rollout_over_time(
    player: Player,
    start: ArrayLike,
    *,
    duration: float = 30.0,
    channels: Sequence[str] | None = None,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw what is played over time, and the component it tracks as a strip below.

    Dotted lines are the re-mapping instants; the band is 2 standard deviations of
    the tracked component (18).

    Parameters
    ----------
    player : Player
    start : array_like, shape (D,)
    duration : float
        Seconds.
    channels : sequence of str, optional
        The channels to draw; all where None.
    axes : sequence of Axes, optional
        One for each channel, then one for the strip.

    Returns
    -------
    tuple of Axes
        The strip is the last.
    """
    names = Channels.of_skill(player.skill)
    indices = names.indices(channels)
    states = _play(player, start, _checked(player, duration))
    made = time_axes(axes, names, len(indices), strip=True)
    time = player.tick_seconds * np.arange(len(states), dtype=np.float64)
    values = np.stack([player.motion(state)[0] for state in states])
    spread = 2 * np.sqrt(
        np.stack([np.diagonal(player.covariance(state)) for state in states])
    )
    instants = _remap_instants(states, time)
    for ax, i in zip(made[:-1], indices, strict=True):
        ax.fill_between(
            time,
            values[:, i] - spread[:, i],
            values[:, i] + spread[:, i],
            color=lighten(PLAYED, 0.75),
            linewidth=0,
            label="2 standard deviations",
        )
        ax.plot(time, values[:, i], color=PLAYED, linewidth=1.2, label="played")
        for number, instant in enumerate(instants):
            ax.axvline(
                instant,
                color="0.3",
                linewidth=0.8,
                linestyle=":",
                label="re-mapped" if number == 0 else None,
            )
    set_title(made[0], "played")
    legend_above(made[0])
    _draw_strip(made[-1], states, np.concatenate([[0.0], instants, time[-1:]]))
    made[0].set_xlim(0, time[-1])
    finish_times(made, [*(names.label(i) for i in indices), "component"])
    made[-1].yaxis.label.set(rotation=0, ha="right", va="center", size="small")
    return made


def _play(player: Player, start: ArrayLike, duration: float) -> list[PlaybackState]:
    """Return the state at every tick, as `Player.rollout` goes through them."""
    state = player.start(start)
    states = [state]
    for _ in range(int(np.floor(duration * player.skill.rate * (1 + 1e-9)))):
        state = player.advance(state, player.tick_seconds)
        states.append(state)
    return states


def _remap_instants(
    states: Sequence[PlaybackState], time: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the times at which a new window began."""
    count = np.array([state.remaps for state in states])
    out: NDArray[np.float64] = time[1:][np.diff(count) > 0]
    return out


def _draw_strip(
    ax: Axes, states: Sequence[PlaybackState], ends: NDArray[np.float64]
) -> None:
    """Draw a coloured, numbered box for every window."""
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
        if len(components) <= _MOST_NUMBERS and right > left:
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


def _checked(player: Player, duration: float) -> float:
    if not (np.isfinite(duration) and duration >= player.tick_seconds):
        raise SkillError(
            f"duration is {duration} s; it must be at least one tick, "
            f"{player.tick_seconds:g} s."
        )
    return duration
