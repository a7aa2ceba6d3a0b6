"""The arm's controller: a spring and damper between the tool and its target."""

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    InputPort,
    LeafSystem,
    ValueProducer,
)

from fmp_drake.errors import StationError
from fmp_drake.systems.impedance_config import ImpedanceConfig
from fmp_drake.systems.impedance_law import (
    ArmDynamics,
    Array,
    impedance_torque,
    limit_torque,
    limit_torque_rate,
    task_error,
)


class _ArmKinematics:
    """The scratch plant context and what was read from it for the present state."""

    __slots__ = ("J", "R_TE", "p_TE", "plant_context", "q", "v")

    def __init__(self, plant_context: Context) -> None:
        self.plant_context = plant_context
        self.q: Array
        self.v: Array
        self.R_TE: Array
        self.p_TE: Array
        self.J: Array


class OperationalSpaceImpedanceController(LeafSystem):
    """Moves the end effector E like a damped spring in the task frame T.

    Input ports:

    - ``state`` (2n): the arm's ``[q, v]``, rad and rad/s.
    - ``desired_position`` (3): p_TE, m, in T.
    - ``desired_velocity`` (3): of E's origin, m/s, in T.
    - ``desired_acceleration`` (3): of E's origin, m/s², in T.
    - ``feedforward_wrench`` (6): torque and force, Nm and N, in T, that the robot
      shall apply at E's origin.

    Output ports:

    - ``torque`` (n): Nm, without gravity. It is discrete state: zero at first, then
      updated every ``config.control_period``, within the plant's effort limits
      and the configured rate.
    - ``measured_position`` (3): p_TE, m, in T.
    - ``measured_velocity`` (3): of E's origin, m/s, in T.
    - ``tracking_error`` (6): what is left to the desired pose, a rotation vector in
      rad and a translation in m, in T.

    The law is `fmp_drake.systems.impedance_law.impedance_torque`.

    Parameters
    ----------
    plant : MultibodyPlant
        A finalized plant that holds the arm and its tool and nothing else, with one
        actuator for every joint in the joints' order.
    end_effector : Frame
        E, a frame of `plant`.
    X_WT : RigidTransform
        Pose of the task frame in the world.
    config : ImpedanceConfig
        Gains and limits; read once.
    q_posture : array, shape (n,), optional
        The posture that the nullspace holds, rad. By default the middle of the
        joints' ranges (zero for a joint without limits).

    Raises
    ------
    StationError
        If the plant, the configuration or the posture cannot be used.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        *,
        end_effector: Frame,
        X_WT: RigidTransform,
        config: ImpedanceConfig,
        q_posture: NDArray[np.float64] | None = None,
    ) -> None:
        LeafSystem.__init__(self)
        self.set_name("operational_space_impedance_controller")
        _check_plant(plant)
        n = plant.num_velocities()
        self._plant = plant
        self._world = plant.world_frame()
        self._end_effector = end_effector
        self._gains = config.gains()
        self._R_TE_desired = config.desired_rotation()
        self._max_change = config.max_torque_rate * config.control_period
        self._lower = plant.GetEffortLowerLimits()
        self._upper = plant.GetEffortUpperLimits()
        self._q_posture = _checked_posture(plant, q_posture)
        X_TW = X_WT.inverse()
        self._R_TW = X_TW.rotation().matrix()
        self._p_TW = X_TW.translation()
        self._origin = np.zeros(3)

        self._state = self.DeclareVectorInputPort("state", 2 * n)
        self._desired_position = self.DeclareVectorInputPort("desired_position", 3)
        self._desired_velocity = self.DeclareVectorInputPort("desired_velocity", 3)
        self._desired_acceleration = self.DeclareVectorInputPort(
            "desired_acceleration", 3
        )
        self._feedforward_wrench = self.DeclareVectorInputPort("feedforward_wrench", 6)

        self._kinematics = self.DeclareCacheEntry(
            "arm kinematics",
            ValueProducer(
                allocate=lambda: AbstractValue.Make(
                    _ArmKinematics(plant.CreateDefaultContext())
                ),
                calc=self._calc_kinematics,
            ),
            prerequisites_of_calc={self._state.ticket()},
        )
        self._error = self.DeclareCacheEntry(
            "tracking error",
            ValueProducer(
                allocate=lambda: AbstractValue.Make(np.zeros(6)),
                calc=self._calc_error,
            ),
            prerequisites_of_calc={
                self._kinematics.ticket(),
                self._desired_position.ticket(),
            },
        )

        torque = self.DeclareDiscreteState(n)
        self.DeclareStateOutputPort("torque", torque)
        self.DeclareVectorOutputPort(
            "measured_position",
            3,
            self._calc_measured_position,
            prerequisites_of_calc={self._kinematics.ticket()},
        )
        self.DeclareVectorOutputPort(
            "measured_velocity",
            3,
            self._calc_measured_velocity,
            prerequisites_of_calc={self._kinematics.ticket()},
        )
        self.DeclareVectorOutputPort(
            "tracking_error",
            6,
            self._calc_tracking_error,
            prerequisites_of_calc={self._error.ticket()},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=config.control_period, offset_sec=0.0, update=self._update_torque
        )

    def _calc_kinematics(self, context: Any, abstract: Any) -> None:
        arm: _ArmKinematics = abstract.get_mutable_value()
        state = _vector(self._state, context)
        n = state.size // 2
        self._plant.SetPositionsAndVelocities(arm.plant_context, state)
        X_WE = self._end_effector.CalcPoseInWorld(arm.plant_context)
        J_WE = self._plant.CalcJacobianSpatialVelocity(
            arm.plant_context,
            JacobianWrtVariable.kV,
            self._end_effector,
            self._origin,
            self._world,
            self._world,
        )
        arm.q = state[:n]
        arm.v = state[n:]
        arm.R_TE = np.dot(self._R_TW, X_WE.rotation().matrix())
        arm.p_TE = np.dot(self._R_TW, X_WE.translation()) + self._p_TW
        arm.J = np.empty((6, n))
        np.dot(self._R_TW, J_WE[:3], out=arm.J[:3])
        np.dot(self._R_TW, J_WE[3:], out=arm.J[3:])

    def _calc_error(self, context: Any, abstract: Any) -> None:
        arm = self._eval_kinematics(context)
        abstract.set_value(
            task_error(
                R_TE=arm.R_TE,
                p_TE=arm.p_TE,
                R_TE_desired=self._R_TE_desired,
                p_TE_desired=_vector(self._desired_position, context),
            )
        )

    def _eval_kinematics(self, context: Context) -> _ArmKinematics:
        return cast(_ArmKinematics, self._kinematics.Eval(context))

    def _eval_error(self, context: Context) -> Array:
        return cast(Array, self._error.Eval(context))

    def _calc_measured_position(self, context: Context, output: BasicVector) -> None:
        arm = self._eval_kinematics(context)
        output.SetFromVector(arm.p_TE)

    def _calc_measured_velocity(self, context: Context, output: BasicVector) -> None:
        arm = self._eval_kinematics(context)
        output.SetFromVector(np.dot(arm.J[3:], arm.v))

    def _calc_tracking_error(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._eval_error(context))

    def _update_torque(self, context: Context, values: DiscreteValues) -> None:
        arm = self._eval_kinematics(context)
        plant, plant_context = self._plant, arm.plant_context
        A_WE_bias = plant.CalcBiasSpatialAcceleration(
            plant_context,
            JacobianWrtVariable.kV,
            self._end_effector,
            self._origin,
            self._world,
            self._world,
        )
        desired_twist = np.zeros(6)
        desired_twist[3:] = _vector(self._desired_velocity, context)
        desired_acceleration = np.zeros(6)
        desired_acceleration[3:] = _vector(self._desired_acceleration, context)
        torque = impedance_torque(
            self._gains,
            ArmDynamics(
                v=arm.v,
                M=plant.CalcMassMatrix(plant_context),
                Cv=plant.CalcBiasTerm(plant_context),
                J=arm.J,
                Jdot_v=np.dot(
                    A_WE_bias.get_coeffs().reshape(2, 3), self._R_TW.T
                ).ravel(),
            ),
            error=self._eval_error(context),
            desired_twist=desired_twist,
            desired_acceleration=desired_acceleration,
            feedforward_wrench=_vector(self._feedforward_wrench, context),
            posture_error=self._q_posture - arm.q,
        )
        if not np.isfinite(torque).all():
            raise StationError(self._describe_non_finite(context))
        torque = limit_torque(torque, lower=self._lower, upper=self._upper)
        values.set_value(
            0,
            limit_torque_rate(
                torque,
                previous=context.get_discrete_state(0).value(),
                max_change=self._max_change,
            ),
        )

    def _describe_non_finite(self, context: Context) -> str:
        ports = [self.get_input_port(i) for i in range(self.num_input_ports())]
        values = {port.get_name(): _vector(port, context) for port in ports}
        bad = [
            f"{name} = {value}"
            for name, value in values.items()
            if not np.isfinite(value).all()
        ]
        return (
            f"{self.get_name()} has no finite torque at t = {context.get_time():g} s; "
            f"inputs that must be finite: {', '.join(bad) or 'all are'}"
        )


def _vector(port: InputPort, context: Context) -> Array:
    """Evaluate a vector port."""
    return cast(Array, port.Eval(context))


def _check_plant(plant: MultibodyPlant) -> None:
    """Refuse a plant that is not one fully actuated arm."""
    if not plant.is_finalized():
        raise StationError("The controller's plant must be finalized first.")
    n = plant.num_velocities()
    if n == 0 or plant.num_positions() != n:
        raise StationError(
            "The controller's plant must hold an arm on a fixed base: "
            f"{plant.num_positions()} positions and {n} velocities, not equal numbers "
            "above 0."
        )
    if plant.num_actuators() != n or not np.array_equal(
        plant.MakeActuationMatrix(), np.eye(n)
    ):
        raise StationError(
            f"The controller's plant must have one actuator for each of its {n} "
            f"joints, in their order; it has {plant.num_actuators()}."
        )


def _checked_posture(
    plant: MultibodyPlant, q_posture: NDArray[np.float64] | None
) -> Array:
    """Return a copy of the posture, or the middle of the joints' ranges."""
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    if q_posture is None:
        limited = np.isfinite(lower) & np.isfinite(upper)
        middle = np.zeros(plant.num_positions())
        middle[limited] = 0.5 * (lower[limited] + upper[limited])
        return middle
    q = np.array(q_posture, dtype=float)
    if q.shape != lower.shape or not np.all((lower <= q) & (q <= upper)):
        raise StationError(
            f"q_posture must be {lower.size} angles between {lower} and {upper} rad, "
            f"got {q}"
        )
    return q
