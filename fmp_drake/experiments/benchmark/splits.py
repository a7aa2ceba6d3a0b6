"""Movements of a folder of recordings, and their fixed splits by cycles seen."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmp_drake.errors import DemonstrationError, FmpError
from fmp_drake.experiments.baselines.method import (
    HORIZON,
    PAST,
    RATE,
    Array,
    long_enough,
)
from fmp_drake.primitives import read_demonstrations
from fmp_drake.primitives.data.channels import channel_scales
from fmp_drake.primitives.model.phase.search import search_rhythm

CYCLES = (1.5, 2.0, 3.0, 4.0, 8.0)
"""Cycles that methods learn from; beside them all but a held-out third."""
ALL = "all"

# A recording with so many cycles is a movement of its own.
_ALONE = 2.3
# Cycles that must remain for scoring, and places of the learned part.
_LEAST_LEFT = 0.4
PLACES = 3
# Files of a folder that are not read as recordings.
_OTHER_FILES = {".md", ".json", ".yaml", ".yml", ".html", ".png", ".pdf", ".svg"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Movement:
    """One movement: the rhythmic parts of one or several recordings.

    Attributes
    ----------
    name : str
    parts : sequence of ndarray, shape (n, D)
        At `RATE`, m.
    period : float
        Samples.
    """

    name: str
    parts: Sequence[Array]
    period: float

    @property
    def cycles(self) -> float:
        """Number of cycles in all parts."""
        return sum(map(len, self.parts)) / self.period


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """A part of a movement to learn from, and parts to score on.

    Attributes
    ----------
    cycles : str
        Number of cycles to learn from, or "all".
    place : int
        Number of the place of the learned part.
    learned, held : sequence of ndarray, shape (n, D)
    """

    cycles: str
    place: int
    learned: Sequence[Array]
    held: Sequence[Array]


def load_movements(
    folder: Path, progress: Callable[[str], None] = lambda _: None
) -> list[Movement]:
    """Load the movements of a folder of recordings.

    The first three channels in metres count. A recording of at least 2.3 cycles is a
    movement; shorter ones whose names differ only in a number at the end are one
    movement together. Others are reported and left out.

    Parameters
    ----------
    folder : pathlib.Path
        Its files are of any kind that `read_demonstrations` reads.
    progress : callable
        Called with a sentence about every recording that is left out.

    Raises
    ------
    FmpError
        Where there is no movement.
    """
    alone: list[Movement] = []
    groups: dict[str, dict[str, Array]] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.suffix.lower() in _OTHER_FILES:
            continue
        for values in _positions(path, progress):
            name = path.stem
            try:
                movement = make_movement(name, [values])
                if movement.cycles >= _ALONE:
                    alone.append(movement)
                    continue
            except DemonstrationError:
                pass
            group = name.rstrip("0123456789").rstrip("_-") or name
            members = groups.setdefault(group, {})
            members[f"{name}, part {len(members)}" if name in members else name] = (
                values
            )
    for group, members in groups.items():
        name = group if len(members) > 1 else next(iter(members))
        try:
            alone.append(make_movement(name, list(members.values())))
        except DemonstrationError as error:
            progress(f"{name} is left out: {error}")
    if not alone:
        raise FmpError(f"{folder} has no recording in which a movement repeats.")
    return sorted(alone, key=lambda movement: movement.name)


def _positions(path: Path, progress: Callable[[str], None]) -> Iterator[Array]:
    """Yield the first three channels in metres of the demonstrations of a file."""
    try:
        demonstrations, _ = read_demonstrations([path])
    except FmpError as error:
        progress(f"{path.name} is left out: {error}")
        return
    for demonstration in demonstrations:
        named = zip(demonstration.channels, demonstration.units, strict=True)
        in_metres = [name for name, unit in named if unit == "m"]
        if not in_metres:
            progress(f"{path.name} is left out: no channel is in metres.")
            continue
        yield demonstration.select(in_metres[:3]).resample(RATE).values


def make_movement(name: str, recordings: Sequence[Array]) -> Movement:
    """Return a movement of recordings (n, D) at `RATE`, without parts that are not rhythmic."""
    period, parts = rhythmic_parts(recordings)
    return Movement(name=name, parts=parts, period=period)


def rhythmic_parts(recordings: Sequence[Array]) -> tuple[float, list[Array]]:
    """Return the period, samples, and the rhythmic parts of recordings (n, D).

    All methods get the same parts: approach, retreat and pauses are found on the whole
    recordings, as `fmp-drake inspect` finds them.

    Raises
    ------
    DemonstrationError
        Where nothing repeats.
    """
    samples = np.concatenate(list(recordings))
    scales = channel_scales("units", samples, ("m",) * samples.shape[1])
    rhythm = search_rhythm([y / scales for y in recordings], rate=RATE).rhythm
    parts = []
    for bout in rhythm.bouts:
        first, last = round(bout.start * RATE), round(bout.end * RATE)
        parts.append(recordings[bout.recording][first:last])
    return rhythm.period * RATE, parts


def splits(movement: Movement, *, places: int = PLACES) -> Iterator[Split]:
    """Yield the fixed splits of a movement.

    Of each number of cycles up to three learned parts, evenly spaced; the rest is scored.
    "all" learns from two thirds of one part, or from all parts but one, in turn. With
    fewer `places` only the first ones of each.
    """
    parts = movement.parts
    for cycles in CYCLES:
        if cycles + _LEAST_LEFT > movement.cycles:
            continue
        size = round(cycles * movement.period)
        seen = set()
        for place in range(places):
            learned, held = _cut(parts, size, place)
            if not _is_scorable(learned, held):
                continue
            first = learned[0][0].tobytes()
            if first not in seen:
                seen.add(first)
                yield Split(
                    cycles=f"{cycles:g}", place=place, learned=learned, held=held
                )
    for place in range(places):
        learned, held = _fold(parts, place)
        enough = sum(map(len, learned)) >= CYCLES[0] * movement.period
        if enough and _is_scorable(learned, held):
            yield Split(cycles=ALL, place=place, learned=learned, held=held)


def instants(held: Sequence[Array], most: int) -> list[tuple[Array, Array]]:
    """Return pairs of observed (PAST, D) and following samples (HORIZON, D)."""
    view = np.lib.stride_tricks.sliding_window_view
    windows = np.concatenate([view(y, PAST + HORIZON, axis=0) for y in held])
    chosen = np.linspace(0, len(windows) - 1, min(most, len(windows))).astype(int)
    pairs = windows[np.unique(chosen)].swapaxes(1, 2).copy()
    return [(window[:PAST], window[PAST:]) for window in pairs]


def _cut(
    parts: Sequence[Array], size: int, place: int
) -> tuple[list[Array], list[Array]]:
    """Cut a learned part of so many samples out of parts, at one of several places."""
    if len(parts) == 1:
        (y,) = parts
        first = round(place / (PLACES - 1) * (len(y) - size))
        learned = [y[first : first + size]]
        return learned, long_enough([y[:first], y[first + size :]])
    order = np.roll(np.arange(len(parts)), -place * max(1, len(parts) // PLACES))
    learned, held = [], []
    for i in order.tolist():
        taken = min(size, len(parts[i]))
        # A remainder that is too short to be learned is not worth a part.
        if taken < PAST + HORIZON:
            taken = 0
        else:
            learned.append(parts[i][:taken])
        held.append(parts[i][taken:])
        size -= taken
    return learned, long_enough(held)


def _fold(parts: Sequence[Array], place: int) -> tuple[list[Array], list[Array]]:
    """Hold out a third of one part, or one of several parts."""
    if len(parts) == 1:
        (y,) = parts
        a, b = (len(y) * place // PLACES, len(y) * (place + 1) // PLACES)
        return long_enough([y[:a], y[b:]]), long_enough([y[a:b]])
    held = place * max(1, len(parts) // PLACES) % len(parts)
    return [*parts[:held], *parts[held + 1 :]], long_enough([parts[held]])


def _is_scorable(learned: Sequence[Array], held: Sequence[Array]) -> bool:
    return bool(learned) and sum(len(y) - PAST - HORIZON + 1 for y in held) >= 5
