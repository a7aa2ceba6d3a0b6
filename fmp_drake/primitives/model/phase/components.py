"""Gaussian mixture over windows from a tracked phase."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from fmp_drake.numeric import Array, Indices, in_threads
from fmp_drake.primitives.model.basis import FourierBasis
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.phase.eigenvectors import (
    leading_eigenvectors,
    symmetric_roots,
)
from fmp_drake.primitives.model.phase.random_processes import (
    Residual,
    phase_covariance,
)
from fmp_drake.primitives.model.phase.tracking import PhaseTrack

# Width of the kernel that shares windows between components, rad; weights of the structural
# mean and covariance, in windows.
_KERNEL_WIDTH = 0.21
_MEAN_WINDOWS = 5.0
_COVARIANCE_WINDOWS = 60.0
_WHITE_NOISE = 1e-10
# With more cycles, windows that are cut by the end of a recording are left out.
_MANY_CYCLES = 12.0
# Rows of the Gram matrices that are mixed at a time.
_ROWS = 32


class PhaseGrid(NamedTuple):
    """Phases of the components at the reference step of a window.

    Attributes
    ----------
    phases : ndarray, shape (M,)
        Rad.
    cell_widths : ndarray, shape (M,)
        Width of the interval of phases that each component covers, rad.
    """

    phases: Array
    cell_widths: Array


def phase_grid(track: PhaseTrack, count: int) -> PhaseGrid:
    """Return a grid of phases with equally many samples in each cell."""
    phase = np.sort(np.mod(np.concatenate(track.phases), 2 * np.pi))
    edges = np.quantile(phase, np.arange(2 * count + 1) / (2 * count))
    edges[[0, -1]] = 0.0, 2 * np.pi
    return PhaseGrid(edges[1::2], np.diff(edges[::2]))


def phase_components(
    track: PhaseTrack,
    residual: Residual,
    grid: PhaseGrid,
    *,
    n_steps: int,
    reference_step: int,
    factors: Array,
    errors: Array,
    rank: int,
) -> tuple[LowRankGaussian, ...]:
    """Return one Gaussian over the Fourier weights of a window for each phase of a grid.

    At each phase the model is linearised: the phase noise moves the samples along the
    cycle, and the residual is added. This structure is a prior, which is combined with
    the windows that pass near the phase.

    Parameters
    ----------
    track : PhaseTrack
    residual : Residual
        Residual of the track.
    grid : PhaseGrid
        Phases at the sample `reference_step`.
    n_steps : int
        T, samples in a window.
    reference_step : int
    factors : ndarray, shape (T - reference_step,)
        Factors of the covariances of the samples from the reference step, given earlier
        ones.
    errors : ndarray, shape (T - reference_step, D, D)
        Covariances that are added to these.
    rank : int
        Greatest number of directions of each covariance.
    """
    weights = FourierBasis(n_steps).analyze(np.eye(n_steps)[..., None]).T
    steps = np.arange(n_steps) - reference_step
    root = symmetric_roots(errors)
    lags = np.arange(len(root))[:, None] - np.arange(len(root))
    correlations = np.exp(-0.5 * (lags / reference_step) ** 2)
    added_covariance = np.einsum(
        "iab,ij,jcb->iajc", root, correlations, root, optimize=True
    )
    size = len(root) * root.shape[1]
    added_covariance = added_covariance.reshape(size, size)
    scale = np.repeat(np.sqrt(factors), root.shape[1])
    growth = np.outer(scale, scale) - 1
    gaussians = grid_gaussians(track, residual, grid, steps)

    def component(m: int) -> LowRankGaussian:
        [mean], [covariance] = gaussians(slice(m, m + 1))
        return _low_rank(
            mean, _rescaled(covariance, growth, added_covariance), weights, rank
        )

    return tuple(in_threads(component, range(len(grid.phases))))


def grid_gaussians(
    track: PhaseTrack,
    residual: Residual,
    grid: PhaseGrid,
    steps: Indices,
) -> Callable[[slice], tuple[Array, Array]]:
    """Return a function that gives means (m, n, D) and covariances (m, n D, n D).

    Both are those of samples at phases of the grid, whose indices are the argument. The
    parameters are those of `phase_components`; `steps` (n,) are the increasing times of
    the samples relative to the reference step.
    """
    cycle, velocity = track.cycle, track.velocity
    d, n_steps, reference_step = cycle.coefficients.shape[1], len(steps), -int(steps[0])
    span = int(np.ptp(steps)) + 1
    noise = phase_covariance(
        track.phases, velocity, count=span, reference_step=reference_step
    )
    noise = noise[np.ix_(steps + reference_step, steps + reference_step)]
    noise = np.asarray(np.kron(noise, np.ones((d, d))), dtype=float)
    residual_covariance = residual.process.covariance(steps)
    slow = np.concatenate(track.shifts).var(axis=0)
    shift_covariance = np.kron(np.ones((n_steps, n_steps)), np.diag(2 * slow))
    paths = grid.phases[:, None] + velocity * steps
    cycles = cycle.values(paths)
    tangents = cycle.values(paths, 1).reshape(len(paths), -1)

    def structure(m: slice, spread: Array | float = 0.0) -> Array:
        prior = (noise + spread) * tangents[m, None]
        prior *= tangents[m, :, None]
        prior += shift_covariance
        prior += residual.shaped_covariance(paths[m], residual_covariance)
        return prior

    errors = _errors(track, cycles, grid.phases, steps)
    counts = np.array([float(len(windows)) for windows in errors])
    conditional_covariances = {
        m: _fill_missing(windows, structure(slice(m, m + 1))[0])
        for m, windows in enumerate(errors)
        if np.isnan(windows).any()
    }
    kernel = _kernel(grid.phases)
    sums = kernel @ np.stack([windows.sum(axis=0) for windows in errors])
    grams = np.empty((len(kernel), *noise.shape))
    for m, windows in enumerate(errors):
        np.matmul(windows.T, windows, out=grams[m])
    for m, conditional in conditional_covariances.items():
        grams[m] += conditional

    def mix(row: int) -> None:
        rows = np.s_[:, row : row + _ROWS]
        grams[rows] = np.tensordot(kernel, grams[rows], 1)

    # A few rows at a time: two copies of all of them need much memory.
    in_threads(mix, range(0, len(noise), _ROWS))

    def gaussians(m: slice) -> tuple[Array, Array]:
        windows, total = (kernel[m] @ counts)[:, None], sums[m]
        weight = _COVARIANCE_WINDOWS + windows
        move = total / (windows + _MEAN_WINDOWS)
        # The windows' scatter about the moved mean is their Gram matrix minus this.
        pair = np.stack([move, total - windows / 2 * move], axis=1)
        spread = grid.cell_widths[m, None] ** 2 / 12 * weight / _COVARIANCE_WINDOWS
        covariances = structure(m, spread[..., None])
        covariances *= _COVARIANCE_WINDOWS
        covariances += grams[m]
        covariances -= pair.mT @ pair[:, ::-1]
        covariances /= weight[..., None]
        return cycles[m] + move.reshape(-1, n_steps, d), covariances

    return gaussians


def _errors(
    track: PhaseTrack,
    cycles: Array,
    phases: Array,
    steps: Indices,
) -> list[Array]:
    """Return the errors (n, T D) of the cycle in the windows that pass each phase.

    `cycles` (M, T, D) are the values of the cycle at these phases.

    With few cycles, windows that are cut by the end of a recording after at least a
    quarter of their length count as well; their missing samples are NaN.
    """
    missing_samples = 0 if track.cycles > _MANY_CYCLES else 3 * int(steps[-1]) // 4
    windows_of: list[list[Array]] = []
    for y, phase in zip(track.recordings, track.phases, strict=True):
        times = np.arange(len(y), dtype=float)
        monotonic_phase = np.maximum.accumulate(phase) + 1e-9 * times
        first, last = np.floor(monotonic_phase[[0, -1]] / (2 * np.pi))
        passages = phases[:, None] + 2 * np.pi * np.arange(first - 1, last + 2)
        is_inside = (passages >= monotonic_phase[0]) & (passages <= monotonic_phase[-1])
        passage_times = np.interp(passages, monotonic_phase, times)
        is_inside &= (passage_times + steps[0] >= 0) & (
            passage_times + steps[-1] <= times[-1] + missing_samples
        )
        places = passage_times[is_inside][:, None] + steps
        indices = np.nonzero(is_inside)[0]
        windows = CubicSpline(times, y)(places)
        windows -= cycles[indices]
        windows[places > times[-1]] = np.nan
        ends = np.cumsum(np.count_nonzero(is_inside, axis=1))
        windows = windows.reshape(len(places), cycles[0].size)
        windows_of.append(np.split(windows, ends[:-1]))
    return [np.concatenate(windows) for windows in zip(*windows_of, strict=True)]


def _fill_missing(errors: Array, prior: Array) -> Array:
    """Replace NaN in windows (n, T D) by conditional expectations, in place.

    Return the sum of the conditional covariances, (T D, T D).
    """
    covariance = np.zeros_like(prior)
    for window in errors:
        is_observed = np.isfinite(window)
        if not is_observed.all():
            observed_rows = prior[is_observed]
            gains = np.linalg.solve(
                observed_rows[:, is_observed]
                + _WHITE_NOISE * np.eye(len(observed_rows)),
                observed_rows[:, ~is_observed],
            )
            window[~is_observed] = window[is_observed] @ gains
            conditional = (
                prior[np.ix_(~is_observed, ~is_observed)]
                - observed_rows[:, ~is_observed].T @ gains
            )
            covariance[np.ix_(~is_observed, ~is_observed)] += conditional
    return covariance


def _kernel(phases: Array) -> Array:
    """Return the weight of the windows of one phase at another one, (M, M)."""
    distances = np.angle(np.exp(1j * (phases[:, None] - phases)))
    weights = np.exp(-0.5 * (distances / _KERNEL_WIDTH) ** 2)
    weights[weights < 1e-4] = 0.0
    return weights


def _rescaled(covariance: Array, growth: Array, added: Array) -> Array:
    """Return a covariance (T D, T D) whose later samples have another uncertainty.

    Their covariance given the earlier samples is multiplied by 1 + `growth` and
    increased by `added`; their dependence on the earlier samples does not change.
    """
    first = len(covariance) - len(growth)
    observed = covariance[:first, :first] + _WHITE_NOISE * np.eye(first)
    cross = covariance[:first, first:]
    conditional = covariance[first:, first:] - cross.T @ np.linalg.solve(
        observed, cross
    )
    conditional *= growth
    conditional += added
    covariance[first:, first:] += conditional
    return covariance


def _low_rank(
    mean: Array, covariance: Array, weights: Array, rank: int
) -> LowRankGaussian:
    """Return a Gaussian over weights from mean and covariance of samples (T, D).

    `weights` (T, T) maps the samples of a channel to its weights.
    """
    size = len(covariance)
    count = min(rank, size - 1)
    total = float(np.trace(covariance))
    variances, vectors = leading_eigenvectors(covariance, count)
    noise = (total - float(variances.sum())) / (size - count)
    noise = max(noise, 0.0) + _WHITE_NOISE
    windows = np.swapaxes(vectors.reshape(*mean.shape, count), 0, 1)
    return LowRankGaussian(
        mean=(weights @ mean).T.ravel(),
        basis=(weights @ windows).reshape(size, count),
        variances=np.maximum(variances + _WHITE_NOISE - noise, 0.0),
        noise=noise,
    )
