"""Conversion from the channels of a skill to the motion of a tool over a surface, and back.

S is the frame of the surface, T the task frame: on a plane T is S, on a curved surface T
moves with the target and its z is the local normal. E is the end effector.
"""

import math
from typing import NamedTuple

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array, Indices
from fmp_drake.systems.surface.surface import (
    Surface,
    angular_motion,
    cross,
    moving_frame,
    point,
    project,
    quaternion,
    quaternion_product,
    rotation,
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


class ToolChannels(NamedTuple):
    """Channel roles for compiled functions.

    Attributes
    ----------
    position : array of int, shape (3,)
    rotation : array of int, shape (3,) or (0,)
        Empty where the skill has no rotation.
    force : int
        -1 where the skill has no force.
    reference : array, shape (4,)
        Quaternion (w, x, y, z) of the reference orientation.
    """

    position: Indices
    rotation: Indices
    force: int
    reference: Array


@compiled
def desired_motion(
    channels: ToolChannels, surface: Surface, frame: Array, motion: Array
) -> Array:
    """Return all inputs of the controller, one after the other in the order of `DESIRED`.

    Parameters
    ----------
    channels : ToolChannels
    surface : Surface
    frame : array, shape (28,)
        The surface in the world: R_WS row by row, p_WS, V_WS and its time derivative
        (rotation first), m and rad with s; and the quaternion (w, x, y, z) of R_WS.
    motion : array, shape (3 D,)
        Channels of a skill, then their first and second time derivatives.

    Returns
    -------
    array, shape (39,)
        In T; the last three in W.
    """
    d = len(motion) // 3
    y, dy, ddy = motion[:d], motion[d : 2 * d], motion[2 * d :]
    out = np.zeros(39)
    p, v, a = y[channels.position], dy[channels.position], ddy[channels.position]
    is_plane = surface.kx == 0 and surface.ky == 0
    # On a curved surface the target is at the height h over the origin of T.
    first = 0 if is_plane else 2
    out[first:3], out[3 + first : 6] = p[first:], v[first:]
    out[6 + first : 9] = a[first:]
    out[9:13] = channels.reference
    if len(channels.rotation):
        phi = y[channels.rotation]
        out[9:13] = quaternion_product(quaternion(phi), channels.reference)
        out[13:16], out[16:19] = angular_motion(
            phi, dy[channels.rotation], ddy[channels.rotation]
        )
    if channels.force >= 0:
        out[19] = max(y[channels.force], 0.0)
    R_WS, p_WS = frame[:9].copy().reshape(3, 3), frame[9:12]
    V_WS, A_WS, q_WS = frame[12:18], frame[18:24], frame[24:]
    if is_plane:
        out[20:24], out[24:27] = q_WS, p_WS
        out[27:33], out[33:] = V_WS, A_WS
        return out
    _, p_ST, V_ST, A_ST = moving_frame(surface, p[:2], v[:2], a[:2])
    arm = R_WS @ p_ST
    turn, moved = R_WS @ V_ST[:3], R_WS @ V_ST[3:]
    w = V_WS[:3]
    out[20:24] = quaternion_product(q_WS, _orientation(surface, p))
    out[24:27] = p_WS + arm
    out[27:30] = w + turn
    out[30:33] = V_WS[3:] + cross(w, arm) + moved
    out[33:36] = A_WS[:3] + R_WS @ A_ST[:3] + cross(w, turn)
    out[36:] = (
        A_WS[3:]
        + cross(A_WS[:3], arm)
        + cross(w, cross(w, arm))
        + 2 * cross(w, moved)
        + R_WS @ A_ST[3:]
    )
    return out


@compiled
def measured_channels(
    channels: ToolChannels,
    surface: Surface,
    desired: Array,
    pose: Array,
    force: float,
) -> Array:
    """Return the measured channels of a skill, from the robot's state.

    Parameters
    ----------
    channels : ToolChannels
    surface : Surface
    desired : array, shape (D,)
        Channels of the skill at the same time: measured angles are unwrapped to the
        nearest branch.
    pose : array, shape (7,)
        Quaternion (w, x, y, z) of R_TE, and p_TE in m, with T at the desired position.
    force : float
        Measured normal force, N.
    """
    out = desired.copy()
    q_TE, p_TE = pose[:4], pose[4:]
    is_plane = surface.kx == 0 and surface.ky == 0
    near = desired[channels.position]
    q = q_TE
    if is_plane:
        uvh = p_TE
    else:
        R_ST = rotation(surface, near[0], near[1])
        uvh = project(surface, point(surface, near[0], near[1]) + R_ST @ p_TE, near[:2])
        # The orientation is relative to the local normal at the tool.
        local, target = _orientation(surface, uvh), _orientation(surface, near)
        q = quaternion_product(_conjugate(local), quaternion_product(target, q_TE))
    for i in range(3):
        out[channels.position[i]] = uvh[i]
    if len(channels.rotation):
        relative = quaternion_product(q, _conjugate(channels.reference))
        phi = _nearest_vector(relative, desired[channels.rotation])
        for i in range(3):
            out[channels.rotation[i]] = phi[i]
    if channels.force >= 0:
        out[channels.force] = force
    return out


@compiled
def _orientation(surface: Surface, uvh: Array) -> Array:
    """Return the unit quaternion (w, x, y, z) of R_ST at (u, v)."""
    return quaternion(np.array((-surface.ky * uvh[1], surface.kx * uvh[0], 0.0)))


@compiled
def _conjugate(q: Array) -> Array:
    return np.array((q[0], -q[1], -q[2], -q[3]))


@compiled
def _nearest_vector(q: Array, near: Array) -> Array:
    """Return the rotation vector of a quaternion (w, x, y, z) nearest to another, rad."""
    sine = math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if sine < 1e-9:
        length = math.sqrt(near @ near)
        axis = near / length if length > 0 else np.array((1.0, 0.0, 0.0))
    else:
        axis = q[1:] / sine
    angle = 2 * math.atan2(sine, q[0])
    turns = round((float(near @ axis) - angle) / (2 * math.pi))
    return (angle + 2 * math.pi * turns) * axis
