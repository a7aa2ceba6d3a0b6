"""Joint estimation of the mean cycle and of the phase of every sample."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter1d

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array, Indices
from fmp_drake.primitives.model.phase.cycle import (
    FEW_CYCLES,
    Cycle,
    CycleHistory,
    count_cycles,
    harmonics_of,
)

Recordings = Sequence[Array]

# Phases per sample of a nominal period, and bounds of their number. Long periods have fewer for
# each sample; with one or less, no increment is near the nominal one.
_STATES_PER_SAMPLE, _STATES = 4, (80, 400)
_LEAST_PER_SAMPLE, _MOST_STATES = 2, 2400
# Greatest increment relative to the nominal one.
FASTEST = 2.2
# Standard deviation of the phase velocity, relative to the nominal one, and of the values
# beside the cycle, relative to their own standard deviation.
_VELOCITY_SPREAD = 0.45
_VALUE_SPREAD = 0.15
# Standard deviation of the change of the phase velocity from sample to sample, relative to
# the nominal one.
CHANGE = 0.03
_STEPS = 12
_ROUNDS = 6
_HARMONICS = (6, 20)
# Most numbers in the segments that are compared for the first cycles.
_MOST_NUMBERS = 50_000_000
# With few cycles a smaller change of the phase velocity is assumed: otherwise it
# absorbs the slowly varying residual. Left-out thirds of 20 s of the 8 and of polishing
# are predicted better with this in 15 of 16 cases; with 2 minutes of data, samples vary
# too little with it.
_CHANGE_OF_FEW = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseTrack:
    """Recordings with the phase of each sample.

    Attributes
    ----------
    recordings : list of ndarray, shape (n, D)
        Their rhythmic parts alone.
    phases : list of ndarray, shape (n,)
        Unwrapped, rad.
    shifts : list of ndarray, shape (n, D)
        Slow displacement of the centre of the movement.
    cycle : Cycle
    """

    recordings: list[Array]
    phases: list[Array]
    shifts: list[Array]
    cycle: Cycle

    @property
    def velocity(self) -> float:
        """The mean phase velocity, rad per sample."""
        total = sum(float(p[-1] - p[0]) for p in self.phases)
        return total / sum(len(p) - 1 for p in self.phases)

    @property
    def period(self) -> float:
        """The mean duration of a cycle, samples."""
        return 2 * np.pi / self.velocity

    @property
    def cycles(self) -> float:
        """The number of cycles."""
        return count_cycles(self.phases)

    @cached_property
    def history(self) -> CycleHistory:
        """Length, size and centre of each cycle."""
        return CycleHistory.of(self.cycle, self.phases, self.recordings)

    @property
    def unexplained(self) -> float:
        """The fraction of the variance that cycle and phase do not explain."""
        return self._fraction(self._errors())

    def unexplained_fractions(self) -> Array:
        """Return the unexplained fraction of each channel's variance, shape (D,)."""
        total = np.concatenate(self.recordings).var(axis=0)
        return np.asarray(
            np.mean(self._errors() ** 2, axis=0) / np.maximum(total, 1e-18)
        )

    @property
    def shifted(self) -> float:
        """The fraction of the variance that slow shifts of the centre take."""
        return self._fraction(np.concatenate(self.shifts))

    def _errors(self) -> Array:
        return np.concatenate(self.residuals()) - np.concatenate(self.shifts)

    def _fraction(self, errors: Array) -> float:
        values = np.concatenate(self.recordings)
        total = float(np.sum((values - values.mean(axis=0)) ** 2))
        return float(np.sum(errors**2)) / max(total, 1e-300)

    def of_channels(self, columns: list[int]) -> "PhaseTrack":
        """Return the track of some channels."""
        if len(columns) == self.recordings[0].shape[1]:
            return self
        return self.with_channels([y[:, columns] for y in self.recordings])

    def with_channels(self, recordings: Recordings) -> "PhaseTrack":
        """Return the track of the same samples with other channels, (n, D)."""
        harmonics = self.cycle.harmonics
        cycle = Cycle.fit(self.phases, recordings, harmonics=harmonics)
        shifts = [
            gaussian_filter1d(y - cycle.values(p), np.pi / self.velocity, axis=0)
            for y, p in zip(recordings, self.phases, strict=True)
        ]
        centred = [y - b for y, b in zip(recordings, shifts, strict=True)]
        cycle = Cycle.fit(self.phases, centred, harmonics=harmonics)
        return PhaseTrack(
            recordings=list(recordings), phases=self.phases, shifts=shifts, cycle=cycle
        )

    def with_smooth_cycle(self) -> "PhaseTrack":
        """Return the track with a cycle of soft ends, to be played."""
        centred = [y - b for y, b in zip(self.recordings, self.shifts, strict=True)]
        cycle = Cycle.fit(
            self.phases,
            centred,
            harmonics=self.cycle.harmonics,
            has_soft_ends=True,
        )
        return replace(self, cycle=cycle)

    def residuals(self) -> list[Array]:
        """Return the recordings minus the cycle at their phases; shifts are included."""
        return [
            y - self.cycle.values(p)
            for y, p in zip(self.recordings, self.phases, strict=True)
        ]


