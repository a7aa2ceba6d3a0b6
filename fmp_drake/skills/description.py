"""Descriptions of recordings and skills in words."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    Rhythm,
    find_rhythm,
)
from fmp_drake.primitives.data.channels import (
    POSITION_CHANNELS,
    ROTATION_CHANNELS,
    listed,
)
from fmp_drake.primitives.data.reading.table import count_text
from fmp_drake.primitives.data.windows import (
    DEFAULT_RATE,
    as_windows,
    cut_demonstrations,
    extent_of,
)
from fmp_drake.primitives.model.phase.phase_model import PhaseModel
from fmp_drake.primitives.model.phase.rhythm import cycle_count
from fmp_drake.skills.placement import Placement, place_on_board
from fmp_drake.station import Scenario

# With fewer cycles the phase model's assumptions outweigh the demonstrations.
_ENOUGH_CYCLES = 12
# Windows without overlap that a mixture needs: on the bundled movements the density of
# unseen windows collapses with fewer.
_ENOUGH_WINDOWS = 7
_DISCRETE = (
    "; one movement from a start to a goal is learned in Python, from two or more recordings "
    "of it: DiscreteMovementPrimitive"
)
# Deviation of the tempo from its mean that is reported.
_TEMPO = 0.15
# Distance of a playback from the demonstrated range that is reported, relative to the widest
# channel of the same unit. It is up to 0.2 for skills of few cycles that play well.
_OUTSIDE = 0.3
# Spread of the intervals between samples that is reported, relative to their median.
_EVEN = 0.01
# Duration of the playback that is described, and of the playback before it, s.
_SECONDS = 8.0


def model_in_words(skill: FourierMovementPrimitive) -> str:
    """Return the model of a skill, and the reason for it."""
    return f"model: {skill.model_}, because {skill.model_reason_}".replace(
        "phase, because", "phase,"
    )


def skill_in_words(skill: FourierMovementPrimitive) -> list[str]:
    """Return sentences about the model, the demonstrations and the played movement.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0, 20, 0.05)
    >>> circles = 0.1 * np.column_stack([np.cos(2 * time), np.sin(2 * time)])
    >>> windows = np.stack([circles[i : i + 120] for i in range(0, 280, 2)])
    >>> words = skill_in_words(FourierMovementPrimitive().fit(windows))
    >>> print(words[-1])
    its playback covers x -0.10 to 0.10 m, y -0.10 to 0.10 m, with a period of 3.1 s, at up to 0.20 m/s
    """
    phase = skill.phase_model_
    remarks = _about_windows(skill) if phase is None else _about_cycles(skill, phase)
    motion = _playback(skill)
    playing = _about_playing(skill, motion)
    return [model_in_words(skill), *remarks, playing, *_about_leaving(skill, motion)]


def outside_in_words(skill: FourierMovementPrimitive) -> list[str]:
    """Return a warning where a playback of the means leaves the demonstrated range."""
    return _about_leaving(skill, _playback(skill))


def _about_leaving(skill: FourierMovementPrimitive, motion: Array) -> list[str]:
    if not skill.paths_:
        return []
    shown, played = skill.extent_, extent_of([motion[:, 0]])
    widths = np.ptp(shown, axis=0)
    widest = [
        max(w for w, u in zip(widths, skill.units_, strict=True) if u == unit)
        for unit in skill.units_
    ]
    outside = np.maximum(shown[0] - played[0], played[1] - shown[1])
    ranges = _ranges_in_words(skill, shown)
    rounding = 1e-6 * (1 + np.max(np.abs(shown), axis=0))
    far = np.flatnonzero(outside > np.maximum(_OUTSIDE * np.array(widest), rounding))
    return [
        (
            f"the playback leaves the demonstrated range ({', '.join(ranges[i] for i in far)}): "
            "record more cycles before a robot plays it"
        )
    ] * bool(len(far))


def source_in_words(skill: FourierMovementPrimitive) -> str:
    """Describe components of a skill and their source: cycles, or windows of a mixture.

    Examples
    --------
    >>> import numpy as np
    >>> phase = np.arange(0, 12.6, 0.1)
    >>> circles = 0.1 * np.column_stack([np.cos(phase), np.sin(phase)])
    >>> skill = FourierMovementPrimitive(model="phase", rate=20.0)
    >>> source_in_words(skill.fit(circles))
    '80 components from 2.0 cycles of 3.14 s'
    """
    source = f"{count_text(len(skill.components_), 'component')} from "
    if skill.phase_model_ is None:
        return source + f"{skill.n_windows_} windows of {skill.window:g} s"
    rhythm = skill.rhythm_
    cycles = skill.phase_model_.cycles if rhythm is None else rhythm.cycles
    return source + f"{cycle_count(cycles)} of {skill.period_:.2f} s"


def _about_windows(skill: FourierMovementPrimitive) -> list[str]:
    seconds = sum(len(path) for path in skill.paths_) / skill.rate
    window = skill.n_steps / skill.rate
    if not skill.paths_ or seconds >= _ENOUGH_WINDOWS * window:
        return []
    windows_per_component = skill.n_windows_ / len(skill.components_)
    return [
        (
            f"{seconds:.0f} s is short for a mixture with windows of {window:g} s: only "
            f"{seconds / window:.1f} of them do not overlap, and a component is learned from "
            f"{windows_per_component:.1f} that do. It does not represent other movements; "
            f"record {_ENOUGH_WINDOWS * window:.0f} s or four equal cycles{_DISCRETE}"
        )
    ]


def _about_cycles(skill: FourierMovementPrimitive, phase: PhaseModel) -> list[str]:
    tempos, sizes = skill.tempos_, skill.amplitudes_
    spread = ""
    if phase.cycles > 1:
        spread = f", tempo {_percent(tempos)}, size {_percent(sizes)} of the mean"
    remarks = [
        f"{count_text(phase.cycles, 'whole cycle')} of {skill.period_:.2f} s{spread}; "
        + (
            "more would hardly help"
            if phase.cycles >= _ENOUGH_CYCLES
            else f"{_ENOUGH_CYCLES} or more would help"
        )
    ]
    if skill.rhythm_ is not None:
        remarks += skill.rhythm_.describe()[1:]
    if np.ptp(tempos) > 2 * _TEMPO:
        remarks.append(
            "the tempo varies so much that the means are smaller than the movement; play "
            "samples (--sample, or sample: true in a scenario)"
        )
    return remarks


def _playback(skill: FourierMovementPrimitive) -> Array:
    """Return a steady playback of the means, shape (n, 3, D)."""
    start = skill.paths_[0][-1] if skill.paths_ else skill.extent_.mean(axis=0)
    seconds = _SECONDS if skill.phase_model_ is None else max(_SECONDS, skill.period_)
    motion = Player(skill).rollout(start, 2 * seconds)
    return motion[round(seconds * skill.rate) :]


def _about_playing(skill: FourierMovementPrimitive, motion: Array) -> str:
    """Return extent, period and greatest speed of a playback (n, 3, D)."""
    ranges = _ranges_in_words(skill, extent_of([motion[:, 0]]))
    sentence = f"its playback covers {', '.join(ranges)}"
    if skill.phase_model_ is not None:
        sentence += f" with a period of {skill.period_:.1f} s"
    metres = [unit == "m" for unit in skill.units_]
    if any(metres):
        speed = float(np.linalg.norm(motion[:, 1, metres], axis=-1).max())
        sentence += f", at up to {speed:.2g} m/s"
    return sentence


def _ranges_in_words(skill: FourierMovementPrimitive, ends: Array) -> list[str]:
    """Return the range of each channel, from its ends (2, D)."""
    return [
        f"{name} {_range_in_words(low, high)} {'' if unit == '1' else unit}".rstrip()
        for name, unit, (low, high) in zip(
            skill.channels_, skill.units_, ends.T, strict=True
        )
    ]


def _range_in_words(low: float, high: float) -> str:
    """Return two numbers with two digits of their difference, or with two decimals."""
    digits = 1 - math.floor(math.log10(high - low)) if high > low else 2
    digits = digits if 2 < digits <= 6 else 2  # Less than 1e-5 is a rounding error.
    # A small negative number would become -0.00.
    ends = (round(value, digits) + 0.0 for value in (low, high))
    return " to ".join(f"{end:.{digits}f}" for end in ends)


def _percent(values: Array) -> str:
    return f"{100 * values.min():.0f} to {100 * values.max():.0f} %"


def describe_recording(
    demonstration: Demonstration,
    *,
    on_board: tuple[Demonstration, str] | None = None,
    **options: Any,
) -> list[str]:
    """Return four lines: channels, rate, cycles, and whether learning is possible.

    `on_board` is what `board_part` returns, where it is known. The options start_time,
    end_time and period are those of `find_rhythm`.

    Examples
    --------
    >>> time = np.arange(0, 30, 0.02)
    >>> circles = 0.1 * np.column_stack([np.cos(3 * time), np.sin(3 * time)])
    >>> for line in describe_recording(Demonstration(time=time, values=circles)):
    ...     print(line)
    channels: x, y (m)
    rate: 50 Hz, 1500 samples in 30 s
    cycles: 14.3 cycles of 2.09 s
    learning: possible, from 14.3 cycles; not for the board: ...
    """
    steps = 1e3 * np.diff(demonstration.time)
    rate = (
        f"{1e3 / np.median(steps):.4g} Hz, {len(demonstration.time)} samples in "
        f"{demonstration.duration:.3g} s"
    )
    if np.ptp(steps) > _EVEN * np.median(steps):
        rate += f"; intervals from {steps.min():.3g} to {steps.max():.3g} ms"
    learned, placing = on_board or board_part(demonstration, **options)
    rhythm: Rhythm | None = None
    try:
        rhythm = find_rhythm(learned, **options)
        cycles = "; ".join(rhythm.describe())
    except DemonstrationError as error:
        cycles = f"none found: {error}{_cycles_of_poses(demonstration, **options)}"
        if len(learned.channels) > len(POSITION_CHANNELS):
            cycles += " If only some channels repeat, name them (--columns)."
    try:
        limits = options.get("start_time"), options.get("end_time")
        (part,) = cut_demonstrations([learned], *limits, DEFAULT_RATE)
        learning = f"{_learning_in_words(part, rhythm)}; {placing}"
    except DemonstrationError as error:
        learning = f"not possible: {error}"
    return [
        f"channels: {'; '.join(_channels_in_words(demonstration))}",
        f"rate: {rate}",
        f"cycles: {cycles}",
        f"learning: {learning}",
    ]


def _cycles_of_poses(demonstration: Demonstration, **options: Any) -> str:
    """Return a remark where the positions of a recording repeat only with its orientation."""
    poses = [*POSITION_CHANNELS, *ROTATION_CHANNELS]
    if not set(poses) <= set(demonstration.channels):
        return ""
    try:
        rhythm = find_rhythm(demonstration.select(poses), **options)
    except DemonstrationError:
        return ""
    return (
        f" With its orientation it has {rhythm.describe()[0]}: learn it with --as-recorded "
        "--extra orientation."
    )


def _channels_in_words(demonstration: Demonstration) -> Iterator[str]:
    """Yield the names of the channels of each unit."""
    named = [*zip(demonstration.channels, demonstration.units, strict=True)]
    for unit in dict.fromkeys(demonstration.units):
        yield f"{listed([name for name, u in named if u == unit])} ({unit})"


def _learning_in_words(demonstration: Demonstration, rhythm: Rhythm | None) -> str:
    """Return what a skill can be learned from.

    Raises
    ------
    DemonstrationError
        Where none can.
    """
    if rhythm is not None:
        return f"possible, from {cycle_count(rhythm.cycles)}"
    skill = FourierMovementPrimitive()
    parts = demonstration.split_at_gaps(skill.rate) or [demonstration]
    longest = max(part.duration for part in parts)
    n_steps = skill.mixture_steps(int(longest * skill.rate) + 1)
    windows = as_windows(
        [demonstration],
        n_steps=n_steps,
        stride=FourierMovementPrimitive(n_steps=n_steps).window_stride,
        rate=skill.rate,
    )
    seconds = n_steps / skill.rate
    is_short = sum(part.duration for part in parts) < _ENOUGH_WINDOWS * seconds
    words = f"possible, from {len(windows.values)} windows of {seconds:g} s"
    return words + _DISCRETE * is_short


def board_part(
    demonstration: Demonstration, *, placement: Placement | None = None, **rhythm: Any
) -> tuple[Demonstration, str]:
    """Return a recording as it is learned for the board, and remarks.

    It is the recording itself where that does not fit the board. The placement is that of
    several recordings together.
    """
    try:
        placed, remarks = place_on_board(
            demonstration, scenario=Scenario(), placement=placement, **rhythm
        )
    except DemonstrationError as error:
        return demonstration, f"not for the board: {error}"
    return placed, "; ".join(remarks or ["on the board"])
