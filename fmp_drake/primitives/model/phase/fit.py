"""Learning a phase model from recordings."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.phase.calibration import calibrate
from fmp_drake.primitives.model.phase.components import anchor_phases, phase_components
from fmp_drake.primitives.model.phase.period import fundamental_period, other_periods
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
_COMPONENTS = (30, 80)
_RANK = 160


def tracked(recordings: Sequence[NDArray[np.float64]], *, n_steps: int) -> PhaseTrack:
    """Return the phase of recordings (n, D), where a phase model can be learned.

    Where the estimated period does not explain them, others are tried.

    Raises
    ------
    DemonstrationError
        Where it cannot: nothing repeats, it repeats less than four times, or one cycle
        does not explain it.
    """
    estimated = fundamental_period(recordings)
    samples = sum(map(len, recordings))
    others = [
        p for p in other_periods(recordings, estimated) if samples >= LEAST_CYCLES * p
    ]
    found: list[PhaseTrack] = []
    first_reason = ""
    for period in (estimated, *others):
        track = track_phase(recordings, period=period, least=n_steps + 1)
        reason = _reason_against(track)
        first_reason = first_reason or reason
        if not reason:
            found.append(track)
            if track.unexplained <= _CLEAR:
                break
    if not found:
        raise DemonstrationError(first_reason)
    return min(found, key=lambda track: track.unexplained)


def _reason_against(track: PhaseTrack) -> str:
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
    count = int(np.clip(round(2 * np.pi / tempo.mean), *_COMPONENTS))
    anchors, spacing = anchor_phases(track, min(count, most_components))
    components = phase_components(
        track,
        cycle=track.cycle,
        residual=residual,
        tempo=tempo.mean,
        anchors=anchors,
        spacing=spacing,
        n_steps=n_steps,
        pinned=pinned,
        rank=_RANK,
    )
    model = PhaseModel(
        cycle=track.cycle,
        residual=residual,
        tempo=tempo,
        anchors=anchors,
        spacing=spacing,
        pinned=pinned,
        calibration=calibrate(
            track, anchors=anchors, spacing=spacing, n_steps=n_steps, pinned=pinned
        ),
        cycles=track.cycles,
        paused=float(track.paused),
    )
    return model, components
