"""Rhythm of recordings: bouts, omitted parts, changes, and their description."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from fmp_drake.numeric import Array, Indices
from fmp_drake.primitives.data.channels import listed
from fmp_drake.primitives.model.phase.cycle import ONE_CYCLE
from fmp_drake.primitives.model.phase.segmentation import (
    BACKWARDS,
    FORWARDS,
    OUTSIDE,
)
from fmp_drake.primitives.model.phase.tracking import PhaseTrack

# Fraction of the recorded time that is left out, above which a remark is made.
_LARGE_FRACTION = 0.2
# Least relative change from the first to the last cycle that is reported, also in standard
# errors.
_LEAST_CHANGE, _STANDARD_ERRORS = 0.25, 3.0
# Least drift that is reported.
_LEAST_DRIFT = 0.1
# Quantile of the distances of a lift from its median position, and its least value relative
# to the size of the movement.
_AWAY_QUANTILE, _AWAY = 0.75, 0.2
OTHER = 3
"""Label of samples of another movement, beside those of a segmentation."""
_KINDS = {FORWARDS: "bout", BACKWARDS: "backwards", OTHER: "another movement"}


def cycle_count(cycles: float) -> str:
    """Return a number of cycles as text: `1 cycle`, `2.5 cycles`."""
    text = f"{cycles:.1f}"
    return "1 cycle" if text == "1.0" else f"{text} cycles"


@dataclass(frozen=True, kw_only=True)
class Part:
    """Interval of a recording.

    Attributes
    ----------
    recording : int
        Index of the recording.
    start, end : float
        s, from the beginning of the recording.
    kind : str
        "bout", or the reason for leaving it out: "approach", "retreat", "pause", "lift"
        (a departure from the movement and return), "backwards", "another movement", or
        "no cycle" for a whole recording.
    cycle_ends : tuple of float
        s, of a bout: instants at which whole cycles since its start end, or since that of
        the bout before a pause in few cycles. Not compared.
    """

    recording: int
    start: float
    end: float
    kind: str
    cycle_ends: tuple[float, ...] = field(default=(), compare=False)

    @property
    def duration(self) -> float:
        """Duration, s."""
        return self.end - self.start


@dataclass(frozen=True, kw_only=True)
class Rhythm:
    """Period, cycles, bouts and omitted parts of recordings.

    Attributes
    ----------
    period : float
        Mean duration of a cycle, s.
    cycles : float
        Number of cycles in all bouts.
    bouts, left_out : tuple of Part
        Parts that are learned from, and omitted parts.
    amplitude_change, tempo_change : float
        Change along the recordings relative to the mean, from a linear fit; 0 where it is
        not significant.
    drift : float
        Displacement of the centre along the recordings, relative to the width.
    irregular : tuple of str
        Channels that do not repeat; the phase is that of the other channels.

    Examples
    --------
    >>> bout = Part(recording=0, start=2.0, end=10.0, kind="bout")
    >>> approach = Part(recording=0, start=0.0, end=2.0, kind="approach")
    >>> rhythm = Rhythm(period=2.0, cycles=4.0, bouts=(bout,), left_out=(approach,))
    >>> for line in rhythm.describe():
    ...     print(line)
    4.0 cycles of 2.00 s
    left out: approach, 0.0 to 2.0 s
    """

    period: float
    cycles: float
    bouts: tuple[Part, ...]
    left_out: tuple[Part, ...] = ()
    amplitude_change: float = 0.0
    tempo_change: float = 0.0
    drift: float = 0.0
    irregular: tuple[str, ...] = ()

    @property
    def is_one_cycle(self) -> bool:
        """Whether it is one closed cycle, which is repeated."""
        return self.cycles < ONE_CYCLE

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts: the bouts, then the omitted parts."""
        return (*self.bouts, *self.left_out)

    @property
    def fraction_left_out(self) -> float:
        """Fraction of the recorded time that is left out."""
        omitted = sum(part.duration for part in self.left_out)
        return omitted / (omitted + sum(part.duration for part in self.bouts))

    def with_parts(self, parts: Iterable[Part]) -> "Rhythm":
        """Return the rhythm with other bouts and omitted parts, in the order of time."""
        ordered = sorted(parts, key=lambda part: (part.recording, part.start))
        bouts, left_out = _split_kinds(ordered)
        return replace(self, bouts=bouts, left_out=left_out)

    def located(self, origins: Sequence[tuple[int, float]], start: float) -> "Rhythm":
        """Return the rhythm of the demonstrations that the recordings are parts of.

        Parameters
        ----------
        origins : sequence of (int, float)
            Index of each recording's demonstration, and its start there, s; empty where
            the recordings are whole.
        start : float
            Time of the demonstrations before these starts, s.
        """

        def shift(part: Part) -> Part:
            number, seconds = part.recording, start
            if origins:
                number, seconds = origins[number][0], start + origins[number][1]
            return replace(
                part,
                recording=number,
                start=part.start + seconds,
                end=part.end + seconds,
                cycle_ends=tuple(end + seconds for end in part.cycle_ends),
            )

        return self.with_parts(map(shift, self.parts))

    def describe(self) -> list[str]:
        """Return lines about cycles and omitted parts, and remarks."""
        bouts = f" in {len(self.bouts)} bouts" if len(self.bouts) > 1 else ""
        lines = [f"{cycle_count(self.cycles)} of {self.period:.2f} s{bouts}"]
        recordings = {part.recording for part in self.parts}
        parts = [
            f"{part.kind}, {part.start:.1f} to {part.end:.1f} s"
            + f" of recording {part.recording + 1}" * (len(recordings) > 1)
            for part in self.left_out
        ]
        if parts:
            lines.append(f"left out: {'; '.join(parts)}")
        return lines + self.remarks()

    def remarks(self) -> list[str]:
        """Return remarks on unusual recordings."""
        out = []
        if self.is_one_cycle:
            out.append(
                "it is one closed cycle, which is repeated; record two or more to show how "
                "cycles differ"
            )
        if self.irregular:
            out.append(
                f"these channels differ from cycle to cycle: {listed(self.irregular)}; "
                "the cycles are those of the other channels"
            )
        kinds = {part.kind for part in self.left_out}
        if "backwards" in kinds:
            out.append(
                "the direction reverses: the shorter part, in the opposite direction, is "
                "left out; record one direction, or choose a part (--from, --to)"
            )
        if "another movement" in kinds:
            out.append(
                "there are two movements: one of them is left out; learn a skill of each "
                "(--from, --to)"
            )
        if self.fraction_left_out > _LARGE_FRACTION:
            out.append(
                f"{100 * self.fraction_left_out:.0f} % of the recording is left out"
            )
        for what, change in (
            ("amplitude", self.amplitude_change),
            ("tempo", self.tempo_change),
        ):
            if change:
                grows = "grows" if change > 0 else "falls"
                out.append(
                    f"the {what} {grows} by {100 * abs(change):.0f} % of its mean: the skill "
                    "plays the mean, and its samples cover the same range"
                )
        if self.drift > _LEAST_DRIFT:
            out.append(
                f"the centre drifts by {100 * self.drift:.0f} % of the width: the skill is "
                "played about the middle, and its samples are wider than one cycle"
            )
        return out


