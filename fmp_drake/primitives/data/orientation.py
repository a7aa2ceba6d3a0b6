"""Orientations as channels: the logarithm of rotations at a reference.

An orientation R_BE of frame E in the frame B of a demonstration becomes the rotation
vector phi (rad) of

    R_BE = exp([phi]x) R_ref,

so phi is expressed in B, as the position is, and 0 where the orientation is the
reference. Its three components are the channels `rx`, `ry` and `rz`, learned together
with the position. The rotation vectors are unwrapped: they continue past 180 degrees
from the reference, up to nearly 360.

Sources: J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in
robotics", arXiv:1812.01537 (logarithm and left Jacobian of SO(3), equations 132 to 146).
"""

from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError, SkillError
from fmp_drake.numeric import Array, as_floats, finite_array, shown
from fmp_drake.primitives.data.channels import (
    ROTATION_CHANNELS,
    Quaternion,
    channel_indices,
)

QuaternionOrder = Literal["xyzw", "wxyz"]

# Greatest |phi|, rad: beyond it the logarithm is too near its singularity at 2 pi.
LARGEST_ANGLE = 1.75 * np.pi
_LARGEST_STEP = np.pi / 2
_SMALL = 1e-2


class RotationRangeError(DemonstrationError):
    """An orientation is too far from its reference for a rotation vector."""


class HasOrientation(Protocol):
    """A fitted skill, rhythmic or discrete, that may have rotation channels."""

    channels_: tuple[str, ...]
    rotation_reference_: Quaternion | None


def as_rotation(
    rotations: Rotation | ArrayLike, *, order: QuaternionOrder | None = None
) -> Rotation:
    """Return quaternions as a SciPy Rotation; return a Rotation unchanged.

    Parameters
    ----------
    rotations : scipy Rotation or array_like, shape (4,) or (N, 4)
        Quaternions need not be normalised; their signs do not matter.
    order : {"xyzw", "wxyz"}
        Of the quaternions: the scalar last (SciPy, ROS) or first (Drake, Eigen's
        constructor). Required for quaternions.

    Raises
    ------
    DemonstrationError
        Where the shape or the order is missing or wrong, or a quaternion is 0, NaN or
        infinite.
    """
    if isinstance(rotations, Rotation):
        return rotations
    if order not in ("xyzw", "wxyz"):
        raise DemonstrationError(
            f"the order of the quaternions is {order!r}; state 'xyzw' (scalar last) or "
            "'wxyz' (scalar first)."
        )
    quaternions = as_floats(rotations, "the quaternions", error=DemonstrationError)
    shape = (4,) if quaternions.ndim == 1 else ("N", 4)
    finite_array(quaternions, "the quaternions", shape, error=DemonstrationError)
    norms = np.linalg.norm(np.atleast_2d(quaternions), axis=-1)
    if np.any(norms < 1e-6):
        raise DemonstrationError(f"quaternion {int(np.argmin(norms))} is zero.")
    # Before version 1.18 SciPy takes no read-only arrays.
    return Rotation.from_quat(np.array(quaternions), scalar_first=order == "wxyz")


def mean_rotation(
    rotations: Rotation | ArrayLike, *, order: QuaternionOrder | None = None
) -> Quaternion:
    """Return the mean rotation, a good reference for several demonstrations.

    Parameters
    ----------
    rotations : scipy Rotation, or array_like of shape (N, 4)
        Those of all demonstrations.
    order : {"xyzw", "wxyz"}
        Of quaternions; see `as_rotation`.

    Returns
    -------
    tuple of float
        Quaternion (x, y, z, w), of unit length, w not negative.
    """
    return unit_quaternion(as_rotation(rotations, order=order).mean())


def rotation_vectors(
    rotations: Rotation,
    reference: Quaternion,
    *,
    near: ArrayLike | None = None,
) -> Array:
    """Return rotation vectors phi that follow a sequence of rotations without jumps.

    Parameters
    ----------
    rotations : scipy Rotation, one or N
        R_BE in the order of time.
    reference : tuple of float
        Quaternion (x, y, z, w) of R_ref.
    near : array_like, shape (3,), optional
        Rotation vector, rad: the first result is the nearest one to it, or the shortest
        where None. Use the middle of a skill's `extent_` for a measured orientation.

    Returns
    -------
    ndarray, shape (3,) or (N, 3)
        rad, in frame B.

    Raises
    ------
    DemonstrationError
        Where two samples are more than 90 degrees apart, or a sample is farther than
        `LARGEST_ANGLE` from the reference.
    """
    relative = rotations * Rotation.from_quat(reference).inv()
    vectors = np.atleast_2d(relative.as_rotvec())
    if len(vectors) > 1:
        steps = (relative[1:] * relative[:-1].inv()).magnitude()
        widest = int(np.argmax(steps))
        if steps[widest] > _LARGEST_STEP:
            raise DemonstrationError(
                f"the orientation jumps by {np.rad2deg(steps[widest]):.0f} degrees "
                f"after sample {widest}; at most {np.rad2deg(_LARGEST_STEP):.0f} can "
                "be followed. Record faster, or check how the orientation is read."
            )
    out = np.empty_like(vectors)
    last = vectors[0] if near is None else np.asarray(near, dtype=float)
    for i, vector in enumerate(vectors):
        last = out[i] = _nearest_branch(vector, last)
    angles = np.linalg.norm(out, axis=1)
    farthest = int(np.argmax(angles))
    if angles[farthest] > LARGEST_ANGLE:
        raise RotationRangeError(
            f"sample {farthest} is rotated by {np.rad2deg(angles[farthest]):.0f} degrees "
            "from the reference; rotation vectors are defined up to "
            f"{np.rad2deg(LARGEST_ANGLE):.0f}. Choose a nearer reference, or cut the "
            "recording."
        )
    return out[0] if rotations.single else out


