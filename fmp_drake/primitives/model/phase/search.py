"""Search for the rhythm of recordings: period, bouts and phase of each sample."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Indices, check_number, runs
from fmp_drake.primitives.data.channels import channel_scales, default_channels
from fmp_drake.primitives.data.demonstration import Demonstration
from fmp_drake.primitives.data.windows import (
    DEFAULT_RATE,
    as_windows,
    cut_demonstrations,
    demonstration_list,
)
from fmp_drake.primitives.model.phase.attempt import (
    ALIGNED,
    CLEAR_MISFIT,
    LENIENT,
    SHORTEST_BOUT,
    STRICT,
    WANDERING,
    Attempt,
    Limits,
)
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.loops import (
    Loops,
    closed_cycle,
    is_direct,
    join_loops,
)
from fmp_drake.primitives.model.phase.pauses import WithoutPauses, without_pauses
from fmp_drake.primitives.model.phase.period import (
    local_periods,
    noise_fractions,
    possible_periods,
)
from fmp_drake.primitives.model.phase.rhythm import (
    OTHER,
    Part,
    Rhythm,
    cycle_count,
    rhythm_of_labels,
)
from fmp_drake.primitives.model.phase.segmentation import (
    BACKWARDS,
    FORWARDS,
    OUTSIDE,
    segments,
)
from fmp_drake.primitives.model.phase.self_alignment import (
    aligned_period,
    aligned_samples,
)
from fmp_drake.primitives.model.phase.tracking import PhaseTrack

# Misfit of a shorter period relative to the best, up to which it is preferred.
_MISFIT_RATIO = 4.0
# Greatest relative difference between candidates that count as equal, between a candidate
# and an attempt that makes it superfluous, and between estimates that confirm each other.
_SAME, _SIMILAR, _NEAR = 0.05, 0.15, 0.25
# Without pauses, another period is preferred up to this misfit relative to that with them, and
# the same one where there are more cycles. Lifts stay where their cutting makes the misfit
# greater than this, relative to that without pauses alone. Smaller misfits do not differ.
_WITHOUT_PAUSES, _MORE_CYCLES, _WITHOUT_LIFTS, _EXACT = 2.0, 0.5, 1.5, 1e-3
# Least number of cycles in noise that hides the similarity of samples.
_TWO_CYCLES = 1.9
# Least duration of another movement, in periods.
_LEAST_OTHER = 1.5
# Noise of a channel that the phase ignores: least fraction of its own variance, and of the
# variance of all channels.
_NOISE, _POWER = 0.5, 0.02
# Misfit of a subset of channels relative to that of all, below which it is preferred.
_FEWER_CHANNELS = 0.75
# Fraction of the variance of another channel that its cycle leaves unexplained, above which
# it differs from cycle to cycle.
_IRREGULAR = 0.5
# Most harmonics of a cycle that was recorded once, and samples for each: with more it plays
# what its straight end leaves unexplained. Long cycles have more.
_HARMONICS, _SAMPLES, _LONG = 20, 10, 20
# Harmonics of the longest cycles; more take gigabytes.
_MOST_HARMONICS = 400
# Most strokes in one closed cycle, for each of which a phase model has two of its 80
# components, and most samples: longer recordings may end where they begin by chance.
_MOST_STROKES, _LONGEST_LAP = 40, 3600
# Most cycles in one place that may be strokes of a lap, of which the others are left out.
_MOST_IN_PLACE = 5
# Turns of a spiral: least change of their amplitude relative to its mean, greatest relative
# difference of its steps from their mean, and greatest part of the lap.
_GROWTH, _UNEQUAL, _PART = 0.5, 0.3, 0.9
# Kinds of parts that may be strokes of a lap.
_WITH_STROKES = ("approach", "retreat", "no cycle", "another movement")
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
        is one cycle, and without pauses that are cut out.
    misfit : float
        0 for many similar cycles; greater for fewer and less similar ones.
    """

    rhythm: Rhythm
    track: PhaseTrack
    recordings: Sequence[Array]
    misfit: float

    def with_parts(self, parts: Iterable[Part]) -> "TrackedRhythm":
        """Return the same with other parts of the rhythm."""
        return self._replace(rhythm=self.rhythm.with_parts(parts))

    def describe(self) -> str:
        """Return the reason for learning it."""
        if self.rhythm.is_one_cycle:
            return "one closed cycle"
        return (
            f"{cycle_count(self.track.cycles)}; one cycle with a varying tempo explains "
            f"{100 * (1 - self.track.unexplained):.1f} % of their variance"
        )


