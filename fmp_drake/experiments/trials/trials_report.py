"""Report of the trials of a store: success rates, faults and infeasible scenarios."""

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import binomtest

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.report import Finding, Section, write_report
from fmp_drake.experiments.trials.store import Trial, TrialStore
from fmp_drake.numeric import is_number
from fmp_drake.plots.style import (
    DEMONSTRATED,
    PLAYED,
    SAMPLED,
    label_decades,
    legend_above,
    set_title,
)
from fmp_drake.primitives.data.channels import listed
from fmp_drake.primitives.data.reading.table import count_text
from fmp_drake.runs.judging import (
    LEAST_PRESSED,
    MOST_FORCE_ERROR,
    MOST_TILT,
    MOST_TILT_WITH_FRICTION,
    faults,
    largest_push,
    misses_by_height,
    on_board_rms,
    pushes,
    undisturbed_force_fraction,
)
from fmp_drake.runs.metrics import RECOVERY

# Kinds of faults that must never occur, and all kinds, with their titles.
_NEVER = {
    "through": "bodies through another",
    "nan": "NaN",
    "limit": "limits broken",
    "exception": "exceptions",
}
_KINDS = {
    **_NEVER,
    "path": "path missed",
    "tilt": "orientation missed",
    "press": "normal force missed",
    "force": "excess force",
    "stop": "protective stop",
    "touch": "arm on the board",
}
_NO_VIOLATION = "no body through another, no NaN, no limit broken, no exception"
_NOT_MEASURED = " The penetration of bodies was not measured."
# Required success rate, and greatest number of rows in the tables of trials.
_REQUIRED_RATE, _ROWS = 0.99, 20
# Bins of a parameter, and pictures in a row.
_BINS, _COLUMNS = 6, 4
# Letters that fit beside each other below a picture.
_MOST_LETTERS = 24
# Least number of trials that shows the influence of a parameter in several bins.
_LEAST_TRIALS = 16
# Ratio of a parameter's extremes above which its axis is logarithmic.
_DECADE = 10.0


