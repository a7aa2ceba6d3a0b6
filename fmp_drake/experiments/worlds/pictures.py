"""Pictures of how many worlds went well, and where the others are."""

from collections.abc import Mapping, Sequence
from math import ceil, sqrt
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmp_drake.numeric import is_number
from fmp_drake.plots.style import DEMONSTRATED, PLAYED, SAMPLED, legend_above, set_title

# Standard deviations of a 95 % interval, and bins of a parameter.
_Z, _BINS = 1.96, 6
_COLUMNS = 4


def interval(good: int, of: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a fraction, from how often it was so.

    Source: E. B. Wilson, J. Am. Stat. Assoc. 22 (1927).
    """
    if of == 0:
        return 0.0, 1.0
    p, z2 = good / of, _Z**2
    middle = (p + z2 / (2 * of)) / (1 + z2 / of)
    half = _Z / (1 + z2 / of) * sqrt(p * (1 - p) / of + z2 / (4 * of**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def draw_success(
    parameters: Mapping[str, Sequence[Any]], good: Sequence[bool]
) -> Figure:
    """Draw the fraction of good worlds against each parameter, with 95 % intervals.

    Numbers are in bins of as many worlds each, with a tick for every world that went
    wrong.

    Parameters
    ----------
    parameters : mapping of str to sequence
        The values of each parameter in all worlds.
    good : sequence of bool
        Of each world.
    """
    rows = ceil(len(parameters) / _COLUMNS)
    figure = Figure(figsize=(12, 0.4 + 2.2 * rows), layout="constrained")
    axes = figure.subplots(rows, _COLUMNS, sharey=True, squeeze=False)
    for ax in axes.flat[len(parameters) :]:
        ax.set_visible(False)
    overall = 100 * float(np.mean(good))
    for ax, (name, values) in zip(axes.flat, parameters.items(), strict=False):
        ax.axhline(overall, color=DEMONSTRATED, linewidth=0.8)
        if all(map(is_number, values)) and len(set(values)) > _BINS:
            _draw_numbers(ax, np.array(values, dtype=float), np.array(good))
        else:
            _draw_choices(ax, values, good)
        set_title(ax, name)
        ax.title.set_fontsize("small")
        ax.set_ylim(-4, 104)
        ax.tick_params(labelsize="small")
        ax.spines[["top", "right"]].set_visible(False)
    for ax in axes[:, 0]:
        ax.set_ylabel("good worlds (%)")
    return figure


def _draw_numbers(ax: Axes, values: Any, good: Any) -> None:
    order = np.argsort(values)
    for part in np.array_split(order, min(_BINS, max(1, len(order) // 4))):
        at = float(np.median(values[part]))
        _draw_fraction(ax, at, good[part])
    ax.plot(values[~good], np.full(np.sum(~good), -1.0), "|", color=PLAYED)
    if np.min(values) > 0 and np.max(values) / np.min(values) > 8:
        ax.set_xscale("log")


def _draw_choices(ax: Axes, values: Sequence[Any], good: Sequence[bool]) -> None:
    choices = sorted(set(values), key=lambda value: (str(type(value)), value))
    for i, choice in enumerate(choices):
        these = [g for value, g in zip(values, good, strict=True) if value == choice]
        _draw_fraction(ax, i, these)
    ax.set_xticks(range(len(choices)), [str(choice) for choice in choices])
    ax.set_xlim(-0.5, len(choices) - 0.5)


def _draw_fraction(ax: Axes, at: float, good: Sequence[bool]) -> None:
    low, high = interval(int(np.sum(good)), len(good))
    ax.plot([at, at], [100 * low, 100 * high], color=SAMPLED, linewidth=1.2, alpha=0.5)
    ax.plot(at, 100 * float(np.mean(good)), "o", color=SAMPLED, markersize=4)


def draw_figures(worlds: Mapping[str, Sequence[Sequence[float]]]) -> Figure:
    """Draw how far off their path worlds were, and how long they pressed as wanted.

    Parameters
    ----------
    worlds : mapping of str to sequence of pairs
        By the names of groups: path error in mm rms, and per cent of the time in
        contact within 5 N of the wanted force.
    """
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    path, press = figure.subplots(1, 2)
    for (name, pairs), color in zip(
        worlds.items(), (SAMPLED, PLAYED, DEMONSTRATED), strict=False
    ):
        rows = np.array(pairs, dtype=float).reshape(-1, 2)
        n = max(1, len(rows))
        order = 100 * np.arange(1, len(rows) + 1) / n
        style = {"color": color, "marker": ".", "markersize": 4, "linewidth": 1.2}
        path.plot(np.sort(rows[:, 0]), order, label=name, **style)
        press.plot(np.sort(rows[:, 1])[::-1], order, label=name, **style)
    path.axvline(10, color="0.3", linestyle=":")
    path.set_xscale("log")
    path.set_xlabel("off the path (mm rms); dotted: 10 mm")
    press.axvline(95, color="0.3", linestyle=":")
    press.set_xlabel("of the contact within 5 N of the wanted (%); dotted: 95 %")
    for ax in (path, press):
        ax.set_ylabel("worlds at least as good (%)")
        ax.set_ylim(0, 102)
        ax.spines[["top", "right"]].set_visible(False)
        legend_above(ax)
    return figure


def draw_places(groups: Mapping[str, Sequence[Sequence[float]]]) -> Figure:
    """Draw where the boards were, seen from the side and from above.

    Parameters
    ----------
    groups : mapping of str to sequence of positions
        p_WB of each world, m, by the names good, wrong and refused.
    """
    figure = Figure(figsize=(12, 4.4), layout="constrained")
    side, above = figure.subplots(1, 2)
    looks = {"good": SAMPLED, "wrong": PLAYED, "refused": "0.6"}
    for name, positions in groups.items():
        p = np.array(positions, dtype=float).reshape(-1, 3)
        hollow = "none" if name == "refused" else looks[name]
        for ax, i in ((side, 2), (above, 1)):
            ax.scatter(
                p[:, 0], p[:, i], s=18, facecolors=hollow, edgecolors=looks[name],
                label=name,
            )  # fmt: skip
    for ax, label in ((side, "z, height of the board (m)"), (above, "y (m)")):
        ax.set_xlabel("x, distance of the board's middle from the arm's base (m)")
        ax.set_ylabel(label)
        ax.spines[["top", "right"]].set_visible(False)
    set_title(side, "from the side")
    set_title(above, "from above")
    legend_above(above)
    return figure
