"""Mean cycle of a movement, and statistics of its single cycles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array

# Ridge of a harmonic k is _RIDGE (k / _KNEE)^4 per sample.
_RIDGE = 1e-7
_KNEE = 3.0
FEW_CYCLES = 12.0
"""Number of cycles below which less is estimated, and recordings count less at their ends."""
ONE_CYCLE = 1.001
"""Greatest number of cycles, but for rounding, of a recording that is one closed cycle."""
# Samples for each harmonic of a long cycle.
_SAMPLES_PER_HARMONIC = 12
# Phase in which the weight of samples rises from 0 at an end of a recording, rad.
_RAMP = np.pi


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycle:
    """Closed curve over the phase: a Fourier series of each channel.

    Attributes
    ----------
    coefficients : ndarray, shape (1 + 2 h, D)
        Of 1, cos(phase), sin(phase), cos(2 phase), ... sin(h phase).

    Examples
    --------
    >>> import numpy as np
    >>> phase = np.linspace(0, 6, 50)
    >>> circle = np.column_stack([np.cos(phase), np.sin(phase)])
    >>> Cycle.fit([phase], [circle], harmonics=3).values([np.pi / 2]).round(3) + 0.0
    array([[0., 1.]])
    """

    coefficients: Array

    @classmethod
    def fit(
        cls,
        phases: Sequence[Array],
        recordings: Sequence[Array],
        *,
        harmonics: int,
        has_soft_ends: bool = False,
    ) -> "Cycle":
        """Fit a cycle to recordings (n, D) at phases (n,) by ridge regression.

        With few cycles, some phases are passed once more than others. The mean of the
        passes would jump where their number changes, at the ends of a recording. With
        soft ends, the weight of samples rises from 0 there and falls to 0, within half a
        cycle. All phases of a single cycle are passed once.
        """
        rows = _rows(np.concatenate(phases), harmonics, 0)
        order = np.repeat(np.arange(1, harmonics + 1), 2)
        ridge = _RIDGE * len(rows) * np.concatenate([[0.0], (order / _KNEE) ** 4])
        weighted = rows.T
        if has_soft_ends and ONE_CYCLE < count_cycles(phases) < FEW_CYCLES:
            weighted = rows.T * np.concatenate([_end_weights(p) for p in phases])
        gram = weighted @ rows + np.diag(ridge)
        solution = np.linalg.solve(gram, weighted @ np.concatenate(recordings))
        return cls(coefficients=np.ascontiguousarray(solution))

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return len(self.coefficients) // 2

    def values(self, phase: ArrayLike, derivative: int = 0) -> Array:
        """Return the values at phases (...), or their derivative by phase, (..., D)."""
        phases = np.asarray(phase, dtype=float)
        values = _rows(phases.ravel(), self.harmonics, derivative) @ self.coefficients
        return values.reshape(*phases.shape, values.shape[1])

    def modulated(self, factors: Array) -> "Cycle":
        """Return the cycle with its mean and harmonics times complex factors (h + 1, D)."""
        cosines, sines = self.coefficients[1::2], self.coefficients[2::2]
        products = factors[1:] * (cosines - 1j * sines)
        coefficients = np.empty_like(self.coefficients)
        coefficients[0] = factors[0].real * self.coefficients[0]
        coefficients[1::2], coefficients[2::2] = products.real, -products.imag
        return Cycle(coefficients=coefficients)

    def repetitions(self, tolerance: float) -> int:
        """Return the number of equal cycles in it, up to a fraction of its variance."""
        energy = np.sum(self.coefficients[1:] ** 2, axis=1).reshape(-1, 2).sum(axis=1)
        order = np.arange(1, len(energy) + 1)
        for repetitions in (5, 4, 3, 2):
            if energy[order % repetitions != 0].sum() < tolerance * energy.sum():
                return repetitions
        return 1


@dataclass(frozen=True, kw_only=True, eq=False)
class CycleHistory:
    """Length, size and centre of each demonstrated cycle, in order.

    Attributes
    ----------
    lengths : ndarray, shape (C,)
        Duration of each cycle, samples.
    amplitudes : ndarray, shape (C,)
        Size relative to the mean cycle.
    shifts : ndarray, shape (C, D)
        Offset of its centre from that of the mean cycle.

    Examples
    --------
    >>> import numpy as np
    >>> phase = np.arange(0, 12.5, 0.1)
    >>> circle = np.column_stack([np.cos(phase), np.sin(phase)])
    >>> cycle = Cycle.fit([phase], [circle], harmonics=2)
    >>> history = CycleHistory.of(cycle, [phase], [1.5 * circle])
    >>> history.lengths.round(1), history.amplitudes.round(2)
    (array([62.8]), array([1.5]))
    """

    lengths: Array
    amplitudes: Array
    shifts: Array

    @classmethod
    def of(
        cls, cycle: Cycle, phases: Sequence[Array], recordings: Sequence[Array]
    ) -> "CycleHistory":
        """Measure the whole cycles of recordings (n, D) with unwrapped phases (n,)."""
        lengths, amplitudes, shifts = [], [], []
        for phase, y in zip(phases, recordings, strict=True):
            times = np.arange(len(y), dtype=float)
            increasing = np.maximum.accumulate(phase) + 1e-9 * times
            start_phases = increasing[0] + 2 * np.pi * np.arange(
                np.floor((increasing[-1] - increasing[0]) / (2 * np.pi)) + 1
            )
            start_times = np.interp(start_phases, increasing, times)
            lengths.extend(np.diff(start_times))
            for a, b in zip(
                np.ceil(start_times[:-1]), np.ceil(start_times[1:]), strict=True
            ):
                part = slice(int(a), int(b))
                values, mean = y[part], cycle.values(phase[part])
                shifts.append((values - mean).mean(axis=0))
                mean = mean - mean.mean(axis=0)
                amplitudes.append(np.sum(mean * values) / np.sum(mean**2))
        return cls(
            lengths=np.array(lengths),
            amplitudes=np.array(amplitudes),
            shifts=np.array(shifts).reshape(len(lengths), recordings[0].shape[1]),
        )

    @property
    def drift(self) -> Array:
        """Displacement of the centre from the first to the last cycle, shape (D,).

        The shifts are fitted by a line of least squares.
        """
        count = np.arange(len(self.shifts)) - (len(self.shifts) - 1) / 2
        spread = max(float(count @ count), 1.0)
        return count @ self.shifts / spread * (len(count) - 1)


def harmonics_of(period: float, usual: int) -> int:
    """Return the harmonics of a cycle: the usual number, more for long ones of many strokes."""
    most = max(usual, period / _SAMPLES_PER_HARMONIC - 2)
    return max(1, int(min(most, period / 2 - 2)))


def count_cycles(phases: Sequence[Array]) -> float:
    """Return the number of cycles in recordings with unwrapped phases (n,)."""
    return sum(float(p[-1] - p[0]) for p in phases) / (2 * np.pi)


def _end_weights(phase: Array) -> Array:
    """Return weights (n,) that fall towards both ends of phases (n,)."""
    path = np.maximum.accumulate(phase) - phase[0]
    ramp = max(min(_RAMP, path[-1] / 2), 1e-9)
    margin = np.minimum(path, path[-1] - path) + 0.5 * path[-1] / len(phase)
    return np.sin(np.pi / 2 * np.minimum(margin / ramp, 1.0)) ** 2


@compiled
def _rows(phases: Array, harmonics: int, derivative: int) -> Array:
    """Return 1 and the cosines and sines of all orders, or derivatives, (n, 1 + 2 h)."""
    rows = np.empty((len(phases), 1 + 2 * harmonics))
    rows[:, 0] = derivative == 0
    for i, phase in enumerate(phases):
        # Repeated rotation takes less time than a sine and cosine of each order.
        rotation, rotated = np.exp(1j * phase), 1j**derivative
        for order in range(1, harmonics + 1):
            rotated *= rotation
            rows[i, 2 * order - 1] = order**derivative * rotated.real
            rows[i, 2 * order] = order**derivative * rotated.imag
    return rows
