"""`fmp-drake inspect`."""

import re
from pathlib import Path

import click

from fmp_drake.apps.options import (
    PATH,
    Command,
    GroupedOption,
    RecordingOptions,
    RhythmOptions,
    arguments,
    options,
)
from fmp_drake.apps.page import make_console, print_next
from fmp_drake.errors import DemonstrationError
from fmp_drake.plots import plot_demonstrations
from fmp_drake.plots.style import check_picture
from fmp_drake.primitives import find_rhythm, read_demonstrations
from fmp_drake.skills.description import describe_recording

# Options in a refusal with which a recording can be learned.
_ADVICE = re.compile(r"--(?:robot|unit) \w+|--as-recorded")


@click.command(
    cls=Command,
    examples={
        "fmp-drake inspect mine.csv --plot mine.png": "look at a recording",
        'fmp-drake inspect log.csv --columns "time=stamp [ms],x=px,y=py,z=pz"': (
            "name its columns"
        ),
    },
)
@click.argument("files", nargs=-1, required=True, type=PATH)
@click.option(
    "--plot",
    type=PATH,
    help="Picture of the recordings.",
    cls=GroupedOption,
    group="Files to write",
)
@options(rhythm=RhythmOptions, recording=RecordingOptions)
def inspect(
    files: tuple[Path, ...],
    plot: Path | None,
    rhythm: RhythmOptions,
    recording: RecordingOptions,
) -> None:
    """Report what recordings contain, and whether they can be learned.

    Several recordings are learned together, where they have the same channels.
    """
    console = make_console()
    check_picture(plot)
    recordings, reports = [], list[str]()
    for file in files:
        demonstrations, _ = read_demonstrations([file], recording.reading())
        for demonstration in demonstrations:
            about = demonstration.note or "as it is"
            console.print(f"{file}: {about}", markup=False, soft_wrap=True)
            lines = describe_recording(
                demonstration, start=rhythm.start, end=rhythm.end, period=rhythm.period
            )
            reports.append(lines[-1])
            for line in lines:
                console.print(f"  {line}", markup=False, soft_wrap=True)
        recordings += demonstrations
    if len(recordings) > 1 and len({d.channels for d in recordings}) == 1:
        try:
            found = find_rhythm(
                recordings, start=rhythm.start, end=rhythm.end, period=rhythm.period
            )
            about = "; ".join(found.describe())
        except DemonstrationError as error:
            about = f"no cycles found: {error}"
        console.print(f"together: {about}", markup=False, soft_wrap=True)
    if plot is not None:
        plot_demonstrations(recordings, plot)
        console.print(f"wrote {plot}")
    refused = [line for line in reports if "not for the board" in line]
    advice = _ADVICE.search(refused[0]) if refused else None
    is_possible = all(line.startswith("learning: possible") for line in reports)
    if is_possible and (advice or not refused):
        given = [*arguments(rhythm, recording), *(advice[0].split() if advice else ())]
        print_next(console, "learn", *map(str, files), *given, "--out", "skill.npz")
