"""`fmp-drake wipe`."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from fmp_drake.apps.arm_console import ARM_MODEL, arm_config, wipe_with_arm
from fmp_drake.apps.options import (
    LearningOptions,
    RecordingOptions,
    SceneOptions,
    arm_option,
    command,
    host_option,
    option,
    real_time_option,
)
from fmp_drake.apps.page import (
    advice,
    ended_page,
    is_watched,
    make_console,
    open_page,
    print_table,
    say,
    show_preparation,
    show_progress,
    wait_for_click,
    wait_for_law,
)
from fmp_drake.apps.run_report import RunFiles, report_rows
from fmp_drake.apps.terminal import has_terminal, noted_interrupts
from fmp_drake.errors import RunError, StationError
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.runs import ArmRun, CheckWithRehearsal, MakeRun, StationRun
from fmp_drake.runs.events import ADVICE
from fmp_drake.runs.real_time import request_priority
from fmp_drake.runs.simulation_loop import advance, reset
from fmp_drake.skills import scenario_skill
from fmp_drake.skills.description import (
    model_in_words,
    outside_in_words,
    source_in_words,
)
from fmp_drake.station import Scenario
from fmp_drake.station.page import describe_page
from fmp_drake.station.reach.feasibility import CheckFeasibility, Feasibility
from fmp_drake.station.scenario_parts import ShowConfig
from fmp_drake.station.warm_up import LawCompilation
from fmp_drake.systems.page.page_panel import Level, PagePanel

# Simulated time of a run without a viewer, s.
_DURATION = 60.0
# Simulated time between two updates of the panel, and a time just below the interval at
# which `advance` yields, s.
_UPDATE_PERIOD, _INTERVAL = 1.0, 0.0999
_RUN_ANYWAY = "run anyway"
_BUTTONS_AFTER_A_RUN = {
    "continue": "continue the run from here",
    "again": "start again, as at the beginning",
}


@dataclass(frozen=True, kw_only=True)
class PlayOptions:
    """Playback."""

    duration: float | None = option(
        None,
        "Simulated time, s [default: 60, and longer while the page is open; with --arm and "
        "Enter: until Ctrl-C].",
        above=0,
    )
    sample: bool | None = option(
        None,
        "Track samples of the components, or their means [default: the scenario's, "
        "samples].",
        flags=["--sample/--mean"],
        basic=False,
    )
    seed: int | None = option(
        None,
        "Seed of the samples [default: the scenario's, 0].",
        basic=False,
        least=0,
    )
    target_realtime_rate: float | None = option(
        None,
        "Simulated seconds per second; 0 is as fast as possible [default: the scenario's, "
        "or 1; headless: 0].",
        basic=False,
        least=0,
    )
    force: bool = option(False, "Run even if the arm cannot follow the skill.")

    @property
    def least_duration(self) -> float:
        """Simulated time after which a run without a viewer ends, s."""
        return _DURATION if self.duration is None else self.duration


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Page."""

    headless: bool = option(False, "Run as fast as possible, without a page.")
    hide: tuple[str, ...] = option(
        (),
        "Part that the page does not show; may be repeated.",
        basic=False,
        type=click.Choice(list(vars(ShowConfig()))),
    )
    host: str = host_option()


@dataclass(frozen=True, kw_only=True)
class ArmOptions:
    """Arm behind LCM, in place of the simulated one."""

    arm: str | None = arm_option(
        "Move a real arm, or the one that `fmp-drake arm` simulates."
    )
    dry: bool = option(False, "With --arm: send zero torques only.", basic=False)
    go: bool = option(
        False, "With --arm: start without asking; never with a real arm.", basic=False
    )
    controls: bool = option(
        False,
        "With --arm: let the page change tempo and press force.",
        basic=False,
    )
    real_time: bool = real_time_option()

    def check(self, play: PlayOptions) -> None:
        """Check that options of an arm come with an arm, and those of a simulation do not."""
        of_simulation = (play.sample, play.seed, play.target_realtime_rate)
        if self.arm and any(value is not None for value in of_simulation):
            raise RunError(
                "--sample, --mean, --seed and --target-realtime-rate are for the simulated "
                "arm; leave them out with --arm."
            )
        options = (self.dry, self.go, self.controls, self.real_time)
        if self.arm is None and any(options):
            raise RunError(
                "--dry, --go, --controls and --real-time need an arm; name it with --arm."
            )