def trend(values: Array) -> float:
    """Return the change of positive values (n,) along a line, relative to their mean.

    It is 0 if it is small or not significant.
    """
    count = len(values)
    if count < 4:
        return 0.0
    offsets = np.arange(count) - (count - 1) / 2
    slope = float(offsets @ values) / float(offsets @ offsets)
    errors = values - values.mean() - slope * offsets
    deviation = np.sqrt(float(errors @ errors) / (count - 2) / float(offsets @ offsets))
    change = slope * (count - 1) / float(values.mean())
    is_significant = abs(slope) > _STANDARD_ERRORS * deviation
    return change if is_significant and abs(change) > _LEAST_CHANGE else 0.0


def rhythm_of_labels(
    recordings: Sequence[Array],
    labels: Sequence[Indices],
    track: PhaseTrack,
    starts: Sequence[int],
    rate: float,
) -> Rhythm:
    """Return the rhythm of labels (n,) of all samples, and of the track of the bouts.

    A bout may begin, at a turn, before the first sample of its track; `starts` are the
    indices of these first samples.
    """
    history = track.history
    points = np.concatenate(track.recordings)
    size = float(np.sqrt(points.var(axis=0).sum()))
    parts = []
    for i, (y, label) in enumerate(zip(recordings, labels, strict=True)):
        edges = [0, *(np.flatnonzero(np.diff(label)) + 1).tolist(), len(label)]
        for a, b in pairwise(edges):
            kind = _kind(y, label, a, b, size)
            parts.append(Part(recording=i, start=a / rate, end=b / rate, kind=kind))
    bouts, left_out = _split_kinds(parts)
    if len(bouts) == len(track.phases):
        bouts = tuple(
            replace(bout, cycle_ends=_cycle_ends(phase, start, rate))
            for bout, phase, start in zip(bouts, track.phases, starts, strict=True)
        )
    return Rhythm(
        period=track.period / rate,
        cycles=track.cycles,
        bouts=bouts,
        left_out=left_out,
        amplitude_change=trend(history.amplitudes),
        tempo_change=trend(1 / history.lengths),
        drift=float(np.max(np.abs(history.drift)) / np.max(np.ptp(points, axis=0))),
    )


def _cycle_ends(phase: Array, start: int, rate: float) -> tuple[float, ...]:
    """Return the instants, s, at which a phase (n,) has grown by whole turns.

    The index of its first sample in the recording is `start`.
    """
    growth = np.maximum.accumulate(phase - phase[0]) / (2 * np.pi)
    steps = np.interp(np.arange(1.0, growth[-1]), growth, np.arange(len(phase)))
    return tuple(((start + steps) / rate).tolist())


def _split_kinds(parts: Sequence[Part]) -> tuple[tuple[Part, ...], tuple[Part, ...]]:
    """Split parts into bouts and omitted parts."""
    bouts = tuple(part for part in parts if part.kind == "bout")
    return bouts, tuple(part for part in parts if part.kind != "bout")


def _kind(values: Array, label: Indices, start: int, end: int, size: float) -> str:
    """Return the kind of a segment of a recording; see `Part`."""
    if label[start] != OUTSIDE:
        return _KINDS[label[start]]
    if start == 0:
        return "approach" if end < len(values) else "no cycle"
    if end == len(values):
        return "retreat"
    part = values[start:end]
    distances = np.linalg.norm(part - np.median(part, axis=0), axis=1)
    is_away = np.quantile(distances, _AWAY_QUANTILE) > _AWAY * size
    return "lift" if is_away else "pause"
