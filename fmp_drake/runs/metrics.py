"""The metrics of a run, computed while it goes: nothing of it is kept in memory.

Each class takes chunks of the logged signals, of any length and in the order of time,
and says at any moment what they amount to so far. `METRIC_SIGNALS` are those it takes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives import DemonstratedRegion
from fmp_drake.runs.occurrences import Occurrences
from fmp_drake.runs.signals import MILLISECOND
from fmp_drake.systems.impedance.status import StatusFlag

CONTACT_FORCE = 0.5
"""The normal force from which on the eraser touches the board, N."""
NEAR_FORCE = 5.0
"""How far from the wanted normal force it may be, N."""

# Of the histogram of forces, N; larger forces than the largest count as that one.
_BIN, _LARGEST_FORCE = 0.01, 500.0
# What the controller should not have to do.
_TOUCHES = StatusFlag.BELOW_SURFACE | StatusFlag.ARM_TOUCHES
_FAULTS = StatusFlag.PROTECTIVE_STOP | StatusFlag.JOINT_WALL | _TOUCHES

METRIC_SIGNALS = (
    *("normal_force", "desired_position", "desired_velocity"),
    *("measured_position", "state", "actuation", "torque", "status", "penetration"),
)
"""Names of the signals that the metrics are computed from."""

type Metrics = dict[str, float | int | None]
type Chunk = Mapping[str, Samples]


class Samples(NamedTuple):
    """Logged samples of one signal: times (N,) in s and values (N, columns)."""

    times: NDArray[np.float64]
    values: NDArray[np.float64]


class ForceMetrics:
    """How hard and how constantly the eraser presses, from its first contact on.

    Parameters
    ----------
    wanted : float
        Normal force, N.
    """

    def __init__(self, wanted: float) -> None:
        self._low, self._high = wanted - NEAR_FORCE, wanted + NEAR_FORCE
        self._counts = np.zeros(round(_LARGEST_FORCE / _BIN), dtype=np.int64)
        self._sum = 0.0
        self._wanted = self._samples = 0

    def update(self, chunk: Chunk) -> None:
        """Take the next normal forces."""
        force = chunk["normal_force"].values[:, 0]
        touching = force > CONTACT_FORCE
        if not self._samples:
            first = int(np.argmax(touching)) if np.any(touching) else len(force)
            force, touching = force[first:], touching[first:]
        self._samples += len(force)
        pressed = force[touching]
        near = (pressed >= self._low) & (pressed <= self._high)
        self._sum += float(np.sum(pressed))
        self._wanted += int(np.sum(near))
        bins = np.minimum((pressed / _BIN).astype(int), len(self._counts) - 1)
        self._counts += np.bincount(bins, minlength=len(self._counts))

    def result(self) -> Metrics:
        """Return the metrics; all are zero before the first contact."""
        pressed = int(np.sum(self._counts))
        return {
            "normal_force_mean_n": self._sum / max(1, pressed),
            "normal_force_p05_n": self._percentile(0.05) if pressed else 0.0,
            "normal_force_p95_n": self._percentile(0.95) if pressed else 0.0,
            "normal_force_wanted_fraction": self._wanted / max(1, pressed),
            "contact_fraction": pressed / max(1, self._samples),
        }

    def _percentile(self, fraction: float) -> float:
        """Return a percentile of the forces in contact, to the width of a bin."""
        until = np.cumsum(self._counts)
        rank = fraction * (until[-1] - 1)
        ranks = np.array([np.floor(rank), np.ceil(rank)])
        found = np.searchsorted(until, ranks, side="right")
        within = (ranks + 0.5 - until[found]) / self._counts[found] + 1
        low, high = _BIN * (found + within)
        return float(low + (rank - ranks[0]) * (high - low))


class TrackingMetrics:
    """How closely the desired motion is followed, and how smooth it is.

    Also on the board as it is: its height, and how far the felt gives way, say where an
    eraser is along the normal that touches where it shall touch.

    Parameters
    ----------
    engage_height : float
        Of the desired position over the board, below which contact is wanted, m.
    """

    def __init__(self, engage_height: float) -> None:
        self._engage_height = engage_height
        self._squares = self._on_board = self._largest = self._jump = 0.0
        self._samples = 0
        self._last: NDArray[np.float64] = np.zeros((0, 7))
        self._force = Samples(np.array([-np.inf]), np.zeros((1, 1)))

    def update(self, chunk: Chunk) -> None:
        """Take the next positions, desired velocities and normal forces."""
        desired, velocity = chunk["desired_position"], chunk["desired_velocity"]
        measured = chunk["measured_position"]
        each = (desired.values - measured.values) ** 2
        squares = np.sum(each, axis=1)
        along_normal = each[:, 2] * ~self._touches(desired, chunk["normal_force"])
        self._on_board += float(np.sum(each[:, :2]) + np.sum(along_normal))
        self._squares += float(np.sum(squares))
        self._largest = float(np.sqrt(np.max(squares, initial=self._largest**2)))
        self._samples += len(squares)
        rows = np.column_stack([desired.times, desired.values, velocity.values])
        rows = np.concatenate([self._last, rows])
        # What the velocity explains of the way from a sample to the next.
        explained = np.diff(rows[:, :1], axis=0) * (rows[1:, 4:] + rows[:-1, 4:]) / 2
        jumps = np.linalg.norm(np.diff(rows[:, 1:4], axis=0) - explained, axis=1)
        self._jump = float(np.max(jumps, initial=self._jump))
        self._last = rows[-1:]

    def _touches(self, desired: Samples, force: Samples) -> NDArray[np.bool_]:
        """Return whether the eraser touches where it shall, by the force before."""
        both = zip(self._force, force, strict=True)
        times, forces = (np.concatenate(parts) for parts in both)
        self._force = Samples(times[-1:], forces[-1:])
        before = np.searchsorted(times, desired.times + 1e-6) - 1
        touching = forces[before, 0] > CONTACT_FORCE
        wanted = desired.values[:, 2] < self._engage_height
        return np.logical_and(touching, wanted)

    def result(self) -> Metrics:
        """Return the metrics."""
        samples = max(1, self._samples)
        return {
            "tracking_rms_m": float(np.sqrt(self._squares / samples)),
            "tracking_on_board_rms_m": float(np.sqrt(self._on_board / samples)),
            "tracking_max_m": self._largest,
            "desired_position_jump_max_m": self._jump,
        }


class RegionMetrics:
    """How far from the demonstrated paths the eraser was, once it had come to them.

    Parameters
    ----------
    region : DemonstratedRegion, optional
        None where the paths are unknown.

    Attributes
    ----------
    outside : Occurrences
        When the measured position was farther from them than the region's margin.
    """

    def __init__(self, region: DemonstratedRegion | None) -> None:
        self._region = region
        self._largest = dict.fromkeys(("desired", "measured"), 0.0)
        self._inside = dict.fromkeys(self._largest, False)
        self.outside = Occurrences(
            "the eraser was outside what was demonstrated",
            "up to {:.0f} mm from its paths",
        )

    def update(self, chunk: Chunk) -> None:
        """Take the next positions."""
        if self._region is None:
            return
        for name in self._largest:
            distance = self._region.distance(chunk[f"{name}_position"].values)
            inside = np.logical_or.accumulate(distance <= self._region.margin)
            inside |= self._inside[name]
            counted = distance[inside]
            if name == "measured":
                left = inside & (distance > self._region.margin)
                self.outside.update(
                    chunk["measured_position"].times, 1e3 * left * distance
                )
            self._inside[name] |= bool(np.any(inside))
            self._largest[name] = np.max(counted, initial=self._largest[name])

    def result(self) -> Metrics:
        """Return the metrics; None where nothing was near the paths, or they are unknown."""
        return {
            f"{name}_off_paths_max_m": float(largest) if self._inside[name] else None
            for name, largest in self._largest.items()
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLimits:
    """Limits of the arm's n joints: positions, speeds and torques, each (n,)."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    speed: NDArray[np.float64]
    torque: NDArray[np.float64]


