"""`fmp-drake video`."""

import contextlib
import io
import os
import shlex
import shutil
import subprocess
import tarfile
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import click

from fmp_drake.apps.options import PATH
from fmp_drake.errors import FmpError
from fmp_drake.primitives.data.files import check_writable


@click.command()
@click.argument("frames", type=PATH)
@click.argument("out", type=PATH)
@click.option("--fps", type=int, default=60, show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace an existing film.")
def video(frames: Path, out: Path, fps: int, overwrite: bool) -> None:
    """Turn FRAMES, the .tar that the page's recorder saves, into the film OUT.

    Needs the extra: pip install fmp-drake[video].
    """
    try:
        import imageio_ffmpeg

        with _quietly():
            from meshcat.animation import convert_frames_to_video
    except ImportError:
        raise FmpError(
            "films need the extra packages: pip install 'fmp-drake[video]'."
        ) from None
    check_writable(out)
    if fps <= 0:
        raise FmpError(f"fps is {fps}; it must be positive.")
    if not frames.is_file():
        raise FmpError(f"there is no frame archive {frames}.")
    if out.exists() and not overwrite:
        raise FmpError(f"{out} exists already; give --overwrite to replace it.")
    _check_frames(frames)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ffmpeg, log = imageio_ffmpeg.get_ffmpeg_exe(), folder / "log"
        raw, film = folder / f"raw{out.suffix}", folder / f"film{out.suffix}"
        # What every player plays: even sizes, and the usual colour format.
        usual = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"]
        usual += ["-vcodec", "libx264", "-crf", "16"]
        try:
            with _ffmpeg_on_path(ffmpeg, folder=folder, log=log), _quietly():
                convert_frames_to_video(str(frames.absolute()), str(raw), framerate=fps)
                subprocess.check_call(["ffmpeg", "-i", str(raw), *usual, str(film)])
        except subprocess.CalledProcessError:
            reason = (log.read_text(errors="replace").strip().splitlines() or ["?"])[-1]
            raise FmpError(
                f"ffmpeg could not make {out} of {frames}: {reason}."
            ) from None
        shutil.move(film, out)
    click.echo(f"wrote {out}")


def _check_frames(frames: Path) -> None:
    try:
        with tarfile.open(frames) as archive:
            names = archive.getnames()
    except (tarfile.TarError, OSError, EOFError):
        names = []
    if not any(name.endswith(".png") for name in names):
        raise FmpError(
            f"{frames} is not a .tar of numbered .png frames; save one from the page: "
            "Open Controls, Animations, default, recording, record."
        )
    if any(Path(name).is_absolute() or ".." in Path(name).parts for name in names):
        raise FmpError(f"{frames} holds files that point out of it; it is not opened.")


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Ignore that meshcat uses what Python and its dependencies have deprecated."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        yield


@contextlib.contextmanager
def _ffmpeg_on_path(ffmpeg: str, *, folder: Path, log: Path) -> Iterator[None]:
    """Let `ffmpeg`, as meshcat's converter calls it, be the packaged one, quietly."""
    shim = folder / "ffmpeg"
    call = f"{shlex.quote(ffmpeg)} -nostdin -loglevel error"
    shim.write_text(f'#!/bin/sh\nexec {call} "$@" 2>>{shlex.quote(str(log))}\n')
    shim.chmod(0o755)
    log.touch()
    before = os.environ.get("PATH", "")
    os.environ["PATH"] = os.pathsep.join([str(folder), before])
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        os.environ["PATH"] = before
