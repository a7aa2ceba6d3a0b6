"""`fmp-drake video`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click

from fmp_drake.apps.options import PATH, command, option
from fmp_drake.apps.page import make_console, track_frames
from fmp_drake.film.encode import convert_frames
from fmp_drake.film.render import MAX_FPS
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.files import check_writable


@dataclass(frozen=True, kw_only=True)
class VideoOptions:
    """Film."""

    fps: int | None = option(
        None, "Frames per second of the film [default: 60, in a .gif 50].", above=0
    )


@command(
    {
        "fmp-drake video frames.tar run.mp4": "a film of frames recorded on the page",
    }
)
@click.argument("frames", type=PATH)
@click.argument("out", type=PATH)
def video(frames: Path, out: Path, to: VideoOptions) -> None:
    """Turn FRAMES, the .tar file of the page's recorder, into the film OUT.

    An .mp4 needs the extra: pip install 'fmp-drake[video]'.
    """
    check_writable(out, "a film", [*MAX_FPS, ".mov", ".mkv"])
    most = MAX_FPS.get(out.suffix.lower(), MAX_FPS[".mp4"])
    fps = min(60.0, most) if to.fps is None else to.fps
    check_number(fps, "fps", most=most, hint=f"in a {out.suffix}")
    convert_frames(frames, out, fps=fps, track=partial(track_frames, make_console()))
    click.echo(f"wrote {out}")
