"""`fmp-drake benchmark`."""

from pathlib import Path

import click

from fmp_drake.apps.options import PATH, Command, GroupedOption
from fmp_drake.apps.page import make_console, make_folder
from fmp_drake.errors import FmpError
from fmp_drake.experiments.benchmark import all_methods, run_benchmark, write_benchmark
from fmp_drake.experiments.benchmark.cleaning import run_cleaning
from fmp_drake.numeric import check_number
from fmp_drake.processes import LocalWorkers


def _list_methods(
    context: click.Context, _parameter: click.Parameter, is_requested: bool
) -> None:
    """Print the names of the methods, and exit."""
    if is_requested:
        for name in all_methods():
            click.echo(name)
        context.exit()


@click.command(
    cls=Command,
    examples={
        "fmp-drake benchmark recordings --out scores": "all methods on a folder",
        "fmp-drake benchmark recordings --out scores --method FMP": "one of them again",
    },
)
@click.argument("folder", type=PATH)
@click.option("--out", type=PATH, required=True, help="Folder for results and report.")
@click.option(
    "--method",
    "methods",
    multiple=True,
    help="Run only this method; may be repeated. The report shows all methods that have "
    "been run.",
)
@click.option("--quick", is_flag=True, help="Score fewer predictions of each split.")
@click.option(
    "--jobs",
    type=int,
    default=1,
    show_default=True,
    help="Number of processes on this machine.",
)
@click.option(
    "--clean",
    type=PATH,
    help="Instead measure how soon each method cleans the board with the movement of this "
    "recording.",
)
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_list_methods,
    help="List the methods and exit.",
    cls=GroupedOption,
    group="Options",
)
def benchmark(
    folder: Path,
    out: Path,
    methods: tuple[str, ...],
    quick: bool,
    jobs: int,
    clean: Path | None,
) -> None:
    """Compare methods on the recordings in FOLDER: prediction and playback.

    Methods learn from 1.5, 2, 3, 4 and 8 cycles and from all but a held-out part of each
    movement. With --clean they also drive the station for a minute, with five seeds.
    Writes one JSON file for each method, and report.html. An installed package
    adds a method by an entry point of the group fmp_drake.methods.
    """
    console = make_console()
    check_number(jobs, "jobs", least=1, whole=True, error=FmpError)
    if not folder.is_dir():
        raise FmpError(f"there is no folder {folder}.")
    make_folder(out)
    workers = LocalWorkers(jobs)

    def progress(text: str) -> None:
        console.print(text, markup=False)

    if clean is None:
        instants = 15 if quick else 60
        scores = run_benchmark(
            folder, out, workers, methods=methods, instants=instants, progress=progress
        )
    else:
        duration, seeds = (5.0, 2) if quick else (60.0, 5)
        scores = run_cleaning(
            clean,
            out,
            workers,
            methods=methods,
            duration=duration,
            seeds=seeds,
            progress=progress,
        )
    write_benchmark(out, scores, folder=folder)
    console.print(f"wrote {out / 'report.html'}")
