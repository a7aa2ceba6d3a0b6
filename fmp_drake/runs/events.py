"""What went wrong in a run, in sentences that are made while it goes."""

import numpy as np

from fmp_drake.runs.metrics import CONTACT_FORCE, Chunk
from fmp_drake.runs.occurrences import Occurrences
from fmp_drake.runs.run_event import RunEvent
from fmp_drake.systems.impedance.status import STOP_REASONS, StatusFlag
from fmp_drake.systems.surface_monitor import TOLERANCE

# A board is said to be elsewhere from this height on, and the most, mm.
_LEAST_HEIGHT, _MOST_HEIGHT = 3, 1000
# Less than anything that is said, but more than 0.
_TINY = 1e-9
_STOPPED = int(StatusFlag.PROTECTIVE_STOP)
_NO_TARGET = int(StatusFlag.PROTECTIVE_STOP | StatusFlag.RECOVER)
_STOPS = {**STOP_REASONS, StatusFlag.JUMP: "the target was {:.0f} cm away"}


class RunEvents:
    """What went wrong in a run, by the controller's status and the positions."""

    def __init__(self) -> None:
        self._stops = {
            int(flag): Occurrences("protective stop", why)
            for flag, why in _STOPS.items()
        }
        self._lost = Occurrences("contact lost")
        self._wall = Occurrences("a joint at its wall")
        self._arm = Occurrences("the arm touches the board")
        self._below = Occurrences("a hard part below the board", "up to {:.1f} mm deep")
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
        self._arm.update(times, flags & int(StatusFlag.ARM_TOUCHES))

        depth = chunk["penetration"]
        millimetres = 1e3 * depth.values[:, 0]
        self._below.update(depth.times, millimetres * (depth.values[:, 0] > TOLERANCE))

        # Contact can be lost after it has been made, and seen: not by a controller before
        # its first update, whose status is all zeros.
        force = chunk["normal_force"]
        touching = force.times[force.values[:, 0] > CONTACT_FORCE]
        self._touch = min([self._touch, *touching[:1]])
        seen = times[(times >= self._touch) & (lost == 0) & (status[:, 2] > 0)]
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
        others = (self._lost, self._wall, self._arm, self._below)
        collected = (*self._stops.values(), *others)
        events = [event for each in collected for event in each.events()]
        until = np.cumsum(self._heights)
        height = int(np.searchsorted(until, until[-1] / 2)) - _MOST_HEIGHT
        if until[-1] and abs(height) >= _LEAST_HEIGHT:
            side = "higher" if height > 0 else "lower"
            kind = f"board found {side} than assumed"
            text = f"board found {abs(height)} mm {side} than assumed"
            events.append(RunEvent(*self._span, kind, text))
        return sorted(events)
