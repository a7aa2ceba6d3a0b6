"""How a movement varied from cycle to cycle."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.model.phase.cycle import Cycle

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class CycleHistory:
    """The demonstrated cycles one after the other.

    Attributes
    ----------
    lengths : ndarray, shape (C,)
        Of each cycle, samples.
    amplitudes : ndarray, shape (C,)
        Its size; 1 is that of the mean cycle.
    shifts : ndarray, shape (C, D)
        By how much its centre was shifted.

    Examples
    --------
    >>> import numpy as np
    >>> phase = np.arange(0, 12.5, 0.1)
    >>> circle = np.column_stack([np.cos(phase), np.sin(phase)])
    >>> cycle = Cycle.fit(phase, circle, harmonics=2)
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
        """Measure whole cycles of recordings (n, D) at unwrapped phases (n,)."""
        lengths, amplitudes, shifts = [], [], []
        for phase, y in zip(phases, recordings, strict=True):
            times = np.arange(len(y), dtype=float)
            rising = np.maximum.accumulate(phase) + 1e-9 * times
            begins = rising[0] + 2 * np.pi * np.arange(
                np.floor((rising[-1] - rising[0]) / (2 * np.pi)) + 1
            )
            at = np.interp(begins, rising, times)
            lengths.extend(np.diff(at))
            for a, b in zip(np.ceil(at[:-1]), np.ceil(at[1:]), strict=True):
                of = slice(int(a), int(b))
                seen, shown = y[of], cycle.values(phase[of])
                shifts.append((seen - shown).mean(axis=0))
                shown = shown - shown.mean(axis=0)
                amplitudes.append(np.sum(shown * seen) / np.sum(shown**2))
        return cls(
            lengths=np.array(lengths),
            amplitudes=np.array(amplitudes),
            shifts=np.array(shifts).reshape(len(lengths), -1),
        )

    @property
    def drift(self) -> Array:
        """By how much the centre moved from the first to the last cycle, shape (D,).

        Along the straight line that fits the shifts best.
        """
        count = np.arange(len(self.shifts)) - (len(self.shifts) - 1) / 2
        spread = max(float(count @ count), 1.0)
        out: Array = count @ self.shifts / spread * (len(count) - 1)
        return out
