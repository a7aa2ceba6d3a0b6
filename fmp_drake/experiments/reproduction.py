"""All experiments of section V, with wiping (V-D) and held-out scores (not in the paper)."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from fmp_drake.experiments.baselines.method import RATE
from fmp_drake.experiments.benchmark.built_in import ABLATIONS, FMP, METHODS, MixtureFMP
from fmp_drake.experiments.benchmark.findings import benchmark_findings, mean_values
from fmp_drake.experiments.benchmark.run import (
    MethodScores,
    Progress,
    run_job,
    score_method,
)
from fmp_drake.experiments.benchmark.splits import ALL, make_movement
from fmp_drake.experiments.comparison import (
    BINS,
    FLOOR,
    N_STEPS,
    draw_paths,
    millimetres,
)
from fmp_drake.experiments.report import Finding, Profile, Section
from fmp_drake.experiments.section_v import eight, polishing
from fmp_drake.numeric import Array
from fmp_drake.primitives import (
    PAPER_SETTINGS,
    Demonstration,
    FourierMovementPrimitive,
    Player,
)
from fmp_drake.runs import WipingRun
from fmp_drake.skills import default_demonstration
from fmp_drake.station import Scenario

# Wiping: length of a path, samples of 1/20 s, and its start in the frame of the board, m.
_LENGTH, _START = 400, (0.05, 0.20, 0.05)
# Measures of the claim about held-out scores: title, and function that returns the better.
_MEASURES: dict[str, tuple[str, Callable[..., Any]]] = {
    "error_mm": ("Error of the next second, rms (mm)", min),
    "log_density": ("Log density (nats per sample)", max),
}
# Cycles of a short recording.
_FEW_CYCLES = "8"


def run_experiments(
    profile: Profile, progress: Progress
) -> tuple[list[Section], dict[str, Any]]:
    """Run all experiments; return the sections of the report and the results.

    Parameters
    ----------
    profile : Profile
    progress : callable
        Called with a message about each step.
    """
    bundled = {
        task: Demonstration.load(default_demonstration(task))
        for task in ("polishing", "eight", "wiping")
    }
    progress("polishing: Figs. 3 to 6")
    sections: list[Section] = [
        ("Polishing (V-B)", polishing(bundled["polishing"], profile))
    ]
    progress("8-shape: Figs. 7 to 9, Table I")
    findings, table = eight(bundled["eight"], profile)
    sections.append(("8-shape (V-C)", findings))
    progress("wiping: Fig. 10, and with the robot")
    sections.append(("Wiping (V-D)", wiping(bundled["wiping"], profile)))
    results: dict[str, Any] = {"table1": table, "settings": _settings(profile)}
    scores = score_demonstrations(
        {task: bundled[task] for task in profile.tasks}, profile, progress
    )
    results["held_out"] = {name: asdict(method) for name, method in scores.items()}
    sections.append(("Held out (beyond the paper)", held_out_findings(scores)))
    results["findings"] = {
        f.name: {"shows": f.shows, "claim": f.claim, "agrees": f.agrees}
        for _, group in sections
        for f in group
    }
    return sections, results


def wiping(demonstration: Demonstration, profile: Profile) -> list[Finding]:
    """Play wiping for 400 samples, with means and with samples, also with the robot."""
    skill = FourierMovementPrimitive().fit(demonstration)
    paths, cells, measured_paths, errors = {}, [], {}, []
    for sample, title in ((False, "mean"), (True, "sample")):
        path = Player(skill, sample=sample).rollout(_START, 60.0)[:, 0]
        paths[f"tracking the {title}"] = path[: _LENGTH + 1]
        cells.append(_visited_cells(path))
        run = WipingRun(
            Scenario(),
            skill,
            demonstrations=[demonstration],
            start=_START,
            sample=sample,
            keep=["measured_position"],
        )
        run.advance_to(profile.robot_duration)
        measured_paths[f"{title}, measured"] = run.log("measured_position")[::4]
        errors.append(run.metrics()["tracking_rms_m"] or 0.0)
    return [
        Finding(
            name="fig10",
            title="Fig. 10: generated trajectories of length 400 (20 s)",
            shows=f"In 60 s the tool visits {cells[0]} cells of 5 mm tracking the means "
            f"(left), {cells[1]} tracking samples (right).",
            claim="Movements of any length; sampling gives them much more variability.",
            agrees=cells[1] > 2 * cells[0],
            figure=draw_paths(demonstration, paths),
        ),
        Finding(
            name="fig10_robot",
            title="Fig. 10, executed by the simulated arm",
            shows=f"{profile.robot_duration:g} s on the whiteboard, with a tracking error of "
            f"{millimetres(errors[0])} (mean) and {millimetres(errors[1])} (sample) rms.",
            claim="An impedance controller with fixed orientation executes them.",
            agrees=max(errors) < 0.01,
            figure=draw_paths(demonstration, measured_paths),
        ),
    ]


def _visited_cells(path: Array) -> int:
    """Return the number of 5 mm cells in the plane that a path (ticks, D) visits."""
    ticks = np.arange(len(path))
    fine = np.linspace(0, len(path) - 1, 20 * len(path))
    points = np.stack([np.interp(fine, ticks, path[:, i]) for i in (0, 1)], axis=1)
    return len(np.unique(np.floor(points / 0.005).astype(int), axis=0))


def score_demonstrations(
    demonstrations: Mapping[str, Demonstration],
    profile: Profile,
    progress: Progress,
) -> dict[str, MethodScores]:
    """Score the built-in methods but ablations on demonstrations, as in the benchmark.

    Parameters
    ----------
    demonstrations : mapping of str to Demonstration
        Recordings by name; their channels are in metres.
    profile : Profile
        With the numbers of training parts of each length and of predictions.
    progress : callable
        Called with a message about each step.
    """
    movements = [
        make_movement(name, [demonstration.resample(RATE).values])
        for name, demonstration in demonstrations.items()
    ]
    scores: dict[str, MethodScores] = {}
    for name in [method.name for method in METHODS if method not in ABLATIONS]:
        scores[name] = MethodScores(method=name)
        for movement in movements:
            progress(f"held out: {movement.name}, {name}")
            score = partial(
                score_method,
                movement=movement,
                instants=profile.instants,
                places=profile.places,
            )
            scores[name].add(run_job((name, score)))
    return scores


def held_out_findings(scores: Mapping[str, MethodScores]) -> list[Finding]:
    """Return the claims about each movement, and the benchmark's tables of all."""
    movements = {row["movement"]: None for row in scores[FMP.name].predictions}
    tables = [
        replace(finding, name=finding.name.replace("benchmark", "held_out"))
        for finding in benchmark_findings(scores)
    ]
    claims = [
        finding(scores, movement)
        for movement in movements
        for finding in (_best_prediction, _prediction_from_few_cycles)
    ]
    return [*claims, *tables]


