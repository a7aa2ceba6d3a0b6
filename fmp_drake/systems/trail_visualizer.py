"""Trails in Meshcat: where the tool has just been, where it was told to be."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number
from fmp_drake.systems.viewer.path_drawing import LIFT, draw_rod

COLORS = {
    "desired": Rgba(0.06, 0.42, 0.25, 0.7),
    "measured": Rgba(0.95, 0.42, 0.05, 0.9),
}
"""Colours of the paths."""

# The measured path covers the desired one.
_RADII = {"desired": 0.5, "measured": 1.0}
_LIFTS = {"desired": LIFT, "measured": 2 * LIFT}

# A trail that is shorter than this (m) is a point and not drawn again.
_STILL = 1e-4


class TrailVisualizer(LeafSystem):
    """Draws the last seconds of the measured and the desired path, thinning out.

    Input ports
    -----------
    desired, measured : (3,)
        Points in the frame B, m; those that `names` asks for.

    Parameters
    ----------
    meshcat : Meshcat
    path : str
        Where in Meshcat's tree; its transform, the caller's, is X_WB.
    names : sequence of str
        Which paths to draw.
    seconds : float
        How much of the past is drawn.
    period : float
        Between two points, and two pictures, s.
    radius : float
        Of the newest end of the measured trail, m; the desired one is half as thick.

    Examples
    --------
    The trail of a point that stands still:

    >>> from pydrake.systems.analysis import Simulator
    >>> trail = TrailVisualizer(Meshcat(), names=("measured",), seconds=2.0)
    >>> simulator = Simulator(trail)
    >>> context = simulator.get_mutable_context()
    >>> _ = trail.get_input_port().FixValue(context, [0.1, 0.2, 0.0])
    >>> _ = simulator.AdvanceTo(1.0)
    """

    def __init__(
        self,
        meshcat: Meshcat,
        *,
        path: str = "trail",
        names: Sequence[str] = ("desired", "measured"),
        seconds: float = 4.0,
        period: float = 0.064,
        radius: float = 0.0025,
    ) -> None:
        super().__init__()
        self.set_name("trail_visualizer")
        check_number(seconds, "seconds", above=0, unit="s", error=SystemsError)
        check_number(period, "period", above=0, unit="s", error=SystemsError)
        check_number(radius, "radius", above=0, unit="m", error=SystemsError)
        unknown = sorted(set(names) - set(COLORS))
        if unknown or not names:
            raise SystemsError(
                f"the paths to draw are {list(names)}; expected some of {list(COLORS)}."
            )
        self._meshcat = meshcat
        self._path = path
        self._points = max(2, round(seconds / period))
        self._radii = radius * np.linspace(0.1, 1.0, self._points)
        self._ports = {name: self.DeclareVectorInputPort(name, 3) for name in names}
        # One row of points per path; NaN where there is none yet.
        blank = np.full(3 * self._points, np.nan)
        self._trails = {name: int(self.DeclareDiscreteState(blank)) for name in names}
        self.DeclareInitializationPublishEvent(self._redraw)
        self.DeclareForcedPublishEvent(self._redraw)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._remember)
        self.DeclarePeriodicPublishEvent(period, 0.0, self._draw)

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        for name, index in self._trails.items():
            old = context.get_discrete_state().value(index)
            values.set_value(
                index, np.concatenate([old[3:], self._point(name, context)])
            )

    def _point(self, name: str, context: Context) -> NDArray[np.float64]:
        point: Any = self._ports[name].Eval(context)
        return np.asarray(point, dtype=float)

    def _redraw(self, context: Context) -> None:
        for name in self._trails:
            self._meshcat.Delete(f"{self._path}/{name}")
        self._draw(context)

    def _draw(self, context: Context) -> None:
        for name, index in self._trails.items():
            trail = context.get_discrete_state().value(index).reshape(-1, 3)
            known = np.isfinite(trail[:, 0])
            points = trail[known]
            if len(points) < 2 or np.all(np.abs(points - points[-1]) < _STILL):
                continue
            draw_rod(
                self._meshcat,
                f"{self._path}/{name}",
                points,
                radius=_RADII[name] * self._radii[known],
                color=COLORS[name],
                lift=_LIFTS[name],
            )
