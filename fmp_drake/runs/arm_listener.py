"""Check of an arm behind LCM, and recording of hand guiding, without sending anything."""

from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_panda_status
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.lcm import LcmSubscriberSystem

import fmp_drake
from fmp_drake.errors import RunError
from fmp_drake.numeric import Array
from fmp_drake.primitives import Demonstration
from fmp_drake.runs.guided_demonstrations import guided_demonstrations
from fmp_drake.runs.real_time import WallClock
from fmp_drake.station import LcmPanda, LoadRobot, Scenario
from fmp_drake.station.robots.panda_lcm import OpenLcm, RawSerializer
from fmp_drake.station.robots.robot import MakeRobotModel, Robot
from fmp_drake.systems.interface.arm_model import joint_limits
from fmp_drake.systems.panda.arm_status import (
    JOINTS,
    ArmReading,
    GateFault,
    decode,
    implausible,
    initial_track,
    read_status,
    track_status,
)
from fmp_drake.systems.surface.surface import project_all

# Duration of a check, s, and its smallest rate of messages, 1/s.
_CHECK_SECONDS, _MIN_RATE = 1.0, 900.0
# Largest distance to the start, m; smallest joint-limit margin, rad; largest speed at
# rest, rad/s.
_START_DISTANCE, _MARGIN, _REST_SPEED = 0.15, 0.05, 0.02
# Largest external torque of an arm without contact, Nm.
_MAX_EXTERNAL = 3.0
# Timeout of the wait for a message, s; 0 means no timeout.
_WAIT = 1e-4
# Shortest time between two samples of a recording, and most by which the time between two
# stamps may differ from that between their arrivals, s.
_SAMPLE_PERIOD, _MAX_DRIFT = 0.01, 0.25
# Time without a status after which a recording reports it, s.
_SILENCE = 1.0
# Statuses with these faults are not recorded.
_NOT_RECORDED = GateFault.OUT_OF_RANGE | GateFault.TOO_FAST | GateFault.JUMP


class ReceivedStatus(NamedTuple):
    """Status: arrival time (s), sequence number, message, decoded reading."""

    time: float
    number: int
    message: Any
    reading: ArmReading


class CheckResult(NamedTuple):
    """Result of a check of an arm: whether it passed, and a sentence about it."""

    is_good: bool
    text: str


def listen(
    config: LcmPanda,
    *,
    lcm: DrakeLcmInterface | None = None,
    until: Callable[[float], bool],
) -> Iterator[ReceivedStatus]:
    """Yield the statuses of an arm, without sending anything.

    If several statuses are waiting, the last one is yielded.

    Parameters
    ----------
    config : LcmPanda
    lcm : DrakeLcmInterface, optional
        The bus instead of one of `config.url`.
    until : callable
        Called with the time since the start, s; the iteration ends when it is true.
    """
    bus = OpenLcm(config.url) if lcm is None else lcm
    # A Python callback would crash the interpreter where a Simulator pumps the bus.
    subscriber = LcmSubscriberSystem(
        channel=config.status_channel, serializer=RawSerializer(), lcm=bus
    )
    clock, data, number = WallClock(config.pace), AbstractValue.Make(b""), 0
    start = clock.now()
    while not until((now := clock.now()) - start):
        bus.HandleSubscriptions(10)
        previous_number, number = number, subscriber.WaitForMessage(number, data, _WAIT)
        if number > previous_number:
            message = decode(lcmt_panda_status, data.get_value())
            yield ReceivedStatus(now, number, message, read_status(message))


def check_arm(
    scenario: Scenario, config: LcmPanda, *, lcm: DrakeLcmInterface | None = None
) -> list[CheckResult]:
    """Receive an arm's statuses for a second, and check whether it may be enabled.

    Parameters
    ----------
    scenario : Scenario
        With the board, and the start of the eraser on it.
    config, lcm
        As for `listen`.
    """
    config.check_robot(LoadRobot(scenario.robot))
    versions = f"fmp_drake {fmp_drake.__version__}, Drake {version('drake')}"
    results = [CheckResult(True, f"{versions}, and the messages of that Drake")]
    received = list(
        listen(config, lcm=lcm, until=lambda seconds: seconds >= _CHECK_SECONDS)
    )
    valid = [status for status in received if status.reading.is_finite]
    if not valid:
        text = (
            f"{len(received)} messages on {config.status_channel}, none of them a status of "
            "seven joints: check that the robot's driver runs, on this bus, and uses the "
            "messages of this Drake"
        )
        return [*results, CheckResult(False, text)]
    rate, broken = received[-1].number / _CHECK_SECONDS, len(received) - len(valid)
    ages = np.array([status.time - status.reading.time for status in valid])
    late = float(np.max(np.abs(ages)))
    last = valid[-1]
    is_wrong = bool(last.reading.faults & GateFault.WRONG_MODE)
    required = "; it must be kMove, controlled by torque"
    return [
        *results,
        CheckResult(
            rate >= _MIN_RATE and not broken,
            f"{rate:.0f} statuses in a second (1000 expected), {broken} of "
            f"{len(received)} that were read are broken",
        ),
        CheckResult(
            late <= config.gate.expiry,
            f"stamps are {1e3 * np.median(ages):.1f} ms old (median), {1e3 * late:.1f} ms at "
            f"most (allowed: {1e3 * config.gate.expiry:g}): it depends on clocks and network",
        ),
        CheckResult(
            not is_wrong,
            f"the robot's mode is {_robot_mode(last.message.robot_mode)}"
            f"{required if is_wrong else ', controlled by torque'}",
        ),
        *_check_pose(scenario, last.reading),
    ]


