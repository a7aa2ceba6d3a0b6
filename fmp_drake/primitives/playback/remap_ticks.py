"""How often a playback is mapped anew."""

from typing import TYPE_CHECKING

from fmp_drake.numeric import check_number

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive

# Ticks.
_EDGE = 4


def remap_ticks_of(
    skill: "FourierMovementPrimitive", given: int | None
) -> tuple[int, int]:
    """Return the ticks between two re-mappings, of samples and of means.

    T - K each where none are given, as in the paper; but one second for the means of a
    phase model, which shrink over a window. Its samples are rough, so they are left a few
    ticks before the end, where their velocity is that of a curve that goes on.
    """
    most = skill.n_steps - skill.overlap
    if given is not None:
        check_number(given, "remap_ticks", least=1, most=most, whole=True)
        return int(given), int(given)
    if skill.phase_model_ is None:
        return most, most
    most = max(1, most - _EDGE)
    return most, min(most, max(1, round(skill.rate)))
