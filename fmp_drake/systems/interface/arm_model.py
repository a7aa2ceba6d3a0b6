"""Kinematics and dynamics of an arm, as a plant computes them."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable, Joint
from pydrake.systems.framework import CacheIndex, Context, LeafSystem, ValueProducer

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, as_floats, check_type
from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.interface.callbacks import check_frame

# Distance of the default posture from the limit of a joint that has one only, rad.
_FROM_LIMIT = 1.0
# Ranges of a revolute joint that are degrees: from 10 revolutions on, rad. Files without
# limits have larger numbers, such as 1e3 or 1e16 on both sides.
_DEGREES = 20 * np.pi, 1500.0

type _Arguments = tuple[bool, Array, Array, Array, Array, Array, Array, Array]


class ArmModel:
    """Kinematics and dynamics of an arm, computed by its plant; has no state.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized; the arm and its tool, nothing else.
    end_effector : Frame
        E, moved by every joint.

    Raises
    ------
    SystemsError
        Where the plant is not one fully actuated arm without constraints.
    """

    def __init__(self, plant: MultibodyPlant, end_effector: Frame) -> None:
        _check_plant(plant, end_effector)
        self._plant = plant
        self._end_effector = end_effector
        world, origin = plant.world_frame(), np.zeros(3)
        # Arguments for the Jacobian of V_WE, expressed in W, with respect to v.
        self._of_E = JacobianWrtVariable.kV, end_effector, origin, world, world

    def declare_context(self, system: LeafSystem) -> CacheIndex:
        """Declare a Context of the plant that a system overwrites at every use."""
        plant = self._plant
        return system.DeclareCacheEntry(
            "plant context, overwritten at every use",
            ValueProducer(
                allocate=lambda: AbstractValue.Make(plant.CreateDefaultContext()),
                calc=lambda _context, _value: None,
            ),
            prerequisites_of_calc={system.nothing_ticket()},
        ).cache_index()

    def read(self, plant_context: Context, state: Array) -> _Arguments:
        """Return the kinematics and dynamics for `impedance_step`, as its arguments.

        Parameters
        ----------
        plant_context : Context
            Of the plant; overwritten.
        state : array, shape (2n,)
            ``[q, v]``, rad and rad/s.
        """
        plant = self._plant
        is_finite = _is_finite(state)
        if not is_finite:
            state = np.zeros_like(state)
        plant.SetPositionsAndVelocities(plant_context, state)
        X_WE = self._end_effector.CalcPoseInWorld(plant_context).GetAsMatrix34()
        A_WE_bias = plant.CalcBiasSpatialAcceleration(plant_context, *self._of_E)
        # Drake's matrices are stored by columns; their transposes by rows.
        return (
            is_finite,
            state,
            plant.CalcMassMatrix(plant_context).T,
            plant.CalcBiasTerm(plant_context),
            X_WE.T,
            plant.CalcJacobianSpatialVelocity(plant_context, *self._of_E).T,
            A_WE_bias.get_coeffs(),
            plant.CalcGravityGeneralizedForces(plant_context),
        )

    def jacobian(self, plant_context: Context, state: Array) -> Array:
        """Return J of V_WE, shape (6, n), at a finite state, shape (2n,)."""
        self._plant.SetPositionsAndVelocities(plant_context, state)
        return self._plant.CalcJacobianSpatialVelocity(plant_context, *self._of_E)

    def motion(self, plant_context: Context, state: Array) -> tuple[Array, Array]:
        """Return the arguments of `measured_motion`: transposed X_WE (4, 3), V_WE (6,).

        Both are NaN where the state, shape (2n,), is not finite.
        """
        if not _is_finite(state):
            return np.full((4, 3), np.nan), np.full(6, np.nan)
        self._plant.SetPositionsAndVelocities(plant_context, state)
        X_WE = self._end_effector.CalcPoseInWorld(plant_context)
        V_WE = self._end_effector.CalcSpatialVelocityInWorld(plant_context)
        return X_WE.GetAsMatrix34().T, V_WE.get_coeffs()


def _is_finite(state: Array) -> bool:
    """Return whether a state is finite, and its squares are far from an overflow."""
    return bool(state.dot(state) < 1e24)


def joint_limits(plant: MultibodyPlant) -> JointLimits:
    """Return the limits of an arm."""
    return JointLimits.between(
        plant.GetPositionLowerLimits(),
        plant.GetPositionUpperLimits(),
        speed=np.minimum(
            plant.GetVelocityUpperLimits(), -plant.GetVelocityLowerLimits()
        ),
        lower_effort=plant.GetEffortLowerLimits(),
        upper_effort=plant.GetEffortUpperLimits(),
    )


def check_limits(plant: MultibodyPlant, wall_width: float) -> None:
    """Raise an error for a joint whose limits leave no motion, or are in degrees.

    The springs at both of its limits would meet, or it may not move in one direction.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized.
    wall_width : float
        Width of a spring at a joint limit, rad or m.
    """
    for joint in _moving_joints(plant):
        unit = "m" if joint.type_name() == "prismatic" else "rad"
        (low,), (high,) = joint.position_lower_limits(), joint.position_upper_limits()
        if not high - low > 2 * wall_width:
            raise SystemsError(
                f"{joint.name()} has the limits {low:g} and {high:g} {unit}; they must be "
                f"more than {2 * wall_width:g} {unit} apart, because a spring of "
                f"walls.width = {wall_width:g} acts at each. Correct the limits, choose "
                "narrower springs, or weld the joint."
            )
        if unit == "rad" and _DEGREES[0] < high - low < _DEGREES[1]:
            raise SystemsError(
                f"{joint.name()} has the limits {low:g} and {high:g} rad, more than 10 "
                "revolutions; give them in rad, not degrees. A joint that turns without end "
                'has no limits (type="continuous" in a URDF).'
            )
        (low,), (high,) = joint.velocity_lower_limits(), joint.velocity_upper_limits()
        if not low < 0 < high:
            raise SystemsError(
                f"{joint.name()} has the velocity limits {low + 0:g} and {high:g} {unit}/s; "
                "expected a negative and a positive one. Correct the model."
            )


def joint_damping(plant: MultibodyPlant) -> Array:
    """Return the viscous damping of an arm's joints, shape (n,), Nm s/rad."""
    joints = _moving_joints(plant)
    return np.concatenate([joint.default_damping_vector() for joint in joints])


