"""Held-out evaluation of all methods (not in the paper)."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fmp_drake.errors import FmpError
from fmp_drake.experiments.baselines.fourier_model import FourierModel
from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.experiments.methods import (
    FMP,
    FMP_PAPER,
    FMP_STRIDE,
    N_STEPS,
    PAPER_STRIDE,
    PHASE,
    RATE,
    SEEDLESS,
    compared,
    cut,
    fmp,
    phase,
)
from fmp_drake.experiments.metrics import divergences, grid_extent, inside_ellipsoids
from fmp_drake.experiments.report import Finding, Profile
from fmp_drake.primitives import Demonstration

PREFIX = 10
HORIZON = 20
FLOOR_ROW = "learning part itself"
ORACLE = "oracle"
# Samples; the heatmap of a shorter recording is too noisy for a comparison.
LEAST_HEATMAP = round(59 * RATE)
# Samples of a window.
_LEAST_WINDOW = 40
# Steps ahead at which the coverage of the 95 % tube is measured: 0.25, 0.5 and 1 s.
_TUBE_STEPS = (5, 10, 20)
_SAMPLES = 2000
# Measures of the comparison, then the coverage of the predicted tubes.
MEASURES = {
    "log_density": "log density (nats per step)",
    "forward_kl": "forward KL",
    "reverse_kl": "reverse KL",
    "prediction_rms": "next second, rms (mm)",
    **{
        f"tube_{step}": f"in the 95 % tube after {step / RATE:g} s (%)"
        for step in _TUBE_STEPS
    },
}
_COMPARED = ("log_density", "forward_kl", "reverse_kl", "prediction_rms")

# Length of short recordings, s, and the measures shown of them.
_SHORT = 20.0
_SHORT_MEASURES = ("log_density", "prediction_rms", "tube_5", "tube_10", "tube_20")

Scores = dict[str, dict[str, list[float]]]


def evaluate(
    demonstration: Demonstration, profile: Profile, progress: Callable[[str], None]
) -> Scores:
    """Score every method on parts of a demonstration that were held out.

    The demonstration is cut into three parts; the profile sets how many of them are held
    out in turn. The methods learn from the rest. The result maps method and measure to a
    list over held-out parts and seeds; methods without randomness have one seed.

    Windows last 6 s, or half of the shortest held-out part. Methods that cannot learn
    from the rest have no scores there.

    The row of the oracle scores the phase model on a recording of the same length that
    it has drawn itself. It is a bound only where the recording follows the phase model,
    and left out where the phase model predicts the recording better.
    """
    recorded = demonstration.resample(RATE)
    # The parts before and after stay apart: a window across them would jump.
    edges = np.linspace(0, len(recorded.time), 4).astype(int)
    cuts = [
        (
            part(recorded, a, b),
            [part(recorded, *side) for side in ((0, a), (b, edges[3])) if np.ptp(side)],
        )
        for a, b in pairwise(edges)
    ]
    shortest = min(len(held.values) for held, _ in cuts)
    n_steps = int(np.clip(shortest // 2, _LEAST_WINDOW, N_STEPS))
    extent = grid_extent(recorded.values)
    scored = partial(score, extent=extent, profile=profile, n_steps=n_steps)
    scores: Scores = {}
    for held, rest in cuts[::-1][: profile.folds]:
        learned = [y for y in rest if len(y.values) >= n_steps + PAPER_STRIDE]
        if len(held.values) < n_steps + PAPER_STRIDE or not learned:
            continue
        if len(held.values) >= LEAST_HEATMAP:
            learned_path = np.concatenate([y.values for y in learned])
            forward, reverse = divergences(learned_path, held.values, extent=extent)
            add_scores(
                scores, FLOOR_ROW, {"forward_kl": forward, "reverse_kl": reverse}
            )
        for name, (make, stride) in compared().items():
            for seed in range(profile.seeds):
                progress(f"held out, {name}, seed {seed}")
                try:
                    model = make(seed).fit(cut(learned, stride=stride, n_steps=n_steps))
                except FmpError as error:
                    progress(f"{name} cannot learn from the rest: {error}")
                    break
                add_scores(scores, name, scored(model, held))
                if name == PHASE and _knows_phase(model):
                    samples = _drawn(model, held)
                    own = scored(model, samples)
                    # Densities of different data cannot be compared.
                    own.pop("log_density")
                    add_scores(scores, ORACLE, own)
                if name in SEEDLESS:
                    break
    if ORACLE in scores and not _bounds(scores[ORACLE], scores[PHASE]):
        del scores[ORACLE]
    return scores


def _bounds(
    oracle: Mapping[str, list[float]], phase: Mapping[str, list[float]]
) -> bool:
    """Return whether no prediction of the phase model is better than the oracle's."""
    best = float(np.mean(phase["prediction_rms"]))
    return float(np.mean(oracle["prediction_rms"])) <= best


