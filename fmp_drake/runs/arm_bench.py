"""Test bench: a simulated Panda with firmware and LCM messages like those of a real one."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmInterfaceSystem, LcmSubscriberSystem

from fmp_drake.errors import RunError
from fmp_drake.numeric import Array
from fmp_drake.runs.log import Samples
from fmp_drake.runs.metrics import ForceMetrics, ink_metrics
from fmp_drake.runs.real_time import WallClock, age_metrics, uninterrupted
from fmp_drake.settings import bounded, check_settings
from fmp_drake.station import AddBoardScene, AddInk, LcmPanda, Scenario
from fmp_drake.station.board_scene import BoardScene
from fmp_drake.station.external_forces import TeachingHand
from fmp_drake.station.robots.panda_lcm import RawSerializer
from fmp_drake.systems.erase_times import EraseTimes
from fmp_drake.systems.panda.arm_status import JOINTS, decode
from fmp_drake.systems.panda.gate import limited_change

PERIOD = 0.001
DAMPING = (37.5, 50.0, 37.5, 25.0, 5.0, 3.75, 2.5)
"""Damping of the joints without a command, Nm s/rad; that of drake-franka-driver."""
# Largest difference between a command's stamp and the wall clock, s; fastest change of a
# torque, Nm/s; cutoff frequency of the torque's low-pass filter, Hz.
_EXPIRY, _MAX_RATE, _CUTOFF = 0.05, 1000.0, 30.0
# Longest delay that is made up for by steps, s: later statuses are stale.
_REPLAYED = 0.04
# Damping of each joint during hand guiding, Nm s/rad.
_GUIDED_DAMPING = 1.0
# Steps between two samples of the normal force.
_FORCE_STEPS = 10


class Reaction(IntEnum):
    """Reaction of a robot to the last command: it followed, damped, or stopped."""

    FOLLOWED = 0
    DAMPED = 1
    REFLEX = 2


class FirmwareState(NamedTuple):
    """Limited and filtered torque, Nm, and the reaction to the last command."""

    limited: Array
    torque: Array
    reaction: Reaction = Reaction.DAMPED


def firmware_step(
    state: FirmwareState,
    *,
    command: Any,
    wall_time: float,
    velocity: Array,
) -> FirmwareState:
    """Return the torque of the motors, without gravity, after `PERIOD`.

    Parameters
    ----------
    state : FirmwareState
    command : lcmt_panda_command
        The last command; its stamp is 0 before the first.
    wall_time : float
        Present time, s.
    velocity : array, shape (7,)
        Of the joints, rad/s.
    """
    reaction = Reaction.FOLLOWED
    if abs(wall_time - 1e-6 * command.utime) > _EXPIRY:
        reaction = Reaction.DAMPED
    elif (
        len(command.joint_torque) != JOINTS
        or command.control_mode_expected != lcmt_panda_status.CONTROL_MODE_TORQUE
        or not np.all(np.isfinite(command.joint_torque))
    ):
        reaction = Reaction.REFLEX
    if state.reaction is Reaction.REFLEX:
        reaction = Reaction.REFLEX
    if reaction is Reaction.FOLLOWED:
        desired = np.array(command.joint_torque)
    else:
        desired = -np.array(DAMPING) * velocity
    limited = limited_change(
        state.limited, desired, _MAX_RATE * PERIOD, np.full(JOINTS, np.inf)
    )
    blend = 1 - np.exp(-2 * np.pi * _CUTOFF * PERIOD)
    torque = state.torque + blend * (limited - state.torque)
    return FirmwareState(limited, torque, reaction)


@dataclass(kw_only=True)
class NetworkFaults:
    """Faults of the network that carries the arm's messages.

    Attributes
    ----------
    drop, reorder, corrupt : float
        Fractions of messages that are lost, delivered out of order, or changed in one bit.
    jitter : float
        Largest delay, s; messages keep their order.
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
    """Simulated Panda, at a board or in free space, that follows LCM commands.

    Parameters
    ----------
    scenario : Scenario
    lcm : DrakeLcmInterface
        The bus; its lifetime must exceed that of the bench.
    arm : LcmPanda, optional
        Channels, and the pace of the clock.
    faults : NetworkFaults, optional
    hand : TeachingHand, optional
        A person who guides the arm, which then ignores commands.
    demonstrated : sequence of ndarray, shape (N, 3)
        Paths in B that determine the area to clean, m; the whole board by default.

    Attributes
    ----------
    reactions : dict
        Duration of each `Reaction`, ms.
    commanded : ndarray, shape (7,)
        Last applied torque, Nm.
    torque_rate : float
        Largest rate of a commanded torque, with respect to the stamps of the commands,
        Nm/s.
    ages : list of float
        Age of each command on arrival, s.
    plant : MultibodyPlant
        Of the simulated arm; `arm` is its model instance.

    Examples
    --------
    >>> from pydrake.lcm import DrakeLcm
    >>> bus = DrakeLcm("memq://")
    >>> bench = ArmBench(Scenario(), bus)
    >>> bench.step(1.7e9)
    >>> bench.reactions[Reaction.DAMPED]
    1
    """

    def __init__(
        self,
        scenario: Scenario,
        lcm: DrakeLcmInterface,
        *,
        arm: LcmPanda | None = None,
        faults: NetworkFaults | None = None,
        hand: TeachingHand | None = None,
        demonstrated: Sequence[Array] = (),
    ) -> None:
        self._lcm = lcm
        self._channels = arm or LcmPanda()
        self.set_faults(faults or NetworkFaults())
        self._queue: list[tuple[float, bytes]] = []
        builder = DiagramBuilder()
        start = scenario.start
        if hand is not None and hand.start is not None:
            start = hand.start
        scene = AddBoardScene(builder, scenario, start=start)
        self._channels.check_robot(scene.robot.config)
        self.plant, self.arm = scene.plant, scene.robot.arm
        plant = self.plant
        if hand is not None:
            forces, _ = hand.AddTo(builder, scene)
            builder.Connect(forces, plant.GetInputPort("applied_spatial_force"))
        self._is_guided = hand is not None
        self._has_board = scene.whiteboard is not None
        if self._has_board:
            self._add_ink(builder, scene, demonstrated)
        bus = LcmInterfaceSystem(lcm)
        builder.AddSystem(bus)
        command = LcmSubscriberSystem(
            channel=self._channels.command_channel,
            serializer=RawSerializer(),
            lcm=bus,
        )
        builder.AddNamedSystem("command", command)
        builder.ExportInput(plant.get_actuation_input_port(self.arm), "torque")
        builder.ExportOutput(plant.get_state_output_port(self.arm), "state")
        external = plant.get_generalized_contact_forces_output_port(self.arm)
        builder.ExportOutput(external, "external")
        builder.ExportOutput(command.get_output_port(), "command")
        self._diagram = builder.Build()
        self._arm = scene.model.plant
        self._arm_context = scene.model.plant.CreateDefaultContext()
        self.simulator = Simulator(self._diagram)
        self.simulator.Initialize()
        self._state = FirmwareState(np.zeros(JOINTS), np.zeros(JOINTS))
        self.commanded, self._stamp = np.zeros(JOINTS), 0
        self._ticks = 0
        self.reactions = dict.fromkeys(Reaction, 0)
        self.torque_rate = self._largest_speed = 0.0
        self.ages: list[float] = []

    def _add_ink(
        self, builder: DiagramBuilder, scene: BoardScene, demonstrated: Sequence[Array]
    ) -> None:
        ink, scenario = AddInk(builder, scene), scene.scenario
        self._grid, self._initial_ink = ink.grid, ink.initial_ink
        self._area = ink.grid.swept_by(demonstrated, scenario.board_footprint())
        if not demonstrated:
            self._area[:] = True
        self._force = ForceMetrics(scenario.press.force)
        erase_times = builder.AddSystem(
            EraseTimes(initial_ink=ink.initial_ink, period=scenario.ink.period)
        )
        builder.Connect(ink.GetOutputPort("ink"), erase_times.GetInputPort("ink"))
        builder.ExportOutput(ink.GetOutputPort("ink"), "ink")
        builder.ExportOutput(erase_times.GetOutputPort("erase_time"), "erase_time")
        builder.ExportOutput(ink.GetOutputPort("normal_force"), "normal_force")

    def set_faults(self, faults: NetworkFaults) -> None:
        """Change the faults of the network."""
        check_settings(faults, RunError)
        self._faults = faults
        self._random = np.random.default_rng(faults.seed)

    def output(self, name: str) -> Any:
        """Return the value of state or external; at a board ink, erase_time, normal_force."""
        return self._diagram.GetOutputPort(name).Eval(self.simulator.get_context())

    def step(self, wall_time: float, *, late: float = 0.0) -> None:
        """Advance by a millisecond, and send a status.

        Its stamp is the wall time, s, at which the step was due: earlier than the present one
        by the delay, s.
        """
        state = self.output("state").copy()
        if self._is_guided:
            torque = -_GUIDED_DAMPING * state[JOINTS:]
            self._state = self._state._replace(torque=torque)
        else:
            self._follow(decode(lcmt_panda_command, self.output("command")), wall_time)
        context = self.simulator.get_mutable_context()
        self._diagram.GetInputPort("torque").FixValue(context, self._state.torque)
        # The contact is solved once for this output and the step.
        external = self.output("external").copy()
        if self._ticks % _FORCE_STEPS == 0:
            if self._has_board:
                force = self.output("normal_force").copy()
                now = np.array([self._ticks * PERIOD])
                self._force.update({"normal_force": Samples(now, force[None])})
            self._largest_speed = max(self._largest_speed, self._speed())
        self._ticks += 1
        self.simulator.AdvanceTo(self._ticks * PERIOD)
        self._send(self._status(external, wall_time - late).encode(), wall_time)

    def _follow(self, command: Any, wall_time: float) -> None:
        """Compute the torque of the motors from the last command."""
        self._state = firmware_step(
            self._state,
            command=command,
            wall_time=wall_time,
            velocity=self.output("state")[JOINTS:],
        )
        self.reactions[self._state.reaction] += 1
        if self._state.reaction is not Reaction.FOLLOWED:
            self.commanded = np.zeros(JOINTS)
        elif command.utime != self._stamp:
            commanded = np.array(command.joint_torque)
            # Several commands may have arrived since the last step.
            elapsed = max(1e-6 * (command.utime - self._stamp), PERIOD)
            rate = float(np.max(np.abs(commanded - self.commanded))) / elapsed
            self.torque_rate = max(self.torque_rate, rate)
            self.commanded, self._stamp = commanded, command.utime
            self.ages.append(wall_time - 1e-6 * command.utime)

    def play(self, duration: float) -> None:
        """Step in real time for a duration, s; long delays are skipped.

        A status has the time at which the arm would have been in its state, also where
        the step was late.
        """
        clock = WallClock(self._channels.pace)
        with uninterrupted():
            for now, late in clock.ticks(PERIOD, duration, replayed=_REPLAYED):
                self.step(now, late=late)

    def metrics(self) -> dict[str, Any]:
        """Return the metrics of the arm: its commands, and at a board ink and contact."""
        seconds, board_metrics = self._ticks * PERIOD, {}
        if self._has_board:
            shape = self._grid.shape
            board_metrics = ink_metrics(
                ink=self.output("ink").reshape(shape),
                initial_ink=self._initial_ink,
                erase_time=self.output("erase_time").reshape(shape),
                area=self._area,
                grid=self._grid,
                seconds=seconds,
            )
            board_metrics |= self._force.result()
        return {
            "seconds": seconds,
            **{f"{key.name.lower()}_ms": n for key, n in self.reactions.items()},
            **age_metrics("command_age", self.ages),
            "torque_rate_max_nm_per_s": self.torque_rate,
            "joint_speed_max_rad_per_s": self._largest_speed,
            "joint_speed_end_rad_per_s": self._speed(),
            **board_metrics,
        }

    def _speed(self) -> float:
        """Return the speed of the fastest joint, rad/s."""
        return float(np.max(np.abs(self.output("state")[JOINTS:])))

    def _status(self, external: Any, wall_time: float) -> Any:
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
        # The message has the torque of the arm on its contacts.
        message.joint_torque_external = (-external).tolist()
        message.robot_mode = message.kMove
        if self._is_guided:
            message.robot_mode = message.kGuiding
        elif self._state.reaction is Reaction.REFLEX:
            message.robot_mode = message.kReflex
        message.control_mode = message.CONTROL_MODE_TORQUE
        return message

    def _send(self, message: bytes, now: float) -> None:
        faults, random = self._faults, self._random
        if random.random() < faults.corrupt:
            content = bytearray(message)
            content[random.integers(len(content))] ^= 1 << random.integers(8)
            message = bytes(content)
        if random.random() >= faults.drop:
            due = now + faults.jitter * random.random()
            if self._queue:
                due = max(due, self._queue[-1][0])
            self._queue.append((due, message))
        if len(self._queue) > 1 and random.random() < faults.reorder:
            (a, first), (b, second) = self._queue[-2:]
            self._queue[-2:] = [(a, second), (b, first)]
        while self._queue and self._queue[0][0] <= now:
            self._lcm.Publish(self._channels.status_channel, self._queue.pop(0)[1])
