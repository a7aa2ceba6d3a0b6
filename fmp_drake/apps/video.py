"""`fmp-drake video`."""

from functools import partial
from pathlib import Path

import click

from fmp_drake.apps.options import PATH, Command
from fmp_drake.apps.page import make_console, track_frames
from fmp_drake.errors import FmpError
from fmp_drake.film.encode import convert_frames
from fmp_drake.primitives.data.files import check_writable


@click.command(
    cls=Command,
    examples={
        "fmp-drake video frames.tar run.mp4": "a film of frames recorded on the page",
    },
)
@click.argument("frames", type=PATH)
@click.argument("out", type=PATH)
@click.option(
    "--fps",
    type=int,
    default=60,
    show_default=True,
    help="Frames per second of the film.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing film.")
def video(frames: Path, out: Path, fps: int, overwrite: bool) -> None:
    """Turn FRAMES, the .tar file of the page's recorder, into the film OUT.

    Needs the extra: pip install fmp-drake[video].
    """
    check_writable(out)
    if out.exists() and not overwrite:
        raise FmpError(f"{out} already exists; give --overwrite to replace it.")
    convert_frames(frames, out, fps=fps, track=partial(track_frames, make_console()))
    click.echo(f"wrote {out}")
