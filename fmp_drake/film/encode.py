"""Films from frames: .gif through Pillow, everything else through ffmpeg."""

import contextlib
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fmp_drake.errors import RunError
from fmp_drake.film.checks import ffmpeg_program
from fmp_drake.primitives.data.files import replaced

type Frame = NDArray[np.uint8]

# Frames from which the palette of a .gif is made.
_SAMPLES = 6
# Of a .gif: with 64, 20 s of wiping are 3.6 MB, with 128 4.7 MB.
_COLORS = 64
# A colour counts by this power of its pixels, so that a palette keeps rare ones.
_RARE = 0.5
# What every player and browser plays: H.264 of even sizes in the common colour format.
_ENCODING = (
    *("-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"),
    *(
        "-c:v",
        "libx264",
        "-preset",
        "veryfast",
        "-crf",
        "18",
        "-movflags",
        "+faststart",
    ),
)


def write_film(
    path: Path,
    frame: Callable[[int], Frame],
    count: int,
    *,
    fps: float,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Write a film of numbered frames; an existing one is replaced at the end.

    Parameters
    ----------
    path : pathlib.Path
        Ends in .gif, or in .mp4 or whatever else ffmpeg stores H.264 in.
    frame : callable
        Returns the frame of a number from 0 to count - 1, an ndarray of uint8 of shape
        (height, width, 3). For a .gif some frames are asked for twice.
    count : int
        Number of frames, at least 1.
    fps : float
        Frames per second.
    track : callable
        Goes through the numbers of the frames, and may show how far it is.

    Raises
    ------
    RunError
        Where it cannot be written; an existing file is then left as it was.
    """
    with replaced(path, RunError) as part:
        if path.suffix.lower() == ".gif":
            chosen = np.linspace(0, count - 1, min(_SAMPLES, count)).round()
            palette = _palette([frame(int(i)) for i in chosen])
            _write_gif(part, map(frame, track(range(count))), fps, palette)
        else:
            _write_video(part, map(frame, track(range(count))), fps)


def _write_video(part: Path, frames: Iterator[Frame], fps: float) -> None:
    """Encode frames by ffmpeg; what it says of a failure becomes an OSError."""
    first = next(frames)
    height, width, _ = first.shape
    command = [
        *(ffmpeg_program(), "-nostdin", "-loglevel", "error", "-y"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"),
        *("-r", f"{fps:.6g}", "-i", "pipe:0", "-an", *_ENCODING, str(part)),
    ]
    with tempfile.TemporaryFile() as log:
        with (
            contextlib.suppress(BrokenPipeError),  # It ended early; the log says why.
            subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=log
            ) as process,
        ):
            assert process.stdin is not None
            for frame in chain([first], frames):
                process.stdin.write(frame.tobytes())
        if process.returncode:
            log.seek(0)
            said = log.read().decode(errors="replace").strip().splitlines()
            raise OSError(f"ffmpeg says {said[-1] if said else process.returncode}")


def _write_gif(
    part: Path, frames: Iterator[Frame], fps: float, palette: Image.Image
) -> None:
    """Write frames of one palette, so that what does not move costs nothing."""
    pictures = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    # A .gif counts in hundredths of a second; rounded so that they do not add up.
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
    """Return a picture with the palette that fits all samples."""
    colors = np.concatenate([sample.reshape(-1, 3) for sample in samples]) // 4
    numbers = colors @ np.array([1 << 12, 1 << 6, 1])
    counts = np.bincount(numbers, minlength=1 << 18)
    kept = np.flatnonzero(counts)
    repeats = np.ceil(counts[kept] ** _RARE).astype(int)
    shades = np.stack([kept >> 12, kept >> 6 & 63, kept & 63], axis=-1)
    palette = (4 * shades + 2).astype(np.uint8)
    together = Image.fromarray(np.repeat(palette, repeats, axis=0)[None])
    return together.quantize(colors=_COLORS, method=Image.Quantize.MEDIANCUT)
