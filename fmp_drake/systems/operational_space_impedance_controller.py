"""The arm's controller: a spring and damper between the tool and its target.

The law
=======
With the arm's equation of motion ``M v̇ + C v = τ + Jᵀ F_ext`` (gravity is
compensated elsewhere) the controller commands

    τ = Jᵀ (Λ (A_d − J̇ v) + K e + D (V_d − J v) + F_ff) + C v + Nᵀ M a,

all of it expressed in the task frame T, rotations first. Then the end effector E
obeys ``Λ (A_d − A) + D (V_d − V) + K e = −F_ff − F_ext``: a mechanical impedance
whose inertia is the arm's own, ``Λ = (J M⁻¹ Jᵀ)⁻¹``, so that no force sensor is
needed, and whose stiffness and damping are chosen.

- ``e`` is the rotation vector and the translation left to the desired pose. A
  rotation through 180 degrees goes on in the way it went before.
- ``K`` is any symmetric positive definite matrix. T may move (`task_frame`).
- ``D`` follows from the damping ratio ζ: ``Λ = B Bᵀ`` and ``K = B diag(ω²) Bᵀ``
  are diagonalized together, ``D = B diag(2 ζ ω) Bᵀ``. Every mode has the ratio ζ,
  at every configuration. With ``D = 2 sqrt(K)``, which takes Λ for 1, a Panda
  rings in translation (ζ of 0.2 to 0.5) and creeps in rotation.
- ``a = ω_p² (q_p − q) − 2 ζ_p ω_p v`` holds the posture in the nullspace;
  ``Nᵀ = I − Jᵀ Λ J M⁻¹`` is dynamically consistent: the tool does not feel it.

Choosing the parameters
=======================
- *Stiffness*: what a disturbance F may displace is F / K; Panda's joint friction is
  about 5 N at the tool. The natural frequency ``sqrt(K / Λ)`` (10 rad/s at 1500 N/m
  and 15 kg) should stay below 1/20 of the control rate and below what the target's
  samples excite. Along the normal of a board choose it soft: its error is K times
  the error in the board's height.
- *Damping ratio*: 1 to approach without overshoot, 0.7 to be faster; below 0.5 it
  rings.
- *Clips* `max_translation_error`, `max_rotation_error`: K times the clip is the
  greatest force of the spring; divided by D it is the greatest speed.
- *Posture frequency*: a few rad/s; below 2 the elbow sags with friction.
- *Press*: feed the force forward. Where height or tilt are not known within K's
  reach, enable `force_control` and connect the measured force; see
  `ForceControlConfig` for its gains.
- *Minimal intervention*: `covariance_stiffness` takes K from the covariance of the
  demonstrations, ``k_min + (k_max − k_min) (1 + Σ / σ²)⁻¹``. Choose σ as the
  deviation that a person would not correct.
- *Changing stiffness* (that, or the port `stiffness`) is filtered by
  `stiffness_time_constant` and paid for by the energy tank. Energy in the tank comes
  from the damping; when it is empty, K may fall but not rise while e is not 0.

Passivity
=========
With a constant target the storage is ``½ Vᵀ Λ V + ½ eᵀ K e`` plus the tank. K
enters through the tank only, the walls are springs with dampers. What is left is
``½ Vᵀ Λ̇ V``, because the Coriolis torque is cancelled rather than shaped; the
damping ``Vᵀ D V`` outweighs it where Λ changes slower than ``2 ζ ω``: it is
measured, not proven. A clipped error with unequal stiffnesses, a torque at its
limits, force control and friction compensation are outside of this argument too.

Safety
======
Torque starts at zero, keeps the plant's limits without changing its direction, and
changes by at most `max_torque_rate`. `JointWallConfig` keeps joints within their
ranges and speeds; its torque comes on top of the limited task, and the sum is
clipped joint by joint, so the wall wins. `max_effective_mass` bounds Λ near
singularities, where D and the tracking get softer than chosen. `WatchdogConfig`
says when the target is not followed: then the arm is held, damped, where it is, the
press is let go, and once the target is good again the hold is led to it. All of
this shows on the port `status`.

Friction compensation uses the measured velocity: it cannot help at rest, and with a
gain above 1 the joints run away.

Model hold
==========
The torque is updated every `control_period`, the law every `model_period`: in between,
a model of the law, of first order in the arm's state and of second in time, is
evaluated at the measured state, see `impedance_hold`. Stiffness and damping act at the
full rate, and the target goes on with its `desired_jerk`. Wiping with 25 ms the torque
differs by 0.08 Nm (rms) from the law at every millisecond, without the jerk by 0.16 Nm,
with 20 ms by 0.03 and 0.11 Nm; Panda's joints rub with more. What differs more are
jumps of the target, seen up to 25 ms later. The law is computed at once where the state
is not finite, leaves the model's reach (0.05 rad, 0.3 rad/s, or less in front of a wall
or a brake), or the torque or its rate comes near a limit, and every time while `status`
shows anything but force control. What the other ports bring, also a fault of the target
or a lost contact, is noticed at the next full update. With ``model_period =
control_period`` all updates are full.

References
----------
.. [1] O. Khatib, "A unified approach for motion and force control of robot
   manipulators: the operational space formulation", IEEE J. Robotics and
   Automation 3(1), 1987.
.. [2] A. Albu-Schäffer, C. Ott, U. Frese, G. Hirzinger, "Cartesian impedance
   control of redundant robots: recent results with the DLR-light-weight-arms",
   ICRA 2003.
"""

