"""Building fitted skills from their parts, without learning again."""

from collections.abc import Mapping
from typing import Any

from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


def build_skill(
    parameters: Mapping[str, Any], fitted: Mapping[str, Any]
) -> FourierMovementPrimitive:
    """Return a skill with given parameters and fitted attributes, without a fit.

    Parameters
    ----------
    parameters : mapping
        Of the constructor.
    fitted : mapping
        What `fit` would set: names that end with an underscore.
    """
    skill = FourierMovementPrimitive(**parameters)
    for name, value in fitted.items():
        setattr(skill, name, value)
    return skill


def copy_skill(
    skill: FourierMovementPrimitive,
    *,
    parameters: Mapping[str, Any] | None = None,
    **fitted: Any,
) -> FourierMovementPrimitive:
    """Return a copy of a fitted skill with some parts replaced.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted; it stays as it is.
    parameters : mapping, optional
        Parameters of the constructor that differ.
    **fitted
        Fitted attributes that differ.
    """
    skill.check_fitted()
    kept = {
        name: value
        for name, value in vars(skill).items()
        if name.endswith("_") and not name.startswith("_")
    }
    return build_skill(
        {**skill.get_params(deep=False), **(parameters or {})}, {**kept, **fitted}
    )
