"""Metrics of a run, computed during the run without keeping its samples in memory.

The `update` of each class takes a chunk of the logged `METRIC_SIGNALS`, of any length, in
the order of time. Its `result` returns the metrics of all chunks so far.
"""

from dataclasses import dataclass
from math import ceil
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant

from fmp_drake.primitives.data.channels import ChannelRoles
from fmp_drake.primitives.model.region import DemonstratedRegion
from fmp_drake.runs.events import Occurrences, RunEvent, RunEvents
from fmp_drake.runs.signals import MILLISECOND, Chunk, Samples
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.impedance.force_control import CONTACT_FORCE
from fmp_drake.systems.impedance.status import StatusFlag
from fmp_drake.systems.ink.grid import CLEAN_BELOW, InkGrid, cleaned_fraction
from fmp_drake.systems.ink.metrics import (
    cleaned_history,
    missed_spots,
    times_to_clean,
)

NEAR_FORCE = 5.0
"""Tolerance of the normal force around its desired value, N."""

PRECISE_FORCE = 0.1
"""Tolerance of a precise normal force, relative to its desired value."""

LANDING = 1.0
"""Time from the first contact in which the force rises; its error does not count, s."""

# Bin width and range of the histogram of forces, N; larger forces fall into the last bin.
_BIN, _LARGEST_FORCE = 0.01, 500.0
# Resolution of the times to 50, 90 and 99 %, which are rounded up, s.
_RESOLUTION = 0.05
# Interventions of the controller, and contacts that should not occur.
_TOUCHES = StatusFlag.BELOW_SURFACE | StatusFlag.ARM_TOUCHES
_FAULTS = StatusFlag.PROTECTIVE_STOP | StatusFlag.JOINT_WALL | _TOUCHES

METRIC_SIGNALS = (
    *("normal_force", "desired_position", "desired_velocity"),
    *("measured_position", "state", "actuation", "torque", "status", "penetration"),
)
"""Names of the signals from which the metrics of every skill are computed."""

_POSITION = ChannelRoles(position=(0, 1, 2))
# Samples of a signal that is not measured.
_NONE = Samples(np.zeros(0), np.zeros((0, 1)))
# Metrics that need a board.
_OF_A_BOARD = ("tracking_on_board_rms_m", "penetration_max_m", "arm_on_board_s")


def metric_signals(roles: ChannelRoles) -> tuple[str, ...]:
    """Return the names of the signals from which a skill's metrics are computed.

    Parameters
    ----------
    roles : ChannelRoles
        Of the skill.

    Examples
    --------
    >>> roles = ChannelRoles(position=(0, 1, 2), force=3)
    >>> metric_signals(roles)[-1]
    'desired_normal_force'
    """
    extra = [] if roles.rotation is None else ["tracking_error"]
    extra += [] if roles.force is None else ["desired_normal_force"]
    return (*METRIC_SIGNALS, *extra)


type Metrics = dict[str, float | int | None]


