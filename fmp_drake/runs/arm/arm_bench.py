"""A simulated arm that speaks a real one's messages: a test bench, not a robot."""

import gc
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np
from drake import lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmInterfaceSystem, LcmSubscriberSystem

from fmp_drake.errors import RunError
from fmp_drake.settings import bounded, check_settings
from fmp_drake.station.panda_driver import LcmPanda, RawSerializer
from fmp_drake.station.parts.board_ink import AddInk
from fmp_drake.station.parts.board_scene import AddBoardScene
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.panda.firmware import (
    FirmwareConfig,
    FirmwareState,
    Obeyed,
    firmware_step,
)
from fmp_drake.systems.panda.reading import JOINTS, decode

PERIOD = 0.001
# What is made up for after a pause, at most, s.
MOST_REPLAYED = 0.01


@dataclass(kw_only=True)
class NetworkFaults:
    """What happens to the messages that the arm sends.

    Attributes
    ----------
    drop, reorder, corrupt : float
        Fractions of the messages.
    jitter : float
        Greatest delay, s; messages keep their order.
    seed : int

    Examples
    --------
    >>> NetworkFaults(drop=0.05).corrupt
    0.0
    """

    drop: float = bounded(0.0, least=0, most=1)
    reorder: float = bounded(0.0, least=0, most=1)
    corrupt: float = bounded(0.0, least=0, most=1)
    jitter: float = bounded(0.0, least=0)
    seed: int = bounded(0, least=0)


