"""The plan in Meshcat: the next desired positions with their covariances."""

import colorsys
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, as_floats, check_number
from fmp_drake.primitives.data.channels import ChannelRoles
from fmp_drake.primitives.data.orientation import rotations_of
from fmp_drake.systems.interface.callbacks import eval_number
from fmp_drake.systems.page.paths import (
    LIFT,
    covariance_band,
    draw_rod,
    lifted,
    on_surface,
)
from fmp_drake.systems.surface.surface import PLANE, Surface, rotations

PLAN_COLOR = Rgba(0.05, 0.55, 0.25, 1.0)
"""Colour of the plan."""

TUBE_COLOR = Rgba(0.20, 0.75, 0.40, 0.28)
"""Colour of the tube of the covariance."""

# Time between two pictures, s.
_PERIOD = 0.256


_POSITION = ChannelRoles(position=(0, 1, 2))
# Number and length, m, of the axes that are drawn along the plan.
_AXES, _AXIS_LENGTH = 7, 0.03
_AXIS_COLORS = (Rgba(0.85, 0.1, 0.1), Rgba(0.1, 0.6, 0.1), Rgba(0.1, 0.2, 0.9))


class PlanVisualizer(LeafSystem):
    """Drawing of the plan as a line in a tube of its covariance, and of the component.

    Where a skill has an orientation, small axes along the line show it: x red, y green and
    z blue.

    The mean path of the active component is a line in the component's own colour. The
    last component drawn is discrete state, so that it is drawn only once.

    Input ports
    -----------
    plan : (D n,)
        Channels of the next seconds, row by row; positions in the frame B, m.
    plan_covariance : (D D n,)
        Their covariances.
    component : (1,)
        Index of the active component.

    Parameters
    ----------
    meshcat : Meshcat
    points : int
        n.
    component_paths : sequence of ndarray, shape (T, 3)
        Mean path in B of each component, m.
    roles : ChannelRoles
        Of the D channels.
    surface : Surface
        Of the board; over a curved one positions are (u, v, h).
    path : str
        Meshcat path; the caller sets its transform to X_WB.
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
        roles: ChannelRoles = _POSITION,
        path: str = "plan",
        show_plan: bool = True,
        show_tube: bool = True,
        show_component: bool = True,
        surface: Surface = PLANE,
    ) -> None:
        super().__init__()
        self.set_name("plan_visualizer")
        check_number(points, "points", least=2, whole=True, error=SystemsError)
        self._component_paths = [
            as_floats(path, "a component's path", ("T", 3), error=SystemsError).copy()
            for path in component_paths
        ]
        self._meshcat = meshcat
        self._path, self._surface = path, surface
        self._show_plan, self._show_tube = show_plan, show_tube
        self._show_component = show_component and len(self._component_paths) > 0
        self._roles, channels = roles, roles.count
        self._plan = self.DeclareVectorInputPort("plan", channels * points)
        self._covariance = self.DeclareVectorInputPort(
            "plan_covariance", channels**2 * points
        )
        self._component = self.DeclareVectorInputPort("component", 1)
        self._drawn = int(self.DeclareDiscreteState(np.array([-1.0])))
        self.DeclareInitializationPublishEvent(self._redraw)
        self.DeclareForcedPublishEvent(self._redraw)
        # A publish event may not write state, so there is an update beside it.
        self.DeclarePeriodicPublishEvent(_PERIOD, 0.0, self._draw)
        self.DeclarePeriodicDiscreteUpdateEvent(_PERIOD, 0.0, self._remember)

    def _active(self, context: Context) -> int:
        return int(eval_number(self._component, context))

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
        roles, values = self._roles, np.array(self._plan.Eval(context))
        values = values.reshape(-1, roles.count)
        plan = values[:, roles.position]
        if self._show_plan:
            self._draw_axes(values)
            draw_rod(
                self._meshcat,
                f"{self._path}/line",
                plan,
                radius=0.0020,
                color=PLAN_COLOR,
                lift=2 * LIFT,  # Above the tube.
                surface=self._surface,
            )
        if self._show_tube:
            covariance = np.array(self._covariance.Eval(context))
            covariance = covariance.reshape(-1, roles.count, roles.count)
            rows = np.ix_(range(len(plan)), roles.position, roles.position)
            vertices, faces = covariance_band(lifted(plan), covariance[rows])
            self._meshcat.SetTriangleMesh(
                f"{self._path}/tube",
                on_surface(vertices, self._surface),
                faces,
                TUBE_COLOR,
            )

    def _draw_axes(self, values: Array) -> None:
        """Draw the orientation of the tool at some points of the plan (n, D)."""
        roles = self._roles
        if roles.reference is None or roles.rotation is None:
            return
        rows = np.linspace(0, len(values) - 1, _AXES).astype(int)
        uvh = np.ascontiguousarray(values[rows][:, roles.position])
        phi = values[rows][:, roles.rotation]
        R_BE = rotations_of(phi, roles.reference).as_matrix()
        if not self._surface.is_plane:
            R_BE = rotations(self._surface, uvh) @ R_BE
        start = on_surface(uvh.T, self._surface)
        for axis, color in enumerate(_AXIS_COLORS):
            self._meshcat.SetLineSegments(
                f"{self._path}/axes/{'xyz'[axis]}",
                start,
                start + _AXIS_LENGTH * R_BE[:, :, axis].T,
                3.0,
                color,
            )

    def _draw_component(self, component: int) -> None:
        draw_rod(
            self._meshcat,
            f"{self._path}/component",
            self._component_paths[component],
            radius=0.0015,
            color=component_color(component),
            surface=self._surface,
        )


def component_color(component: int) -> Rgba:
    """Return a colour for a component; neighbours in number differ clearly."""
    # The golden ratio spreads the hues; those of plan and trail are left out.
    hue = 0.55 + 0.37 * ((component * 0.618034) % 1.0)
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.75, 0.80)
    return Rgba(red, green, blue, 0.55)
