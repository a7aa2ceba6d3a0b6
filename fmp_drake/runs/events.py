"""What went wrong in a run, in sentences that are made while it goes."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.runs.metrics import CONTACT_FORCE, Chunk
from fmp_drake.systems.impedance.status import StatusFlag

# A board is said to be elsewhere from this height on, and the most, mm.
_LEAST_HEIGHT, _MOST_HEIGHT = 3, 1000
# Less than anything that is said, but more than 0.
_TINY = 1e-9
_STOPPED = int(StatusFlag.PROTECTIVE_STOP)
_NO_TARGET = int(StatusFlag.PROTECTIVE_STOP | StatusFlag.RECOVER)
_STOPS = {
    StatusFlag.JUMP: "the target was {:.0f} cm away",
    StatusFlag.STALE: "the target was too old",
    StatusFlag.NOT_FINITE: "an input was not finite",
    StatusFlag.NO_STATE: "the arm's state was not known",
    StatusFlag.NOT_FOUND: "no board was found where it is looked for",
}


class RunEvent(NamedTuple):
    """Something that went wrong in a run, once or several times.

    Attributes
    ----------
    start, end : float
        Of the longest time that it lasted, s.
    kind : str
        In a few words.
    text : str
        A sentence about all times.
    """

    start: float
    end: float
    kind: str
    text: str


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


class RunEvents:
    """What went wrong in a run, by the controller's status and the positions."""

    def __init__(self) -> None:
        self._stops = {
            int(flag): Occurrences("protective stop", why)
            for flag, why in _STOPS.items()
        }
        self._lost = Occurrences("contact lost")
        self._wall = Occurrences("a joint at its wall")
        self._cause = 0
        self._touch = self._contact = np.inf
        self._span = (np.inf, 0.0)
        self._heights = np.zeros(2 * _MOST_HEIGHT + 1, dtype=np.int64)

    def update(self, chunk: Chunk) -> None:
        """Take the next samples of `METRIC_SIGNALS`."""
        times, status = chunk["status"]
        flags = status[:, 0].astype(int)
        lost, stopped = flags & int(StatusFlag.CONTACT_LOST), flags & _STOPPED
        self._wall.update(times, flags & int(StatusFlag.JOINT_WALL))

        # Contact can be lost after it has been made, and seen.
        force = chunk["normal_force"]
        touching = force.times[force.values[:, 0] > CONTACT_FORCE]
        self._touch = min([self._touch, *touching[:1]])
        seen = times[(times >= self._touch) & (lost == 0)]
        self._contact = min([self._contact, *seen[:1]])
        self._lost.update(times, lost * (times >= self._contact))

        # The cause of a stop is the fault at which it began.
        at, desired = chunk["desired_position"]
        way = chunk["measured_position"].values - desired
        rows = np.searchsorted(times, at - 1e-6)
        centimetres = np.full(len(times), _TINY)
        centimetres[rows] += 100 * np.linalg.norm(way, axis=1)
        faults = np.concatenate([[self._cause], flags & sum(self._stops)])
        latest = np.maximum.accumulate(np.where(faults > 0, np.arange(len(faults)), 0))
        cause = faults[latest][1:]
        self._cause = int(faults[latest[-1]])
        for flag, stop in self._stops.items():
            stop.update(times, centimetres * ((stopped > 0) & (cause & flag > 0)))

        # How high the board is shows where it is touched.
        pressed = (flags[rows] & (int(StatusFlag.CONTACT_LOST) | _NO_TARGET)) == 0
        pressed &= (at >= self._contact) & (status[rows, 4] != 0)
        if np.any(pressed):
            self._span = (
                min(self._span[0], float(at[pressed][0])),
                float(at[pressed][-1]),
            )
            heights = np.clip(
                np.rint(1e3 * way[pressed, 2]), -_MOST_HEIGHT, _MOST_HEIGHT
            )
            np.add.at(self._heights, heights.astype(int) + _MOST_HEIGHT, 1)

    def result(self) -> list[RunEvent]:
        """Return the events so far, in the order of time."""
        collected = (*self._stops.values(), self._lost, self._wall)
        events = [event for each in collected for event in each.events()]
        until = np.cumsum(self._heights)
        height = int(np.searchsorted(until, until[-1] / 2)) - _MOST_HEIGHT
        if until[-1] and abs(height) >= _LEAST_HEIGHT:
            side = "higher" if height > 0 else "lower"
            kind = f"board found {side} than assumed"
            text = f"board found {abs(height)} mm {side} than assumed"
            events.append(RunEvent(*self._span, kind, text))
        return sorted(events)