def score(
    model: TrajectoryModel,
    held: Demonstration,
    *,
    extent: NDArray[np.float64],
    profile: Profile,
    n_steps: int = N_STEPS,
) -> dict[str, float]:
    """Score a fitted model on a held-out recording."""
    out = {}
    windows = cut([held], stride=PAPER_STRIDE, n_steps=n_steps)
    density = model.log_density(windows)
    if density is not None:
        out["log_density"] = float(np.mean(density))
    if len(held.values) >= LEAST_HEATMAP:
        samples = model.sample(min(profile.samples, _SAMPLES), seed=0)
        out["forward_kl"], out["reverse_kl"] = divergences(
            samples, held.values, extent=extent
        )
    last = len(held.time) - PREFIX - HORIZON
    errors, inside = [], []
    for first in np.linspace(0, last, profile.predictions).astype(int):
        prefix = held.values[first : first + PREFIX]
        truth = held.values[first + PREFIX : first + PREFIX + HORIZON]
        off = truth - model.predict(prefix, HORIZON)
        errors.append(np.sum(off**2, axis=1))
        tubes = model.tubes(prefix, HORIZON)
        if tubes is not None:
            at = np.array(_TUBE_STEPS) - 1
            off = (truth - tubes.values)[at]
            inside.append(inside_ellipsoids(off, tubes.covariances[at]))
    out["prediction_rms"] = 1e3 * float(np.sqrt(np.mean(errors)))
    if inside:
        for step, fraction in zip(_TUBE_STEPS, np.mean(inside, axis=0), strict=True):
            out[f"tube_{step}"] = 100 * float(fraction)
    return out


def _knows_phase(model: TrajectoryModel) -> bool:
    return isinstance(model, FourierModel) and model.skill_.phase_model_ is not None


def _drawn(model: TrajectoryModel, held: Demonstration) -> Demonstration:
    """Return a recording as long as a held-out one, drawn from a phase model."""
    assert isinstance(model, FourierModel)
    skill = model.skill_
    assert skill.phase_model_ is not None
    rng = np.random.default_rng(1)
    long = np.sum(skill.phase_model_.draw(rng, 0, 1, len(held.values)), axis=0)[0]
    values = long * skill.scales_
    return replace(held, values=values)


def summary(scores: Scores) -> dict[str, dict[str, dict[str, float]]]:
    """Return mean and standard deviation: method to measure to both."""
    return {
        name: {
            measure: {"mean": float(np.mean(v)), "std": float(np.std(v))}
            for measure, v in measures.items()
        }
        for name, measures in scores.items()
    }


def score_rows(
    numbers: Mapping[str, Mapping[str, Mapping[str, float]]], measures: Iterable[str]
) -> list[list[str]]:
    """Return some measures of a `summary` as text, a row for each name, header first."""
    shown = list(measures)
    rows = [["", *(MEASURES[m] for m in shown)]]
    for name, scores in numbers.items():
        cells = [
            f"{scores[m]['mean']:.2f} ± {scores[m]['std']:.2f}" if m in scores else "-"
            for m in shown
        ]
        rows.append([name, *cells])
    return rows


def held_out_finding(task: str, scores: Scores) -> Finding:
    """Return the table and the picture of a demonstration's held-out scores."""
    numbers = summary(scores)
    ours = (PHASE, FMP, FMP_PAPER)
    others = [n for n in numbers if n not in (*ours, FLOOR_ROW, ORACLE)]
    comparisons, wins, judged = [], 0, 0
    for measure in _COMPARED:
        better = max if measure == "log_density" else min
        values = {
            n: numbers[n][measure]["mean"] for n in others if measure in numbers[n]
        }
        if not values:
            continue
        rival = better(values, key=values.__getitem__)
        phase, mixture, paper = (
            numbers.get(n, {}).get(measure, {}).get("mean", np.nan) for n in ours
        )
        judged += 1
        wins += better(phase, values[rival]) == phase
        comparisons.append(
            f"{MEASURES[measure]}: phase model {phase:.2f}, mixture {mixture:.2f}, "
            f"paper's settings {paper:.2f}; best other {values[rival]:.2f} ({rival})"
        )
        if measure in numbers.get(ORACLE, {}):
            comparisons[-1] += f"; oracle {numbers[ORACLE][measure]['mean']:.2f}"
    return Finding(
        name=f"held_out_{task}",
        title=f"Held out: {task}",
        shows=f"FMP with the phase model is best in {wins} of {judged} measures. "
        f"{'. '.join(comparisons)}.",
        claim="FMP generalises better than every other method, in every measure.",
        agrees=wins == judged,
        figure=_bars(numbers),
        table=score_rows(numbers, MEASURES),
    )


