"""Encoding of films: .gif by Pillow, everything else by ffmpeg."""

import contextlib
import importlib
import subprocess
import tarfile
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.files import replaced

type Frame = NDArray[np.uint8]

# Number of frames from which the palette of a .gif is computed.
_SAMPLES = 6
# Colours of a .gif: with 64, 20 s of wiping take 3.6 MB, with 128 they take 4.7 MB.
_COLORS = 64
# Exponent that turns the number of pixels of a colour into its weight: rare colours remain.
_WEIGHT_EXPONENT = 0.5
# H.264 with even sizes and the common colour format, which every player and browser plays.
_ENCODING = (
    *("-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"),
    *("-c:v", "libx264", "-preset", "veryfast", "-crf", "18"),
    *("-movflags", "+faststart"),
)


def write_film(
    path: Path,
    frame: Callable[[int], Frame],
    count: int,
    *,
    fps: float,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Write a film of numbered frames; an existing file is replaced at the end.

    Parameters
    ----------
    path : pathlib.Path
        Ends in .gif, or in .mp4 or another container of H.264 for ffmpeg.
    frame : callable
        Returns the frame of a number from 0 to count - 1, an ndarray of uint8 of shape
        (height, width, 3). For a .gif it is called twice for some frames.
    count : int
        Number of frames, at least 1.
    fps : float
        Frames per second.
    track : callable
        Iterates over the numbers of the frames, and may show the progress.

    Raises
    ------
    RunError
        If the film cannot be written; an existing file then remains unchanged.
    """
    with replaced(path, RunError) as part:
        if path.suffix.lower() == ".gif":
            samples = np.linspace(0, count - 1, min(_SAMPLES, count)).round()
            palette = _palette([frame(int(i)) for i in samples])
            _write_gif(part, map(frame, track(range(count))), fps, palette)
        else:
            _write_video(part, map(frame, track(range(count))), fps)


def convert_frames(
    frames: Path,
    out: Path,
    *,
    fps: float,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Convert an archive of numbered pictures, recorded by a Meshcat page, to a film.

    Parameters
    ----------
    frames : pathlib.Path
        A .tar of .png; all get the size of the first.
    out : pathlib.Path
        Ends in .gif, or in .mp4 or another container of H.264 for ffmpeg. An existing
        file is replaced at the end.
    fps : float
        Frames per second.
    track : callable
        Iterates over the numbers of the frames, and may show the progress.

    Raises
    ------
    RunError
        If the film cannot be written, a frame is missing or damaged, or the packages for
        films are missing.
    """
    if out.suffix.lower() != ".gif":
        ffmpeg_program()
    check_number(fps, "fps", above=0.0, error=RunError)
    if not frames.is_file():
        raise RunError(f"there is no frame archive {frames}.")
    with tempfile.TemporaryDirectory() as folder:
        damage = ""
        try:
            with tarfile.open(frames) as archive:
                archive.extractall(folder, filter="data")
        except (tarfile.TarError, EOFError) as error:
            damage = str(error)
        pictures = sorted(Path(folder).rglob("*.png"))
        if not pictures:
            raise RunError(
                f"{frames} is not a .tar of numbered .png frames; save one from a page that "
                "wipe --html has written: the viewer's own settings, Animations, default, "
                "Recording, record (png)."
            )
        if damage:
            raise RunError(
                f"{frames} is damaged after {len(pictures)} frames ({damage}); save it again."
            )

        def picture(i: int) -> Image.Image:
            try:
                return Image.open(pictures[i]).convert("RGB")
            except OSError:
                raise RunError(
                    f"{pictures[i].name} of {frames} is not a picture."
                ) from None

        size = picture(0).size

        def frame(i: int) -> NDArray[np.uint8]:
            # The window may have been resized while it was recorded.
            return np.asarray(picture(i).resize(size))

        write_film(out, frame, len(pictures), fps=fps, track=track)


def ffmpeg_program() -> str:
    """Return the path of the ffmpeg of the extra packages."""
    try:
        return str(importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except ImportError:
        raise RunError(
            "an .mp4 needs the extra packages: pip install 'fmp-drake[video]'; "
            "a .gif needs none."
        ) from None
    except RuntimeError as error:
        raise RunError(f"there is no ffmpeg: {error}.") from None


def _write_video(part: Path, frames: Iterator[Frame], fps: float) -> None:
    """Encode frames with ffmpeg; raise an OSError with its message if it fails."""
    first = next(frames)
    height, width, _ = first.shape
    command = [
        *(ffmpeg_program(), "-nostdin", "-loglevel", "error", "-y"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"),
        *("-r", f"{fps:.6g}", "-i", "pipe:0", "-an", *_ENCODING, str(part)),
    ]
    with tempfile.TemporaryFile() as log:
        with (
            contextlib.suppress(BrokenPipeError),  # The log contains the reason.
            subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=log
            ) as process,
        ):
            assert process.stdin is not None
            for frame in chain([first], frames):
                process.stdin.write(frame.tobytes())
        if process.returncode:
            log.seek(0)
            message = log.read().decode(errors="replace").strip().splitlines()
            raise OSError(
                f"ffmpeg reported {message[-1] if message else process.returncode}"
            )


def _write_gif(
    part: Path, frames: Iterator[Frame], fps: float, palette: Image.Image
) -> None:
    """Write frames with a common palette, so that unchanged pixels take no space."""
    pictures = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    # A .gif has durations in hundredths of a second. Rounding the ends avoids a drift.
    ends = np.rint(100 / fps * np.arange(len(pictures) + 1))
    pictures[0].save(
        part,
        format="GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=[int(10 * d) for d in np.diff(ends)],
        loop=0,
        optimize=False,
        disposal=1,
    )


def _palette(samples: Sequence[Frame]) -> Image.Image:
    """Return a picture with a palette for all samples."""
    colors = np.concatenate([sample.reshape(-1, 3) for sample in samples]) // 4
    codes = colors @ np.array([1 << 12, 1 << 6, 1])
    counts = np.bincount(codes, minlength=1 << 18)
    used_codes = np.flatnonzero(counts)
    repeats = np.ceil(counts[used_codes] ** _WEIGHT_EXPONENT).astype(int)
    shades = np.stack(
        [used_codes >> 12, used_codes >> 6 & 63, used_codes & 63], axis=-1
    )
    used_colors = (4 * shades + 2).astype(np.uint8)
    weighted_colors = Image.fromarray(np.repeat(used_colors, repeats, axis=0)[None])
    return weighted_colors.quantize(colors=_COLORS, method=Image.Quantize.MEDIANCUT)
