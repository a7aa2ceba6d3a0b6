"""Pictures of a learned skill and of its playback."""

from collections.abc import Sequence
from itertools import accumulate, repeat

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull
from scipy.stats import chi2

from fmp_drake.errors import RunError
from fmp_drake.numeric import Array, check_number
from fmp_drake.plots.style import (
    DENSITY_MAP,
    PLAYED,
    SAMPLED,
    TIME_MAP,
    Channels,
    Demonstrations,
    PlanePanel,
    add_colorbar,
    add_lines,
    component_color,
    finish_times,
    legend_above,
    lighten,
    series_style,
    set_title,
    with_unit,
)
from fmp_drake.primitives import FourierMovementPrimitive, PlaybackState, Player
from fmp_drake.primitives.data.reading.table import count_text
from fmp_drake.primitives.data.windows import demonstration_list

_CONFIDENCE = 0.95
_ANGLES = np.linspace(0, 2 * np.pi, 48, endpoint=False)
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_PHASES = np.linspace(0, 2 * np.pi, 241)
_HEATMAP_SAMPLES = 1000
_CELLS = 60  # Of a heatmap, along its longer side.
# Percentile of the positive densities at the end of the colour scale.
_SCALE_PERCENTILE = 99
_SUBSTEPS = 4  # Points per step of a path, for the cells between two samples.
_MAX_NUMBERS = 40
_LUMA = (0.299, 0.587, 0.114)  # Weights of red, green and blue (ITU-R BT.601).


