"""A target that the user of a player gives."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.numeric import all_finite, as_floats

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


def checked_target(
    skill: "FourierMovementPrimitive", target: ArrayLike | None, *, sample: bool
) -> NDArray[np.float64] | None:
    """Return weights to be tracked, (D*T,), or None where none are given.

    Raises
    ------
    SkillError
        Where they do not fit the skill, or samples are to be tracked instead.
    """
    if target is None:
        return None
    if sample:
        raise SkillError("give either a target or sample=True, not both.")
    own = as_floats(target, "the target")
    n = skill.components_[0].dim
    if own.shape != (n,) or not all_finite(own):
        raise SkillError(
            f"the target has shape {own.shape}; expected ({n},) finite weights."
        )
    return own
