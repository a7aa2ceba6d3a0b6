"""The force of a tool on a surface, from what an arm feels in its joints."""

from typing import Any

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.systems.framework.callbacks import eval_cache
from fmp_drake.systems.impedance.arm import ArmModel


class NormalForceEstimator(LeafSystem):
    """Estimates the force of a tool along a normal from external joint torques.

    The wrench F of what touches the tool is that of the smallest residual
    ``|Jᵀ F - τ|`` in Nm, with the Jacobian J of the end effector E. It is exact where
    nothing but the tool is touched, and the arm is not singular.

    Input ports
    -----------
    state : (2n,)
        Angles and speeds of the joints, rad and rad/s.
    torque_external : (n,)
        Of what touches the arm, on the arm, Nm.

    Output ports
    ------------
    normal_force : (1,)
        Of the tool on the surface, along -z of T, N; NaN where an input is not finite.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized; the arm and its tool.
    end_effector : Frame
        E, a frame of `plant`.
    R_WT : RotationMatrix
        Of the surface, z out of it.

    Examples
    --------
    >>> from fmp_drake.station import AddPandaWithEraser
    >>> plant = MultibodyPlant(time_step=0.0)
    >>> _ = AddPandaWithEraser(plant)
    >>> plant.Finalize()
    >>> estimator = NormalForceEstimator(
    ...     plant, end_effector=plant.GetFrameByName("eraser_tip"), R_WT=RotationMatrix()
    ... )
    >>> context = estimator.CreateDefaultContext()
    >>> _ = estimator.GetInputPort("state").FixValue(context, np.full(14, 0.1))
    >>> _ = estimator.GetInputPort("torque_external").FixValue(context, np.zeros(7))
    >>> estimator.GetOutputPort("normal_force").Eval(context)
    array([0.])
    """

    def __init__(
        self, plant: MultibodyPlant, *, end_effector: Frame, R_WT: RotationMatrix
    ) -> None:
        super().__init__()
        self.set_name("normal_force_estimator")
        self._arm = ArmModel(plant, end_effector)
        self._normal_W = R_WT.matrix()[:, 2].copy()
        n = plant.num_velocities()
        self._state = self.DeclareVectorInputPort("state", 2 * n)
        self._torque = self.DeclareVectorInputPort("torque_external", n)
        self._plant_context = self._arm.declare_context(self)
        self.DeclareVectorOutputPort(
            "normal_force",
            1,
            self._calc,
            prerequisites_of_calc={self._state.ticket(), self._torque.ticket()},
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        state: Any = self._state.Eval(context)
        torque: Any = self._torque.Eval(context)
        force = np.nan
        if np.all(np.isfinite(state)) and np.all(np.isfinite(torque)):
            J = self._arm.jacobian(
                eval_cache(self, self._plant_context, context), state
            )
            wrench = np.linalg.lstsq(J.T, torque)[0]
            force = self._normal_W @ wrench[3:]
        output.SetAtIndex(0, force)
