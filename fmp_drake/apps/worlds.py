"""`fmp-drake worlds`."""

import os
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import click
from rich.console import Console

from fmp_drake.apps.options import Command, option, options
from fmp_drake.apps.page import make_console, make_progress
from fmp_drake.errors import FmpError
from fmp_drake.experiments.trials import (
    TrialSpec,
    TrialStore,
    run_trials,
)
from fmp_drake.experiments.trials.report import TrialsReport
from fmp_drake.experiments.trials.running import replay_trial
from fmp_drake.experiments.trials.store import check_parquet
from fmp_drake.experiments.trials.trial import faults
from fmp_drake.film import check_film, film_size
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.processes import ClusterWorkers, LocalWorkers, Workers


@dataclass(frozen=True, kw_only=True)
class TrialsOptions:
    """Trials."""

    count: int = option(100, "Number of trials.")
    seconds: float = option(30.0, "Simulated time of each trial, s.")
    seed: int = option(0, "Seed of the draws.")
    robot: str | None = option(
        None, "Robot of all trials: its name, or a YAML file [default: SOURCE's]."
    )
    out: Path | None = option(None, "Folder for the trials and the report.")
    jobs: int | None = option(
        None, "Number of processes on this machine [default: one for each core]."
    )
    cluster: str | None = option(
        None, "Address of a Dask cluster to run on instead, tcp://...", basic=False
    )
    force: bool = option(False, "Also run infeasible scenarios.")


@dataclass(frozen=True, kw_only=True)
class TrialsOutput:
    """Other files to write."""

    parquet: Path | None = option(
        None, "Write all metrics to a file (.parquet).", basic=False
    )
    page: Path | None = option(None, "Also write the report as a page (.md).")


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """Repetition of one trial."""

    replay: int | None = option(None, "Run this trial of the folder SOURCE again.")
    html: Path | None = option(None, "Write a page that replays it.")
    video: Path | None = option(None, "Render a film of it (.mp4, .gif).")


@click.command(
    cls=Command,
    examples={
        "fmp-drake worlds default --count 20 --out trials": "20 scenarios, and a report",
        "fmp-drake worlds trials --replay 7 --html seven.html": "one of them again",
    },
)
@click.argument("source")
@options(to=TrialsOptions, output=TrialsOutput, one=ReplayOptions)
def worlds(
    source: str, to: TrialsOptions, output: TrialsOutput, one: ReplayOptions
) -> None:
    """Run randomised scenarios from SOURCE, and report which failed and why.

    SOURCE is a YAML file of distributions, or the name of one that comes with the package
    (default). The same command again continues where it was stopped. Where SOURCE is a
    folder of trials, its report is written again, or one trial is run again.
    """
    count, seconds, seed, out = to.count, to.seconds, to.seed, to.out
    jobs = (os.cpu_count() or 1) if to.jobs is None else to.jobs
    parquet, page = output.parquet, output.page
    replay, html, video = one.replay, one.html, one.video
    console = make_console()
    for target in (parquet, page, html):
        check_writable(target)
    check_film(video, fps=20, speed=1, size=film_size(640))
    if page is not None and page.suffix != ".md":
        raise FmpError(f"{page} is no page; let its name end in .md.")
    if parquet is not None:
        check_parquet()
    if replay is None and (html or video):
        raise FmpError("--html and --video show one trial; say which with --replay.")
    if Path(source).is_dir():
        store = TrialStore(Path(source))
        if replay is not None:
            _replay(console, store, replay, html, video)
            return
    else:
        if replay is not None:
            raise FmpError(f"{source} is no folder of trials, of which to replay one.")
        if out is None:
            raise FmpError("say with --out in which folder to keep the trials.")
        for name, value, least, most in (
            ("count", count, 1, 100_000),
            ("jobs", jobs, 1, 1000),
            ("seed", seed, 0, 2**63),
        ):
            check_number(
                value, name, least=least, most=most, whole=True, error=FmpError
            )
        check_number(seconds, "seconds", above=0, unit="s", error=FmpError)
        spec = TrialSpec.load(source, robot=to.robot)
        workers: Workers = (
            LocalWorkers(jobs) if to.cluster is None else ClusterWorkers(to.cluster)
        )
        store = TrialStore(out, spec.plan(seed=seed, seconds=seconds))
        _run(console, store, spec, count, workers, to.force)
    report = TrialsReport(store)
    report.write(page)
    console.print(report.verdict())
    console.print(f"wrote {store.folder / 'report.html'}")
    if page is not None:
        console.print(f"wrote {page}")
    if parquet is not None:
        store.export(parquet)
        console.print(f"wrote {parquet}")


def _run(
    console: Console,
    store: TrialStore,
    spec: TrialSpec,
    count: int,
    workers: Workers,
    force: bool,
) -> None:
    """Run the missing trials, with a progress bar."""
    steps = run_trials(store, spec, count, workers, force=force)
    try:
        with closing(steps), make_progress(console) as progress:
            bar = progress.add_task("trials", total=None)
            for done, total in steps:
                progress.update(bar, completed=done, total=total)
                if not console.is_terminal and done % max(1, total // 20) == 0:
                    console.print(f"{done} of {total} trials")
    except KeyboardInterrupt:
        console.print(
            f"{len(store.trials())} trials are kept in {store.folder}; the same command "
            "continues with the others."
        )
        raise


def _replay(
    console: Console,
    store: TrialStore,
    number: int,
    html: Path | None,
    video: Path | None,
) -> None:
    """Run a trial again, and report whether the metrics are identical."""
    trial = store.trial(number)
    if not trial.is_feasible:
        console.print(f"infeasible: {trial.verdict}")
    metrics = replay_trial(trial, float(store.plan["seconds"]), html=html, video=video)
    words = [fault.words for fault in faults(replace(trial, metrics=metrics, error=""))]
    console.print(f"trial {number} {'; '.join(words) or 'passed'}")
    if trial.metrics is not None:
        is_identical = str(metrics) == str(trial.metrics)  # NaN is not equal to itself.
        console.print(
            "identical to the last bit"
            if is_identical
            else "NOT identical to the stored run: the code, a library or the "
            f"processor is another one (it was run by the code {trial.code})."
        )
    for path in (html, video):
        if path is not None:
            console.print(f"wrote {path}")
