"""State of a station, for the panel of the page."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, InputPort, LeafSystem

from fmp_drake.systems.impedance.controller_status import (
    CONDITIONS,
    STATUS_SIZE,
    STOP_REASONS,
    StatusFlag,
)
from fmp_drake.systems.impedance.force_control import CONTACT_FORCE
from fmp_drake.systems.ink.grid import cleaned_fraction
from fmp_drake.systems.page.page_panel import PagePanel, PanelFields
from fmp_drake.systems.page.paths import css_color
from fmp_drake.systems.page.plan_visualizer import component_color

# Time between two pictures, s.
_PERIOD = 0.128


class PageStatus(LeafSystem):
    """Shows time, force, cleaned area, component and mode in the panel of a page.

    Input ports
    -----------
    status : (6,)
        Of the controller, see `ImpedanceStatus`.
    last_fault : (1,)
        Of the controller: the reason of the latest protective stop.
    normal_force : (1,)
        On the board, N. This, the desired one and ink only where there is a board.
    desired_normal_force : (1,)
        N.
    ink : (ny nx,)
        Fraction of the ink left in each cell.
    component : (1,)
        Index of the active component.

    Parameters
    ----------
    panel : PagePanel
    area : array_like of bool, shape (ny nx,), optional
        The cells that should be cleaned; None where there is no board.

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> panel = PagePanel(Meshcat())
    >>> status = PageStatus(panel, area=[True, True, False, False])
    >>> context = status.CreateDefaultContext()
    >>> for name, value in {
    ...     "status": [4096, 1, 1, 1, 0, 0],
    ...     "last_fault": [0],
    ...     "normal_force": [9.5],
    ...     "desired_normal_force": [10.0],
    ...     "ink": [0.0, 1.0, 1.0, 1.0],
    ...     "component": [3],
    ... }.items():
    ...     _ = status.GetInputPort(name).FixValue(context, value)
    >>> status.ForcedPublish(context)
    >>> panel.shown["mode"], panel.shown["cleaned"]
    ('wiping', 0.5)
    >>> panel.close()
    """

    def __init__(self, panel: PagePanel, *, area: ArrayLike | None = None) -> None:
        super().__init__()
        self.set_name("page_status")
        self._panel = panel
        self._area = None if area is None else np.array(area, dtype=bool).ravel()
        sizes = {"status": STATUS_SIZE, "last_fault": 1, "component": 1}
        if self._area is not None:
            sizes |= {"normal_force": 1, "desired_normal_force": 1}
            sizes["ink"] = self._area.size
        self._inputs: Mapping[str, InputPort] = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in sizes.items()
        }
        self.DeclareInitializationPublishEvent(self._show)
        self.DeclareForcedPublishEvent(self._show)
        self.DeclarePeriodicPublishEvent(_PERIOD, 0.0, self._show)

    def _show(self, context: Context) -> None:
        values: dict[str, Any] = {k: p.Eval(context) for k, p in self._inputs.items()}
        component, flags = int(values["component"][0]), int(values["status"][0])
        fields: PanelFields = {}
        force: float | None = None
        desired = 0.0
        if self._area is not None:
            force = float(values["normal_force"][0])
            desired = float(values["desired_normal_force"][0])
            fields["force"], fields["desired_force"] = max(force, 0.0), desired
            if np.any(self._area):
                fields["cleaned"] = cleaned_fraction(values["ink"], self._area)
        fault = int(values["last_fault"][0])
        level, mode, detail = mode_in_words(flags, fault, force, desired=desired)
        fields |= {
            "level": level,
            "mode": mode,
            "detail": detail,
            "time": context.get_time(),
            "component": f"mean of component {component}",
            "component_color": css_color(component_color(component)),
        }
        self._panel.show(**fields)


def mode_in_words(
    flags: int, fault: int, force: float | None, *, desired: float
) -> tuple[Literal["good", "busy", "bad"], str, str]:
    """Describe what an arm is doing.

    Parameters
    ----------
    flags : int
        `StatusFlag` of the controller and of the monitor of the surface.
    fault : int
        Last flags of `STOP_REASONS`; 0 for none.
    force : float or None
        Of the eraser on the board, N; None in free space.
    desired : float
        Desired normal force, N; unused in free space.

    Returns
    -------
    level : str
        Severity: `good`, `busy` or `bad`.
    mode : str
        One or two words.
    detail : str
        Reason, or next step; may be empty.

    Examples
    --------
    >>> mode_in_words(StatusFlag.PROTECTIVE_STOP, StatusFlag.STALE, 0.0, desired=9.0)
    ('bad', 'protective stop', 'the target was too old')
    """
    for flag, condition in CONDITIONS.items():
        if flags & flag and condition.mode:
            detail = condition.detail
            if flag in StatusFlag.PROTECTIVE_STOP | StatusFlag.RECOVER:
                reasons = [text for r, text in STOP_REASONS.items() if fault & r]
                detail += ", ".join(reasons)
            return condition.level, condition.mode, detail
    if force is None:
        return "good", "following", ""
    if desired <= 0:
        return "busy", "no press force", "set one, so that the eraser wipes"
    if force < CONTACT_FORCE:
        return "busy", "in the air", "comes down where the movement touches the board"
    return "good", "wiping", ""
