"""A phase model as a mixture of Gaussians over windows."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from fmp_drake.primitives.model.basis import FourierBasis
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.phase.residual import Residual
from fmp_drake.primitives.model.phase.tempo import phase_covariance
from fmp_drake.primitives.model.phase.tracking import PhaseTrack

Array = NDArray[np.float64]

# Width, in rad, of the neighbourhood whose windows a component is learned from, and the
# windows that its structural mean and covariance count for.
_NEAR = 0.21
_MEAN_WINDOWS = 5.0
_COVARIANCE_WINDOWS = 60.0
_WHITE = 1e-10
# With more cycles, windows that are cut by the end of a recording do not count.
_MANY_CYCLES = 12.0


class Anchors(NamedTuple):
    """The phases of components at the sample at which each knows its phase.

    Attributes
    ----------
    phases : ndarray, shape (M,)
        Rad.
    spacing : ndarray, shape (M,)
        The widths of their cells, rad.
    """

    phases: Array
    spacing: Array


def anchor_phases(track: PhaseTrack, count: int) -> Anchors:
    """Return phases that equally many samples lie between."""
    phase = np.sort(np.mod(np.concatenate(track.phases), 2 * np.pi))
    edges = np.quantile(phase, np.arange(2 * count + 1) / (2 * count))
    edges[[0, -1]] = 0.0, 2 * np.pi
    return Anchors(edges[1::2], np.diff(edges[::2]))


def phase_components(
    track: PhaseTrack,
    residual: Residual,
    anchors: Anchors,
    *,
    n_steps: int,
    pinned: int,
    rank: int,
) -> tuple[LowRankGaussian, ...]:
    """Return one Gaussian over the Fourier weights of a window for each anchor.

    At each anchor the model is linearised: the phase strays around a constant tempo,
    which moves the samples along the cycle, and the residual is added. This structure is
    a prior; the windows that pass near the anchor's phase are counted into it.

    Parameters
    ----------
    track : PhaseTrack
    residual : Residual
        Of the track.
    anchors : Anchors
        Phases at the sample `pinned`.
    n_steps : int
        T, samples in a window.
    pinned : int
    rank : int
        Most directions that are kept of each covariance.
    """
    basis, steps = FourierBasis(n_steps), np.arange(n_steps) - pinned
    return tuple(
        _low_rank(mean, covariance, basis, rank)
        for mean, covariance in anchored_gaussians(track, residual, anchors, steps)
    )


def anchored_gaussians(
    track: PhaseTrack,
    residual: Residual,
    anchors: Anchors,
    steps: NDArray[np.int64],
) -> Iterator[tuple[Array, Array]]:
    """Return mean (n, D) and covariance (n D, n D) of samples around each anchor.

    The parameters are those of `phase_components`; `steps` (n,) are the rising places
    of the samples, of which 0 knows the phase.
    """
    cycle, tempo, anchor = track.cycle, track.tempo, anchors.phases
    d, n_steps, pinned = cycle.coefficients.shape[1], len(steps), -int(steps[0])
    span = int(np.ptp(steps)) + 1
    straying = phase_covariance(track.phases, tempo, count=span, pinned=pinned)
    straying = straying[np.ix_(steps + pinned, steps + pinned)]
    straying = np.asarray(np.kron(straying, np.ones((d, d))), dtype=float)
    smooth = residual.process.covariance(steps)
    slow = np.concatenate(track.shifts).var(axis=0)
    shifted = np.kron(np.ones((n_steps, n_steps)), np.diag(2 * slow))
    paths = anchor[:, None] + tempo * steps

    def structure(path: Array) -> Array:
        tangent = cycle.values(path, 1).ravel()
        prior = residual.formed(path, smooth)
        return prior + np.outer(tangent, tangent) * straying + shifted

    errors = _errors(track, paths, anchor, steps)
    counts = np.array([float(len(each)) for each in errors])
    unsure = {
        m: _complete(windows, structure(paths[m]))
        for m, windows in enumerate(errors)
        if np.isnan(windows).any()
    }
    near = _nearness(anchor)
    sums = near @ np.stack([windows.sum(axis=0) for windows in errors])
    grams = np.stack([windows.T @ windows for windows in errors])
    for m, left in unsure.items():
        grams[m] += left
    grams = (near @ grams.reshape(len(near), -1)).reshape(grams.shape)
    for m, path in enumerate(paths):
        prior, tangent = structure(path), cycle.values(path, 1).ravel()
        windows, total, gram = float(near[m] @ counts), sums[m], grams[m]
        move = total / (windows + _MEAN_WINDOWS)
        gram -= np.outer(move, total) + np.outer(total, move)
        gram += windows * np.outer(move, move)
        covariance = _COVARIANCE_WINDOWS * prior + gram
        covariance /= _COVARIANCE_WINDOWS + windows
        covariance += anchors.spacing[m] ** 2 / 12 * np.outer(tangent, tangent)
        mean = cycle.values(path) + move.reshape(n_steps, d)
        yield mean, covariance


def _errors(
    track: PhaseTrack,
    paths: Array,
    anchors: Array,
    steps: NDArray[np.int64],
) -> list[Array]:
    """Return how the windows that pass each anchor differ from the cycle, (n, T D).

    Of few cycles also those count that are cut by the end of a recording, after a quarter
    of them; what they lack is NaN.
    """
    cut = 0 if track.cycles > _MANY_CYCLES else 3 * int(steps[-1]) // 4
    found: list[list[Array]] = [[] for _ in anchors]
    for y, phase in zip(track.recordings, track.phases, strict=True):
        times = np.arange(len(y), dtype=float)
        spline = CubicSpline(times, y)
        rising = np.maximum.accumulate(phase) + 1e-9 * times
        for m, anchor in enumerate(anchors):
            first = np.ceil((rising[0] - anchor) / (2 * np.pi))
            last = np.floor((rising[-1] - anchor) / (2 * np.pi))
            passed = anchor + 2 * np.pi * np.arange(first, last + 1)
            at = np.interp(passed, rising, times)
            at = at[(at + steps[0] >= 0) & (at + steps[-1] <= times[-1] + cut)]
            place = at[:, None] + steps
            windows = spline(place) - track.cycle.values(paths[m])
            windows[place > times[-1]] = np.nan
            found[m].append(windows.reshape(len(at), paths[m].size * y.shape[1]))
    return [np.concatenate(each) for each in found]


def _complete(errors: Array, prior: Array) -> Array:
    """Put what is expected of them into windows (n, T D) where they are NaN.

    Return the sum of the covariances of what was put there, (T D, T D).
    """
    unsure = np.zeros_like(prior)
    for window in errors:
        seen = np.isfinite(window)
        if not seen.all():
            known = prior[seen]
            gains = np.linalg.solve(
                known[:, seen] + _WHITE * np.eye(len(known)), known[:, ~seen]
            )
            window[~seen] = window[seen] @ gains
            left = prior[np.ix_(~seen, ~seen)] - known[:, ~seen].T @ gains
            unsure[np.ix_(~seen, ~seen)] += left
    return unsure


def _nearness(anchors: Array) -> Array:
    """Return how much the windows of an anchor count at another one, (M, M)."""
    apart = np.angle(np.exp(1j * (anchors[:, None] - anchors)))
    near = np.exp(-0.5 * (apart / _NEAR) ** 2)
    near[near < 1e-4] = 0.0
    return near


def _low_rank(
    mean: Array, covariance: Array, basis: FourierBasis, rank: int
) -> LowRankGaussian:
    """Return a Gaussian over weights from mean and covariance of samples (T, D)."""
    size = len(covariance)
    kept = min(rank, size - 1)
    # All of them: finding only the greatest takes three times as long.
    variances, vectors = np.linalg.eigh(covariance)
    variances, vectors = variances[size - kept :], vectors[:, size - kept :]
    noise = (float(np.trace(covariance)) - float(variances.sum())) / (size - kept)
    noise = max(noise, 0.0) + _WHITE
    windows = vectors.T.reshape(kept, *mean.shape)
    return LowRankGaussian(
        mean=basis.analyze(mean),
        basis=np.ascontiguousarray(basis.analyze(windows).T),
        variances=np.maximum(variances + _WHITE - noise, 0.0),
        noise=noise,
    )
