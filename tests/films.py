"""Readers of films."""

import subprocess

import numpy as np


def read_film(ffmpeg, film):
    """Return the film's frames, (N, height, width, 3), and what it says of itself.

    `ffmpeg` is the module imageio_ffmpeg.
    """
    stream = ffmpeg.read_frames(str(film))
    about = next(stream)
    stream.close()
    raw = subprocess.run(
        [
            *(ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", film),
            *("-f", "rawvideo", "-pix_fmt", "rgb24", "-"),
        ],
        check=True,
        capture_output=True,
    ).stdout
    width, height = about["source_size"]
    return np.frombuffer(raw, dtype=np.uint8).reshape(-1, height, width, 3), about
