"""`fmp-drake teach`."""

from itertools import count
from math import inf
from pathlib import Path

import click

from fmp_drake.apps.arm_console import (
    ARM_MODEL,
    arm_config,
    guide_arm,
    wipe_with_arm,
)
from fmp_drake.apps.options import PATH, arm_option, host_option
from fmp_drake.apps.page import get_ready, make_console, open_page
from fmp_drake.errors import FmpError, StationError
from fmp_drake.numeric import check_number
from fmp_drake.primitives import save_skill
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.runs.skills import learn_skill
from fmp_drake.runs.teaching.teach_page import TeachPage
from fmp_drake.runs.teaching.teaching_session import TeachingSession
from fmp_drake.station import CheckFeasibility
from fmp_drake.station.parts.hands import MouseOnPage
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.station.warm_up import WarmUp

# Simulated seconds between two looks at the buttons, and between two lines of text.
_STRETCH, _TEXT = 0.1, 1.0


@click.command()
@click.option(
    "--scenario",
    default="table_top",
    show_default=True,
    help="Name of a scenario (see `fmp-drake scenarios`), or a YAML file.",
)
@click.option(
    "--out",
    type=PATH,
    default=Path("taught.npz"),
    show_default=True,
    help="Demonstration (.npz or .csv) to write with the button save.",
)
@click.option(
    "--skill",
    "skill_file",
    type=PATH,
    default=Path("taught_skill.npz"),
    show_default=True,
    help="Skill (.npz) to write with the button save.",
)
@click.option("--duration", type=float, help="End after so many seconds.")
@arm_option("Guide an arm, for --duration or until Enter; it learns, and wipes on.")
@host_option
def teach(
    scenario: str,
    out: Path,
    skill_file: Path,
    duration: float | None,
    arm: str | None,
    host: str,
) -> None:
    """Teach the arm with the mouse: drag it on the page, press learn, and it wipes on.

    Or, with --arm, a real one by hand.
    """
    console = make_console()
    for target in (out, skill_file):
        check_writable(target)
    if duration is not None:
        check_number(duration, "duration", above=0, unit="s", error=FmpError)
    scene = LoadScenario(scenario)
    if arm is not None:
        config = arm_config(arm)
        shown = guide_arm(console, scene, config, duration or inf)
        shown.save(out)
        skill = learn_skill(
            [shown],
            window=scene.skill.window,
            components=scene.skill.components,
            model=ARM_MODEL,
        )
        save_skill(skill, skill_file)
        console.print(f"wrote {out} and {skill_file}")
        found = CheckFeasibility(scene, skill)
        if not found.is_feasible:
            raise StationError(found.verdict)
        wipe_with_arm(console, scene, skill, config, inf)
        return
    panel = open_page(title=f"teach: {Path(scenario).stem}", host=host)
    get_ready(panel, scene)
    console.print(f"teach it at {panel.url}; Ctrl-C ends")
    with console.status("getting ready"):
        WarmUp()
    session = TeachingSession(
        scene, MouseOnPage(panel.meshcat), panel=panel, out=out, skill_file=skill_file
    )
    page = TeachPage(panel, scene)
    stretches = count() if duration is None else range(round(duration / _STRETCH))
    for stretch in stretches:
        session.advance(_STRETCH)
        if button := page.attend(session):
            console.print(f"{button}: {session.remark or session.status}")
        elif stretch % round(_TEXT / _STRETCH) == 0:
            page.show(session)
