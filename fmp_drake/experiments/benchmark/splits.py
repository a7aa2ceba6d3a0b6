"""Movements in a folder of recordings, and their splits into training and held-out parts."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import chain
from itertools import count as counting
from pathlib import Path

import numpy as np

from fmp_drake.errors import DemonstrationError, FmpError
from fmp_drake.experiments.baselines.method import HORIZON, PAST, RATE, long_enough
from fmp_drake.numeric import Array
from fmp_drake.primitives import read_demonstrations
from fmp_drake.primitives.data.channels import channel_scales
from fmp_drake.primitives.data.windows import windows_of_all
from fmp_drake.primitives.model.phase.search import search_rhythm

CYCLES = (1.5, 2.0, 3.0, 4.0, 8.0)
"""Numbers of cycles to learn from."""
ALL = "all"
"""Learning from two thirds of a movement, or from all its parts but one."""
PLACES = 3
"""Greatest number of places of a training part."""

# Least number of cycles of a recording that is a movement by itself.
_LEAST_CYCLES = 2.3
# Cycles that must remain for scoring.
_LEAST_HELD_OUT = 0.4
# Samples that are scored.
_LEAST_SCORED = 5
_NEEDED = (
    f"at least {CYCLES[0] + _LEAST_HELD_OUT:g} cycles are needed, and after {CYCLES[0]:g} of "
    f"them at least {(PAST + HORIZON + _LEAST_SCORED - 1) / RATE:.2g} s"
)
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

    @property
    def digest(self) -> str:
        """Hash of the parts, by which scores of the same movement are known."""
        digest = sha256(self.name.encode())
        for part in self.parts:
            digest.update(np.ascontiguousarray(part))
        return digest.hexdigest()[:12]


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """Division of a movement into parts to learn from and parts to score on.

    Attributes
    ----------
    cycles : str
        Number of cycles to learn from, or "all".
    place : int
        Number of the place of the training part.
    training, held_out : sequence of ndarray, shape (n, D)
    """

    cycles: str
    place: int
    training: Sequence[Array]
    held_out: Sequence[Array]


def load_movements(
    folder: Path, progress: Callable[[str], None] = lambda _: None
) -> list[Movement]:
    """Load the movements of a folder of recordings.

    Only the first three channels in metres are used. A recording of at least 2.3 cycles is
    a movement; shorter ones whose names differ only in a number at the end form one
    movement. Others are reported and left out, as are copies of a recording and movements
    that are too short to be divided.

    Parameters
    ----------
    folder : pathlib.Path
        Folder of files that `read_demonstrations` reads.
    progress : callable
        Called with the remarks on every recording, and why it is left out.

    Raises
    ------
    FmpError
        Where there is no movement.
    """
    movements: list[Movement] = []
    # Recordings of few cycles with their names, by these names without numbers, and by their
    # number of channels.
    groups: dict[tuple[str, int], list[tuple[str, Array]]] = {}
    paths = [
        path
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".") and path.suffix.lower() not in _OTHER_FILES
    ]
    stems = Counter(path.stem for path in paths)
    originals: dict[bytes, str] = {}
    for path in paths:
        recordings = list(_positions(path, progress))
        for number, values in enumerate(recordings, 1):
            name = path.stem if stems[path.stem] == 1 else path.name
            if len(recordings) > 1:
                name = f"{name}_{number}"
            # A copy would count twice, or be learned from and scored on.
            if (original := originals.setdefault(values.tobytes(), name)) != name:
                progress(f"{name} is left out: it is a copy of {original}.")
                continue
            with suppress(DemonstrationError):
                movement = make_movement(name, [values])
                if movement.cycles >= _LEAST_CYCLES:
                    movements.append(movement)
                    continue
            group = name.rstrip("0123456789").rstrip("_-") or name
            groups.setdefault((group, values.shape[1]), []).append((name, values))
    for (group, _), members in groups.items():
        name = group if len(members) > 1 else members[0][0]
        try:
            movements.append(make_movement(name, [values for _, values in members]))
        except DemonstrationError as error:
            progress(f"{name} is left out: {error}")
    if not movements:
        raise FmpError(f"{folder} has no recording in which a movement repeats.")
    movements.sort(key=lambda movement: movement.name)
    divided = []
    for movement in movements:
        if any(splits(movement)):
            divided.append(movement)
        else:
            progress(
                f"{movement.name} is left out: {movement.cycles:.1f} cycles of "
                f"{movement.period / RATE:.2g} s cannot be divided; {_NEEDED}."
            )
    if not divided:
        raise FmpError(f"{folder} has no movement that is long enough: {_NEEDED}.")
    return _with_names_of_their_own(divided)


def _with_names_of_their_own(movements: Sequence[Movement]) -> list[Movement]:
    """Return movements of which those that have the same name are numbered."""
    named: dict[str, Movement] = {}
    for movement in movements:
        names = (f"{movement.name} ({number})" for number in counting(2))
        name = next(n for n in chain([movement.name], names) if n not in named)
        named[name] = replace(movement, name=name)
    return [*named.values()]


def _positions(path: Path, progress: Callable[[str], None]) -> Iterator[Array]:
    """Yield the first three channels in metres of the demonstrations of a file."""
    try:
        demonstrations, remarks = read_demonstrations([path])
    except FmpError as error:
        progress(f"{path.name} is left out: {error}")
        return
    for remark in remarks:
        progress(remark)
    for demonstration in demonstrations:
        channels = zip(demonstration.channels, demonstration.units, strict=True)
        in_metres = [name for name, unit in channels if unit == "m"]
        if not in_metres:
            progress(f"{path.name} is left out: no channel is in metres.")
            continue
        yield demonstration.select(in_metres[:3]).resample(RATE).values


def make_movement(name: str, recordings: Sequence[Array]) -> Movement:
    """Return the movement of recordings (n, D) at `RATE`, m.

    Approach, retreat and pauses are found on the whole recordings, as by `fmp-drake
    inspect`, and left out. All methods therefore get the same parts.

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
    return Movement(name=name, parts=parts, period=rhythm.period * RATE)