class ForceMetrics:
    """Statistics of the normal force of the eraser from its first contact.

    Parameters
    ----------
    desired_force : float
        Desired normal force, N; where it changes, the signal desired_normal_force counts.
    """

    def __init__(self, desired_force: float) -> None:
        self._desired = desired_force
        self._squares = self._landed = 0.0
        self._settled = 0
        self._counts = np.zeros(round(_LARGEST_FORCE / _BIN), dtype=np.int64)
        self._sum = 0.0
        self._near = self._precise = self._samples = 0
        self._largest = 0.0

    def update(self, chunk: Chunk) -> None:
        """Add samples of the normal force."""
        times, force = chunk["normal_force"].times, chunk["normal_force"].values[:, 0]
        self._largest = float(np.max(force, initial=self._largest))
        desired = np.full(len(force), self._desired)
        touching = force > CONTACT_FORCE
        if varies := "desired_normal_force" in chunk:
            desired = chunk["desired_normal_force"].values[:, 0]
        if not self._samples:
            first = int(np.argmax(touching)) if np.any(touching) else len(force)
            force, touching, desired = force[first:], touching[first:], desired[first:]
            times = times[first:]
            self._landed = float(np.min(times, initial=np.inf)) + LANDING
        self._samples += len(force)
        pressed, desired = force[touching], desired[touching]
        error = np.abs(pressed - desired)
        if varies:
            settled = times[touching] >= self._landed
            self._squares += float(np.sum(error[settled] ** 2))
            self._settled += int(np.sum(settled))
        self._sum += float(np.sum(pressed))
        self._near += int(np.sum(error <= NEAR_FORCE))
        self._precise += int(np.sum(error <= PRECISE_FORCE * desired))
        bins = np.minimum((pressed / _BIN).astype(int), len(self._counts) - 1)
        self._counts += np.bincount(bins, minlength=len(self._counts))

    def result(self) -> Metrics:
        """Return the metrics; all are zero before the first contact."""
        pressed = int(np.sum(self._counts))
        error = {}
        if self._settled:
            error["normal_force_error_rms_n"] = (self._squares / self._settled) ** 0.5
        return {
            **error,
            "normal_force_mean_n": self._sum / max(1, pressed),
            "normal_force_p05_n": self._percentile(0.05) if pressed else 0.0,
            "normal_force_p95_n": self._percentile(0.95) if pressed else 0.0,
            "normal_force_max_n": self._largest,
            "normal_force_wanted_fraction": self._near / max(1, pressed),
            "normal_force_precise_fraction": self._precise / max(1, pressed),
            "contact_fraction": pressed / max(1, self._samples),
        }

    def _percentile(self, fraction: float) -> float:
        """Return a percentile of the forces in contact, interpolated within its bin."""
        cumulative = np.cumsum(self._counts)
        rank = fraction * (cumulative[-1] - 1)
        ranks = np.array([np.floor(rank), np.ceil(rank)])
        bins = np.searchsorted(cumulative, ranks, side="right")
        within = (ranks + 0.5 - cumulative[bins]) / self._counts[bins] + 1
        low, high = _BIN * (bins + within)
        return float(low + (rank - ranks[0]) * (high - low))


class TrackingMetrics:
    """Tracking error of the eraser, its desired contact, and smoothness of the motion.

    The error on the board leaves out the direction of the normal while the eraser is in
    desired contact: there the real board and the compression of the felt set its position.

    Parameters
    ----------
    engage_height : float
        Height of the desired position over the board below which contact is desired, m.
    """

    def __init__(self, engage_height: float) -> None:
        self._engage_height = engage_height
        self._squares = self._on_board = self._largest = self._jump = 0.0
        self._samples = self._desired = self._touching = 0
        self._last: NDArray[np.float64] = np.zeros((0, 7))
        self._force = Samples(np.array([-np.inf]), np.zeros((1, 1)))

    def update(self, chunk: Chunk) -> None:
        """Add samples of positions, desired velocities and normal forces."""
        desired, velocity = chunk["desired_position"], chunk["desired_velocity"]
        measured = chunk["measured_position"]
        components = (desired.values - measured.values) ** 2
        squares = np.sum(components, axis=1)
        in_contact = self._in_contact(desired, chunk["normal_force"])
        along_normal = components[:, 2] * ~in_contact
        self._on_board += float(np.sum(components[:, :2]) + np.sum(along_normal))
        self._squares += float(np.sum(squares))
        self._largest = float(np.sqrt(np.max(squares, initial=self._largest**2)))
        self._samples += len(squares)
        rows = np.column_stack([desired.times, desired.values, velocity.values])
        rows = np.concatenate([self._last, rows])
        # Displacement from one sample to the next according to the velocity.
        explained = np.diff(rows[:, :1], axis=0) * (rows[1:, 4:] + rows[:-1, 4:]) / 2
        jumps = np.linalg.norm(np.diff(rows[:, 1:4], axis=0) - explained, axis=1)
        self._jump = float(np.max(jumps, initial=self._jump))
        self._last = rows[-1:]

    def _in_contact(self, desired: Samples, force: Samples) -> NDArray[np.bool_]:
        """Return whether the eraser is in desired contact, by the latest force."""
        both = zip(self._force, force, strict=True)
        times, forces = (np.concatenate(parts) for parts in both)
        self._force = Samples(times[-1:], forces[-1:])
        before = np.searchsorted(times, desired.times + 1e-6) - 1
        touching = forces[before, 0] > CONTACT_FORCE
        is_desired = desired.values[:, 2] < self._engage_height
        in_contact = np.logical_and(touching, is_desired)
        # From the first contact on.
        if self._touching or np.any(in_contact):
            first = 0 if self._touching else int(np.argmax(in_contact))
            self._desired += int(np.sum(is_desired[first:]))
            self._touching += int(np.sum(in_contact))
        return in_contact

    def result(self) -> Metrics:
        """Return the metrics."""
        samples = max(1, self._samples)
        return {
            "tracking_rms_m": float(np.sqrt(self._squares / samples)),
            "tracking_on_board_rms_m": float(np.sqrt(self._on_board / samples)),
            "tracking_max_m": self._largest,
            "desired_position_jump_max_m": self._jump,
            "desired_contact_fraction": self._touching / max(1, self._desired),
        }