def _moving_joints(plant: MultibodyPlant) -> list[Joint]:
    """Return the joints of a plant that can move, in the order of its velocities."""
    joints = [plant.get_joint(i) for i in plant.GetJointIndices()]
    joints = [joint for joint in joints if joint.num_velocities()]
    return sorted(joints, key=lambda joint: joint.velocity_start())


def _check_plant(plant: MultibodyPlant, end_effector: Frame) -> None:
    """Raise an error for a plant that is not one fully actuated arm with an end effector."""
    check_type(plant, "plant", MultibodyPlant, error=SystemsError)
    if not plant.is_finalized():
        raise SystemsError("The controller's plant must be finalized first.")
    n = plant.num_velocities()
    if n == 0 or plant.num_positions() != n:
        raise SystemsError(
            "The controller's plant must hold an arm on a fixed base: "
            f"{plant.num_positions()} positions and {n} velocities, not equal numbers "
            "above 0."
        )
    joints = _moving_joints(plant)
    if plant.num_actuators() != n or not np.array_equal(
        plant.MakeActuationMatrix(), np.eye(n)
    ):
        indices = plant.GetJointActuatorIndices()
        actuated = [plant.get_joint_actuator(i).joint().name() for i in indices]
        listed = ""
        if actuated:
            listed = (
                f": {', '.join(actuated)}. Write the transmissions in the order of the "
                "joints, and in an SDF file the joints from the base to the tool"
            )
        raise SystemsError(
            f"The controller's plant must have one actuator for each of its {n} joints, "
            f"in their order {', '.join(joint.name() for joint in joints)}; it has "
            f"{len(actuated)}{listed}."
        )
    if plant.num_constraints():
        raise SystemsError(
            f"The controller's plant has constraints ({plant.num_constraints()}), such as "
            "those of mimic joints, which its dynamics leave out; it must have none."
        )
    check_frame(end_effector, "end_effector", plant, error=SystemsError)
    body = end_effector.body().index()
    for joint in joints:
        if body not in plant.GetBodiesKinematicallyAffectedBy([joint.index()]):
            raise SystemsError(
                f"{joint.name()} does not move end_effector {end_effector.name()}; the "
                "controller's plant must hold one arm and its tool, and nothing else that "
                "moves."
            )


def checked_posture(plant: MultibodyPlant, q_posture: Array | None) -> Array:
    """Return a copy of the posture in rad, or the middle of the joints' ranges."""
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    if q_posture is None:
        is_bounded = np.isfinite(lower) & np.isfinite(upper)
        near_zero = np.clip(0.0, lower + _FROM_LIMIT, upper - _FROM_LIMIT)
        return np.where(is_bounded, joint_limits(plant).middle, near_zero)
    q = np.array(as_floats(q_posture, "q_posture", error=SystemsError))
    if q.shape != lower.shape or not np.all((lower <= q) & (q <= upper)):
        raise SystemsError(
            f"q_posture must be {lower.size} angles between {lower} and {upper} rad, "
            f"got {q}"
        )
    return q
