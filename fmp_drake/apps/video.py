"""`fmp-drake video`."""

import contextlib
import io
import os
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path

import click

from fmp_drake.apps.inputs import PATH
from fmp_drake.apps.learn import check_writable
from fmp_drake.errors import FmpError


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
    with tempfile.TemporaryDirectory() as folder:
        # The converter calls `ffmpeg`; the packaged one has another name.
        (Path(folder) / "ffmpeg").symlink_to(imageio_ffmpeg.get_ffmpeg_exe())
        film = Path(folder) / out.name
        path = os.environ["PATH"]
        os.environ["PATH"] = os.pathsep.join([folder, path])
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                convert_frames_to_video(
                    str(frames.absolute()), str(film), framerate=fps
                )
        except subprocess.CalledProcessError as error:
            raise FmpError(
                f"ffmpeg could not convert {frames} (exit code {error.returncode})."
            ) from None
        finally:
            os.environ["PATH"] = path
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
