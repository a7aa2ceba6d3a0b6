"""Finding the cycle of a movement and the phase of every sample together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.path import CHANGE, phase_path

Recordings = Sequence[NDArray[np.float64]]

_ROUNDS = 6
_HARMONICS = (6, 20)
# Of so few cycles the tempo is taken to change less than it may: what a cycle leaves, which
# varies slowly, would be mistaken for it. Left out of 20 s of the 8 and of polishing, thirds
# are predicted better with this in 15 of 16; of 2 minutes, samples vary too little.
_FEW_CYCLES = 12.0
_CHANGE_OF_FEW = 0.01
# A pause is where the tempo, smoothed over half a period, is below this fraction of
# its median.
_PAUSE = 0.35


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseTrack:
    """Recordings with the phase of each sample.

    Attributes
    ----------
    recordings : list of ndarray, shape (n, D)
        What was given, without pauses.
    phases : list of ndarray, shape (n,)
        Unwrapped, rad.
    shifts : list of ndarray, shape (n, D)
        By how much the centre of the movement was shifted.
    cycle : Cycle
    paused : int
        Samples left out because the movement paused.
    approach : int
        Samples left out at the ends because they led there or away.
    """

    recordings: list[NDArray[np.float64]]
    phases: list[NDArray[np.float64]]
    shifts: list[NDArray[np.float64]]
    cycle: Cycle
    paused: int
    approach: int = 0

    @property
    def tempo(self) -> float:
        """The mean tempo, rad per sample."""
        ahead = sum(float(p[-1] - p[0]) for p in self.phases)
        return ahead / sum(len(p) - 1 for p in self.phases)

    @property
    def cycles(self) -> float:
        """How many cycles there are."""
        return sum(float(p[-1] - p[0]) for p in self.phases) / (2 * np.pi)

    @property
    def unexplained(self) -> float:
        """The fraction of the variance that cycle and phase do not explain."""
        errors = np.concatenate(self.residuals()) - np.concatenate(self.shifts)
        return self._fraction(errors)

    @property
    def shifted(self) -> float:
        """The fraction of the variance that slow shifts of the centre take."""
        return self._fraction(np.concatenate(self.shifts))

    def _fraction(self, errors: NDArray[np.float64]) -> float:
        values = np.concatenate(self.recordings)
        total = float(np.sum((values - values.mean(axis=0)) ** 2))
        return float(np.sum(errors**2)) / max(total, 1e-300)

    def residuals(self) -> list[NDArray[np.float64]]:
        """Return what the cycle leaves of the recordings, shifts included."""
        return [
            y - self.cycle.values(p)
            for y, p in zip(self.recordings, self.phases, strict=True)
        ]


def track_phase(recordings: Recordings, *, period: float, least: int) -> PhaseTrack:
    """Track the phase through recordings (n, D), of which pauses are cut out.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    period : float
        About, in samples.
    least : int
        Samples; shorter segments are left out.
    """
    track = _tracked(list(recordings), period, _first_cycle(recordings, period))
    moving = [
        part
        for values, phase in zip(track.recordings, track.phases, strict=True)
        for part in _moving(values, phase, period, least)
    ]
    left = sum(map(len, moving))
    paused = sum(map(len, track.recordings)) - left
    if not moving or paused == 0:
        return track
    again = _tracked(moving, 2 * np.pi / track.tempo, track.cycle)
    return replace(again, paused=paused)


def _tracked(
    recordings: list[NDArray[np.float64]], period: float, cycle: Cycle
) -> PhaseTrack:
    most = max(1, int(min(_HARMONICS[1], period / 2 - 2)))
    tempo = 2 * np.pi / period
    few = sum(map(len, recordings)) < _FEW_CYCLES * period
    change = _CHANGE_OF_FEW if few else CHANGE
    shifts = [np.zeros_like(y) for y in recordings]
    for harmonics in np.linspace(min(_HARMONICS[0], most), most, _ROUNDS).astype(int):
        phases = [
            phase_path(y - b, cycle, tempo=tempo, change=change)
            for y, b in zip(recordings, shifts, strict=True)
        ]
        shifts = [
            gaussian_filter1d(y - cycle.values(p), 0.5 * period, axis=0)
            for y, p in zip(recordings, phases, strict=True)
        ]
        centred = [y - b for y, b in zip(recordings, shifts, strict=True)]
        cycle = Cycle.fit(
            np.concatenate(phases), np.concatenate(centred), harmonics=harmonics
        )
    return PhaseTrack(
        recordings=recordings, phases=phases, shifts=shifts, cycle=cycle, paused=0
    )


def _first_cycle(recordings: Recordings, period: float) -> Cycle:
    """Return the cycle that all others resemble most."""
    size = round(period)
    pieces = np.concatenate(
        [
            np.lib.stride_tricks.sliding_window_view(y, size, axis=0).reshape(
                -1, size * y.shape[1]
            )
            for y in recordings
            if len(y) >= size
        ]
    )
    candidates = pieces[:: max(1, size // 4, len(pieces) // 400)]
    # By least squares the parts of a candidate that recur, at their best shift.
    squares = np.sum(pieces**2, axis=1)
    distance = squares[:, None] - 2 * pieces @ candidates.T
    distance += np.sum(candidates**2, axis=1)
    usable = len(pieces) // size * size or len(pieces)
    distance = distance[:usable].reshape(-1, min(size, usable), len(candidates))
    best = candidates[int(np.argmin(np.median(distance.min(axis=1), axis=0)))]
    phase = np.asarray(2 * np.pi * np.arange(size) / period, dtype=float)
    values: NDArray[np.float64] = best.reshape(-1, size).T
    return Cycle.fit(phase, values, harmonics=max(1, min(_HARMONICS[0], size // 2 - 2)))


def _moving(
    values: NDArray[np.float64],
    phase: NDArray[np.float64],
    period: float,
    least: int,
) -> list[NDArray[np.float64]]:
    """Return the segments between pauses that are at least so long."""
    smooth = uniform_filter1d(np.gradient(phase), max(3, round(period / 2)))
    moves = smooth > _PAUSE * np.median(smooth)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], moves.astype(int), [0]])))
    return [
        values[a:b]
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if b - a >= least
    ]
