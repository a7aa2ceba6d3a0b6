"""Paths in Meshcat: where the tool has been, where it is told to be."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform
from pydrake.systems.framework import (
    Context,
    DiscreteValues,
    LeafSystem,
)

from fmp_drake.errors import StationError

_COLORS = {
    "measured": Rgba(0.95, 0.45, 0.10, 1.0),
    "desired": Rgba(0.10, 0.55, 0.30, 1.0),
}


class PathVisualizer(LeafSystem):
    """Draws the last seconds of the desired and the measured path.

    Input ports
    -----------
    desired, measured : (3,)
        Points in the frame B, m.

    Parameters
    ----------
    meshcat : Meshcat
    X_WB : RigidTransform
    seconds : float
        How much of the past is drawn.
    rate : float
        Points, and pictures, per second.
    path : str
        Where in Meshcat's tree.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        *,
        X_WB: RigidTransform,
        seconds: float = 8.0,
        rate: float = 20.0,
        path: str = "paths",
    ) -> None:
        super().__init__()
        self.set_name("path_visualizer")
        if not (seconds > 0 and rate > 0):
            raise StationError(
                f"seconds is {seconds} and rate {rate} Hz; both must be positive."
            )
        self._meshcat = meshcat
        self._path = path
        meshcat.SetTransform(path, X_WB)
        self._points = max(2, round(seconds * rate))
        self._ports = {
            name: self.DeclareVectorInputPort(name, 3)
            for name in ("desired", "measured")
        }
        # One row of points per path; NaN where there is none yet.
        blank = np.full(3 * self._points, np.nan)
        self._trails = {name: int(self.DeclareDiscreteState(blank)) for name in _COLORS}
        period = 1 / rate
        self.DeclareInitializationDiscreteUpdateEvent(self._begin)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._remember)
        self.DeclarePeriodicPublishEvent(period, 0.0, self._draw)

    def _begin(self, context: Context, values: DiscreteValues) -> None:
        for name, index in self._trails.items():
            trail = np.full((self._points, 3), np.nan)
            trail[-1] = self._point(name, context)
            values.set_value(index, trail.ravel())

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        for name, index in self._trails.items():
            trail = np.roll(self._trail(name, context), -1, axis=0)
            trail[-1] = self._point(name, context)
            values.set_value(index, trail.ravel())

    def _point(self, name: str, context: Context) -> NDArray[np.float64]:
        point: Any = self._ports[name].Eval(context)
        return np.asarray(point, dtype=float)

    def _trail(self, name: str, context: Context) -> NDArray[np.float64]:
        flat = context.get_discrete_state().value(self._trails[name])
        return flat.reshape(self._points, 3)

    def _draw(self, context: Context) -> None:
        for name, color in _COLORS.items():
            trail = self._trail(name, context)
            draw_path(
                self._meshcat,
                f"{self._path}/{name}",
                trail[np.isfinite(trail[:, 0])],
                color=color,
            )


def draw_path(
    meshcat: Meshcat,
    path: str,
    points: NDArray[np.float64],
    *,
    color: Rgba,
    line_width: float = 3.0,
    lift: float = 0.004,
) -> None:
    """Draw points (N, 3) as a line, slightly lifted off the board (m)."""
    if len(points) < 2:
        return
    lifted = points + np.array([0.0, 0.0, lift])
    meshcat.SetLine(path, lifted.T, line_width, color)
