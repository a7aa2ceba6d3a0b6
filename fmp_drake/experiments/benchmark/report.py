"""Report of the benchmark: tables and pictures of all methods."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import wilcoxon

from fmp_drake.experiments.baselines.delay_gp import DelayGP
from fmp_drake.experiments.baselines.method import Array
from fmp_drake.experiments.baselines.periodic_gp import PeriodicGP
from fmp_drake.experiments.benchmark.built_in import FMP, ReplayMethod
from fmp_drake.experiments.benchmark.run import MethodScores
from fmp_drake.experiments.benchmark.scores import STEPS
from fmp_drake.experiments.benchmark.splits import ALL, CYCLES
from fmp_drake.experiments.report import Finding, write_report
from fmp_drake.plots.style import PLAYED, SAMPLED, component_color, label_decades

_COLUMNS = (*(f"{cycles:g}" for cycles in CYCLES), ALL)
_GUARANTEED = (85, 99)  # Per cent of the true samples in the tubes.

_Scores = Mapping[str, MethodScores]


def benchmark_findings(scores: _Scores) -> list[Finding]:
    """Return the tables and pictures of all methods."""
    cleaned = {run["movement"] for m in scores.values() for run in m.cleaning}
    return [
        _errors(scores),
        _densities(scores),
        _coverage(scores),
        _playback(scores),
        *(_cleaning(scores, recording) for recording in sorted(cleaned)),
        _movements(scores),
    ]


def mean_values(scores: MethodScores, measure: str) -> dict[str, dict[str, float]]:
    """Return a measure by cycles and movement, the mean over the learned parts."""
    gathered: dict[str, dict[str, list[float]]] = {}
    for row in scores.predictions:
        value = row.get(measure)
        if value is not None:
            by_movement = gathered.setdefault(row["cycles"], {})
            by_movement.setdefault(row["movement"], []).append(value)
    return {
        cycles: {name: float(np.mean(v)) for name, v in by_movement.items()}
        for cycles, by_movement in gathered.items()
    }


def _compared(
    scores: _Scores,
    measure: str,
    reference: str,
    compare: Callable[[float, float], float],
) -> dict[str, dict[str, list[float]]]:
    """Return method to cycles to comparisons with a reference, one for each movement."""
    base = mean_values(scores[reference], measure) if reference in scores else {}
    return {
        name: {
            cycles: [
                compare(value, base[cycles][movement])
                for movement, value in by_movement.items()
                if movement in base.get(cycles, {})
            ]
            for cycles, by_movement in mean_values(method, measure).items()
        }
        for name, method in scores.items()
    }


def _columns(known: Iterable[str]) -> list[str]:
    """Return the numbers of cycles that are known, in order."""
    known = set(known)
    return [cycles for cycles in _COLUMNS if cycles in known]


def _table(
    scores: _Scores,
    compared: Mapping[str, Mapping[str, Sequence[float]]],
    show: Callable[[Sequence[float]], str],
) -> list[list[str]]:
    """Return a table of methods and cycles; the header counts the movements."""
    cases = {
        (row["cycles"], row["movement"])
        for method in scores.values()
        for row in method.predictions
    }
    known = [cycles for cycles, _ in cases]
    counts = {cycles: known.count(cycles) for cycles in _columns(known)}
    header = [f"{cycles} ({count})" for cycles, count in counts.items()]
    rows = [["cycles learned from (movements)", *header]]
    for name in scores:
        cells = []
        for cycles, count in counts.items():
            values = compared[name].get(cycles, [])
            text = show(values) if values else "-"
            if values and len(values) < count:
                text += f" [{len(values)}]"
            cells.append(text)
        rows.append([name, *cells])
    return rows


def _errors(scores: _Scores) -> Finding:
    compared = _compared(scores, "error_mm", ReplayMethod.name, lambda a, b: a / b)

    def show(ratios: Sequence[float]) -> str:
        logs = np.log(ratios)
        return f"{np.exp(logs.mean()):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"

    mine = [r for values in compared.get(FMP.name, {}).values() for r in values]
    text = ""
    if mine:
        text = (
            f"{FMP.name}: {np.exp(np.mean(np.log(mine))):.2f} of replay's error in the "
            f"geometric mean of all {len(mine)} cases, at most replay's in "
            f"{sum(r <= 1 for r in mine)}. {_against_the_best(scores, 'error_mm', min)}"
        )
    return Finding(
        name="benchmark_error",
        title="Error of the next second, relative to replay",
        shows=f"{text}Geometric mean over movements, and the range. In square brackets: "
        "movements that the method can learn from, where it cannot learn from all. "
        f"{_significance(scores)}",
        figure=_lines(
            compared,
            "error / error of replay",
            lambda values: float(np.exp(np.mean(np.log(values)))),
            log=True,
        ),
        table=_table(scores, compared, show),
    )


def _against_the_best(
    scores: _Scores, measure: str, best: Callable[[Iterable[float]], float]
) -> str:
    """Return a sentence that counts the cases no worse than the best simple method."""
    names = [DelayGP.name, PeriodicGP.name]
    if measure != "log_density":
        names = [ReplayMethod.name, *names]
    names = [name for name in names if name in scores]
    rivals = [_cases(scores, name, measure) for name in names]
    wins = [
        best((value, *theirs)) == value
        for case, value in _cases(scores, FMP.name, measure).items()
        if (theirs := [rival[case] for rival in rivals if case in rival])
    ]
    text = (
        f"No worse than the best of {', '.join(names)} in {sum(wins)} of {len(wins)} "
        "cases. "
    )
    return text if wins else ""


def _cases(scores: _Scores, method: str, measure: str) -> dict[tuple[str, str], float]:
    """Return a measure of a method by cycles and movement."""
    values = mean_values(scores[method], measure) if method in scores else {}
    return {
        (cycles, movement): value
        for cycles, by_movement in values.items()
        for movement, value in by_movement.items()
    }


def _significance(scores: _Scores) -> str:
    """Return a sentence about paired tests over all cases."""
    mine = _cases(scores, FMP.name, "error_mm")
    parts = []
    for name in scores:
        # The mean over cycles of each movement: cases of one movement are not independent.
        logs: dict[str, list[float]] = {}
        for case, value in _cases(scores, name, "error_mm").items():
            if case in mine:
                logs.setdefault(case[1], []).append(float(np.log(mine[case] / value)))
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
    compared = _compared(scores, "log_density", PeriodicGP.name, lambda a, b: a - b)

    def show(differences: Sequence[float]) -> str:
        return f"{np.mean(differences):+.1f} (least {min(differences):+.1f})"

    return Finding(
        name="benchmark_density",
        title="Log score: density of the true next second",
        shows=f"Nats per sample, mean over the second, minus those of {PeriodicGP.name}: "
        "mean over movements, and the least. Methods without a row of numbers have no "
        f"uncertainty. {_against_the_best(scores, 'log_density', max)}",
        figure=_lines(
            compared,
            f"nats per sample more than {PeriodicGP.name}",
            lambda values: float(np.mean(values)),
            limits=(-12.0, 8.0),
        ),
        table=_table(scores, compared, show),
    )


def _coverage(scores: _Scores) -> Finding:
    inside = {
        name: [mean_values(method, f"inside_{step}") for step in STEPS]
        for name, method in scores.items()
    }
    compared = {
        name: {c: [100 * v for v in values[-1].get(c, {}).values()] for c in _COLUMNS}
        for name, values in inside.items()
    }
    rows = _table(scores, compared, lambda _: "")
    columns = _columns(header.split()[0] for header in rows[0][1:])
    for row, name in zip(rows[1:], scores, strict=True):
        for i, cycles in enumerate(columns, start=1):
            means = [
                f"{100 * np.mean(list(values[cycles].values())):.0f}"
                for values in inside[name]
                if values.get(cycles)
            ]
            row[i] = " / ".join(means) or "-"
    return Finding(
        name="benchmark_coverage",
        title="Coverage of the 95 % tubes",
        shows="Per cent of the true samples inside after 0.25 / 0.5 / 1 s, mean over "
        "movements; 95 is ideal. The picture shows 1 s.",
        figure=_lines(
            compared,
            "inside after 1 s (%)",
            lambda values: float(np.mean(values)),
            band=_GUARANTEED,
        ),
        table=rows,
    )


def _playback(scores: _Scores) -> Finding:
    def summary(values: Array, form: str) -> str:
        low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
        return f"{middle:{form}} ({low:{form}} to {high:{form}})"

    names = [name for name, method in scores.items() if method.playbacks]
    figure, axes, rows = _runs(
        {name: scores[name].playbacks for name in names},
        {
            "stays": ("stays near (%)", 100.0, ".0f"),
            "size": ("size", 1.0, ".2f"),
            "tempo": ("tempo", 1.0, ".2f"),
            "variety": ("variety", 1.0, ".2f"),
        },
        summary,
        lost="none in {}",
    )
    for ax, demonstrated in zip(axes, (100, 1, 1, 1), strict=True):
        ax.axvline(demonstrated, color="0.8", zorder=0)
    for ax in axes[1:]:
        ax.set_xlim(0, 2)
    table = [
        ["", "minutes", *rows[0]],
        *(
            [name, str(len(scores[name].playbacks)), *cells]
            for name, cells in zip(names, rows[1:], strict=True)
        ),
    ]
    return Finding(
        name="benchmark_playback",
        title="Playback of a minute",
        shows="From a held-out second; the first 10 s are not judged. Stays: samples within "
        "15 % of the movement's size of the demonstrated path. Size and tempo relative to "
        "the demonstration. Variety: difference of successive cycles, relative to that of "
        "the demonstration; 0 repeats itself exactly. Median, and the range of 80 %; "
        "'none' counts playbacks in which no cycle repeats.",
        figure=figure,
        table=table,
    )


def _cleaning(scores: _Scores, recording: str) -> Finding:
    """Return the table and picture of the task metric for a recording."""
    every = {
        name: runs
        for name, method in scores.items()
        if (runs := [r for r in method.cleaning if r["movement"] == recording])
    }
    done = {n: [r for r in runs if "error" not in r] for n, runs in every.items()}
    figure, _, rows = _runs(
        done,
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
        lost="{} never",
    )
    table = [
        ["", "runs", *rows[0]],
        *(
            [name, f"{len(done[name])} of {len(runs)}", *cells]
            for (name, runs), cells in zip(every.items(), rows[1:], strict=True)
        ),
    ]
    cycles = ", ".join(
        sorted({run["cycles"] for runs in every.values() for run in runs})
    )
    return Finding(
        name=f"benchmark_cleaning_{recording}",
        title=f"Task: how soon a minute of each method cleans the board, {recording}",
        shows=f"Learned from {cycles} cycles of {recording}; the same station follows the "
        "path that each method plays, from other samples of the recording with each seed. "
        "Times until that part of the area is clean which the whole recording sweeps. "
        "Mean and standard deviation over runs; 'never' counts runs that do not get there.",
        figure=figure,
        table=table,
    )


def _runs(
    runs: Mapping[str, Sequence[Mapping[str, Any]]],
    measures: Mapping[str, tuple[str, float, str]],
    summary: Callable[[Array, str], str],
    *,
    lost: str,
) -> tuple[Figure, Sequence[Axes], list[list[str]]]:
    """Draw the first four measures of runs, and summarise all.

    Parameters
    ----------
    runs : mapping of str to sequence of mapping
        Runs of each method.
    measures : mapping of str to tuple
        Title, factor and number format of each measure.
    summary : callable
        Returns the text for values and a number format.
    lost : str
        Text that counts the runs without a value.

    Returns
    -------
    figure : Figure
        A mark for each run, and a point at the median of each method.
    axes : sequence of Axes
    rows : list of list of str
        The titles, then a row for each method.
    """
    figure = Figure(figsize=(12, 0.9 + 0.3 * len(runs)), layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    rows = [[title for title, _, _ in measures.values()]]
    for row, (name, own) in enumerate(runs.items()):
        cells = []
        for i, (measure, (_, factor, form)) in enumerate(measures.items()):
            known = [run[measure] for run in own if run[measure] is not None]
            if not known:
                cells.append("-")
                continue
            values = factor * np.array(known, dtype=float)
            if i < len(axes):
                color = SAMPLED if name == FMP.name else "0.5"
                axes[i].plot(values, [row] * len(values), "|", color=color, alpha=0.6)
                axes[i].plot(np.median(values), row, "o", color=PLAYED, markersize=4)
            missing = len(own) - len(known)
            also = f", {lost.format(missing)}" if missing else ""
            cells.append(f"{summary(values, form)}{also}")
        rows.append(cells)
    for ax, title in zip(axes, rows[0], strict=False):
        ax.set_title(title, loc="left", fontsize="medium")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(range(len(runs)), list(runs))
    axes[0].invert_yaxis()
    return figure, axes, rows


def _movements(scores: _Scores) -> Finding:
    values = [mean_values(m, "error_mm").get(ALL, {}) for m in scores.values()]
    rows = [["", *scores]]
    for movement in sorted(set().union(*values)):
        cells = [f"{own[movement]:.1f}" if movement in own else "-" for own in values]
        rows.append([movement, *cells])
    return Finding(
        name="benchmark_movements",
        title="Error of the next second of each movement, mm",
        shows="Learned from two thirds, or from all recordings but one.",
        table=rows,
    )


def _lines(
    compared: Mapping[str, Mapping[str, Sequence[float]]],
    label: str,
    mean: Callable[[Sequence[float]], float],
    *,
    log: bool = False,
    limits: tuple[float, float] | None = None,
    band: tuple[float, float] | None = None,
) -> Figure:
    """Draw a measure over the cycles, one line for each method."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    ax: Axes = figure.subplots()
    if band is not None:
        ax.axhspan(*band, color="0.93", zorder=0)
    columns = _columns(c for by in compared.values() for c in by if by[c])
    for number, (name, by_cycles) in enumerate(compared.items()):
        at = [i for i, c in enumerate(columns) if by_cycles.get(c)]
        style: dict[str, Any] = {"linewidth": 2.6, "color": SAMPLED, "marker": "o"}
        if name == FMP.name:
            style["zorder"] = 4
            for i in at:
                values = by_cycles[columns[i]]
                ax.plot([i] * len(values), values, "_", color=SAMPLED, alpha=0.5)
        else:
            style = {"linewidth": 1.1, "color": component_color(number), "marker": "."}
            style["linestyle"] = "--" if number >= 10 else "-"
        if at:
            means = [mean(by_cycles[columns[i]]) for i in at]
            ax.plot(at, means, label=name, **style)
    ax.set_xticks(range(len(columns)), columns)
    ax.margins(x=0.1)
    ax.set_xlabel("cycles learned from")
    ax.set_ylabel(label)
    if log:
        ax.set_yscale("log")
        label_decades(ax.yaxis, (1.0, 2.0, 5.0))
        ax.axhline(1.0, color="0.6", linewidth=1, zorder=0)
    if limits is not None:
        ax.set_ylim(*limits)
    ax.spines[["top", "right"]].set_visible(False)
    if ax.get_legend_handles_labels()[0]:
        figure.legend(loc="outside right upper", frameon=False, fontsize="small")
    return figure


def write_benchmark(out: Path, scores: _Scores, *, folder: Path) -> None:
    """Write report.html of all methods into a folder."""
    count = len({row["movement"] for m in scores.values() for row in m.predictions})
    failed = {
        name: [row["error"] for row in method.predictions if "error" in row]
        for name, method in scores.items()
    }
    failures = [
        f"{name} could not learn from {len(errors)} of {len(scores[name].predictions)} "
        f"splits: {errors[0]}"
        for name, errors in failed.items()
        if errors
    ]
    introduction = (
        f"{len(scores)} methods on {count} movements in `{folder.name}`, 20 "
        "samples per second. Each method learns from some cycles, observes half a second "
        "of what it has not learned from, and predicts the next second. "
        + " ".join(failures)
    )
    write_report(
        out,
        sections=[("All methods", benchmark_findings(scores))],
        introduction=introduction,
        results={name: asdict(method) for name, method in scores.items()},
        title=f"Benchmark: {folder.name}",
    )
