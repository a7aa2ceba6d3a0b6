"""`fmp-drake record`."""

import time
from pathlib import Path

import click
from pydrake.systems.analysis import Simulator

from fmp_drake.apps.arm_console import arm_config, guide_arm
from fmp_drake.apps.options import PATH, arm_option, host_option
from fmp_drake.apps.page import make_console, open_page, show_progress
from fmp_drake.errors import FmpError, RunError
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.runs.advancing import advance
from fmp_drake.station.parts.hands import SimulatedHand
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.station.teaching_station import (
    DemonstrationFromRecorder,
    MakeTeachingStation,
)
from fmp_drake.systems.teaching.hand_motion import TASKS, HandMotion, Task

# The hand settles on the board before the recording begins.
_SETTLE = 2.0


@click.command()
@click.option("--task", type=click.Choice(TASKS), default="wiping", show_default=True)
@click.option("--minutes", type=float, default=2.0, show_default=True)
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--out", type=PATH, required=True, help="File (.npz or .csv) to write.")
@click.option("--scenario", default="table_top", show_default=True)
@click.option(
    "--page", is_flag=True, help="Show the teaching in Meshcat, in real time."
)
@arm_option(
    "A person guides an arm, at most for these minutes, instead of a simulation."
)
@host_option
def record(
    task: Task,
    minutes: float,
    seed: int,
    out: Path,
    scenario: str,
    page: bool,
    arm: str | None,
    host: str,
) -> None:
    """Record a demonstration: a simulated person guides the arm over the board.

    Or, with --arm, a person a real one.
    """
    console = make_console()
    check_writable(out)
    check_number(minutes, "minutes", above=0, error=FmpError)
    check_number(seed, "seed", least=0, error=FmpError)
    seconds = 60 * minutes
    if arm is not None:
        if page:
            raise RunError(
                "of an arm that is recorded there is no page; leave out --page."
            )
        shown = guide_arm(console, LoadScenario(scenario), arm_config(arm), seconds)
        shown.save(out)
        console.print(f"wrote {out}")
        return
    motion = HandMotion.make(task, seconds=_SETTLE + seconds + 1, seed=seed)
    panel = open_page(console, title=scenario, host=host) if page else None
    meshcat = None if panel is None else panel.meshcat
    hand = SimulatedHand(motion)
    station = MakeTeachingStation(LoadScenario(scenario), hand, meshcat=meshcat)
    simulator = Simulator(station)
    simulator.set_target_realtime_rate(1.0 if page else 0.0)
    started = time.perf_counter()
    until = _SETTLE + seconds
    times = advance(simulator, until)
    show_progress(console, times, until=until, label=f"guiding: {task}")
    demonstration = DemonstrationFromRecorder(
        station,
        simulator.get_context(),
        skip=_SETTLE,
        note=f"simulated: a modelled hand guides the simulated arm ({task}, seed "
        f"{seed}); not recorded on a robot",
    )
    demonstration.save(out)
    low, high = demonstration.values.min(axis=0), demonstration.values.max(axis=0)
    console.print(
        f"recorded {demonstration.duration:.1f} s at 20 Hz in "
        f"{time.perf_counter() - started:.0f} s: x {low[0]:.3f} to {high[0]:.3f} m, "
        f"y {low[1]:.3f} to {high[1]:.3f} m on the board"
    )
    console.print(f"wrote {out}")
