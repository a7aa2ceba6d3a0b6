"""Report of the benchmark: tables and pictures of all methods."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import fmean, geometric_mean
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import wilcoxon

from fmp_drake.experiments.baselines.gaussian_processes import DelayGP, PeriodicGP
from fmp_drake.experiments.benchmark.built_in import FMP, ReplayMethod
from fmp_drake.experiments.benchmark.run import STEPS, MethodScores
from fmp_drake.experiments.benchmark.splits import ALL, CYCLES
from fmp_drake.experiments.report import Finding, write_report
from fmp_drake.numeric import Array
from fmp_drake.plots.style import PLAYED, SAMPLED, label_decades, series_style
from fmp_drake.primitives.data.reading.table import count_text

_COLUMNS = (*(f"{cycles:g}" for cycles in CYCLES), ALL)
# Allowed percentages of the true samples in the tubes.
_COVERAGE_BAND = (85, 99)
# Densities that are drawn, relative to the reference, nats per sample.
_DENSITIES = (-12.0, 8.0)
_IN_BRACKETS = (
    "In square brackets: number of movements compared, where the methods did not learn "
    "from, or were not run on, all. "
)
# Greatest ratio of a playback to the demonstration that is drawn as it is.
_MOST_RATIO = 2.0

_Scores = Mapping[str, MethodScores]
# Number of cycles, and name of a movement.
_Case = tuple[str, str]


def benchmark_findings(scores: _Scores) -> list[Finding]:
    """Return the tables and pictures of all methods."""
    recordings = {run["movement"] for m in scores.values() for run in m.cleaning}
    cleaning = [_cleaning(scores, recording) for recording in sorted(recordings)]
    if not any(method.predictions for method in scores.values()):
        return cleaning
    return [
        _errors(scores),
        _densities(scores),
        _coverage(scores),
        _playback(scores),
        *cleaning,
        _movements(scores),
    ]


def _place_values(scores: MethodScores, measure: str) -> dict[_Case, dict[int, float]]:
    """Return a measure by cycles and movement, and by the place of the training part."""
    values: dict[_Case, dict[int, float]] = {}
    for row in scores.predictions:
        if row.get(measure) is not None:
            case = row["cycles"], row["movement"]
            values.setdefault(case, {})[row["place"]] = row[measure]
    return values


def mean_values(scores: MethodScores, measure: str) -> dict[_Case, float]:
    """Return a measure by cycles and movement, the mean over the training parts."""
    return {
        case: fmean(places.values())
        for case, places in _place_values(scores, measure).items()
    }


def _paired_means(
    scores: _Scores, method: str, other: str, measure: str
) -> dict[_Case, tuple[float, float]]:
    """Return the means of two methods over the training parts that both learned from.

    There are none where a method has not been run.
    """
    if method not in scores or other not in scores:
        return {}
    ours, theirs = (_place_values(scores[name], measure) for name in (method, other))
    means = {}
    for case, places in ours.items():
        others = theirs.get(case, {})
        pairs = [(places[place], others[place]) for place in places if place in others]
        if pairs:
            mean, other_mean = map(fmean, zip(*pairs, strict=True))
            means[case] = mean, other_mean
    return means


def _grouped[T](values: Mapping[_Case, T]) -> dict[str, list[T]]:
    """Return values by the number of cycles."""
    groups: dict[str, list[T]] = {}
    for (cycles, _), value in values.items():
        groups.setdefault(cycles, []).append(value)
    return groups


def _comparisons(
    scores: _Scores,
    measure: str,
    reference: str,
    compare: Callable[[float, float], float],
) -> dict[str, dict[str, list[float]]]:
    """Return method to cycles to comparisons with a reference, one for each movement."""
    return {
        name: _grouped(
            {
                case: compare(*means)
                for case, means in _paired_means(
                    scores, name, reference, measure
                ).items()
            }
        )
        for name in scores
    }


def _table(
    scores: _Scores,
    values: Mapping[str, Mapping[str, Sequence[Any]]],
    show: Callable[[Sequence[Any]], str],
) -> list[list[str]]:
    """Return a table of methods and cycles; the header counts the movements."""
    cases = {
        (row["cycles"], row["movement"])
        for method in scores.values()
        for row in method.predictions
    }
    all_cycles = [cycles for cycles, _ in cases]
    counts = {c: all_cycles.count(c) for c in _COLUMNS if c in all_cycles}
    header = [f"{cycles} ({count})" for cycles, count in counts.items()]
    rows = [["cycles learned from (movements)", *header]]
    for name in scores:
        cells = []
        for cycles, count in counts.items():
            group = values[name].get(cycles, [])
            text = show(group) if group else "-"
            if group and len(group) < count:
                text += f" [{len(group)}]"
            cells.append(text)
        rows.append([name, *cells])
    return rows


def _errors(scores: _Scores) -> Finding:
    comparisons = _comparisons(
        scores, "error_mm", ReplayMethod.name, lambda a, b: a / b
    )

    def show(ratios: Sequence[float]) -> str:
        return f"{geometric_mean(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"

    ratios = [r for group in comparisons.get(FMP.name, {}).values() for r in group]
    text = ""
    if ratios:
        text = (
            f"{FMP.name}: {geometric_mean(ratios):.2f} of replay's error in the geometric "
            f"mean of all {len(ratios)} cases, at most replay's in "
            f"{sum(r <= 1 for r in ratios)}. {_wins(scores, 'error_mm', min)}"
        )
    figure = _draw_lines(comparisons, "error / error of replay", geometric_mean)
    (ax,) = figure.axes
    ax.set_yscale("log")
    label_decades(ax.yaxis, (1.0, 2.0, 5.0))
    ax.axhline(1.0, color="0.6", linewidth=1, zorder=0)
    return Finding(
        name="benchmark_error",
        title="Error of the next second, relative to replay",
        shows=f"{text}Geometric mean over movements, and the range, over the training parts "
        f"that the method and replay learned from. {_IN_BRACKETS}{_significance(scores)}",
        figure=figure,
        table=_table(scores, comparisons, show),
    )


def _wins(
    scores: _Scores, measure: str, best: Callable[[Iterable[float]], float]
) -> str:
    """Return a sentence that counts the cases no worse than the best simple method."""
    simple = (ReplayMethod.name, DelayGP.name, PeriodicGP.name)
    names = [name for name in simple if name in scores]
    pairs: dict[_Case, list[bool]] = {}
    for name in names:
        paired = _paired_means(scores, FMP.name, name, measure)
        for case, (value, other) in paired.items():
            pairs.setdefault(case, []).append(best((value, other)) == value)
    wins = [all(no_worse) for no_worse in pairs.values()]
    text = (
        f"No worse than the best of {', '.join(names)} in {sum(wins)} of {len(wins)} "
        "cases. "
    )
    return text if wins else ""


def _significance(scores: _Scores) -> str:
    """Return a sentence about paired tests over all cases."""
    parts = []
    for name in scores:
        # The mean over cycles of each movement: cases of one movement are not independent.
        logs: dict[str, list[float]] = {}
        paired = _paired_means(scores, FMP.name, name, "error_mm")
        for (_, movement), (error, other) in paired.items():
            logs.setdefault(movement, []).append(float(np.log(error / other)))
        means = [float(np.mean(values)) for values in logs.values()]
        if name != FMP.name and len(means) > 4 and np.any(means):
            p = float(wilcoxon(means).pvalue)
            parts.append(f"{name} {np.exp(np.mean(means)):.2f} (p = {p:.2g})")
    if not parts:
        return ""
    return (
        f"Error of {FMP.name} relative to each method, over movements, with the p-value of "
        f"Wilcoxon's signed-rank test: {', '.join(parts)}."
    )


def _densities(scores: _Scores) -> Finding:
    comparisons = _comparisons(
        scores, "log_density", PeriodicGP.name, lambda a, b: a - b
    )

    def show(differences: Sequence[float]) -> str:
        return f"{np.mean(differences):+.1f} (least {min(differences):+.1f})"

    label = f"nats per sample more than {PeriodicGP.name}"
    figure = _draw_lines(comparisons, label, fmean)
    figure.axes[0].set_ylim(*_DENSITIES)
    return Finding(
        name="benchmark_density",
        title="Log score: density of the true next second",
        shows=f"Nats per sample, mean over the second, minus those of {PeriodicGP.name}: "
        "mean over movements, and the least, over the training parts that both learned from. "
        "Methods without numbers have no uncertainty. The picture shows "
        f"{_DENSITIES[0]:g} to {_DENSITIES[1]:g}. {_IN_BRACKETS}"
        f"{_wins(scores, 'log_density', max)}",
        figure=figure,
        table=_table(scores, comparisons, show),
    )


def _coverage(scores: _Scores) -> Finding:
    # One row for each movement: the percentages after each of the steps.
    coverage: dict[str, dict[str, list[list[float]]]] = {}
    for name, method in scores.items():
        steps = [mean_values(method, f"inside_{step}") for step in STEPS]
        coverage[name] = _grouped(
            {case: [100 * values[case] for values in steps] for case in steps[0]}
        )

    def show(rows: Sequence[Sequence[float]]) -> str:
        return " / ".join(f"{mean:.0f}" for mean in np.mean(rows, axis=0))

    last = {
        name: {cycles: [row[-1] for row in rows] for cycles, rows in groups.items()}
        for name, groups in coverage.items()
    }
    figure = _draw_lines(last, "inside after 1 s (%)", fmean)
    figure.axes[0].axhspan(*_COVERAGE_BAND, color="0.93", zorder=0)
    return Finding(
        name="benchmark_coverage",
        title="Coverage of the 95 % tubes",
        shows="Percentage of the true samples inside after 0.25 / 0.5 / 1 s, mean over "
        "movements; 95 is ideal. The picture shows 1 s.",
        figure=figure,
        table=_table(scores, coverage, show),
    )


def _playback(scores: _Scores) -> Finding:
    def summary(values: Array, form: str) -> str:
        low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
        return f"{middle:{form}} ({low:{form}} to {high:{form}})"

    runs = {name: m.playbacks for name, m in scores.items() if m.playbacks}
    figure, axes, table = _summarised_runs(
        runs,
        {
            "stays": ("stays near (%)", 100.0, ".0f"),
            "size": ("size", 1.0, ".2f"),
            "tempo": ("tempo", 1.0, ".2f"),
            "variety": ("variety", 1.0, ".2f"),
        },
        summary,
        counts={name: str(len(playbacks)) for name, playbacks in runs.items()},
        missing="none in {}",
        limits=(np.inf, *[_MOST_RATIO] * 3),
    )
    for ax, demonstrated in zip(axes, (100, 1, 1, 1), strict=True):
        ax.axvline(demonstrated, color="0.8", zorder=0)
    for ax in axes[1:]:
        ax.set_xlim(0, 1.02 * _MOST_RATIO)
    return Finding(
        name="benchmark_playback",
        title="Playback of a minute",
        shows="From a held-out second; the first 10 s are not scored. Stays: samples within "
        "15 % of the movement's size of the demonstrated path. Size and tempo relative to "
        "the demonstration. Variety: difference of successive cycles, relative to that of "
        "the demonstration; 0 repeats itself exactly. Median, and the range of 80 %; "
        "'none' counts playbacks without a value, as no cycle repeats in them or in the "
        f"demonstration. Ratios above {_MOST_RATIO:g} "
        "are drawn at the edge, their medians as arrows.",
        figure=figure,
        table=table,
    )


def _cleaning(scores: _Scores, recording: str) -> Finding:
    """Return the table and picture of the task metric for a recording."""
    runs = {
        name: group
        for name, method in scores.items()
        if (group := [run for run in method.cleaning if run["movement"] == recording])
    }
    finished = {n: [r for r in group if "error" not in r] for n, group in runs.items()}
    figure, _, table = _summarised_runs(
        finished,
        {
            "seconds_to_50": ("to 50 % (s)", 1.0, ".1f"),
            "seconds_to_90": ("to 90 % (s)", 1.0, ".1f"),
            "seconds_to_99": ("to 99 % (s)", 1.0, ".1f"),
            "cleaned": ("cleaned (%)", 100.0, ".1f"),
            "tracking_rms_m": ("tracking error (mm rms)", 1e3, ".1f"),
            "force_mean_n": ("normal force (N)", 1.0, ".1f"),
            "force_near": ("within 5 N (%)", 100.0, ".0f"),
        },
        lambda v, form: f"{np.mean(v):{form}} ± {np.std(v):{form}}",
        counts={n: f"{len(finished[n])} of {len(group)}" for n, group in runs.items()},
        missing="{} never",
    )
    all_runs = [run for group in runs.values() for run in group]
    cycles = ", ".join(sorted({run["cycles"] for run in all_runs}))
    durations = {f"{run['duration']:g} s" for run in all_runs}
    return Finding(
        name=f"benchmark_cleaning_{recording}",
        title=f"Task: times in which the methods clean the board, {recording}",
        shows=f"Learned from {cycles} cycles of {recording}; the same station follows the "
        f"path of each method for {', '.join(sorted(durations))}. Each seed starts from other "
        "samples of the recording. Times refer to the area that the whole recording sweeps. "
        "Mean and standard deviation over runs; 'never' counts runs that do not reach it.",
        figure=figure,
        table=table,
    )


def _summarised_runs(
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
        ax.set_title(title, loc="left", fontsize="medium")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(range(len(runs)), list(runs))
    axes[0].invert_yaxis()
    return figure, axes, table


def _movements(scores: _Scores) -> Finding:
    values = [_place_values(method, "error_mm") for method in scores.values()]
    rows = [["", *scores]]
    cases = {case for means in values for case in means if case[0] == ALL}
    for case in sorted(cases):
        groups = [method.get(case, {}) for method in values]
        most = max(map(len, groups))
        cells = [
            f"{fmean(group.values()):.1f}" + f" [{len(group)}]" * (len(group) < most)
            if group
            else "-"
            for group in groups
        ]
        rows.append([case[1], *cells])
    return Finding(
        name="benchmark_movements",
        title="Error of the next second of each movement, mm",
        shows="Learned from two thirds, or from all recordings but one. In square brackets: "
        "number of training parts that a method could learn from, where these are not all.",
        table=rows,
    )


def _draw_lines(
    values: Mapping[str, Mapping[str, Sequence[float]]],
    label: str,
    mean: Callable[[Sequence[float]], float],
) -> Figure:
    """Draw a measure over the cycles, one line for each method."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    ax: Axes = figure.subplots()
    all_cycles = set().union(*values.values())
    columns = [cycles for cycles in _COLUMNS if cycles in all_cycles]
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


def write_benchmark(out: Path, scores: _Scores, *, folder: Path) -> None:
    """Write report.html of all methods into a folder."""
    name = folder.resolve().name
    count = len({row["movement"] for m in scores.values() for row in m.predictions})
    failures = [
        f"{name} could not learn from, or predict, {len(errors)} of "
        f"{len(method.predictions)} splits: {errors[0]}"
        for name, method in scores.items()
        if (errors := [row["error"] for row in method.predictions if "error" in row])
    ]
    methods = count_text(len(scores), "method")
    introduction = (
        f"{methods} on {count_text(count, 'movement')} in `{name}`, 20 samples per second. "
        "Each method learns from some cycles, observes half a second of a held-out part, and "
        "predicts the next second. " + " ".join(failures)
        if count
        else f"{methods}, which clean the board."
    )
    write_report(
        out,
        sections=[("All methods", benchmark_findings(scores))],
        introduction=introduction,
        results={name: asdict(method) for name, method in scores.items()},
        title=f"Benchmark: {name if count else 'cleaning'}",
    )
