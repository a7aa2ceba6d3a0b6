"""How closely the start of a playback is met."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillError
from fmp_drake.numeric import is_number

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


def start_variances(
    skill: "FourierMovementPrimitive", fraction: float
) -> NDArray[np.float64]:
    """Return lambda of (13) for a start, per channel, shape (D,).

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    fraction : float
        Of the movement's half width, root 2 of its standard deviation over all channels
        of a unit together: a rotated movement has the same.
    """
    if not (is_number(fraction) and fraction >= 0):
        raise SkillError(
            f"start_tolerance is {fraction}; it must be 0 (exact) or positive."
        )
    variances, units = _variances(skill), np.array(skill.units_)
    squares = np.array([2 * variances[units == unit].sum() for unit in units])
    return np.maximum(fraction**2 * squares, skill.tolerance * np.square(skill.scales_))


def _variances(skill: "FourierMovementPrimitive") -> NDArray[np.float64]:
    """Return the variance of each channel over all windows and times, (D,)."""
    n, d = skill.n_steps, skill.n_channels_
    square, middle = np.zeros(d), np.zeros(d)
    for proportion, c in zip(skill.proportions_, skill.components_, strict=True):
        weights = c.mean.reshape(d, n)
        spread = (c.basis**2 @ c.variances).reshape(d, n)
        square += proportion * (weights**2 + spread + c.noise).sum(axis=1) / n
        middle += proportion * weights[:, 0] / np.sqrt(n)
    return np.maximum(square - middle**2, 0) * skill.scales_**2
