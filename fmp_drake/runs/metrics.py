"""Metrics of a run, computed during the run without storing its samples.

The `update` of each class takes a chunk of the logged `METRIC_SIGNALS`, of any length, in
chronological order. Its `result` returns the metrics of all chunks so far.
"""

from collections.abc import Sequence
from functools import partial
from math import ceil
from typing import Any

import numpy as np

from fmp_drake.numeric import Array, Mask
from fmp_drake.primitives.data.channels import ChannelRoles
from fmp_drake.primitives.model.region import DemonstratedRegion
from fmp_drake.runs.events import Occurrences, RunEvent, RunEvents
from fmp_drake.runs.log import MILLISECOND, Chunk, Samples
from fmp_drake.station import Scenario
from fmp_drake.station.models.eraser import FeltCompression
from fmp_drake.station.scenario_parts import FORCE_TOLERANCE
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.impedance.force_control import CONTACT_FORCE
from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.ink.grid import (
    CLEAN_BELOW,
    InkGrid,
    cleaned_fraction,
    cleaned_history,
    missed_spots,
    times_to_clean,
)
from fmp_drake.systems.scripted_disturbances import Disturbance

PRECISE_FORCE = 0.1
"""Tolerance of a precise normal force, relative to its desired value."""

LANDING = 1.0
"""Duration of the rise of the force after the first contact, s; its errors do not count."""

RECOVERY = 2.0
"""Duration after a disturbance in which the force is not judged, s."""

# Bin width and range of the histogram of forces, N; the last bin contains larger forces.
_BIN, _MAX_FORCE = 0.01, 500.0
# Resolution of the times to 50, 90 and 99 %, which are rounded up, s.
_RESOLUTION = 0.05
# Unwanted contacts, and these together with interventions of the controller.
_TOUCHES = StatusFlag.BELOW_SURFACE | StatusFlag.ARM_TOUCHES
_FAULTS = StatusFlag.PROTECTIVE_STOP | StatusFlag.JOINT_WALL | _TOUCHES

METRIC_SIGNALS = (
    *("normal_force", "desired_normal_force", "desired_position", "desired_velocity"),
    *("measured_position", "state", "actuation", "torque", "status", "penetration"),
)
"""Names of the signals from which the metrics of every skill are computed."""

_POSITION = ChannelRoles(position=(0, 1, 2))
# Samples of a signal that is not measured.
_NO_SAMPLES = Samples(np.zeros(0), np.zeros((0, 1)))
_BOARD_METRICS = (
    "tracking_on_board_rms_m",
    "penetration_max_m",
    "arm_on_board_s",
    "board_height_error_m",
)


def metric_signals(roles: ChannelRoles) -> tuple[str, ...]:
    """Return the names of the signals from which a skill's metrics are computed.

    Parameters
    ----------
    roles : ChannelRoles
        Of the skill.

    Examples
    --------
    >>> roles = ChannelRoles(position=(0, 1, 2), rotation=(3, 4, 5))
    >>> metric_signals(roles)[-1]
    'tracking_error'
    """
    extra = [] if roles.rotation is None else ["tracking_error"]
    return (*METRIC_SIGNALS, *extra)


type Metrics = dict[str, float | int | None]


class _ErrorStatistics:
    """Root mean square and largest value of errors, computed from their squares."""

    def __init__(self) -> None:
        self._sum = 0.0
        self.count = 0
        self.largest = 0.0

    def update(self, squares: Array) -> None:
        """Add squares of errors, shape (N,)."""
        self._sum += float(np.sum(squares))
        self.count += len(squares)
        self.largest = float(np.sqrt(np.max(squares, initial=self.largest**2)))

    def rms(self) -> float:
        """Return the root mean square; 0 without errors."""
        return float(np.sqrt(self._sum / max(1, self.count)))


