"""The press of the tool on the board."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.errors import StationError


class NormalPress(LeafSystem):
    """A feed-forward press along the board's normal, only where there is board.

    The press comes in smoothly while the tool and its target both approach the
    surface from `engage_height` on, so that the arm does not push in free air.

    Input ports
    -----------
    desired_position, measured_position : (3,)
        p_BE in the frame B of the board, z out of it, m.
    force : (1,), optional
        N; the parameter where unconnected.

    Output ports
    ------------
    wrench : (6,)
        Torque (Nm), then force (N), in B.

    Parameters
    ----------
    force : float
        N, not negative.
    engage_height : float
        m, positive.
    """

    def __init__(self, *, force: float, engage_height: float = 0.01) -> None:
        super().__init__()
        self.set_name("normal_press")
        if not (np.isfinite(force) and force >= 0):
            raise StationError(f"force is {force} N; it must not be negative.")
        if not (np.isfinite(engage_height) and engage_height > 0):
            raise StationError(
                f"engage_height is {engage_height} m; it must be positive."
            )
        self._force = float(force)
        self._height = float(engage_height)
        self._desired = self.DeclareVectorInputPort("desired_position", 3)
        self._measured = self.DeclareVectorInputPort("measured_position", 3)
        self._wanted = self.DeclareVectorInputPort("force", 1)
        self.DeclareVectorOutputPort(
            "wrench",
            6,
            self._calc,
            prerequisites_of_calc={
                self._desired.ticket(),
                self._measured.ticket(),
                self._wanted.ticket(),
            },
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        desired: Any = self._desired.Eval(context)
        measured: Any = self._measured.Eval(context)
        force = self._force
        if self._wanted.HasValue(context):
            wanted: Any = self._wanted.Eval(context)
            force = max(float(wanted[0]), 0.0)
        press = force * press_share(max(desired[2], measured[2]), self._height)
        output.SetFromVector(np.array([0.0, 0.0, 0.0, 0.0, 0.0, -press]))


def press_share(height: float, engage_height: float) -> float:
    """Return a smooth step from 0 at `engage_height` to 1 on the surface."""
    nearness = min(max(1 - height / engage_height, 0.0), 1.0)
    return nearness * nearness * (3 - 2 * nearness)
