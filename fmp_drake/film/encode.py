"""Films from frames: .mp4 through ffmpeg, .gif through Pillow."""

import contextlib
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fmp_drake.errors import RunError
from fmp_drake.film.checks import ffmpeg_program
from fmp_drake.primitives.data.files import replaced

type Frame = NDArray[np.uint8]
type AddFrame = Callable[[Frame], None]

# Of a .gif: with 64, 20 s of wiping are 3.6 MB, with 128 4.7 MB.
_COLORS = 64
# A colour counts by this power of its pixels, so that a palette keeps rare ones.
_RARE = 0.5


@contextlib.contextmanager
def open_film(
    path: Path,
    *,
    fps: float,
    size: tuple[int, int],
    samples: Sequence[Frame],
) -> Iterator[AddFrame]:
    """Open a film for writing; an existing one is replaced at the end.

    Parameters
    ----------
    path : pathlib.Path
        Ends in .mp4 or .gif.
    fps : float
    size : tuple of int
        Width and height, pixels.
    samples : sequence of ndarray of uint8, shape (height, width, 3)
        Some of the frames, for the colours of a .gif.

    Yields
    ------
    callable
        Adds a frame (height, width, 3).

    Raises
    ------
    RunError
        Where it cannot be written; an existing film is then as before.
    """
    gif = path.suffix.lower() == ".gif"
    with (
        replaced(path, RunError) as part,
        _gif(part, fps, _palette(samples)) if gif else _mp4(part, fps, size) as add,
    ):
        yield add


@contextlib.contextmanager
def _mp4(part: Path, fps: float, size: tuple[int, int]) -> Iterator[AddFrame]:
    """H.264 as every player and browser plays it."""
    width, height = size
    command = [
        *(ffmpeg_program(), "-nostdin", "-loglevel", "error", "-y"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"),
        *("-r", f"{fps:.6g}", "-i", "pipe:0", "-an"),
        *("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20"),
        *("-movflags", "+faststart", "-f", "mp4", str(part)),
    ]
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=log, stderr=log
        )
        pipe = process.stdin
        assert pipe is not None
        try:
            with contextlib.suppress(BrokenPipeError):
                yield lambda frame: _put(pipe.write, frame)
                pipe.close()
            code = process.wait()
        finally:
            process.kill()
            process.wait()
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
        if code:
            log.seek(0)
            said = log.read().decode(errors="replace").strip().splitlines()
            raise OSError(f"ffmpeg says {said[-1] if said else code}")


def _put(write: Callable[[bytes], int], frame: Frame) -> None:
    write(np.ascontiguousarray(frame).tobytes())


@contextlib.contextmanager
def _gif(part: Path, fps: float, palette: Image.Image) -> Iterator[AddFrame]:
    """Frames of one palette, so that what rests costs nothing."""
    frames: list[Image.Image] = []

    def add(frame: Frame) -> None:
        image = Image.fromarray(frame)
        frames.append(image.quantize(palette=palette, dither=Image.Dither.NONE))

    yield add
    # A .gif counts in hundredths of a second; rounded so that they do not add up.
    ends = np.rint(100 / fps * np.arange(len(frames) + 1))
    frames[0].save(
        part,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=[int(10 * d) for d in np.diff(ends)],
        loop=0,
        optimize=False,
        disposal=1,
    )


def _palette(samples: Sequence[Frame]) -> Image.Image:
    """Return a picture with the palette that fits all samples."""
    colors = np.concatenate([sample.reshape(-1, 3) for sample in samples])
    kept, counts = np.unique(colors // 4, axis=0, return_counts=True)
    repeats = np.ceil(counts**_RARE).astype(int)
    together = Image.fromarray(np.repeat(4 * kept + 2, repeats, axis=0)[None])
    return together.quantize(colors=_COLORS, method=Image.Quantize.MEDIANCUT)
