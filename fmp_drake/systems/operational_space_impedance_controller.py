"""Cartesian impedance controller: a spring and damper between the tool and its target.

The law
=======
With the arm's equation of motion ``M v̇ + C v = τ + Jᵀ F_ext`` (gravity is
compensated elsewhere) the controller commands

    τ = Jᵀ (Λ (A_d − J̇ v) + K e + D (V_d − J v) + F_ff) + C v + Nᵀ M a,

all of it expressed in the task frame T, rotations first. Then the end effector E
obeys ``Λ (A_d − A) + D (V_d − V) + K e = −F_ff − F_ext``: a mechanical impedance
whose inertia is the arm's own, ``Λ = (J M⁻¹ Jᵀ)⁻¹``, so that no force sensor is
needed, and whose stiffness and damping are chosen.

- ``e`` is the rotation vector and the translation from the measured to the desired
  pose. The rotation vector is unwrapped: it is continuous through 180 degrees.
- ``K`` is any symmetric positive definite matrix. T may move (`task_frame`).
- ``D`` follows from the damping ratio ζ: ``Λ = B Bᵀ`` and ``K = B diag(ω²) Bᵀ`` are
  diagonalized together, ``D = B diag(2 ζ ω) Bᵀ``. Every mode has the ratio ζ, at
  every configuration. With ``D = 2 sqrt(K)``, which assumes Λ = 1, an arm is
  underdamped in translation and overdamped in rotation (a Panda: ζ of 0.2 to 0.5 in
  translation).
- ``a = ω_p² (q_p − q) − 2 ζ_p ω_p v`` keeps the posture in the nullspace;
  ``Nᵀ = I − Jᵀ Λ J M⁻¹`` is dynamically consistent: it does not accelerate the tool.

Choosing the parameters
=======================
- *Stiffness*: a disturbance F displaces the tool by F / K; joint friction is one (a
  Panda's is about 5 N at the tool). The natural frequency ``sqrt(K / Λ)`` (10 rad/s
  at 1500 N/m and 15 kg) should stay below 1/20 of the control rate and below the
  frequencies in the target's samples. Along the normal of a board choose a low
  stiffness: the error of the force is K times the error of the board's height.
- *Damping ratio*: 1 for an approach without overshoot, 0.7 for a faster one; below 0.5
  the motion oscillates.
- *Clips* `max_translation_error`, `max_rotation_error`: K times the clip is the
  greatest force of the spring; divided by D it is the greatest speed.
- *Posture frequency*: a few rad/s; below 2 the elbow sags with friction.
- *Normal force*: `desired_normal_force` is fed forward along −z of T. It increases
  smoothly while the target descends by `engage_height` to `contact_height`, and the
  tool follows no faster than `force_control.search_speed` allows. The feed-forward of
  the target's motion along z fades out as the force fades in. Where the surface is
  lower or higher than assumed, the target is shifted by the difference, up to
  `search_range`; where there is none, a protective stop reports it. Farther than
  `rest_distance` from its target along the surface the tool is lifted instead. Where joint
  friction is not small compared with the force, enable `force_control` and connect the
  measured force; see `ForceControlConfig` for its gains.
- *Minimal intervention*: `covariance_stiffness` takes K from the covariance of the
  demonstrations, ``k_min + (k_max − k_min) (1 + Σ / σ²)⁻¹``. Choose σ as the
  deviation that a person would not correct.
- *Variable stiffness* (that, or the port `stiffness`) is filtered by
  `stiffness_time_constant`. The energy tank supplies the energy of an increase, and is
  filled by the damping. When it is empty, K may fall but not rise while e is not 0.

Passivity
=========
With a constant target the storage function is ``½ Vᵀ Λ V + ½ eᵀ K e`` plus the tank.
Changes of K draw on the tank only, and the joint-limit springs have dampers. The
remaining term is ``½ Vᵀ Λ̇ V``, because the Coriolis torque is cancelled rather than
shaped. The damping ``Vᵀ D V`` is greater where Λ changes slower than ``2 ζ ω``; this is
measured, not proven. A clipped error with unequal stiffnesses, a torque at its
limits, force control and friction compensation are not covered by this argument.

Safety
======
Torque starts at zero and changes by at most `max_torque_rate`. It is scaled, without a
change of direction, to the plant's limits, also together with the torque that carries
the arm's weight. `JointWallConfig` keeps joints within their ranges and speeds; its
torque is added to the limited task torque, and the sum is clipped joint by joint, so
that the joint limits have priority. `max_effective_mass` bounds Λ near singularities,
where damping and tracking are softer than chosen. `WatchdogConfig` has the conditions of
a protective stop: the arm is held, damped, at its position, and the normal force is
zero. Along the normal it comes to rest in 10 ms, so that a push does not throw it against
the surface. After a stop because of the normal force it retreats by 20 mm. Once the target
is valid again the arm returns to it. Every condition takes effect at the next update and
is reported on the port `status`.

For any inputs, no joint exceeds its speed limit by its own torque: a torque is
applied only where the limited torque rate suffices to end its acceleration in time.
Otherwise the joints are braked until it does, and the status reports it. A joint that a
push or a contact drives above its limit all the same ends in a protective stop, and so
does a normal force that is far above the desired one, or that oscillates. All this
assumes that the measured state is correct.

Friction compensation uses the measured velocity: it cannot help at rest, and with a
gain above 1 the joints run away.

The whole law is computed at every `control_period`. Its pure functions are compiled
when the first controller of any arm is made, which takes seconds once per
computer; the arm's dynamics are Drake's.

References
----------
.. [1] O. Khatib, "A unified approach for motion and force control of robot
   manipulators: the operational space formulation", IEEE J. Robotics and
   Automation 3(1), 1987.
.. [2] A. Albu-Schäffer, C. Ott, U. Frese, G. Hirzinger, "Cartesian impedance
   control of redundant robots: recent results with the DLR-light-weight-arms",
   ICRA 2003.
"""

