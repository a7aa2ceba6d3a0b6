"""A tracker of every kind, each stable for a given skill."""

from fmp_drake.primitives import ExponentialTracker, LqrTracker, ProportionalTracker
from fmp_drake.primitives.playback.trackers import paper_precision_diagonal


def greatest_precision(skill):
    return max(
        paper_precision_diagonal(c, n_steps=skill.n_steps).max()
        for c in skill.components_
    )


TRACKERS = {
    "lqr": lambda _: LqrTracker(),
    "quick": lambda _: LqrTracker(time_constant=0.4, shortest=0.05),
    "proportional": lambda skill: ProportionalTracker(
        beta=skill.rate / greatest_precision(skill)
    ),
    "exponential": lambda skill: ExponentialTracker(
        beta=3 * skill.rate / greatest_precision(skill)
    ),
}
