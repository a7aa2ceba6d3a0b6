"""Trail of the tool in Meshcat."""

from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.systems.page.paths import LIFT, draw_rod
from fmp_drake.systems.surface.surface import PLANE, Surface

TRAIL_COLOR = Rgba(0.95, 0.42, 0.05, 0.9)
"""Colour of the trail."""

TRAIL_DURATION = 4.0
"""Duration of the trail, s."""

TRAIL_PERIOD = 0.064
"""Time between two points of the trail, and between two pictures, s."""

# Radius of the newest end, m.
_RADIUS = 0.0025
# A trail that is shorter than this (m) is a point and not drawn again.
_STILL = 1e-4


class TrailVisualizer(LeafSystem):
    """Draws the last 4 s of a point's path as a line that thins out.

    Input ports
    -----------
    position : (3,)
        The point in the frame B, or (u, v, h) over a curved board, m.

    Parameters
    ----------
    meshcat : Meshcat
    path : str
        Meshcat path; the caller sets its transform to X_WB.
    surface : Surface
        Of the board.

    Examples
    --------
    The trail of a point that stands still:

    >>> from pydrake.systems.analysis import Simulator
    >>> trail = TrailVisualizer(Meshcat())
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
        surface: Surface = PLANE,
    ) -> None:
        super().__init__()
        self.set_name("trail_visualizer")
        self._meshcat = meshcat
        self._path, self._surface = path, surface
        points = round(TRAIL_DURATION / TRAIL_PERIOD)
        self._radii = _RADIUS * np.linspace(0.1, 1.0, points)
        self._position = self.DeclareVectorInputPort("position", 3)
        # One point after the other; NaN where there is none yet.
        self.DeclareDiscreteState(np.full(3 * points, np.nan))
        self.DeclareInitializationPublishEvent(self._redraw)
        self.DeclareForcedPublishEvent(self._redraw)
        self.DeclarePeriodicDiscreteUpdateEvent(TRAIL_PERIOD, 0.0, self._remember)
        self.DeclarePeriodicPublishEvent(TRAIL_PERIOD, 0.0, self._draw)

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        position: Any = self._position.Eval(context)
        trail = values.get_mutable_value()
        trail[:] = np.concatenate([trail[3:], position])

    def _redraw(self, context: Context) -> None:
        self._meshcat.Delete(f"{self._path}/line")
        self._draw(context)

    def _draw(self, context: Context) -> None:
        trail = context.get_discrete_state_vector().value().reshape(-1, 3)
        is_known = np.isfinite(trail[:, 0])
        points = trail[is_known]
        if len(points) < 2 or np.all(np.abs(points - points[-1]) < _STILL):
            return
        draw_rod(
            self._meshcat,
            f"{self._path}/line",
            points,
            radius=self._radii[is_known],
            color=TRAIL_COLOR,
            lift=2 * LIFT,  # Above the plan's tube.
            surface=self._surface,
        )
