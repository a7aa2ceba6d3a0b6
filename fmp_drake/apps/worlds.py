"""`fmp-drake worlds`."""

import os
from contextlib import closing
from dataclasses import dataclass, fields, replace
from pathlib import Path

import click
from rich.console import Console

from fmp_drake.apps.options import command, option
from fmp_drake.apps.page import make_console, make_progress
from fmp_drake.errors import FmpError
from fmp_drake.experiments.trials import TrialSpec, TrialStore, run_trials
from fmp_drake.experiments.trials.running import replay_trial
from fmp_drake.experiments.trials.store import check_parquet
from fmp_drake.experiments.trials.trials_report import TrialsReport
from fmp_drake.film import check_film
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.processes import ClusterWorkers, LocalWorkers, Workers
from fmp_drake.runs.judging import failure, faults


@dataclass(frozen=True, kw_only=True)
class TrialsOptions:
    """Trials."""

    count: int = option(100, "Number of trials.", least=1, most=100_000)
    duration: float = option(30.0, "Simulated time of each trial, s.", above=0)
    seed: int = option(0, "Seed of the draws.", least=0, most=2**63)
    robot: str | None = option(
        None, "Robot of all trials: its name, or a YAML file [default: SOURCE's]."
    )
    out: Path | None = option(None, "Folder for the trials and the report.")
    jobs: int | None = option(
        None,
        "Number of processes on this machine [default: one for each core].",
        least=1,
        most=1000,
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
    markdown: Path | None = option(None, "Also write the report as a file (.md).")


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """Replay of one trial."""

    replay: int | None = option(None, "Run the trial of this number in SOURCE again.")
    html: Path | None = option(None, "Write a page that replays the trial.")
    video: Path | None = option(None, "Render a film of the trial (.mp4, .gif).")


@command(
    {
        "fmp-drake worlds default --count 20 --out trials": "20 scenarios, and a report",
        "fmp-drake worlds trials --replay 7 --html seven.html": "one of them again",
    }
)
@click.argument("source")
def worlds(
    source: str, to: TrialsOptions, output: TrialsOutput, one: ReplayOptions
) -> None:
    """Run randomised scenarios from SOURCE, and report which failed and why.

    SOURCE is a YAML file of distributions, or the name of a bundled one (default or
    surfaces). The same command again continues where it was stopped. If SOURCE is a folder
    of trials, its report is written again, or one trial is run again.
    """
    console = make_console()
    check_writable(output.parquet, "a table", [".parquet"])
    check_writable(one.html, "a page", [".html"])
    check_writable(output.markdown, "Markdown", [".md"])
    check_film(one.video)
    if output.parquet is not None:
        check_parquet()
    if one.replay is None and (one.html or one.video):
        raise FmpError(
            "--html and --video show one trial; give its number by --replay."
        )
    if one.replay is not None and output != TrialsOutput():
        raise FmpError(
            "--parquet and --markdown are of all trials; leave out --replay."
        )
    if Path(source).is_dir():
        given = [f.name for f in fields(to) if getattr(to, f.name) != f.default]
        if given:
            raise FmpError(
                f"{source} is a folder of trials, to which --{given[0]} does not apply; give "
                "the specification to run more."
            )
        store = TrialStore(Path(source))
        if one.replay is not None:
            _replay(console, store, one.replay, one)
            return
    elif one.replay is not None:
        raise FmpError(f"{source} is not a folder of trials; --replay needs one.")
    else:
        store = _run(console, source, to)
    report = TrialsReport(store)
    report.write(output.markdown)
    console.print(report.verdict())
    console.print(f"wrote {store.folder / 'report.html'}")
    if output.markdown is not None:
        console.print(f"wrote {output.markdown}")
    if output.parquet is not None:
        store.export(output.parquet)
        console.print(f"wrote {output.parquet}")


def _run(console: Console, source: str, to: TrialsOptions) -> TrialStore:
    """Run the missing trials, with a progress bar."""
    if to.out is None:
        raise FmpError("there is no folder for the trials; give one by --out.")
    jobs = (os.cpu_count() or 1) if to.jobs is None else to.jobs
    spec = TrialSpec.load(source, robot=to.robot)
    workers: Workers = (
        LocalWorkers(jobs) if to.cluster is None else ClusterWorkers(to.cluster)
    )
    store = TrialStore(to.out, spec.plan(seed=to.seed, duration=to.duration))
    steps = run_trials(store, spec, to.count, workers, force=to.force)
    try:
        with closing(steps), make_progress(console) as progress:
            bar = progress.add_task("trials", total=None)
            for number, total in steps:
                progress.update(bar, completed=number, total=total)
                if not console.is_terminal and number % max(1, total // 20) == 0:
                    console.print(f"{number} of {total} trials")
    except KeyboardInterrupt:
        console.print(
            f"{len(store.trials())} trials are kept in {store.folder}; the same command "
            "continues with the others."
        )
        raise
    return store


def _replay(
    console: Console, store: TrialStore, number: int, files: ReplayOptions
) -> None:
    """Run a trial again, and report whether the metrics are identical."""
    trial = store.trial(number)
    if not trial.is_feasible:
        console.print(f"infeasible: {trial.verdict}")
    duration = float(store.plan["duration"])
    repeated = replace(trial, metrics=None, error="")
    try:
        repeated.metrics = replay_trial(
            trial, duration, html=files.html, video=files.video
        )
    except (Exception, SystemExit) as error:
        if not trial.error:
            raise
        repeated.error = failure(error)
    texts = [fault.text for fault in faults(repeated, duration)]
    console.print(f"trial {number} {'; '.join(texts) or 'passed'}")
    if trial.was_run:
        # NaN is not equal to itself.
        is_identical = str(repeated.metrics) == str(trial.metrics)
        is_identical &= repeated.error == trial.error
        console.print(
            "identical to the last bit"
            if is_identical
            else "NOT identical to the stored run: the code, a library, a file of the scenario "
            f"or the processor differs (it was run by the code {trial.code})."
        )
    for path in (files.html, files.video):
        if path is not None and not repeated.error:
            console.print(f"wrote {path}")
