"""Pictures of how many worlds went well, and where the others are."""

from collections.abc import Mapping, Sequence
from math import ceil, sqrt
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from fmp_drake.numeric import is_number
from fmp_drake.plots.style import DEMONSTRATED, PLAYED, SAMPLED, legend_above

# Standard deviations of a 95 % interval, and bins of a parameter.
_Z, _BINS = 1.96, 6
_COLUMNS = 4
# A parameter that spans more is drawn on a logarithmic axis.
_DECADE = 10.0
_TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500)


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
    figure = Figure(figsize=(12, 0.4 + 2.0 * rows), layout="constrained")
    axes = figure.subplots(rows, _COLUMNS, sharey=True, squeeze=False)
    for ax in axes.flat[len(parameters) :]:
        ax.set_visible(False)
    for ax, (name, values) in zip(axes.flat, parameters.items(), strict=False):
        if good:
            ax.axhline(100 * float(np.mean(good)), color=DEMONSTRATED, linewidth=0.8)
        if all(map(is_number, values)) and len(set(values)) > _BINS:
            _draw_numbers(ax, np.array(values, dtype=float), np.array(good))
        else:
            _draw_choices(ax, values, good)
        ax.set_ylim(-5, 104)
        ax.set_title(name, loc="left", fontsize="small")
        ax.tick_params(labelsize="small")
        ax.spines[["top", "right"]].set_visible(False)
    for ax in axes[:, 0]:
        ax.set_ylabel("good (%)", fontsize="small")
    return figure


def _draw_numbers(ax: Axes, values: Any, good: Any) -> None:
    for part in np.array_split(np.argsort(values), min(_BINS, 1 + len(values) // 8)):
        _draw_fraction(ax, float(np.median(values[part])), good[part])
    ax.plot(values[~good], np.full(np.sum(~good), -2.0), "|", color=PLAYED)
    ax.locator_params(axis="x", nbins=4)
    if np.min(values) > 0 and np.max(values) > _DECADE * np.min(values):
        ax.set_xscale("log")
        ax.xaxis.set_minor_formatter(NullFormatter())


def _draw_choices(ax: Axes, values: Sequence[Any], good: Sequence[bool]) -> None:
    choices = sorted({str(value) for value in values})
    for i, choice in enumerate(choices):
        pairs = zip(values, good, strict=True)
        _draw_fraction(ax, i, [g for value, g in pairs if str(value) == choice])
    ax.set_xticks(range(len(choices)), choices)
    ax.set_xlim(-0.5, max(len(choices), 1) - 0.5)


def _draw_fraction(ax: Axes, at: float, good: Sequence[bool]) -> None:
    low, high = interval(int(np.sum(good)), len(good))
    ax.plot([at, at], [100 * low, 100 * high], color=SAMPLED, linewidth=1.2, alpha=0.5)
    ax.plot(at, 100 * float(np.mean(good)), "o", color=SAMPLED, markersize=4)


def draw_figures(groups: Mapping[str, Sequence[Sequence[float]]]) -> Figure:
    """Draw how far off their path worlds were, and how long they pressed as wanted.

    Parameters
    ----------
    groups : mapping of str to sequence of pairs
        Path error, m rms, and fraction of the time in contact within 5 N of the wanted
        force, of each world.
    """
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    path, press = figure.subplots(1, 2, sharey=True)
    for (name, pairs), color in zip(groups.items(), (SAMPLED, PLAYED), strict=True):
        rms, pressed = np.array(pairs, dtype=float).reshape(-1, 2).T
        for ax, values in (
            (path, 1e3 * np.sort(rms)),
            (press, 100 * np.sort(-pressed)),
        ):
            order = 100 * np.arange(1, len(values) + 1) / max(1, len(values))
            ax.plot(np.abs(values), order, ".-", color=color, linewidth=1, label=name)
    path.set_xscale("log")
    farthest = max(20, 1.1 * path.get_xlim()[1])  # All ticks would widen it.
    path.set_xticks(_TICKS, [str(tick) for tick in _TICKS])
    path.xaxis.set_minor_formatter(NullFormatter())
    path.set_xlim(1, farthest)
    path.set_xlabel("off the path (mm rms)")
    path.set_ylabel("worlds at least as good (%)")
    press.set_xlabel("time in contact within 5 N of the wanted (%)")
    for ax, limit in ((path, 10), (press, 95)):
        ax.axvline(limit, color="0.3", linestyle=":", label="limit")
        ax.spines[["top", "right"]].set_visible(False)
    legend_above(press)
    return figure