class ForceMetrics:
    """Statistics of the normal force of the eraser from its first contact.

    Parameters
    ----------
    desired_force : float
        Desired normal force, N; the signal desired_normal_force, if any, replaces it.
    has_channel : bool
        Whether the desired force is a channel of the skill: its error counts as well.
    disturbances : sequence of Disturbance
        The force during these, and for `RECOVERY` after each, does not count in
        ``normal_force_undisturbed_fraction``.
    """

    def __init__(
        self,
        desired_force: float,
        *,
        has_channel: bool = False,
        disturbances: Sequence[Disturbance] = (),
    ) -> None:
        self._desired, self._has_channel = desired_force, has_channel
        self._disturbances = disturbances
        self._undisturbed, self._undisturbed_near = 0, 0
        self._settling_end = 0.0
        self._error = _ErrorStatistics()
        self._counts = np.zeros(round(_MAX_FORCE / _BIN), dtype=np.int64)
        self._sum = 0.0
        self._near = self._precise = self._samples = 0
        self._largest = 0.0

    def update(self, chunk: Chunk) -> None:
        """Add samples of the normal force."""
        times, force = chunk["normal_force"].times, chunk["normal_force"].values[:, 0]
        self._largest = float(np.max(force, initial=self._largest))
        desired = np.full(len(force), self._desired)
        touching = force > CONTACT_FORCE
        if "desired_normal_force" in chunk:
            desired = chunk["desired_normal_force"].values[:, 0]
        first = 0
        if not self._samples:
            first = int(np.argmax(touching)) if np.any(touching) else len(force)
            self._settling_end = float(np.min(times[first:], initial=np.inf)) + LANDING
        self._samples += len(force) - first
        force, desired = force[touching], desired[touching]
        error = np.abs(force - desired)
        if self._has_channel:
            is_settled = times[touching] >= self._settling_end
            self._error.update(error[is_settled] ** 2)
        self._sum += float(np.sum(force))
        is_near = error <= FORCE_TOLERANCE
        self._near += int(np.sum(is_near))
        counts = np.ones(len(error), dtype=bool)
        for each in self._disturbances:
            counts &= ~each.is_active(times[touching], after=RECOVERY)
        self._undisturbed += int(np.sum(counts))
        self._undisturbed_near += int(np.sum(is_near & counts))
        self._precise += int(np.sum(error <= PRECISE_FORCE * desired))
        bins = np.minimum((force / _BIN).astype(int), len(self._counts) - 1)
        self._counts += np.bincount(bins, minlength=len(self._counts))

    def result(self) -> Metrics:
        """Return the metrics; all are zero before the first contact."""
        count = int(np.sum(self._counts))
        error, undisturbed = {}, None
        if self._undisturbed:
            undisturbed = self._undisturbed_near / self._undisturbed
        if self._error.count:
            error["normal_force_error_rms_n"] = self._error.rms()
        return {
            **error,
            "normal_force_mean_n": self._sum / max(1, count),
            "normal_force_p05_n": self._percentile(0.05) if count else 0.0,
            "normal_force_p95_n": self._percentile(0.95) if count else 0.0,
            "normal_force_max_n": self._largest,
            "normal_force_wanted_fraction": self._near / max(1, count),
            "normal_force_undisturbed_fraction": undisturbed,
            "normal_force_precise_fraction": self._precise / max(1, count),
            "contact_fraction": count / max(1, self._samples),
        }

    def _percentile(self, fraction: float) -> float:
        """Return a percentile of the forces in contact, interpolated within its bin."""
        cumulative = np.cumsum(self._counts)
        rank = fraction * (cumulative[-1] - 1)
        ranks = np.array([np.floor(rank), np.ceil(rank)])
        bins = np.searchsorted(cumulative, ranks, side="right")
        fractions = (ranks + 0.5 - cumulative[bins]) / self._counts[bins] + 1
        low, high = _BIN * (bins + fractions)
        return float(low + (rank - ranks[0]) * (high - low))