def track_phase(
    recordings: Recordings, *, period: float, cycle: Cycle | None = None
) -> PhaseTrack:
    """Estimate cycle and phase of recordings (n, D).

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    period : float
        Initial estimate, samples.
    cycle : Cycle, optional
        Initial estimate.
    """
    if cycle is None:
        (cycle,) = first_cycles(recordings, period, most=1)
    most = harmonics_of(period, _HARMONICS[1])
    velocity = 2 * np.pi / period
    has_few_cycles = sum(map(len, recordings)) < FEW_CYCLES * period
    change = _CHANGE_OF_FEW if has_few_cycles else CHANGE
    shifts = [np.zeros_like(y) for y in recordings]
    for harmonics in np.linspace(min(_HARMONICS[0], most), most, _ROUNDS).astype(int):
        phases = [
            phase_path(y - b, cycle, velocity=velocity, change=change)
            for y, b in zip(recordings, shifts, strict=True)
        ]
        shifts = [
            gaussian_filter1d(y - cycle.values(p), 0.5 * period, axis=0)
            for y, p in zip(recordings, phases, strict=True)
        ]
        centred = [y - b for y, b in zip(recordings, shifts, strict=True)]
        cycle = Cycle.fit(phases, centred, harmonics=harmonics)
    return PhaseTrack(
        recordings=list(recordings), phases=phases, shifts=shifts, cycle=cycle
    )


