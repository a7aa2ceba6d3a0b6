"""All experiments of section V, and the held-out scores of the demonstrations."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fmp_drake.errors import FmpError
from fmp_drake.experiments.eight import (
    eight,
    learn_and_sample,
    table_one,
    table_rows,
)
from fmp_drake.experiments.held_out import held_out_findings, score_demonstrations
from fmp_drake.experiments.metrics import (
    BINS,
    FLOOR,
    N_STEPS,
    PAPER_STRIDE,
    RATE,
)
from fmp_drake.experiments.polishing import polishing
from fmp_drake.experiments.report import Finding, Profile, Section
from fmp_drake.experiments.wiping import wiping
from fmp_drake.primitives import PAPER_SETTINGS, Demonstration, FourierMovementPrimitive
from fmp_drake.skills.learning import default_demonstration

Progress = Callable[[str], None]


def run_experiments(
    profile: Profile,
    others: list[Demonstration],
    paths: tuple[Path, ...],
    progress: Progress,
) -> tuple[list[Section], dict[str, Any]]:
    """Run everything; return the sections of the report and the results."""
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
    results: dict[str, Any] = {
        "table1": table,
        "settings": _settings(profile),
        "demonstrations": {},
    }
    scores = score_demonstrations(
        {task: bundled[task] for task in profile.tasks}, profile, progress
    )
    results["held_out"] = {name: asdict(method) for name, method in scores.items()}
    sections.append(("Held out (beyond the paper)", held_out_findings(scores)))
    extra = []
    for path, demonstration in zip(paths, others, strict=True):
        progress(f"{path.name}: Table I")
        finding, row = _own(path, demonstration, profile)
        results["demonstrations"][path.stem] = row
        extra.append(finding)
    if extra:
        sections.append(("Your recordings", extra))
    results["findings"] = {
        f.name: {"shows": f.shows, "claim": f.claim, "agrees": f.agrees}
        for _, group in sections
        for f in group
    }
    return sections, results


def load_own(path: Path) -> Demonstration:
    """Load a recording with its two widest channels, those of the heatmaps, first."""
    demonstration = Demonstration.load(path)
    shortest = (N_STEPS + PAPER_STRIDE) / RATE
    if demonstration.duration < shortest or demonstration.n_channels < 2:
        raise FmpError(
            f"{path.name} lasts {demonstration.duration:.3g} s and has "
            f"{demonstration.n_channels} channels; the experiments need at least "
            f"{shortest:g} s and 2 channels."
        )
    widest = np.argsort(-np.ptp(demonstration.values, axis=0), kind="stable")
    return demonstration.select([demonstration.channels[i] for i in widest])


def _own(
    path: Path, demonstration: Demonstration, profile: Profile
) -> tuple[Finding, dict[str, dict[str, float]]]:
    recorded = demonstration.resample(RATE)
    _, samples = learn_and_sample(recorded, profile)
    table = table_one(samples, recorded.values)
    finding = Finding(
        name=f"own_{path.stem}",
        title=f"Table I on {path.name}",
        shows=f"{recorded.duration:.1f} s, as measured, in the plane of "
        f"{' and '.join(recorded.channels[:2])}.",
        table=table_rows(table),
    )
    return finding, table


def _settings(profile: Profile) -> dict[str, Any]:
    return {
        "fmp": FourierMovementPrimitive().get_params(),
        "fmp_paper": PAPER_SETTINGS,
        "n_steps": N_STEPS,
        "rate_hz": RATE,
        "bins": BINS,
        "floor": FLOOR,
        "samples": profile.samples,
        "places": profile.places,
    }
