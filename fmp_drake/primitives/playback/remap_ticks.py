"""How often a playback is mapped anew."""

from typing import TYPE_CHECKING

from fmp_drake.numeric import check_number
from fmp_drake.primitives.model.phase.closing import unplayed

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


def remap_ticks_of(skill: "FourierMovementPrimitive", given: int | None) -> int:
    """Return the ticks between two re-mappings: as given, or as many as there may be.

    These are T - K, as in the paper; of a phase model fewer by those at the end of a window
    that lead back to its beginning.
    """
    most = skill.n_steps - skill.overlap
    if skill.phase_model_ is not None:
        most = max(1, most - unplayed(skill.n_steps))
    if given is not None:
        check_number(given, "remap_ticks", least=1, most=most, whole=True)
        return int(given)
    return most