class OrientationMetrics:
    """Error of the tool's orientation, as `TrackingMetrics` has that of its position."""

    def __init__(self) -> None:
        self._squares = self._largest = 0.0
        self._samples = 0

    def update(self, chunk: Chunk) -> None:
        """Add samples of the tracking error, whose first three columns are a rotation."""
        squares = np.sum(chunk["tracking_error"].values[:, :3] ** 2, axis=1)
        self._squares += float(np.sum(squares))
        self._largest = float(np.sqrt(np.max(squares, initial=self._largest**2)))
        self._samples += len(squares)

    def result(self) -> Metrics:
        """Return the metrics."""
        rms = np.sqrt(self._squares / max(1, self._samples))
        return {
            "orientation_rms_deg": float(np.rad2deg(rms)),
            "orientation_max_deg": float(np.rad2deg(self._largest)),
        }


class RegionMetrics:
    """Distance of the eraser from the demonstrated paths after it has reached them.

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
        self._squares = dict.fromkeys(("desired", "measured"), 0.0)
        self._samples = dict.fromkeys(self._squares, 0)
        self.outside = Occurrences(
            "the eraser was outside the demonstrated region",
            "up to {:.0f} mm from its paths",
        )

    def update(self, chunk: Chunk) -> None:
        """Add samples of positions."""
        if self._region is None:
            return
        for name in self._squares:
            position = chunk[f"{name}_position"].values
            values = np.zeros((len(position), self._roles.count))
            values[:, self._roles.position] = position
            distance = self._region.distance(values)
            inside = np.logical_or.accumulate(distance <= self._region.margin)
            inside |= self._samples[name] > 0
            if name == "measured":
                outside = inside & (distance > self._region.margin)
                self.outside.update(
                    chunk["measured_position"].times, 1e3 * outside * distance
                )
            self._samples[name] += int(np.sum(inside))
            self._squares[name] += float(np.sum(distance[inside] ** 2))

    def result(self) -> Metrics:
        """Return the metrics; None if the paths were never reached or are unknown."""
        return {
            f"{name}_off_paths_rms_m": float(np.sqrt(squares / self._samples[name]))
            if self._samples[name]
            else None
            for name, squares in self._squares.items()
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmLimits:
    """Limits of the arm's n joints: positions, speeds and torques, each (n,)."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    speed: NDArray[np.float64]
    torque: NDArray[np.float64]

    @classmethod
    def of(cls, arm: MultibodyPlant) -> Self:
        """Return the limits of an arm, of which the plant has nothing else that moves."""
        return cls(
            lower=arm.GetPositionLowerLimits(),
            upper=arm.GetPositionUpperLimits(),
            speed=arm.GetVelocityUpperLimits(),
            torque=arm.GetEffortUpperLimits(),
        )


