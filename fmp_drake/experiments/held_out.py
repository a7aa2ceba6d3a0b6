"""Held-out scores of the bundled demonstrations, by the benchmark (not in the paper)."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fmp_drake.experiments.baselines.method import RATE
from fmp_drake.experiments.benchmark.built_in import ABLATIONS, FMP, MixtureFMP
from fmp_drake.experiments.benchmark.report import benchmark_findings, mean_values
from fmp_drake.experiments.benchmark.run import (
    Job,
    MethodScores,
    chosen_methods,
    run_job,
    score_method,
)
from fmp_drake.experiments.benchmark.splits import ALL, make_movement
from fmp_drake.experiments.report import Finding, Profile
from fmp_drake.primitives import Demonstration

Scores = Mapping[str, MethodScores]

# Measures of the claim, and which of two values is better.
_MEASURES: dict[str, tuple[str, Callable[..., Any]]] = {
    "error_mm": ("next second, rms (mm)", min),
    "log_density": ("log density (nats per sample)", max),
}
# Cycles of a short recording.
_FEW = "8"


def score_demonstrations(
    demonstrations: Mapping[str, Demonstration],
    profile: Profile,
    progress: Callable[[str], None],
) -> dict[str, MethodScores]:
    """Score all methods but the ablations on demonstrations, as the benchmark does.

    Parameters
    ----------
    demonstrations : mapping of str to Demonstration
        Name to a recording whose channels are in metres.
    profile : Profile
        Sets the numbers of learned parts of each length and of predictions.
    progress : callable
        Called with a sentence about each step.
    """
    movements = [
        make_movement(name, [demonstration.resample(RATE).values])
        for name, demonstration in demonstrations.items()
    ]
    ablations = [method.name for method in ABLATIONS]
    scores: dict[str, MethodScores] = {}
    for name in chosen_methods(()):
        if name in ablations:
            continue
        scores[name] = MethodScores(method=name)
        for movement in movements:
            progress(f"held out: {movement.name}, {name}")
            score = partial(
                score_method,
                movement=movement,
                instants=profile.instants,
                places=profile.places,
            )
            scores[name].add(run_job(Job(method=name, score=score)))
    return scores


def held_out_findings(scores: Scores) -> list[Finding]:
    """Return the claims about each movement, and the benchmark's tables of all."""
    movements = {row["movement"]: None for row in scores[FMP.name].predictions}
    tables = [
        replace(finding, name=finding.name.replace("benchmark", "held_out"))
        for finding in benchmark_findings(scores)
    ]
    claims = [claim(scores, m) for m in movements for claim in (_best, _short)]
    return [*claims, *tables]


def _mean(
    scores: Scores, method: str, movement: str, *, measure: str, cycles: str = ALL
) -> float:
    """Return the mean of a measure over the learned parts; NaN without a value."""
    values = mean_values(scores[method], measure)
    return values.get(cycles, {}).get(movement, np.nan)


def _best(scores: Scores, movement: str) -> Finding:
    """Compare FMP with the best other method in each measure."""
    comparisons, wins = [], 0
    for measure, (title, better) in _MEASURES.items():
        means = {
            name: _mean(scores, name, movement, measure=measure) for name in scores
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


def _short(scores: Scores, movement: str) -> Finding:
    """Compare learning from few cycles with learning from two thirds of a recording."""
    short = _mean(scores, FMP.name, movement, measure="error_mm", cycles=_FEW)
    mixture = _mean(scores, MixtureFMP.name, movement, measure="error_mm")
    return Finding(
        name=f"short_{movement}",
        title=f"Learned from {_FEW} cycles: {movement}",
        shows=f"The next second is predicted with {short:.1f} mm by FMP learned from "
        f"{_FEW} cycles, and with {mixture:.1f} mm by the mixture learned from two thirds.",
        claim=f"FMP predicts from {_FEW} cycles as well as the mixture from two thirds.",
        agrees=short <= mixture,
    )
