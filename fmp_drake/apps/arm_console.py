"""Operator console of an arm behind LCM."""

from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from fmp_drake.apps.page import write_metrics
from fmp_drake.apps.terminal import has_terminal, is_enter_pressed
from fmp_drake.errors import RunError, StationError
from fmp_drake.primitives import Demonstration
from fmp_drake.primitives.model.movement_primitive import ModelChoice
from fmp_drake.runs import ArmRun, record_arm
from fmp_drake.station import LcmPanda, Scenario
from fmp_drake.station.robots.panda_lcm import LoadPanda
from fmp_drake.systems import GateMode
from fmp_drake.systems.page.page_panel import PanelFields
from fmp_drake.systems.page.page_status import mode_in_words
from fmp_drake.systems.panda.arm_status import faults_in_words

ARM_MODEL: ModelChoice = "mixture"
"""Model of the skills of a real arm, which cannot wait: a re-mapping, including the choice of
a sample, takes 11 ms with a mixture and 36 ms with a phase model."""

# Control steps between two checks of the keyboard, and between two requests of --go.
_KEYBOARD_STEPS, _REQUEST_STEPS = 100, 500


def arm_config(arm: str, *, dry: bool = False) -> LcmPanda:
    """Return the driver that `--arm` names: `lcm`, `lcm:URL` or a YAML file."""
    if arm.endswith((".yaml", ".yml")):
        config = LoadPanda(arm)
        if not isinstance(config, LcmPanda):
            raise StationError(f"{arm} is not an arm behind LCM; expected !LcmPanda.")
    elif arm == "lcm" or arm.startswith("lcm:"):
        config = LcmPanda(url=arm[4:])
    else:
        raise StationError(f"--arm is {arm}; expected lcm, lcm:URL or a YAML file.")
    config.gate.dry = config.gate.dry or dry
    return config


def guide_arm(
    console: Console,
    scenario: Scenario,
    config: LcmPanda,
    duration: float,
    *,
    is_ended: Callable[[], bool] = lambda: False,
) -> Demonstration:
    """Record the hand guiding of an arm, until Enter or `is_ended`, or for a duration, s."""
    end = "Enter ends it" if has_terminal() else f"for {duration:g} s"
    console.print(f"nothing is sent: guide the arm now, pressing lightly; {end}")
    demonstration = record_arm(
        scenario,
        config,
        until=lambda elapsed: elapsed >= duration or is_enter_pressed() or is_ended(),
        remark=console.print,
        note="guided by hand, on an arm behind LCM",
    )
    console.print(recorded_text(demonstration))
    return demonstration


def recorded_text(demonstration: Demonstration, *, has_board: bool = True) -> str:
    """Describe the duration and the range of a recording, on the board if there is one."""
    low, high = demonstration.values.min(axis=0), demonstration.values.max(axis=0)
    ranges = [f"{c} {low[i]:.3f} to {high[i]:.3f} m" for i, c in enumerate("xyz")]
    place = " on the board" if has_board else ""
    return (
        f"recorded {demonstration.duration:.1f} s at 20 Hz: {', '.join(ranges)}{place}"
    )


def wipe_with_arm(
    console: Console,
    run: ArmRun,
    duration: float,
    *,
    go: bool = False,
    report: Path | None = None,
) -> None:
    """Play the skill of a run on an arm; Enter enables and stops it.

    Parameters
    ----------
    console : Console
    run : ArmRun
    duration : float
        Longest time, s.
    go : bool
        Enable the arm without Enter.
    report : pathlib.Path, optional
        File for the metrics (.json).
    """
    if not (go or has_terminal()):
        raise RunError(
            "there is no terminal in which to enable the arm; use one, or --go for a "
            "simulated arm."
        )
    if has_terminal():
        console.print("Enter enables the arm, and stops it; Ctrl-C ends the program")
    last_state = None
    steps = 0

    def operate(run: ArmRun) -> None:
        nonlocal last_state, steps
        steps += 1
        if steps % _KEYBOARD_STEPS:
            return
        if (state := (run.mode, run.faults)) != last_state:
            last_state = state
            reason = f" ({run.faults.name})" if run.faults else ""
            console.print(f"{run.mode.name.lower()}{reason}")
        if run.panel is not None:
            run.panel.show(**arm_in_words(run))
        if is_enter_pressed():
            (run.stop if run.mode.is_enabled else run.go)()
        elif go and steps % _REQUEST_STEPS == 0 and run.mode is GateMode.WAITING:
            run.go()

    if run.panel is not None:
        run.panel.show(progress=None)
    try:
        run.play(duration, operate)
    finally:
        metrics = run.metrics()
        for name, value in metrics.items():
            console.print(f"{name.replace('_', ' ')}: {value}")
        events = run.events()
        console.print("what went wrong: ", end="")
        console.print("; ".join(event.text for event in events) or "nothing")
        metrics["events"] = [event._asdict() for event in events]
        if run.panel is not None:
            run.panel.show(mode="ended", level="idle", detail="nothing is sent")
        write_metrics(console, metrics, report)


def arm_in_words(run: ArmRun) -> PanelFields:
    """Return the fields of a page's panel for an arm."""
    fields: PanelFields = {"time": run.seconds}
    force = None
    if run.scenario.has_board:
        force = fields["force"] = max(float(run.output("normal_force")[0]), 0.0)
        fields["desired_force"] = run.desired_force
    faults = faults_in_words(run.faults)
    if run.mode is GateMode.OPEN:
        flags = int(run.output("status")[0])
        level, mode, detail = mode_in_words(
            flags, flags, force, desired=run.desired_force
        )
        return {**fields, "level": level, "mode": mode, "detail": detail}
    if run.mode is GateMode.RETURNING:
        return {**fields, "level": "good", "mode": "returning slowly", "detail": ""}
    hint = "Enter in the terminal enables the arm" if has_terminal() else ""
    if run.mode is GateMode.STOPPED:
        fields |= {"level": "bad", "mode": "stopped"}
        hint = hint and f"{hint} again"
    else:
        fields |= {"level": "idle", "mode": "waiting"}
    detail = "; ".join(text for text in (faults, hint) if text)
    return {**fields, "detail": detail}