@command(
    {
        "fmp-drake wipe": "wipe a table top, with a page to watch and pull the arm",
        "fmp-drake wipe --scenario vertical --tempo 0.8": "another board, slower",
        "fmp-drake wipe --demo mine.csv": "learn from your recording",
        "fmp-drake wipe --headless --plot run.png": "no page, a picture of the run",
    }
)
def wipe(
    scene: SceneOptions,
    play: PlayOptions,
    page: PageOptions,
    files: RunFiles,
    arm: ArmOptions,
    learning: LearningOptions,
    recording: RecordingOptions,
) -> None:
    """Learn a skill from a demonstration and play it: wipe a board, or follow a motion."""
    console = make_console()
    inputs = (*scene.demonstrations, scene.skill_file, Path(scene.scenario))
    files.check(of_arm=arm.arm is not None, inputs=inputs)
    arm.check(play)
    scenario = scene.load()
    for part in page.hide:
        setattr(scenario.show, part, False)
    config = None if arm.arm is None else arm_config(arm.arm, dry=arm.dry)
    title = Path(scene.scenario).stem
    law, panel = LawCompilation(), None
    if files.html or not page.headless:
        announce = None if page.headless else console
        panel = open_page(announce, title=title, host=page.host)
    with ended_page(panel):
        if panel is not None and not page.headless:
            show_preparation(panel, scenario if config is None else None)
        start = time.perf_counter()
        skill, demonstrations, remarks = scenario_skill(
            scenario,
            demonstrations=scene.demonstrations,
            skill_file=scene.skill_file,
            model=None if config is None else ARM_MODEL,
            reading=recording.reading(),
            **vars(learning),
        )
        scene.check(scenario, skill)
        learn_seconds = time.perf_counter() - start
        for text in (
            *remarks,
            f"skill of {source_in_words(skill)}, ready after {learn_seconds:.2f} s",
            model_in_words(skill),
            *outside_in_words(skill),
        ):
            say(console, panel, text)
        # With --force no rehearsal changes what is done.
        check: Callable[[Scenario, FourierMovementPrimitive], Feasibility] = (
            CheckFeasibility
            if play.force
            else partial(CheckWithRehearsal, say=partial(say, console, panel))
        )
        feasibility = check(scenario, skill)
        if not (
            feasibility.is_feasible
            or play.force
            or _is_run_anyway(console, panel, feasibility, scenario)
        ):
            parts = feasibility.verdict, advice(feasibility, scene, learning, recording)
            text = " ".join(filter(None, parts))
            raise StationError(f"{text} (--force runs it anyway).")
        if scenario.skill.tempo == feasibility.suggested_tempo:  # A viewer has set it.
            feasibility = check(scenario, skill)
        say(console, panel, feasibility.verdict)
        wait_for_law(console, panel, law)

        options: dict[str, Any] = {
            "demonstrations": demonstrations,
            "meshcat": None if panel is None else panel.meshcat,
            "panel": panel,
        }
        if config is not None:
            # The page shows a real arm, and controls it only with --controls.
            scenario.show.ink = scenario.show.force = scenario.show.mouse = False
            scenario.show.controls = arm.controls
            for refusal in request_priority() if arm.real_time else ():
                console.print(refusal)
            arm_run = ArmRun(scenario, skill, config, **options)
            # It is unknown when Enter will be pressed.
            is_endless = play.duration is None and not arm.go
            duration = math.inf if is_endless else play.least_duration
            wipe_with_arm(console, arm_run, duration, go=arm.go, report=files.report)
            return
        run = MakeRun(
            scenario,
            skill,
            sample=play.sample,
            seed=play.seed,
            recording=files.html is not None,
            keep=files.signals(),
            **options,
        )
        about = {"scenario": scene.scenario, "learn_seconds": learn_seconds}
        _simulate(console, run, play, page, files, about=about, title=title)


def _is_run_anyway(
    console: Console,
    panel: PagePanel | None,
    feasibility: Feasibility,
    scenario: Scenario,
) -> bool:
    """Return whether a viewer of the page decides to run an infeasible skill.

    If it is feasible at a slower tempo, a button sets that tempo.
    """
    if panel is None or not is_watched(panel):
        return False
    tempo, buttons = feasibility.suggested_tempo, {}
    if tempo is not None:
        hint = "the fastest tempo at which the arm can follow"
        buttons[f"set tempo to {tempo:.2f}"] = hint
    buttons[_RUN_ANYWAY] = "like --force"
    panel.show(
        mode="not feasible", level="busy", detail=feasibility.verdict, progress=None
    )
    console.print(f"{feasibility.verdict} Choose on the page; Enter ends it.")
    choice = wait_for_click(panel, buttons)
    if choice is None:
        return False
    if tempo is not None and choice != _RUN_ANYWAY:
        scenario.skill.tempo = tempo
    panel.show(mode="getting ready", level="idle", detail="")
    say(console, panel, choice)
    return True


