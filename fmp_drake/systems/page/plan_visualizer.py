"""The plan in Meshcat: where the skill is about to go, and how surely."""

import colorsys
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import as_floats, check_number
from fmp_drake.systems.viewer.path_drawing import LIFT, draw_rod, lifted
from fmp_drake.systems.viewer.swept_mesh import covariance_band

PLAN_COLOR = Rgba(0.05, 0.55, 0.25, 1.0)
"""Colour of the plan."""

TUBE_COLOR = Rgba(0.20, 0.75, 0.40, 0.28)
"""Colour of the tube of the covariance."""


class PlanVisualizer(LeafSystem):
    """Draws the plan as a line in the tube of its covariance, and the component.

    The mean path of the active component is a line in the component's own colour. Which
    one was drawn last is discrete state, that it is not drawn again.

    Input ports
    -----------
    plan : (3 n,)
        Positions in the frame B of the next seconds, row by row, m.
    plan_covariance : (9 n,)
        Their covariances, m^2.
    component : (1,)
        Index of the active component.

    Parameters
    ----------
    meshcat : Meshcat
    points : int
        n.
    component_paths : sequence of ndarray, shape (T, 3)
        Mean path in B of each component, m.
    path : str
        Where in Meshcat's tree; its transform, the caller's, is X_WB.
    period : float
        Between two pictures, s.
    deviations : float
        Size of the tube in standard deviations.
    show_plan, show_tube, show_component : bool
        What to draw.

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> visualizer = PlanVisualizer(Meshcat(), points=40, path="board/plan")
    >>> visualizer.GetInputPort("plan").size()
    120
    """

    def __init__(
        self,
        meshcat: Meshcat,
        *,
        points: int,
        component_paths: Iterable[ArrayLike] = (),
        path: str = "plan",
        period: float = 0.256,
        deviations: float = 2.0,
        show_plan: bool = True,
        show_tube: bool = True,
        show_component: bool = True,
    ) -> None:
        super().__init__()
        self.set_name("plan_visualizer")
        check_number(points, "points", least=2, whole=True, error=SystemsError)
        check_number(period, "period", above=0, unit="s", error=SystemsError)
        check_number(deviations, "deviations", above=0, error=SystemsError)
        self._component_paths = [
            as_floats(path, "a component's path", ("T", 3), error=SystemsError).copy()
            for path in component_paths
        ]
        self._meshcat = meshcat
        self._path = path
        self._deviations = deviations
        self._show_plan, self._show_tube = show_plan, show_tube
        self._show_component = show_component and len(self._component_paths) > 0
        self._plan = self.DeclareVectorInputPort("plan", 3 * points)
        self._covariance = self.DeclareVectorInputPort("plan_covariance", 9 * points)
        self._component = self.DeclareVectorInputPort("component", 1)
        self._drawn = int(self.DeclareDiscreteState(np.array([-1.0])))
        self.DeclareInitializationPublishEvent(self._redraw)
        self.DeclareForcedPublishEvent(self._redraw)
        # A publish event may not write state, so there is an update beside it.
        self.DeclarePeriodicPublishEvent(period, 0.0, self._draw)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._remember)

    def _plan_points(self, context: Context) -> NDArray[np.float64]:
        plan: Any = self._plan.Eval(context)
        return np.asarray(plan).reshape(-1, 3)

    def _active(self, context: Context) -> int:
        component: Any = self._component.Eval(context)
        return int(component[0])

    def _redraw(self, context: Context) -> None:
        self._meshcat.Delete(self._path)
        if self._show_component:
            self._draw_component(self._active(context))
        self._draw_plan(context)

    def _draw(self, context: Context) -> None:
        component = self._active(context)
        drawn = context.get_discrete_state(self._drawn).value()[0]
        if self._show_component and drawn != component:
            self._draw_component(component)
        self._draw_plan(context)

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        values.set_value(self._drawn, np.array([float(self._active(context))]))

    def _draw_plan(self, context: Context) -> None:
        plan = self._plan_points(context)
        if self._show_plan:
            draw_rod(
                self._meshcat,
                f"{self._path}/line",
                plan,
                radius=0.0020,
                color=PLAN_COLOR,
                lift=2 * LIFT,  # Above the tube.
            )
        if self._show_tube:
            covariance: Any = self._covariance.Eval(context)
            vertices, faces = covariance_band(
                lifted(plan),
                np.asarray(covariance).reshape(-1, 3, 3),
                deviations=self._deviations,
            )
            self._meshcat.SetTriangleMesh(
                f"{self._path}/tube", vertices, faces, TUBE_COLOR
            )

    def _draw_component(self, component: int) -> None:
        draw_rod(
            self._meshcat,
            f"{self._path}/component",
            self._component_paths[component],
            radius=0.0015,
            color=component_color(component),
        )


def component_color(component: int) -> Rgba:
    """Return a colour for a component; neighbours in number differ clearly."""
    # The golden ratio spreads the hues; those of plan and trail are left out.
    hue = 0.55 + 0.37 * ((component * 0.618034) % 1.0)
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.75, 0.80)
    return Rgba(red, green, blue, 0.55)