class LimitMetrics:
    """How far the arm stays from every limit, and how often the controller steps in.

    Parameters
    ----------
    limits : JointLimits
    """

    def __init__(self, limits: JointLimits) -> None:
        self._limits = limits
        self._effort = self._rate = self._speed = 0.0
        self._margin = np.inf
        self._faults = self._samples = self._touches = 0
        self._depth = 0.0
        self._last: NDArray[np.float64] = np.zeros((0, len(limits.lower)))

    def update(self, chunk: Chunk) -> None:
        """Take the next states of the arm, torques and states of the controller."""
        limits = self._limits
        q, v = np.split(chunk["state"].values, 2, axis=1)
        margin = np.minimum(q - limits.lower, limits.upper - q)
        self._margin = float(np.min(margin, initial=self._margin))
        self._speed = float(np.max(np.abs(v) / limits.speed, initial=self._speed))
        effort = np.abs(chunk["actuation"].values) / limits.torque
        self._effort = float(np.max(effort, initial=self._effort))
        torque = np.concatenate([self._last, chunk["torque"].values])
        rate = np.abs(np.diff(torque, axis=0)) / MILLISECOND
        self._rate = float(np.max(rate, initial=self._rate))
        self._last = torque[-1:]
        flags = chunk["status"].values[:, 0].astype(int)
        self._faults += int(np.count_nonzero(flags & int(_FAULTS)))
        self._touches += int(np.count_nonzero(flags & int(StatusFlag.ARM_TOUCHES)))
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
            "fault_fraction": self._faults / max(1, self._samples),
        }