class ArmBench:
    """A Panda at a whiteboard that is simulated, and driven by LCM messages.

    Parameters
    ----------
    scenario : Scenario
    lcm : DrakeLcmInterface
        The bus; it must outlive the bench.
    channels : LcmPanda, optional
        Whose channels are used.
    faults : NetworkFaults, optional
    firmware : FirmwareConfig, optional

    Attributes
    ----------
    obeyed : dict
        How many milliseconds each `Obeyed` lasted.
    commanded : ndarray, shape (7,)
        The last torque that was followed, Nm.
    greatest_step : float
        Greatest change of a commanded torque per millisecond of the commands' stamps, Nm.

    Examples
    --------
    >>> from pydrake.lcm import DrakeLcm
    >>> bus = DrakeLcm("memq://")
    >>> bench = ArmBench(Scenario(), bus)
    >>> bench.step(1.7e9)
    >>> bench.obeyed[Obeyed.DAMPED]
    1
    """

    def __init__(
        self,
        scenario: Scenario,
        lcm: DrakeLcmInterface,
        *,
        channels: LcmPanda | None = None,
        faults: NetworkFaults | None = None,
        firmware: FirmwareConfig | None = None,
    ) -> None:
        self._lcm = lcm
        self._channels = channels or LcmPanda()
        self._firmware = firmware or FirmwareConfig()
        check_settings(self._firmware, RunError)
        self.set_faults(faults or NetworkFaults())
        self._line: list[tuple[float, bytes]] = []
        builder = DiagramBuilder()
        scene = AddBoardScene(builder, scenario, start=scenario.start)
        ink = AddInk(builder, scene, scenario)
        bus = LcmInterfaceSystem(lcm)
        builder.AddSystem(bus)
        command = LcmSubscriberSystem(
            channel=self._channels.command_channel,
            serializer=RawSerializer(),
            lcm=bus,
        )
        builder.AddNamedSystem("command", command)
        plant = scene.plant
        builder.ExportInput(plant.get_actuation_input_port(scene.panda), "torque")
        for port, name in (
            (plant.get_state_output_port(scene.panda), "state"),
            (plant.get_generalized_contact_forces_output_port(scene.panda), "external"),
            (command.get_output_port(), "command"),
            (ink.GetOutputPort("cleaned_fraction"), "cleaned_fraction"),
            (ink.GetOutputPort("normal_force"), "normal_force"),
        ):
            builder.ExportOutput(port, name)
        self._diagram = builder.Build()
        self._arm = scene.arm
        self._arm_context = scene.arm.CreateDefaultContext()
        self.simulator = Simulator(self._diagram)
        self.simulator.Initialize()
        self._state = FirmwareState(np.zeros(JOINTS), np.zeros(JOINTS))
        self.commanded, self._stamp = np.zeros(JOINTS), 0
        self._ticks = 0
        self.obeyed = dict.fromkeys(Obeyed, 0)
        self.greatest_step = 0.0

    def set_faults(self, faults: NetworkFaults) -> None:
        """Change what happens to the messages."""
        check_settings(faults, RunError)
        self._faults = faults
        self._random = np.random.default_rng(faults.seed)

    def output(self, name: str) -> Any:
        """Return what state, external, cleaned_fraction or normal_force are now."""
        return self._diagram.GetOutputPort(name).Eval(self.simulator.get_context())

    def step(self, wall_time: float) -> None:
        """Advance by a millisecond, and send a status stamped with a wall time, s."""
        command = decode(lcmt_panda_command, self.output("command"))
        state = self.output("state").copy()
        self._state = firmware_step(
            self._firmware,
            self._state,
            command=command,
            wall_time=wall_time,
            velocity=state[JOINTS:],
            period=PERIOD,
        )
        self.obeyed[self._state.obeyed] += 1
        if self._state.obeyed is Obeyed.FOLLOWED:
            commanded = np.array(command.joint_torque)
            # Several may have come since the last step.
            elapsed = max(1e-3 * (command.utime - self._stamp), 1.0)
            change = float(np.max(np.abs(commanded - self.commanded))) / elapsed
            self.greatest_step = max(self.greatest_step, change)
            self.commanded, self._stamp = commanded, command.utime
        else:
            self.commanded = np.zeros(JOINTS)
        context = self.simulator.get_mutable_context()
        self._diagram.GetInputPort("torque").FixValue(context, self._state.torque)
        self._ticks += 1
        self.simulator.AdvanceTo(self._ticks * PERIOD)
        self._send(self._status(wall_time).encode(), wall_time)

    def play(self, duration: float) -> None:
        """Step in the time of the wall clock for some seconds; give up what is missed."""
        with undisturbed():
            began = due = time.time()
            while (now := time.time()) < began + duration:
                if now < due:
                    time.sleep(due - now)
                    continue
                due = max(due, now - MOST_REPLAYED) + PERIOD
                self.step(now)

    def _status(self, wall_time: float) -> Any:
        state = self.output("state")
        self._arm.SetPositionsAndVelocities(self._arm_context, state)
        weight = -self._arm.CalcGravityGeneralizedForces(self._arm_context)
        message = lcmt_panda_status()
        message.utime = message.robot_utime = round(1e6 * wall_time)
        message.num_joints = JOINTS
        for name in message.__slots__:
            if name.startswith("joint_"):
                setattr(message, name, [0.0] * JOINTS)
        message.joint_position = state[:JOINTS].tolist()
        message.joint_velocity = state[JOINTS:].tolist()
        message.joint_torque = (self._state.torque + weight).tolist()
        message.joint_torque_desired = self.commanded.tolist()
        # Theirs is the torque of the arm on what it touches.
        message.joint_torque_external = (-self.output("external")).tolist()
        reflex = self._state.obeyed is Obeyed.REFLEX
        message.robot_mode = message.kReflex if reflex else message.kMove
        message.control_mode = message.CONTROL_MODE_TORQUE
        return message

    def _send(self, message: bytes, now: float) -> None:
        faults, random = self._faults, self._random
        if random.random() < faults.corrupt:
            broken = bytearray(message)
            broken[random.integers(len(broken))] ^= 1 << random.integers(8)
            message = bytes(broken)
        if random.random() >= faults.drop:
            due = now + faults.jitter * random.random()
            if self._line:
                due = max(due, self._line[-1][0])
            self._line.append((due, message))
        if len(self._line) > 1 and random.random() < faults.reorder:
            (a, first), (b, second) = self._line[-2:]
            self._line[-2:] = [(a, second), (b, first)]
        while self._line and self._line[0][0] <= now:
            self._lcm.Publish(self._channels.status_channel, self._line.pop(0)[1])


@contextmanager
def undisturbed() -> Iterator[None]:
    """Collect no garbage meanwhile, and let SIGTERM end a block as SIGINT does."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        signal.signal(signal.SIGTERM, previous)
