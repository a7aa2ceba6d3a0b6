"""The phase of every sample, given the cycle: Viterbi, then Gauss and Newton."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from fmp_drake.compiled import compiled
from fmp_drake.primitives.model.phase.cycle import Cycle

# Phases per nominal period, within bounds, and the greatest increment, in nominal ones.
_STATES_PER_SAMPLE = 4
_STATES = (80, 400)
_FASTEST = 2.2
# Standard deviation of the tempo from sample to sample, in nominal ones, and of the
# values from the cycle, in their own standard deviation.
_TEMPO_SPREAD = 0.45
_VALUE_SPREAD = 0.15
# Standard deviation of the tempo's change from sample to sample, in nominal ones.
CHANGE = 0.03
_STEPS = 12


def phase_path(
    values: NDArray[np.float64], cycle: Cycle, *, tempo: float, change: float = CHANGE
) -> NDArray[np.float64]:
    """Return the phase of every sample of a movement, unwrapped, shape (n,).

    First the best path through a grid of phases, by dynamic programming, so that
    nothing depends on a guess; then least squares with a smooth tempo.

    Parameters
    ----------
    values : ndarray, shape (n, D)
        At least 2 samples, without slow shifts of the centre.
    cycle : Cycle
    tempo : float
        Nominal, rad per sample.
    change : float
        Standard deviation of its change from sample to sample, in nominal ones.
    """
    rough = _grid_path(values, cycle, tempo)
    return _refined(rough, values, cycle, change * tempo)


def _grid_path(
    values: NDArray[np.float64], cycle: Cycle, tempo: float
) -> NDArray[np.float64]:
    count = int(np.clip(_STATES_PER_SAMPLE * 2 * np.pi / tempo, *_STATES))
    grid = 2 * np.pi * np.arange(count) / count
    shown, slope = cycle.values(grid), tempo * cycle.values(grid, 1)
    cost = 1.0 * _distances(values, shown)
    cost += 0.5 * _distances(np.gradient(values, axis=0), slope)
    cost /= 2 * _VALUE_SPREAD**2
    nominal = tempo * count / (2 * np.pi)
    increments = np.arange(int(_FASTEST * nominal) + 1) / nominal
    start, path = best_path(cost, ((increments - 1) / _TEMPO_SPREAD) ** 2 / 2)
    return np.asarray((start + np.cumsum(path)) * (2 * np.pi / count), dtype=float)


def _distances(
    values: NDArray[np.float64], shown: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return squared distances (n, S), in the variance of what the cycle shows."""
    total = max(float(shown.var(axis=0).sum()), 1e-300)
    squares = np.sum(values**2, axis=1)[:, None] + np.sum(shown**2, axis=1)
    return np.maximum(squares - 2 * values @ shown.T, 0) / total


@compiled
def best_path(
    cost: NDArray[np.float64], step_cost: NDArray[np.float64]
) -> tuple[int, NDArray[np.int64]]:
    """Return the cheapest path through states on a circle, by dynamic programming.

    Parameters
    ----------
    cost : ndarray, shape (n, S)
        Of each state at each time.
    step_cost : ndarray, shape (J,)
        Of going on by 0 to J - 1 states.

    Returns
    -------
    start : int
        The first state.
    increments : ndarray, shape (n,)
        By how many states it goes on to each time; 0 for the first.
    """
    n, count = cost.shape
    best = cost[0].copy()
    new = np.empty(count)
    choice = np.zeros((n, count), dtype=np.int16)
    for i in range(1, n):
        for s in range(count):
            least, by = np.inf, 0
            for j in range(len(step_cost)):
                total = best[(s - j) % count] + step_cost[j]
                if total < least:
                    least, by = total, j
            new[s] = least + cost[i, s]
            choice[i, s] = by
        best[:] = new
    out = np.zeros(n, dtype=np.int64)
    state = int(np.argmin(best))
    for i in range(n - 1, 0, -1):
        out[i] = choice[i, state]
        state = (state - out[i]) % count
    return state, out


def _refined(
    phase: NDArray[np.float64],
    values: NDArray[np.float64],
    cycle: Cycle,
    change: float,
) -> NDArray[np.float64]:
    """Minimise the values' distance to the cycle and the changes of the tempo."""
    n, d = values.shape
    if n < 3:
        return phase
    variance = 2 * float(np.median(np.sum((values - cycle.values(phase)) ** 2, 1))) / d
    variance = max(
        variance, 1e-6 * float(cycle.values(phase).var(axis=0).sum()), 1e-300
    )
    stiffness = 1 / change**2
    smooth = _second_difference_bands(n) * stiffness

    def cost(phi: NDArray[np.float64]) -> float:
        misfit = np.sum((values - cycle.values(phi)) ** 2) / variance
        return float(misfit + stiffness * np.sum(np.diff(phi, 2) ** 2))

    now = cost(phase)
    for _ in range(_STEPS):
        jacobian = cycle.values(phase, 1)
        error = values - cycle.values(phase)
        pull = np.sum(jacobian * error, axis=1) / variance
        second = np.diff(phase, 2)
        pull[:-2] -= stiffness * second
        pull[1:-1] += 2 * stiffness * second
        pull[2:] -= stiffness * second
        bands = smooth.copy()
        bands[-1] += np.sum(jacobian**2, axis=1) / variance + 1e-9 * stiffness
        step = solveh_banded(bands, pull)
        step *= min(1.0, 0.5 / max(float(np.max(np.abs(step))), 1e-12))
        for _ in range(5):
            new = cost(phase + step)
            if new < now:
                break
            step = step / 2
        else:
            break
        phase, gained, now = phase + step, now - new, new
        if gained < 1e-6 * now:
            break
    return phase


def _second_difference_bands(n: int) -> NDArray[np.float64]:
    """Return the upper bands of D'D, with D the second difference, shape (3, n)."""
    bands = np.zeros((3, n))
    for offset, product in ((0, (1, 4, 1)), (1, (-2, -2)), (2, (1,))):
        for i, value in enumerate(product):
            # Diagonal `offset`: of the entries (c - offset, c).
            first = i + offset
            bands[2 - offset, first : n - 2 + first] += value
    return bands
