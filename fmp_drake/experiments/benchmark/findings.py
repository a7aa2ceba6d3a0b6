"""Report of the benchmark: tables and pictures of all methods."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import fmean, geometric_mean
from typing import Any

import numpy as np
from scipy.stats import wilcoxon

from fmp_drake.experiments.baselines.gaussian_processes import DelayGP, PeriodicGP
from fmp_drake.experiments.benchmark.built_in import FMP, ReplayMethod
from fmp_drake.experiments.benchmark.pictures import (
    COLUMNS,
    draw_lines,
    summarise_runs,
)
from fmp_drake.experiments.benchmark.run import STEPS, MethodScores
from fmp_drake.experiments.benchmark.splits import ALL
from fmp_drake.experiments.report import Finding, write_report
from fmp_drake.numeric import Array
from fmp_drake.plots.style import label_decades
from fmp_drake.primitives.data.reading.table import count_text

# Allowed percentages of the true samples in the tubes.
_COVERAGE_BAND = (85, 99)
# Densities that are drawn, relative to the reference, nats per sample.
_DENSITIES = (-12.0, 8.0)
_IN_BRACKETS = (
    "In square brackets: number of movements with a value, where these are not all. "
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
    findings = [_errors(scores)]
    if any(mean_values(method, "log_density") for method in scores.values()):
        findings += [_densities(scores), _coverage(scores)]
    if any(method.playbacks for method in scores.values()):
        findings.append(_playback(scores))
    movements = _movements(scores)
    return [*findings, *cleaning, *([movements] if movements.table else [])]


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


def _is_scored(scores: _Scores, method: str, measure: str) -> bool:
    """Return whether a method has been run, and has a measure."""
    return method in scores and bool(_place_values(scores[method], measure))


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
    """Return method to cycles to comparisons with a reference, one for each movement.

    Without scores of the reference they are the values of the methods themselves.
    """
    if not _is_scored(scores, reference, measure):
        return {name: _grouped(mean_values(m, measure)) for name, m in scores.items()}
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
    counts = {c: all_cycles.count(c) for c in COLUMNS if c in all_cycles}
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
    text, is_relative = "", _is_scored(scores, ReplayMethod.name, "error_mm")
    if ratios and is_relative:
        text = (
            f"{FMP.name}: {geometric_mean(ratios):.2f} of replay's error in the geometric "
            f"mean of all {len(ratios)} cases, at most replay's in "
            f"{sum(r <= 1 for r in ratios)}. {_wins(scores, 'error_mm', min)}"
        )
    label = "error / error of replay" if is_relative else "error (mm)"
    figure = draw_lines(comparisons, label, geometric_mean)
    (ax,) = figure.axes
    ax.set_yscale("log")
    label_decades(ax.yaxis, (1.0, 2.0, 5.0))
    parts = "."
    if is_relative:
        ax.axhline(1.0, color="0.6", linewidth=1, zorder=0)
        parts = ", over the training parts that the method and replay learned from."
    return Finding(
        name="benchmark_error",
        title=f"Error of the next second, {'relative to replay' if is_relative else 'mm'}",
        shows=f"{text}Geometric mean over movements, and the range{parts} {_IN_BRACKETS}"
        f"{_significance(scores)}",
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
        "Wilcoxon's signed-rank test, not corrected for the number of methods: "
        f"{', '.join(parts)}."
    )


def _densities(scores: _Scores) -> Finding:
    comparisons = _comparisons(
        scores, "log_density", PeriodicGP.name, lambda a, b: a - b
    )

    def show(differences: Sequence[float]) -> str:
        return f"{np.mean(differences):+.1f} (least {min(differences):+.1f})"

    label, shows = "nats per sample", "Nats per sample, mean over the second"
    if is_relative := _is_scored(scores, PeriodicGP.name, "log_density"):
        label += f" more than {PeriodicGP.name}"
        shows += (
            f", minus those of {PeriodicGP.name}, over the training parts that both learned "
            f"from; the picture shows {_DENSITIES[0]:g} to {_DENSITIES[1]:g}"
        )
    figure = draw_lines(comparisons, label, fmean)
    if is_relative:
        figure.axes[0].set_ylim(*_DENSITIES)
    return Finding(
        name="benchmark_density",
        title="Log score: density of the true next second",
        shows=f"{shows}. Mean over movements, and the least. Methods without numbers have no "
        f"uncertainty, or did not learn. {_IN_BRACKETS}"
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
    figure = draw_lines(last, "inside after 1 s (%)", fmean)
    figure.axes[0].axhspan(*_COVERAGE_BAND, color="0.93", zorder=0)
    return Finding(
        name="benchmark_coverage",
        title="Coverage of the 95 % tubes",
        shows="Percentage of the true samples inside after 0.25 / 0.5 / 1 s, mean over "
        "movements; 95 is ideal. The picture shows 1 s, and a grey band from "
        f"{_COVERAGE_BAND[0]} to {_COVERAGE_BAND[1]} %. {_IN_BRACKETS}",
        figure=figure,
        table=_table(scores, coverage, show),
    )


def _playback(scores: _Scores) -> Finding:
    def summary(values: Array, form: str) -> str:
        low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
        return f"{middle:{form}} ({low:{form}} to {high:{form}})"

    runs = {name: m.playbacks for name, m in scores.items() if m.playbacks}
    figure, axes, table = summarise_runs(
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
        shows="Each continues half a second of a held-out part; the first 10 s are not "
        "scored. Stays near: samples whose distance from the demonstrated path is less than "
        "15 % of the size of the movement. Size and tempo relative to "
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
    figure, _, table = summarise_runs(
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
        table=rows if cases else None,
    )


def write_benchmark(out: Path, scores: _Scores, *, folder: Path) -> None:
    """Write report.html of all methods into a folder."""
    name = folder.resolve().name
    count = len({row["movement"] for m in scores.values() for row in m.predictions})
    failures = [
        f"{method} could not {task} {len(errors)} of {count_text(len(rows), what)}: "
        f"{errors[0].rstrip('.')}."
        for method, m in scores.items()
        for task, what, rows in (
            ("learn from, or predict,", "split", m.predictions),
            ("clean the board in", "run", m.cleaning),
        )
        if (errors := [row["error"] for row in rows if "error" in row])
    ]
    methods = count_text(len(scores), "method")
    introduction = (
        f"{methods} on {count_text(count, 'movement')} in `{name}`, 20 samples per second. "
        "Each method learns from some cycles, observes half a second of a held-out part, and "
        "predicts the next second."
        if count
        else f"{methods}, which clean the board."
    )
    write_report(
        out,
        sections=[("All methods", benchmark_findings(scores))],
        introduction=" ".join([introduction, *failures]),
        results={name: asdict(method) for name, method in scores.items()},
        title=f"Benchmark: {name if count else 'cleaning'}",
    )
