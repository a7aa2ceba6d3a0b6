"""What an arm behind LCM says while nothing is sent to it: a check, a recording."""

from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_panda_status
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.lcm import LcmSubscriberSystem

import fmp_drake
from fmp_drake.errors import RunError
from fmp_drake.primitives import Demonstration
from fmp_drake.primitives.data.recording import led_demonstrations
from fmp_drake.runs.arm.real_time import WallClock
from fmp_drake.station.panda_driver import LcmPanda, OpenLcm, RawSerializer
from fmp_drake.station.parts.board_scene import MakeArm
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.impedance.arm import ArmModel
from fmp_drake.systems.panda.reading import (
    JOINTS,
    ArmReading,
    GateFault,
    decode,
    read_status,
)

# Seconds that a check listens, and the least number of messages per second.
_CHECKED, _LEAST_RATE = 1.0, 900.0
# What is near enough: to the start, m, to a limit, rad; and at rest, rad/s.
_NEAR, _MARGIN, _STILL = 0.15, 0.05, 0.02
# What an arm may feel that touches nothing, Nm.
_FELT = 3.0
# Until a message that was handled is there, s; 0 would wait for ever.
_WAIT = 1e-4
# Between two samples that are kept of a recording, s.
_KEPT = 0.01


class Heard(NamedTuple):
    """A status: when it came, s, the how many-th it is, and what is in it."""

    time: float
    number: int
    message: Any
    reading: ArmReading


class Finding(NamedTuple):
    """One thing that was checked: whether it is good, and a sentence that says so."""

    is_good: bool
    said: str


def listen(
    config: LcmPanda,
    *,
    lcm: DrakeLcmInterface | None = None,
    until: Callable[[float], bool],
) -> Iterator[Heard]:
    """Yield statuses of an arm, of several at once the last, and send nothing.

    Parameters
    ----------
    config : LcmPanda
    lcm : DrakeLcmInterface, optional
        The bus instead of one of `config.url`.
    until : callable
        Told the seconds since the begin; whether it is enough.
    """
    bus = OpenLcm(config.url) if lcm is None else lcm
    # A callback of Python's would end the interpreter where a Simulator pumps the bus.
    subscriber = LcmSubscriberSystem(
        channel=config.status_channel, serializer=RawSerializer(), lcm=bus
    )
    clock, data, number = WallClock(config.pace), AbstractValue.Make(b""), 0
    began = clock.now()
    while not until((now := clock.now()) - began):
        bus.HandleSubscriptions(10)
        before, number = number, subscriber.WaitForMessage(number, data, _WAIT)
        if number > before:
            message = decode(lcmt_panda_status, data.get_value())
            yield Heard(now, number, message, read_status(message))


def check_arm(
    scenario: Scenario, config: LcmPanda, *, lcm: DrakeLcmInterface | None = None
) -> list[Finding]:
    """Listen to an arm for a second, and tell whether it may be let go.

    Parameters
    ----------
    scenario : Scenario
        Where it shall begin.
    config, lcm
        As for `listen`.
    """
    versions = f"fmp_drake {fmp_drake.__version__}, Drake {version('drake')}"
    found = [Finding(True, f"{versions}, and the messages of that Drake")]
    heard = list(listen(config, lcm=lcm, until=lambda seconds: seconds >= _CHECKED))
    good = [each for each in heard if each.reading.is_finite]
    if not good:
        found.append(
            Finding(
                False,
                f"{len(heard)} messages on {config.status_channel}, none of them a "
                "status of seven joints: does the robot's driver run, on this bus, with the "
                "messages of this Drake?",
            )
        )
        return found
    rate = heard[-1].number / _CHECKED
    found.append(
        Finding(
            rate >= _LEAST_RATE and len(good) == len(heard),
            f"{rate:.0f} statuses in a second (1000 wanted), {len(heard) - len(good)} of "
            f"{len(heard)} that were read are broken",
        )
    )
    ages = np.array([each.time - each.reading.time for each in good])
    late = float(np.max(np.abs(ages)))
    found.append(
        Finding(
            late <= config.gate.expiry,
            f"stamps are {1e3 * np.median(ages):.1f} ms old (median), {1e3 * late:.1f} ms at "
            f"most (allowed: {1e3 * config.gate.expiry:g}): clocks and network",
        )
    )
    last = good[-1]
    mode = _robot_mode(last.message.robot_mode)
    if last.reading.faults & GateFault.WRONG_MODE:
        said = f"the robot's mode is {mode}; it must be kMove, controlled by torque"
        found.append(Finding(False, said))
    else:
        found.append(Finding(True, f"the robot's mode is {mode}, controlled by torque"))
    found += _pose_findings(scenario, last.reading)
    return found