def rotations_of(vectors: ArrayLike, reference: Quaternion) -> Rotation:
    """Return R_BE = exp([phi]x) R_ref of rotation vectors phi (3,) or (N, 3), rad."""
    return Rotation.from_rotvec(np.array(vectors, float)) * Rotation.from_quat(
        reference
    )


def skill_rotations(skill: HasOrientation, values: ArrayLike) -> Rotation:
    """Return the orientations R_BE that a skill's rotation channels describe.

    Parameters
    ----------
    skill : FourierMovementPrimitive or DiscreteMovementPrimitive
        Learned from demonstrations with rotation channels.
    values : array_like, shape (D,) or (N, D)
        All channels, as the `position` of a playback or a sample gives them.

    Raises
    ------
    SkillError
        Where the skill has no orientation, or the values have another shape.
    """
    if not hasattr(skill, "rotation_reference_"):
        raise SkillError(
            "skill_rotations(skill, values) needs a fitted skill, such as "
            f"FourierMovementPrimitive().fit(demonstrations); it is {shown(skill)}."
        )
    reference = skill.rotation_reference_
    if reference is None:
        raise SkillError(
            "the skill has no orientation; learn it from demonstrations with rotation "
            "channels (`add_orientation`)."
        )
    array, d = np.asarray(values, dtype=float), len(skill.channels_)
    if array.ndim not in (1, 2) or array.shape[-1] != d:
        raise SkillError(
            f"the values have shape {array.shape}; expected ({d},) or (N, {d}), such as "
            "the position of a motion."
        )
    index = channel_indices(list(ROTATION_CHANNELS), skill.channels_)
    return rotations_of(array[..., index], reference)


def angular_velocity(vectors: ArrayLike, rates: ArrayLike) -> Array:
    """Return the angular velocity omega_BE in frame B.

    omega = J_l(phi) dphi/dt, with the left Jacobian of SO(3)::

        J_l = I + (1 - cos a) / a^2 [phi]x + (a - sin a) / a^3 [phi]x^2,  a = |phi|,

    which does not depend on the reference. Exact for every angle; small ones use the
    power series.

    Parameters
    ----------
    vectors : array_like, shape (..., 3)
        phi, rad.
    rates : array_like, shape (..., 3)
        dphi/dt, rad/s.

    Returns
    -------
    ndarray, shape (..., 3)
        rad/s.
    """
    phi = as_floats(vectors, "the rotation vectors", ("...", 3))
    rate = as_floats(rates, "the rates", phi.shape)
    a = np.linalg.norm(phi, axis=-1, keepdims=True)
    small = a < _SMALL
    s = a**2
    a = np.where(small, 1.0, a)
    # sin(a/2)^2 instead of 1 - cos(a) keeps the digits of small angles.
    b = np.where(small, 1 / 2 - s / 24 + s**2 / 720, 2 * np.sin(a / 2) ** 2 / a**2)
    c = np.where(small, 1 / 6 - s / 120 + s**2 / 5040, (a - np.sin(a)) / a**3)
    first = np.cross(phi, rate)
    return rate + b * first + c * np.cross(phi, first)


def _nearest_branch(vector: Array, near: Array) -> Array:
    """Return the rotation vector of the same rotation that is nearest to another."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-9:
        # The identity has no axis: a rotation by 360 degrees may be about any.
        length = float(np.linalg.norm(near))
        axis = near / length if length > 0 else np.array([1.0, 0.0, 0.0])
    else:
        axis = vector / angle
    revolutions = np.round((float(near @ axis) - angle) / (2 * np.pi))
    return vector + 2 * np.pi * revolutions * axis


def unit_quaternion(rotation: Rotation) -> Quaternion:
    """Return a rotation as a quaternion (x, y, z, w) with w not negative."""
    x, y, z, w = (float(q) for q in np.ravel(rotation.as_quat(canonical=True)))
    return (x, y, z, w)
