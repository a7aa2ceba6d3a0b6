"""`fmp-drake teach`."""

from itertools import count
from pathlib import Path

import click

from fmp_drake.apps.options import PATH, host_option
from fmp_drake.apps.page import make_console, open_page
from fmp_drake.errors import FmpError
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.runs.skills import scenario_skill
from fmp_drake.runs.teaching.teach_page import TeachPage
from fmp_drake.runs.teaching.teaching_session import TeachingSession
from fmp_drake.runs.wiping_run import WipingRun
from fmp_drake.station.parts.hands import MouseOnPage
from fmp_drake.station.scenario import LoadScenario

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
@host_option
def teach(
    scenario: str, out: Path, skill_file: Path, duration: float | None, host: str
) -> None:
    """Teach the arm with the mouse: drag it on the page, press learn, and it wipes on."""
    console = make_console()
    for target in (out, skill_file):
        check_writable(target)
    if duration is not None:
        check_number(duration, "duration", above=0, unit="s", error=FmpError)
    scene = LoadScenario(scenario)
    with console.status("compiling, once"):
        skill, _, _ = scenario_skill(scene)
        WipingRun(scene, skill).advance_to(0.01)
    panel = open_page(title=f"teach: {Path(scenario).stem}", host=host)
    session = TeachingSession(
        scene, MouseOnPage(panel.meshcat), panel=panel, out=out, skill_file=skill_file
    )
    console.print(f"teach it at {panel.url}; Ctrl-C ends")
    page = TeachPage(panel, scene)
    stretches = count() if duration is None else range(round(duration / _STRETCH))
    for stretch in stretches:
        session.advance(_STRETCH)
        if button := page.attend(session):
            console.print(f"{button}: {session.remark or session.status}")
        elif stretch % round(_TEXT / _STRETCH) == 0:
            page.show(session)
