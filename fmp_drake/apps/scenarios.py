"""`fmp-drake scenarios`."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from os import cpu_count
from pathlib import Path

import click
import numpy as np
from rich.table import Table

from fmp_drake.apps.options import PATH
from fmp_drake.apps.page import make_console
from fmp_drake.errors import FmpError
from fmp_drake.film.scenario_page import Measured, measure_scenario, scenario_page
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.station.scenario import ListScenarios, LoadScenario


@click.command()
@click.option(
    "--page",
    type=PATH,
    help="Run them all and write a page (.md) with a table of what was measured, "
    "and a picture of each beside it.",
)
@click.option(
    "--duration",
    type=float,
    default=60.0,
    show_default=True,
    help="Of each run, s.",
)
def scenarios(page: Path | None, duration: float) -> None:
    """List the scenarios that come with the package."""
    console = make_console()
    check_writable(page)
    if page is not None and page.suffix != ".md":
        raise FmpError(f"{page} is no page; let its name end in .md.")
    if not (np.isfinite(duration) and duration > 0):
        raise FmpError(f"duration is {duration:g} s; it must be positive.")
    names = ListScenarios()
    if page is None:
        table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
        for name in names:
            table.add_row(f"[bold]{name}[/bold]", LoadScenario(name).description)
        console.print(table)
        console.print("run one of them: fmp-drake wipe --scenario NAME")
        return
    measured: dict[str, Measured] = {}
    # Each run in a process of its own: as if it were alone.
    with ProcessPoolExecutor(
        cpu_count(), mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        jobs = {
            name: pool.submit(measure_scenario, name, duration, page.parent)
            for name in names
        }
        for name, job in jobs.items():
            measured[name] = job.result()
            console.print(f"measured {name}")
    page.write_text(scenario_page(measured, duration=duration), encoding="utf-8")
    console.print(f"wrote {page}")
