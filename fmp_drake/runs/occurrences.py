"""Times at which something was wrong, and a sentence about them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.runs.run_event import RunEvent


class Occurrences:
    """Collects when something was wrong, from samples that come in chunks.

    Parameters
    ----------
    kind : str
        What was wrong.
    detail : str
        What else to say, with ``{}`` for the largest magnitude.

    Examples
    --------
    >>> below = Occurrences("a part below the board", "up to {:.1f} mm deep")
    >>> below.update(np.arange(4.0), np.array([0.0, 2.0, 2.5, 0.0]))
    >>> below.events()[0].text
    'a part below the board from 1.0 to 3.0 s: up to 2.5 mm deep'
    """

    def __init__(self, kind: str, detail: str = "") -> None:
        self._kind, self._detail = kind, detail
        self._start: float | None = None
        self._end = self._total = self._worst = 0.0
        self._longest = (0.0, -1.0)
        self._count = 0

    def update(self, times: NDArray[np.float64], magnitude: NDArray[Any]) -> None:
        """Take the next samples; it is wrong where the magnitude is above 0."""
        if not len(times):
            return
        wrong = magnitude > 0
        self._worst = float(np.max(magnitude, initial=self._worst))
        edges = np.diff(wrong.astype(int), prepend=int(self._start is not None))
        for i in np.flatnonzero(edges):
            at = float(times[i])
            if self._start is None:
                self._start = at
                self._count += 1
            else:
                self._total += at - self._start
                self._longest = self._longer(at)
                self._start = None
        self._end = float(times[-1])

    def _longer(self, until: float) -> tuple[float, float]:
        """Return the longest time, where the present one ends now."""
        start, end = self._longest
        if self._start is None or until - self._start <= end - start:
            return start, end
        return self._start, until

    def events(self) -> list[RunEvent]:
        """Return one event if it has ever been wrong."""
        if not self._count:
            return []
        total = self._total + (0 if self._start is None else self._end - self._start)
        start, end = self._longer(self._end)
        when = (
            f"at {start:.1f} s"
            if end - start < 0.1
            else f"from {start:.1f} to {end:.1f} s"
        )
        text = f"{self._kind} {when}"
        if self._count > 1:
            text += f" ({self._count} times in all, {total:.1f} s)"
        if self._detail:
            text += f": {self._detail.format(self._worst)}"
        return [RunEvent(start, end, self._kind, text)]
