"""A film of the pictures that the recorder of a Meshcat page saves."""

import contextlib
import tarfile
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fmp_drake.errors import RunError
from fmp_drake.film.checks import ffmpeg_program
from fmp_drake.film.encode import write_film
from fmp_drake.numeric import check_number


def convert_frames(
    frames: Path,
    out: Path,
    *,
    fps: float,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Make a film of an archive of numbered pictures.

    Parameters
    ----------
    frames : pathlib.Path
        A .tar of .png; all are made as large as the first.
    out : pathlib.Path
        A .gif, or any film that ffmpeg stores H.264 in; an existing one is replaced at
        the end.
    fps : float
        Frames per second.
    track : callable
        Goes through the numbers of the frames, and may show how far it is.

    Raises
    ------
    RunError
        Where the film cannot be made, or the packages for films are missing.
    """
    ffmpeg_program()
    check_number(fps, "fps", above=0.0, error=RunError)
    if not frames.is_file():
        raise RunError(f"there is no frame archive {frames}.")
    with tempfile.TemporaryDirectory() as folder:
        with (
            contextlib.suppress(tarfile.TarError, EOFError),
            tarfile.open(frames) as archive,
        ):
            archive.extractall(folder, filter="data")
        pictures = sorted(Path(folder).rglob("*.png"))
        if not pictures:
            raise RunError(
                f"{frames} is not a .tar of numbered .png frames; save one from the "
                "page: Open Controls, Animations, default, recording, record."
            )
        with Image.open(pictures[0]) as first:
            size = first.size

        def frame(i: int) -> NDArray[np.uint8]:
            # The window may have been resized while it was recorded.
            return np.asarray(Image.open(pictures[i]).convert("RGB").resize(size))

        write_film(out, frame, len(pictures), fps=fps, track=track)
