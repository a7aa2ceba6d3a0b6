"""`fmp-drake check`."""

import json
import sys
from pathlib import Path
from typing import Any

import click

from fmp_drake.apps.arm_console import arm_config
from fmp_drake.apps.options import PATH, arm_option, scene_options, skill_options
from fmp_drake.apps.page import make_console
from fmp_drake.errors import RunError
from fmp_drake.plots import plot_reach
from fmp_drake.plots.outputs import check_picture
from fmp_drake.primitives.data.files import check_writable, write_text
from fmp_drake.runs import check_arm
from fmp_drake.runs.skills import scenario_skill
from fmp_drake.station import CheckFeasibility, LoadScenario


@click.command()
@scene_options
@click.option("--plot", type=PATH, help="Write a picture of what the arm can reach.")
@click.option("--report", type=PATH, help="Write the figures (.json).")
@arm_option("Before anything moves, listen to an arm, too.")
@skill_options
def check(
    scenario: str,
    demos: tuple[Path, ...],
    skill_file: Path | None,
    start: tuple[float, float, float] | None,
    plot: Path | None,
    report: Path | None,
    arm: str | None,
    **learning: Any,
) -> None:
    """Tell whether the arm can follow a skill on a board, and what would help."""
    console = make_console()
    check_writable(report)
    check_picture(plot)
    scene = LoadScenario(scenario)
    if start is not None:
        scene.start = list(start)
    skill, _, remarks = scenario_skill(
        scene,
        demos=demos,
        skill_file=skill_file,
        **learning,
    )
    found = CheckFeasibility(scene, skill)
    for line in (*remarks, found.verdict):
        console.print(line)
    heard = [] if arm is None else check_arm(scene, arm_config(arm))
    for is_good, said in heard:
        console.print(f"{'good' if is_good else 'BAD '}  {said}")
    if plot is not None:
        plot_reach(found, plot)
        console.print(f"wrote {plot}")
    if report is not None:
        figures: dict[str, Any] = {
            "is_feasible": found.is_feasible,
            "verdict": found.verdict,
            "arm": [each._asdict() for each in heard],
        }
        text = json.dumps(figures | found.values, indent=2) + "\n"
        write_text(report, text, RunError)
        console.print(f"wrote {report}")
    if not (found.is_feasible and all(each.is_good for each in heard)):
        sys.exit(1)