class TrialsReport:
    """Report of the trials of a store.

    A trial passes if it is feasible and its run has no fault.

    Parameters
    ----------
    store : TrialStore
        With at least one trial.

    Examples
    --------
    >>> TrialsReport(TrialStore(Path("out"), {"duration": "9.0", "seed": "0"}))
    Traceback (most recent call last):
    fmp_drake.errors.ExperimentError: there are no trials in out yet.
    """

    def __init__(self, store: TrialStore) -> None:
        self._folder, self._plan = store.folder, store.plan
        self._trials = store.trials()
        if not self._trials:
            raise ExperimentError(f"there are no trials in {store.folder} yet.")
        self._duration = float(self._plan["duration"])
        run = [t for t in self._trials if t.was_run]
        self._faults = {t.number: faults(t, self._duration) for t in run}
        self._run = [t for t in self._trials if t.is_feasible and t.was_run]
        self._refused = [t for t in self._trials if not t.is_feasible]
        self._failed = [t for t in self._run if self._faults[t.number]]
        on_board = [t.metrics for t in self._run if t.metrics and t.has_board]
        is_measured = all("penetration_max_m" in metrics for metrics in on_board)
        self._remark = "" if is_measured else _NOT_MEASURED
        self._failed.sort(key=lambda t: -self._faults[t.number][0].severity)
        # Time of one core, with that for infeasible trials.
        self._cpu_seconds = sum(trial.cpu_seconds for trial in self._trials)
        self._run_per_hour = 3600 * len(run) / max(self._cpu_seconds, 1e-3)

    def write(self, page: Path | None = None) -> None:
        """Write report.html into the folder of the store, and optionally a Markdown page."""
        sections: list[Section] = [
            ("Verdict", [self._violations(), self._accuracy()]),
            ("Failed trials", [self._success(), self._worst()]),
            ("Infeasible trials", [self._refusals()]),
        ]
        results = {
            "trials": len(self._trials),
            "refused": len(self._refused),
            "faults": self._count(self._run),
            "worst": [trial.number for trial in self._failed[:_ROWS]],
            "cpu_seconds": self._cpu_seconds,
            "run_per_hour": self._run_per_hour,
        }
        write_report(
            self._folder,
            sections=sections,
            introduction=self.verdict(),
            results=results,
            title=f"{len(self._trials)} trials of {self._duration:g} s",
            markdown=page,
        )

    def verdict(self) -> str:
        """Return a summary of the trials in a few sentences."""
        n, passed = len(self._run), len(self._run) - len(self._failed)
        counts = self._count(self._run)
        found = [
            f"{counts[k]} with {title}" for k, title in _KINDS.items() if counts[k]
        ]
        if not any(counts[kind] for kind in _NEVER):
            found.append(_NO_VIOLATION)
        return (
            f"Of {count_text(len(self._trials), 'trial')}, drawn with seed "
            f"{self._plan['seed']}, the feasibility check refuses {len(self._refused)}. "
            f"Of the {count_text(n, 'other trial')} {passed} passed ({_percent(passed, n)}), "
            f"{', '.join(found)}. "
            f"The runs took {self._cpu_seconds / 3600:.2f} hours of one core, at a rate of "
            f"{self._run_per_hour:.0f} per hour, with the code "
            f"{', '.join(sorted({trial.code for trial in self._trials}))}.{self._remark}"
        )

    def _count(self, trials: Sequence[Trial]) -> dict[str, int]:
        """Return the number of trials with each kind of fault."""
        kinds = [{fault.kind for fault in self._faults[t.number]} for t in trials]
        return {kind: sum(kind in faulty for faulty in kinds) for kind in _KINDS}

    def _by_push(self) -> dict[str, list[Trial]]:
        pushed = {t.number for t in self._run if pushes(t, self._duration)}
        return {
            "without disturbances": [t for t in self._run if t.number not in pushed],
            "with disturbances": [t for t in self._run if t.number in pushed],
        }

    def _violations(self) -> Finding:
        groups = {"all feasible trials": self._run, **self._by_push()}
        for name in ("base", "skill.demonstration"):
            for trial in sorted(self._run, key=lambda t: str(t.parameters.get(name))):
                if name in trial.parameters:
                    groups.setdefault(str(trial.parameters[name]), []).append(trial)
        groups["run although infeasible"] = [t for t in self._refused if t.was_run]
        columns = ["", "trials", "passed", "95 % interval", *_KINDS.values()]
        columns += ["distance from the path, median", "cleaned, median"]
        counts = self._count(self._run)
        numbers = [f"{counts[kind]} {title}" for kind, title in _NEVER.items()]
        return Finding(
            name="impossible",
            title="Faults that must never occur",
            shows=f"{', '.join(numbers)}, in {len(self._run)} trials.{self._remark}",
            claim=f"N{_NO_VIOLATION[1:]}.",
            agrees=not self._remark and not any(counts[kind] for kind in _NEVER),
            table=[columns, *(self._row(k, v) for k, v in groups.items() if v)],
        )

    def _row(self, name: str, trials: Sequence[Trial]) -> list[str]:
        n, passed = len(trials), sum(not self._faults[t.number] for t in trials)
        low, high = interval(passed, n)
        fraction = "cleaned_fraction_of_demonstrated_area"
        measured = [t.metrics for t in trials if t.metrics]
        cleaned = [100 * m[fraction] for m in measured if fraction in m]
        rms = [1e3 * on_board_rms(t) for t in trials if t.metrics]
        return [
            name,
            str(n),
            _percent(passed, n),
            f"{100 * low:.0f} to {100 * high:.0f} %",
            *map(str, self._count(trials).values()),
            _median(rms, "{:.1f} mm"),
            _median(cleaned, "{:.0f} %"),
        ]

    def _accuracy(self) -> Finding:
        n, misses = len(self._run), {"path", "tilt", "press", "exception"}
        kinds = [{fault.kind for fault in self._faults[t.number]} for t in self._run]
        accurate = sum(not faulty & misses for faulty in kinds)
        high = [t.number for t in self._run if misses_by_height(t)]
        errors = {
            name: [
                (on_board_rms(t) / t.tolerance, undisturbed_force_fraction(t))
                for t in trials
                if t.metrics
            ]
            for name, trials in self._by_push().items()
        }
        tolerances = sorted({1e3 * t.tolerance for t in self._run})
        extremes = dict.fromkeys((*tolerances[:1], *tolerances[-1:]))
        tolerance = " to ".join(f"{value:g}" for value in extremes)
        remark = (
            " The distance is measured on the actual board. From the assumed board, "
            f"with rigid felt, it is too large in these trials: {listed(high, most=_ROWS)}."
        )
        return Finding(
            name="followed",
            title="Path, orientation and normal force",
            shows=f"{accurate} of {n} trials, {_percent(accurate, n)}. Of trials with "
            "disturbances contact, orientation and a force of the skill are not judged."
            f"{remark if high else ''}",
            claim=f"Of the feasible trials at least {100 * _REQUIRED_RATE:.0f} % stay "
            f"within their tolerance, {tolerance} mm rms, of their path and within 5 N of the "
            f"desired force for {100 * LEAST_PRESSED:.0f} % of the time in contact, outside "
            f"disturbances and the {RECOVERY:g} s after each. A force of the skill is followed "
            f"to {MOST_FORCE_ERROR:g} N rms, its orientation to {MOST_TILT:g} degrees ({MOST_TILT_WITH_FRICTION:g} with joint "
            "friction).",
            agrees=n > 0 and accurate >= _REQUIRED_RATE * n,
            figure=draw_figures(errors),
        )

    def _success(self) -> Finding:
        parameters = {
            name: [t.parameters[name] for t in self._run]
            for name in (self._run[0].parameters if self._run else ())
            if not name.endswith("seed")
            and all(name in t.parameters for t in self._run)
        }
        parameters["largest push (N)"] = [
            largest_push(t, self._duration) for t in self._run
        ]
        return Finding(
            name="success",
            title="Success rate against each parameter",
            shows="Points are success rates with their 95 % intervals, the grey line is the "
            "rate of all trials, and an orange tick is a failed trial. Numbers are binned.",
            figure=draw_success(
                parameters, [not self._faults[t.number] for t in self._run]
            ),
        )

    def _worst(self) -> Finding:
        rows = [
            [
                str(t.number),
                self._fault_text(t),
                _description(t, self._duration),
                self._command(t),
            ]
            for t in self._failed[:_ROWS]
        ]
        return Finding(
            name="worst",
            title="The worst trials",
            shows=f"{len(self._failed)} failed; the worst {len(rows)} are shown."
            if rows
            else "None failed.",
            table=[["trial", "faults", "scenario", "replay"], *rows] if rows else None,
        )

    def _refusals(self) -> Finding:
        n, forced = len(self._trials), [t for t in self._refused if t.was_run]
        passed = sum(not self._faults[t.number] for t in forced)
        rows = [
            [str(t.number), t.verdict, self._fault_text(t), self._command(t)]
            for t in (forced or self._refused)[:_ROWS]
        ]
        return Finding(
            name="refused",
            title="Reasons for refusal, and runs although infeasible",
            shows=f"{len(self._refused)} are refused, {_percent(len(self._refused), n)}. "
            f"{len(forced) or 'None'} were run although infeasible"
            f"{f', of which {passed} passed' * bool(forced)}.",
            table=[["trial", "reason", "run although infeasible", "replay"], *rows]
            if rows
            else None,
        )

    def _fault_text(self, trial: Trial) -> str:
        violations = self._faults.get(trial.number)
        if violations is None:
            return "not run"
        text = "; ".join(fault.text for fault in violations) or "passed"
        return f"{text}. The run reports: {trial.events}." if trial.events else text

    def _command(self, trial: Trial) -> str:
        page = f"trial_{trial.number}.html"
        folder = shlex.quote(str(self._folder))
        return f"`fmp-drake worlds {folder} --replay {trial.number} --html {page}`"


