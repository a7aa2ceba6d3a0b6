"""Signals of a log: their meaning, unit, frame and sampling period.

They are output ports of the station, apart from `erase_time`, which the run computes. B is
the frame of the board, T that of the target, which is B on a flat board, and W the world.
"""

from collections.abc import Mapping, Sequence
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context
from pydrake.systems.primitives import VectorLogSink

from fmp_drake.errors import RunError
from fmp_drake.primitives.data.channels import POSITION_CHANNELS

type Chunk = Mapping[str, Samples]


class Samples(NamedTuple):
    """Logged samples of one signal: times (N,) in s and values (N, columns)."""

    times: NDArray[np.float64]
    values: NDArray[np.float64]


class SignalKind(NamedTuple):
    """Description of a signal.

    Attributes
    ----------
    period : float
        Sampling period, s; infinite for a signal that is logged at the end only.
    meaning : str
    unit : str
        Common unit of all columns, or one for each, separated by commas; 1 if there is
        none.
    frame : str
        B, T, W, or empty if the values belong to no frame.
    columns : tuple of str
        Empty if the number of columns depends on the scenario or the skill. A name with
        ``{}`` stands for one column for each joint.
    """

    period: float
    meaning: str
    unit: str
    frame: str = ""
    columns: tuple[str, ...] = ()

    def described(self, size: int) -> dict[str, Any]:
        """Return the metadata of the signal in a log, for a number of columns."""
        about = self._asdict()
        del about["period"]
        if any("{}" in column for column in self.columns):
            joints = range(1, size // len(self.columns) + 1)
            about["columns"] = [c.format(i) for c in self.columns for i in joints]
            if "," in self.unit:
                units = self.unit.split(",")
                about["unit"] = ",".join(unit for unit in units for _ in joints)
        return about


MILLISECOND = 0.001
# Multiples of a millisecond, exactly so in floating point at any time. A sample that is a
# rounding error away from an update of the controller would split an integrator's step.
_FAST, _SLOW, _RARE = 0.005, 0.01, 0.04
_XX = tuple(a + b for a in POSITION_CHANNELS for b in POSITION_CHANNELS)
_POSE = ("qw", "qx", "qy", "qz", *POSITION_CHANNELS)
_JOINTS = ("joint{}",)
_SPEEDS = ("joint{}_velocity",)
_ERROR = "of the controller: a rotation vector, a translation"
_STATE = "of the arm: angles, then velocities"
_CLEANED = "fraction of the cells that are clean"
_PENETRATION = "of the deepest hard point below the board's surface"
_STATUS = "of the controller: see fmp_drake.systems.impedance.status"
_REMAPS = "re-mappings so far, and those after a push among them"

_KINDS: dict[str, tuple[Any, ...]] = {
    "desired_position": (
        _FAST,
        "p_BE of the skill",
        "m",
        "B",
        POSITION_CHANNELS,
    ),
    "desired_velocity": (_FAST, "its velocity", "m/s", "B", POSITION_CHANNELS),
    "desired_acceleration": (
        _FAST,
        "its acceleration",
        "m/s^2",
        "B",
        POSITION_CHANNELS,
    ),
    "covariance": (_RARE, "of the tracked component, row by row", "m^2", "B", _XX),
    "weights": (_RARE, "of the tracked movement", "m", "B"),
    "component": (_RARE, "index of the tracked component", "1", "", ("component",)),
    "remaps": (_FAST, _REMAPS, "1", "", ("all", "reactive")),
    "measured_position": (_FAST, "p_BE", "m", "B", POSITION_CHANNELS),
    "measured_velocity": (_FAST, "v_BE", "m/s", "B", POSITION_CHANNELS),
    "measured_pose": (_FAST, "R_TE and p_TE", "1,1,1,1,m,m,m", "T", _POSE),
    "desired_orientation": (_FAST, "R_TE of the skill", "1", "T", _POSE[:4]),
    "tracking_error": (
        _FAST,
        _ERROR,
        "rad,rad,rad,m,m,m",
        "B",
        ("rx", "ry", "rz", *POSITION_CHANNELS),
    ),
    "status": (MILLISECOND, _STATUS, "1"),
    "torque": (MILLISECOND, "commanded, without gravity", "N m", "", _JOINTS),
    "actuation": (MILLISECOND, "torque with gravity", "N m", "", _JOINTS),
    "state": (MILLISECOND, _STATE, "rad,rad/s", "", (*_JOINTS, *_SPEEDS)),
    "ink": (inf, "fraction left in each cell, along x first", "1", "B"),
    "erase_time": (inf, "time at which a cell became clean, along x first", "s", "B"),
    "cleaned_fraction": (_RARE, _CLEANED, "1", "", ("cleaned",)),
    "normal_force": (_SLOW, "of the eraser on the board", "N", "", ("force",)),
    "desired_normal_force": (_SLOW, "of the skill", "N", "", ("force",)),
    "penetration": (_SLOW, _PENETRATION, "m", "", ("depth",)),
    "contact_area": (_SLOW, "between eraser and board", "m^2", "", ("area",)),
    "disturbance": (
        _SLOW,
        "force of the disturbances on E",
        "N",
        "W",
        POSITION_CHANNELS,
    ),
}
SIGNALS = {name: SignalKind(*kind) for name, kind in _KINDS.items()}
"""The signals of a log by their names."""


def skill_signals(
    channels: Sequence[str], units: Sequence[str], *, weights: int
) -> dict[str, SignalKind]:
    """Return `SIGNALS` for a skill: its channels have names and units of their own.

    Parameters
    ----------
    channels, units : sequence of str
        Of the skill.
    weights : int
        Number of its weights for each channel.

    Examples
    --------
    >>> kinds = skill_signals(["x", "force"], ["m", "N"], weights=10)
    >>> kinds["covariance"].columns
    ('xx', 'forcex', 'xforce', 'forceforce')
    """
    if len(channels) == 3 and set(units) == {"m"}:
        return SIGNALS
    pairs = [(a, b) for a in range(len(units)) for b in range(len(units))]
    covariance = SIGNALS["covariance"]._replace(
        columns=tuple(channels[b] + channels[a] for a, b in pairs),
        unit=",".join(f"{units[b]} {units[a]}" for a, b in pairs),
    )
    kind = SIGNALS["weights"]._replace(
        unit=",".join(unit for unit in units for _ in range(weights))
    )
    return {**SIGNALS, "covariance": covariance, "weights": kind}


def pop_samples(
    sinks: Mapping[str, VectorLogSink], context: Context
) -> dict[str, Samples]:
    """Return the logged samples of each signal, and clear the logs."""
    chunk = {}
    for name, sink in sinks.items():
        log = sink.FindMutableLog(context)
        chunk[name] = Samples(log.sample_times().copy(), log.data().T.copy())
        log.Clear()
    return chunk


def signal_kind(name: str) -> SignalKind:
    """Return the description of a signal.

    Raises
    ------
    RunError
        If the name is not in `SIGNALS`.
    """
    try:
        return SIGNALS[name]
    except KeyError:
        raise RunError(
            f"there is no signal {name!r}; a log may hold {', '.join(SIGNALS)}."
        ) from None