from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    InputPort,
    LeafSystem,
    ValueProducer,
)

from fmp_drake.errors import StationError
from fmp_drake.systems.impedance.arm import (
    ArmKinematics,
    ArmModel,
    is_finite,
    step_settings,
    twist_turn,
)
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.error import task_error
from fmp_drake.systems.impedance.inputs import ArmMeasurement, StepInputs
from fmp_drake.systems.impedance.law import Array
from fmp_drake.systems.impedance.memory import ImpedanceMemory
from fmp_drake.systems.impedance.status import STATUS_SIZE
from fmp_drake.systems.impedance.step import impedance_step
from fmp_drake.systems.impedance.target import TaskTarget, rotation_of_quaternion

# Groups of the discrete state.
_TORQUE, _STATUS, _MEMORY, _MODEL = range(4)


class OperationalSpaceImpedanceController(LeafSystem):
    """Moves the end effector E like a damped spring in the task frame T.

    Input ports that must be connected:

    - ``state`` (2n): the arm's ``[q, v]``, rad and rad/s.
    - ``desired_position`` (3): p_TE, m, in T.
    - ``desired_velocity`` (3): of E's origin, m/s, in T.
    - ``desired_acceleration`` (3): of E's origin, m/s², in T.
    - ``feedforward_wrench`` (6): torque and force, Nm and N, in T, that the robot
      shall apply at E's origin.

    Input ports that may stay unconnected:

    - ``desired_orientation`` (4): quaternion w, x, y, z of R_TE, of any length and
      sign; without it the configured orientation.
    - ``desired_angular_velocity``, ``desired_angular_acceleration`` (3): of E
      relative to T, in T, rad/s and rad/s².
    - ``task_frame`` (7): quaternion w, x, y, z of R_WT and p_WT in m; without it
      `X_WT`.
    - ``task_frame_velocity`` (6), ``task_frame_acceleration`` (6): V_WT of T's origin
      and its derivative, rotation first, in W: rad/s, m/s, rad/s², m/s². The second
      is used with the first.
    - ``desired_jerk`` (3): how the desired acceleration goes on until the next full
      update, m/s³, in T; without it the last updates tell. Not used with
      ``config.target_time_constant``.
    - ``target_time`` (1): when the target was made, s of the context's time.
    - ``stiffness`` (36 or 6): K in T, its rows or its diagonal, rotations first.
    - ``covariance`` (9): of the desired position, m², in T, if
      ``config.covariance_stiffness`` is enabled.
    - ``normal_force`` (1): measured press along −z of T, N, if
      ``config.force_control`` is enabled. The wanted press is
      ``feedforward_wrench``'s.

    Output ports:

    - ``torque`` (n): Nm, without gravity. It is discrete state: zero at first, then
      updated every ``config.control_period``, within the plant's effort limits
      and the configured rate.
    - ``measured_position`` (3): p_TE, m, in T.
    - ``measured_velocity`` (3): of E's origin relative to T, m/s, in T.
    - ``tracking_error`` (6): what is left to the desired pose as it came in, a
      rotation vector in rad and a translation in m, in T.
    - ``status`` (6): what the last full update did, see `ImpedanceStatus`.

    Inputs that are not finite, stale or jump do not raise: see `WatchdogConfig`.

    Parameters
    ----------
    plant : MultibodyPlant
        A finalized plant that holds the arm and its tool and nothing else, with one
        actuator for every joint in the joints' order. The limits are its own.
    end_effector : Frame
        E, a frame of `plant`.
    X_WT : RigidTransform
        Pose of the task frame in the world.
    config : ImpedanceConfig
        Gains and limits; read once.
    q_posture : array, shape (n,), optional
        The posture that the nullspace holds, rad. By default the middle of the
        joints' ranges (zero for a joint without limits).
    stiffness_size : {36, 6}, optional
        Size of the port `stiffness`.

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
        stiffness_size: Literal[6, 36] = 36,
    ) -> None:
        LeafSystem.__init__(self)
        self.set_name("operational_space_impedance_controller")
        model = ArmModel(plant, end_effector)
        if stiffness_size not in (6, 36):
            raise StationError(f"stiffness_size must be 6 or 36, got {stiffness_size}")
        n = plant.num_velocities()
        self._model = model
        self._settings = step_settings(plant, config, q_posture)
        self._hold = self._settings.hold
        self._R_TE_desired = config.desired_rotation()
        self._R_WT = X_WT.rotation().matrix()
        self._p_WT = np.array(X_WT.translation())
        self._turn = twist_turn(self._R_WT.T)
        self._unmoved = np.zeros(6)
        self._unmoved.setflags(write=False)
        self._declare_inputs(n, stiffness_size)
        self._declare_cache()
        self._declare_outputs(n)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=config.control_period, offset_sec=0.0, update=self._update
        )

    def _declare_inputs(self, n: int, stiffness_size: int) -> None:
        declare = self.DeclareVectorInputPort
        self._state = declare("state", 2 * n)
        self._desired_position = declare("desired_position", 3)
        self._desired_velocity = declare("desired_velocity", 3)
        self._desired_acceleration = declare("desired_acceleration", 3)
        self._feedforward_wrench = declare("feedforward_wrench", 6)
        self._desired_orientation = declare("desired_orientation", 4)
        self._desired_jerk = declare("desired_jerk", 3)
        self._angular_velocity = declare("desired_angular_velocity", 3)
        self._angular_acceleration = declare("desired_angular_acceleration", 3)
        self._task_frame = declare("task_frame", 7)
        self._task_frame_velocity = declare("task_frame_velocity", 6)
        self._task_frame_acceleration = declare("task_frame_acceleration", 6)
        self._target_time = declare("target_time", 1)
        self._stiffness = declare("stiffness", stiffness_size)
        self._covariance = declare("covariance", 9)
        self._normal_force = declare("normal_force", 1)

    def _declare_cache(self) -> None:
        model = self._model
        self._kinematics = self.DeclareCacheEntry(
            "arm kinematics",
            ValueProducer(
                allocate=lambda: AbstractValue.Make(model.allocate()),
                calc=self._calc_kinematics,
            ),
            prerequisites_of_calc={self._state.ticket(), self._task_frame.ticket()},
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
                self._desired_orientation.ticket(),
            },
        )

    def _declare_outputs(self, n: int) -> None:
        settings = self._settings
        self.DeclareStateOutputPort("torque", self.DeclareDiscreteState(n))
        status = self.DeclareDiscreteState(STATUS_SIZE)
        memory = ImpedanceMemory.initial(
            settings.gains.stiffness, tank_energy=settings.config.tank.initial_energy
        )
        self.DeclareDiscreteState(memory.to_vector())
        self.DeclareDiscreteState(settings.hold.empty())
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
            prerequisites_of_calc={
                self._kinematics.ticket(),
                self._task_frame_velocity.ticket(),
            },
        )
        self.DeclareVectorOutputPort(
            "tracking_error",
            6,
            self._calc_tracking_error,
            prerequisites_of_calc={self._error.ticket()},
        )
        self.DeclareStateOutputPort("status", status)

    def _calc_kinematics(self, context: Any, abstract: Any) -> None:
        arm: ArmKinematics = abstract.get_mutable_value()
        arm.R_WT, arm.p_WT, arm.frame_finite = self._frame(context)
        still = arm.R_WT is self._R_WT
        arm.turn = self._turn if still else twist_turn(arm.R_WT.T)
        self._model.read(arm, _vector(self._state, context))

    def _frame(self, context: Context) -> tuple[Array, Array, bool]:
        """Return R_WT, p_WT and whether the port, if connected, holds a pose."""
        if self._task_frame.HasValue(context):
            pose = _vector(self._task_frame, context)
            R_WT = rotation_of_quaternion(pose[:4])
            if np.isfinite(R_WT).all() and np.isfinite(pose).all():
                return R_WT, pose[4:], True
            return self._R_WT, self._p_WT, False
        return self._R_WT, self._p_WT, True

    def _orientation(self, context: Context) -> Array:
        """Return the desired R_TE."""
        if self._desired_orientation.HasValue(context):
            return rotation_of_quaternion(_vector(self._desired_orientation, context))
        return self._R_TE_desired

    def _calc_error(self, context: Any, abstract: Any) -> None:
        arm = self._eval_kinematics(context)
        error: Array = abstract.get_mutable_value()
        error[:] = task_error(
            R_TE=arm.R_TE,
            p_TE=arm.p_TE,
            R_TE_desired=self._orientation(context),
            p_TE_desired=_vector(self._desired_position, context),
        )

    def _eval_kinematics(self, context: Context) -> ArmKinematics:
        return cast(ArmKinematics, self._kinematics.Eval(context))

    def _eval_error(self, context: Context) -> Array:
        return cast(Array, self._error.Eval(context))

    def _calc_measured_position(self, context: Context, output: BasicVector) -> None:
        arm = self._eval_kinematics(context)
        output.SetFromVector(arm.p_TE)

    def _calc_measured_velocity(self, context: Context, output: BasicVector) -> None:
        arm = self._eval_kinematics(context)
        velocity = np.dot(arm.J[3:], arm.v)
        frame_twist = self._frame_twist(context, arm)
        if frame_twist is not None:
            velocity -= frame_twist[3:] + np.cross(frame_twist[:3], arm.p_TE)
        output.SetFromVector(velocity)

    def _frame_twist(self, context: Context, arm: ArmKinematics) -> Array | None:
        """Return V_WT in T's axes, or None where T stands still."""
        if not self._task_frame_velocity.HasValue(context):
            return None
        V_WT = _vector(self._task_frame_velocity, context)
        return np.dot(arm.turn, V_WT)

    def _calc_tracking_error(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._eval_error(context))

    def _update(self, context: Context, values: DiscreteValues) -> None:
        discrete = context.get_discrete_state()
        previous, held = discrete.value(_TORQUE), discrete.value(_MODEL)
        hold, time = self._hold, context.get_time()
        torque = None
        if hold.serves(held, time):
            # A view, which is faster than `Eval`, and is not kept.
            state: Any = self._state.EvalBasicVector(context)
            torque = hold.torque(
                held, time=time, state=state.value(), previous=previous
            )
        if torque is not None:
            values.set_value(_TORQUE, torque)
        else:
            self._full_update(context, values, previous=previous, held=held)

    def _full_update(
        self, context: Context, values: DiscreteValues, *, previous: Array, held: Array
    ) -> None:
        hold, time = self._hold, context.get_time()
        arm = self._eval_kinematics(context)
        measurement = None
        if arm.finite:
            measurement = ArmMeasurement(
                arm.q,
                self._model.dynamics(arm),
                arm.R_TE,
                arm.p_TE,
                self._eval_error(context),
            )
        result = impedance_step(
            self._settings,
            ImpedanceMemory.from_vector(context.get_discrete_state(_MEMORY).value()),
            arm=measurement,
            inputs=self._inputs(context, arm, hold.elapsed(held, time=time)),
            previous=previous,
        )
        values.set_value(_TORQUE, result.torque)
        values.set_value(_STATUS, np.array(result.status))
        values.set_value(_MEMORY, result.memory.to_vector())
        values.set_value(_MODEL, hold.pack(result.model, time=time, before=held))

    def _inputs(
        self, context: Context, arm: ArmKinematics, elapsed: float
    ) -> StepInputs:
        position = _vector(self._desired_position, context)
        velocity = _vector(self._desired_velocity, context)
        acceleration = _vector(self._desired_acceleration, context)
        wrench = _vector(self._feedforward_wrench, context)
        R = self._orientation(context)
        w = _optional(self._angular_velocity, context)
        alpha = _optional(self._angular_acceleration, context)
        jerk = _optional(self._desired_jerk, context)
        age = _optional(self._target_time, context)
        frame_twist = self._frame_twist(context, arm)
        frame_acceleration = self._unmoved
        if self._task_frame_acceleration.HasValue(context):
            A_WT = _vector(self._task_frame_acceleration, context)
            frame_acceleration = np.dot(arm.turn, A_WT)
        stiffness = _optional(self._stiffness, context)
        covariance = force = None
        if self._settings.config.covariance_stiffness.enabled:
            covariance = _optional(self._covariance, context)
        if self._settings.config.force_control.enabled:
            force = _optional(self._normal_force, context)
        V, A = np.zeros(6), np.zeros(6)
        V[3:] = velocity
        A[3:] = acceleration
        if w is not None:
            V[:3] = w
        if alpha is not None:
            A[:3] = alpha
        finite = arm.frame_finite and is_finite(
            np.concatenate((position, V, A, wrench))
        )
        for value in (
            jerk, age, frame_twist, frame_acceleration, stiffness, covariance, force
        ):  # fmt: skip
            finite = finite and (value is None or is_finite(value))
        if R is not self._R_TE_desired:
            finite = finite and is_finite(R.ravel())
        return StepInputs(
            TaskTarget(R, position, V, A),
            jerk,
            wrench,
            finite,
            R is not self._R_TE_desired,
            None if age is None else context.get_time() - float(age[0]),
            arm.R_WT,
            arm.p_WT,
            arm.R_WT is not self._R_WT,
            frame_twist,
            frame_acceleration,
            stiffness,
            covariance,
            None if force is None else float(force[0]),
            elapsed,
        )


def _vector(port: InputPort, context: Context) -> Array:
    """Evaluate a vector port."""
    return cast(Array, port.Eval(context))


def _optional(port: InputPort, context: Context) -> Array | None:
    """Evaluate a vector port that may be unconnected."""
    return _vector(port, context) if port.HasValue(context) else None
