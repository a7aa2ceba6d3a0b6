"""The names of the signals in a log: what each one is, in which unit, how often.

They are the station's output ports; `erase_time` is the run's own. B is the frame of the
board, W the world.
"""

from math import inf
from typing import Any, NamedTuple

from fmp_drake.errors import RunError


class SignalKind(NamedTuple):
    """What a signal means.

    Attributes
    ----------
    period : float
        Seconds between samples; infinite for what is logged at the end only.
    meaning : str
    unit : str
        Of all columns, or of each, separated by commas; 1 where there is none.
    frame : str
        B, W, or empty where the values belong to no frame.
    columns : tuple of str
        Empty where the number of columns depends on the scenario or the skill.
    """

    period: float
    meaning: str
    unit: str
    frame: str = ""
    columns: tuple[str, ...] = ()

    def described(self) -> dict[str, Any]:
        """Return what the metadata of a log say of the signal."""
        return {k: v for k, v in self._asdict().items() if k != "period"}


MILLISECOND = 0.001
# Multiples of a millisecond that are so in floating point, too, at any time: no sample
# lies a rounding error beside a step of the controller and cuts the integrator's steps.
_FAST, _SLOW, _RARE = 0.005, 0.01, 0.04
_XYZ = ("x", "y", "z")
_XX = tuple(a + b for a in _XYZ for b in _XYZ)
_JOINTS = tuple(f"joint{i}" for i in range(1, 8))
_SPEEDS = tuple(f"{joint}_velocity" for joint in _JOINTS)
_ERROR = "of the controller: a rotation vector, a translation"
_STATE = "of the arm: angles, then velocities"
_STATE_UNITS = ",".join(["rad"] * 7 + ["rad/s"] * 7)
_CLEANED = "fraction of the cells that are clean"
_PENETRATION = "of the deepest hard point below the board's surface"
_STATUS = "of the controller: see fmp_drake.systems.impedance.status"
_REMAPS = "re-mappings so far, and those after a push among them"

_KINDS: dict[str, tuple[Any, ...]] = {
    "desired_position": (_FAST, "p_BE that the skill wants", "m", "B", _XYZ),
    "desired_velocity": (_FAST, "its velocity", "m/s", "B", _XYZ),
    "desired_acceleration": (_FAST, "its acceleration", "m/s^2", "B", _XYZ),
    "covariance": (_RARE, "of the tracked component, row by row", "m^2", "B", _XX),
    "weights": (_RARE, "of the tracked movement", "m", "B"),
    "component": (_RARE, "index of the tracked component", "1", "", ("component",)),
    "remaps": (_FAST, _REMAPS, "1", "", ("all", "reactive")),
    "measured_position": (_FAST, "p_BE", "m", "B", _XYZ),
    "measured_velocity": (_FAST, "v_BE", "m/s", "B", _XYZ),
    "tracking_error": (
        _FAST,
        _ERROR,
        "rad,rad,rad,m,m,m",
        "B",
        ("rx", "ry", "rz", *_XYZ),
    ),
    "status": (MILLISECOND, _STATUS, "1"),
    "torque": (MILLISECOND, "commanded, without gravity", "N m", "", _JOINTS),
    "actuation": (MILLISECOND, "torque with gravity", "N m", "", _JOINTS),
    "state": (MILLISECOND, _STATE, _STATE_UNITS, "", (*_JOINTS, *_SPEEDS)),
    "ink": (inf, "fraction left in each cell, along x first", "1", "B"),
    "erase_time": (inf, "when a cell became clean, along x first", "s", "B"),
    "cleaned_fraction": (_RARE, _CLEANED, "1", "", ("cleaned",)),
    "normal_force": (_SLOW, "of the eraser on the board", "N", "", ("force",)),
    "penetration": (_SLOW, _PENETRATION, "m", "", ("depth",)),
    "contact_area": (_SLOW, "between eraser and board", "m^2", "", ("area",)),
    "disturbance": (_SLOW, "force of the disturbances on E", "N", "W", _XYZ),
}
SIGNALS = {name: SignalKind(*kind) for name, kind in _KINDS.items()}
"""The signals of a log by their names."""


def signal_kind(name: str) -> SignalKind:
    """Return what a signal of a log means.

    Raises
    ------
    RunError
        Where the name is not in `SIGNALS`.
    """
    try:
        return SIGNALS[name]
    except KeyError:
        raise RunError(
            f"there is no signal {name!r}; a log may hold {', '.join(SIGNALS)}."
        ) from None
