"""Model of the hand of a person who guides the arm."""

from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array
from fmp_drake.primitives.data.channels import (
    FORCE_CHANNEL,
    POSITION_CHANNELS,
    ROTATION_CHANNELS,
)
from fmp_drake.primitives.data.orientation import angular_velocity
from fmp_drake.systems.interface.callbacks import (
    declare_bodies,
    declare_spatial_forces,
    spatial_force,
)
from fmp_drake.systems.surface import surface as surfaces
from fmp_drake.systems.surface.surface import PLANE, Surface
from fmp_drake.systems.teaching.hand_motion import HandMotion

# The hand: stiffness in the plane of the board (N/m), damping in every direction (N
# s/m), normal force (N), stiffness (Nm/rad) and damping (Nm s/rad) of rotation.
STIFFNESS, DAMPING, NORMAL_FORCE = 1500.0, 120.0, 9.0
ROTATIONAL_STIFFNESS, ROTATIONAL_DAMPING = 60.0, 6.0


class HumanHand(LeafSystem):
    """Simulated kinesthetic teaching: a spring to a moving target, and a normal force.

    For a motion with a height the spring also acts along the normal, and there is no
    normal force. Rotation channels of a motion are the orientation of the tool, and a
    force channel is the normal force.

    Input ports
    -----------
    body_poses, body_spatial_velocities : abstract
        The plant's ports of the same names.

    Output ports
    ------------
    spatial_forces : abstract
        For the plant's applied_spatial_force port: the hand's wrench at the grip.
    position : (3,)
        p_BE, the grip in the frame of the board, m.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized.
    grip : Frame
        E, the frame of the grasp.
    X_WB : RigidTransform
        Pose of the board, z outward.
    motion : HandMotion
        Target of the hand: position, and optionally orientation and force of the tool. Over
        a curved board it has x and y, or these and a force.
    R_BE : RotationMatrix
        Orientation of the tool where the motion has none; relative to the local normal of a
        curved board.
    surface : Surface
        Curvature of the board, over which the hand slides.

    Raises
    ------
    SystemsError
        Where the plant is not finalized, or the motion is not one over the surface.

    Examples
    --------
    >>> from pydrake.systems.framework import DiagramBuilder
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> tool = plant.AddRigidBody("tool")
    >>> plant.Finalize()
    >>> builder = DiagramBuilder()
    >>> _ = builder.AddSystem(plant)
    >>> hand = HumanHand(
    ...     plant,
    ...     grip=tool.body_frame(),
    ...     X_WB=RigidTransform([0.5, 0.0, 0.0]),
    ...     motion=HandMotion.make("wiping", duration=5.0, seed=0),
    ...     R_BE=RotationMatrix(),
    ... )
    >>> _ = builder.AddSystem(hand)
    >>> for name in ("body_poses", "body_spatial_velocities"):
    ...     builder.Connect(plant.GetOutputPort(name), hand.GetInputPort(name))
    >>> builder.Connect(
    ...     hand.GetOutputPort("spatial_forces"),
    ...     plant.GetInputPort("applied_spatial_force"),
    ... )
    >>> diagram = builder.Build()
    >>> context = diagram.CreateDefaultContext()
    >>> hand.GetOutputPort("position").Eval(hand.GetMyContextFromRoot(context))
    array([-0.5,  0. ,  0. ])
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        *,
        grip: Frame,
        X_WB: RigidTransform,
        motion: HandMotion,
        R_BE: RotationMatrix,
        surface: Surface = PLANE,
    ) -> None:
        super().__init__()
        self.set_name("human_hand")
        if not plant.is_finalized():
            raise SystemsError("the plant is not finalized; call Finalize() first.")
        self._motion = motion
        self._X_WB = X_WB
        self._X_BW = X_WB.inverse()
        self._R_WE = X_WB.rotation() @ R_BE
        self._R_TE, self._surface = R_BE, surface
        index = motion.channels.index
        names = [n for n in POSITION_CHANNELS if n in motion.channels]
        self._position = [index(name) for name in names]
        self._rotation = [index(n) for n in ROTATION_CHANNELS if n in motion.channels]
        has_force = FORCE_CHANNEL in motion.channels
        self._force = index(FORCE_CHANNEL) if has_force else None
        if not surface.is_plane and (len(names) != 2 or self._rotation):
            raise SystemsError(
                f"the motion has the channels {', '.join(motion.channels)}; over a curved "
                "board the hand follows x and y with an optional force."
            )
        self._body = int(grip.body().index())
        self._X_LE = grip.GetFixedPoseInBodyFrame()
        self._poses, self._velocities = declare_bodies(self)
        poses, velocities = self._poses.ticket(), self._velocities.ticket()
        prerequisites = {poses, velocities, self.time_ticket()}
        declare_spatial_forces(self, self._calc_forces, prerequisites)
        self.DeclareVectorOutputPort("position", 3, self._calc_position, {poses})

    def _grip_pose(self, context: Context) -> RigidTransform:
        poses: Any = self._poses.Eval(context)
        return poses[self._body] @ self._X_LE

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        p_WE: Any = self._grip_pose(context).translation()
        output.SetFromVector(self._X_BW.multiply(p_WE))

    def _to_tangent(self, p_BE: Array, target: Array) -> tuple[RotationMatrix, Array]:
        """Return R_BT at the grip, and the offset to the target (u, v) in its plane, m."""
        u, v, h = surfaces.project(self._surface, p_BE, target)
        R_BT = RotationMatrix(surfaces.rotation(self._surface, u, v))
        goal = surfaces.place(self._surface, np.array([[*target, h]]))[0]
        offset: Array = R_BT.matrix().T @ (goal - p_BE)
        return R_BT, offset[:2]

    def _calc_forces(self, context: Any, output: Any) -> None:
        X_WE = self._grip_pose(context)
        velocities: Any = self._velocities.Eval(context)
        R_WL = X_WE.rotation() @ self._X_LE.rotation().inverse()
        V_WE = velocities[self._body].Shift(R_WL @ self._X_LE.translation())
        R_BW = self._X_BW.rotation()
        p_WE: Any = X_WE.translation()
        p_BE = self._X_BW.multiply(p_WE)
        values, rates = self._motion.at(context.get_time())
        target, target_velocity = values[self._position], rates[self._position]
        n = len(target)
        R_WE, w_WE = self._R_WE, V_WE.rotational()
        if self._rotation:
            phi, rate = values[self._rotation], rates[self._rotation]
            R_BR = RotationMatrix(Rotation.from_rotvec(phi).as_matrix())
            R_WE = self._X_WB.rotation() @ R_BR @ self._R_TE
            w_WE = w_WE - self._X_WB.rotation().matrix() @ angular_velocity(phi, rate)
        elif not self._surface.is_plane:
            R_BT, offset = self._to_tangent(p_BE, target)
            R_WB = self._X_WB.rotation()
            R_WE = R_WB @ R_BT @ self._R_TE
            _, _, V_BT, _ = surfaces.moving_frame(
                self._surface, target, target_velocity, np.zeros(2)
            )
            w_WE = w_WE - R_WB.matrix() @ V_BT[:3]
            # The frame below is T, which is B on a plane.
            R_BW, target, p_BE = R_BT.inverse() @ R_BW, offset, np.zeros(3)
            target_velocity = (R_BT.matrix().T @ V_BT[3:])[:2]
        f_B = -DAMPING * (R_BW @ V_WE.translational())
        f_B[:n] += STIFFNESS * (target - p_BE[:n])
        f_B[:n] += DAMPING * target_velocity
        if n == 2:
            force = NORMAL_FORCE if self._force is None else values[self._force]
            f_B[2] -= max(force, 0.0)
        tau_W = hand_torque(R_WE @ X_WE.rotation().inverse(), w_WE)
        p_LE, f_W = self._X_LE.translation(), R_BW.inverse() @ f_B
        output.set_value([spatial_force(self._body, p_LE, tau_W, f_W)])


def hand_torque(
    R: RotationMatrix, angular_velocity: Array, most: float = np.inf
) -> Array:
    """Return the torque (3,) of a hand that turns a tool, in W, Nm.

    Parameters
    ----------
    R : RotationMatrix
        From the orientation of the tool to its target, in W.
    angular_velocity : ndarray, shape (3,)
        Of the tool relative to its target, in W, rad/s.
    most : float
        Greatest torque, Nm.
    """
    rotation = R.ToAngleAxis()
    torque = ROTATIONAL_STIFFNESS * rotation.angle() * rotation.axis()
    torque -= ROTATIONAL_DAMPING * angular_velocity
    return torque * min(1.0, most / max(float(np.linalg.norm(torque)), 1e-12))
