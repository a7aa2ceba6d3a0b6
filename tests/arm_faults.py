"""An arm and its controller on two buses, connected by a network with faults."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from drake import lcmt_panda_command, lcmt_panda_status
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcm
from pydrake.systems.lcm import LcmSubscriberSystem

from fmp_drake.runs import ArmRun
from fmp_drake.runs.arm_bench import ArmBench
from fmp_drake.station import LcmPanda, LoadScenario
from fmp_drake.station.robots.panda_lcm import RawSerializer, TorquePublisher
from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel
from fmp_drake.systems import GateConfig, GateMode
from fmp_drake.systems.interface.arm_model import joint_limits
from fmp_drake.systems.panda.arm_status import GateFault

NOW = 1.7e9
LIMITS = joint_limits(MakeRobotModel(LoadRobot("panda")).plant)
# Of messages: what a network makes of one, with the milliseconds since the fault began
# and all earlier ones.
Change = Callable[[int, Any, list[Any]], list[Any]]


def pass_on(_ms, message, _earlier):
    """Deliver a message as it is."""
    return [message]


def frozen():
    """Repeat the state of the first status, with fresh stamps."""
    first = []

    def change(_ms, message, _earlier):
        first.append(message)
        message.joint_position = first[0].joint_position
        message.joint_velocity = first[0].joint_velocity
        return [message]

    return change


@dataclass(frozen=True, kw_only=True)
class Fault:
    """What fails, for how long.

    Attributes
    ----------
    status, command : callable
        What becomes of the messages of the arm, and of those to it; messages are bytes
        or LCM messages.
    arm_pause, controller_pause : int
        Milliseconds for which one side does not run.
    duration : int
        Milliseconds.
    """

    status: Change = pass_on
    command: Change = pass_on
    arm_pause: int = 0
    controller_pause: int = 0
    duration: int = 10**9


@dataclass(frozen=True, kw_only=True)
class Reaction:
    """What an arm did after a fault.

    Attributes
    ----------
    stopped_after : int or None
        Milliseconds until the gate stopped.
    faults : GateFault
    moved : float
        Largest movement of a joint since the fault began, rad.
    speed, torque : float
        Largest fractions of a joint's limits since then.
    speed_before : float
        The same before it.
    speed_end : float
        Largest speed of a joint at the end, rad/s.
    """

    stopped_after: int | None
    faults: GateFault
    moved: float
    speed: float
    torque: float
    speed_before: float
    speed_end: float


class Neighbour(TorquePublisher):
    """A publisher of the gate's commands with another program's beside each of them.

    Attributes
    ----------
    before, after : callable or None
        Torque of a command immediately before or after, of the gate's torque; or None.
    stamp_offset : float
        Of its stamps, s.
    """

    before = after = None
    stamp_offset = 0.0

    def __call__(self, torque, stamp):
        if self.before is not None:
            super().__call__(self.before(torque), stamp + self.stamp_offset)
        super().__call__(torque, stamp)
        if self.after is not None:
            super().__call__(self.after(torque), stamp + self.stamp_offset)


class Receiver:
    """The messages of a channel, as bytes."""

    def __init__(self, lcm, channel):
        self._lcm, self._number = lcm, 0
        self._data = AbstractValue.Make(b"")
        self._subscriber = LcmSubscriberSystem(
            channel=channel, serializer=RawSerializer(), lcm=lcm
        )

    def new(self):
        """Return the last message, or None where there is no new one."""
        self._lcm.HandleSubscriptions(0)
        before = self._number
        self._number = self._subscriber.WaitForMessage(before, self._data, 1e-9)
        return self._data.get_value() if self._number > before else None


class FailingNetwork:
    """A skill on a simulated arm, with a network between them that can fail.

    Parameters
    ----------
    skill : FourierMovementPrimitive
    gate : dict
        Settings of the gate.
    """

    def __init__(self, skill, **gate):
        self.arm_bus, self.bus = DrakeLcm("memq://"), DrakeLcm("memq://")
        self.scenario = LoadScenario("table_top")
        self.config = LcmPanda(gate=GateConfig(**gate))
        self.bench = ArmBench(self.scenario, self.arm_bus)
        self.run = ArmRun(self.scenario, skill, self.config, lcm=self.bus)
        self._statuses = Receiver(self.arm_bus, "PANDA_STATUS")
        self._commands = Receiver(self.bus, "PANDA_COMMAND")
        self.ticks, self.fault, self.began = 0, Fault(), 0
        self.earlier_statuses, self.earlier_commands = [], []
        self.states, self.torques = [], []

    def advance(self, milliseconds):
        """Step both sides in lockstep."""
        for _ in range(milliseconds):
            now, ms = NOW + 1e-3 * self.ticks, self.ticks - self.began
            is_fault = ms < self.fault.duration
            if not (is_fault and ms < self.fault.arm_pause):
                self.bench.step(now)
                self._forward(
                    self._statuses, lcmt_panda_status, self.earlier_statuses,
                    self.fault.status if is_fault else pass_on,
                    lambda data: self.bus.Publish("PANDA_STATUS", data), ms,
                )  # fmt: skip
            if not (is_fault and ms < self.fault.controller_pause):
                self.run.step(now)
                self._forward(
                    self._commands, lcmt_panda_command, self.earlier_commands,
                    self.fault.command if is_fault else pass_on,
                    lambda data: self.arm_bus.Publish("PANDA_COMMAND", data), ms,
                )  # fmt: skip
            self.ticks += 1
            self.states.append(self.bench.output("state").copy())
            self.torques.append(self.bench.commanded.copy())
        return self

    def _forward(self, receiver, kind, earlier, change, publish, ms):
        data = receiver.new()
        if data is None:
            return
        earlier.append(data)
        del earlier[:-200]
        for message in change(ms, kind.decode(data), earlier):
            publish(message if isinstance(message, bytes) else message.encode())

    def begin(self, milliseconds=1500):
        """Enable the arm and let it play."""
        self.advance(20)
        self.run.go()
        self.advance(milliseconds)
        assert self.run.mode is GateMode.OPEN, (self.run.mode, self.run.faults)
        return self

    def react(self, fault, milliseconds=500):
        """Let a fault happen, and return what the arm did."""
        self.fault, self.began = fault, self.ticks
        before = self.states[-1]
        first = len(self.states)
        stopped_after = None
        for ms in range(milliseconds):
            self.advance(1)
            if stopped_after is None and self.run.mode is GateMode.STOPPED:
                stopped_after = ms
        states = np.array(self.states[first:])
        speeds = np.abs(states[:, 7:]) / LIMITS.speed
        torques = np.abs(self.torques[first:]) / LIMITS.upper_effort
        return Reaction(
            stopped_after=stopped_after,
            faults=self.run.faults,
            moved=float(np.max(np.abs(states[:, :7] - before[:7]))),
            speed=float(np.max(speeds)),
            torque=float(np.max(torques)),
            speed_before=float(np.max(np.abs(before[7:]) / LIMITS.speed)),
            speed_end=float(np.max(np.abs(states[-1, 7:]))),
        )