from collections.abc import Iterable
from functools import partial
from typing import Any, cast

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    InputPort,
    LeafSystem,
)

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, check_number, check_type
from fmp_drake.systems.impedance.algebra import Pose
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.controller_status import STATUS_SIZE, STOP_REASONS
from fmp_drake.systems.impedance.records import (
    PACKED_SIZE,
    PLACES,
    PORTS,
    REQUIRED,
    initial_memory,
    joint_settings,
    settings_of,
)
from fmp_drake.systems.impedance.step import impedance_step, measured_motion
from fmp_drake.systems.interface.arm_model import (
    ArmModel,
    check_limits,
    checked_posture,
    joint_limits,
)
from fmp_drake.systems.interface.callbacks import eval_cache

ENGAGE_HEIGHT = 0.01
"""Default height over the surface below which the normal force acts, m."""


# Groups of the discrete state.
_TORQUE, _STATUS, _MEMORY, _LAST_FAULT = range(4)
_REASONS = int(sum(STOP_REASONS))
# Input ports of the measured pose, velocity and error.
_POSE = ("task_frame",)
_VELOCITY = ("task_frame", "task_frame_velocity")
_ERROR = ("task_frame", "desired_position", "desired_orientation")


class OperationalSpaceImpedanceController(LeafSystem):
    """Controller that moves the end effector E like a damped spring in the task frame T.

    Input ports that must be connected:

    - ``state`` (2n): the arm's ``[q, v]``, rad and rad/s.
    - ``desired_position`` (3): p_TE, m, in T.
    - ``desired_velocity`` (3): of E's origin, m/s, in T.
    - ``desired_acceleration`` (3): of E's origin, m/s², in T.

    Input ports that may stay unconnected:

    - ``feedforward_wrench`` (6): torque and force, Nm and N, in T, to be applied at
      E's origin.
    - ``desired_normal_force`` (1): N, along −z of T, applied where the target is
      near the surface z = 0 of T; up to twice as much returns a lifted tool to the
      surface. Less than 0 counts as 0.
    - ``desired_orientation`` (4): quaternion w, x, y, z of R_TE, of any length and
      sign; without it the configured orientation.
    - ``desired_angular_velocity``, ``desired_angular_acceleration`` (3): of E
      relative to T, in T, rad/s and rad/s².
    - ``task_frame`` (7): quaternion w, x, y, z of R_WT and p_WT in m; without it
      `X_WT`.
    - ``task_frame_velocity`` (6), ``task_frame_acceleration`` (6): V_WT of T's origin
      and its derivative, rotation first, in W: rad/s, m/s, rad/s², m/s². The second
      is used with the first.
    - ``target_time`` (1): time stamp of the target, s of the context's time.
    - ``stiffness`` (36): the rows of K in T, rotations first.
    - ``covariance`` (9): of the desired position, m², in T, if
      ``config.covariance_stiffness`` is enabled.
    - ``normal_force`` (1): measured along −z of T, N, if ``config.force_control`` is
      enabled. The desired force is the sum of ``feedforward_wrench`` and
      ``desired_normal_force``.

    Output ports:

    - ``torque`` (n): Nm, without gravity: disable gravity for the arm in a simulated plant
      (`MultibodyPlant.set_gravity_enabled`), or add the torque that carries its weight, as
      a real arm does. It is discrete state: zero at first, then updated every
      ``config.control_period``, within the plant's effort limits, also together with the
      torque that carries the plant's weight, and the configured rate.
    - ``measured_position`` (3): p_TE, m, in T.
    - ``measured_velocity`` (3): of E's origin relative to T, m/s, in T.
    - ``tracking_error`` (6): from the measured to the desired pose at the inputs, a
      rotation vector in rad and a translation in m, in T.
    - ``status`` (6): of the last update, see `ImpedanceStatus`.
    - ``last_fault`` (1): the flags among `STOP_REASONS` in the latest status that had any;
      0 before the first. A fault may last for one update only; the stop lasts longer.
    - ``measured_pose`` (7): quaternion w, x, y, z of R_TE, and p_TE in m.

    Inputs that are stale, implausible or not finite, or that jump, do not raise an error:
    see `WatchdogConfig`.

    Parameters
    ----------
    plant : MultibodyPlant
        A finalized plant that holds the arm and its tool and nothing else, without
        constraints, and with one actuator for every joint in the joints' order; source of
        the joint limits. Its force elements, such as springs, and the damping of its joints
        are not compensated. An arm of fewer than six joints cannot reach every pose: it
        follows the target as far as its joints allow (`NEAR_SINGULAR`).
    end_effector : Frame
        E, a frame of `plant` that every joint moves.
    X_WT : RigidTransform
        Pose of the task frame in the world.
    config : ImpedanceConfig
        Gains and limits; read once.
    q_posture : array, shape (n,), optional
        Posture of the nullspace, rad. By default the middle of the joints' ranges; zero
        for a joint without limits, and at least 1 rad from the limit of a joint that has
        only one.
    engage_height : float
        Height of the target over `contact_height` below which the desired normal force
        acts, m.
    contact_height : float
        Height of the target over T's plane below which the whole force acts, m.

    Attributes
    ----------
    limits : JointLimits
        Of the arm.

    Raises
    ------
    SystemsError
        If the plant, the configuration, the posture or a height cannot be used.

    Examples
    --------
    >>> from pydrake.math import RigidTransform
    >>> from pydrake.multibody.plant import MultibodyPlant
    >>> from fmp_drake.station import AddRobot, LoadRobot
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> plant = MultibodyPlant(time_step=0.0)
    >>> _ = AddRobot(plant, LoadRobot("panda"))
    >>> plant.Finalize()
    >>> controller = OperationalSpaceImpedanceController(
    ...     plant,
    ...     end_effector=plant.GetFrameByName("eraser_tip"),
    ...     X_WT=RigidTransform([0.55, 0.0, 0.1]),
    ...     config=ImpedanceConfig(damping_ratio=0.8),
    ... )
    >>> controller.GetOutputPort("torque").size()
    7
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        *,
        end_effector: Frame,
        X_WT: RigidTransform,
        config: ImpedanceConfig,
        q_posture: Array | None = None,
        engage_height: float = ENGAGE_HEIGHT,
        contact_height: float = 0.0,
    ) -> None:
        super().__init__()
        self.set_name("operational_space_impedance_controller")
        self._arm = ArmModel(plant, end_effector)
        check_type(X_WT, "X_WT", RigidTransform, error=SystemsError)
        check_type(config, "config", ImpedanceConfig, error=SystemsError)
        self._X_WT = X_WT
        check_number(engage_height, "engage_height", above=0, error=SystemsError)
        check_number(contact_height, "contact_height", least=0, error=SystemsError)
        self._settings = settings_of(
            config,
            X_WT=Pose(X_WT.rotation().matrix().copy(), np.array(X_WT.translation())),
            engage_height=float(engage_height),
            contact_height=float(contact_height),
        )
        check_limits(plant, config.walls.width)
        self.limits = joint_limits(plant)
        joints = joint_settings(
            config,
            limits=self.limits,
            q_posture=checked_posture(plant, q_posture),
        )
        self._declare_inputs(plant.num_velocities())
        self._plant_context = self._arm.declare_context(self)
        self._declare_outputs(plant.num_velocities())
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=config.control_period, offset_sec=0.0, update=self._update
        )
        settings = self._settings.view(np.uint8)
        self._step = partial(impedance_step, settings, joints)
        self._measured_motion = partial(measured_motion, settings)
        # One update compiles the functions before a run.
        n = plant.num_velocities()
        zeros, at_rest = np.zeros(PACKED_SIZE), np.zeros(2 * n)
        plant_context, memory = plant.CreateDefaultContext(), self._initial_memory()
        reading = self._arm.read(plant_context, at_rest)
        self._step(zeros, 0.0, np.zeros(n), memory, *reading)
        self._measured_motion(zeros, *self._arm.motion(plant_context, at_rest))

    def _declare_inputs(self, n: int) -> None:
        self._state = self.DeclareVectorInputPort("state", 2 * n)
        self._ports = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in PORTS.items()
        }
        config = self._settings[0].config
        enabled = {
            "covariance": config.covariance_stiffness.enabled,
            "normal_force": config.force_control.enabled,
        }
        self._used = [name for name in PORTS if enabled.get(name, True)]

    def _declare_outputs(self, n: int) -> None:
        self.DeclareStateOutputPort("torque", self.DeclareDiscreteState(n))
        status = self.DeclareDiscreteState(STATUS_SIZE)
        self.DeclareDiscreteState(self._initial_memory())
        last_fault = self.DeclareDiscreteState(1)
        state, first = self._state.ticket(), 0
        for name, size, inputs in (
            ("measured_position", 3, _POSE),
            ("measured_velocity", 3, _VELOCITY),
            ("tracking_error", 6, _ERROR),
        ):
            calc = partial(self._calc_measured, slice(first, first + size), inputs)
            tickets = {state, *(self._ports[name].ticket() for name in inputs)}
            self.DeclareVectorOutputPort(name, size, calc, tickets)
            first += size
        self.DeclareStateOutputPort("status", status)
        self.DeclareStateOutputPort("last_fault", last_fault)
        tickets = {state, self._ports["task_frame"].ticket()}
        self.DeclareVectorOutputPort(
            "measured_pose", 7, self._calc_measured_pose, tickets
        )

    def _initial_memory(self) -> Array:
        settings = self._settings[0]
        energy = float(settings.config.tank.initial_energy)
        return initial_memory(settings.stiffness, tank_energy=energy)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        discrete = context.get_discrete_state()
        torque, status, memory = self._step(
            self._pack(context, self._used),
            context.get_time(),
            discrete.value(_TORQUE),
            discrete.value(_MEMORY),
            *self._arm.read(*self._arm_state(context)),
        )
        values.set_value(_TORQUE, torque)
        values.set_value(_STATUS, status)
        values.set_value(_MEMORY, memory)
        if fault := int(status[0]) & _REASONS:
            values.set_value(_LAST_FAULT, np.array([float(fault)]))

    def _arm_state(self, context: Context) -> tuple[Context, Array]:
        """Return the arguments of the methods of `ArmModel`."""
        plant_context = eval_cache(self, self._plant_context, context)
        return plant_context, _eval(self._state, context)

    def _pack(self, context: Context, names: Iterable[str]) -> Array:
        """Return an array for `unpack` with the values of some ports."""
        values = np.zeros(PACKED_SIZE)
        for name in names:
            port = self._ports[name]
            if name in REQUIRED or port.HasValue(context):
                place, flag = PLACES[name]
                values[place] = _eval(port, context)
                values[flag] = 1.0
        return values

    # Measured outputs are computed on demand.

    def _calc_measured(
        self, part: slice, names: Iterable[str], context: Context, output: BasicVector
    ) -> None:
        """Set a part of `measured_motion` with the values of some ports."""
        measured = self._measured_motion(
            self._pack(context, names),
            *self._arm.motion(*self._arm_state(context)),
        )
        output.SetFromVector(measured[part])

    def _calc_measured_pose(self, context: Context, output: BasicVector) -> None:
        X_WE, _ = self._arm.motion(*self._arm_state(context))
        if not np.all(np.isfinite(X_WE)):
            output.SetFromVector(np.full(7, np.nan))
            return
        X_WT, frame = self._X_WT, self._ports["task_frame"]
        if frame.HasValue(context):
            pose = _eval(frame, context)
            length = np.linalg.norm(pose[:4])
            # Without a finite frame it is the assumed one, as for the law.
            if np.isfinite(np.sum(pose)) and length > 0:
                X_WT = RigidTransform(Quaternion(pose[:4] / length), pose[4:])
        R_WE = RotationMatrix.ProjectToRotationMatrix(X_WE[:3].T)
        X_TE = X_WT.inverse() @ RigidTransform(R_WE, X_WE[3])
        wxyz = X_TE.rotation().ToQuaternion().wxyz()
        output.SetFromVector(np.concatenate([wxyz, X_TE.translation()]))


def _eval(port: InputPort, context: Context) -> Array:
    """Return the values at a vector port, without copying them."""
    try:
        return cast(BasicVector, port.EvalBasicVector(context)).value()
    except RuntimeError as error:
        if port.HasValue(context):
            raise
        system: Any = port.get_system()
        raise SystemsError(
            f"Input port {port.get_name()} of {system.GetSystemPathname()} "
            "has no value; connect it, or fix its value in the context."
        ) from error