def _description(trial: Trial, duration: float) -> str:
    """Describe the scenario of a trial."""
    board, skill = trial.fields["board"], trial.fields["skill"]
    base, played = trial.parameters.get("base", ""), skill["demonstration"]
    played = skill.get("file") or played
    parts = [f"{base} {played}".strip(), f"tempo {skill['tempo']:.2f}"]
    if trial.has_board:
        height = board["error"]["translation"][2]
        position = ", ".join(f"{value:.2f}" for value in board["translation"])
        parts += [
            f"board at ({position}) m",
            f"{1e3 * abs(height):.1f} mm {'lower' if height < 0 else 'higher'} than assumed",
            f"felt of {trial.fields['eraser']['modulus'] / 1e3:.0f} kPa",
            f"{trial.fields['press']['force']:.1f} N",
        ]
    push = largest_push(trial, duration)
    return ", ".join([*parts, f"pushed with {push:.0f} N"] if push else parts)


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "-"


def _median(values: Sequence[float], form: str) -> str:
    """Return the median as text; it is NaN if a value is."""
    return form.format(np.median(values)) if values else "-"


def interval(passed: int, total: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a fraction.

    Source: E. B. Wilson, J. Am. Stat. Assoc. 22 (1927).
    """
    if total == 0:
        return 0.0, 1.0
    limits = binomtest(passed, total).proportion_ci(method="wilson")
    return float(limits.low), float(limits.high)


def draw_success(
    parameters: Mapping[str, Sequence[Any]], passed: Sequence[bool]
) -> Figure:
    """Draw the success rate against each parameter, with 95 % intervals.

    Numbers are in bins of equal counts, with a tick for every failed trial. A parameter
    with the same value in all trials is left out. For fewer than 16 trials, or where no
    parameter is left, the picture is a sentence that says so.

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
            if parameters
            else "No parameter differs between these trials."
        )
        figure.text(0.01, 0.4, text)
        return figure
    rows = math.ceil(len(parameters) / _COLUMNS)
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
    choices = {str(value): value for value in values}
    are_numbers = all(map(is_number, values))
    names = sorted(choices, key=choices.__getitem__ if are_numbers else None)
    for i, choice in enumerate(names):
        pairs = zip(values, passed, strict=True)
        _draw_fraction(ax, i, [ok for value, ok in pairs if str(value) == choice])
    labels = [
        f"{choices[n]:.3g}" if isinstance(choices[n], float) else n for n in names
    ]
    ax.set_xticks(range(len(names)), labels)
    if len(names) > 1 and sum(map(len, labels)) > _MOST_LETTERS:
        ax.tick_params(axis="x", rotation=30)
        for label in ax.get_xticklabels():
            label.set_horizontalalignment("right")
            label.set_rotation_mode("anchor")
    ax.set_xlim(-0.5, len(names) - 0.5)


