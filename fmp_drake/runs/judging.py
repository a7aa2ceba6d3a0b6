"""Faults of a run: what is required of it, and where its metrics fall short."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import yaml

from fmp_drake.station import LoadRobot, Scenario
from fmp_drake.station.robots.robot import DEFAULT_ROBOT
from fmp_drake.systems.surface_monitor import TOLERANCE

LEAST_PRESSED = 0.95
"""Least allowed fraction of the time in contact within 5 N of the desired normal force."""
LEAST_CONTACT = 0.95
"""Least allowed fraction of time in contact, while contact is desired, from the first
contact."""
MOST_FORCE_ERROR = 0.5
"""Greatest allowed rms error of a normal force that changes (a force channel), N."""
MOST_TILT, MOST_TILT_WITH_FRICTION = 0.5, 0.6
"""Greatest allowed rms errors of an orientation channel, without and with joint friction,
degrees."""
MOST_EXCESS = 60.0
"""Greatest allowed normal force above the sum of twice the desired one and the greatest push,
N."""


@dataclass(kw_only=True)
class RunResult:
    """Scenario of a run, and what came of it.

    Attributes
    ----------
    scenario : str
        Scenario in YAML, with every key.
    metrics : dict or None
        Metrics of the run; None without a run, or after an exception.
    error : str
        Exception; empty without one.

    Examples
    --------
    >>> RunResult(scenario="press: {force: 8.0}").tolerance
    0.01
    """

    scenario: str
    metrics: dict[str, Any] | None = None
    error: str = ""

    @cached_property
    def fields(self) -> dict[str, Any]:
        """Fields of the scenario; older versions wrote other fields."""
        fields: dict[str, Any] = yaml.load(self.scenario, Loader=yaml.CSafeLoader)
        return fields

    @property
    def tolerance(self) -> float:
        """Greatest allowed rms distance from the path, m; 10 mm in older stores."""
        return float(self.fields.get("tolerance", Scenario.tolerance))

    @property
    def has_board(self) -> bool:
        """Whether there is a board; false in free space."""
        return self.fields["board"].get("shape") != "none"


def failure(error: BaseException) -> str:
    """Return an exception in one line, as a `RunResult` has it."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


class Fault(NamedTuple):
    """Violation of a limit or of a requirement.

    Attributes
    ----------
    kind : str
        through, nan, limit, exception, path, tilt, press, force, stop or touch.
    severity : float
        1 at the limit, greater beyond.
    text : str
    """

    kind: str
    severity: float
    text: str


def faults(result: RunResult, duration: float = math.inf) -> list[Fault]:
    """Return the faults of a run that lasted for a time, the most severe first."""
    if result.error:
        return [Fault("exception", 1e6, f"stopped with {result.error}")]
    violations = (fault for fault in _judged(result, duration) if fault.severity > 1)
    return sorted(violations, key=lambda fault: -fault.severity)


def pushes(result: RunResult, duration: float = math.inf) -> list[dict[str, Any]]:
    """Return the disturbances that start before the end of the run."""
    return [push for push in result.fields["disturbances"] if push["start"] < duration]


def largest_push(result: RunResult, duration: float = math.inf) -> float:
    """Return the greatest force of the `pushes`, N; 0 without any."""
    return max(
        (
            math.hypot(*push["force"]) if push["kind"] == "push" else push["max_force"]
            for push in pushes(result, duration)
        ),
        default=0.0,
    )


def on_board_rms(result: RunResult) -> float:
    """Return the rms distance from the path on the actual board, m.

    Along the normal it excludes the error of the assumed height and the compression of
    the felt. Stores of older versions only have the whole distance.
    """
    m: Mapping[str, Any] = result.metrics or {}
    return float(m.get("tracking_on_board_rms_m", m.get("tracking_rms_m", 0.0)))


def undisturbed_force_fraction(result: RunResult) -> float:
    """Return the fraction of the time in contact within 5 N of the desired force.

    Disturbances are not counted, except in stores of older versions. 0 without contact, NaN in
    free space.
    """
    m: Mapping[str, Any] = result.metrics or {}
    if m.get("contact_fraction") == 0:
        return 0.0
    fraction = m.get("normal_force_undisturbed_fraction")
    if fraction is None:
        fraction = m.get("normal_force_wanted_fraction")
    return math.nan if fraction is None else float(fraction)


