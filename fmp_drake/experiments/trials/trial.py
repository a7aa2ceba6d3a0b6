"""One trial of randomised scenarios: its row in a store, and its faults."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import yaml

from fmp_drake.station import LoadRobot
from fmp_drake.systems.surface_monitor import TOLERANCE

MOST_RMS = 0.010
"""Largest rms distance from the path, m."""
LEAST_PRESSED = 0.95
"""Least fraction of the time in contact within 5 N of the desired normal force."""
LEAST_CONTACT = 0.95
"""Least fraction of the time in contact where contact is desired, after the first one."""
MOST_FORCE_ERROR = 0.5
"""Largest rms error of a normal force that changes (a force channel), N."""
MOST_TILT, MOST_TILT_WITH_FRICTION = 0.5, 0.6
"""Largest rms error of an orientation channel without and with joint friction, degrees."""
MOST_EXCESS = 60.0
"""Normal force above twice the desired one and the greatest push, N."""


@dataclass(kw_only=True)
class Trial:
    """A randomised scenario, and the result of its run: a row of a store.

    Attributes
    ----------
    number : int
    scenario : str
        YAML, with every key.
    parameters : dict of str to object
        The values that were drawn, by the names of the fields.
    code : str
        The `code_version` that runs it.
    is_feasible : bool
        Whether the feasibility check passes.
    verdict : str
        The words of that check.
    checked : dict
        Its values.
    metrics : dict or None
        Of the run; None where there was none, or an exception.
    events : str
        The faults that the run reports, with their times.
    error : str
        The exception; empty where there was none.
    attempts : int
        Number of times that it was started.
    cpu_seconds : float

    Examples
    --------
    >>> trial = Trial(number=0, scenario="press: {force: 8.0}")
    >>> trial.was_run
    False
    """

    number: int
    scenario: str
    parameters: dict[str, Any] = field(default_factory=dict)
    code: str = ""
    is_feasible: bool = True
    verdict: str = ""
    checked: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] | None = None
    events: str = ""
    error: str = ""
    attempts: int = 1
    cpu_seconds: float = 0.0

    @cached_property
    def fields(self) -> dict[str, Any]:
        """Fields of the scenario, also of one that an older version has drawn."""
        fields: dict[str, Any] = yaml.load(self.scenario, Loader=yaml.CSafeLoader)
        return fields

    @property
    def max_torque_rate(self) -> float:
        """Fastest change of a joint torque that the robot accepts, Nm/s."""
        return LoadRobot(self.fields.get("robot", "panda")).max_torque_rate

    @property
    def has_board(self) -> bool:
        """Return whether there is a board, or free space."""
        return self.fields["board"].get("shape") != "none"

    @property
    def was_run(self) -> bool:
        """Return whether it was simulated, or an attempt was made."""
        return self.metrics is not None or bool(self.error)


class Fault(NamedTuple):
    """A violation of a limit or of a requirement.

    Attributes
    ----------
    kind : str
        through, nan, limit, exception, path, tilt, press, force, stop or touch.
    severity : float
        1 at the limit, greater beyond it.
    words : str
    """

    kind: str
    severity: float
    words: str


def faults(trial: Trial) -> list[Fault]:
    """Return the faults of a trial that was run, the most severe first."""
    if trial.error:
        return [Fault("exception", 1e6, f"stopped with {trial.error}")]
    return sorted(_faults(trial), key=lambda fault: -fault.severity)


def is_pushed(trial: Trial, seconds: float) -> bool:
    """Return whether a disturbance starts before the end of the run."""
    return any(push["start"] < seconds for push in trial.fields["disturbances"])


def largest_push(trial: Trial) -> float:
    """Return the greatest force of the disturbances, N; 0 without any."""
    return max(
        (
            math.hypot(*each["force"]) if each["kind"] == "push" else each["max_force"]
            for each in trial.fields["disturbances"]
        ),
        default=0.0,
    )


def on_board_rms(trial: Trial) -> float:
    """Return the rms distance from the path on the actual board, m.

    Along the normal it excludes the error of the assumed height and the compression of
    the felt. Stores of older versions only have the whole distance.
    """
    m: Mapping[str, Any] = trial.metrics or {}
    return float(m.get("tracking_on_board_rms_m", m.get("tracking_rms_m", 0.0)))


def misses_by_height(trial: Trial) -> bool:
    """Return whether only the path on the assumed board is missed."""
    rms = (trial.metrics or {}).get("tracking_rms_m", 0.0)
    return on_board_rms(trial) <= MOST_RMS < rms


def most_tilt(trial: Trial) -> float:
    """Return the largest rms error of the orientation that is allowed, degrees."""
    has_friction = trial.fields.get("friction", {}).get("enabled", False)
    return MOST_TILT_WITH_FRICTION if has_friction else MOST_TILT


def _faults(trial: Trial) -> list[Fault]:
    m: Mapping[str, Any] = trial.metrics or {}
    violations = []
    not_numbers = [
        name
        for name, value in m.items()
        if isinstance(value, float) and math.isnan(value)
    ]
    if not_numbers:
        violations.append(Fault("nan", 1e5, f"has NaN in {', '.join(not_numbers)}"))

    def exceeds(kind: str, name: str, limit: float, words: str) -> None:
        value = m.get(name)
        if value is not None and value > limit:
            violations.append(Fault(kind, value / limit, words))

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
        ("torque_rate_max_nm_per_s", trial.max_torque_rate, " Nm/s", "a torque's rate"),
    ):
        value = m.get(name) or 0.0
        exceeds("limit", name, limit * (1 + 1e-9), f"{what} reaches {value:.4g}{unit}")
    margin = m.get("joint_limit_margin_min_rad")
    if margin is not None and margin < 0:
        violations.append(
            Fault("limit", 1 - margin, f"a joint is {-margin:.3f} rad beyond its limit")
        )
    rms, most = on_board_rms(trial), m.get("tracking_max_m", 0.0)
    if rms > MOST_RMS:
        words = (
            f"follows its path to {1e3 * rms:.1f} mm rms, {1e3 * most:.0f} mm at most"
        )
        violations.append(Fault("path", rms / MOST_RMS, words))
    wanted, pushes = trial.fields["press"]["force"], trial.fields["disturbances"]
    if not pushes:
        name, limit = "orientation_rms_deg", most_tilt(trial)
        words = f"is {m.get(name) or 0.0:.2f} degrees rms off its orientation"
        exceeds("tilt", name, limit, f"{words}, above {limit:g}")
        name = "normal_force_error_rms_n"
        words = f"is {m.get(name) or 0.0:.2f} N rms off the force of the skill"
        exceeds("press", name, MOST_FORCE_ERROR, f"{words}, above {MOST_FORCE_ERROR:g}")
    if not trial.has_board:
        wanted = 0.0
    pressed = m.get("normal_force_wanted_fraction", 1.0)
    if not pushes and wanted > 0 and pressed < LEAST_PRESSED:
        words = (
            f"presses within 5 N of the wanted {wanted:.1f} N for "
            f"{100 * pressed:.0f} % of the time in contact (90 % from "
            f"{m['normal_force_p05_n']:.1f} to {m['normal_force_p95_n']:.1f} N)"
            if m["contact_fraction"] > 0
            else "never touches the board"
        )
        violations.append(Fault("press", 1 + LEAST_PRESSED - pressed, words))
    contact = m.get("desired_contact_fraction", 1.0)
    if not pushes and wanted > 0 and pressed > 0 and contact < LEAST_CONTACT:
        words = f"is in contact for {100 * contact:.0f} % of the time that it should be"
        violations.append(Fault("press", 1 + LEAST_CONTACT - contact, words))
    most_force = 2 * wanted + largest_push(trial) + MOST_EXCESS
    exceeds(
        "force",
        "normal_force_max_n",
        most_force,
        f"presses with up to {m.get('normal_force_max_n', 0.0):.0f} N, above "
        f"{most_force:.0f} N",
    )
    stopped = m.get("protective_stop_s", 0.0)
    if stopped > 0:
        words = f"is in a protective stop for {stopped:.2f} s"
        violations.append(Fault("stop", 1 + stopped, words))
    touched = m.get("arm_on_board_s", 0.0)
    if touched > 0:
        words = f"a link of the arm touches the board for {touched:.2f} s"
        violations.append(Fault("touch", 1 + touched, words))
    return violations
