"""What is wrong with a run, in words, worst first."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from fmp_drake.experiments.worlds.store import World
from fmp_drake.systems.surface_monitor import TOLERANCE

MOST_RMS = 0.010
"""Of the distance from the path, m."""
LEAST_PRESSED = 0.95
"""Fraction of the time in contact within 5 N of the wanted normal force."""

# Limits of Franka's robots that are not in the metrics: Nm/s.
_TORQUE_RATE = 1000.0


class Fault(NamedTuple):
    """Something that must not be.

    Attributes
    ----------
    kind : str
        through, nan, limit, exception, path, press or touch.
    severity : float
        1 at the limit, more beyond it.
    words : str
    """

    kind: str
    severity: float
    words: str


def faults(world: World) -> list[Fault]:
    """Return what went wrong in a world that was run, the worst first."""
    if world.error:
        return [Fault("exception", 1e6, f"stopped with {world.error}")]
    return sorted(_faults(world), key=lambda fault: -fault.severity)


def is_pushed(world: World, seconds: float) -> bool:
    """Return whether somebody disturbs the arm before the end."""
    return any(push["start"] < seconds for push in world.fields["disturbances"])


def largest_push(world: World) -> float:
    """Return the greatest force of the disturbances, N; 0 without any."""
    return max(
        (
            math.hypot(*each["force"]) if each["kind"] == "push" else each["max_force"]
            for each in world.fields["disturbances"]
        ),
        default=0.0,
    )


def on_board_rms(world: World) -> float:
    """Return the rms distance from the path on the board as it is, m.

    Along the normal that leaves out how much higher the board is than assumed, and how
    far the felt gives way; stores of older versions have only the whole distance.
    """
    m: Mapping[str, Any] = world.metrics or {}
    return float(m.get("tracking_on_board_rms_m", m.get("tracking_rms_m", 0.0)))


def misses_by_height(world: World) -> bool:
    """Return whether a path is missed only where the board was assumed."""
    rms = (world.metrics or {}).get("tracking_rms_m", 0.0)
    return on_board_rms(world) <= MOST_RMS < rms


def _faults(world: World) -> list[Fault]:
    m: Mapping[str, Any] = world.metrics or {}
    found = []
    not_numbers = [
        name
        for name, value in m.items()
        if isinstance(value, float) and math.isnan(value)
    ]
    if not_numbers:
        found.append(Fault("nan", 1e5, f"has NaN in {', '.join(not_numbers)}"))

    def exceeds(kind: str, name: str, limit: float, words: str) -> None:
        value = m.get(name)
        if value is not None and value > limit:
            found.append(Fault(kind, value / limit, words))

    deep = m.get("penetration_max_m", 0.0)
    exceeds(
        "through",
        "penetration_max_m",
        TOLERANCE,
        f"something hard is {1e3 * deep:.1f} mm below the surface",
    )
    for name, limit, unit, what in (
        ("torque_ratio_max", 1.0, " of its limit", "a joint's torque"),
        ("joint_speed_ratio_max", 1.0, " of its limit", "a joint's speed"),
        ("torque_rate_max_nm_per_s", _TORQUE_RATE, " Nm/s", "a torque's rate"),
    ):
        value = m.get(name) or 0.0
        exceeds("limit", name, limit * (1 + 1e-9), f"{what} reaches {value:.4g}{unit}")
    margin = m.get("joint_limit_margin_min_rad")
    if margin is not None and margin < 0:
        found.append(
            Fault("limit", 1 - margin, f"a joint is {-margin:.3f} rad beyond its limit")
        )
    rms, most = on_board_rms(world), m.get("tracking_max_m", 0.0)
    if rms > MOST_RMS:
        words = (
            f"follows its path to {1e3 * rms:.1f} mm rms, {1e3 * most:.0f} mm at most"
        )
        found.append(Fault("path", rms / MOST_RMS, words))
    wanted, pushes = world.fields["press"]["force"], world.fields["disturbances"]
    pressed = m.get("normal_force_wanted_fraction", 1.0)
    if not pushes and wanted > 0 and pressed < LEAST_PRESSED:
        words = (
            f"presses within 5 N of the wanted {wanted:.1f} N for "
            f"{100 * pressed:.0f} % of the time in contact (90 % from "
            f"{m['normal_force_p05_n']:.1f} to {m['normal_force_p95_n']:.1f} N)"
            if m["contact_fraction"] > 0
            else "never touches the board"
        )
        found.append(Fault("press", 1 + LEAST_PRESSED - pressed, words))
    touched = m.get("arm_on_board_s", 0.0)
    if touched > 0:
        words = f"a link of the arm touches the board for {touched:.2f} s"
        found.append(Fault("touch", 1 + touched, words))
    return found
