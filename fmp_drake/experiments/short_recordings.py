"""What a short recording teaches, beyond the paper."""

from dataclasses import replace

import numpy as np

from fmp_drake.experiments.finding import Finding
from fmp_drake.experiments.held_out import MEASURES, score
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
    whole, held = _between(recorded, 0, last), _between(recorded, last, last + size)
    pieces = [_between(recorded, a, a + size) for a in begins[: 3 * profile.folds]]
    rows = {
        f"phase model, {len(pieces)} pieces of {_SECONDS:g} s": [
            (phase(), piece) for piece in pieces
        ],
        f"phase model, all {whole.duration:.0f} s": [(phase(), whole)],
        f"mixture, all {whole.duration:.0f} s": [
            (fmp(seed), whole) for seed in range(profile.seeds)
        ],
    }
    extent = grid_extent(recorded.values)
    table, errors = [["learned from", *(MEASURES[m] for m in _SHOWN)]], []
    for name, learned in rows.items():
        scores = [
            score(
                model.fit(cut([part], stride=FMP_STRIDE)),
                held,
                extent=extent,
                profile=profile,
            )
            for model, part in learned
        ]
        values = np.array([[each[m] for m in _SHOWN] for each in scores])
        mean, spread = values.mean(axis=0), values.std(axis=0)
        table.append(
            [name, *(f"{m:.2f} ± {s:.2f}" for m, s in zip(mean, spread, strict=True))]
        )
        errors.append(mean[_SHOWN.index("prediction_rms")])
    short, _, mixture = errors
    return Finding(
        name=f"short_{task}",
        title=f"Learned from {_SECONDS:g} s: {task}",
        shows=f"The next second of the last {_SECONDS:g} s is predicted with "
        f"{short:.1f} mm by what was learned from {_SECONDS:g} s, and with {mixture:.1f} mm by "
        "the mixture that has learned from all that was before.",
        claim=f"{_SECONDS:g} s teach the phase model what all of it teaches the mixture.",
        agrees=bool(short <= mixture),
        table=table,
    )


def _between(recorded: Demonstration, a: int, b: int) -> Demonstration:
    return replace(recorded, time=recorded.time[a:b], values=recorded.values[a:b])