def misses_by_height(result: RunResult) -> bool:
    """Return whether only the path on the assumed board is missed."""
    rms = (result.metrics or {}).get("tracking_rms_m", 0.0)
    return on_board_rms(result) <= result.tolerance < rms


def most_tilt(result: RunResult) -> float:
    """Return the greatest allowed rms error of the orientation, degrees."""
    has_friction = result.fields.get("friction", {}).get("enabled", False)
    return MOST_TILT_WITH_FRICTION if has_friction else MOST_TILT


def _judged(result: RunResult, duration: float) -> Iterator[Fault]:
    """Yield everything that is judged; a severity up to 1 is not a fault."""
    metrics = result.metrics or {}
    is_pushed = bool(pushes(result, duration))
    desired = result.fields["press"]["force"] if result.has_board else 0.0
    robot = LoadRobot(result.fields.get("robot", DEFAULT_ROBOT))

    def value(name: str, default: float = 0.0) -> float:
        measured = metrics.get(name)
        return default if measured is None else measured

    not_numbers = [
        name for name, v in metrics.items() if isinstance(v, float) and math.isnan(v)
    ]
    if not_numbers:
        yield Fault("nan", 1e5, f"has NaN in {', '.join(not_numbers)}")
    depth = value("penetration_max_m")
    text = f"a hard part is {1e3 * depth:.1f} mm below the surface"
    yield Fault("through", depth / TOLERANCE, text)
    for name, limit, unit, what in (
        ("torque_ratio_max", 1.0, " of its limit", "a joint's torque"),
        ("joint_speed_ratio_max", 1.0, " of its limit", "a joint's speed"),
        ("torque_rate_max_nm_per_s", robot.max_torque_rate, " Nm/s", "a torque's rate"),
    ):
        most = value(name)
        text = f"{what} reaches {most:.4g}{unit}"
        yield Fault("limit", most / (limit * (1 + 1e-9)), text)
    margin = value("joint_limit_margin_min_rad")
    yield Fault("limit", 1 - margin, f"a joint is {-margin:.3f} rad beyond its limit")
    rms, most = on_board_rms(result), value("tracking_max_m")
    text = f"follows its path to {1e3 * rms:.1f} mm rms, {1e3 * most:.0f} mm at most"
    yield Fault("path", rms / result.tolerance, text)
    if not is_pushed:
        tilt, limit = value("orientation_rms_deg"), most_tilt(result)
        text = f"is {tilt:.2f} degrees rms off its orientation, above {limit:g}"
        yield Fault("tilt", tilt / limit, text)
        error = value("normal_force_error_rms_n")
        text = f"is {error:.2f} N rms off the force of the skill, above "
        yield Fault("press", error / MOST_FORCE_ERROR, f"{text}{MOST_FORCE_ERROR:g}")
    fraction = value("normal_force_wanted_fraction", 1.0)
    if desired > 0:
        # Stores of older versions do not tell the time of disturbances.
        default = 1.0 if is_pushed else fraction
        calm = value("normal_force_undisturbed_fraction", default)
        if undisturbed_force_fraction(result) == 0:
            calm = 0.0
        text = (
            f"presses within 5 N of the desired {desired:.1f} N for {100 * calm:.1f} % of "
            f"the time in contact{' without disturbances' * is_pushed} (90 % from "
            f"{value('normal_force_p05_n'):.1f} to {value('normal_force_p95_n'):.1f} N)"
        )
        if value("contact_fraction") <= 0:
            text = "never touches the board"
        yield Fault("press", 1 + LEAST_PRESSED - calm, text)
    if not is_pushed and desired > 0:
        contact = value("desired_contact_fraction", 1.0)
        text = f"is in contact for {100 * contact:.1f} % of the desired time"
        if fraction > 0:
            yield Fault("press", 1 + LEAST_CONTACT - contact, text)
    force = value("normal_force_max_n")
    limit = 2 * desired + largest_push(result, duration) + MOST_EXCESS
    text = f"presses with up to {force:.0f} N, above {limit:.0f} N"
    yield Fault("force", force / limit, text)
    for kind, name, what in (
        ("stop", "protective_stop_s", "is in a protective stop"),
        ("touch", "arm_on_board_s", "a link of the arm touches the board"),
    ):
        seconds = value(name)
        yield Fault(kind, 1 + seconds, f"{what} for {seconds:.2f} s")
