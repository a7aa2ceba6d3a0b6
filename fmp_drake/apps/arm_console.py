"""What an operator sees and says at an arm that is not simulated here."""

import json
import select
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from fmp_drake.errors import RunError, StationError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.data.files import write_text
from fmp_drake.primitives.model.parameters import ModelChoice
from fmp_drake.runs import ArmRun, record_arm
from fmp_drake.runs.page_text import describe_page
from fmp_drake.station import LcmPanda, LoadPanda, Scenario
from fmp_drake.systems import GateMode, PagePanel
from fmp_drake.systems.page.page_status import mode_in_words
from fmp_drake.systems.viewer.panel_fields import PanelFields

ARM_MODEL: ModelChoice = "mixture"
"""What an arm plays that does not wait: with its choice of samples re-mapped in 11 ms, a
phase model in 36."""

# Steps between two looks at the keyboard, and until the arm may have answered.
_LOOK, _ANSWER = 100, 500


def arm_config(arm: str, *, dry: bool = False) -> LcmPanda:
    """Return what `--arm` names: `lcm`, `lcm:URL` or a YAML file."""
    if arm.endswith((".yaml", ".yml")):
        config = LoadPanda(arm)
        if not isinstance(config, LcmPanda):
            raise StationError(f"{arm} names no arm behind LCM; expected !LcmPanda.")
    elif arm == "lcm" or arm.startswith("lcm:"):
        config = LcmPanda(url=arm[4:])
    else:
        raise StationError(f"--arm is {arm}; expected lcm, lcm:URL or a YAML file.")
    config.gate.dry = config.gate.dry or dry
    return config


def can_ask() -> bool:
    """Tell whether there is somebody who can press Enter."""
    return sys.stdin is not None and sys.stdin.isatty()


def is_entered() -> bool:
    """Tell whether somebody has pressed Enter since the last time."""
    if not (can_ask() and select.select([sys.stdin], [], [], 0)[0]):
        return False
    sys.stdin.readline()
    return True


def guide_arm(
    console: Console, scenario: Scenario, config: LcmPanda, seconds: float
) -> Demonstration:
    """Record how a person guides an arm, until Enter or for some seconds."""
    ends = "Enter ends it" if can_ask() else f"for {seconds:g} s"
    console.print(f"nothing is sent: guide the arm now, pressing lightly; {ends}")
    shown = record_arm(
        scenario,
        config,
        until=lambda elapsed: elapsed >= seconds or is_entered(),
        note="guided by hand, on an arm behind LCM",
    )
    low, high = shown.values.min(axis=0), shown.values.max(axis=0)
    console.print(
        f"recorded {shown.duration:.1f} s at 20 Hz: x {low[0]:.3f} to {high[0]:.3f} m, "
        f"y {low[1]:.3f} to {high[1]:.3f} m, z {low[2]:.3f} to {high[2]:.3f} m on the board"
    )
    return shown


def wipe_with_arm(
    console: Console,
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    config: LcmPanda,
    duration: float,
    *,
    go: bool = False,
    panel: PagePanel | None = None,
    demonstrations: Sequence[Demonstration] = (),
    report: Path | None = None,
) -> None:
    """Play a skill on an arm; Enter lets it go and stops it."""
    if not (go or can_ask()):
        raise RunError(
            "nobody can say go: run it in a terminal, or, only where the arm is a "
            "simulated one, with --go."
        )
    run = ArmRun(
        scenario,
        skill,
        config,
        meshcat=None if panel is None else panel.meshcat,
        demonstrated=[each.values for each in demonstrations],
    )
    if panel is not None:
        panel.show(**describe_page(scenario))
    if can_ask():
        console.print("Enter lets the arm go, and stops it; Ctrl-C ends it")
    shown = None
    steps = 0

    def operate(run: ArmRun) -> None:
        nonlocal shown, steps
        steps += 1
        if steps % _LOOK:
            return
        if (now := (run.mode, run.faults)) != shown:
            shown = now
            reason = f" ({run.faults.name})" if run.faults else ""
            console.print(f"{run.mode.name.lower()}{reason}")
        if panel is not None:
            panel.show(**arm_in_words(run))
        is_open = run.mode is GateMode.OPEN
        if is_entered():
            (run.stop if is_open else run.go)()
        elif go and steps % _ANSWER == 0 and run.mode is GateMode.WAITING:
            run.go()

    try:
        run.play(duration, operate)
    finally:
        metrics = run.metrics()
        for name, value in metrics.items():
            console.print(f"{name.replace('_', ' ')}: {value}")
        if panel is not None:
            panel.show(mode="ended", level="idle", detail="nothing is sent")
        if report is not None:
            write_text(report, json.dumps(metrics, indent=2) + "\n", RunError)


def arm_in_words(run: ArmRun) -> PanelFields:
    """Return what the panel of a page says of an arm."""
    force = max(float(run.output("normal_force")[0]), 0.0)
    fields: PanelFields = {"time": run.seconds, "force": force}
    faults = run.faults.name or ""
    if run.mode is GateMode.OPEN:
        flags = int(run.output("status")[0])
        level, mode, detail = mode_in_words(flags, flags, force)
        return {**fields, "level": level, "mode": mode, "detail": detail}
    if run.mode is GateMode.STOPPED:
        return {**fields, "level": "bad", "mode": "stopped", "detail": faults}
    return {**fields, "level": "idle", "mode": "waiting", "detail": faults}
