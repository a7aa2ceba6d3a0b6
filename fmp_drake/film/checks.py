"""Checks of a film before any work is done: its file, its settings, the renderer."""

import functools
import importlib
import subprocess
import sys
from pathlib import Path

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.files import check_writable

_GREATEST_FPS = {".mp4": 120.0, ".gif": 50.0}

# VTK ends the process without EGL, so a process of its own tries it.
_PROBE = """
from pydrake.geometry import (ClippingRange, ColorRenderCamera, MakeRenderEngineVtk,
    RenderCameraCore, RenderEngineVtkParams, SceneGraph)
from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraInfo
graph = SceneGraph()
context = graph.CreateDefaultContext()
engine = MakeRenderEngineVtk(RenderEngineVtkParams(backend="EGL"))
graph.AddRenderer(context, "r", engine)
core = RenderCameraCore("r", CameraInfo(4, 4, 1.0), ClippingRange(1, 2), RigidTransform())
graph.get_query_output_port().Eval(context).RenderColorImage(
    ColorRenderCamera(core, False), graph.world_frame_id(), RigidTransform())
"""


def check_film(
    path: Path | None,
    *,
    fps: float = 30.0,
    speed: float = 1.0,
    size: tuple[int, int] = (640, 480),
) -> None:
    """Raise an error where a film cannot be made, before any work is done.

    Parameters
    ----------
    path : pathlib.Path, optional
        Its suffix determines the format; None is allowed.
    fps : float
        Frames per second, at most 120, in a .gif 50.
    speed : float
        Simulated seconds in a second of the film.
    size : tuple of int
        Width and height, pixels; even, as the films of most players are.

    Raises
    ------
    RunError
        Also where the packages for films, or EGL, are missing.
    """
    if path is None:
        return
    check_writable(path)
    suffix = path.suffix.lower()
    if suffix not in _GREATEST_FPS:
        raise RunError(f"{path} is not a film; its name must end in .mp4 or .gif.")
    check_number(fps, "fps", above=0.0, most=_GREATEST_FPS[suffix], error=RunError)
    check_number(speed, "speed", above=0.0, error=RunError)
    if any(edge < 16 or edge > 4096 or edge % 2 for edge in size):
        raise RunError(
            f"a film of {size[0]} x {size[1]} pixels: both must be even, and from 16 "
            "to 4096."
        )
    if suffix == ".mp4":
        ffmpeg_program()
    check_renderer()


def check_renderer() -> None:
    """Raise an error where EGL does not work."""
    if not renders():
        raise RunError(
            "films are rendered through EGL, which does not work here; install it "
            "(on Ubuntu and Debian: apt-get install libegl1 libgl1-mesa-dri)."
        )


def ffmpeg_program() -> str:
    """Return the ffmpeg that comes with the extra packages."""
    try:
        return str(importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except ImportError:
        raise RunError(
            "an .mp4 needs the extra packages: pip install 'fmp-drake[video]'; "
            "a .gif needs none."
        ) from None
    except RuntimeError as error:
        raise RunError(f"there is no ffmpeg: {error}.") from None


@functools.cache
def renders() -> bool:
    """Return whether this machine renders through EGL."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            capture_output=True,
            timeout=120,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0
