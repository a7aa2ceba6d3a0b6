"""Pictures of success rates, tracking errors and force errors of trials."""

from collections.abc import Mapping, Sequence
from math import ceil, sqrt
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from fmp_drake.numeric import is_number
from fmp_drake.plots.style import (
    DEMONSTRATED,
    PLAYED,
    SAMPLED,
    label_decades,
    legend_above,
    set_title,
)

# Standard deviations of a 95 % interval, and bins of a parameter.
_Z, _BINS = 1.96, 6
_COLUMNS = 4
# Least number of trials that shows the influence of a parameter in several bins.
_LEAST_TRIALS = 16
# Ratio of a parameter's extremes above which its axis is logarithmic.
_DECADE = 10.0
_TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500)


def interval(passed: int, total: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a fraction.

    Source: E. B. Wilson, J. Am. Stat. Assoc. 22 (1927).
    """
    if total == 0:
        return 0.0, 1.0
    p, z2 = passed / total, _Z**2
    middle = (p + z2 / (2 * total)) / (1 + z2 / total)
    half = _Z / (1 + z2 / total) * sqrt(p * (1 - p) / total + z2 / (4 * total**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def draw_success(
    parameters: Mapping[str, Sequence[Any]], passed: Sequence[bool]
) -> Figure:
    """Draw the success rate against each parameter, with 95 % intervals.

    Numbers are in bins of equal counts, with a tick for every failed trial. A parameter
    with the same value in all trials is left out. For fewer than 16 trials the picture is
    a sentence that says so.

    Parameters
    ----------
    parameters : mapping of str to sequence
        Values of each parameter in all trials.
    passed : sequence of bool
        For each trial.
    """
    parameters = {
        name: values
        for name, values in parameters.items()
        if len({str(value) for value in values}) > 1
    }
    if len(passed) < _LEAST_TRIALS or not parameters:
        figure = Figure(figsize=(12, 0.6))
        text = (
            f"{len(passed)} trials are too few to show the influence of a parameter; "
            f"run at least {_LEAST_TRIALS}."
        )
        figure.text(0.01, 0.4, text)
        return figure
    rows = ceil(len(parameters) / _COLUMNS)
    figure = Figure(figsize=(12, 0.4 + 2.0 * rows), layout="constrained")
    axes = figure.subplots(rows, _COLUMNS, sharey=True, squeeze=False)
    for ax in axes.flat[len(parameters) :]:
        ax.set_visible(False)
    for ax, (name, values) in zip(axes.flat, parameters.items(), strict=False):
        ax.axhline(100 * float(np.mean(passed)), color=DEMONSTRATED, linewidth=0.8)
        if all(map(is_number, values)) and len(set(values)) > _BINS:
            _draw_numbers(ax, np.array(values, dtype=float), np.array(passed))
        else:
            _draw_choices(ax, values, passed)
        ax.set_ylim(-5, 104)
        ax.set_title(name, loc="left", fontsize="small")
        ax.tick_params(labelsize="small")
        ax.spines[["top", "right"]].set_visible(False)
    for ax in axes[:, 0]:
        ax.set_ylabel("passed (%)", fontsize="small")
    return figure


def _draw_numbers(ax: Axes, values: Any, passed: Any) -> None:
    for part in np.array_split(np.argsort(values), min(_BINS, 1 + len(values) // 8)):
        _draw_fraction(ax, float(np.median(values[part])), passed[part])
    ax.plot(values[~passed], np.full(np.sum(~passed), -2.0), "|", color=PLAYED)
    ax.locator_params(axis="x", nbins=4)
    if np.min(values) > 0 and np.max(values) > _DECADE * np.min(values):
        ax.set_xscale("log")
        label_decades(ax.xaxis, (1.0, 3.0))


def _draw_choices(ax: Axes, values: Sequence[Any], passed: Sequence[bool]) -> None:
    choices = sorted({str(value) for value in values})
    for i, choice in enumerate(choices):
        pairs = zip(values, passed, strict=True)
        _draw_fraction(ax, i, [ok for value, ok in pairs if str(value) == choice])
    labels = [f"{float(c):.3g}" if _is_decimal(c) else c for c in choices]
    ax.set_xticks(range(len(choices)), labels)
    ax.set_xlim(-0.5, max(len(choices), 1) - 0.5)


def _is_decimal(text: str) -> bool:
    return text.replace(".", "", 1).removeprefix("-").isdecimal()


def _draw_fraction(ax: Axes, x: float, passed: Sequence[bool]) -> None:
    low, high = interval(int(np.sum(passed)), len(passed))
    ax.plot([x, x], [100 * low, 100 * high], color=SAMPLED, linewidth=1.2, alpha=0.5)
    ax.plot(x, 100 * float(np.mean(passed)), "o", color=SAMPLED, markersize=4)


def draw_figures(groups: Mapping[str, Sequence[Sequence[float]]]) -> Figure:
    """Draw the distributions of path error and time with the desired force.

    Parameters
    ----------
    groups : mapping of str to sequence of pairs
        For each trial the path error, m rms, and the fraction of the time in contact
        within 5 N of the desired force.
    """
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    path_axes, force_axes = figure.subplots(1, 2, sharey=True)
    for (name, pairs), color in zip(groups.items(), (SAMPLED, PLAYED), strict=True):
        if not pairs:
            continue
        rms, fractions = np.array(pairs, dtype=float).T
        for ax, values in (
            (path_axes, 1e3 * np.sort(rms)),
            (force_axes, 100 * np.sort(-fractions)),
        ):
            order = 100 * np.arange(1, len(values) + 1) / len(values)
            ax.plot(np.abs(values), order, ".-", color=color, linewidth=1, label=name)
    path_axes.set_xscale("log")
    largest = max(20, 1.1 * path_axes.get_xlim()[1])  # All ticks would widen it.
    path_axes.set_xticks(_TICKS, [str(tick) for tick in _TICKS])
    path_axes.xaxis.set_minor_formatter(NullFormatter())
    path_axes.set_xlim(1, largest)
    path_axes.set_xlabel("distance from the path (mm rms)")
    path_axes.set_ylabel("trials at least as good (%)")
    force_axes.set_xlabel("time in contact within 5 N of the desired force (%)")
    for ax, limit in ((path_axes, 10), (force_axes, 95)):
        ax.axvline(limit, color="0.3", linestyle=":", label="limit")
        ax.set_ylim(0, 103)
        ax.spines[["top", "right"]].set_visible(False)
    set_title(path_axes, "tracking error")
    set_title(force_axes, "normal force")
    legend_above(force_axes)
    return figure
