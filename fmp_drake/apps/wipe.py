"""`fmp-drake wipe`: the main job."""

import json
import sys
import time
from pathlib import Path
from typing import Any

import click
import numpy as np

from fmp_drake.apps.inputs import (
    PATH,
    default_demonstration,
    learn_skill,
    load_on_board,
    skill_options,
)
from fmp_drake.apps.outputs import check_picture, check_writable
from fmp_drake.apps.page import advance, make_console, open_page
from fmp_drake.apps.plots import plot_run
from fmp_drake.apps.report import print_report
from fmp_drake.apps.wiping_run import WipingRun
from fmp_drake.errors import FmpError
from fmp_drake.primitives import Demonstration, load_skill
from fmp_drake.station.scenario import LoadScenario


@click.command()
@click.option(
    "--demo", "demos", type=PATH, multiple=True, help="Learn from this file (again)."
)
@click.option("--skill", "skill_file", type=PATH, help="Play this skill instead.")
@click.option(
    "--scenario",
    default="table_top",
    show_default=True,
    help="Name of a scenario, or a YAML file.",
)
@click.option(
    "--duration", type=float, default=60.0, show_default=True, help="Seconds."
)
@click.option(
    "--start",
    type=float,
    nargs=3,
    metavar="X Y Z",
    help="Where the eraser starts, m: in the frame of the board, z above it.",
)
@click.option(
    "--sample/--mean",
    default=True,
    show_default=True,
    help="Track samples of the components, or always their means.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of the samples.")
@click.option(
    "--rate",
    type=float,
    help="Speed relative to real time, 0 for the fastest [default: 1; headless: 0].",
)
@click.option("--headless", is_flag=True, help="No page.")
@click.option("--html", type=PATH, help="Write a page that replays the run.")
@click.option("--plot", type=PATH, help="Write a picture of the run.")
@click.option("--report", type=PATH, help="Write the figures of the run (.json).")
@skill_options
def wipe(
    demos: tuple[Path, ...],
    skill_file: Path | None,
    scenario: str,
    duration: float,
    start: tuple[float, float, float] | None,
    sample: bool,
    seed: int,
    rate: float | None,
    headless: bool,
    html: Path | None,
    plot: Path | None,
    report: Path | None,
    transform: tuple[float, ...] | None,
    stretch: float,
    window: float,
    components: int,
) -> None:
    """Learn whiteboard wiping from a demonstration and wipe the board."""
    console = make_console()
    for target in (html, report):
        check_writable(target)
    check_picture(plot)
    if not (np.isfinite(duration) and duration > 0):
        raise FmpError(f"duration is {duration:g} s; it must be positive.")
    if rate is not None and not (np.isfinite(rate) and rate >= 0):
        raise FmpError(f"rate is {rate:g}; it must be 0 (fastest) or positive.")
    if seed < 0:
        raise FmpError(f"seed is {seed}; it must not be negative.")
    if skill_file is not None and demos:
        raise FmpError("give either --demo or --skill, not both.")
    scene = LoadScenario(scenario)

    learn_started = time.perf_counter()
    if skill_file is not None:
        demonstrations: list[Demonstration] = []
        skill = load_skill(skill_file)
        console.print(f"loaded {skill_file}")
    else:
        demonstrations, remarks = load_on_board(
            demos or [default_demonstration()], transform=transform, stretch=stretch
        )
        for remark in remarks:
            console.print(remark)
        skill = learn_skill(demonstrations, window=window, components=components)
    learn_seconds = time.perf_counter() - learn_started
    console.print(
        f"skill of {len(skill.components_)} components from {skill.n_windows_} windows "
        f"of {skill.n_steps / skill.rate:g} s, ready after {learn_seconds:.2f} s"
    )

    meshcat = open_page(None if headless else console) if html or not headless else None
    run = WipingRun(
        scene,
        skill,
        demonstrations=demonstrations,
        start=start,
        sample=sample,
        seed=seed,
        meshcat=meshcat,
        recording=html is not None,
    )
    realtime = (0.0 if headless else 1.0) if rate is None else rate
    run.simulator.set_target_realtime_rate(realtime)
    started = time.perf_counter()
    advance(run.simulator, duration, console=console, label="wiping")
    wall_seconds = time.perf_counter() - started

    figures: dict[str, Any] = {
        "simulated_seconds": duration,
        "wall_seconds": wall_seconds,
        "real_time_factor": duration / wall_seconds,
        "learn_seconds": learn_seconds,
        **run.figures(),
    }
    print_report(console, figures)
    if report is not None:
        report.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
        console.print(f"wrote {report}")
    if plot is not None:
        plot_run(run, plot)
        console.print(f"wrote {plot}")
    if html is not None:
        html.write_text(run.html(duration), encoding="utf-8")
        console.print(f"wrote {html}")
    if not headless and sys.stdin is not None and sys.stdin.isatty():
        console.input("the page stays open; press Enter to quit ")