def first_cycles(recordings: Recordings, period: float, *, most: int) -> list[Cycle]:
    """Return disjoint segments of one period, those most similar to all others first."""
    size = round(period)
    long = [y for y in recordings if len(y) >= size]
    count = sum(y.shape[1] * size * (len(y) - size + 1) for y in long)
    step = 1 + count // _MOST_NUMBERS
    pieces = np.concatenate(
        [
            np.lib.stride_tricks.sliding_window_view(y, size, axis=0)[::step].reshape(
                -1, size * y.shape[1]
            )
            for y in long
        ]
    )
    spacing = -(-size // step)
    starts = np.arange(0, len(pieces), max(1, spacing // 4, len(pieces) // 400))
    candidates = pieces[starts]
    # Squared distances of each candidate to every piece.
    squares = np.sum(pieces**2, axis=1)
    distance = squares[:, None] - 2 * pieces @ candidates.T
    distance += np.sum(candidates**2, axis=1)
    whole_size = len(pieces) // spacing * spacing or len(pieces)
    distance = distance[:whole_size].reshape(
        -1, min(spacing, whole_size), len(candidates)
    )
    typical_distance = np.median(distance.min(axis=1), axis=0)
    phase = 2 * np.pi * np.arange(float(size)) / period
    harmonics = harmonics_of(size, _HARMONICS[0])
    cycles: list[Cycle] = []
    while len(cycles) < most and np.isfinite(typical_distance).any():
        best = int(np.argmin(typical_distance))
        typical_distance[np.abs(starts - starts[best]) < spacing] = np.inf
        values = candidates[best].reshape(-1, size).T
        cycles.append(Cycle.fit([phase], [values], harmonics=harmonics))
    return cycles


def phase_path(
    values: Array,
    cycle: Cycle,
    *,
    velocity: float,
    change: float = CHANGE,
) -> Array:
    """Return the unwrapped phase of every sample of a movement, shape (n,).

    Dynamic programming over a grid of phases gives an estimate that needs no initial
    guess; least squares with a smooth phase velocity refines it.

    Parameters
    ----------
    values : ndarray, shape (n, D)
        At least 2 samples, without slow displacements of the centre.
    cycle : Cycle
    velocity : float
        Nominal phase velocity, rad per sample.
    change : float
        Standard deviation of its change from sample to sample, relative to it.
    """
    path = _grid_path(values, cycle, velocity)
    return _refined(path, values, cycle, change * velocity)


def phase_states(period: float) -> Array:
    """Return the phases that dynamic programming compares, rad, for a period in samples."""
    count = np.clip(_STATES_PER_SAMPLE * period, *_STATES)
    count = int(max(count, min(_LEAST_PER_SAMPLE * period, _MOST_STATES)))
    return 2 * np.pi * np.arange(count) / count


def _grid_path(values: Array, cycle: Cycle, velocity: float) -> Array:
    grid = phase_states(2 * np.pi / velocity)
    count = len(grid)
    states, rates = cycle.values(grid), velocity * cycle.values(grid, 1)
    # Squared distances of values and velocities, each relative to the variance of the
    # states. Terms that are equal for all states do not matter.
    sizes = [max(x.var(axis=0).sum(), 1e-300) for x in (states, rates)]
    scales = np.sqrt([1 / sizes[0], 0.5 / sizes[1]]) / (np.sqrt(2) * _VALUE_SPREAD)
    scales = np.repeat(scales, values.shape[1])
    centre = states.mean(axis=0)
    samples = np.hstack([values - centre, np.gradient(values, axis=0)]) * scales
    nodes = np.hstack([states - centre, rates]) * scales
    cost = np.column_stack([samples, np.ones(len(samples))]) @ np.vstack(
        [-2 * nodes.T, np.sum(nodes**2, axis=1)]
    )
    nominal = velocity * count / (2 * np.pi)
    increments = np.arange(int(FASTEST * nominal) + 1) / nominal
    step_costs = ((increments - 1) / _VELOCITY_SPREAD) ** 2 / 2
    # One circle, which no sample leaves.
    never = np.full(len(cost), np.inf)
    _, path, _ = best_labels(
        cost[None], np.tile(step_costs, (len(cost), 1)), never, np.inf
    )
    path[1:] = path[0] + np.cumsum(np.diff(path) % count)
    return np.asarray(path * (2 * np.pi / count), dtype=float)


@compiled
def best_labels(
    costs: Array, step_costs: Array, outside: Array, change: float
) -> tuple[Indices, Indices, float]:
    """Return the cheapest sequence of labels and states, by dynamic programming.

    Parameters
    ----------
    costs : ndarray, shape (K, n, S)
        Cost of each state on each of K circles at each time; overwritten.
    step_costs : ndarray, shape (n, J)
        Cost of an increment by 0 to J - 1 states, to each time.
    outside : ndarray, shape (n,)
        Cost of each sample beside all circles.
    change : float
        Cost of a change between circles, and to the samples beside them.

    Returns
    -------
    labels : ndarray, shape (n,)
        Circle of each sample; K beside all.
    states : ndarray, shape (n,)
    cost : float
    """
    circles, n, count = costs.shape
    reach = step_costs.shape[1] - 1
    best = costs
    # Least cost of each label at each time, and its state.
    least = np.zeros((n, circles + 1))
    least_state = np.zeros((n, circles + 1), dtype=np.int64)
    unrolled, lowest = np.empty(reach + count), np.empty(count)
    for i in range(n):
        for k in range(circles):
            if i:
                entry = np.inf
                for other in range(circles + 1):
                    if other != k:
                        entry = min(entry, least[i - 1, other] + change)
                for s in range(reach):
                    unrolled[s] = best[k, i - 1, (s - reach) % count]
                for s in range(count):
                    unrolled[reach + s] = best[k, i - 1, s]
                lowest[:] = entry
                for j in range(reach + 1):
                    before = unrolled[reach - j : reach - j + count]
                    for s in range(count):
                        lowest[s] = min(lowest[s], before[s] + step_costs[i, j])
                for s in range(count):
                    best[k, i, s] += lowest[s]
            state = 0
            for s in range(count):
                if best[k, i, s] < best[k, i, state]:
                    state = s
            least[i, k], least_state[i, k] = best[k, i, state], state
        least[i, circles] = outside[i]
        if i:
            entry = least[i - 1, circles]
            for k in range(circles):
                entry = min(entry, least[i - 1, k] + change)
            least[i, circles] += entry
    labels, states = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    label = 0
    for k in range(circles + 1):
        if least[n - 1, k] < least[n - 1, label]:
            label = k
    cost, state = least[n - 1, label], least_state[n - 1, label]
    for i in range(n - 1, -1, -1):
        labels[i], states[i] = label, state
        if i == 0:
            break
        # The label and state before, recomputed.
        lowest_cost, label_before, state_before = np.inf, label, state
        if label < circles:
            for j in range(reach + 1):
                total = best[label, i - 1, (state - j) % count] + step_costs[i, j]
                if total < lowest_cost:
                    lowest_cost, state_before = total, (state - j) % count
        else:
            lowest_cost = least[i - 1, circles]
        for other in range(circles + 1):
            if other != label and least[i - 1, other] + change < lowest_cost:
                lowest_cost = least[i - 1, other] + change
                label_before, state_before = other, least_state[i - 1, other]
        label, state = label_before, state_before
    return labels, states, cost


def _refined(
    phase: Array,
    values: Array,
    cycle: Cycle,
    change: float,
) -> Array:
    """Minimise distances to the cycle and changes of the phase velocity (Gauss-Newton)."""
    n, d = values.shape
    if n < 3:
        return phase
    on_cycle = cycle.values(phase)
    error = values - on_cycle
    variance = 2 * float(np.median(np.sum(error**2, axis=1))) / d
    variance = max(variance, 1e-6 * float(on_cycle.var(axis=0).sum()), 1e-300)
    stiffness = 1 / change**2
    smooth = _second_difference_bands(n) * stiffness

    def cost(phi: Array, error: Array) -> float:
        misfit = np.sum(error**2) / variance
        return float(misfit + stiffness * np.sum(np.diff(phi, 2) ** 2))

    now = cost(phase, error)
    for _ in range(_STEPS):
        jacobian = cycle.values(phase, 1)
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
            error = values - cycle.values(phase + step)
            new = cost(phase + step, error)
            if new < now:
                break
            step = step / 2
        else:
            break
        phase, gained, now = phase + step, now - new, new
        if gained < 1e-6 * now:
            break
    return phase


def _second_difference_bands(n: int) -> Array:
    """Return the upper bands of D'D, with D the second difference, shape (3, n)."""
    # Products of entries of one row of D, the second, first and zeroth diagonal.
    products = ((1,), (-2, -2), (1, 4, 1))
    bands = [np.convolve(np.ones(n - 2), product) for product in products]
    return np.stack([np.pad(band, (n - len(band), 0)) for band in bands])
