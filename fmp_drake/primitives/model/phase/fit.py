"""Learning a phase model from recordings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.phase.approach import without_approach
from fmp_drake.primitives.model.phase.calibration import calibrate
from fmp_drake.primitives.model.phase.components import anchor_phases, phase_components
from fmp_drake.primitives.model.phase.history import CycleHistory
from fmp_drake.primitives.model.phase.period import possible_periods
from fmp_drake.primitives.model.phase.phase_model import PhaseModel
from fmp_drake.primitives.model.phase.residual import Residual
from fmp_drake.primitives.model.phase.tempo import Tempo
from fmp_drake.primitives.model.phase.tracking import PhaseTrack, track_phase

LEAST_CYCLES = 4.0
# Of the recordings' variance. One cycle leaves 0.3 to 0.7 % of guided movements; strokes
# that were taken for the whole of three left 3.5 to 7 %. Below the first nothing better
# is looked for.
_CLEAR = 0.015
MOST_UNEXPLAINED = 0.05
# Shifts of the centre that take more of the variance leave little to a cycle.
MOST_SHIFTED = 0.5
# A track that is slower or faster than the period it began with has another cycle.
_TEMPO_FOUND = (0.6, 1.6)
LEAST_COMPONENTS, _MOST_COMPONENTS = 30, 80
_RANK = 160


def tracked(recordings: Sequence[NDArray[np.float64]], *, n_steps: int) -> PhaseTrack:
    """Return the phase of recordings (n, D), where a phase model can be learned.

    What leads to the movement and away from it is left out. Where the estimated period
    does not explain the rest, others are tried, and where its cycle consists of several
    equal ones, these are taken.

    Raises
    ------
    DemonstrationError
        Where it cannot: nothing repeats, it repeats less than four times, or one cycle
        does not explain it.
    """
    given = sum(map(len, recordings))
    parts = [y[without_approach(y, apart=n_steps // 2)] for y in recordings]
    recordings = [
        part if len(part) > n_steps else y
        for part, y in zip(parts, recordings, strict=True)
    ]
    estimated, *others = possible_periods(recordings)
    samples = sum(map(len, recordings))
    others = [p for p in others if samples >= LEAST_CYCLES * p]
    found: list[PhaseTrack] = []
    first_reason = ""
    for period in (estimated, *others):
        track = track_phase(recordings, period=period, least=n_steps + 1)
        reason = _reason_against(track, period)
        first_reason = first_reason or reason
        if not reason:
            found.append(track)
            if track.unexplained <= _CLEAR:
                break
    if not found:
        raise DemonstrationError(first_reason)
    best = min(found, key=lambda track: track.unexplained)
    while (folds := best.cycle.folds(_CLEAR)) > 1:
        period = 2 * np.pi / best.tempo / folds
        track = track_phase(recordings, period=period, least=n_steps + 1)
        if _reason_against(track, period) or track.unexplained > _CLEAR:
            break
        best = track
    return replace(best, approach=given - samples)


def _reason_against(track: PhaseTrack, period: float) -> str:
    """Return why a phase model cannot be learned; "" where it can."""
    if track.cycles < LEAST_CYCLES:
        return (
            f"it has {track.cycles:.1f} cycles; the phase model needs {LEAST_CYCLES:g}."
        )
    if track.unexplained > MOST_UNEXPLAINED:
        return (
            f"one cycle leaves {100 * track.unexplained:.0f} % of its variance "
            f"unexplained; the phase model needs at most {100 * MOST_UNEXPLAINED:.0f} %."
        )
    if track.shifted > MOST_SHIFTED:
        return (
            f"its centre wanders: that is {100 * track.shifted:.0f} % of its variance; "
            f"the phase model needs at most {100 * MOST_SHIFTED:.0f} %."
        )
    if not _TEMPO_FOUND[0] < track.tempo * period / (2 * np.pi) < _TEMPO_FOUND[1]:
        return (
            f"it seems to repeat after {period:.0f} samples, but its cycles last "
            f"{2 * np.pi / track.tempo:.0f}."
        )
    return ""


def fit_phase_model(
    track: PhaseTrack, *, n_steps: int, pinned: int, most_components: int
) -> tuple[PhaseModel, tuple[LowRankGaussian, ...]]:
    """Return the phase model of tracked recordings, and its components.

    Parameters
    ----------
    track : PhaseTrack
        Of values divided by the scales of a skill.
    n_steps : int
        T, samples in a window.
    pinned : int
        The sample of a window at which a component knows the phase: the end of what has
        been observed when a skill is played.
    most_components : int
    """
    tempo = Tempo.fit(track.phases)
    residual = Residual.fit(track.phases, track.residuals())
    count = int(
        np.clip(round(2 * np.pi / tempo.mean), LEAST_COMPONENTS, _MOST_COMPONENTS)
    )
    anchors = anchor_phases(track, min(count, most_components))
    components = phase_components(
        track, residual, anchors, n_steps=n_steps, pinned=pinned, rank=_RANK
    )
    model = PhaseModel(
        cycle=track.cycle,
        residual=residual,
        tempo=tempo,
        anchors=anchors.phases,
        spacing=anchors.spacing,
        pinned=pinned,
        calibration=calibrate(track, anchors, n_steps=n_steps, pinned=pinned),
        history=CycleHistory.of(track.cycle, track.phases, track.recordings),
        paused=float(track.paused),
        approach=float(track.approach),
    )
    return model, components