class _NoSteadyCycleError(DemonstrationError):
    """No part of the recordings recurs in another cycle, or only beside it."""


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
    them. Recordings of one cycle each, which begin where another one ends, are joined. A
    single recording in which nothing repeats is one cycle if it ends where it begins.
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
    best: tuple[list[int], TrackedRhythm] | None = None
    refusal: DemonstrationError | None = None
    for columns in _column_choices(ordered, tuple(units.values())):
        try:
            tracked = _Search(ordered, columns, rate, period).best()
        except DemonstrationError as error:
            refusal = refusal or error
            continue
        if best is None or tracked.misfit < _FEWER_CHANNELS * best[1].misfit:
            best = columns, tracked
        if not tracked.misfit:
            break
    if best is None:
        raise refusal or DemonstrationError("there is no channel.")
    columns, tracked = best
    remaining = tracked.track.unexplained_fractions()
    irregular = tuple(
        name
        for i, name in enumerate(units)
        if i not in columns and remaining[i] > _IRREGULAR
    )
    tracked = tracked.with_parts(
        replace(part, recording=order[part.recording]) for part in tracked.rhythm.parts
    )
    return tracked._replace(rhythm=replace(tracked.rhythm, irregular=irregular))


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


class _Search(NamedTuple):
    """Search for a rhythm in some columns of recordings (n, D), the longest first."""

    recordings: Sequence[Array]
    columns: list[int]
    rate: float
    period: float | None

    def best(self) -> TrackedRhythm:
        """Find the rhythm of separate or joined recordings, or of one closed cycle.

        Few cycles are searched without pauses, too.
        """
        recordings, columns = self.recordings, self.columns
        try:
            tracked = self.separate()
        except DemonstrationError as error:
            found = self.edited(without_pauses(recordings, columns))
            found = found or self.edited(join_loops(recordings, columns))
            if found is None and isinstance(error, _NoSteadyCycleError):
                found = self.one_cycle()
            if found is None:
                raise
            return found
        # The channels that do not repeat may wander.
        strokes = tracked._replace(track=tracked.track.of_channels(columns))
        if _may_be_strokes(strokes, recordings[0][:, columns], self.rate):
            found = self.one_cycle()
            if found and _is_lap_of(strokes.track, found.track):
                return found
        if tracked.misfit:
            found = self.edited(without_pauses(recordings, columns))
            if found and _is_better(found, tracked):
                return found
        return tracked

    def edited(self, edits: Iterable[WithoutPauses | Loops]) -> TrackedRhythm | None:
        """Find the rhythm of recordings without pauses, or joined ones.

        An edit without lifts, the first of two, is preferred, unless the other one is much
        better.
        """
        found: TrackedRhythm | None = None
        for edit in edits:
            with contextlib.suppress(DemonstrationError):
                tracked = self._replace(recordings=edit.values).separate()
                misfit = max(tracked.misfit, _EXACT)
                if found is None or _WITHOUT_LIFTS * misfit < found.misfit:
                    parts = edit.parts(tracked.rhythm.parts, self.rate)
                    found = tracked.with_parts(parts)
        return found

    def one_cycle(self) -> TrackedRhythm | None:
        """Return the rhythm of a recording that is one closed cycle."""
        if len(self.recordings) > 1:
            return None
        closed = closed_cycle(self.recordings[0], self.columns)
        if closed is None:
            return None
        values, first, after = closed
        if self.period and abs(len(values) / (self.period * self.rate) - 1) > _NEAR:
            return None
        phase = np.linspace(0.0, 2 * np.pi, len(values))
        track = _track_of_cycle(phase, values, max(_HARMONICS, len(values) // _LONG))
        if track.unexplained > CLEAR_MISFIT:  # It has short strokes.
            track = _track_of_cycle(phase, values, len(values) // _SAMPLES)
        label = np.full(len(self.recordings[0]), OUTSIDE)
        label[first:after] = FORWARDS
        rhythm = rhythm_of_labels(self.recordings, [label], track, [first], self.rate)
        return TrackedRhythm(rhythm, track, self.recordings, np.inf)

    def separate(self) -> TrackedRhythm:
        """Find the rhythm of the recordings as they are; see `search_rhythm`."""
        recordings = [np.ascontiguousarray(y[:, self.columns]) for y in self.recordings]
        is_known = self.period is not None
        candidates = _candidates(recordings, self.rate, self.period)
        best, limits = _best_attempt(recordings, candidates, is_known=is_known)
        labels, other = _with_other_movement(recordings, best, self.rate)
        if not is_known and other and other.samples > best.samples:
            # The longer movement is the one that is learned.
            longer = Attempt.of(recordings, other.track.period)
            if (
                longer
                and longer.samples > best.samples
                and not longer.objection(limits)
            ):
                best = longer
                labels, _ = _with_other_movement(recordings, best, self.rate)
        best = best.with_similar_cycles(recordings, labels)
        starts = [a for mask in best.bouts for a, _ in runs(mask)]
        rhythm = rhythm_of_labels(recordings, labels, best.track, starts, self.rate)
        track = best.track
        if len(self.columns) < self.recordings[0].shape[1]:
            track = track.with_channels(segments(self.recordings, best.bouts))
        misfit = 0.0 if limits is STRICT else best.misfit / best.track.cycles
        return TrackedRhythm(rhythm, track, self.recordings, misfit)


def _may_be_strokes(tracked: TrackedRhythm, path: Array, rate: float) -> bool:
    """Return whether the cycles of a path (n, D) may be the strokes of one closed cycle."""
    track, rhythm = tracked.track, tracked.rhythm
    kinds = {part.kind for part in rhythm.left_out}
    # A spiral returns backwards; a circle that grows may precede another movement.
    is_other = "another movement" in kinds and "backwards" not in kinds
    are_strokes = _has_strokes_of_lap(track) and (_wanders(track) or not is_other)
    return are_strokes or _omits_strokes(rhythm, path, rate)


def _is_lap_of(strokes: PhaseTrack, lap: PhaseTrack) -> bool:
    """Return whether a closed cycle has more than strokes about one centre.

    An eight that grows closes too, but nothing leads back to its beginning.
    """
    return _wanders(strokes) or _samples(strokes) < _PART * _samples(lap)


def _has_strokes_of_lap(track: PhaseTrack) -> bool:
    """Return whether its cycles are beside one another, or the turns of a spiral."""
    is_short = track.cycles <= _MOST_STROKES and _samples(track) <= _LONGEST_LAP
    return is_short and (_wanders(track) or _is_spiral(track))


def _wanders(track: PhaseTrack) -> bool:
    return track.shifted > WANDERING


def _omits_strokes(rhythm: Rhythm, path: Array, rate: float) -> bool:
    """Return whether strokes of a path (n, D) before or after the bouts are longer than these.

    Of strokes along a line and back, only those where it turns resemble one another. A part
    of one period is a stroke if it is not direct, unlike one of a winding approach. A path of
    more than `_LONGEST_LAP` samples is not a lap, nor one with many cycles in one place.
    """
    if rhythm.cycles > _MOST_IN_PLACE or len(path) > _LONGEST_LAP:
        return False
    omitted = 0
    for part in rhythm.left_out:
        if part.kind in _WITH_STROKES:
            omission = path[round(part.start * rate) : round(part.end * rate)]
            count = max(round(part.duration / rhythm.period), 1)
            pieces = np.array_split(omission, count)
            omitted += sum(len(piece) for piece in pieces if not is_direct(piece))
    in_bouts = sum(bout.duration for bout in rhythm.bouts)
    return omitted > in_bouts * rate


def _samples(track: PhaseTrack) -> int:
    return sum(map(len, track.recordings))


def _is_spiral(track: PhaseTrack) -> bool:
    """Return whether the cycles grow, or shrink, by equal steps, and differ clearly."""
    amplitudes = track.history.amplitudes
    steps = np.diff(amplitudes)
    if len(steps) < 2 or abs(steps.sum()) < _GROWTH * amplitudes.mean():
        return False
    are_equal = np.all(np.abs(steps / steps.mean() - 1) < _UNEQUAL)
    return bool(are_equal) and track.unexplained > STRICT.unexplained


def _track_of_cycle(phase: Array, values: Array, harmonics: int) -> PhaseTrack:
    """Return the track of one cycle of values (n, D) at phases (n,)."""
    most = min(_MOST_HARMONICS, len(values) // _SAMPLES)
    harmonics = max(1, min(harmonics, most))
    return PhaseTrack(
        recordings=[values],
        phases=[phase],
        shifts=[np.zeros_like(values)],
        cycle=Cycle.fit([phase], [values], harmonics=harmonics),
    )


def _is_better(without: TrackedRhythm, with_pauses: TrackedRhythm) -> bool:
    """Return whether a rhythm without pauses is better than the one with them."""
    one, other = without.rhythm, with_pauses.rhythm
    if abs(one.period / other.period - 1) < _SIMILAR:
        return one.cycles > other.cycles + _MORE_CYCLES
    return without.misfit < _WITHOUT_PAUSES * max(with_pauses.misfit, _EXACT)


def _best_attempt(
    recordings: Sequence[Array], candidates: Iterable[float], *, is_known: bool
) -> tuple[Attempt, Limits]:
    """Return the attempt that explains the recordings best, and the limits it satisfies."""
    attempts = _attempts(recordings, candidates, is_known=is_known)
    limits = STRICT
    acceptable = [a for a in attempts if not a.objection(limits)]
    best = min(acceptable, key=Attempt.cost, default=None)
    if not is_known and not (best and best.is_clear):
        few = _few_cycles(recordings, attempts)
        # One stroke of a few cycles repeats more often, but less exactly than they do.
        if few and (best is None or _MISFIT_RATIO * few.cost(best) < best.cost(few)):
            acceptable, limits = [few], ALIGNED
    if not acceptable:
        limits = ALIGNED if is_known else LENIENT
        acceptable = [a for a in attempts if not a.objection(limits)]
    if not acceptable:
        refused = [a for a in attempts if a.track.cycles >= limits.cycles]
        if refused:
            is_lap = any(_has_strokes_of_lap(a.track) for a in refused)
            kind = _NoSteadyCycleError if is_lap else DemonstrationError
            raise kind(refused[0].objection(limits))
        raise _NoSteadyCycleError(
            "no part of it recurs in another cycle; record at least two full cycles"
            f"{' without gaps, in one recording' * (len(recordings) > 1)}."
        )
    best = min(acceptable, key=Attempt.cost)
    if limits is LENIENT:
        # With few cycles, choose the shortest period among those of similar misfit.
        most = max(CLEAR_MISFIT, _MISFIT_RATIO * best.misfit)
        comparable = [a for a in acceptable if a.misfit <= most]
        best = max(comparable, key=lambda attempt: attempt.track.cycles)
    while not is_known and (n := best.track.cycle.repetitions(CLEAR_MISFIT)) > 1:
        attempt = Attempt.of(recordings, best.track.period / n)
        if attempt is None or attempt.objection(limits):
            break
        # Noise remains unexplained by both.
        most = max(CLEAR_MISFIT, (1 + _SIMILAR) * best.track.unexplained)
        if attempt.track.unexplained > most:
            break
        best = attempt
    return best, limits


def _few_cycles(recordings: Sequence[Array], attempts: list[Attempt]) -> Attempt | None:
    """Return the attempt with the period of the best alignment, unless it is refused.

    Noise hides the similarity of samples. Then it is the first attempt at two cycles or more
    about one centre that leaves only noise unexplained.
    """
    if period := aligned_period(recordings):
        attempts = [a for a in [Attempt.of(recordings, period)] if a]
    else:
        variance = np.sum([len(y) * y.var(axis=0) for y in recordings], axis=0)
        noise = noise_fractions(recordings) @ variance / max(variance.sum(), 1e-300)
        most = CLEAR_MISFIT + noise if noise > CLEAR_MISFIT else 0.0
        attempts = [a for a in attempts if a.track.unexplained + a.track.shifted < most]
        attempts = [a for a in attempts if a.track.cycles > _TWO_CYCLES]
    return next((a for a in attempts if not a.objection(ALIGNED)), None)


def _attempts(
    recordings: Sequence[Array], candidates: Iterable[float], *, is_known: bool
) -> list[Attempt]:
    """Attempt candidates of the period until one explains the recordings clearly."""
    attempts: list[Attempt] = []
    for candidate in candidates:
        # An attempt finds the same cycle from similar periods.
        if any(abs(candidate / a.track.period - 1) < _SIMILAR for a in attempts):
            continue
        attempt = Attempt.of(recordings, candidate, is_known=is_known)
        if attempt is None:
            continue
        attempts.append(attempt)
        if attempt.is_clear and not attempt.objection(STRICT):
            break
    return attempts


def _with_other_movement(
    recordings: Sequence[Array], attempt: Attempt, rate: float
) -> tuple[list[Indices], Attempt | None]:
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
    shortest = max(SHORTEST_BOUT, round(attempt.period))
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
        bouts = segments(recordings, masks) or bouts
    try:
        estimates = possible_periods(bouts)
    except DemonstrationError:
        estimates = []
    confirmed = [p for p in estimates[:1] if local and abs(p / local[0] - 1) < _NEAR]
    samples = sum(map(len, recordings))
    previous: list[float] = []
    for candidate in (*confirmed, *local, *estimates):
        if samples < ALIGNED.cycles * candidate:
            continue
        if all(abs(candidate / other - 1) > _SAME for other in previous) and not (
            confirmed and candidate in local[:1]
        ):
            previous.append(candidate)
            yield candidate