class LimitMetrics:
    """Margins of the arm's limits, and fraction of time of the controller's interventions.

    Parameters
    ----------
    limits : ArmLimits
    control_period : float
        Seconds between two updates of the commanded torque, which is logged every
        millisecond.
    """

    def __init__(self, limits: ArmLimits, *, control_period: float) -> None:
        self._limits = limits
        # The torque changes once per update of the controller.
        updates = ceil(MILLISECOND / control_period - 1e-9)
        self._torque_period = updates * control_period
        self._effort = self._rate = self._speed = 0.0
        self._margin = np.inf
        self._faults = self._samples = self._touches = self._stops = 0
        self._depth = 0.0
        self._last: NDArray[np.float64] = np.zeros((0, len(limits.lower)))

    def update(self, chunk: Chunk) -> None:
        """Add samples of the arm's state, the torques and the controller's status."""
        limits = self._limits
        q, v = np.split(chunk["state"].values, 2, axis=1)
        margin = np.minimum(q - limits.lower, limits.upper - q)
        self._margin = float(np.min(margin, initial=self._margin))
        self._speed = float(np.max(np.abs(v) / limits.speed, initial=self._speed))
        effort = np.abs(chunk["actuation"].values) / limits.torque
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
    """Metrics and events of one run, on any arm, at a board or in free space.

    Parameters
    ----------
    scenario : Scenario
    region : DemonstratedRegion or None
        Of the skill; None where its paths are unknown.
    limits : ArmLimits
    control_period : float
        As for `LimitMetrics`.
    roles : ChannelRoles
        Of the skill: there are errors of the orientation and of the force where it has them.
    """

    def __init__(
        self,
        scenario: Scenario,
        region: DemonstratedRegion | None,
        limits: ArmLimits,
        *,
        control_period: float,
        roles: ChannelRoles = _POSITION,
    ) -> None:
        press = scenario.press
        self._has_board = scenario.has_board
        self._region = RegionMetrics(region, roles)
        self._limits = LimitMetrics(limits, control_period=control_period)
        self._played: tuple[Any, ...] = (
            *([ForceMetrics(press.force)] if self._has_board else []),
            TrackingMetrics(press.engage_height),
            *([] if roles.rotation is None else [OrientationMetrics()]),
            self._region,
        )
        excess = scenario.impedance.watchdog.max_excess_force
        has_force = roles.force is not None
        self._events = RunEvents(np.inf if has_force else 2 * press.force + excess)

    def update(self, chunk: Chunk, *, played: Chunk | None = None) -> None:
        """Take the next samples of `metric_signals`.

        Parameters
        ----------
        chunk : mapping of str to Samples
            Without the penetration where nothing measures it.
        played : mapping of str to Samples, optional
            The samples during which the skill was played; all where None. The others
            count for the limits only.
        """
        played = chunk if played is None else played
        if not self._has_board:  # External joint torques are not a normal force there.
            played = {**played, "normal_force": _NONE}
        played = {"penetration": _NONE, **played}
        self._limits.update({"penetration": _NONE, **chunk})
        for part in (*self._played, self._events):
            part.update(played)

    def result(self) -> Metrics:
        """Return the metrics so far."""
        parts = (*self._played, self._limits)
        result = {name: x for part in parts for name, x in part.result().items()}
        for name in () if self._has_board else _OF_A_BOARD:
            del result[name]
        return result

    def events(self) -> list[RunEvent]:
        """Return the events so far, in the order of time."""
        return sorted([*self._events.result(), *self._region.outside.events()])


def ink_metrics(
    *,
    ink: NDArray[np.float64],
    initial_ink: NDArray[np.float64],
    erase_time: NDArray[np.float64],
    area: NDArray[np.bool_],
    grid: InkGrid,
    seconds: float,
) -> Metrics:
    """Return the metrics of the ink; a time that was never reached is None.

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
    times = _RESOLUTION * np.arange(int(seconds / _RESOLUTION) + 1)
    times_reached = times_to_clean(times, cleaned_history(erase_time, target, times))
    return {
        "cleaned_fraction": cleaned_fraction(ink, inked),
        "cleaned_fraction_of_demonstrated_area": spots.cleaned_fraction,
        **{f"seconds_to_{100 * f:.0f}_percent": t for f, t in times_reached.items()},
        "missed_spots": spots.count,
        "missed_area_cm2": spots.area_cm2,
        "missed_largest_cm2": spots.largest_cm2,
    }
