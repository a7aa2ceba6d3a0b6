"""Held-out evaluation, which the paper lacks."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.experiments.finding import Finding
from fmp_drake.experiments.methods import (
    FMP,
    FMP_PAPER,
    N_STEPS,
    PAPER_STRIDE,
    RATE,
    compared,
    cut,
)
from fmp_drake.experiments.metrics import divergences, grid_extent
from fmp_drake.experiments.profile import Profile
from fmp_drake.primitives import Demonstration

PREFIX = 10
HORIZON = 20
FLOOR_ROW = "learning part itself"
_SAMPLES = 2000
MEASURES = {
    "log_density": "log density (nats per step)",
    "forward_kl": "forward KL",
    "reverse_kl": "reverse KL",
    "prediction_rms": "next second, rms (mm)",
}

Scores = dict[str, dict[str, list[float]]]


def evaluate(
    demonstration: Demonstration,
    profile: Profile,
    progress: Callable[[str], None],
) -> Scores:
    """Score every method on the parts of a demonstration it has not learned from.

    The demonstration is cut into three parts; each in turn (as many as the profile
    says) is held out and the rest learned. Method to measure to a list over parts
    and seeds. Methods that do not depend on a seed count once for each part.
    """
    recorded = demonstration.resample(RATE)
    edges = np.linspace(0, len(recorded.time), 4).astype(int)
    scores: Scores = {}
    for fold in range(2, 2 - profile.folds, -1):
        a, b = edges[fold], edges[fold + 1]
        sides = (_part(recorded, 0, a), _part(recorded, b, None))
        learned = [part for part in sides if part is not None]
        held = _part(recorded, a, b)
        if held is None or not learned:
            continue
        extent = grid_extent(recorded.values)
        learned_path = np.concatenate([part.values for part in learned])
        forward, reverse = divergences(learned_path, held.values, extent=extent)
        _add(scores, FLOOR_ROW, {"forward_kl": forward, "reverse_kl": reverse})
        for name, (make, stride) in compared(slow=profile.slow_methods).items():
            for seed in range(profile.seeds):
                progress(f"held-out part {fold + 1}, {name}, seed {seed}")
                model = make(seed).fit(cut(learned, stride=stride))
                _add(scores, name, score(model, held, extent=extent, profile=profile))
                if name.startswith("periodic"):
                    break  # No seed in it.
    return scores


def score(
    model: TrajectoryModel,
    held: Demonstration,
    *,
    extent: NDArray[np.float64],
    profile: Profile,
) -> dict[str, float]:
    """Score a fitted model on a held-out recording."""
    out = {}
    density = model.log_density(cut([held], stride=PAPER_STRIDE))
    if density is not None:
        out["log_density"] = float(np.mean(density))
    samples = model.sample(min(profile.samples, _SAMPLES), seed=0)
    out["forward_kl"], out["reverse_kl"] = divergences(
        samples, held.values, extent=extent
    )
    last = len(held.time) - PREFIX - HORIZON
    errors = []
    for first in np.linspace(0, last, profile.predictions).astype(int):
        seen = held.values[first : first + PREFIX]
        truth = held.values[first + PREFIX : first + PREFIX + HORIZON]
        errors.append(np.sum((model.predict(seen, HORIZON) - truth) ** 2, axis=1))
    out["prediction_rms"] = 1e3 * float(np.sqrt(np.mean(errors)))
    return out


def summary(scores: Scores) -> dict[str, dict[str, dict[str, float]]]:
    """Return mean and standard deviation: method to measure to both."""
    return {
        name: {
            measure: {"mean": float(np.mean(v)), "std": float(np.std(v))}
            for measure, v in measures.items()
        }
        for name, measures in scores.items()
    }


def held_out_finding(task: str, scores: Scores) -> Finding:
    """Return the table and the picture of a demonstration's held-out scores."""
    numbers = summary(scores)
    rows = [["", *MEASURES.values()]]
    for name, measures in numbers.items():
        cells = [
            f"{measures[m]['mean']:.2f} ± {measures[m]['std']:.2f}"
            if m in measures
            else "-"
            for m in MEASURES
        ]
        rows.append([name, *cells])
    others = [n for n in numbers if n not in (FMP, FMP_PAPER, FLOOR_ROW)]
    said, wins = [], 0
    for measure, label in MEASURES.items():
        better = max if measure == "log_density" else min
        values = {
            n: numbers[n][measure]["mean"] for n in others if measure in numbers[n]
        }
        rival = better(values, key=values.__getitem__)
        ours, paper = (numbers[n][measure]["mean"] for n in (FMP, FMP_PAPER))
        wins += better(ours, values[rival]) == ours
        said.append(
            f"{label}: {ours:.2f} (paper's settings {paper:.2f}; best other "
            f"{values[rival]:.2f}, {rival})"
        )
    return Finding(
        name=f"held_out_{task}",
        title=f"Held out: {task}",
        shows=f"FMP is best in {wins} of {len(MEASURES)} measures. {'. '.join(said)}.",
        claim="FMP generalises better than every other method, in every measure.",
        agrees=wins == len(MEASURES),
        figure=_bars(numbers),
        table=rows,
    )


def _bars(numbers: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Figure:
    figure = Figure(figsize=(13, 4), layout="constrained")
    axes = figure.subplots(1, len(MEASURES), sharey=True)
    names = list(numbers)
    for ax, (measure, label) in zip(axes, MEASURES.items(), strict=True):
        values: Any = [numbers[n].get(measure, {}).get("mean", np.nan) for n in names]
        spreads = [numbers[n].get(measure, {}).get("std", 0.0) for n in names]
        colors = ["#0072b2" if n == FMP else "0.7" for n in names]
        ax.barh(names, values, xerr=spreads, color=colors)
        ax.set_xlabel(label)
        if measure == "log_density":
            ax.set_xlim(left=max(0.0, float(np.nanmin(values)) - 1))
    axes[0].invert_yaxis()
    return figure


def _part(recorded: Demonstration, a: int, b: int | None) -> Demonstration | None:
    values = recorded.values[a:b]
    if len(values) < N_STEPS + PAPER_STRIDE:
        return None
    return Demonstration(
        time=np.arange(len(values)) / RATE,
        values=values,
        channels=recorded.channels,
        units=recorded.units,
    )


def _add(scores: Scores, name: str, new: Mapping[str, float]) -> None:
    for measure, value in new.items():
        scores.setdefault(name, {}).setdefault(measure, []).append(value)
