"""Events of a run: faults with their times and a sentence about each."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.numeric import Array, Mask
from fmp_drake.runs.log import Chunk, Samples
from fmp_drake.systems import StatusFlag
from fmp_drake.systems.impedance.controller_status import CONDITIONS, STOP_REASONS
from fmp_drake.systems.impedance.force_control import CONTACT_FORCE
from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.surface_monitor import TOLERANCE

# Largest error of the board's height, mm.
_MAX_HEIGHT = 1000
# After a lift, contact may be missing for the first time until the eraser lands. Contact that is
# missing within the second time after a touch was lost; within it after a landing, the
# controller has not noticed the contact yet if the last touch is not older than the third, s.
_LANDING, _JUST, _TOUCHING = 1.0, 0.3, 0.05
# A magnitude above 0 that is rounded to 0 in texts, and the least distance in them, rad.
_TINY, _SMALL = 1e-9, 0.01
_FORCE = "a normal force far too large"
_STOPPED = int(StatusFlag.PROTECTIVE_STOP)
_NO_TARGET = int(StatusFlag.PROTECTIVE_STOP | StatusFlag.RECOVER)
ADVICE = {c.event: c.advice for c in CONDITIONS.values() if c.advice} | {
    _FORCE: "Lower the tempo or the stiffness, or move the board."
}
"""Advice for each kind of event."""

_STOPS = {**STOP_REASONS, StatusFlag.JUMP: "the target was {:.0f} cm away"}


class RunEvent(NamedTuple):
    """Fault of a run, which occurred once or several times.

    Attributes
    ----------
    start, end : float
        Start and end of its longest occurrence, s.
    kind : str
        Name of the fault.
    text : str
        Sentence about all occurrences.

    Examples
    --------
    >>> event = RunEvent(12.3, 13.1, "contact lost", "contact lost from 12.3 to 13.1 s")
    >>> round(event.end - event.start, 1)
    0.8
    """

    start: float
    end: float
    kind: str
    text: str


class Occurrences:
    """Occurrences of a fault, collected from chunks of samples.

    Parameters
    ----------
    kind : str
        Name of the fault.
    detail : str
        Additional text, with ``{}`` for the largest magnitude.

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

    def update(self, times: Array, magnitude: NDArray[Any]) -> None:
        """Add samples; the fault is present where the magnitude is above 0."""
        if not len(times):
            return
        is_present = magnitude > 0
        self._worst = float(np.max(magnitude, initial=self._worst))
        edges = np.diff(is_present.astype(int), prepend=int(self._start is not None))
        for i in np.flatnonzero(edges):
            time = float(times[i])
            if self._start is None:
                self._start = time
                self._count += 1
            else:
                self._total += time - self._start
                self._longest = self._longest_until(time)
                self._start = None
        self._end = float(times[-1])

    def _longest_until(self, time: float) -> tuple[float, float]:
        """Return the longest occurrence if the current one ended at a time, s."""
        start, end = self._longest
        if self._start is None or time - self._start <= end - start:
            return start, end
        return self._start, time

    def events(self) -> list[RunEvent]:
        """Return one event if the fault has occurred, otherwise none."""
        if not self._count:
            return []
        total = self._total + (0 if self._start is None else self._end - self._start)
        start, end = self._longest_until(self._end)
        interval = (
            f"at {start:.1f} s"
            if end - start < 0.1
            else f"from {start:.1f} to {end:.1f} s"
        )
        text = f"{self._kind} {interval}"
        if self._count > 1:
            text += f" ({self._count} times in all, {total:.1f} s)"
        if self._detail:
            text += f": {self._detail.format(self._worst)}"
        return [RunEvent(start, end, self._kind, text)]


# Faults that are reported while their flag is set.
_FLAG_FAULTS = StatusFlag.ARM_TOUCHES, StatusFlag.OVERSPEED, StatusFlag.JOINT_WALL
# Faults of single joints, and their words in the texts of events.
_JOINT_FAULTS = {
    flag: CONDITIONS[flag].event
    for flag in (StatusFlag.OVERSPEED, StatusFlag.JOINT_WALL)
} | {StatusFlag.SPEED_EXCEEDED: STOP_REASONS[StatusFlag.SPEED_EXCEEDED]}


