"""`fmp-drake arm`."""

import json
from pathlib import Path

import click

from fmp_drake.apps.arm_console import arm_config
from fmp_drake.apps.options import PATH, arm_option, real_time_option
from fmp_drake.apps.page import make_console
from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import check_writable, write_text
from fmp_drake.runs import (
    ArmBench,
    NetworkFaults,
    default_demonstration,
    load_on_board,
)
from fmp_drake.runs.arm.real_time import take_precedence
from fmp_drake.station import LcmPanda, LoadScenario
from fmp_drake.station.panda_driver import OpenLcm
from fmp_drake.station.parts.hands import SimulatedHand
from fmp_drake.systems.teaching.hand_motion import TASKS, HandMotion, Task


@click.command()
@click.option("--scenario", default="table_top", show_default=True, help="As for wipe.")
@arm_option("What to be taken for.")
@click.option("--hand", type=click.Choice(TASKS), help="A simulated person guides it.")
@click.option("--duration", type=float, default=600.0, help="Seconds.")
@click.option("--drop", type=float, default=0.0, help="Fraction of lost messages.")
@click.option("--reorder", type=float, default=0.0, help="Of messages that overtake.")
@click.option(
    "--corrupt", type=float, default=0.0, help="Of messages with a wrong bit."
)
@click.option("--jitter", type=float, default=0.0, help="Greatest delay, s.")
@click.option("--seed", type=int, default=0, help="Of these faults.")
@real_time_option
@click.option("--report", type=PATH, help="Write what was measured (.json).")
def arm(
    scenario: str,
    arm: str | None,
    hand: Task | None,
    duration: float,
    drop: float,
    reorder: float,
    corrupt: float,
    jitter: float,
    seed: int,
    real_time: bool,
    report: Path | None,
) -> None:
    """Simulate an arm that speaks a real one's LCM messages, to try against.

    It is a test bench, not a robot: nothing here was ever tried on a real arm.
    """
    console = make_console()
    check_writable(report)
    config = LcmPanda() if arm is None else arm_config(arm)
    for refused in take_precedence() if real_time else ():
        console.print(refused)
    bus, scene = OpenLcm(config.url), LoadScenario(scenario)
    faults = NetworkFaults(
        drop=drop, reorder=reorder, corrupt=corrupt, jitter=jitter, seed=seed
    )
    demonstrations, _ = load_on_board(
        [default_demonstration(scene.skill.demonstration)],
        scenario=scene,
        transform=None,
        stretch=1.0,
    )
    guide = None
    if hand is not None:
        guide = SimulatedHand(HandMotion.make(hand, seconds=duration + 1, seed=seed))
    bench = ArmBench(
        scene,
        bus,
        arm=config,
        faults=faults,
        hand=guide,
        demonstrated=[each.values for each in demonstrations],
    )
    console.print("a simulated arm sends PANDA_STATUS; Ctrl-C ends it")
    try:
        bench.play(duration)
    finally:
        metrics = bench.metrics()
        for name, value in metrics.items():
            console.print(f"{name}: {value}")
        if report is not None:
            write_text(report, json.dumps(metrics, indent=2) + "\n", RunError)
