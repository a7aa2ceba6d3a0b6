"""Joint friction of a simulated arm."""

from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.systems.impedance.joints import (
    FrictionConfig,
    SigmoidFriction,
    friction_torque,
)


class JointFriction(LeafSystem):
    """Friction of an arm's joints as a generalized force on the plant.

    Input port ``state`` (2n): the arm's ``[q, v]``, rad and rad/s. Output port
    ``generalized_force`` (nv of the whole plant): Nm, against the motion; connect it
    to the plant's ``applied_generalized_force``.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized, the simulated one.
    arm : ModelInstanceIndex
        Instance whose joints have friction.
    config : FrictionConfig
        For all joints of the arm; `enabled` is not read here.

    Raises
    ------
    SystemsError
        If the plant is not finalized or the configuration does not fit the arm.

    Examples
    --------
    A joint that does not move has no friction:

    >>> from pydrake.multibody.tree import RevoluteJoint, default_model_instance
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> link = plant.AddRigidBody("link").body_frame()
    >>> joint = RevoluteJoint("joint", plant.world_frame(), link, [0.0, 0.0, 1.0])
    >>> _ = plant.AddJoint(joint)
    >>> plant.Finalize()
    >>> config = FrictionConfig(height=[0.5], slope=[5.0], shift=[0.04])
    >>> friction = JointFriction(plant, arm=default_model_instance(), config=config)
    >>> context = friction.CreateDefaultContext()
    >>> _ = friction.get_input_port().FixValue(context, np.zeros(2))
    >>> friction.get_output_port().Eval(context).tolist()
    [-0.0]
    """

    def __init__(
        self, plant: MultibodyPlant, *, arm: ModelInstanceIndex, config: FrictionConfig
    ) -> None:
        super().__init__()
        self.set_name("joint_friction")
        if not plant.is_finalized():
            raise SystemsError("the plant is not finalized; call Finalize() first.")
        n = plant.num_velocities(arm)
        self._friction = SigmoidFriction.of(config, n=n)
        indices = plant.GetVelocitiesFromArray(
            arm, np.arange(plant.num_velocities(), dtype=float)
        )
        self._indices = indices.astype(int)
        self._state = self.DeclareVectorInputPort("state", 2 * n)
        size, tickets = plant.num_velocities(), {self._state.ticket()}
        self.DeclareVectorOutputPort("generalized_force", size, self._calc, tickets)

    def _calc(self, context: Context, output: BasicVector) -> None:
        state: Any = self._state.Eval(context)
        v = state[state.size // 2 :]
        force = np.zeros(output.size())
        force[self._indices] = -friction_torque(self._friction, v)
        output.SetFromVector(force)
