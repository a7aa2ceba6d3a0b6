"""Surfaces of constant curvature, and the motion of a tool over them.

S is the frame of a surface: its origin is the middle of the surface, z the normal out of
it. A point of the surface has coordinates (u, v) in m, measured along the surface from the
middle, and the height h over it along the local normal. T is the frame at such a point: z
is the local normal. For a tool E over a plane, T is S.

With the curvatures kx and ky along x and y of S (1/m, positive for a dome, negative for a
bowl) and phi = (-ky v, kx u, 0)::

    R_ST = exp([phi]x),  p_ST = straight part + (R_ST z - z) / k.

A plane has kx = ky = 0. Where one of them is 0 the surface is a cylinder, and (u, v) an
isometry. Where both are equal it is a sphere, and (u, v) its azimuthal equidistant map: at
the angle a from the middle, lengths across the radial direction are scaled by sin(a) / a.

Rotation vectors and their derivatives follow J. Sola, J. Deray, D. Atchuthan, "A micro Lie
theory for state estimation in robotics", arXiv:1812.01537 (exponential and left Jacobian
of SO(3)).
"""

import math
from typing import NamedTuple

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array, Indices


@compiled
def cross(a: Array, b: Array) -> Array:
    """Return ``a × b``, shape (3,)."""
    return np.array(
        (
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        )
    )


@compiled
def coefficients(phi: Array) -> tuple[float, float, float, float]:
    """Return the coefficients of the left Jacobian and their derivatives.

    With a = |phi| they are b = (1 - cos a)/a², c = (a - sin a)/a³, (db/da)/a and (dc/da)/a;
    below 0.01 rad their power series.

    Parameters
    ----------
    phi : array, shape (3,)
        rad.
    """
    s = float(phi @ phi)
    if s < 1e-4:
        return (
            1 / 2 - s / 24 + s * s / 720,
            1 / 6 - s / 120 + s * s / 5040,
            -1 / 12 + s / 180 - s * s / 6720,
            -1 / 60 + s / 1260 - s * s / 60480,
        )
    a = math.sqrt(s)
    b = 2 * math.sin(a / 2) ** 2 / s
    c = (a - math.sin(a)) / (a * s)
    return b, c, (math.sin(a) / a - 2 * b) / s, (b - 3 * c) / s


@compiled
def rotation_matrix(phi: Array) -> Array:
    """Return exp([phi]x), shape (3, 3), of a rotation vector, rad."""
    b, _, _, _ = coefficients(phi)
    s = phi @ phi
    a = math.sqrt(s)
    sinc = math.sin(a) / a if a > 1e-4 else 1 - s / 6
    x, y, z = phi
    K = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.eye(3) + sinc * K + b * (K @ K)


@compiled
def quaternion(phi: Array) -> Array:
    """Return the unit quaternion (w, x, y, z) of a rotation vector, rad."""
    half = 0.5 * math.sqrt(phi @ phi)
    sinc = 0.5 * math.sin(half) / half if half > 1e-8 else 0.5
    return np.array((math.cos(half), sinc * phi[0], sinc * phi[1], sinc * phi[2]))


@compiled
def quaternion_product(p: Array, q: Array) -> Array:
    """Return the Hamilton product of two quaternions (w, x, y, z)."""
    return np.array(
        (
            p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
            p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
            p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
            p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
        )
    )


