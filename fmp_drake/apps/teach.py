"""`fmp-drake teach`."""

from dataclasses import dataclass
from itertools import count
from math import inf
from pathlib import Path

from rich.console import Console

from fmp_drake.apps.arm_console import (
    ARM_MODEL,
    arm_config,
    guide_arm,
    wipe_with_arm,
)
from fmp_drake.apps.options import (
    SKILL_FLAGS,
    ScenarioOptions,
    arguments,
    arm_option,
    command,
    host_option,
    option,
)
from fmp_drake.apps.page import (
    ended_page,
    make_console,
    open_page,
    print_next,
    say,
    show_preparation,
)
from fmp_drake.apps.terminal import has_terminal
from fmp_drake.errors import FmpError, RunError, StationError
from fmp_drake.primitives import save_skill
from fmp_drake.primitives.data.files import check_writable, keep_earlier_files
from fmp_drake.runs import ArmRun, CheckWithRehearsal, TeachingSession
from fmp_drake.runs.real_time import ignored_signals
from fmp_drake.runs.teach_page import TeachPage
from fmp_drake.runs.teaching_session import check_names
from fmp_drake.skills import learn_skill
from fmp_drake.station import MouseOnPage, WarmUp
from fmp_drake.systems import PagePanel

# Simulated time between two polls of the buttons, and between two updates of the panel, s.
_STEP, _UPDATE_PERIOD = 0.1, 1.0


@dataclass(frozen=True, kw_only=True)
class TeachOptions(ScenarioOptions):
    """Scene, and files to write."""

    out: Path = option(
        Path("taught.npz"),
        "Demonstration (.npz or .csv) that the button save writes.",
    )
    skill_file: Path = option(
        Path("taught_skill.npz"),
        "Skill (.npz) that the button save writes.",
        flags=SKILL_FLAGS,
    )
    duration: float | None = option(None, "End after this time, s.", above=0)
    arm: str | None = arm_option(
        "Guide an arm by hand, for --duration or until Enter; then it plays the skill."
    )
    host: str = host_option()


@command(
    {
        "fmp-drake teach": "guide the arm with the mouse on a page",
        "fmp-drake teach --scenario vertical --skill mine.npz": "on another board",
    }
)
def teach(to: TeachOptions) -> None:
    """Teach the arm with the mouse: drag it on the page, press learn, and it continues.

    With --arm a real arm is taught by hand.
    """
    console = make_console()
    check_writable(to.out)
    scene = to.load()
    check_names(scene, to.out, to.skill_file)
    if to.arm is not None:
        if to.duration is None and not has_terminal():
            raise FmpError(
                "without a terminal nothing ends the recording: give --duration."
            )
        config = arm_config(to.arm)
        demonstration = guide_arm(console, scene, config, to.duration or inf)
        if kept := keep_earlier_files(to.out, to.skill_file):
            console.print(f"earlier files are now {', '.join(kept)}")
        demonstration.save(to.out)
        skill = learn_skill(
            [demonstration],
            window=scene.skill.window,
            n_components=scene.skill.n_components,
            model=ARM_MODEL,
        )
        save_skill(skill, to.skill_file)
        console.print(f"wrote {to.out} and {to.skill_file}")
        feasibility = CheckWithRehearsal(scene, skill, say=console.print)
        if not feasibility.is_feasible:
            raise StationError(feasibility.verdict)
        wipe_with_arm(console, ArmRun(scene, skill, config), inf)
        return
    panel = open_page(title=f"teach: {Path(to.scenario).stem}", host=to.host)
    with ended_page(panel):
        show_preparation(panel, scene)
        console.print(f"teach it at {panel.url}; Ctrl-C saves and ends")
        with console.status("getting ready"):
            WarmUp(lambda fraction: panel.show(progress=fraction))
        session = TeachingSession(
            scene,
            MouseOnPage(panel.meshcat),
            panel=panel,
            out=to.out,
            skill_file=to.skill_file,
        )
        page = TeachPage(panel, scene)
        steps = count() if to.duration is None else range(round(to.duration / _STEP))
        try:
            for step in steps:
                session.advance(_STEP)
                if button := page.press_clicked_button(session):
                    console.print(f"{button}: {session.remark or session.status}")
                elif step % round(_UPDATE_PERIOD / _STEP) == 0:
                    page.show(session)
        finally:
            _save_rest(console, panel, session)
            if session.skill is not None and session.is_done:
                flags = arguments(ScenarioOptions(scenario=to.scenario, robot=to.robot))
                print_next(console, "wipe", *flags, "--skill", str(to.skill_file))


def _save_rest(console: Console, panel: PagePanel, session: TeachingSession) -> None:
    """Save what was not saved: nobody can teach it again in the same way.

    Less than a window of a movement, such as an accidental drag, is not worth a file.
    """
    if session.skill is None and session.progress < 0.5:
        return
    with ignored_signals():
        session.press("save")
    say(console, panel, f"save: {session.remark}")
    if not session.is_done:
        raise RunError("what was taught is not saved.")
