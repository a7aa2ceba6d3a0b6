"""How wide predictions must be to hold of what has not been learned from."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fmp_drake.primitives.model.conditioning import Conditioning
from fmp_drake.primitives.model.phase.components import Anchors, anchored_gaussians
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.residual import Residual
from fmp_drake.primitives.model.phase.tracking import PhaseTrack

Array = NDArray[np.float64]

_COVERED = 0.95
# Of a higher quantile few predictions would decide.
_MOST_COVERED = 0.98
_PARTS = 5
# Places in all parts at which is predicted, and the samples ahead that are looked at.
_PLACES = 300
_AHEAD = np.array([1, 2, 3, 5, 7, 10, 14, 20, 28, 40])
# In squared scaled units; what a mapping trusts its samples with.
_NOISE = 1e-8


def calibrate(
    track: PhaseTrack, anchors: Anchors, *, n_steps: int, pinned: int
) -> Array:
    """Return samples ahead, and factors for the covariances predicted there, (A, 2).

    The model is learned without one part of the recordings after the other, and predicts
    it. The factors are those with which 95 % of the truth would have been in the
    ellipsoids of 95 %: covariances learned from few cycles are too small, and phases
    that stray far are not Gaussian. 1 where there is too little to be left out.

    Parameters
    ----------
    track : PhaseTrack
    anchors : Anchors
        Of the components.
    n_steps : int
        T, samples in a window.
    pinned : int
        Samples of a window that are seen when its end is predicted.
    """
    ahead = _AHEAD[_AHEAD <= n_steps - pinned]
    steps = np.concatenate([np.arange(pinned), pinned + ahead - 1])
    channels = track.cycle.coefficients.shape[1]
    squares = []
    for rest, held in _splits(track, int(steps[-1]) + 1):
        residual = Residual.fit(rest.phases, rest.residuals())
        parts = anchored_gaussians(rest, residual, anchors, steps - pinned)
        means, covariances = map(np.stack, zip(*parts, strict=True))
        conditioning = Conditioning(
            np.ones(len(means)),
            means,
            covariances + _NOISE * np.eye(covariances.shape[1]),
            seen=pinned,
            noise=np.full(pinned * channels, _NOISE),
        )
        places = max(1, _PLACES // _PARTS // len(held))
        for y in held:
            for first in np.linspace(0, len(y) - 1 - steps[-1], places).astype(int):
                window = y[first + steps]
                mean, covariance = conditioning.predict(window[:pinned])
                error = (window[pinned:] - mean)[..., None]
                solved = np.linalg.solve(covariance, error)
                squares.append(np.sum(error * solved, axis=(1, 2)))
    factors = np.ones(len(ahead))
    if squares:
        # Predictions that share no sample; of so few the quantile must be higher.
        count = sum(map(len, track.recordings)) / (pinned + ahead)
        levels = np.minimum(_COVERED * (1 + 1 / count), _MOST_COVERED)
        quantiles = map(np.quantile, np.transpose(squares), levels)
        factors = np.array(list(quantiles)) / chi2.ppf(_COVERED, channels)
    return np.column_stack([ahead, factors])


def _splits(track: PhaseTrack, least: int) -> Iterator[tuple[PhaseTrack, list[Array]]]:
    """Return tracks without a part of the recordings, and the values of the part."""
    ends = np.cumsum([len(y) for y in track.recordings])
    edges = np.linspace(0, ends[-1], _PARTS + 1).astype(int)
    for a, b in pairwise(edges):
        kept: list[tuple[Array, Array, Array]] = []
        held: list[Array] = []
        for y, phase, shift, end in zip(
            track.recordings, track.phases, track.shifts, ends, strict=True
        ):
            low, high = np.clip(np.array([a, b]) - (end - len(y)), 0, len(y))
            held += [y[low:high]] if high - low >= least else []
            kept += [
                (y[part], phase[part], shift[part])
                for part in (slice(0, low), slice(high, None))
                if len(y[part]) >= least
            ]
        if held and kept:
            values, phases, shifts = map(list, zip(*kept, strict=True))
            cycle = Cycle.fit(
                np.concatenate(phases),
                np.concatenate(values) - np.concatenate(shifts),
                harmonics=len(track.cycle.coefficients) // 2,
            )
            rest = replace(
                track, recordings=values, phases=phases, shifts=shifts, cycle=cycle
            )
            yield rest, held
