"""The names of the signals in a log: what each one is, in which unit, how often.

They are the station's output ports. B is the frame of the board, W the world.
"""

from math import inf
from typing import NamedTuple

from fmp_drake.errors import RunError


class SignalKind(NamedTuple):
    """What a signal means.

    Attributes
    ----------
    meaning : str
    unit : str
        Of all columns, or of each, separated by commas; 1 where there is none.
    frame : str
        B, W, or empty where the values belong to no frame.
    columns : tuple of str
        Empty where the number of columns depends on the scenario or the skill.
    period : float
        Seconds between samples; infinite for what is logged at the end only.
    """

    meaning: str
    unit: str
    frame: str = ""
    columns: tuple[str, ...] = ()
    period: float = inf


MILLISECOND = 0.001
# Multiples of a millisecond that are so in floating point, too, at any time: no sample
# lies a rounding error beside a step of the controller and cuts the integrator's steps.
_FAST, _SLOW, _RARE = 0.005, 0.01, 0.04
_XYZ = ("x", "y", "z")
_JOINTS = tuple(f"joint{i}" for i in range(1, 8))

SIGNALS = {
    "desired_position": SignalKind(
        "p_BE that the skill wants", "m", "B", _XYZ, period=_FAST
    ),
    "desired_velocity": SignalKind("its velocity", "m/s", "B", _XYZ, period=_FAST),
    "desired_acceleration": SignalKind(
        "its acceleration", "m/s^2", "B", _XYZ, period=_FAST
    ),
    "covariance": SignalKind(
        "of the tracked component, row by row",
        "m^2",
        "B",
        tuple(a + b for a in _XYZ for b in _XYZ),
        period=_RARE,
    ),
    "weights": SignalKind("of the tracked movement", "m", "B", period=_RARE),
    "component": SignalKind(
        "index of the tracked component", "1", "", ("component",), period=_RARE
    ),
    "remaps": SignalKind(
        "re-mappings so far, and those after a push among them",
        "1",
        "",
        ("all", "reactive"),
        period=_FAST,
    ),
    "measured_position": SignalKind("p_BE", "m", "B", _XYZ, period=_FAST),
    "measured_velocity": SignalKind("v_BE", "m/s", "B", _XYZ, period=_FAST),
    "tracking_error": SignalKind(
        "of the controller: a rotation vector, a translation",
        "rad,rad,rad,m,m,m",
        "B",
        ("rx", "ry", "rz", *_XYZ),
        period=_FAST,
    ),
    "status": SignalKind(
        "of the controller: see fmp_drake.systems.impedance.status",
        "1",
        period=MILLISECOND,
    ),
    "torque": SignalKind(
        "commanded, without gravity", "N m", "", _JOINTS, period=MILLISECOND
    ),
    "actuation": SignalKind(
        "torque with gravity", "N m", "", _JOINTS, period=MILLISECOND
    ),
    "state": SignalKind(
        "of the arm: angles, then velocities",
        ",".join(["rad"] * 7 + ["rad/s"] * 7),
        "",
        (*_JOINTS, *(f"{joint}_velocity" for joint in _JOINTS)),
        period=MILLISECOND,
    ),
    "ink": SignalKind("fraction left in each cell, along x first", "1", "B"),
    "erase_time": SignalKind("when a cell became clean, along x first", "s", "B"),
    "fade_time": SignalKind("when a cell had lost half of its ink", "s", "B"),
    "cleaned_fraction": SignalKind(
        "fraction of the cells that are clean", "1", "", ("cleaned",), period=_RARE
    ),
    "normal_force": SignalKind(
        "of the eraser on the board", "N", "", ("force",), period=_SLOW
    ),
    "contact_area": SignalKind(
        "between eraser and board", "m^2", "", ("area",), period=_SLOW
    ),
    "disturbance": SignalKind(
        "force of the disturbances on E", "N", "W", _XYZ, period=_SLOW
    ),
}


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
