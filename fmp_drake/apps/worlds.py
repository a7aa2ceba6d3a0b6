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
from fmp_drake.experiments.worlds import (
    WorldSpec,
    WorldsReport,
    WorldStore,
    faults,
    replay_world,
    run_worlds,
)
from fmp_drake.experiments.worlds.store import check_parquet
from fmp_drake.film import check_film, film_size
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.processes import ClusterWorkers, LocalWorkers, Workers


@click.command()
@click.argument("source")
@click.option("--count", type=int, default=100, show_default=True, help="Worlds.")
@click.option(
    "--seconds",
    type=float,
    default=30.0,
    show_default=True,
    help="Simulated time of each.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of the draws.")
@click.option("--out", type=PATH, help="Folder that keeps them, with the report.")
@click.option(
    "--jobs",
    type=int,
    default=os.cpu_count(),
    show_default="one for each core",
    help="Processes of this machine.",
)
@click.option(
    "--cluster", help="Address of a Dask cluster to run on instead, tcp://..."
)
@click.option(
    "--force", is_flag=True, help="Run those that are refused in advance, too."
)
@click.option("--parquet", type=PATH, help="Write all figures to a file (.parquet).")
@click.option("--page", type=PATH, help="Write the report as a page (.md), too.")
@click.option("--replay", type=int, help="Run this world of the folder SOURCE again.")
@click.option("--html", type=PATH, help="Write a page that replays it.")
@click.option("--video", type=PATH, help="Render a film of it (.mp4, .gif).")
def worlds(
    source: str,
    count: int,
    seconds: float,
    seed: int,
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
    """Draw worlds from SOURCE, run them, and report what went wrong in which.

    SOURCE is a YAML file of distributions, or the name of one that comes with the package
    (default). The same command again goes on where it was stopped. Where SOURCE is a
    folder of worlds, its report is written again, or one world is run again.
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
        raise FmpError("--html and --video show one world; say which with --replay.")
    if Path(source).is_dir():
        store = WorldStore(Path(source))
        if replay is not None:
            _replay(console, store, replay, html, video)
            return
    else:
        if replay is not None:
            raise FmpError(f"{source} is no folder of worlds, of which to replay one.")
        if out is None:
            raise FmpError("say with --out in which folder to keep the worlds.")
        for name, value, least in (
            ("count", count, 1),
            ("jobs", jobs, 1),
            ("seed", seed, 0),
        ):
            check_number(value, name, least=least, whole=True, error=FmpError)
        check_number(seconds, "seconds", above=0, unit="s", error=FmpError)
        spec = WorldSpec.load(source)
        workers: Workers = (
            LocalWorkers(jobs) if cluster is None else ClusterWorkers(cluster)
        )
        store = WorldStore(out, spec.plan(seed=seed, seconds=seconds))
        _run(console, store, spec, count, workers, force)
    report = WorldsReport(store)
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
    store: WorldStore,
    spec: WorldSpec,
    count: int,
    workers: Workers,
    force: bool,
) -> None:
    """Run the worlds that are missing, with a bar that says how long it will take."""
    steps = run_worlds(store, spec, count, workers, force=force)
    try:
        with (
            closing(steps),
            Progress(
                TextColumn("worlds"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                console=console,
                transient=not console.is_terminal,
                disable=not console.is_terminal,
            ) as progress,
        ):
            bar = progress.add_task("worlds", total=None)
            for done, of in steps:
                progress.update(bar, completed=done, total=of)
                if not console.is_terminal and done % max(1, of // 20) == 0:
                    console.print(f"{done} of {of} worlds")
    except KeyboardInterrupt:
        console.print(
            f"{len(store.worlds())} worlds are kept in {store.folder}; the same command "
            "goes on with the others."
        )
        raise


def _replay(
    console: Console,
    store: WorldStore,
    number: int,
    html: Path | None,
    video: Path | None,
) -> None:
    """Run a world again, and say whether it is the same."""
    world = store.world(number)
    if not world.is_feasible:
        console.print(f"refused in advance: {world.verdict}")
    metrics = replay_world(world, float(store.plan["seconds"]), html=html, video=video)
    found = [fault.words for fault in faults(replace(world, metrics=metrics, error=""))]
    console.print(f"world {number} {'; '.join(found) or 'goes well'}")
    if world.metrics is not None:
        same = str(metrics) == str(world.metrics)  # NaN is not equal to itself.
        console.print(
            "the same to the last bit"
            if same
            else "NOT the same as when it was stored: the code, a library or the "
            f"processor is another one (it was run by the code {world.code})."
        )
    for path in (html, video):
        if path is not None:
            console.print(f"wrote {path}")
