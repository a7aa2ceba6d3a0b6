"""`fmp-drake arm`."""

from dataclasses import dataclass
from pathlib import Path

from fmp_drake.apps.arm_console import arm_config
from fmp_drake.apps.options import (
    arm_option,
    command,
    option,
    real_time_option,
)
from fmp_drake.apps.page import make_console, write_metrics
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.runs.arm_bench import ArmBench, NetworkFaults
from fmp_drake.runs.real_time import request_priority
from fmp_drake.skills import default_demonstration, load_on_board
from fmp_drake.station import LcmPanda, LoadScenario, SimulatedHand
from fmp_drake.station.robots.panda_lcm import OpenLcm
from fmp_drake.systems.teaching.hand_motion import HandMotion, Task


@dataclass(frozen=True, kw_only=True)
class FaultOptions:
    """Faults of the messages."""

    drop: float = option(0.0, "Fraction of messages that are lost.")
    reorder: float = option(0.0, "Fraction of messages that overtake earlier ones.")
    corrupt: float = option(0.0, "Fraction of messages with a bit error.")
    jitter: float = option(0.0, "Largest delay of a message, s.")
    seed: int = option(0, "Seed of the faults and of the simulated person.")


@dataclass(frozen=True, kw_only=True)
class BenchOptions:
    """Simulated arm."""

    scenario: str = option("table_top", "Name of a scenario, or a YAML file.")
    arm: str | None = arm_option("Bus and channels.")
    task: Task | None = option(
        None, "Movement with which a simulated person guides the arm."
    )
    duration: float = option(600.0, "End after this time, s.", above=0)
    real_time: bool = real_time_option()
    report: Path | None = option(None, "Write the metrics (.json).")


@command(
    {
        "fmp-drake arm": "simulate a robot on the default bus",
        "fmp-drake record --arm lcm --out mine.npz": "record from it, in another terminal",
    }
)
def arm(to: BenchOptions, faults: FaultOptions) -> None:
    """Simulate an arm with the LCM messages of a real one, for tests.

    Nothing here has ever been tried on a real arm.
    """
    console = make_console()
    check_writable(to.report)
    config = LcmPanda() if to.arm is None else arm_config(to.arm)
    for refusal in request_priority() if to.real_time else ():
        console.print(refusal)
    bus, scene = OpenLcm(config.url), LoadScenario(to.scenario)
    source = default_demonstration(scene.skill.demonstration)
    demonstrations, _ = load_on_board([source], scenario=scene)
    hand = None
    if to.task is not None:
        motion = HandMotion.make(to.task, duration=to.duration + 1, seed=faults.seed)
        hand = SimulatedHand(motion)
    bench = ArmBench(
        scene,
        bus,
        arm=config,
        faults=NetworkFaults(**vars(faults)),
        hand=hand,
        demonstrated=[demonstration.values for demonstration in demonstrations],
    )
    console.print(f"a simulated arm sends {config.status_channel}; Ctrl-C ends it")
    try:
        bench.play(to.duration)
    finally:
        metrics = bench.metrics()
        for name, value in metrics.items():
            console.print(f"{name}: {value}")
        write_metrics(console, metrics, to.report)
