"""`fmp-drake check`."""

import sys
from dataclasses import dataclass
from pathlib import Path

from fmp_drake.apps.arm_console import ARM_MODEL, arm_config
from fmp_drake.apps.options import (
    LearningOptions,
    RecordingOptions,
    SceneOptions,
    arguments,
    arm_option,
    command,
    option,
)
from fmp_drake.apps.page import advice, make_console, print_next, write_metrics
from fmp_drake.plots import plot_reach
from fmp_drake.plots.style import check_picture
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.runs import CheckWithRehearsal, check_arm
from fmp_drake.skills import scenario_skill
from fmp_drake.skills.description import outside_in_words


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """Further checks, and files to write."""

    plot: Path | None = option(None, "Picture of the reach of the arm.")
    report: Path | None = option(None, "Values of the check (.json).")
    arm: str | None = arm_option("Also listen to an arm, without moving it.")


@command(
    {
        "fmp-drake check --scenario vertical": "a bundled board",
        "fmp-drake check --demo mine.csv --plot reach.png": "a recording of yours",
    }
)
def check(
    scene: SceneOptions,
    checks: CheckOptions,
    learning: LearningOptions,
    recording: RecordingOptions,
) -> None:
    """Check whether the arm can follow a skill on a board, and what would help."""
    console = make_console()
    plot, report, arm = checks.plot, checks.report, checks.arm
    check_writable(report, "a report", [".json"])
    check_picture(plot)
    scenario = scene.load()
    skill, _, remarks = scenario_skill(
        scenario,
        demonstrations=scene.demonstrations,
        skill_file=scene.skill_file,
        reading=recording.reading(),
        model=None if arm is None else ARM_MODEL,
        **vars(learning),
    )
    scene.check(scenario, skill)
    for line in (*remarks, *outside_in_words(skill)):
        console.print(line)
    feasibility = CheckWithRehearsal(scenario, skill, say=console.print)
    console.print(feasibility.verdict)
    findings = [] if arm is None else check_arm(scenario, arm_config(arm))
    for is_good, text in findings:
        console.print(f"{'good' if is_good else 'BAD '}  {text}")
    if plot is not None:
        plot_reach(feasibility, plot)
        console.print(f"wrote {plot}")
    metrics = {
        "is_feasible": feasibility.is_feasible,
        "verdict": feasibility.verdict,
        "arm": [finding._asdict() for finding in findings],
        **feasibility.values,
    }
    write_metrics(console, metrics, report)
    is_ready = all(finding.is_good for finding in findings)
    if feasibility.suggestion:
        console.print(advice(feasibility, scene, learning, recording))
    if feasibility.is_feasible and is_ready:
        flags = [] if arm is None else ["--arm", arm]
        print_next(console, "wipe", *arguments(scene, learning, recording), *flags)
    else:
        sys.exit(1)
