"""The figures of a run: how well it wiped, and how far it was from every limit."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.runs.wiping_run import STEP, WipingRun
from fmp_drake.systems.impedance.status import StatusFlag
from fmp_drake.systems.ink.grid import CLEAN_BELOW, cleaned_fraction
from fmp_drake.systems.ink.metrics import (
    cleaned_history,
    missed_spots,
    times_to_clean,
)

_CONTACT_FORCE = 0.5
WANTED_FORCE = (5.0, 15.0)
"""The press that is wanted, N."""

# What the controller should not have to do.
_FAULTS = StatusFlag.PROTECTIVE_STOP | StatusFlag.JOINT_WALL

type Figures = dict[str, float | int | None]


def run_figures(run: WipingRun) -> Figures:
    """Return the figures of a run; what was never reached is None."""
    return {**_ink(run), **_force(run), **_motion(run), **_limits(run)}


def _ink(run: WipingRun) -> Figures:
    ink = run.ink()
    inked = run.initial_ink >= CLEAN_BELOW
    area = run.demonstrated_area() & inked
    spots = missed_spots(ink, area, grid=run.grid)
    times = run.log_times("cleaned_fraction")
    reached = times_to_clean(
        times, cleaned_history(run.output("erase_time"), area, times)
    )
    return {
        "cleaned_fraction": cleaned_fraction(ink, inked),
        "cleaned_fraction_of_demonstrated_area": spots.cleaned_fraction,
        **{f"seconds_to_{100 * f:.0f}_percent": t for f, t in reached.items()},
        "missed_spots": spots.count,
        "missed_area_cm2": spots.area_cm2,
        "missed_largest_cm2": spots.largest_cm2,
    }


def _force(run: WipingRun) -> Figures:
    force = run.log("normal_force")[:, 0]
    touching = force > _CONTACT_FORCE
    since = force[np.argmax(touching) :] if np.any(touching) else force[:0]
    pressed = since[since > _CONTACT_FORCE]
    if not len(pressed):
        pressed = np.zeros(1)
    low, high = WANTED_FORCE
    p05, p95 = np.percentile(pressed, [5, 95])
    return {
        "normal_force_mean_n": float(np.mean(pressed)),
        "normal_force_p05_n": float(p05),
        "normal_force_p95_n": float(p95),
        "normal_force_wanted_fraction": float(
            np.mean((pressed >= low) & (pressed <= high))
        ),
        "contact_fraction": float(np.mean(since > _CONTACT_FORCE))
        if len(since)
        else 0.0,
    }


def _motion(run: WipingRun) -> Figures:
    desired = run.log("desired_position")
    error = np.linalg.norm(desired - run.log("measured_position"), axis=1)
    every, reactive = run.log("remaps")[-1]
    return {
        "tracking_rms_m": float(np.sqrt(np.mean(error**2))),
        "tracking_max_m": float(np.max(error)),
        "remap_count": int(every),
        "reactive_remap_count": int(reactive),
        "desired_position_jump_max_m": _jump(run, desired),
    }


def _jump(run: WipingRun, desired: NDArray[np.float64]) -> float:
    """Return the largest jump of the desired position, m.

    What it changes by from a sample to the next, less what its velocity explains.
    """
    velocity = run.log("desired_velocity")
    seconds = np.diff(run.log_times("desired_position"))[:, None]
    moved = np.diff(desired, axis=0)
    explained = seconds * (velocity[1:] + velocity[:-1]) / 2
    return float(np.max(np.linalg.norm(moved - explained, axis=1), initial=0.0))


def _limits(run: WipingRun) -> Figures:
    plant: Any = run.station.GetSubsystemByName("plant")
    panda = plant.GetModelInstanceByName("panda")
    n = plant.num_positions(panda)
    lower = plant.GetPositionLowerLimits()[:n]
    upper = plant.GetPositionUpperLimits()[:n]
    state = run.log("state")
    q, v = state[:, :n], state[:, n:]
    effort = np.abs(run.log("actuation")) / plant.GetEffortUpperLimits()[:n]
    torque_rate = np.abs(np.diff(run.log("torque"), axis=0)) / STEP
    flags = run.log("status")[:, 0].astype(int)
    return {
        "torque_ratio_max": float(np.max(effort)),
        "torque_rate_max_nm_per_s": float(np.max(torque_rate, initial=0.0)),
        "joint_limit_margin_min_rad": float(min(np.min(q - lower), np.min(upper - q))),
        "joint_speed_ratio_max": float(
            np.max(np.abs(v) / plant.GetVelocityUpperLimits()[:n])
        ),
        "fault_fraction": float(np.mean(flags & int(_FAULTS) != 0)),
    }