def _mean(
    scores: MethodScores, movement: str, *, measure: str, cycles: str = ALL
) -> float:
    """Return the mean of a measure over the training parts; NaN without a value."""
    return mean_values(scores, measure).get((cycles, movement), np.nan)


def _best_prediction(scores: Mapping[str, MethodScores], movement: str) -> Finding:
    """Compare FMP with the best other method in each measure."""
    comparisons, wins = [], 0
    for measure, (title, better) in _MEASURES.items():
        means = {
            name: _mean(method, movement, measure=measure)
            for name, method in scores.items()
        }
        fmp, mixture = means.pop(FMP.name), means.pop(MixtureFMP.name)
        rival = better(
            (name for name in means if np.isfinite(means[name])),
            key=means.__getitem__,
        )
        wins += better(fmp, means[rival]) == fmp
        comparisons.append(
            f"{title}: FMP {fmp:.2f}, its mixture {mixture:.2f}; best other "
            f"{means[rival]:.2f} ({rival})"
        )
    return Finding(
        name=f"held_out_{movement}",
        title=f"Held out: {movement}",
        shows=f"Learned from two thirds, FMP is best in {wins} of {len(_MEASURES)} "
        f"measures. {'. '.join(comparisons)}.",
        claim="FMP generalises better than every other method, in every measure.",
        agrees=wins == len(_MEASURES),
    )


def _prediction_from_few_cycles(
    scores: Mapping[str, MethodScores], movement: str
) -> Finding:
    """Compare learning from few cycles with learning from two thirds of a recording."""
    error = _mean(scores[FMP.name], movement, measure="error_mm", cycles=_FEW_CYCLES)
    mixture_error = _mean(scores[MixtureFMP.name], movement, measure="error_mm")
    return Finding(
        name=f"short_{movement}",
        title=f"Learned from {_FEW_CYCLES} cycles: {movement}",
        shows=f"The next second is predicted with {error:.1f} mm by FMP learned from "
        f"{_FEW_CYCLES} cycles, and with {mixture_error:.1f} mm by the mixture learned from two thirds.",
        claim=f"FMP predicts from {_FEW_CYCLES} cycles as well as the mixture from two thirds.",
        agrees=error <= mixture_error,
    )


def _settings(profile: Profile) -> dict[str, Any]:
    return {
        "fmp": FourierMovementPrimitive().get_params(),
        "fmp_paper": PAPER_SETTINGS,
        "n_steps": N_STEPS,
        "rate_hz": RATE,
        "bins": BINS,
        "floor": FLOOR,
        **asdict(profile),
    }
