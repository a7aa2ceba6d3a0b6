"""Concatenation of lists of forces on bodies."""

from typing import Any

from pydrake.common.value import Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.systems.interface.callbacks import weakly


class SpatialForceSum(LeafSystem):
    """Concatenation of lists of forces on bodies.

    Unlike Drake's `ExternallyAppliedSpatialForceMultiplexer` it takes an input that
    is not connected as an empty list, so that a diagram can export an optional one.

    Input ports
    -----------
    The given names : abstract
        Lists of `ExternallyAppliedSpatialForce`; may stay unconnected.

    Output ports
    ------------
    spatial_forces : abstract
        For the plant's applied_spatial_force port.

    Parameters
    ----------
    *names : str
        Of the input ports.

    Examples
    --------
    >>> total = SpatialForceSum("mouse", "disturbances")
    >>> total.GetOutputPort("spatial_forces").Eval(total.CreateDefaultContext())
    []
    """

    def __init__(self, *names: str) -> None:
        super().__init__()
        self.set_name("spatial_force_sum")
        if not names:
            raise SystemsError("there is nothing to add; name at least one input.")
        self._inputs = [
            self.DeclareAbstractInputPort(
                name, Value[list[ExternallyAppliedSpatialForce]]()
            )
            for name in names
        ]
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            Value[list[ExternallyAppliedSpatialForce]],
            weakly(self._calc),
            prerequisites_of_calc={port.ticket() for port in self._inputs},
        )

    def _calc(self, context: Any, output: Any) -> None:
        forces: list[ExternallyAppliedSpatialForce] = []
        for port in self._inputs:
            if port.HasValue(context):
                part: Any = port.Eval(context)
                forces += part
        output.set_value(forces)