def _bars(numbers: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Figure:
    figure = Figure(figsize=(13, 4), layout="constrained")
    axes = figure.subplots(1, len(_COMPARED), sharey=True)
    names = list(numbers)
    for ax, measure in zip(axes, _COMPARED, strict=True):
        values: Any = [numbers[n].get(measure, {}).get("mean", np.nan) for n in names]
        spreads = [numbers[n].get(measure, {}).get("std", 0.0) for n in names]
        colors = ["#0072b2" if n == PHASE else "0.7" for n in names]
        bars = ax.barh(names, values, xerr=spreads, color=colors)
        texts = ["" if np.isnan(v) else f"{v:.3g}" for v in values]
        ax.bar_label(bars, texts, padding=3, fontsize="small")
        ax.margins(x=0.3)  # Room for the numbers, on the left of negative ones, too.
        better = "right" if measure == "log_density" else "left"
        ax.set_xlabel(MEASURES[measure])
        arrow = (
            "better \N{RIGHTWARDS ARROW}"
            if better == "right"
            else "\N{LEFTWARDS ARROW} better"
        )
        ax.set_title(arrow, loc=better, fontsize="medium")
        if measure == "log_density":
            least = min((v for v in values if np.isfinite(v)), default=0.0)
            if least > 1:
                ax.set_xlim(left=least - 1)
    axes[0].invert_yaxis()
    return figure


def part(recorded: Demonstration, a: int, b: int) -> Demonstration:
    """Return samples a to b of a recording at `RATE`, from time 0."""
    values = recorded.values[a:b]
    return replace(recorded, time=np.arange(len(values)) / RATE, values=values)


def add_scores(scores: Scores, name: str, new: Mapping[str, float]) -> None:
    """Add the measures of one held-out part to the scores of a method."""
    for measure, value in new.items():
        scores.setdefault(name, {}).setdefault(measure, []).append(value)


def short_recordings(
    task: str, demonstration: Demonstration, profile: Profile
) -> Finding:
    """Compare learning from pieces of 20 s with learning from the whole recording.

    The last 20 s are predicted. Three pieces are used for each fold of the profile.
    """
    recorded = demonstration.resample(RATE)
    size = round(_SHORT * RATE)
    *begins, last = range(len(recorded.time) % size, len(recorded.time), size)
    whole, held = part(recorded, 0, last), part(recorded, last, last + size)
    pieces = [part(recorded, a, a + size) for a in begins[: 3 * profile.folds]]
    by_pieces = f"phase model, {len(pieces)} pieces of {_SHORT:g} s"
    all_of_it = f"all {whole.duration:.0f} s"
    by_mixture = f"mixture, {all_of_it}"
    learned = [
        *((by_pieces, phase(), piece) for piece in pieces),
        (f"phase model, {all_of_it}", phase(), whole),
        *((by_mixture, fmp(seed), whole) for seed in range(profile.seeds)),
    ]
    extent = grid_extent(recorded.values)
    scores: Scores = {}
    for name, model, shown in learned:
        fitted = model.fit(cut([shown], stride=FMP_STRIDE))
        add_scores(scores, name, score(fitted, held, extent=extent, profile=profile))
    numbers = summary(scores)
    short, mixture = (
        numbers[name]["prediction_rms"]["mean"] for name in (by_pieces, by_mixture)
    )
    return Finding(
        name=f"short_{task}",
        title=f"Learned from {_SHORT:g} s: {task}",
        shows=f"The next second of the last {_SHORT:g} s is predicted with "
        f"{short:.1f} mm by the phase model learned from {_SHORT:g} s, and with {mixture:.1f} mm "
        "by the mixture learned from everything before.",
        claim=f"The phase model predicts from {_SHORT:g} s as well as the mixture from all.",
        agrees=short <= mixture,
        table=score_rows(numbers, _SHORT_MEASURES),
    )
