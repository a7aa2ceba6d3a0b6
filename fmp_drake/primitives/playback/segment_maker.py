"""Makes the motion between two ticks of a playback."""

from typing import TYPE_CHECKING

from scipy.linalg import pascal

from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.polynomial_segment import (
    PolynomialPlan,
    PolynomialSegment,
)
from fmp_drake.primitives.playback.segment import Segment
from fmp_drake.primitives.playback.tracking import Drift

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


class SegmentMaker:
    """Makes the segments of a skill: polynomials where the weights drift slowly.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    drifts : list of Drift
        Of each component.
    blend_time : float
        Time constant of the offset's decay, s.
    """

    def __init__(
        self,
        skill: "FourierMovementPrimitive",
        drifts: list[Drift],
        *,
        blend_time: float,
    ) -> None:
        self._skill = skill
        self._drifts = drifts
        self._blend_rate = 1 / blend_time
        self._plans: dict[int, PolynomialPlan | None] = {}

    def make(self, state: PlaybackState) -> Segment | PolynomialSegment:
        """Return the motion from the tick of a state to the next."""
        skill, j = self._skill, state.component
        interval = min(state.step, skill.n_steps - 2)
        polynomial = skill.basis.local_polynomial(interval)
        if interval != state.step:
            # At the last sample: the last interval's, seen from one sample further on.
            polynomial = pascal(len(polynomial), kind="upper") @ polynomial
        plan = self._plan(j)
        if plan is not None:
            return plan.segment(
                polynomial=polynomial,
                weights=state.weights,
                target=state.target,
                offset=state.offset,
            )
        return Segment(
            polynomial=polynomial,
            rate=skill.rate,
            scales=skill.scales_,
            drift=self._drifts[j],
            weights=state.weights,
            target=state.target,
            offset=state.offset,
            blend_rate=self._blend_rate,
        )

    def _plan(self, component: int) -> PolynomialPlan | None:
        """Return the plan of a component, made once."""
        if component not in self._plans:
            self._plans[component] = PolynomialPlan.of(
                self._drifts[component],
                rate=self._skill.rate,
                scales=self._skill.scales_,
                blend_rate=self._blend_rate,
            )
        return self._plans[component]
