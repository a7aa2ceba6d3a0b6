"""The pull of a mouse on a body, as strong as a person's hand."""

from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number, read_only

_NONE = np.array([-1.0, *np.zeros(9)])


class MousePull(LeafSystem):
    """Makes Drake's mouse spring equally stiff on all bodies, and limits its force.

    Drake's spring has a stiffness per kilogram of the body that is dragged: the eraser
    could hardly be moved and the shoulder be torn off. The mouse is part of the
    outside world: it is read at a rate, and what was read is the state.

    Input ports
    -----------
    spring : abstract
        Of the mouse spring: the forces of a drag, or none.

    Output ports
    ------------
    spatial_force : abstract
        For the plant's applied_spatial_force port.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized; knows the masses.
    specific_stiffness : float
        Of the mouse spring, 1/s^2.
    stiffness : float
        N/m.
    max_force : float
        N.
    period : float
        Between two readings, s.

    Examples
    --------
    >>> from pydrake.multibody.plant import MultibodyPlant
    >>> from fmp_drake.station import AddPandaWithEraser
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> _ = AddPandaWithEraser(plant)
    >>> plant.Finalize()
    >>> pull = MousePull(plant, specific_stiffness=1000.0, max_force=20.0)
    >>> pull.GetInputPort("spring").get_name()
    'spring'
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        *,
        specific_stiffness: float,
        stiffness: float = 400.0,
        max_force: float = 40.0,
        period: float = 0.016,
    ) -> None:
        super().__init__()
        self.set_name("mouse_pull")
        for name, value in {
            "specific_stiffness": specific_stiffness,
            "stiffness": stiffness,
            "max_force": max_force,
            "period": period,
        }.items():
            check_number(value, name, above=0, error=SystemsError)
        bodies = (plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies()))
        self._masses = read_only(np.array([body.default_mass() for body in bodies]))
        self._ratio = stiffness / specific_stiffness
        self._max_force = float(max_force)
        self._spring = self.DeclareAbstractInputPort(
            "spring", Value[list[ExternallyAppliedSpatialForce]]()
        )
        # body (-1: none), p_BoBq_B (m), moment (Nm) and force (N) in W
        pull = self.DeclareDiscreteState(_NONE)
        self._pull = int(pull)
        self.DeclareAbstractOutputPort(
            "spatial_force",
            Value[list[ExternallyAppliedSpatialForce]],
            self._calc,
            prerequisites_of_calc={self.discrete_state_ticket(pull)},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._read)

    def _read(self, context: Context, values: DiscreteValues) -> None:
        springs: Any = self._spring.Eval(context)
        pull = _NONE
        for spring in springs:
            body = int(spring.body_index)
            mass = self._masses[body]
            if not mass > 0:
                continue
            wrench = self._ratio / mass * spring.F_Bq_W.get_coeffs()
            strength = float(np.linalg.norm(wrench[3:]))
            wrench *= min(1.0, self._max_force / max(strength, 1e-12))
            if np.all(np.isfinite(wrench)):
                pull = np.concatenate([[body], spring.p_BoBq_B, wrench])
        values.set_value(self._pull, pull)

    def _calc(self, context: Any, output: Any) -> None:
        pull = context.get_discrete_state(self._pull).value()
        if pull[0] < 0:
            output.set_value([])
            return
        force = ExternallyAppliedSpatialForce()
        force.body_index = BodyIndex(int(pull[0]))
        force.p_BoBq_B = pull[1:4]
        force.F_Bq_W = SpatialForce(pull[4:])
        output.set_value([force])
