"""`fmp-drake inspect`."""

from pathlib import Path

import click

from fmp_drake.apps.options import PATH, reading_options
from fmp_drake.apps.page import make_console
from fmp_drake.plots.outputs import check_picture
from fmp_drake.plots.recorded import plot_demonstrations
from fmp_drake.primitives import ReadingOptions, read_demonstrations
from fmp_drake.runs.inspection import describe_recording


@click.command()
@click.argument("files", nargs=-1, required=True, type=PATH)
@click.option("--plot", type=PATH, help="Picture of the recordings to write.")
@reading_options
def inspect(
    files: tuple[Path, ...], plot: Path | None, reading: ReadingOptions
) -> None:
    """Tell what is in recordings, and whether they can be learned."""
    console = make_console()
    check_picture(plot)
    shown = []
    for file in files:
        demonstrations, _ = read_demonstrations([file], reading)
        for demonstration in demonstrations:
            about = demonstration.note or "as it is"
            console.print(f"{file}: {about}", markup=False, soft_wrap=True)
            for line in describe_recording(demonstration):
                console.print(f"  {line}", markup=False, soft_wrap=True)
        shown += demonstrations
    if plot is not None:
        plot_demonstrations(shown, plot)
        console.print(f"wrote {plot}")
