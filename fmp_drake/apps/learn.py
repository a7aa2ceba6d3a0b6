"""`fmp-drake learn`."""

import time
from pathlib import Path

import click

from fmp_drake.apps.options import PATH, skill_options
from fmp_drake.apps.page import make_console
from fmp_drake.plots import plot_skill
from fmp_drake.plots.outputs import check_picture
from fmp_drake.primitives import (
    FourierMovementPrimitive,
    ReadingOptions,
    save_skill,
)
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.primitives.model.parameters import ModelChoice
from fmp_drake.runs.skill_words import skill_in_words
from fmp_drake.runs.skills import learn_skill, load_as_recorded, load_on_board
from fmp_drake.station.scenario import Scenario


@click.command()
@click.argument("demonstrations", nargs=-1, required=True, type=PATH)
@click.option("--out", type=PATH, required=True, help="Skill file (.npz) to write.")
@click.option("--plot", type=PATH, help="Picture of the skill to write.")
@click.option(
    "--model",
    type=click.Choice(["mixture", "phase", "automatic"]),
    help="How to learn: by Gaussians over windows, by the phase of the movement, or by "
    f"the phase where it can be tracked [default: {FourierMovementPrimitive().model}].",
)
@click.option(
    "--as-recorded",
    is_flag=True,
    help="Learn all channels as they are, instead of x, y and z on the board.",
)
@skill_options
def learn(
    demonstrations: tuple[Path, ...],
    out: Path,
    plot: Path | None,
    model: ModelChoice | None,
    as_recorded: bool,
    reading: ReadingOptions,
    transform: tuple[float, ...] | None,
    stretch: float,
    window: float | None,
    components: int | None,
) -> None:
    """Learn a skill from DEMONSTRATIONS (tables, bags ...) and write it to a file."""
    console = make_console()
    check_writable(out)
    check_picture(plot)
    if as_recorded:
        loaded, remarks = load_as_recorded(
            demonstrations, stretch=stretch, reading=reading
        )
    else:
        loaded, remarks = load_on_board(
            demonstrations,
            scenario=Scenario(),
            transform=transform,
            stretch=stretch,
            reading=reading,
            needs_board=False,
        )
    for remark in remarks:
        console.print(remark, markup=False, soft_wrap=True)
    started = time.perf_counter()
    with console.status("learning") as status:
        skill = learn_skill(
            loaded,
            window=window,
            components=components,
            model=model,
            progress=status.update,
        )
    console.print(
        f"learned {len(skill.components_)} components from {skill.n_windows_} windows "
        f"of {skill.n_steps / skill.rate:g} s in {time.perf_counter() - started:.2f} s"
    )
    for sentence in skill_in_words(skill):
        console.print(sentence)
    save_skill(skill, out)
    console.print(f"wrote {out}")
    if plot is not None:
        plot_skill(skill, loaded, plot)
        console.print(f"wrote {plot}")
