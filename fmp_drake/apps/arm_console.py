"""What an operator sees and says while a skill moves an arm."""

import json
import select
import sys
from pathlib import Path

from rich.console import Console

from fmp_drake.errors import RunError, StationError
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.primitives.data.files import write_text
from fmp_drake.runs import ArmRun
from fmp_drake.station import LcmPanda, LoadPanda, Scenario
from fmp_drake.systems import GateMode

# Steps between two looks at the keyboard, and until the arm may have answered.
_LOOK, _ANSWER = 100, 500


def arm_config(arm: str, *, dry: bool) -> LcmPanda:
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


def wipe_with_arm(
    console: Console,
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    config: LcmPanda,
    duration: float,
    *,
    go: bool,
    report: Path | None,
) -> None:
    """Play a skill on an arm; Enter lets it go and stops it."""
    run = ArmRun(scenario, skill, config)
    asks = sys.stdin is not None and sys.stdin.isatty()
    if not (go or asks):
        raise RunError(
            "nobody can say go: run it in a terminal, or, only where the arm is a "
            "simulated one, with --go."
        )
    if asks:
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
        is_open = run.mode is GateMode.OPEN
        if asks and select.select([sys.stdin], [], [], 0)[0]:
            sys.stdin.readline()
            (run.stop if is_open else run.go)()
        elif go and steps % _ANSWER == 0 and run.mode is GateMode.WAITING:
            run.go()

    try:
        run.play(duration, operate)
    finally:
        metrics = run.metrics()
        for name, value in metrics.items():
            console.print(f"{name.replace('_', ' ')}: {value}")
        if report is not None:
            write_text(report, json.dumps(metrics, indent=2) + "\n", RunError)
