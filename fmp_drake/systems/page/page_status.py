"""What a station is doing, for the panel of the page."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import (
    Context,
    DiscreteValues,
    InputPort,
    LeafSystem,
)

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number
from fmp_drake.systems.impedance.status import (
    STATUS_SIZE,
    STOP_REASONS,
    StatusFlag,
)
from fmp_drake.systems.ink.grid import cleaned_fraction
from fmp_drake.systems.page.plan_visualizer import component_color
from fmp_drake.systems.viewer.page_panel import PagePanel
from fmp_drake.systems.viewer.path_drawing import css_color

# Less is no contact, N.
_CONTACT = 0.5
_REASONS = int(sum(STOP_REASONS))


class PageStatus(LeafSystem):
    """Shows time, force, cleaned area, component and mode in the panel of a page.

    A fault that stops the arm may last for one update of the controller; the latest is
    discrete state.

    Input ports
    -----------
    status : (6,)
        Of the controller, see `ImpedanceStatus`.
    normal_force : (1,)
        On the board, N.
    ink : (ny nx,)
        Fraction of the ink left in each cell.
    component : (1,)
        Index of the active component.

    Parameters
    ----------
    panel : PagePanel
    area : array_like of bool, shape (ny nx,)
        The cells that should be cleaned.
    period : float
        Between two pictures, s.
    status_period : float
        Between two updates of the status, s.

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> panel = PagePanel(Meshcat())
    >>> status = PageStatus(panel, area=[True, True, False, False])
    >>> context = status.CreateDefaultContext()
    >>> for name, value in {
    ...     "status": [4096, 1, 1, 1, 0, 0],
    ...     "normal_force": [9.5],
    ...     "ink": [0.0, 1.0, 1.0, 1.0],
    ...     "component": [3],
    ... }.items():
    ...     _ = status.GetInputPort(name).FixValue(context, value)
    >>> status.ForcedPublish(context)
    >>> panel.shown["mode"], panel.shown["cleaned"]
    ('wiping', 0.5)
    >>> panel.close()
    """

    def __init__(
        self,
        panel: PagePanel,
        *,
        area: ArrayLike,
        period: float = 0.128,
        status_period: float = 0.001,
    ) -> None:
        super().__init__()
        self.set_name("page_status")
        for name, value in {"period": period, "status_period": status_period}.items():
            check_number(value, name, above=0, unit="s", error=SystemsError)
        self._panel = panel
        self._area: NDArray[np.bool_] = np.array(area, dtype=bool).ravel()
        sizes = {"status": STATUS_SIZE, "normal_force": 1, "component": 1}
        self._inputs: Mapping[str, InputPort] = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in {**sizes, "ink": self._area.size}.items()
        }
        self._fault = int(self.DeclareDiscreteState(1))
        self.DeclarePeriodicDiscreteUpdateEvent(status_period, 0.0, self._remember)
        self.DeclareInitializationPublishEvent(self._show)
        self.DeclareForcedPublishEvent(self._show)
        self.DeclarePeriodicPublishEvent(period, 0.0, self._show)

    def _show(self, context: Context) -> None:
        values: dict[str, Any] = {k: p.Eval(context) for k, p in self._inputs.items()}
        force, component = float(values["normal_force"][0]), int(values["component"][0])
        flags = int(values["status"][0])
        fault = flags & _REASONS or int(
            context.get_discrete_state(self._fault).value()[0]
        )
        level, mode, detail = mode_in_words(flags, fault, force)
        self._panel.show(
            level=level,
            mode=mode,
            detail=detail,
            time=context.get_time(),
            force=max(force, 0.0),
            cleaned=cleaned_fraction(values["ink"], self._area),
            component=f"mean of component {component}",
            component_color=css_color(component_color(component)),
        )

    def _remember(self, context: Context, values: DiscreteValues) -> None:
        status: Any = self._inputs["status"].Eval(context)
        if fault := int(status[0]) & _REASONS:
            values.set_value(self._fault, np.array([float(fault)]))


def mode_in_words(
    flags: int, fault: int, force: float
) -> tuple[Literal["good", "busy", "bad"], str, str]:
    """Say what a wiping arm is doing.

    Parameters
    ----------
    flags : int
        `StatusFlag` of the controller and what watches it.
    fault : int
        Those of `STOP_REASONS` that were there last; none is 0.
    force : float
        Of the eraser on the board, N.

    Returns
    -------
    level : str
        Whether all is well: `good`, `busy` or `bad`.
    mode : str
        In a word or two.
    detail : str
        Why, or what comes next; may be empty.

    Examples
    --------
    >>> mode_in_words(StatusFlag.PROTECTIVE_STOP, StatusFlag.STALE, 0.0)
    ('bad', 'protective stop', 'the target was too old')
    """
    reasons = [text for flag, text in STOP_REASONS.items() if fault & flag]
    if flags & StatusFlag.PROTECTIVE_STOP:
        return "bad", "protective stop", ", ".join(reasons)
    if flags & StatusFlag.RECOVER:
        return "busy", "going back", "after a protective stop: " + ", ".join(reasons)
    if flags & StatusFlag.BELOW_SURFACE:
        return "bad", "below the board", "something hard is below the surface"
    if flags & StatusFlag.ARM_TOUCHES:
        return "bad", "arm on the board", "a link of the arm touches the board"
    if flags & StatusFlag.CONTACT_LOST:
        return "busy", "searching the board", "nothing is touched where it should be"
    if force < _CONTACT:
        return "busy", "in the air", "comes down where the movement is on the board"
    return "good", "wiping", ""