@compiled
def angular_motion(phi: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
    """Return angular velocity and acceleration of exp([phi]x), in the fixed frame.

    Parameters
    ----------
    phi, rate, acceleration : array, shape (3,)
        Rotation vector and its time derivatives: rad, rad/s, rad/s².

    Returns
    -------
    omega, alpha : array, shape (3,)
        rad/s and rad/s².
    """
    b, c, b_derivative, c_derivative = coefficients(phi)
    first = cross(phi, rate)
    second = cross(phi, first)
    omega = rate + b * first + c * second
    along = phi @ rate
    third = cross(phi, acceleration)
    alpha = acceleration + b * third + c * cross(phi, third)
    alpha += along * (b_derivative * first + c_derivative * second)
    return omega, alpha + c * cross(rate, first)


class Surface(NamedTuple):
    """Curvatures of a surface along x and y of S, 1/m.

    One of them is 0, or both are equal.

    Examples
    --------
    >>> pipe = Surface(kx=0.0, ky=1 / 0.3)
    >>> pipe.is_plane
    False
    >>> [round(float(x), 3) for x in point(pipe, 0.1, 0.3 * np.pi / 2)]
    [0.1, 0.3, -0.3]
    """

    kx: float = 0.0
    ky: float = 0.0

    @property
    def is_plane(self) -> bool:
        """Return whether the surface is flat."""
        return self.kx == 0 == self.ky

    @property
    def circumference(self) -> tuple[float, float]:
        """Circumferences along u and v, m; infinite along a straight line."""
        kx, ky = (2 * math.pi / abs(k) if k else math.inf for k in self)
        return kx, ky

    def sagitta(self, footprint: tuple[float, float]) -> float:
        """Return the sagitta of the surface under a tool of a footprint (x, y), m.

        Parameters
        ----------
        footprint : tuple of 2 floats
            Edges of the tool along x and y of T, m.
        """
        return sum(
            abs(k) * (a / 2) ** 2 / 2 for k, a in zip(self, footprint, strict=True)
        )


PLANE = Surface()


@compiled
def _curvature(surface: Surface) -> float:
    """Return the curvature that is not 0, if any."""
    return surface.kx if surface.kx != 0 else surface.ky


@compiled
def rotation(surface: Surface, u: float, v: float) -> Array:
    """Return R_ST at a point, shape (3, 3)."""
    return rotation_matrix(np.array((-surface.ky * v, surface.kx * u, 0.0)))


@compiled
def point(surface: Surface, u: float, v: float) -> Array:
    """Return p_ST, the point of the surface at (u, v), shape (3,), m."""
    p = np.zeros(3)
    if surface.kx == 0:
        p[0] = u
    if surface.ky == 0:
        p[1] = v
    k = _curvature(surface)
    if k != 0:
        normal = rotation(surface, u, v)[:, 2]
        p += np.array((normal[0], normal[1], normal[2] - 1)) / k
    return p


def place(surface: Surface, uvh: Array) -> Array:
    """Return the positions in S of points given by (u, v, h), shape (N, 3), m."""
    return uvh.copy() if surface.is_plane else _place(surface, uvh)


@compiled
def _place(surface: Surface, uvh: Array) -> Array:
    """Place points on a curved surface."""
    out = np.empty_like(uvh)
    for i in range(len(uvh)):
        u, v, h = uvh[i]
        out[i] = point(surface, u, v) + h * rotation(surface, u, v)[:, 2]
    return out


@compiled
def project(surface: Surface, p_S: Array, near: Array) -> Array:
    """Return (u, v, h) of a point in S, shape (3,), m.

    Parameters
    ----------
    surface : Surface
    p_S : array, shape (3,)
        m. Nearer to the surface than its centre of curvature.
    near : array, shape (2,)
        Coordinates (u, v), m: on a cylinder the nearest equivalent ones are returned.
    """
    k = _curvature(surface)
    if k == 0:
        return p_S.copy()
    d = np.array((p_S[0], p_S[1], p_S[2] + 1 / k))
    if surface.kx == 0:
        d[0] = 0.0
    if surface.ky == 0:
        d[1] = 0.0
    sign = 1.0 if k > 0 else -1.0
    distance = math.sqrt(d @ d)
    h = sign * distance - 1 / k
    normal = sign * d / distance
    radial = math.sqrt(normal[0] ** 2 + normal[1] ** 2)
    length = math.atan2(radial, normal[2]) / (k * radial) if radial > 1e-12 else 1 / k
    uvh = np.array((normal[0] * length, normal[1] * length, h))
    if surface.kx == 0 or surface.ky == 0:
        straight = 0 if surface.kx == 0 else 1
        uvh[straight] = p_S[straight]
        circumference = 2 * math.pi / abs(k)
        circular = 1 - straight
        uvh[circular] = math.atan2(normal[circular], normal[2]) / k
        uvh[circular] += circumference * round(
            (near[circular] - uvh[circular]) / circumference
        )
    return uvh


@compiled
def project_all(surface: Surface, p_S: Array, near: Array) -> Array:
    """Return (u, v, h) of points in S, shape (N, 3), m; see `project`."""
    out = np.empty_like(p_S)
    for i in range(len(p_S)):
        out[i] = project(surface, p_S[i], near)
    return out


@compiled
def rotations(surface: Surface, uvh: Array) -> Array:
    """Return R_ST at points given by (u, v, h), shape (N, 3, 3)."""
    out = np.empty((len(uvh), 3, 3))
    for i in range(len(uvh)):
        out[i] = rotation(surface, uvh[i, 0], uvh[i, 1])
    return out


@compiled
def moving_frame(
    surface: Surface, uv: Array, rate: Array, acceleration: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the frame T at a moving point of the surface, with its velocity and acceleration.

    Parameters
    ----------
    surface : Surface
    uv, rate, acceleration : array, shape (2,)
        Coordinates of the point and their time derivatives: m, m/s, m/s².

    Returns
    -------
    R_ST : array, shape (3, 3)
    p_ST : array, shape (3,)
        m.
    V_ST, A_ST : array, shape (6,)
        Spatial velocity of T's origin and its time derivative in S, rotation first: rad/s,
        m/s, rad/s², m/s².
    """
    kx, ky = surface.kx, surface.ky
    phi = np.array((-ky * uv[1], kx * uv[0], 0.0))
    omega, alpha = angular_motion(
        phi,
        np.array((-ky * rate[1], kx * rate[0], 0.0)),
        np.array((-ky * acceleration[1], kx * acceleration[0], 0.0)),
    )
    R = rotation_matrix(phi)
    velocity, second = np.zeros(6), np.zeros(6)
    velocity[:3], second[:3] = omega, alpha
    if kx == 0:
        velocity[3], second[3] = rate[0], acceleration[0]
    if ky == 0:
        velocity[4], second[4] = rate[1], acceleration[1]
    k = _curvature(surface)
    if k != 0:
        normal = R[:, 2].copy()
        normal_rate = cross(omega, normal)
        velocity[3:] += normal_rate / k
        second[3:] += (cross(alpha, normal) + cross(omega, normal_rate)) / k
    return R, point(surface, uv[0], uv[1]), velocity, second


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
    """Return all inputs of the controller, in the order of `task_motion.DESIRED`.

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
