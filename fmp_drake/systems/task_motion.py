"""Conversion between the channels of a skill and the ports of an impedance controller."""

from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_type
from fmp_drake.primitives.data.channels import ChannelRoles
from fmp_drake.systems.surface.surface import (
    Surface,
    ToolChannels,
    desired_motion,
    measured_channels,
)

POSITION = {"desired_position": 3, "desired_velocity": 3, "desired_acceleration": 3}
ROTATION = {
    "desired_orientation": 4,
    "desired_angular_velocity": 3,
    "desired_angular_acceleration": 3,
}
FORCE = {"desired_normal_force": 1}
FRAME = {"task_frame": 7, "task_frame_velocity": 6, "task_frame_acceleration": 6}
DESIRED = POSITION | ROTATION | FORCE | FRAME
"""Inputs of the impedance controller that follow from the motion, with their sizes."""


class TaskMotion(LeafSystem):
    """Conversion of a skill's channels to a controller's inputs, and of poses to channels.

    On a plane the task frame T is the frame S of the surface, and the channels x, y, z are
    p_TE. On a curved surface they are (u, v, h), see `Surface`: T moves with the target over
    the surface, z of T is the local normal, and the target is at the height h over T's
    origin. Rotation channels are the orientation R_TE, so that they follow the normal.

    There is no state. All inputs of the controller come from one port, because calling
    Python takes longer than computing them. A `Demultiplexer` with the sizes in `parts`
    splits them.

    Input ports
    -----------
    motion : (3 D,)
        Channels of the skill and their first and second time derivatives.
    measured_pose : (7,)
        Quaternion (w, x, y, z) of R_TE, and p_TE in m.
    normal_force : (1,)
        Measured, N; only where the skill has a force channel.
    surface_frame, surface_frame_velocity, surface_frame_acceleration : (7,), (6,), (6,)
        Quaternion (w, x, y, z) of R_WS and p_WS in m; V_WS and its time derivative, rotation
        first. Only where `is_moving`; S is otherwise fixed at `X_WS`.

    Output ports
    ------------
    desired : (n,)
        The `parts`, one after the other:

        - desired_position, desired_velocity, desired_acceleration (3,): of E in T; m,
          m/s, m/s^2;
        - desired_orientation (4,): quaternion (w, x, y, z) of R_TE. This and the next two
          only with rotation channels;
        - desired_angular_velocity, desired_angular_acceleration (3,): of E relative to T,
          in T; rad/s, rad/s^2;
        - desired_normal_force (1,): N, not negative; only with a force channel;
        - task_frame (7,): quaternion (w, x, y, z) of R_WT and p_WT in m. This and the next
          two only on a curved or moving surface;
        - task_frame_velocity, task_frame_acceleration (6,): V_WT and its time derivative
          in W, rotation first.
    measured : (D,)
        Measured values of the skill's channels.

    Parameters
    ----------
    roles : ChannelRoles
    surface : Surface
    X_WS : RigidTransform
        Pose of the surface in the world.
    is_moving : bool
        Whether the frame of the surface is an input.

    Attributes
    ----------
    parts : dict of str to int
        Names of the controller's inputs at the port desired, in their order, and sizes.

    Raises
    ------
    SystemsError
        Where the curvatures are neither those of a plane, a cylinder nor a sphere.

    Examples
    --------
    >>> from fmp_drake.primitives.data.channels import channel_roles
    >>> roles = channel_roles(["x", "y", "z"], ["m", "m", "m"])
    >>> pipe = TaskMotion(roles, Surface(0.0, 4.0), X_WS=RigidTransform())
    >>> context = pipe.CreateDefaultContext()
    >>> _ = pipe.GetInputPort("motion").FixValue(context, [0.1, 0.0, 0.02, *[0.0] * 6])
    >>> [*pipe.parts.items()][-3:]
    [('task_frame', 7), ('task_frame_velocity', 6), ('task_frame_acceleration', 6)]
    >>> pipe.GetOutputPort("desired").Eval(context)[9:16]
    array([1. , 0. , 0. , 0. , 0.1, 0. , 0. ])
    """

    def __init__(
        self,
        roles: ChannelRoles,
        surface: Surface,
        *,
        X_WS: RigidTransform,
        is_moving: bool = False,
    ) -> None:
        super().__init__()
        self.set_name("task_motion")
        check_type(roles, "roles", ChannelRoles, error=SystemsError)
        check_type(surface, "surface", Surface, error=SystemsError)
        check_type(X_WS, "X_WS", RigidTransform, error=SystemsError)
        kx, ky = surface
        if not np.all(np.isfinite(surface)) or (kx and ky and kx != ky):
            raise SystemsError(
                f"the curvatures of the surface are {kx} and {ky} 1/m; expected one to be "
                "0 (a cylinder), both (a plane), or both equal (a sphere)."
            )
        self._roles, self._surface = roles, surface
        x, y, z, w = roles.reference or (0.0, 0.0, 0.0, 1.0)
        self._channels = ToolChannels(
            np.array(roles.position),
            np.array(roles.rotation or (), dtype=np.int64),
            -1 if roles.force is None else roles.force,
            np.array([w, x, y, z]),
        )
        R_WS = X_WS.rotation()
        self._fixed_frame = np.zeros(28)
        self._fixed_frame[:9] = R_WS.matrix().ravel()
        self._fixed_frame[9:12] = X_WS.translation()
        self._fixed_frame[24:] = R_WS.ToQuaternion().wxyz()
        self._declare_inputs(is_moving)
        self._declare_outputs(is_moving)

    def _declare_inputs(self, is_moving: bool) -> None:
        declare = self.DeclareVectorInputPort
        self._motion = declare("motion", 3 * self._roles.count)
        self._pose = declare("measured_pose", 7)
        self._force = None if self._roles.force is None else declare("normal_force", 1)
        self._frame = [
            declare(name.replace("task", "surface"), size)
            for name, size in (FRAME if is_moving else {}).items()
        ]

    def _declare_outputs(self, is_moving: bool) -> None:
        self.parts = POSITION.copy()
        if self._roles.rotation is not None:
            self.parts |= ROTATION
        if self._roles.force is not None:
            self.parts |= FORCE
        if is_moving or not self._surface.is_plane:
            self.parts |= FRAME
        self._is_used = np.repeat(
            [name in self.parts for name in DESIRED], [*DESIRED.values()]
        )
        declare, size = self.DeclareVectorOutputPort, sum(self.parts.values())
        tickets = {port.ticket() for port in (self._motion, *self._frame)}
        declare("desired", size, self._calc_desired, tickets)
        tickets = {self._motion.ticket(), self._pose.ticket()}
        if self._force is not None:
            tickets.add(self._force.ticket())
        declare("measured", self._roles.count, self._calc_measured, tickets)

    def _calc_desired(self, context: Context, output: BasicVector) -> None:
        frame = self._fixed_frame
        if self._frame:
            pose, velocity, acceleration = (
                np.array(port.Eval(context)) for port in self._frame
            )
            q_WS = pose[:4] / np.linalg.norm(pose[:4])
            R_WS = RotationMatrix(Quaternion(q_WS))
            frame = np.concatenate(
                [R_WS.matrix().ravel(), pose[4:], velocity, acceleration, q_WS]
            )
        motion: Any = self._motion.Eval(context)
        desired = desired_motion(self._channels, self._surface, frame, motion)
        output.SetFromVector(desired[self._is_used])

    def _calc_measured(self, context: Context, output: BasicVector) -> None:
        motion: Any = self._motion.Eval(context)
        pose: Any = self._pose.Eval(context)
        force: Any = [0.0] if self._force is None else self._force.Eval(context)
        output.SetFromVector(
            measured_channels(
                self._channels,
                self._surface,
                motion[: self._roles.count].copy(),
                pose,
                float(force[0]),
            )
        )