class TrackingMetrics:
    """Tracking error of the eraser, its desired contact, and smoothness of the motion.

    The error on the board excludes the direction of the normal during desired contact,
    where the board and the compression of the felt determine the position.

    Parameters
    ----------
    engage_height : float
        Height of the desired position over the board below which contact is desired, m.
    """

    def __init__(self, engage_height: float) -> None:
        self._engage_height = engage_height
        self._error, self._error_on_board = _ErrorStatistics(), _ErrorStatistics()
        self._jump = 0.0
        self._desired = self._touching = 0
        self._last: Array = np.zeros((0, 7))
        self._force = Samples(np.array([-np.inf]), np.zeros((1, 1)))

    def update(self, chunk: Chunk) -> None:
        """Add samples of positions, desired velocities and normal forces."""
        desired, velocity = chunk["desired_position"], chunk["desired_velocity"]
        measured = chunk["measured_position"]
        squares = (desired.values - measured.values) ** 2
        self._error.update(np.sum(squares, axis=1))
        squares[self._in_contact(desired, chunk["normal_force"]), 2] = 0.0
        self._error_on_board.update(np.sum(squares, axis=1))
        rows = np.column_stack([desired.times, desired.values, velocity.values])
        rows = np.concatenate([self._last, rows])
        # Displacement between consecutive samples according to the velocity.
        displacement = np.diff(rows[:, :1], axis=0) * (rows[1:, 4:] + rows[:-1, 4:]) / 2
        jumps = np.linalg.norm(np.diff(rows[:, 1:4], axis=0) - displacement, axis=1)
        self._jump = float(np.max(jumps, initial=self._jump))
        self._last = rows[-1:]

    def _in_contact(self, desired: Samples, force: Samples) -> Mask:
        """Return whether the eraser is in desired contact, from the latest force."""
        pairs = zip(self._force, force, strict=True)
        times, forces = (np.concatenate(pair) for pair in pairs)
        self._force = Samples(times[-1:], forces[-1:])
        latest = np.searchsorted(times, desired.times + 1e-6) - 1
        touching = forces[latest, 0] > CONTACT_FORCE
        is_desired = desired.values[:, 2] < self._engage_height
        in_contact = np.logical_and(touching, is_desired)
        # Count from the first contact.
        if self._touching or np.any(in_contact):
            first = 0 if self._touching else int(np.argmax(in_contact))
            self._desired += int(np.sum(is_desired[first:]))
            self._touching += int(np.sum(in_contact))
        return in_contact

    def result(self) -> Metrics:
        """Return the metrics."""
        return {
            "tracking_rms_m": self._error.rms(),
            "tracking_on_board_rms_m": self._error_on_board.rms(),
            "tracking_max_m": self._error.largest,
            "desired_position_jump_max_m": self._jump,
            "desired_contact_fraction": self._touching / max(1, self._desired),
        }


class OrientationMetrics:
    """Tracking error of the tool's orientation."""

    def __init__(self) -> None:
        self._error = _ErrorStatistics()

    def update(self, chunk: Chunk) -> None:
        """Add samples of the tracking error, whose first three columns are a rotation."""
        rotation = chunk["tracking_error"].values[:, :3]
        self._error.update(np.sum(rotation**2, axis=1))

    def result(self) -> Metrics:
        """Return the metrics."""
        return {
            "orientation_rms_deg": float(np.rad2deg(self._error.rms())),
            "orientation_max_deg": float(np.rad2deg(self._error.largest)),
        }


