"""`fmp-drake worlds`."""

import os
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import click
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from fmp_drake.apps.options import PATH
from fmp_drake.apps.page import make_console
from fmp_drake.errors import FmpError
from fmp_drake.experiments.trials import (
    TrialSpec,
    TrialsReport,
    TrialStore,
    run_trials,
)
from fmp_drake.experiments.trials.running import replay_trial
from fmp_drake.experiments.trials.store import check_parquet
from fmp_drake.experiments.trials.trial import faults
from fmp_drake.film import check_film, film_size
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.processes import ClusterWorkers, LocalWorkers, Workers


@click.command()
@click.argument("source")
@click.option(
    "--count", type=int, default=100, show_default=True, help="Number of trials."
)
@click.option(
    "--seconds",
    type=float,
    default=30.0,
    show_default=True,
    help="Simulated time of each trial, s.",
)
@click.option(
    "--seed", type=int, default=0, show_default=True, help="Seed of the draws."
)
@click.option(
    "--robot", help="Robot of all trials: its name, or a YAML file [default: SOURCE's]."
)
@click.option("--out", type=PATH, help="Folder for the trials and the report.")
@click.option(
    "--jobs",
    type=int,
    default=os.cpu_count(),
    show_default="one for each core",
    help="Number of processes on this machine.",
)
@click.option(
    "--cluster", help="Address of a Dask cluster to run on instead, tcp://..."
)
@click.option("--force", is_flag=True, help="Also run infeasible scenarios.")
@click.option("--parquet", type=PATH, help="Write all metrics to a file (.parquet).")
@click.option("--page", type=PATH, help="Also write the report as a page (.md).")
@click.option("--replay", type=int, help="Run this trial of the folder SOURCE again.")
@click.option("--html", type=PATH, help="Write a page that replays it.")
@click.option("--video", type=PATH, help="Render a film of it (.mp4, .gif).")
def worlds(
    source: str,
    count: int,
    seconds: float,
    seed: int,
    robot: str | None,
    out: Path | None,
    jobs: int,
    cluster: str | None,
    force: bool,
    parquet: Path | None,
    page: Path | None,
    replay: int | None,
    html: Path | None,
    video: Path | None,
) -> None:
    """Run randomised scenarios from SOURCE, and report which failed and why.

    SOURCE is a YAML file of distributions, or the name of one that comes with the package
    (default). The same command again continues where it was stopped. Where SOURCE is a
    folder of trials, its report is written again, or one trial is run again.
    """
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
        spec = TrialSpec.load(source, robot=robot)
        workers: Workers = (
            LocalWorkers(jobs) if cluster is None else ClusterWorkers(cluster)
        )
        store = TrialStore(out, spec.plan(seed=seed, seconds=seconds))
        _run(console, store, spec, count, workers, force)
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
        with (
            closing(steps),
            Progress(
                TextColumn("trials"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                console=console,
                transient=not console.is_terminal,
                disable=not console.is_terminal,
            ) as progress,
        ):
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
