"""What a short recording teaches, beyond the paper."""

from fmp_drake.experiments.finding import Finding
from fmp_drake.experiments.held_out import (
    Scores,
    add_scores,
    part,
    score,
    score_rows,
    summary,
)
from fmp_drake.experiments.methods import FMP_STRIDE, RATE, cut, fmp, phase
from fmp_drake.experiments.metrics import grid_extent
from fmp_drake.experiments.profile import Profile
from fmp_drake.primitives import Demonstration

_SECONDS = 20.0
_SHOWN = ("log_density", "prediction_rms", "tube_5", "tube_10", "tube_20")


def short_recordings(
    task: str, demonstration: Demonstration, profile: Profile
) -> Finding:
    """Learn from pieces of 20 s, and from all but the last 20 s, which are predicted.

    Of the pieces three are used for each fold of the profile.
    """
    recorded = demonstration.resample(RATE)
    size = round(_SECONDS * RATE)
    *begins, last = range(len(recorded.time) % size, len(recorded.time), size)
    whole, held = part(recorded, 0, last), part(recorded, last, last + size)
    pieces = [part(recorded, a, a + size) for a in begins[: 3 * profile.folds]]
    by_pieces = f"phase model, {len(pieces)} pieces of {_SECONDS:g} s"
    all_of_it = f"all {whole.duration:.0f} s"
    by_mixture = f"mixture, {all_of_it}"
    learned = [
        *((by_pieces, phase(), piece) for piece in pieces),
        (f"phase model, {all_of_it}", phase(), whole),
        *((by_mixture, fmp(seed), whole) for seed in range(profile.seeds)),
    ]
    extent = grid_extent(recorded.values)
    scores: Scores = {}
    for name, model, shown in learned:
        fitted = model.fit(cut([shown], stride=FMP_STRIDE))
        add_scores(scores, name, score(fitted, held, extent=extent, profile=profile))
    numbers = summary(scores)
    short, mixture = (
        numbers[name]["prediction_rms"]["mean"] for name in (by_pieces, by_mixture)
    )
    return Finding(
        name=f"short_{task}",
        title=f"Learned from {_SECONDS:g} s: {task}",
        shows=f"The next second of the last {_SECONDS:g} s is predicted with "
        f"{short:.1f} mm by what was learned from {_SECONDS:g} s, and with {mixture:.1f} mm by "
        "the mixture that has learned from all that was before.",
        claim=f"{_SECONDS:g} s teach the phase model what all of it teaches the mixture.",
        agrees=short <= mixture,
        table=score_rows(numbers, _SHOWN),
    )
