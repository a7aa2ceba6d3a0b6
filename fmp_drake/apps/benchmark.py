"""`fmp-drake benchmark`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click

from fmp_drake.apps.options import PATH, command, option
from fmp_drake.apps.page import make_console, make_folder
from fmp_drake.errors import FmpError
from fmp_drake.experiments.benchmark import run_benchmark, write_benchmark
from fmp_drake.experiments.benchmark.cleaning import run_cleaning
from fmp_drake.processes import LocalWorkers


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Methods, and files to write."""

    out: Path = option(help="Folder for results and report.")
    methods: tuple[str, ...] = option(
        (),
        "Run only this method; may be repeated. The report shows all methods that have "
        "been run.",
        flags=["--method"],
    )
    quick: bool = option(
        False, "Score fewer predictions of each split, or clean for 5 s with two seeds."
    )
    jobs: int = option(1, "Number of processes on this machine.", least=1)
    clean: Path | None = option(
        None,
        "Instead measure how soon each method cleans the board with the movement of this "
        "recording.",
    )


@command(
    {
        "fmp-drake benchmark recordings --out scores": "all methods on a folder",
        "fmp-drake benchmark recordings --out scores --method FMP": "one of them again",
    }
)
@click.argument("folder", type=PATH)
def benchmark(folder: Path, to: BenchmarkOptions) -> None:
    """Compare methods on the recordings in FOLDER: prediction and playback.

    Methods learn from 1.5, 2, 3, 4 and 8 cycles and from all but a held-out part of each
    movement. With --clean they drive the station instead, for a minute with five seeds,
    and FOLDER is not read. Writes one JSON file for each method, and report.html. An
    installed package adds a method by an entry point of the group fmp_drake.methods.
    """
    console = make_console()
    if to.clean is None and not folder.is_dir():
        raise FmpError(f"there is no folder {folder}.")
    make_folder(to.out)
    if to.clean is None:
        run = partial(run_benchmark, folder, instants=15 if to.quick else 60)
    else:
        duration, seeds = (5.0, 2) if to.quick else (60.0, 5)
        run = partial(run_cleaning, to.clean, duration=duration, seeds=seeds)
    progress = console.print
    scores = run(to.out, LocalWorkers(to.jobs), methods=to.methods, progress=progress)
    write_benchmark(to.out, scores, folder=folder)
    console.print(f"wrote {to.out / 'report.html'}")
