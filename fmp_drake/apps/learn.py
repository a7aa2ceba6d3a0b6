"""`fmp-drake learn`."""

import time
from pathlib import Path

import click

from fmp_drake.apps.options import PATH, skill_options
from fmp_drake.apps.page import make_console
from fmp_drake.plots import plot_skill
from fmp_drake.plots.outputs import check_picture
from fmp_drake.primitives import save_skill
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.runs.skills import learn_skill, load_on_board
from fmp_drake.station.scenario import Scenario


@click.command()
@click.argument("demonstrations", nargs=-1, required=True, type=PATH)
@click.option("--out", type=PATH, required=True, help="Skill file (.npz) to write.")
@click.option("--plot", type=PATH, help="Picture of the skill to write.")
@skill_options
def learn(
    demonstrations: tuple[Path, ...],
    out: Path,
    plot: Path | None,
    transform: tuple[float, ...] | None,
    stretch: float,
    window: float | None,
    components: int | None,
) -> None:
    """Learn a skill from DEMONSTRATIONS (.npz or .csv) and write it to a file."""
    console = make_console()
    check_writable(out)
    check_picture(plot)
    loaded, remarks = load_on_board(
        demonstrations, scenario=Scenario(), transform=transform, stretch=stretch
    )
    for remark in remarks:
        console.print(remark)
    started = time.perf_counter()
    with console.status("learning") as status:
        skill = learn_skill(
            loaded, window=window, components=components, progress=status.update
        )
    console.print(
        f"learned {len(skill.components_)} components from {skill.n_windows_} windows "
        f"of {skill.n_steps / skill.rate:g} s in {time.perf_counter() - started:.2f} s"
    )
    save_skill(skill, out)
    console.print(f"wrote {out}")
    if plot is not None:
        plot_skill(skill, loaded, plot)
        console.print(f"wrote {plot}")