def _simulate(
    console: Console,
    run: StationRun,
    play: PlayOptions,
    page: PageOptions,
    files: RunFiles,
    *,
    about: dict[str, Any],
    title: str,
) -> None:
    """Simulate and report runs until the viewer requests no further run."""
    panel = None if page.headless else run.panel
    reel = files.begin(console, run)
    rate = play.target_realtime_rate
    if rate is None:
        config = run.scenario.simulator
        rate = config.target_realtime_rate or (0.0 if page.headless else 1.0)
    run.simulator.set_target_realtime_rate(rate)
    end, written, choice = play.least_duration, None, None
    while True:
        if panel is not None:
            grab = describe_page(run.scenario)["grab"]
            panel.show(summary=[], progress=None, grab=grab)
            if choice is not None:  # It takes the last message off the page.
                panel.say(choice, level="idle")
                if files.are_results():
                    text = (
                        f"the files hold the first run, which ended at {written:.1f} s"
                    )
                    say(console, panel, text)
        times = advance(
            run.simulator,
            end,
            meshcat=None if page.headless else run.meshcat,
            panel=run.panel,
            advance_to=run.advance_to,
            on_reset=partial(_restart, run, panel),
            keep_running=partial(_continues, panel, play, choice),
        )
        if panel is not None:
            times = _show_events(times, run, panel, rate)
        # The files of an interrupted run are written, too.
        noted = (
            noted_interrupts() if files.are_results() else nullcontext(lambda: False)
        )
        with noted as is_stopped:
            times = takewhile(lambda _: not is_stopped(), times)
            show_progress(console, times, until=end, label="running")
        seconds = run.simulator.get_context().get_time()
        run.remove_controls()
        metrics = {
            "scenario": about["scenario"],
            "simulated_seconds": seconds,
            "wall_seconds": run.wall_seconds,
            "real_time_factor": seconds / max(run.wall_seconds, 1e-9),
            "learn_seconds": about["learn_seconds"],
            **run.metrics(),
            "events": [event._asdict() for event in run.events()],
        }
        rows = report_rows(metrics)
        print_table(console, rows)
        if run.panel is not None:
            faults = rows["what went wrong"]
            run.show_status()
            run.panel.show(mode="finished", level="idle", detail="", rate=1.0, grab="")
            run.panel.show(summary=[row for row in rows.items() if row[1] != faults])
            level: Level = "good" if faults == "nothing" else "busy"
            run.panel.say(f"what went wrong: {faults}", level=level)
        if written is None:
            files.write(console, run, metrics, reel=reel, title=title)
            written = seconds
        if panel is None or is_stopped():
            return
        if has_terminal():
            console.print("the page stays open; press Enter to quit ", end="")
        choice = wait_for_click(panel, _BUTTONS_AFTER_A_RUN)
        if choice is None:
            return
        if choice == "again":
            reset(run.simulator)
            run.restart()
        end = play.least_duration if choice == "again" else seconds


def _restart(run: StationRun, panel: PagePanel | None) -> None:
    """Discard the results of a run and its last message on the page."""
    run.restart()
    if panel is not None:
        panel.show(rate=1.0)
        panel.say("reset", level="idle")


def _continues(panel: PagePanel | None, play: PlayOptions, choice: str | None) -> bool:
    """Return whether a run continues after its duration."""
    return (play.duration is None or choice is not None) and is_watched(panel)


def _show_events(
    times: Iterable[float], run: StationRun, panel: PagePanel, rate: float
) -> Iterator[float]:
    """Yield the times of a run, and show its events and its speed on the page."""
    kinds: set[str] = set()
    for now in times:
        if now < _UPDATE_PERIOD:
            kinds = set()
        if now % _UPDATE_PERIOD < _INTERVAL:
            if rate > 0:
                panel.show(rate=run.simulator.get_actual_realtime_rate() / rate)
            for event in run.recent_events():
                if event.kind in ADVICE and event.kind not in kinds:
                    kinds.add(event.kind)
                    panel.say(f"{event.text}. {ADVICE[event.kind]}", level="busy")
        yield now