def draw_samples_in_plane(
    skill: FourierMovementPrimitive,
    *,
    n: int = 20,
    seed: int = 0,
    demonstrations: Demonstrations = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw windows sampled from a skill, over its demonstrations (Fig. 7).

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    n, seed : int
        Number of samples, without the isotropic noise, and their seed.
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey in the background.
    ax : Axes, optional
        Axes of a new figure if None.
    """
    check_number(n, "n", least=1, whole=True, error=RunError)
    panel = PlanePanel(Channels.of_skill(skill), ax)
    panel.background(demonstrations)
    for sample in skill.sample(n, seed=seed, with_noise=False):
        panel.path(sample, color=SAMPLED, linewidth=0.8, alpha=0.8)
    return panel.finish(f"{n} samples of {skill.n_steps / skill.rate:g} s")


def draw_component_over_time(
    skill: FourierMovementPrimitive, component: int, axes: Sequence[Axes]
) -> tuple[Axes, ...]:
    """Draw the mean of a component over time, with a band of 2 standard deviations.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    component : int
        Index; the components of a mixture are sorted by proportion, the largest first.
    axes : sequence of Axes
        One for each channel.
    """
    labels = Channels.of_skill(skill).labels
    mean, covariances = _moments(skill, component)
    color = component_color(component)
    time = np.arange(skill.n_steps) / skill.rate
    for i, ax in enumerate(axes):
        draw_band(ax, time, mean[:, i], covariances[:, i, i], color)
        ax.plot(time, mean[:, i], color=color, linewidth=1.6, label="mean")
    percent = 100 * skill.proportions_[component]
    title = f"component {component} ({percent:.0f} % of the windows)"
    return finish_times(axes, labels, title=title, xlabel="time in the window (s)")


def draw_band(
    ax: Axes,
    time: Array,
    mean: Array,
    variance: Array,
    color: str,
) -> None:
    """Draw a band of 2 standard deviations about a mean over time, each (N,)."""
    deviation = 2 * np.sqrt(variance)
    ax.fill_between(
        time,
        mean - deviation,
        mean + deviation,
        color=lighten(color, 0.7),
        linewidth=0,
        label="2 standard deviations",
    )


def draw_component_in_plane(
    skill: FourierMovementPrimitive,
    component: int,
    ax: Axes,
    *,
    demonstrations: Demonstrations = (),
) -> Axes:
    """Draw the mean of a component and the tube of its confidence ellipses.

    At every step of the window the tube contains 95 % of the component. The outlines are
    ellipses at twelve steps; the dot is the start.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    component : int
        Index; the components of a mixture are sorted by proportion, the largest first.
    ax : Axes
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey.
    """
    panel = PlanePanel(Channels.of_skill(skill), ax)
    mean, covariances = _moments(skill, component)
    centres = mean[:, [1, 0]]
    roots = np.linalg.cholesky(covariances[:, [[1], [0]], [1, 0]])
    roots *= np.sqrt(chi2.ppf(_CONFIDENCE, 2))
    ellipses = centres[:, None] + _CIRCLE @ np.swapaxes(roots, 1, 2)
    pairs = np.concatenate([ellipses[:-1], ellipses[1:]], axis=1)
    color = component_color(component)
    fill = lighten(color, 0.75)
    tube = PolyCollection(
        [points[ConvexHull(points).vertices] for points in pairs],
        facecolor=fill,
        edgecolor=fill,
        linewidth=0.5,
        zorder=1.0,
        label=f"{100 * _CONFIDENCE:g} %",
    )
    panel.ax.add_collection(tube)
    panel.background(demonstrations)
    outlines = PolyCollection(
        list(ellipses[:: max(1, round(skill.n_steps / 12))]),
        facecolor="none",
        edgecolor=lighten(color, 0.35),
        linewidth=0.6,
        zorder=2.0,
    )
    panel.ax.add_collection(outlines)
    panel.ax.plot(*centres.T, color=color, linewidth=1.6, label="mean", zorder=3.0)
    panel.ax.plot(*centres[:1].T, "o", color=color, markersize=5, zorder=3.0)
    percent = 100 * skill.proportions_[component]
    return panel.finish(
        f"component {component} ({percent:.0f} %):\nmean, {100 * _CONFIDENCE:g} % tube"
    )


def _moments(skill: FourierMovementPrimitive, component: int) -> tuple[Array, Array]:
    """Return mean (T, D) and covariance (T, D, D) of a component at every step."""
    mean = skill.synthesize(skill.components_[component].mean)
    covariances = [skill.covariance(component, t) for t in range(skill.n_steps)]
    return mean, np.stack(covariances)


def draw_heatmaps(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    axes: Sequence[Axes],
) -> None:
    """Draw heatmaps of demonstrations and samples: how often positions are visited (Fig. 8).

    Both have the same grid and colour scale.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    demonstrations : Demonstration or sequence of Demonstration
    axes : sequence of two Axes
    """
    recordings = demonstration_list(demonstrations, "a picture")
    channels = Channels.of_skill(skill)
    Channels.of_demonstrations(recordings)
    channels.check(recordings)
    samples = skill.sample(_HEATMAP_SAMPLES, seed=0, with_noise=False)
    sample_extent = np.percentile(samples, [0.1, 99.9], axis=(0, 1))
    points = np.concatenate([*(d.values for d in recordings), sample_extent])[:, :2]
    vertical, horizontal = channels.units[:2]
    edges = grid_edges(points, square=vertical == horizontal)
    densities = {
        "visited in the demonstrations": density(
            [d.values for d in recordings],
            [np.diff(d.time) for d in recordings],
            edges,
        ),
        f"visited in {_HEATMAP_SAMPLES} samples": density(
            list(samples), [np.ones(skill.n_steps - 1)] * _HEATMAP_SAMPLES, edges
        ),
    }
    largest = max(
        np.percentile(d[d > 0], _SCALE_PERCENTILE) for d in densities.values()
    )
    for ax, (title, values) in zip(axes, densities.items(), strict=True):
        panel = PlanePanel(channels, ax)
        mesh = ax.pcolormesh(
            edges[1],
            edges[0],
            np.ma.masked_equal(values, 0),
            cmap=DENSITY_MAP,
            vmin=0,
            vmax=largest,
            rasterized=True,
        )
        panel.finish(title)
    unit = f"{vertical}²" if vertical == horizontal else f"({vertical} {horizontal})"
    add_colorbar(axes[1], mesh, f"density (1/{unit})", extend="max")


def density(
    paths: Sequence[Array],
    steps: Sequence[Array],
    edges: Sequence[Array],
) -> Array:
    """Return the density of positions over the cells of a grid.

    Parameters
    ----------
    paths : sequence of ndarray, shape (N, D)
    steps : sequence of ndarray, shape (N - 1,)
        Durations of the steps of each path.
    edges : sequence of two ndarray
        Ascending edges of the cells along the first and the second channel.

    Returns
    -------
    ndarray, shape (rows, columns)
    """
    points = np.concatenate([_interpolate(path) for path in paths])
    weights = np.repeat(np.concatenate(steps), _SUBSTEPS)
    counts, *_ = np.histogram2d(points[:, 0], points[:, 1], bins=edges, weights=weights)
    area = np.diff(edges[0])[0] * np.diff(edges[1])[0]
    result: Array = counts / (np.sum(weights) * area)
    return result


def grid_edges(points: Array, *, square: bool) -> tuple[Array, Array]:
    """Return the edges of the cells of a grid around points (N, 2), with a small margin.

    There are 60 cells along both sides, or square cells with 60 along the longer side.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.03 * np.maximum(high - low, 1e-6)
    low, widths = low - margin, high - low + 2 * margin
    cell = (np.full(2, widths.max()) if square else widths) / _CELLS
    counts = np.ceil(widths / cell - 1e-9).astype(int)
    rows, columns = (low[i] + cell[i] * np.arange(counts[i] + 1) for i in range(2))
    return rows, columns


def _interpolate(path: Array) -> Array:
    """Return interpolated points of a path (N, D), `_SUBSTEPS` for each step: (.., D)."""
    ratio = (np.arange(_SUBSTEPS) / _SUBSTEPS)[:, None]
    points = path[:-1, None] * (1 - ratio) + path[1:, None] * ratio
    return points.reshape(-1, path.shape[1])


def draw_phase(
    skill: FourierMovementPrimitive,
    axes: Sequence[Axes],
    *,
    demonstrations: Demonstrations = (),
) -> None:
    """Draw a phase model in three pictures.

    The first shows the mean cycle, coloured by the phase, or over the phase for a skill of
    one channel. The second shows tempo and size of each demonstrated cycle, and the third
    the standard deviation of the residual over the phase.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted, with a phase model.
    axes : sequence of three Axes
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey behind the cycle.
    """
    model = skill.phase_model_
    if model is None:
        raise RunError(f"the skill has no phase model: {skill.model_reason_}.")
    channels = Channels.of_skill(skill)
    cycle_axes, tempo_axes, residual_axes = axes
    cycle = model.cycle.values(_PHASES) * skill.scales_
    if len(channels.names) > 1:
        panel = PlanePanel(channels, cycle_axes)
        panel.background(demonstrations)
        points = cycle[:, [1, 0]]
        segments = np.stack([points[:-1], points[1:]], axis=1)
        cmap = matplotlib.colormaps["twilight"]
        style = {"cmap": cmap, "linewidth": 2.5, "zorder": 3.0}
        line = add_lines(cycle_axes, segments, _PHASES[:-1], **style)
        panel.finish("mean cycle")
        add_colorbar(cycle_axes, line, "phase (rad)")
    else:
        cycle_axes.plot(_PHASES, cycle[:, 0], color=PLAYED)
        cycle_axes.set(xlabel="phase (rad)", ylabel=channels.labels[0])
        set_title(cycle_axes, "mean cycle")
    cycle_numbers = np.arange(1, model.cycles + 1)
    tempo_axes.plot(
        cycle_numbers, 100 * skill.tempos_, ".-", color=PLAYED, label="tempo"
    )
    tempo_axes.plot(
        cycle_numbers, 100 * skill.amplitudes_, ".-", color=SAMPLED, label="size"
    )
    tempo_axes.set(xlabel="demonstrated cycle", ylabel="of the mean (%)")
    tempo_axes.locator_params(axis="x", integer=True)
    tempo_axes.set_xlim(0.5, model.cycles + 0.5)
    tempo_axes.legend(frameon=False)
    cycles = count_text(model.cycles, "cycle")
    set_title(tempo_axes, f"{cycles} of {skill.period_:.2f} s")
    factor = model.residual.factor(_PHASES) * skill.scales_[:, None]
    spread = np.sqrt(np.sum(factor**2, axis=2))
    unit = channels.units[0]
    if len(set(channels.units)) > 1:
        unit = "% of the range"
        spread *= 100 / channels.ranges(skill.extent_)
    for i, name in enumerate(channels.short_names):
        residual_axes.plot(_PHASES, spread[:, i], **series_style(i), label=name)
    ylabel = with_unit("standard deviation", unit)
    residual_axes.set(xlabel="phase (rad)", ylabel=ylabel)
    residual_axes.set_ylim(bottom=0)
    rows = legend_above(residual_axes)
    set_title(residual_axes, "residual of the cycle" + rows * "\n")


def draw_rollout_in_plane(
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
    values = player.rollout(start, duration)[..., 0, :]
    values = values.reshape(-1, *values.shape[-2:])
    points = values[..., [1, 0]]
    panel.background(demonstrations)
    segments = np.stack([points[:, :-1], points[:, 1:]], axis=2)
    time = np.tile(np.arange(segments.shape[1]) * player.tick_seconds, len(segments))
    style = {"cmap": TIME_MAP, "linewidths": 1.5, "zorder": 3.0}
    lines = add_lines(panel.ax, segments.reshape(-1, 2, 2), time, **style)
    lines.set_clim(0, duration)
    panel.starts(values[:, 0])
    add_colorbar(panel.ax, lines, "time (s)")
    return panel.finish(f"played for {duration:g} s\nfrom the ring")


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
    labels = [*Channels.of_skill(player.skill).labels, "component"]
    _check_duration(player, duration)
    # As `Player.rollout`, with the state at every tick.
    ticks = int(np.floor(duration * player.skill.rate * (1 + 1e-9)))
    steps = repeat(player.tick_seconds, ticks)
    states = list(accumulate(steps, player.advance, initial=player.start(start)))
    time = player.tick_seconds * np.arange(len(states), dtype=np.float64)
    values = np.stack([player.motion(state)[0] for state in states])
    covariances = np.stack([player.covariance(state) for state in states])
    instants = time[1:][np.diff([state.remaps for state in states]) > 0]
    *panels, strip = axes
    for i, ax in enumerate(panels):
        draw_band(ax, time, values[:, i], covariances[:, i, i], PLAYED)
        ax.plot(time, values[:, i], color=PLAYED, linewidth=1.2, label="played")
        for instant in instants:
            ax.axvline(
                instant, color="0.3", linewidth=0.8, linestyle=":", label="re-mapped"
            )
    _draw_strip(strip, states, np.concatenate([[0.0], instants, time[-1:]]))
    axes[0].set_xlim(0, time[-1])
    finish_times(axes, labels, title="played")
    strip.yaxis.label.set(rotation=0, ha="right", va="center", size="small")
    return tuple(axes)


def _draw_strip(ax: Axes, states: Sequence[PlaybackState], ends: Array) -> None:
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
