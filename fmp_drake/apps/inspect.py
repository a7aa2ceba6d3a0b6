"""`fmp-drake inspect`."""

import re
from dataclasses import dataclass
from pathlib import Path

import click

from fmp_drake.apps.options import (
    PATH,
    RecordingOptions,
    RhythmOptions,
    arguments,
    command,
    option,
)
from fmp_drake.apps.page import make_console, print_next
from fmp_drake.errors import DemonstrationError
from fmp_drake.plots import plot_demonstrations
from fmp_drake.plots.style import check_picture
from fmp_drake.primitives import find_rhythm, read_demonstrations
from fmp_drake.primitives.data.reading.parts import is_part
from fmp_drake.skills.description import board_part, describe_recording
from fmp_drake.skills.loading import options_for_left_out
from fmp_drake.skills.placement import common_placement
from fmp_drake.station import Scenario

# Options that a refusal names, with which the recording can be learned.
_ADVICE = re.compile(r"--(?:robot|unit) \w+|--as-recorded")


@dataclass(frozen=True, kw_only=True)
class PictureOptions:
    """Files to write."""

    plot: Path | None = option(None, "Picture of the recordings.")


@command(
    {
        "fmp-drake inspect mine.csv --plot mine.png": "look at a recording",
        'fmp-drake inspect log.csv --columns "time=stamp [ms],x=px,y=py,z=pz"': (
            "name its columns"
        ),
    }
)
@click.argument("files", nargs=-1, required=True, type=PATH)
def inspect(
    files: tuple[Path, ...],
    picture: PictureOptions,
    rhythm: RhythmOptions,
    recording: RecordingOptions,
) -> None:
    """Report what recordings contain, and whether they can be learned.

    Several recordings with the same channels are learned together.
    """
    console = make_console()
    check_picture(picture.plot)
    recordings, parts, conclusions = [], [], list[str]()
    reading = recording.reading()
    loaded = [(f, d) for f in files for d in read_demonstrations([f], reading)[0]]
    positions = [file for file, d in loaded if not is_part(d.channels, d.units)]
    if 0 < len(positions) < len(loaded):  # The others are added to these.
        joined, _ = read_demonstrations(files, reading)
        if len(joined) == len(positions):  # Saved recordings are not added.
            loaded = list(zip(positions, joined, strict=True))
    common = common_placement(
        [d for _, d in loaded], scenario=Scenario(), **vars(rhythm)
    )
    # Once for each file.
    left_out = {f: options_for_left_out(f, d, reading) for f, d in dict(loaded).items()}
    for file, demonstration in loaded:
        note = demonstration.note or "no remarks"
        console.print(f"{file}: {note}", soft_wrap=True)
        on_board = board_part(demonstration, placement=common, **vars(rhythm))
        parts.append(on_board[0])
        lines = describe_recording(demonstration, on_board=on_board, **vars(rhythm))
        conclusions.append(lines[-1])
        if options := left_out[file]:
            lines.insert(-1, f"to learn more of it: --surface fitted {options}")
        for line in lines:
            console.print(f"  {line}", soft_wrap=True)
        recordings.append(demonstration)
    found = None
    is_needed = len(recordings) > 1 or picture.plot is not None
    if is_needed and len({d.channels for d in recordings}) == 1:
        try:
            is_common = len({part.channels for part in parts}) == 1
            found = find_rhythm(parts if is_common else recordings, **vars(rhythm))
            text = "; ".join(found.describe())
        except DemonstrationError as error:
            text = f"no cycles found: {error}"
        if len(recordings) > 1:
            console.print(f"together: {text}", soft_wrap=True)
    if picture.plot is not None:
        plot_demonstrations(recordings, picture.plot, rhythm=found)
        console.print(f"wrote {picture.plot}")
    refusals = [line for line in conclusions if "not for the board" in line]
    advice = _ADVICE.search(refusals[0]) if refusals else None
    is_possible = all(line.startswith("learning: possible") for line in conclusions)
    if is_possible and (advice or not refusals):
        flags = [*arguments(rhythm, recording), *(advice[0].split() if advice else ())]
        print_next(console, "learn", *map(str, files), *flags, "--out", "skill.npz")
