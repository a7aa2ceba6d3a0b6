"""Pictures of the benchmark: measures over learned cycles, and summarised runs."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmp_drake.experiments.benchmark.built_in import FMP
from fmp_drake.experiments.benchmark.splits import ALL, CYCLES
from fmp_drake.numeric import Array
from fmp_drake.plots.style import PLAYED, SAMPLED, series_style, set_title

COLUMNS = (*(f"{cycles:g}" for cycles in CYCLES), ALL)
"""Numbers of learned cycles, as text."""


def draw_lines(
    values: Mapping[str, Mapping[str, Sequence[float]]],
    label: str,
    mean: Callable[[Sequence[float]], float],
) -> Figure:
    """Draw a measure over the cycles, one line for each method."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    ax: Axes = figure.subplots()
    all_cycles = set().union(*values.values())
    columns = [cycles for cycles in COLUMNS if cycles in all_cycles]
    for number, (name, groups) in enumerate(values.items()):
        positions = [i for i, cycles in enumerate(columns) if cycles in groups]
        style: dict[str, Any] = {"linewidth": 2.6, "color": SAMPLED, "marker": "o"}
        if name == FMP.name:
            style["zorder"] = 4
            for i in positions:
                group = groups[columns[i]]
                ax.plot([i] * len(group), group, "_", color=SAMPLED, alpha=0.5)
        else:
            # Ten colours repeat.
            style = {**series_style(number), "lw": 1.1, "marker": ".x"[number > 9]}
        if positions:
            means = [mean(groups[columns[i]]) for i in positions]
            ax.plot(positions, means, label=name, **style)
    ax.set_xticks(range(len(columns)), columns)
    ax.margins(x=0.1)
    ax.set_xlabel("cycles learned from")
    ax.set_ylabel(label)
    ax.spines[["top", "right"]].set_visible(False)
    if ax.get_legend_handles_labels()[0]:
        figure.legend(loc="outside right upper", frameon=False, fontsize="small")
    return figure


def summarise_runs(
    runs: Mapping[str, Sequence[Mapping[str, Any]]],
    measures: Mapping[str, tuple[str, float, str]],
    summary: Callable[[Array, str], str],
    *,
    counts: Mapping[str, str],
    missing: str,
    limits: Sequence[float] = (np.inf,) * 4,
) -> tuple[Figure, Sequence[Axes], list[list[str]]]:
    """Draw the first four measures of runs, and summarise all in a table.

    Parameters
    ----------
    runs : mapping of str to sequence of mapping
        Runs of each method.
    measures : mapping of str to tuple
        Title, factor and number format of each measure.
    summary : callable
        Returns the text for values and a number format.
    counts : mapping of str to str
        Number of runs of each method, as text.
    missing : str
        Text with a placeholder for the number of runs without a value.
    limits : sequence of float, length 4
        Values above these are drawn there.

    Returns
    -------
    figure : Figure
        A mark for each run, and a point at the median of each method.
    axes : sequence of Axes
    table : list of list of str
    """
    figure = Figure(figsize=(12, 0.9 + 0.3 * len(runs)), layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    titles = [title for title, _, _ in measures.values()]
    table = [["", "runs", *titles]]
    for row, (name, group) in enumerate(runs.items()):
        cells = []
        for i, (measure, (_, factor, form)) in enumerate(measures.items()):
            numbers = [run[measure] for run in group if run[measure] is not None]
            if not numbers:
                cells.append(missing.format(len(group)) if group else "-")
                continue
            values = factor * np.array(numbers, dtype=float)
            if i < len(axes):
                color = SAMPLED if name == FMP.name else "0.5"
                most, middle = limits[i], np.median(values)
                shown = np.minimum(values, most)
                axes[i].plot(shown, [row] * len(shown), "|", color=color, alpha=0.6)
                marker = "o" if middle <= most else ">"
                axes[i].plot(min(middle, most), row, marker, color=PLAYED, markersize=4)
            count = len(group) - len(numbers)
            remark = f", {missing.format(count)}" if count else ""
            cells.append(f"{summary(values, form)}{remark}")
        table.append([name, counts[name], *cells])
    for ax, title in zip(axes, titles, strict=False):
        set_title(ax, title)
        ax.spines[["top", "right"]].set_visible(False)
        if not ax.lines:
            ax.set_xticks([])
    axes[0].set_yticks(range(len(runs)), list(runs))
    axes[0].invert_yaxis()
    return figure, axes, table