class RegionMetrics:
    """Distance of the eraser from the demonstrated paths, once it has reached them.

    Parameters
    ----------
    region : DemonstratedRegion, optional
        None if the paths are unknown.
    roles : ChannelRoles
        Of the skill.

    Attributes
    ----------
    outside : Occurrences
        Times at which the measured position was outside the margin of the region.
    """

    def __init__(
        self, region: DemonstratedRegion | None, roles: ChannelRoles = _POSITION
    ) -> None:
        self._region, self._roles = region, roles
        self._distances = {n: _ErrorStatistics() for n in ("desired", "measured")}
        self.outside = Occurrences(
            "the eraser was outside the demonstrated region",
            "up to {:.0f} mm from its paths",
        )

    def update(self, chunk: Chunk) -> None:
        """Add samples of positions."""
        if self._region is None:
            return
        for name, distances in self._distances.items():
            position = chunk[f"{name}_position"].values
            values = np.zeros((len(position), self._roles.count))
            values[:, self._roles.position] = position
            distance = self._region.distance(values)
            has_entered = np.logical_or.accumulate(distance <= self._region.margin)
            has_entered |= distances.count > 0
            if name == "measured":
                outside = has_entered & (distance > self._region.margin)
                self.outside.update(
                    chunk["measured_position"].times, 1e3 * outside * distance
                )
            distances.update(distance[has_entered] ** 2)

    def result(self) -> Metrics:
        """Return the metrics; None if the paths were never reached or are unknown."""
        return {
            f"{name}_off_paths_rms_m": distances.rms() if distances.count else None
            for name, distances in self._distances.items()
        }


class LimitMetrics:
    """Margins from the arm's limits, and duration of the controller's interventions.

    Parameters
    ----------
    limits : JointLimits
        Of the arm.
    control_period : float
        Seconds between two updates of the commanded torque, which is logged every
        millisecond.
    """

    def __init__(self, limits: JointLimits, *, control_period: float) -> None:
        self._limits = limits
        # The torque changes once per update of the controller.
        updates = ceil(MILLISECOND / control_period - 1e-9)
        self._torque_period = updates * control_period
        self._effort = self._rate = self._speed = 0.0
        self._margin = np.inf
        self._faults = self._samples = self._touches = self._stops = 0
        self._depth = 0.0
        self._last: Array = np.zeros((0, len(limits.speed)))

    def update(self, chunk: Chunk) -> None:
        """Add samples of the arm's state, the torques and the controller's status."""
        limits = self._limits
        q, v = np.split(chunk["state"].values, 2, axis=1)
        margin = limits.half_range - np.abs(q - limits.middle)
        self._margin = float(np.min(margin, initial=self._margin))
        self._speed = float(np.max(np.abs(v) / limits.speed, initial=self._speed))
        effort = np.abs(chunk["actuation"].values) / limits.upper_effort
        self._effort = float(np.max(effort, initial=self._effort))
        torque = np.concatenate([self._last, chunk["torque"].values])
        rate = np.abs(np.diff(torque, axis=0)) / self._torque_period
        self._rate = float(np.max(rate, initial=self._rate))
        self._last = torque[-1:]
        flags = chunk["status"].values[:, 0].astype(int)
        self._faults += int(np.count_nonzero(flags & int(_FAULTS)))
        self._touches += int(np.count_nonzero(flags & int(StatusFlag.ARM_TOUCHES)))
        self._stops += int(np.count_nonzero(flags & int(StatusFlag.PROTECTIVE_STOP)))
        self._samples += len(flags)
        depth = chunk["penetration"].values
        self._depth = float(np.max(depth, initial=self._depth))

    def result(self) -> Metrics:
        """Return the metrics."""
        return {
            "torque_ratio_max": self._effort,
            "torque_rate_max_nm_per_s": self._rate,
            "joint_limit_margin_min_rad": self._margin,
            "joint_speed_ratio_max": self._speed,
            "penetration_max_m": self._depth,
            "arm_on_board_s": self._touches * MILLISECOND,
            "protective_stop_s": self._stops * MILLISECOND,
            "fault_fraction": self._faults / max(1, self._samples),
        }


