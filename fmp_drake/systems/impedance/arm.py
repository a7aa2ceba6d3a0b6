"""What the impedance controller knows of its arm: kinematics, dynamics, limits."""

import copy

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.framework import Context

from fmp_drake.errors import StationError
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.friction import SigmoidFriction
from fmp_drake.systems.impedance.hold import ModelHold
from fmp_drake.systems.impedance.law import ArmDynamics
from fmp_drake.systems.impedance.step import StepSettings
from fmp_drake.systems.impedance.walls import JointLimits

Array = NDArray[np.float64]


class ArmKinematics:
    """The scratch plant context and what was read from it for the present state."""

    __slots__ = (
        "J",
        "R_TE",
        "R_WT",
        "finite",
        "frame_finite",
        "p_TE",
        "p_WT",
        "plant_context",
        "q",
        "turn",
        "v",
    )

    def __init__(self, plant_context: Context) -> None:
        self.plant_context = plant_context
        self.finite: bool
        self.frame_finite: bool
        self.q: Array
        self.v: Array
        self.R_WT: Array
        self.p_WT: Array
        self.R_TE: Array
        self.p_TE: Array
        self.turn: Array  # From twists in W's axes to twists in T's.
        self.J: Array


class ArmModel:
    """Computes the arm's kinematics and dynamics by Drake; holds no values.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized; the arm and its tool, nothing else.
    end_effector : Frame
        E.

    Raises
    ------
    StationError
        Where the plant is not one fully actuated arm.
    """

    def __init__(self, plant: MultibodyPlant, end_effector: Frame) -> None:
        _check_plant(plant)
        self._plant = plant
        self._end_effector = end_effector
        self._world = plant.world_frame()
        self._origin = np.zeros(3)

    def allocate(self) -> ArmKinematics:
        """Return one with a plant context of its own."""
        return ArmKinematics(self._plant.CreateDefaultContext())

    def read(self, arm: ArmKinematics, state: Array) -> None:
        """Fill in q, v, R_TE, p_TE and J at a state, shape (2n,).

        R_WT, p_WT and turn must be there. Where the state is not finite the rest
        is NaN.
        """
        n = state.size // 2
        arm.q = state[:n]
        arm.v = state[n:]
        arm.finite = is_finite(state)
        if not arm.finite:
            arm.R_TE = np.full((3, 3), np.nan)
            arm.p_TE = np.full(3, np.nan)
            arm.J = np.full((6, n), np.nan)
            return
        self._plant.SetPositionsAndVelocities(arm.plant_context, state)
        X_WE = self._end_effector.CalcPoseInWorld(arm.plant_context).GetAsMatrix34()
        J_WE = self._plant.CalcJacobianSpatialVelocity(
            arm.plant_context,
            JacobianWrtVariable.kV,
            self._end_effector,
            self._origin,
            self._world,
            self._world,
        )
        R_TW = arm.R_WT.T
        arm.R_TE = R_TW.dot(X_WE[:, :3])
        arm.p_TE = R_TW.dot(X_WE[:, 3] - arm.p_WT)
        arm.J = arm.turn.dot(J_WE)

    def dynamics(self, arm: ArmKinematics) -> ArmDynamics:
        """Return the equation of motion at the state that was read, finite."""
        plant, plant_context = self._plant, arm.plant_context
        A_WE_bias = plant.CalcBiasSpatialAcceleration(
            plant_context,
            JacobianWrtVariable.kV,
            self._end_effector,
            self._origin,
            self._world,
            self._world,
        )
        return ArmDynamics(
            arm.v,
            plant.CalcMassMatrix(plant_context),
            plant.CalcBiasTerm(plant_context),
            arm.J,
            arm.turn.dot(A_WE_bias.get_coeffs()),
        )


def is_finite(vector: Array) -> bool:
    """Tell whether all elements are finite, and far from an overflow."""
    return sum(map(abs, vector.tolist())) < 1e12


def twist_turn(R: Array) -> Array:
    """Return the matrix, shape (6, 6), that turns both halves of a twist."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R
    return turn


def step_settings(
    plant: MultibodyPlant,
    config: ImpedanceConfig,
    q_posture: NDArray[np.float64] | None,
) -> StepSettings:
    """Check and copy what the updates need.

    Raises
    ------
    StationError
        If the configuration or the posture cannot be used.
    """
    gains = config.gains()
    config = copy.deepcopy(config)
    friction = None
    if config.friction_compensation.enabled:
        friction = SigmoidFriction.of(
            config.friction_compensation, n=plant.num_velocities()
        )
    lower, upper = plant.GetEffortLowerLimits(), plant.GetEffortUpperLimits()
    return StepSettings(
        config=config,
        gains=gains,
        limits=JointLimits.between(
            plant.GetPositionLowerLimits(),
            plant.GetPositionUpperLimits(),
            speed=np.minimum(
                plant.GetVelocityUpperLimits(), -plant.GetVelocityLowerLimits()
            ),
            effort=np.minimum(upper, -lower),
        ),
        lower=lower,
        upper=upper,
        q_posture=_checked_posture(plant, q_posture),
        friction=friction,
        hold=ModelHold(
            lower=lower,
            upper=upper,
            max_change=config.max_torque_rate * config.control_period,
            control_period=config.control_period,
            model_period=config.model_period,
            friction=friction,
        ),
    )


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
