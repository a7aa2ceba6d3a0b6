"""Attempt to explain recordings by cycles of one period."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fmp_drake.numeric import Array, Indices, Mask, runs
from fmp_drake.primitives.model.phase.cycle import Cycle, harmonics_of
from fmp_drake.primitives.model.phase.period import SIMILAR, similarity
from fmp_drake.primitives.model.phase.rhythm import cycle_count
from fmp_drake.primitives.model.phase.segmentation import (
    FORWARDS,
    OUTSIDE,
    segment,
    segments,
)
from fmp_drake.primitives.model.phase.self_alignment import aligned_samples
from fmp_drake.primitives.model.phase.tracking import PhaseTrack, track_phase


class Limits(NamedTuple):
    """Limits of a track: least number of cycles and greatest unexplained variance."""

    cycles: float
    unexplained: float


# Unexplained fraction of the variance below which no other period is tried. One cycle
# leaves 0.3 to 0.7 % of hand-guided movements unexplained. If one stroke is mistaken
# for a cycle of three, 3.5 to 7 % are left.
CLEAR_MISFIT = 0.015
# Limits in the order of use. Few cycles suffice where they were found by alignment, because
# that is evidence of a repetition.
STRICT, ALIGNED, LENIENT = Limits(4.0, 0.05), Limits(1.25, 0.15), Limits(3.0, 0.1)
# Fraction of the variance that slow displacements of the centre may take, above which strokes
# may be beside one another, and below which no other period is tried. Real cycles: up to 0.05.
_MOST_SHIFTED, WANDERING, _STEADY = 0.5, 0.3, 0.05
# Bounds of the mean phase velocity relative to its initial estimate.
_VELOCITIES = (0.6, 1.6)
# Shortest bout, samples.
SHORTEST_BOUT = 12
# Shortest bout, in periods, and harmonics of its initial cycle.
_LEAST_BOUT, _HARMONICS = 0.5, 6
# Misfit of a sample that is left out.
_LEFT_OUT_MISFIT = 0.13
# Least number of omitted parts, in total and per cycle, that shows that a part of each cycle
# is left out.
_LEAST_GAPS, _GAPS_PER_CYCLE = 3, 0.8


class Attempt(NamedTuple):
    """Attempt with one period: labels (n,) of the samples, and the track of the bouts."""

    labels: list[Indices]
    track: PhaseTrack
    period: float

    @property
    def bouts(self) -> list[Mask]:
        """Masks (n,) of the samples in bouts."""
        return [label == FORWARDS for label in self.labels]

    @property
    def gaps(self) -> int:
        """Number of parts that are left out between bouts."""
        return sum(max(0, len(runs(mask)) - 1) for mask in self.bouts)

    @property
    def samples(self) -> int:
        """Number of samples in bouts."""
        return sum(map(np.count_nonzero, self.bouts))

    @classmethod
    def of(
        cls, recordings: Sequence[Array], period: float, *, is_known: bool = False
    ) -> "Attempt | None":
        """Segment recordings and track the phase of the bouts; None where there are none.

        Where the period is known but no cycle is found, all samples that repeat are bouts, or
        all samples if none repeats.
        """
        aligned = aligned_samples(recordings, period)
        segmentation = segment(recordings, aligned, period)
        bouts, cycle = list[Array](), None
        if segmentation is not None:
            labels = segmentation.labels
            shortest = max(SHORTEST_BOUT, _LEAST_BOUT * period)
            for label in labels:
                for a, b in runs(label == FORWARDS):
                    if b - a < shortest:
                        label[a:b] = OUTSIDE
            masks = [label == FORWARDS for label in labels]
            phases, bouts = (
                segments(segmentation.phases, masks),
                segments(recordings, masks),
            )
            if 0 < sum(map(len, bouts)) < sum(map(len, recordings)):
                # Without other parts, the phase begins where one of the cycles does.
                harmonics = harmonics_of(period, _HARMONICS)
                cycle = Cycle.fit(phases, bouts, harmonics=harmonics)
        if is_known and max(map(len, bouts), default=0) < period + 1:
            labels = [np.where(mask, FORWARDS, OUTSIDE) for mask in aligned]
            bouts, cycle = segments(recordings, aligned), None
        if max(map(len, bouts), default=0) < period + 1:
            return None
        track = track_phase(bouts, period=period, cycle=cycle)
        return cls(labels, track, period)

    def with_similar_cycles(
        self, recordings: Sequence[Array], labels: Sequence[Indices]
    ) -> "Attempt":
        """Add the cycles before and after each bout that are similar to its first and last.

        They may be wider, for example, at the beginning of a recording. The labels are changed
        where they are `OUTSIDE`.
        """
        size = round(self.track.period)
        is_changed = False
        for y, known, label in zip(recordings, self.labels, labels, strict=True):
            similar = similarity(y, size, size) > SIMILAR
            for a, b in runs(known == FORWARDS):
                start, end = a, b
                if b - a >= size:
                    while start >= size and similar[start - size]:
                        start -= size
                    while end + size <= len(y) and similar[end - size]:
                        end += size
                for part in (slice(start, a), slice(b, end)):
                    if len(label[part]) and np.all(label[part] == OUTSIDE):
                        known[part] = label[part] = FORWARDS
                        is_changed = True
        if not is_changed:
            return self
        track = track_phase(
            segments(recordings, [known == FORWARDS for known in self.labels]),
            period=self.track.period,
            cycle=self.track.cycle,
        )
        return self._replace(track=track)

    def objection(self, limits: Limits) -> str:
        """Return the reason why a phase model cannot be learned; "" where it can."""
        track = self.track
        if track.cycles < limits.cycles:
            count = cycle_count(track.cycles)
            return f"it has {count}; the phase model needs {limits.cycles:g}."
        if track.unexplained > limits.unexplained:
            return (
                f"one cycle leaves {100 * track.unexplained:.0f} % of its variance "
                f"unexplained; the phase model needs at most {100 * limits.unexplained:.0f} %."
            )
        if track.shifted > _MOST_SHIFTED:
            return (
                f"the centre of its cycles wanders, which makes {100 * track.shifted:.0f} % "
                f"of its variance; the phase model needs at most {100 * _MOST_SHIFTED:.0f} %."
            )
        if self.gaps >= max(_LEAST_GAPS, _GAPS_PER_CYCLE * track.cycles):
            return "a part of each cycle is left out, so this is not the period."
        period = track.period
        if not _VELOCITIES[0] < self.period / period < _VELOCITIES[1]:
            return (
                f"it seems to repeat after {self.period:.0f} samples, but its cycles last "
                f"{period:.0f}."
            )
        return ""

    @property
    def misfit(self) -> float:
        """Fraction of unexplained variance, with a penalty for large shifts.

        The mean of n cycles explains 1 / n of any variance, which is corrected for.
        """
        track = self.track
        explainable = 1 - 1 / max(track.cycles, ALIGNED.cycles)
        return (track.unexplained + track.shifted**2 / 4) / explainable

    @property
    def is_clear(self) -> bool:
        """Whether one cycle explains most samples exactly."""
        # A stroke of a longer cycle has a centre that moves, or is not like all strokes.
        track = self.track
        is_whole = track.shifted <= _STEADY and self.gaps < track.cycles / 2
        is_most = 2 * self.samples > sum(map(len, self.labels))
        return is_most and is_whole and self.misfit <= CLEAR_MISFIT

    def cost(self, rival: "Attempt | None" = None) -> float:
        """Return the mean misfit of samples inside and outside the bouts.

        The mean is over all samples or, with a rival, over those in bouts of either.
        """
        count = sum(map(len, self.labels))
        if rival is not None:
            both = zip(self.bouts, rival.bouts, strict=True)
            count = sum(int(np.count_nonzero(one | other)) for one, other in both)
        fraction = self.samples / count
        return fraction * self.misfit + (1 - fraction) * _LEFT_OUT_MISFIT
