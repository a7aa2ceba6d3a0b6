"""Copies of a skill at another tempo, position, orientation or size."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SkillError
from fmp_drake.numeric import Array, check_number, check_type, finite_array
from fmp_drake.primitives.data.channels import (
    POSITION_CHANNELS,
    ROTATION_CHANNELS,
    channel_indices,
)
from fmp_drake.primitives.data.orientation import unit_quaternion
from fmp_drake.primitives.model.movement_primitive import (
    FourierMovementPrimitive,
    copy_skill,
)
from fmp_drake.primitives.model.trajectory_mixture import check_skill

_ROUNDING = 1e-9


def scale_tempo(
    skill: FourierMovementPrimitive, factor: float
) -> FourierMovementPrimitive:
    """Return a copy of a skill at `factor` times the tempo.

    The distribution over windows is unchanged; only the sample interval changes.
    Therefore positions are the same, velocities are multiplied by `factor`,
    accelerations by `factor`^2 and the period by 1/`factor`. Time constants of a
    `Player` and its tracker are in seconds and do not change.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted; not changed.
    factor : float
        Greater than 1 is faster.

    Raises
    ------
    SkillError
        Where the factor is not positive.
    """
    check_skill(skill, "scale_tempo(skill)")
    check_number(factor, "factor", above=0.0)
    rate = float(skill.rate * factor)
    check_number(rate, "the rate", least=1e-6, most=1e6, unit="Hz")
    parameters = {
        "rate": rate,
        "n_steps": skill.n_steps,
        "window": None,
        "overlap": skill.overlap,
    }
    return copy_skill(skill, parameters=parameters)


def transform_space(
    skill: FourierMovementPrimitive,
    *,
    rotation: Rotation | ArrayLike | None = None,
    scale: float = 1.0,
    translation: ArrayLike | None = None,
    channels: Sequence[str] = POSITION_CHANNELS,
    rotate_orientation: bool = True,
    frame: str | None = None,
) -> FourierMovementPrimitive:
    """Return a copy of a skill that is rotated, scaled and translated in space.

    Every sample p of the named channels becomes scale * R p + t. The distribution over
    trajectories is transformed exactly: means, factors and white noise. A playback from a
    transformed start is the transformed playback; samples need the same `margin` for it,
    as the automatic one follows the extent, which a rotation enlarges. Predictions from
    few cycles use each channel's own past: of a rotated skill they differ by millimetres.

    A rotation is an orthogonal map of the scaled values. It keeps the noise of the
    mixture isotropic where it mixes channels of equal scale. A change of size changes
    the scales of the channels.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted; not changed.
    rotation : scipy Rotation or array_like, shape (C, C), optional
        R, a proper rotation of the C named channels.
    scale : float
        Positive, the same for all named channels.
    translation : array_like, shape (C,), optional
        t, in the channels' units.
    channels : sequence of str
        The C channels that form a vector.
    rotate_orientation : bool
        Whether to rotate the orientations R_BE of the rotation channels (see
        `add_orientation`), too, to R R_BE. False where the named channels are, for example,
        a force measured in another frame.
    frame : str, optional
        Name of the frame of the new values; unchanged where None.

    Returns
    -------
    FourierMovementPrimitive
        Its `extent_` is the bounding box of the transformed box.

    Raises
    ------
    SkillError
        Where a channel is missing, R is not a rotation, the scale is not positive, or R
        mixes channels of different units or scales (the noise would then no longer be
        isotropic).

    Notes
    -----
    Where a rotation is refused, learn from transformed demonstrations.
    """
    check_skill(skill, "transform_space(skill)")
    check_type(channels, "channels", Iterable, error=SkillError)
    index = channel_indices(list(channels), skill.channels_)
    count = len(index)
    check_number(scale, "scale", above=0.0)
    shift = np.zeros(count)
    if translation is not None:
        shift = finite_array(translation, "the translation", (count,))
    matrix = np.eye(count) if rotation is None else _rotation_matrix(rotation, count)
    out = _apply(
        skill, index=index, rotation=matrix, scale=float(scale), translation=shift
    )
    changes: dict[str, Any] = {}
    reference = skill.rotation_reference_
    if rotation is not None and reference is not None and rotate_orientation:
        if count != 3:
            raise SkillError(
                f"the skill has an orientation, which a rotation of {count} channels "
                "does not rotate; name three channels, or set rotate_orientation=False."
            )
        indices = channel_indices(list(ROTATION_CHANNELS), skill.channels_)
        if set(indices) & set(index):
            raise SkillError(
                "the rotation channels are rotated along with a position; name the channels "
                "of the position."
            )
        out = _apply(
            out, index=indices, rotation=matrix, scale=1.0, translation=np.zeros(3)
        )
        quaternion = Rotation.from_matrix(matrix) * Rotation.from_quat(reference)
        changes["rotation_reference_"] = unit_quaternion(quaternion)
    if frame is not None:
        changes["frame_"] = frame
    return copy_skill(out, **changes)


def _rotation_matrix(rotation: Rotation | ArrayLike, count: int) -> Array:
    if isinstance(rotation, Rotation):
        rotation = rotation.as_matrix()
    matrix = finite_array(rotation, "the rotation", (count, count))
    error = np.max(np.abs(matrix @ matrix.T - np.eye(count)))
    if not error < 1e-6 or np.linalg.det(matrix) < 0:
        raise SkillError(
            f"rotation is not a rotation: R R' is off the identity by {error:.2g}, the "
            f"determinant is {np.linalg.det(matrix):.3g}; it must be orthogonal with "
            "determinant 1."
        )
    return polar(matrix)[0]


def _apply(
    skill: FourierMovementPrimitive,
    *,
    index: list[int],
    rotation: Array,
    scale: float,
    translation: Array,
) -> FourierMovementPrimitive:
    """Transform some channels; `rotation` is orthogonal."""
    old = skill.scales_[index]
    new = _rotated_scales(skill, index, rotation)
    scaled = (rotation * old) / new[:, None]  # orthogonal
    scales = skill.scales_.copy()
    scales[index] = scale * new
    offset = translation / scales[index] * np.sqrt(skill.n_steps)
    shape = (skill.n_channels_, skill.n_steps, -1)
    components = []
    for component in skill.components_:
        mean = component.mean.reshape(shape[:2]).copy()
        mean[index] = scaled @ mean[index]
        mean[index, 0] += offset
        basis = component.basis.reshape(shape).copy()
        basis[index] = np.einsum("ab,btr->atr", scaled, basis[index])
        components.append(
            replace(
                component,
                mean=mean.ravel(),
                basis=np.ascontiguousarray(basis.reshape(component.basis.shape)),
            )
        )
    extent = skill.extent_.copy()
    middle = extent[:, index].mean(axis=0)
    half = np.abs(rotation) @ (np.ptp(extent[:, index], axis=0) / 2)
    middle = scale * rotation @ middle + translation
    extent[:, index] = [middle - scale * half, middle + scale * half]
    paths = [path.copy() for path in skill.paths_]
    for path in paths:
        path[:, index] = scale * path[:, index] @ rotation.T + translation
    phase = skill.phase_model_
    matrix, shift = np.eye(skill.n_channels_), np.zeros(skill.n_channels_)
    matrix[np.ix_(index, index)] = scaled
    shift[index] = translation / scales[index]
    if phase is not None:
        phase = phase.transformed(matrix, shift)
    calibration = skill.calibration_
    return copy_skill(
        skill,
        calibration_=calibration and calibration.transformed(matrix),
        memory_=tuple(path @ matrix.T + shift for path in skill.memory_),
        components_=tuple(components),
        phase_model_=phase,
        scales_=scales,
        extent_=extent,
        paths_=tuple(paths),
    )


def _rotated_scales(
    skill: FourierMovementPrimitive, index: list[int], rotation: Array
) -> Array:
    """Return the scales after a rotation, where those keep the noise isotropic."""
    squares = (rotation * skill.scales_[index] ** 2) @ rotation.T
    new = np.sqrt(np.diag(squares))
    mixed = squares - np.diag(np.diag(squares))
    units = np.array([skill.units_[i] for i in index])
    differ = (np.abs(rotation) > _ROUNDING) & (units[:, None] != units)
    if np.any(differ) or np.max(np.abs(mixed)) > _ROUNDING * np.max(squares):
        names = ", ".join(skill.channels_[i] for i in index)
        raise SkillError(
            f"the rotation mixes the channels {names} of the units "
            f"{', '.join(units)} and the scales "
            f"{', '.join(f'{s:.3g}' for s in skill.scales_[index])}; only channels of "
            "the same unit and scale can be mixed exactly. Learn from rotated "
            "demonstrations, or with equal scales."
        )
    return new
