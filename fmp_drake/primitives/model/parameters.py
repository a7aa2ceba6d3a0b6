"""The ranges of a skill's parameters."""

from collections.abc import Mapping
from typing import Any, Literal

from fmp_drake.errors import SkillError
from fmp_drake.numeric import GREATEST, check_number, is_whole

ModelChoice = Literal["mixture", "phase", "automatic"]
ComponentCount = int | Literal["automatic", "bic"]


def check_parameters(values: Mapping[str, Any]) -> None:
    """Raise SkillError where a parameter of `FourierMovementPrimitive` is out of range.

    `scales` is checked where it is used, against the channels.
    """
    model = values["model"]
    if not isinstance(model, str) or model not in ("mixture", "phase", "automatic"):
        raise SkillError(
            f"model is {model!r}; it must be 'mixture', 'phase' or 'automatic'."
        )
    least_positive = 1 / GREATEST
    check_number(values["n_steps"], "n_steps", least=8, whole=True)
    half = values["n_steps"] // 2
    check_number(values["overlap"], "overlap", least=2, most=half, whole=True)
    if values["stride"] is not None:
        check_number(values["stride"], "stride", least=1, whole=True)
    components = values["n_components"]
    is_named = isinstance(components, str) and components in ("automatic", "bic")
    if not (is_named or (is_whole(components) and components >= 1)):
        raise SkillError(
            f"n_components is {components!r}; it must be a whole number, at least 1, "
            "'automatic' or 'bic'."
        )
    seed = values["random_state"]
    check_number(seed, "random_state", least=0, most=2**32 - 1, whole=True)
    check_number(values["rate"], "rate", least=1e-6, most=1e6, unit="Hz")
    check_number(
        values["explained_variance"], "explained_variance", above=0.0, most=1.0
    )
    check_number(values["regularization"], "regularization", least=least_positive)
    check_number(values["shrinkage"], "shrinkage", least=0.0)
    check_number(values["tolerance"], "tolerance", least=least_positive)
    selection = values["selection"]
    if not isinstance(selection, str) or selection not in ("cost", "evidence"):
        raise SkillError(
            f"selection is {selection!r}; it must be 'cost' or 'evidence'."
        )
