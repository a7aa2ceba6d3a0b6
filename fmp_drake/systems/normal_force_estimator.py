"""Normal force of a tool on a surface, from estimated external joint torques."""

from typing import Any

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_type
from fmp_drake.systems.interface.arm_model import ArmModel
from fmp_drake.systems.interface.callbacks import eval_cache


class NormalForceEstimator(LeafSystem):
    """Normal force of a tool, estimated from external joint torques.

    The wrench F on the tool minimises the residual ``|Jᵀ F - τ|`` in Nm, with the
    Jacobian J of the end effector E. The estimate is exact where only the tool is in
    contact and the arm is not singular.

    Input ports
    -----------
    state : (2n,)
        Angles and speeds of the joints, rad and rad/s.
    torque_external : (n,)
        Of all contacts, on the arm, Nm.
    task_frame : (7,)
        Quaternion (w, x, y, z) of R_WT and p_WT in m. Optional, for a surface whose normal
        changes; `R_WT` without it.

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
        Orientation of the surface, z outward.

    Examples
    --------
    >>> from fmp_drake.station import AddRobot, LoadRobot
    >>> plant = MultibodyPlant(time_step=0.0)
    >>> _ = AddRobot(plant, LoadRobot("panda"))
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
        check_type(R_WT, "R_WT", RotationMatrix, error=SystemsError)
        self._normal_W = R_WT.matrix()[:, 2].copy()
        n = plant.num_velocities()
        self._state = self.DeclareVectorInputPort("state", 2 * n)
        self._torque = self.DeclareVectorInputPort("torque_external", n)
        self._frame = self.DeclareVectorInputPort("task_frame", 7)
        self._plant_context = self._arm.declare_context(self)
        tickets = {p.ticket() for p in (self._state, self._torque, self._frame)}
        self.DeclareVectorOutputPort("normal_force", 1, self._calc, tickets)

    def _calc(self, context: Context, output: BasicVector) -> None:
        state: Any = self._state.Eval(context)
        torque: Any = self._torque.Eval(context)
        force = np.nan
        if np.all(np.isfinite(state)) and np.all(np.isfinite(torque)):
            plant_context = eval_cache(self, self._plant_context, context)
            J = self._arm.jacobian(plant_context, state)
            wrench = np.linalg.lstsq(J.T, torque)[0]
            normal_W = self._normal_W
            if self._frame.HasValue(context):
                frame: Any = self._frame.Eval(context)
                w, x, y, z = frame[:4] / np.linalg.norm(frame[:4])
                normal_W = np.array(
                    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
                )
            force = normal_W @ wrench[3:]
        output.SetAtIndex(0, force)
