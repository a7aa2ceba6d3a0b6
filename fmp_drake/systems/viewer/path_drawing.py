"""Drawing paths in Meshcat."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba

from fmp_drake.systems.viewer.swept_mesh import rod_mesh

DEMONSTRATION_COLOR = Rgba(0.36, 0.38, 0.42, 1.0)
"""Colour of demonstrated paths."""

LIFT = 0.002
"""Height in metres at which paths are drawn above themselves."""


def css_color(color: Rgba) -> str:
    """Return a colour as CSS.

    Examples
    --------
    >>> css_color(Rgba(1.0, 0.5, 0.0, 0.3))
    'rgb(255 128 0 / 0.3)'
    """
    red, green, blue = (round(255 * c) for c in (color.r(), color.g(), color.b()))
    return f"rgb({red} {green} {blue} / {color.a():g})"


def lifted(points: ArrayLike, lift: float = LIFT) -> NDArray[np.float64]:
    """Return points (N, 3) in B above the board, raised by `lift` (m) along z.

    What is demonstrated or planned below the surface of the board, which hides it,
    is drawn on it.
    """
    raised = np.array(points, dtype=float)
    raised[:, 2] = np.maximum(raised[:, 2], 0.0) + lift
    return raised


def draw_line(
    meshcat: Meshcat,
    path: str,
    points: NDArray[np.float64],
    *,
    color: Rgba,
    lift: float = LIFT,
) -> None:
    """Draw points (N, 3) as a line, raised by `lift` (m).

    Browsers draw every line opaque and one pixel wide; a rod can be seen better.
    """
    if len(points) < 2:
        return
    meshcat.SetLine(path, lifted(points, lift).T, 1.0, color)


def draw_rod(
    meshcat: Meshcat,
    path: str,
    points: NDArray[np.float64],
    *,
    radius: float | NDArray[np.float64],
    color: Rgba,
    lift: float = LIFT,
) -> None:
    """Draw points (N, 3) as a rod of some radius (m), raised by `lift` (m)."""
    if len(points) < 2:
        return
    vertices, faces = rod_mesh(lifted(points, lift), radius)
    meshcat.SetTriangleMesh(path, vertices, faces, color)


def draw_demonstrations(
    meshcat: Meshcat,
    path: str,
    demonstrations: Iterable[NDArray[np.float64]],
    *,
    color: Rgba = DEMONSTRATION_COLOR,
    lift: float = LIFT,
) -> None:
    """Draw demonstrated paths as thin lines, once; they stay as they are.

    Parameters
    ----------
    meshcat : Meshcat
    path : str
        Where in Meshcat's tree; its transform, the caller's, is X_WB.
    demonstrations : iterable of ndarray, shape (N, 3)
        Points in B, m.
    color : Rgba
    lift : float
        Height above the points, m.
    """
    meshcat.Delete(path)
    for i, points in enumerate(demonstrations):
        draw_line(meshcat, f"{path}/{i}", np.asarray(points), color=color, lift=lift)