def _robot_mode(number: int) -> str:
    for name, value in vars(lcmt_panda_status).items():
        if name.startswith("k") and name[1].isupper() and value == number:
            return name
    return str(number)


def _pose_findings(scenario: Scenario, reading: ArmReading) -> list[Finding]:
    """Return what is to be said of where an arm stands, and what it feels there."""
    arm, tip = MakeArm(scenario)
    context = arm.CreateDefaultContext()
    q, v = reading.state[:JOINTS], reading.state[JOINTS:]
    room = np.minimum(
        q - arm.GetPositionLowerLimits(), arm.GetPositionUpperLimits() - q
    )
    joint = int(np.argmin(room))
    p_WE: Any = ArmModel(arm, tip).motion(context, reading.state)[0][3]
    p_BE = scenario.board.assumed_pose().inverse().multiply(p_WE)
    off = float(np.linalg.norm(p_BE - scenario.start))
    speed, felt = (float(np.max(np.abs(x))) for x in (v, reading.torque_external))
    x, y, z = p_BE
    return [
        Finding(
            bool(room[joint] >= _MARGIN),
            f"joint {joint + 1} is {room[joint]:.2f} rad from its limit, the others are "
            f"farther (at least {_MARGIN:g})",
        ),
        Finding(speed <= _STILL, f"the fastest joint moves with {speed:.3f} rad/s"),
        Finding(
            off <= _NEAR and z > 0,
            f"the eraser is at {x:.3f} {y:.3f} {z:.3f} m on the board, {off:.3f} m from the "
            f"start (at most {_NEAR:g}, and above the board)",
        ),
        Finding(
            felt <= _FELT,
            f"it feels at most {felt:.1f} Nm (at most {_FELT:g}, touching nothing): the "
            "eraser's mass that the robot was told",
        ),
    ]


def record_arm(
    scenario: Scenario,
    config: LcmPanda,
    *,
    lcm: DrakeLcmInterface | None = None,
    until: Callable[[float], bool],
    note: str = "",
) -> Demonstration:
    """Record how a person guides an arm; return the longest part without a gap.

    Its own kinematics say where the eraser is, in the frame of the assumed board, at 20 Hz.
    The robot compensates its weight by itself, nothing is sent to it.

    Parameters
    ----------
    scenario : Scenario
        With the eraser and the board.
    config, lcm, until
        As for `listen`.
    note : str

    Raises
    ------
    RunError
        Where nothing was heard, or nothing moved.
    """
    times: list[float] = []
    angles: list[NDArray[np.float64]] = []
    for *_, reading in listen(config, lcm=lcm, until=until):
        if reading.is_finite and (not times or reading.time >= times[-1] + _KEPT):
            times.append(reading.time)
            angles.append(reading.state)
    if not times:
        raise RunError(
            f"nothing was heard on {config.status_channel}; see fmp-drake check --arm."
        )
    arm, tip = MakeArm(scenario)
    model, context = ArmModel(arm, tip), arm.CreateDefaultContext()
    X_BW = scenario.board.assumed_pose().inverse()
    p_WE: Any = np.array([model.motion(context, q)[0][3] for q in angles]).T
    shown = led_demonstrations(
        np.subtract(times, times[0]),
        X_BW.multiply(p_WE).T,
        np.ones(len(times)),
        note=note,
    )
    if not shown:
        raise RunError(f"in {times[-1] - times[0]:.1f} s nothing moved.")
    return max(shown, key=lambda each: each.duration)
