"""`fmp-drake arm`."""

import json
from pathlib import Path

import click
import numpy as np

from fmp_drake.apps.options import PATH
from fmp_drake.apps.page import make_console
from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import check_writable, write_text
from fmp_drake.runs import ArmBench, NetworkFaults
from fmp_drake.station import LoadScenario
from fmp_drake.station.panda_driver import OpenLcm


@click.command()
@click.option("--scenario", default="table_top", show_default=True, help="As for wipe.")
@click.option("--lcm", "url", default="", help="URL of LCM [default: LCM's own].")
@click.option("--duration", type=float, default=3600.0, help="Seconds.")
@click.option("--drop", type=float, default=0.0, help="Fraction of lost messages.")
@click.option("--reorder", type=float, default=0.0, help="Of messages that overtake.")
@click.option(
    "--corrupt", type=float, default=0.0, help="Of messages with a wrong bit."
)
@click.option("--jitter", type=float, default=0.0, help="Greatest delay, s.")
@click.option("--seed", type=int, default=0, help="Of these faults.")
@click.option("--report", type=PATH, help="Write what was measured (.json).")
def arm(
    scenario: str,
    url: str,
    duration: float,
    drop: float,
    reorder: float,
    corrupt: float,
    jitter: float,
    seed: int,
    report: Path | None,
) -> None:
    """Simulate an arm that speaks a real one's LCM messages, to try against.

    It is a test bench, not a robot: nothing here was ever tried on a real arm.
    """
    console = make_console()
    check_writable(report)
    bus = OpenLcm(url)
    faults = NetworkFaults(
        drop=drop, reorder=reorder, corrupt=corrupt, jitter=jitter, seed=seed
    )
    bench = ArmBench(LoadScenario(scenario), bus, faults=faults)
    console.print("a simulated arm sends PANDA_STATUS; Ctrl-C ends it")
    try:
        bench.play(duration)
    finally:
        metrics = {
            **{f"{each.name.lower()}_ms": n for each, n in bench.obeyed.items()},
            "greatest_step": bench.greatest_step,
            "cleaned_fraction": float(bench.output("cleaned_fraction")[0]),
            "normal_force": float(bench.output("normal_force")[0]),
            "greatest_speed": float(np.max(np.abs(bench.output("state")[7:]))),
        }
        for name, value in metrics.items():
            console.print(f"{name}: {value}")
        if report is not None:
            write_text(report, json.dumps(metrics, indent=2) + "\n", RunError)