def splits(movement: Movement, *, places: int = PLACES) -> Iterator[Split]:
    """Yield the fixed splits of a movement.

    For each number of cycles there are up to three training parts, evenly spaced; the rest
    is scored. "all" learns from two thirds of one part, or from all parts but one, in turn.

    Parameters
    ----------
    movement : Movement
    places : int
        Number of training parts of each length, starting with the first.
    """
    parts = movement.parts
    for cycles in CYCLES:
        if cycles + _LEAST_HELD_OUT > movement.cycles:
            continue
        size = round(cycles * movement.period)
        first_samples = set()
        for place in range(places):
            training, held_out = _cut_training_part(parts, size, place)
            if not _is_scorable(training, held_out):
                continue
            first = training[0][0].tobytes()
            if first not in first_samples:
                first_samples.add(first)
                yield Split(
                    cycles=f"{cycles:g}",
                    place=place,
                    training=training,
                    held_out=held_out,
                )
    for place in range(places):
        training, held_out = _hold_out_third(parts, place)
        is_long = sum(map(len, training)) >= CYCLES[0] * movement.period
        if is_long and _is_scorable(training, held_out):
            yield Split(cycles=ALL, place=place, training=training, held_out=held_out)


def prediction_instants(
    recordings: Sequence[Array], count: int
) -> list[tuple[Array, Array]]:
    """Return pairs of observed (PAST, D) and following samples (HORIZON, D), evenly spaced.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    count : int
        Greatest number of pairs.
    """
    windows = windows_of_all(recordings, n_steps=PAST + HORIZON)
    indices = np.linspace(0, len(windows) - 1, min(count, len(windows))).astype(int)
    pairs = windows[np.unique(indices)]
    return [(window[:PAST], window[PAST:]) for window in pairs]


def _cut_training_part(
    parts: Sequence[Array], size: int, place: int
) -> tuple[list[Array], list[Array]]:
    """Cut a training part out of parts at a place; return both."""
    if len(parts) == 1:
        (y,) = parts
        first = round(place / (PLACES - 1) * (len(y) - size))
        training = [y[first : first + size]]
        return training, long_enough([y[:first], y[first + size :]])
    order = np.roll(np.arange(len(parts)), -place * max(1, len(parts) // PLACES))
    training, held_out = [], []
    for i in order.tolist():
        count = min(size, len(parts[i]))
        # Fewer samples are too short to learn from.
        if count < PAST + HORIZON:
            count = 0
        else:
            training.append(parts[i][:count])
        held_out.append(parts[i][count:])
        size -= count
    return training, long_enough(held_out)


def _hold_out_third(
    parts: Sequence[Array], place: int
) -> tuple[list[Array], list[Array]]:
    """Hold out a third of one part, or one of several parts."""
    if len(parts) == 1:
        (y,) = parts
        first, last = (len(y) * place // PLACES, len(y) * (place + 1) // PLACES)
        return long_enough([y[:first], y[last:]]), long_enough([y[first:last]])
    i = place * max(1, len(parts) // PLACES) % len(parts)
    return [*parts[:i], *parts[i + 1 :]], long_enough([parts[i]])


def _is_scorable(training: Sequence[Array], held_out: Sequence[Array]) -> bool:
    return (
        bool(training)
        and sum(len(y) - PAST - HORIZON + 1 for y in held_out) >= _LEAST_SCORED
    )
