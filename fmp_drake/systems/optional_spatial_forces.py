"""Forces on bodies from a port that may stay unconnected."""

from typing import Any

from pydrake.common.value import Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import LeafSystem

from fmp_drake.systems.interface.callbacks import declare_spatial_forces


class OptionalSpatialForces(LeafSystem):
    """Forces on bodies, or none where nothing is connected.

    A diagram exports its input in place of that of Drake's
    `ExternallyAppliedSpatialForceMultiplexer`, which must be connected.

    Input ports
    -----------
    forces : abstract
        List of `ExternallyAppliedSpatialForce`; may stay unconnected.

    Output ports
    ------------
    spatial_forces : abstract
        The same list.

    Examples
    --------
    >>> forces = OptionalSpatialForces()
    >>> forces.GetOutputPort("spatial_forces").Eval(forces.CreateDefaultContext())
    []
    """

    def __init__(self) -> None:
        super().__init__()
        self.set_name("optional_spatial_forces")
        forces = Value[list[ExternallyAppliedSpatialForce]]
        self._forces = self.DeclareAbstractInputPort("forces", forces())
        declare_spatial_forces(self, self._calc, {self._forces.ticket()})

    def _calc(self, context: Any, output: Any) -> None:
        has_value = self._forces.HasValue(context)
        output.set_value(self._forces.Eval(context) if has_value else [])
