"""`fmp-drake reproduce`."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console

from fmp_drake.apps.options import PATH
from fmp_drake.apps.page import make_console
from fmp_drake.errors import FmpError
from fmp_drake.experiments import (
    FULL,
    QUICK,
    Finding,
    Profile,
    eight,
    evaluate,
    held_out_finding,
    learn_and_sample,
    polishing,
    short_recordings,
    summary,
    table_one,
    table_rows,
    wiping,
    write_report,
)
from fmp_drake.experiments.held_out import LEAST_RECORDING
from fmp_drake.experiments.methods import N_STEPS, PAPER_STRIDE, RATE
from fmp_drake.experiments.metrics import BINS, FLOOR
from fmp_drake.experiments.report import Section
from fmp_drake.primitives import PAPER_SETTINGS, Demonstration, FourierMovementPrimitive
from fmp_drake.runs.skills import default_demonstration

Progress = Callable[[str], None]


@click.command()
@click.option("--out", type=PATH, required=True, help="Folder to write into.")
@click.option("--quick", is_flag=True, help="Fewer samples and seeds: about 1 minute.")
@click.option(
    "--demo",
    "demos",
    type=PATH,
    multiple=True,
    help="Also evaluate the methods on this recording (again).",
)
@click.option(
    "--demos",
    "folder",
    type=PATH,
    help="Also compare the methods, held out, on every .npz file in this folder.",
)
def reproduce(
    out: Path, quick: bool, demos: tuple[Path, ...], folder: Path | None
) -> None:
    """Rerun the paper's experiments and write a report with figures and tables."""
    console = make_console()
    profile = QUICK if quick else FULL
    others = [_load_own(path) for path in demos]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FmpError(f"cannot write into {out}: {error.strerror}.") from None

    started = time.perf_counter()
    with console.status("polishing") as status:

        def progress(what: str) -> None:
            seconds = time.perf_counter() - started
            status.update(f"{seconds:4.0f} s  {what}")
            if not console.is_terminal:
                console.print(f"{seconds:4.0f} s  {what}")

        sections, results = run_experiments(profile, others, demos, progress)
        if folder is not None:
            section, scores = compare_recordings(folder, profile, progress)
            sections.append(section)
            results["held_out"] |= scores
    results["seconds"] = time.perf_counter() - started
    write_report(
        out, sections=sections, introduction=_introduction(profile), results=results
    )
    _print_verdicts(console, sections)
    console.print(f"wrote {out / 'report.html'} in {results['seconds']:.0f} s")


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
        "held_out": {},
        "demonstrations": {},
    }
    held: list[Finding] = []
    for task in profile.tasks:
        scores = evaluate(bundled[task], profile, partial(_prefixed, progress, task))
        results["held_out"][task] = summary(scores)
        held.append(held_out_finding(task, scores))
        progress(f"{task}: learned from 20 s")
        held.append(short_recordings(task, bundled[task], profile))
    sections.append(("Held out (beyond the paper)", held))
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


def compare_recordings(
    folder: Path, profile: Profile, progress: Progress
) -> tuple[Section, dict[str, Any]]:
    """Score every method on the recordings of a folder.

    Those whose names differ only in a number at their end show the same movement: each
    in turn is held out. Of others, those that are long enough are cut into three.
    """
    groups: dict[str, list[Demonstration]] = {}
    for path in sorted(folder.glob("*.npz")):
        name = path.stem.rstrip("0123456789").rstrip("_-") or path.stem
        groups.setdefault(name, []).append(Demonstration.load(path))
    findings, results = [], {}
    for name, recordings in groups.items():
        seconds = max(each.duration for each in recordings)
        if len(recordings) == 1 and seconds < LEAST_RECORDING / RATE:
            progress(f"{name} lasts {seconds:.1f} s: too short to hold out a part")
            continue
        every = replace(profile, folds=max(profile.folds, len(recordings)))
        scores = evaluate(recordings, every, partial(_prefixed, progress, name))
        if not scores:
            progress(f"{name} lasts {seconds:.1f} s: too short to learn from")
            continue
        results[name] = summary(scores)
        findings.append(held_out_finding(name, scores))
    if not findings:
        raise FmpError(
            f"{folder} has no .npz recording of {LEAST_RECORDING / RATE:g} s or more."
        )
    return (f"Held out: recordings in {folder.name}", findings), results


def _prefixed(progress: Progress, task: str, what: str) -> None:
    progress(f"{task}: {what}")


def _load_own(path: Path) -> Demonstration:
    """Load a recording, its two widest channels first: those of the heatmaps."""
    demonstration = Demonstration.load(path)
    least = (N_STEPS + PAPER_STRIDE) / RATE
    if demonstration.duration < least or demonstration.n_channels < 2:
        raise FmpError(
            f"{path.name} lasts {demonstration.duration:.3g} s and has "
            f"{demonstration.n_channels} channels; the experiments need at least "
            f"{least:g} s and 2 channels."
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
        "seeds": profile.seeds,
        "folds": profile.folds,
    }


def _introduction(profile: Profile) -> str:
    return (
        "Section V of Kulak, Silvério and Calinon, <i>Fourier movement primitives</i>, "
        "RSS 2020, rerun on recordings of a simulated arm guided by a modelled hand (the "
        "paper's own are not public). FMP stands for the defaults of the estimator; "
        "the paper's settings are 10 Gaussians, windows 10 samples apart, plain EM. "
        f"{profile.samples} trajectories for each heatmap."
    )


def _print_verdicts(console: Console, sections: list[Section]) -> None:
    for _, findings in sections:
        for finding in findings:
            if finding.agrees is not None:
                mark = "holds        " if finding.agrees else "does not hold"
                console.print(f"{mark}  {finding.title}")