def _draw_fraction(ax: Axes, x: float, passed: Sequence[bool]) -> None:
    low, high = interval(int(np.sum(passed)), len(passed))
    ax.plot([x, x], [100 * low, 100 * high], color=SAMPLED, linewidth=1.2, alpha=0.5)
    ax.plot(x, 100 * float(np.mean(passed)), "o", color=SAMPLED, markersize=4)


def draw_figures(groups: Mapping[str, Sequence[Sequence[float]]]) -> Figure:
    """Draw the distributions of path error and time with the desired force.

    Parameters
    ----------
    groups : mapping of str to sequence of pairs
        For each trial the rms path error, in tolerances, and the fraction of the time in
        contact within 5 N of the desired force; NaN in free space.
    """
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    path_axes, force_axes = figure.subplots(1, 2, sharey=True)
    for (name, pairs), color in zip(groups.items(), (SAMPLED, PLAYED), strict=True):
        if not pairs:
            continue
        rms, fractions = np.array(pairs, dtype=float).T
        # Nothing presses in free space.
        fractions = fractions[np.isfinite(fractions)]
        for ax, values in (
            (path_axes, 100 * np.sort(rms)),
            (force_axes, 100 * np.sort(-fractions)),
        ):
            order = 100 * np.arange(1, len(values) + 1) / len(values)
            ax.plot(np.abs(values), order, ".-", color=color, linewidth=1, label=name)
    path_axes.set_xscale("log")
    label_decades(path_axes.xaxis, (1.0, 2.0, 5.0))
    low, high = path_axes.get_xlim()
    path_axes.set_xlim(min(10, low), max(200, 1.1 * high))
    force_axes.set_xlim(min(90, force_axes.get_xlim()[0]), 100.5)
    path_axes.set_xlabel("rms distance from the path (% of the tolerance)")
    path_axes.set_ylabel("trials at least as good (%)")
    force_axes.set_xlabel("time in contact within 5 N of the desired force (%)")
    for ax, limit in ((path_axes, 100), (force_axes, 100 * LEAST_PRESSED)):
        ax.axvline(limit, color="0.3", linestyle=":", label="limit")
        ax.set_ylim(0, 103)
        ax.spines[["top", "right"]].set_visible(False)
    set_title(path_axes, "tracking error")
    set_title(force_axes, "normal force")
    legend_above(force_axes)
    return figure