class RunMetrics:
    """Metrics and events of a run of any arm, at a board or in free space.

    Parameters
    ----------
    scenario : Scenario
    region : DemonstratedRegion or None
        Of the skill; None if its paths are unknown.
    limits : JointLimits
        Of the arm.
    control_period : float
        As for `LimitMetrics`.
    contact_height : float
        As for the controller, m.
    roles : ChannelRoles
        Of the skill; errors of orientation and force need such channels.
    """

    def __init__(
        self,
        scenario: Scenario,
        region: DemonstratedRegion | None,
        limits: JointLimits,
        *,
        control_period: float,
        contact_height: float = 0.0,
        roles: ChannelRoles = _POSITION,
    ) -> None:
        press, has_force = scenario.press, roles.force is not None
        self._has_board = scenario.has_board
        self._region = RegionMetrics(region, roles)
        self._limits = LimitMetrics(limits, control_period=control_period)
        force = ForceMetrics(
            press.force, has_channel=has_force, disturbances=scenario.disturbances
        )
        self._played: tuple[Any, ...] = (
            *([force] if self._has_board else []),
            TrackingMetrics(contact_height + press.engage_height),
            *([] if roles.rotation is None else [OrientationMetrics()]),
            self._region,
        )
        excess = scenario.impedance.watchdog.max_excess_force
        self._events = RunEvents(
            np.inf if has_force else 2 * press.force + excess,
            compression=partial(FeltCompression, scenario.eraser),
            limits=limits,
        )

    def update(self, chunk: Chunk, *, played: Chunk | None = None) -> None:
        """Add the next samples of `metric_signals`.

        Parameters
        ----------
        chunk : mapping of str to Samples
            Without the penetration if it is not measured.
        played : mapping of str to Samples, optional
            The samples during playback of the skill; all if None. The other samples are
            used for the limits only.
        """
        played = chunk if played is None else played
        if not self._has_board:  # There is a force by external torques, but no contact.
            played = {**played, "normal_force": _NO_SAMPLES}
        played = {"penetration": _NO_SAMPLES, **played}
        self._limits.update({"penetration": _NO_SAMPLES, **chunk})
        for part in (*self._played, self._events):
            part.update(played)

    def result(self) -> Metrics:
        """Return the metrics so far."""
        parts = (*self._played, self._limits)
        result = {name: x for part in parts for name, x in part.result().items()}
        result["board_height_error_m"] = self._events.board_height_error
        for name in () if self._has_board else _BOARD_METRICS:
            del result[name]
        return result

    def events(self) -> list[RunEvent]:
        """Return the events so far, in chronological order."""
        return sorted([*self._events.result(), *self._region.outside.events()])


def ink_metrics(
    *,
    ink: Array,
    initial_ink: Array,
    erase_time: Array,
    area: Mask,
    grid: InkGrid,
    seconds: float,
) -> Metrics:
    """Return the metrics of the ink; the time to a fraction not reached is None.

    Parameters
    ----------
    ink, initial_ink, erase_time : ndarray, shape (ny, nx)
        Remaining ink, initial ink, and the time at which each cell became clean, s, from
        `InkBoard` and `EraseTimes`.
    area : ndarray of bool, shape (ny, nx)
        Demonstrated area.
    grid : InkGrid
    seconds : float
        Length of the run.
    """
    inked = initial_ink >= CLEAN_BELOW
    target = area & inked
    spots = missed_spots(ink, target, grid=grid)
    times = _RESOLUTION * np.arange(int(seconds / _RESOLUTION + 1e-6) + 1)
    # The times of events are sums, with rounding errors.
    history = cleaned_history(erase_time, target, times + 1e-9)
    times_reached = times_to_clean(times, history)
    return {
        "cleaned_fraction": cleaned_fraction(ink, inked),
        "cleaned_fraction_of_demonstrated_area": spots.cleaned_fraction,
        **{f"seconds_to_{100 * f:.0f}_percent": t for f, t in times_reached.items()},
        "missed_spots": spots.count,
        "missed_area_cm2": spots.area_cm2,
        "missed_largest_cm2": spots.largest_cm2,
    }
