"""Estimate of the wiped area from position and normal force."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.systems.impedance.force_control import CONTACT_FORCE
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.interface.callbacks import eval_number

# Time between two updates, s.
_PERIOD = 0.05


class WipedArea(LeafSystem):
    """Cells of a board that an eraser has wiped.

    It replaces the ink of an `InkBoard` where no ink is measured: it assumes a cell clean
    after one pass of the eraser in contact.

    Input ports
    -----------
    measured_position : (3,)
        p_BE of the eraser, m.
    normal_force : (1,)
        Of the eraser on the board, N.

    Output ports
    ------------
    ink : (ny nx,)
        1 in each cell, 0 after it was wiped; discrete state.

    Parameters
    ----------
    grid : InkGrid
    footprint : tuple of 2 floats
        Edges of the eraser along x and y of B, m.

    Examples
    --------
    >>> area = WipedArea(InkGrid(size=(0.2, 0.1), cell=0.1), footprint=(0.1, 0.1))
    >>> area.GetOutputPort("ink").Eval(area.CreateDefaultContext())
    array([1., 1.])
    """

    def __init__(self, grid: InkGrid, *, footprint: tuple[float, float]) -> None:
        super().__init__()
        self.set_name("wiped_area")
        self._grid, self._footprint = grid, footprint
        self._position = self.DeclareVectorInputPort("measured_position", 3)
        self._force = self.DeclareVectorInputPort("normal_force", 1)
        ink = self.DeclareDiscreteState(grid.full().ravel())
        # Position of the eraser and whether it was in contact, at the last update.
        last = self.DeclareDiscreteState(4)
        self._ink, self._last = int(ink), int(last)
        self.DeclareStateOutputPort("ink", ink)
        self.DeclarePeriodicDiscreteUpdateEvent(_PERIOD, 0.0, self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        position: Any = self._position.Eval(context)
        is_in_contact = eval_number(self._force, context) > CONTACT_FORCE
        last = context.get_discrete_state(self._last).value()
        if is_in_contact and last[3] > 0:
            path = np.array([[*last[:2], 0.0], [*position[:2], 0.0]])
            area = self._grid.swept_area(path, self._footprint)
            ink = context.get_discrete_state(self._ink).value() * (1.0 - area.ravel())
            values.set_value(self._ink, ink)
        values.set_value(self._last, np.array([*position, float(is_in_contact)]))