class RunEvents:
    """Events of a run and height of its board, from status, positions and contact.

    Parameters
    ----------
    most_force : float
        Normal force above which it is an event, also where the controller measures none, N.
    compression : callable, optional
        Returns the compression of the felt, m, for normal forces, N: in contact the eraser is
        lower than the board by it.
    limits : JointLimits, optional
        Of the arm, to name the joint that is too fast or at its limit.
    """

    def __init__(
        self,
        most_force: float = np.inf,
        *,
        compression: Callable[[Array], Array] = np.zeros_like,
        limits: JointLimits | None = None,
    ) -> None:
        self._most_force, self._compression = most_force, compression
        self._limits = limits
        # Largest fraction of a speed limit and distance beyond a position limit, rad, while
        # these faults are present, and their joints.
        self._worst = dict.fromkeys(_JOINT_FAULTS, (-np.inf, 0))
        self._forces = Occurrences(_FORCE, "up to {:.0f} N")
        stop = CONDITIONS[StatusFlag.PROTECTIVE_STOP].event
        self._stops = {
            int(flag): Occurrences(stop, reason) for flag, reason in _STOPS.items()
        }
        self._lost = Occurrences(CONDITIONS[StatusFlag.CONTACT_LOST].event)
        below = CONDITIONS[StatusFlag.BELOW_SURFACE].event
        self._below = Occurrences(below, "up to {:.1f} mm deep")
        self._flag_faults = {
            int(flag): Occurrences(CONDITIONS[flag].event) for flag in _FLAG_FAULTS
        }
        self._cause = 0
        self._was_missing, self._missing_since, self._last_touch = False, -1.0, -np.inf
        self._last_landing = -np.inf
        self._touch = self._contact = np.inf
        self._heights = np.zeros(2 * _MAX_HEIGHT + 1, dtype=np.int64)

    def update(self, chunk: Chunk) -> None:
        """Add samples of `METRIC_SIGNALS`."""
        times, status = chunk["status"]
        flags = status[:, 0].astype(int)
        lost, stopped = flags & int(StatusFlag.CONTACT_LOST), flags & _STOPPED
        for flag, occurrences in self._flag_faults.items():
            occurrences.update(times, flags & flag)
        if self._limits is not None:
            for flag in self._worst:
                marked = times[flags & int(flag) > 0]
                if len(marked):
                    self._find_worst(flag, chunk["state"], marked, self._limits)

        depth = chunk["penetration"]
        millimetres = 1e3 * depth.values[:, 0]
        self._below.update(depth.times, millimetres * (depth.values[:, 0] > TOLERANCE))

        # Contact can be lost only after the controller has reported it. The status is zero
        # before the first update of the controller.
        force = chunk["normal_force"]
        pressing = force.values[:, 0]
        self._forces.update(force.times, pressing * (pressing > self._most_force))
        touching = force.times[pressing > CONTACT_FORCE]
        self._touch = min([self._touch, *touching[:1]])
        reported = times[(times >= self._touch) & (lost == 0) & (status[:, 2] > 0)]
        self._contact = min([self._contact, *reported[:1]])
        # After a lift the arm lands a little later than the skill.
        is_loss = self._is_loss(times, lost > 0, touching)
        self._lost.update(times, is_loss & (times >= self._contact))

        # The cause of a stop is the fault at its start.
        position_times, desired = chunk["desired_position"]
        error = chunk["measured_position"].values - desired
        rows = np.searchsorted(times, position_times - 1e-6)
        centimetres = np.full(len(times), _TINY)
        centimetres[rows] += 100 * np.linalg.norm(error, axis=1)
        faults = np.concatenate([[self._cause], flags & sum(self._stops)])
        latest = np.maximum.accumulate(np.where(faults > 0, np.arange(len(faults)), 0))
        cause = faults[latest][1:]
        self._cause = int(faults[latest[-1]])
        for flag, stop in self._stops.items():
            stop.update(times, centimetres * ((stopped > 0) & (cause & flag > 0)))

        # In contact, the eraser shows the height of the board.
        in_contact = (flags[rows] & (int(StatusFlag.CONTACT_LOST) | _NO_TARGET)) == 0
        in_contact &= (position_times >= self._contact) & (status[rows, 4] != 0)
        if np.any(in_contact) and len(pressing):
            heights = chunk["measured_position"].values[in_contact, 2]
            felt = np.interp(position_times[in_contact], force.times, pressing)
            heights = np.rint(1e3 * (heights + self._compression(felt)))
            heights = np.clip(heights, -_MAX_HEIGHT, _MAX_HEIGHT)
            np.add.at(self._heights, heights.astype(int) + _MAX_HEIGHT, 1)

    def _find_worst(
        self, flag: StatusFlag, state: Samples, times: Array, limits: JointLimits
    ) -> None:
        """Find the joint that is fastest, or nearest to its limit, at some times, s."""
        is_marked = np.isin(np.rint(1e3 * state.times), np.rint(1e3 * times))
        q, v = np.split(state.values[is_marked], 2, axis=1)
        excess = np.abs(v) / limits.speed
        if flag == StatusFlag.JOINT_WALL:
            excess = np.abs(q - limits.middle) - limits.half_range
        largest = np.max(excess, axis=0, initial=-np.inf)
        joint = int(np.argmax(largest))
        self._worst[flag] = max(self._worst[flag], (float(largest[joint]), joint))

    def _is_loss(self, times: Array, is_missing: Mask, touching: Array) -> Mask:
        """Return where missing contact was lost, or is not made for long after a lift.

        `touching` are the times of samples in contact.
        """
        if not len(times):
            return is_missing
        begins = is_missing & ~np.concatenate([[self._was_missing], is_missing[:-1]])
        since = np.where(begins, times, -np.inf)
        since = np.maximum.accumulate(np.maximum(since, self._missing_since))
        touches = np.concatenate([[self._last_touch], touching])
        landings = touching[np.diff(touches) > _JUST]
        landings = np.concatenate([[self._last_landing], landings])
        last, landed, latest = (
            events[np.maximum(np.searchsorted(events, moments, "right") - 1, 0)]
            for events, moments in (
                (touches, since),
                (landings, since),
                (touches, times),
            )
        )
        self._was_missing, self._missing_since = bool(is_missing[-1]), float(since[-1])
        self._last_touch, self._last_landing = float(touches[-1]), float(landings[-1])
        is_noticed_late = (since - landed < _JUST) & (times - latest < _TOUCHING)
        is_lost = (since - last < _JUST) & ~is_noticed_late
        return is_missing & (is_lost | (times - since > _LANDING))

    def result(self) -> list[RunEvent]:
        """Return the events so far, in chronological order."""
        faults = (
            *self._stops.values(),
            *self._flag_faults.values(),
            self._lost,
            self._below,
            self._forces,
        )
        events = [event for fault in faults for event in fault.events()]
        for words, detail in self._joint_details().items():
            events = [
                e._replace(text=e.text + detail) if words in e.text else e
                for e in events
            ]
        return sorted(events)

    def _joint_details(self) -> dict[str, str]:
        """Return texts about the worst joints, by the words of their faults."""
        details = {}
        for flag, (excess, joint) in self._worst.items():
            if self._limits is None or excess == -np.inf:
                continue
            if flag == StatusFlag.JOINT_WALL:
                is_small = abs(excess) < _SMALL
                size = f"less than {_SMALL}" if is_small else f"{abs(excess):.2f}"
                text = f"{size} rad {'beyond' if excess >= _SMALL else 'from'} it"
            else:
                limit = self._limits.speed[joint]
                text = (
                    f"at up to {100 * excess:.0f} % of its limit of {limit:.3g} rad/s"
                )
            details[_JOINT_FAULTS[flag]] = f": joint {joint + 1}, {text}"
        return details

    @property
    def board_height_error(self) -> float | None:
        """Median height of the board above the assumed one, m; None without contact."""
        counts = np.cumsum(self._heights)
        if not counts[-1]:
            return None
        return 1e-3 * (int(np.searchsorted(counts, counts[-1] / 2)) - _MAX_HEIGHT)
