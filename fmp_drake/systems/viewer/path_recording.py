"""A path in a recording of Meshcat, which appears as it was gone along."""

from itertools import pairwise
from math import inf

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, MeshcatAnimation, Rgba

from fmp_drake.systems.viewer.path_drawing import draw_line

# The longest part that appears at once, s, unless there would be too many parts.
_PART = 0.25
_MAX_PARTS = 300


def AddPathToRecording(
    meshcat: Meshcat, path: str, *, times: ArrayLike, points: ArrayLike, color: Rgba
) -> None:
    """Add a path to Meshcat's recording, of which the animation shows part after part.

    Call it between `Meshcat.StopRecording()` and `Meshcat.PublishRecording()`.

    Parameters
    ----------
    meshcat : Meshcat
    path : str
        Where in Meshcat's tree; its transform, the caller's, is X_WB.
    times : array_like, shape (N,)
        Ascending, s.
    points : array_like, shape (N, 3)
        Points in B, m.
    color : Rgba
    """
    at, line = np.asarray(times, dtype=float), np.asarray(points, dtype=float)
    meshcat.Delete(path)
    if len(at) < 2:
        return
    animation = meshcat.get_mutable_recording()
    parts = int(np.clip(np.ceil((at[-1] - at[0]) / _PART), 1, _MAX_PARTS))
    edges = np.searchsorted(at, np.linspace(at[0], at[-1], parts + 1))
    for a, b in pairwise(edges):
        name = f"{path}/{a}"
        draw_line(meshcat, name, line[a : b + 1], color=color)
        show_during(animation, name, since=at[b], end=at[-1])


def show_during(
    animation: MeshcatAnimation,
    path: str,
    *,
    since: float = -inf,
    until: float = inf,
    end: float,
) -> None:
    """Show what is at a path only for some time, s, of an animation that has an end."""
    # Meshcat loops each path by itself: let all last equally long.
    first, last = 0, max(1, animation.frame(end))
    for time, visible in ((since, True), (until, False)):
        if np.isfinite(time):
            frame = min(max(1, animation.frame(time)), last)
            animation.SetProperty(first, path, "visible", not visible)
            animation.SetProperty(frame, path, "visible", visible)
            animation.SetProperty(last, path, "visible", visible)
