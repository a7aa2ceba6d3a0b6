"""The plan in Meshcat: where the skill is about to go, and how surely."""

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.systems.viewer.path_drawing import LIFT, draw_rod, lifted
from fmp_drake.systems.viewer.swept_mesh import covariance_band

PLAN_COLOR = Rgba(0.05, 0.55, 0.25, 1.0)
"""Colour of the plan."""

TUBE_COLOR = Rgba(0.20, 0.75, 0.40, 0.28)
"""Colour of the tube of the covariance."""

SLIDER = "component"
"""Name of the control that shows the number of the active component."""


class PlanVisualizer(LeafSystem):
    """Draws the plan as a line in the tube of its covariance, and the component.

    The mean path of the active component is a line in the component's own colour; its
    number is shown by a slider among the page's controls, which only shows.

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
    rate : float
        Highest rate of drawing, Hz.
    deviations : float
        Size of the tube in standard deviations.
    show_plan, show_tube, show_component : bool
        What to draw.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        *,
        points: int,
        component_paths: Sequence[ArrayLike] = (),
        path: str = "plan",
        rate: float = 10.0,
        deviations: float = 2.0,
        show_plan: bool = True,
        show_tube: bool = True,
        show_component: bool = True,
    ) -> None:
        super().__init__()
        self.set_name("plan_visualizer")
        if points < 2:
            raise SystemsError(f"points is {points}; a plan has at least 2.")
        if not (np.isfinite(rate) and rate > 0):
            raise SystemsError(f"rate is {rate} Hz; it must be positive.")
        if not (np.isfinite(deviations) and deviations > 0):
            raise SystemsError(f"deviations is {deviations}; it must be positive.")
        self._component_paths = [np.array(p, dtype=float) for p in component_paths]
        for p in self._component_paths:
            if p.ndim != 2 or p.shape[1] != 3 or len(p) < 2:
                raise SystemsError(
                    f"a component's path has shape {p.shape}; expected (T, 3)."
                )
        self._meshcat = meshcat
        self._path = path
        self._deviations = deviations
        self._show_plan, self._show_tube = show_plan, show_tube
        self._show_component = show_component and len(self._component_paths) > 0
        self._plan = self.DeclareVectorInputPort("plan", 3 * points)
        self._covariance = self.DeclareVectorInputPort("plan_covariance", 9 * points)
        self._component = self.DeclareVectorInputPort("component", 1)
        # What was drawn last: component, first and last point of the plan.
        self._drawn = int(self.DeclareDiscreteState(np.full(7, np.nan)))
        # A publish event may not write state, so each one has an update beside it; at
        # one time both see the same input and the same state.
        period = 1 / rate
        self.DeclareInitializationDiscreteUpdateEvent(self._remember)
        self.DeclareInitializationPublishEvent(self._redraw)
        self.DeclareForcedPublishEvent(self._redraw)
        self.DeclarePeriodicPublishEvent(period, period, self._draw_if_changed)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._remember)

    def Delete(self) -> None:
        """Remove the control from the page."""
        self._meshcat.DeleteSlider(SLIDER, strict=False)

    def _plan_points(self, context: Context) -> NDArray[np.float64]:
        plan: Any = self._plan.Eval(context)
        return np.asarray(plan).reshape(-1, 3)

    def _active(self, context: Context) -> int:
        component: Any = self._component.Eval(context)
        return int(component[0])

    def _now(self, context: Context) -> NDArray[np.float64]:
        plan = self._plan_points(context)
        return np.concatenate([[self._active(context)], plan[0], plan[-1]])

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        values.set_value(self._drawn, self._now(context))

    def _redraw(self, context: Context) -> None:
        self._meshcat.Delete(self._path)
        if self._show_component:
            self._add_slider()
            self._draw_component(self._active(context))
        self._draw_plan(context)

    def _draw_if_changed(self, context: Context) -> None:
        now = self._now(context)
        drawn = context.get_discrete_state().value(self._drawn)
        if self._show_component and now[0] != drawn[0]:
            self._draw_component(int(now[0]))
        if not np.array_equal(now[1:], drawn[1:]):
            self._draw_plan(context)

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
        if SLIDER in self._meshcat.GetSliderNames():
            self._meshcat.SetSliderValue(SLIDER, component)

    def _add_slider(self) -> None:
        if SLIDER not in self._meshcat.GetSliderNames():
            last = max(1, len(self._component_paths) - 1)
            self._meshcat.AddSlider(SLIDER, min=0, max=last, step=1, value=0)


def component_color(component: int) -> Rgba:
    """Return a colour for a component; neighbours in number differ clearly."""
    # The golden ratio spreads the hues; those of plan and trail are left out.
    hue = 0.55 + 0.37 * ((component * 0.618034) % 1.0)
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.75, 0.80)
    return Rgba(red, green, blue, 0.55)