def _robot_mode(number: int) -> str:
    for name, value in vars(lcmt_panda_status).items():
        if name.startswith("k") and name[1].isupper() and value == number:
            return name
    return str(number)


def _check_pose(scenario: Scenario, reading: ArmReading) -> list[CheckResult]:
    """Check posture, speed, position and external torque of an arm."""
    robot = MakeRobotModel(LoadRobot(scenario.robot), scenario.held_tool())
    arm = robot.plant
    q, v = reading.state[:JOINTS], reading.state[JOINTS:]
    margins = np.minimum(
        q - arm.GetPositionLowerLimits(), arm.GetPositionUpperLimits() - q
    )
    joint = int(np.argmin(margins))
    (p_BE,) = _eraser_positions(scenario, robot, [reading.state])
    distance = float(np.linalg.norm(p_BE - scenario.start))
    speed, external = (float(np.max(np.abs(x))) for x in (v, reading.torque_external))
    x, y, z = p_BE
    return [
        CheckResult(
            bool(margins[joint] >= _MARGIN),
            f"joint {joint + 1} is nearest to its limit: {margins[joint]:.2f} rad (at least "
            f"{_MARGIN:g})",
        ),
        CheckResult(
            speed <= _REST_SPEED, f"the fastest joint moves at {speed:.3f} rad/s"
        ),
        CheckResult(
            distance <= _START_DISTANCE and z > 0,
            f"the eraser is at {x:.3f} {y:.3f} {z:.3f} m on the board, {distance:.3f} m from the "
            f"start (at most {_START_DISTANCE:g}, and above the board)",
        ),
        CheckResult(
            external <= _MAX_EXTERNAL,
            f"the largest external torque is {external:.1f} Nm (at most {_MAX_EXTERNAL:g} "
            "without contact): it depends on the eraser's mass in the robot's settings",
        ),
    ]


def _eraser_positions(
    scenario: Scenario, robot: Robot, states: Sequence[Array]
) -> Array:
    """Return positions on the assumed board, (N, 3), m, for states of an arm, (14,) each.

    p_BE, or (u, v, h) over a curved board.
    """
    poses = robot.tip_poses(np.array(states)[:, :JOINTS])
    p_WE: Any = np.transpose([X_WE.translation() for X_WE in poses])
    p_BE = scenario.board.assumed_pose().inverse().multiply(p_WE).T
    surface = scenario.board.curvature()
    return p_BE if surface.is_plane else project_all(surface, p_BE, np.zeros(2))


def record_arm(
    scenario: Scenario,
    config: LcmPanda,
    *,
    lcm: DrakeLcmInterface | None = None,
    until: Callable[[float], bool],
    remark: Callable[[str], Any] = lambda _: None,
    note: str = "",
) -> Demonstration:
    """Record the hand guiding of an arm; return the longest part without a gap.

    The arm's kinematics yield the eraser's position in the frame of the assumed board, at
    20 Hz. The robot compensates its own weight; nothing is sent to it. Statuses with
    impossible positions, velocities or stamps are left out.

    Parameters
    ----------
    scenario : Scenario
        With the eraser and the board.
    config, lcm, until
        As for `listen`.
    remark : callable
        Called with a sentence where no status arrives in the first second.
    note : str

    Raises
    ------
    RunError
        If no status was received, or nothing moved.
    """
    robot_config = LoadRobot(scenario.robot)
    config.check_robot(robot_config)
    robot = MakeRobotModel(robot_config, scenario.held_tool())
    limits, no_torque = joint_limits(robot.plant), np.zeros(JOINTS)
    track, offset, is_remarked = initial_track(), None, False
    times: list[float] = []
    states: list[Array] = []

    def is_over(elapsed: float) -> bool:
        nonlocal is_remarked
        if offset is None and not is_remarked and elapsed > _SILENCE:
            is_remarked = True
            remark(
                f"no status on {config.status_channel} yet: check that the robot's driver "
                "runs, on this bus; waiting for it"
            )
        return until(elapsed)

    for arrival, _, _, reading in listen(config, lcm=lcm, until=is_over):
        if not reading.is_finite:
            continue
        offset = reading.time - arrival if offset is None else offset
        if abs(reading.time - arrival - offset) > _MAX_DRIFT:
            continue
        before, track = track, track_status(track, reading, no_torque)
        is_due = not times or reading.time >= times[-1] + _SAMPLE_PERIOD
        if is_due and not implausible(limits, before, track, reading) & _NOT_RECORDED:
            times.append(reading.time)
            states.append(reading.state)
    if not times:
        raise RunError(
            f"no status was received on {config.status_channel}; see fmp-drake check --arm."
        )
    demonstrations = guided_demonstrations(
        np.subtract(times, times[0]),
        _eraser_positions(scenario, robot, states),
        np.ones(len(times)),
        note=note,
    )
    if not demonstrations:
        raise RunError(f"nothing moved in {times[-1] - times[0]:.1f} s.")
    return max(demonstrations, key=lambda part: part.duration)
