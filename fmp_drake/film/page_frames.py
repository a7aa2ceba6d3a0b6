"""A film of the pictures that the recorder of a Meshcat page saves."""

import contextlib
import io
import os
import shlex
import subprocess
import tarfile
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import replaced

# What every player plays: even sizes, and the most common colour format.
_ENCODING = (
    *("-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"),
    *("-vcodec", "libx264", "-crf", "16"),
)


def convert_frames(frames: Path, out: Path, *, fps: int) -> None:
    """Make a film of an archive of numbered pictures.

    Parameters
    ----------
    frames : pathlib.Path
        A .tar of .png.
    out : pathlib.Path
        Any film that ffmpeg writes; an existing one is replaced at the end.
    fps : int
        Frames per second.

    Raises
    ------
    RunError
        Where the film cannot be made, or the packages for films are missing.
    """
    try:
        import imageio_ffmpeg

        with _quietly():
            from meshcat.animation import convert_frames_to_video
    except ImportError:
        raise RunError(
            "films need the extra packages: pip install 'fmp-drake[video]'."
        ) from None
    if fps <= 0:
        raise RunError(f"fps is {fps}; it must be positive.")
    if not frames.is_file():
        raise RunError(f"there is no frame archive {frames}.")
    _check_frames(frames)
    with tempfile.TemporaryDirectory() as name, replaced(out, RunError) as part:
        folder = Path(name)
        log, raw = folder / "log", folder / f"raw{out.suffix}"
        ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
        try:
            with _ffmpeg_on_path(ffmpeg, folder=folder, log=log), _quietly():
                convert_frames_to_video(str(frames.absolute()), str(raw), framerate=fps)
                command = ["ffmpeg", "-i", str(raw), *_ENCODING, str(part)]
                subprocess.check_call(command)
        except subprocess.CalledProcessError:
            reason = (log.read_text(errors="replace").strip().splitlines() or ["?"])[-1]
            raise RunError(
                f"ffmpeg could not make {out} of {frames}: {reason}."
            ) from None


def _check_frames(frames: Path) -> None:
    try:
        with tarfile.open(frames) as archive:
            names = archive.getnames()
    except (tarfile.TarError, OSError, EOFError):
        names = []
    if not any(name.endswith(".png") for name in names):
        raise RunError(
            f"{frames} is not a .tar of numbered .png frames; save one from the page: "
            "Open Controls, Animations, default, recording, record."
        )
    if any(Path(name).is_absolute() or ".." in Path(name).parts for name in names):
        raise RunError(f"{frames} holds files that point out of it; it is not opened.")


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
