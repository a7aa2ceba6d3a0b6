"""Search for the rhythm of recordings: period, bouts and phase of each sample."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Indices, Mask, check_number, runs
from fmp_drake.primitives.data.channels import (
    channel_scales,
    default_channels,
)
from fmp_drake.primitives.data.demonstration import Demonstration
from fmp_drake.primitives.data.windows import (
    DEFAULT_RATE,
    as_windows,
    cut_demonstrations,
    demonstration_list,
)
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.loops import join_loops
from fmp_drake.primitives.model.phase.period import (
    SIMILAR,
    local_periods,
    noise_fractions,
    possible_periods,
    similarity,
)
from fmp_drake.primitives.model.phase.rhythm import (
    OTHER,
    Part,
    Rhythm,
    rhythm_of_labels,
    split_kinds,
)
from fmp_drake.primitives.model.phase.segmentation import (
    BACKWARDS,
    FORWARDS,
    OUTSIDE,
    segment,
)
from fmp_drake.primitives.model.phase.self_alignment import (
    aligned_period,
    aligned_samples,
)
from fmp_drake.primitives.model.phase.tracking import (
    PhaseTrack,
    track_phase,
)


class _Limits(NamedTuple):
    """Limits of a track: least number of cycles and greatest unexplained variance."""

    cycles: float
    unexplained: float


# Unexplained fraction of the variance below which no other period is tried. One cycle
# leaves 0.3 to 0.7 % of hand-guided movements unexplained. If one stroke is mistaken
# for a cycle of three, 3.5 to 7 % are left.
_CLEAR_MISFIT = 0.015
# Misfit of a shorter period relative to the best, up to which it is preferred.
_MISFIT_RATIO = 4.0
# Limits in the order of use. Few cycles suffice where they were found by alignment, because
# that is evidence of a repetition.
_STRICT, _ALIGNED, _LENIENT = _Limits(4.0, 0.05), _Limits(1.25, 0.15), _Limits(3.0, 0.1)
# Fraction of the variance that slow displacements of the centre may take, and below which no
# other period is tried.
_MOST_SHIFTED, _STEADY = 0.5, 0.05
# Bounds of the mean phase velocity relative to its initial estimate.
_VELOCITIES = (0.6, 1.6)
# Greatest relative difference between candidates that count as equal, between a candidate
# and an attempt that makes it superfluous, and between estimates that confirm each other.
_SAME, _SIMILAR, _NEAR = 0.05, 0.15, 0.25
# Shortest bout, samples.
_SHORTEST_BOUT = 12
# Shortest bout, in periods, and harmonics of its initial cycle.
_LEAST_BOUT, _HARMONICS = 0.5, 6
# Least duration of another movement, in periods.
_LEAST_OTHER = 1.5
# Misfit of a sample that is left out.
_LEFT_OUT_MISFIT = 0.13
# Least number of omitted parts, in total and per cycle, that shows that a part of each cycle
# is left out.
_LEAST_GAPS, _GAPS_PER_CYCLE = 3, 0.8
# Noise of a channel that the phase ignores: least fraction of its own variance, and of the
# variance of all channels.
_NOISE, _POWER = 0.5, 0.02
# Misfit of a subset of channels relative to that of all, below which it is preferred.
_FEWER_CHANNELS = 0.75
# Units of the channels that are searched separately, in this order.
_MOTION_UNITS = ("m", "rad")


class TrackedRhythm(NamedTuple):
    """Rhythm of recordings, and the phase of the samples in its bouts.

    Attributes
    ----------
    rhythm : Rhythm
    track : PhaseTrack
        Of all channels, also those that do not repeat.
    recordings : sequence of ndarray, shape (n, D)
        The recordings in the order of the search, the longest first; joined where each
        is one cycle.
    misfit : float
        0 for many similar cycles; greater for fewer and less similar ones.
    """

    rhythm: Rhythm
    track: PhaseTrack
    recordings: Sequence[Array]
    misfit: float


class _Attempt(NamedTuple):
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


def find_rhythm(
    demonstrations: Demonstration | Sequence[Demonstration],
    *,
    start_time: float | None = None,
    end_time: float | None = None,
    period: float | None = None,
) -> Rhythm:
    """Find period, cycles and bouts of demonstrations, as a skill that learns them does.

    Parameters
    ----------
    demonstrations : Demonstration, or a sequence of them
    start_time, end_time : float, optional
        Part of every demonstration to search, s from its first sample.
    period : float, optional
        Duration of a cycle, s; estimated where None.

    Raises
    ------
    DemonstrationError
        If nothing repeats, there are too few cycles, or one cycle does not explain
        the demonstrations.

    Examples
    --------
    >>> time = np.arange(0, 30, 0.05)
    >>> circles = 0.1 * np.column_stack([np.cos(3 * time), np.sin(3 * time)])
    >>> rhythm = find_rhythm(Demonstration(time=time, values=circles))
    >>> rhythm.describe()
    ['14.3 cycles of 2.09 s']
    """
    demonstrations = demonstration_list(demonstrations, "find_rhythm")
    if period is not None:
        least = 8 / DEFAULT_RATE
        check_number(period, "period", least=least, unit="s", error=DemonstrationError)
    cut = cut_demonstrations(demonstrations, start_time, end_time, DEFAULT_RATE)
    windows = as_windows(cut, n_steps=1, stride=1, rate=DEFAULT_RATE, at_least=0)
    recordings, units = windows.recordings(), cut[0].units
    scales = channel_scales("units", np.concatenate(recordings), units)
    tracked = search_rhythm(
        [y / scales for y in recordings],
        rate=DEFAULT_RATE,
        period=period,
        units=dict(zip(cut[0].channels, units, strict=True)),
    )
    return tracked.rhythm.located(windows.origins(), start_time or 0.0)


def search_rhythm(
    recordings: Sequence[Array],
    *,
    rate: float,
    period: float | None = None,
    units: Mapping[str, str] | None = None,
) -> TrackedRhythm:
    """Find the rhythm of recordings (n, D), and the phase of their rhythmic samples.

    Approach, retreat, lifts, pauses and parts of another movement are left out; all
    bouts between them are used. Where the estimated period does not explain the bouts,
    others are tried. A cycle that consists of several equal ones is replaced by one of
    them. Recordings of one cycle each, which begin where another one ends, are joined.
    The order of the recordings does not matter.

    Channels of noise are ignored. Where the others do not repeat together, positions are
    searched without them, then angles.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
        At the rate, divided by the scales of their channels.
    rate : float
        Hz.
    period : float, optional
        s, where it is known.
    units : mapping from str to str, optional
        Unit of each channel, by its name; positions where None.

    Raises
    ------
    DemonstrationError
        If nothing repeats, there are too few cycles, or one cycle does not explain
        the recordings.
    """
    order = sorted(
        range(len(recordings)),
        key=lambda i: (-len(recordings[i]), recordings[i].tobytes()),
    )
    ordered = [recordings[i] for i in order]
    if units is None:
        units = dict.fromkeys(default_channels(ordered[0].shape[1]), "m")
    best: tuple[float, list[int], TrackedRhythm, Iterable[Part]] | None = None
    refusal: DemonstrationError | None = None
    for columns in _column_choices(ordered, tuple(units.values())):
        try:
            tracked, parts = _search_or_join(ordered, columns, rate, period)
        except DemonstrationError as error:
            refusal = refusal or error
            continue
        if best is None or tracked.misfit < _FEWER_CHANNELS * best[0]:
            best = tracked.misfit, columns, tracked, parts
        if not tracked.misfit:
            break
    if best is None:
        raise refusal or DemonstrationError("there is no channel.")
    _, columns, tracked, parts = best
    parts = (replace(part, recording=order[part.recording]) for part in parts)
    bouts, left_out = split_kinds(sorted(parts, key=lambda p: (p.recording, p.start)))
    irregular = (name for i, name in enumerate(units) if i not in columns)
    rhythm = replace(
        tracked.rhythm, bouts=bouts, left_out=left_out, irregular=tuple(irregular)
    )
    return tracked._replace(rhythm=rhythm)


def _column_choices(
    recordings: Sequence[Array], units: Sequence[str]
) -> Iterator[list[int]]:
    """Yield the columns to search: those without noise, the positions, the angles."""
    variance = np.sum([len(y) * y.var(axis=0) for y in recordings], axis=0)
    noise = noise_fractions(recordings)
    is_noise = (noise > _NOISE) & (noise * variance > _POWER * variance.sum())
    steady = np.flatnonzero(~is_noise).tolist() or list(range(len(units)))
    yield steady
    groups = [[i for i in steady if units[i] == unit] for unit in _MOTION_UNITS]
    yield from (g for g in groups if 1 < len(g) < len(steady))


def _search_or_join(
    recordings: Sequence[Array], columns: list[int], rate: float, period: float | None
) -> tuple[TrackedRhythm, Iterable[Part]]:
    """Find the rhythm of separate or joined recordings; return it and its parts."""
    loops = None
    try:
        tracked = _search(recordings, columns, rate, period)
    except DemonstrationError as error:
        if (loops := join_loops(recordings, columns)) is None:
            raise
        try:
            tracked = _search([loops.values], columns, rate, period)
        except DemonstrationError:
            raise error from None
    parts = (*tracked.rhythm.bouts, *tracked.rhythm.left_out)
    return tracked, loops.parts(parts, rate) if loops else parts


def _search(
    all_channels: Sequence[Array], columns: list[int], rate: float, period: float | None
) -> TrackedRhythm:
    """Find the rhythm of some columns of recordings; see `search_rhythm`."""
    recordings = [np.ascontiguousarray(y[:, columns]) for y in all_channels]
    best, limits = _best_attempt(
        recordings, _candidates(recordings, rate, period), is_known=period is not None
    )
    labels, other = _with_other_movement(recordings, best, rate)
    if period is None and other and other.samples > best.samples:
        # The longer movement is the one that is learned.
        longer = _attempt(recordings, other.track.period)
        if longer and longer.samples > best.samples and not _objection(longer, limits):
            best = longer
            labels, _ = _with_other_movement(recordings, best, rate)
    best = _add_similar_cycles(recordings, best, labels)
    starts = [a for mask in best.bouts for a, _ in runs(mask)]
    rhythm = rhythm_of_labels(recordings, labels, best.track, starts, rate)
    track = best.track
    if len(columns) < all_channels[0].shape[1]:
        track = track.with_channels(_cut(all_channels, best.bouts))
    misfit = 0.0 if limits is _STRICT else _misfit(best) / best.track.cycles
    return TrackedRhythm(rhythm, track, all_channels, misfit)


def _best_attempt(
    recordings: Sequence[Array], candidates: Iterable[float], *, is_known: bool
) -> tuple[_Attempt, _Limits]:
    """Return the attempt that explains the recordings best, and the limits it satisfies."""
    attempts = _attempts(recordings, candidates, is_known=is_known)
    limits = _STRICT
    acceptable = [a for a in attempts if not _objection(a, limits)]
    best = min(acceptable, key=_cost, default=None)
    if not is_known and not (best and _is_clear(best)):
        few = _attempt_of_few_cycles(recordings)
        # One stroke of a few cycles repeats more often, but less exactly than they do.
        if few and (
            best is None or _MISFIT_RATIO * _cost(few, best) < _cost(best, few)
        ):
            acceptable, limits = [few], _ALIGNED
    if not acceptable:
        limits = _ALIGNED if is_known else _LENIENT
        acceptable = [a for a in attempts if not _objection(a, limits)]
    if not acceptable:
        refusals = [
            _objection(a, limits) for a in attempts if a.track.cycles >= limits.cycles
        ]
        raise DemonstrationError(
            refusals[0]
            if refusals
            else "no part of it comes again in another cycle; record at least two "
            "full cycles."
        )
    best = min(acceptable, key=_cost)
    if limits is _LENIENT:
        # With few cycles, choose the shortest period among those of similar misfit.
        most = max(_CLEAR_MISFIT, _MISFIT_RATIO * _misfit(best))
        comparable = [a for a in acceptable if _misfit(a) <= most]
        best = max(comparable, key=lambda attempt: attempt.track.cycles)
    while not is_known and (n := best.track.cycle.repetitions(_CLEAR_MISFIT)) > 1:
        attempt = _attempt(recordings, best.track.period / n)
        if (
            attempt is None
            or _objection(attempt, limits)
            or attempt.track.unexplained > _CLEAR_MISFIT
        ):
            break
        best = attempt
    return best, limits


def _attempt_of_few_cycles(recordings: Sequence[Array]) -> _Attempt | None:
    """Return the attempt with the period of the best alignment, unless it is refused."""
    period = aligned_period(recordings)
    attempt = _attempt(recordings, period) if period else None
    return attempt if attempt and not _objection(attempt, _ALIGNED) else None


def _attempts(
    recordings: Sequence[Array], candidates: Iterable[float], *, is_known: bool
) -> list[_Attempt]:
    """Attempt candidates of the period until one explains the recordings clearly."""
    attempts: list[_Attempt] = []
    for candidate in candidates:
        # An attempt finds the same cycle from similar periods.
        if any(abs(candidate / a.track.period - 1) < _SIMILAR for a in attempts):
            continue
        attempt = _attempt(recordings, candidate, is_known=is_known)
        if attempt is None:
            continue
        attempts.append(attempt)
        if _is_clear(attempt) and not _objection(attempt, _STRICT):
            break
    return attempts


def _is_clear(attempt: _Attempt) -> bool:
    """Return whether one cycle explains most samples exactly."""
    # A stroke of a longer cycle has a centre that moves, or is not like all strokes.
    track = attempt.track
    is_whole = track.shifted <= _STEADY and attempt.gaps < track.cycles / 2
    is_most = 2 * attempt.samples > sum(map(len, attempt.labels))
    return is_most and is_whole and _misfit(attempt) <= _CLEAR_MISFIT


def _cost(attempt: _Attempt, rival: _Attempt | None = None) -> float:
    """Return the mean misfit of samples inside and outside the bouts of an attempt.

    The mean is over all samples or, with a rival, over those in bouts of either.
    """
    count = sum(map(len, attempt.labels))
    if rival is not None:
        both = zip(attempt.bouts, rival.bouts, strict=True)
        count = sum(int(np.count_nonzero(one | other)) for one, other in both)
    fraction = attempt.samples / count
    return fraction * _misfit(attempt) + (1 - fraction) * _LEFT_OUT_MISFIT


def _with_other_movement(
    recordings: Sequence[Array], attempt: _Attempt, rate: float
) -> tuple[list[Indices], _Attempt | None]:
    """Return labels (n,) that mark another movement, and the attempt at that movement.

    It is the rhythm of the parts that are left out, if they have one.
    """
    labels = [label.copy() for label in attempt.labels]
    parts = [
        (y[a:b], label[a:b])
        for y, label in zip(recordings, labels, strict=True)
        for a, b in runs(label == OUTSIDE)
        if b - a >= _LEAST_OTHER * attempt.period
    ]
    other = None
    if parts:
        values = [value for value, _ in parts]
        with contextlib.suppress(DemonstrationError):
            candidates = _candidates(values, rate, None)
            other, _ = _best_attempt(values, candidates, is_known=False)
            for (_, label), found in zip(parts, other.labels, strict=True):
                label[found != OUTSIDE] = OTHER
    # Transitions between two movements, or directions, are short.
    shortest = max(_SHORTEST_BOUT, round(attempt.period))
    for label in labels:
        for a, b in runs(label == OUTSIDE):
            if a == 0 or b == len(label) or b - a >= shortest:
                continue
            before, after = int(label[a - 1]), int(label[b])
            if {before, after} == {FORWARDS, BACKWARDS}:
                # A movement slows down before the turn as long as it accelerates after it.
                label[a : (a + b) // 2] = before
                label[(a + b) // 2 : b] = after
            elif {before, after} != {FORWARDS}:
                label[a:b] = max(before, after)
    return labels, other


def _misfit(attempt: _Attempt) -> float:
    """Return the fraction of unexplained variance, with a penalty for large shifts.

    The mean of n cycles explains 1 / n of any variance, which is corrected for.
    """
    track = attempt.track
    explainable = 1 - 1 / max(track.cycles, _ALIGNED.cycles)
    return (track.unexplained + track.shifted**2 / 4) / explainable


def _candidates(
    recordings: Sequence[Array], rate: float, period: float | None
) -> Iterator[float]:
    """Yield candidates of the period, samples, the most likely first."""
    if period is not None:
        yield period * rate
        return
    local = local_periods(recordings)
    bouts = list(recordings)
    if local:
        masks = aligned_samples(recordings, local[0])
        bouts = _cut(recordings, masks) or bouts
    try:
        estimates = possible_periods(bouts)
    except DemonstrationError:
        estimates = []
    confirmed = [p for p in estimates[:1] if local and abs(p / local[0] - 1) < _NEAR]
    samples = sum(map(len, recordings))
    previous: list[float] = []
    for candidate in (*confirmed, *local, *estimates):
        if samples < _ALIGNED.cycles * candidate:
            continue
        if all(abs(candidate / other - 1) > _SAME for other in previous) and not (
            confirmed and candidate in local[:1]
        ):
            previous.append(candidate)
            yield candidate


def _cut(recordings: Sequence[Array], masks: Sequence[Mask]) -> list[Array]:
    """Return the segments of recordings where masks are true."""
    return [
        y[a:b] for y, mask in zip(recordings, masks, strict=True) for a, b in runs(mask)
    ]


def _attempt(
    recordings: Sequence[Array], period: float, *, is_known: bool = False
) -> _Attempt | None:
    """Segment recordings and track the phase of the bouts; None where there are none.

    Where the period is known but no cycle is found, all samples that repeat are bouts, or
    all samples if none repeats.
    """
    aligned = aligned_samples(recordings, period)
    segmentation = segment(recordings, aligned, period)
    bouts, cycle = list[Array](), None
    if segmentation is not None:
        labels = segmentation.labels
        shortest = max(_SHORTEST_BOUT, _LEAST_BOUT * period)
        for label in labels:
            for a, b in runs(label == FORWARDS):
                if b - a < shortest:
                    label[a:b] = OUTSIDE
        masks = [label == FORWARDS for label in labels]
        phases, bouts = _cut(segmentation.phases, masks), _cut(recordings, masks)
        if 0 < sum(map(len, bouts)) < sum(map(len, recordings)):
            # Without other parts, the phase begins where one of the cycles does.
            harmonics = max(1, min(_HARMONICS, int(period / 2 - 2)))
            cycle = Cycle.fit(phases, bouts, harmonics=harmonics)
    if max(map(len, bouts), default=0) < period + 1:
        if not is_known:
            return None
        labels = [np.where(mask, FORWARDS, OUTSIDE) for mask in aligned]
        bouts, cycle = _cut(recordings, aligned), None
        if max(map(len, bouts), default=0) < period + 1:
            return None
    track = track_phase(bouts, period=period, cycle=cycle)
    return _Attempt(labels, track, period)


def _add_similar_cycles(
    recordings: Sequence[Array], attempt: _Attempt, labels: Sequence[Indices]
) -> _Attempt:
    """Add to each bout the cycles before and after it that are similar to its first and last.

    They may be wider, for example, at the beginning of a recording. The labels are changed
    where they are `OUTSIDE`.
    """
    size = round(attempt.track.period)
    is_changed = False
    for y, known, label in zip(recordings, attempt.labels, labels, strict=True):
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
        return attempt
    track = track_phase(
        _cut(recordings, [known == FORWARDS for known in attempt.labels]),
        period=attempt.track.period,
        cycle=attempt.track.cycle,
    )
    return attempt._replace(track=track)


def _objection(attempt: _Attempt, limits: _Limits) -> str:
    """Return the reason why a phase model cannot be learned; "" where it can."""
    track = attempt.track
    if track.cycles < limits.cycles:
        return f"it has {track.cycles:.1f} cycles; the phase model needs {limits.cycles:g}."
    if track.unexplained > limits.unexplained:
        return (
            f"one cycle leaves {100 * track.unexplained:.0f} % of its variance "
            f"unexplained; the phase model needs at most {100 * limits.unexplained:.0f} %."
        )
    if track.shifted > _MOST_SHIFTED:
        return (
            f"the centre of its cycles wanders, which makes {100 * track.shifted:.0f} % of its "
            f"variance; the phase model needs at most {100 * _MOST_SHIFTED:.0f} %."
        )
    if attempt.gaps >= max(_LEAST_GAPS, _GAPS_PER_CYCLE * track.cycles):
        return "a part of each cycle is left out, so this is not the period."
    period = track.period
    if not _VELOCITIES[0] < attempt.period / period < _VELOCITIES[1]:
        return (
            f"it seems to repeat after {attempt.period:.0f} samples, but its cycles last "
            f"{period:.0f}."
        )
    return ""
