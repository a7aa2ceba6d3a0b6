"""The driver of a Panda behind Drake's LCM messages, and the YAML file of `--arm`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drake import lcmt_panda_command, lcmt_panda_status
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcm, DrakeLcmInterface
from pydrake.manipulation import PandaCommandSender
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, TriggerType
from pydrake.systems.lcm import (
    LcmInterfaceSystem,
    LcmPublisherSystem,
    LcmSubscriberSystem,
    SerializerInterface,
)

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array
from fmp_drake.settings import bounded, check_settings, check_yaml
from fmp_drake.station.robots.driver import Driver, SimulatedDriver
from fmp_drake.station.robots.robot import RobotConfig
from fmp_drake.station.scenario_parts import in_one_line, load_yaml
from fmp_drake.systems import GateConfig
from fmp_drake.systems.command_listener import CommandListener
from fmp_drake.systems.interface.arm_model import joint_limits
from fmp_drake.systems.panda.arm_status import JOINTS
from fmp_drake.systems.torque_gate import TorqueGate

# Providers of Drake's LCM. It warns about others, and goes on without a bus.
_PROVIDERS = ("udpm://", "mpudpm://", "tcpq://", "memq://", "file://")


@dataclass(kw_only=True)
class LcmPanda(Driver):
    """A Panda behind Drake's LCM messages, real or simulated by another process.

    Attributes
    ----------
    url : str
        Of LCM; empty for its own default.
    status_channel, command_channel : str
    pace : float
        Seconds of the messages' clock per second, for a simulated arm that is slower than
        real time. Both sides need the same value; the statuses of a real arm are then
        stale.
    gate : GateConfig
        Limits of the torque that is sent.

    Examples
    --------
    >>> LcmPanda(gate=GateConfig(dry=True)).status_channel
    'PANDA_STATUS'
    """

    url: str = ""
    status_channel: str = "PANDA_STATUS"
    command_channel: str = "PANDA_COMMAND"
    pace: float = bounded(1.0, least=0.01, most=1)
    gate: GateConfig = field(default_factory=GateConfig)

    @property
    def control_period(self) -> float:
        """Period of the gate, s."""
        return self.gate.period

    def check_robot(self, robot: RobotConfig) -> None:
        """Check that the robot is a Panda, for which the torques are intended."""
        if robot.driver != type(self).__name__:
            raise StationError(
                f"{Path(robot.model).stem} is simulated only; the arm behind LCM is a "
                "Panda. Use the robot panda, or leave out the arm."
            )

    def AddTo(
        self,
        builder: DiagramBuilder,
        *,
        arm: MultibodyPlant,
        initial: Array,
        lcm: DrakeLcmInterface | None,
    ) -> None:
        """Add systems bus, status, command and torque_gate."""
        bus = OpenLcm(self.url) if lcm is None else lcm
        pump = LcmInterfaceSystem(bus)
        builder.AddNamedSystem("bus", pump)
        gate = TorqueGate(
            self.gate,
            initial=initial,
            limits=joint_limits(arm),
            send=TorquePublisher(bus, self.command_channel),
        )
        builder.AddSystem(gate)
        status = LcmSubscriberSystem(
            channel=self.status_channel, serializer=RawSerializer(), lcm=pump
        )
        builder.AddNamedSystem("status", status)
        command = CommandListener(
            bus,
            self.command_channel,
            serializer=RawSerializer(),
            period=self.gate.period,
        )
        builder.AddSystem(command)
        builder.Connect(status.get_output_port(), gate.GetInputPort("status"))
        builder.Connect(command.GetOutputPort("command"), gate.GetInputPort("command"))
        count = command.GetOutputPort("count")
        builder.Connect(count, gate.GetInputPort("command_count"))
        for name in ("torque", "wall_time", "go"):
            builder.ExportInput(gate.GetInputPort(name), name)
        for i in range(gate.num_output_ports()):
            port = gate.get_output_port(i)
            builder.ExportOutput(port, port.get_name())


class TorquePublisher:
    """Publisher of torque commands with stamps of a wall clock.

    Parameters
    ----------
    lcm : DrakeLcmInterface
    channel : str

    Examples
    --------
    >>> TorquePublisher(DrakeLcm("memq://"), "PANDA_COMMAND")(np.zeros(7), 1.7e9)
    """

    def __init__(self, lcm: DrakeLcmInterface, channel: str) -> None:
        builder = DiagramBuilder()
        sender = PandaCommandSender(JOINTS, lcmt_panda_status.CONTROL_MODE_TORQUE)
        builder.AddSystem(sender)
        publisher = builder.AddSystem(
            LcmPublisherSystem.Make(
                channel=channel,
                lcm_type=lcmt_panda_command,
                lcm=lcm,
                publish_triggers={TriggerType.kForced},
                use_cpp_serializer=True,
            )
        )
        builder.Connect(sender.get_output_port(), publisher.get_input_port())
        builder.ExportInput(sender.get_torque_input_port(), "torque")
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def __call__(self, torque: Array, stamp: float) -> None:
        """Publish a torque (7,), Nm, stamped with a time of the wall clock, s."""
        # Drake truncates the time of the Context to microseconds.
        self._context.SetTime(stamp + 0.5e-6)
        self._diagram.GetInputPort("torque").FixValue(self._context, torque)
        self._diagram.ForcedPublish(self._context)


@dataclass
class _PandaFile:
    panda: SimulatedDriver | LcmPanda = field(default_factory=SimulatedDriver)


def LoadPanda(path: str | Path) -> Driver:
    """Load the driver of a Panda from a YAML file.

    Raises
    ------
    StationError
        If the file cannot be read, or a value is out of range; the message contains the reason.

    Examples
    --------
    ::

        panda: !LcmPanda
          url: udpm://239.255.76.67:7667?ttl=0
          gate: {expiry: 0.05, max_rate: 500.0}
    """
    hint = ". Expected panda: with !SimulatedDriver or !LcmPanda."
    with in_one_line(f"{path} does not name an arm", hint):
        text = Path(path).read_text()
        check_yaml(text, str(path), StationError)
        file: _PandaFile = load_yaml(_PandaFile, text)
    check_settings(file.panda, StationError)
    return file.panda


def OpenLcm(url: str) -> DrakeLcm:
    """Open an LCM bus.

    Parameters
    ----------
    url : str
        Empty for the default of LCM.

    Raises
    ------
    StationError
        If the bus cannot be opened; the message contains the reason.
    """
    if url and not str(url).startswith(_PROVIDERS):
        raise StationError(
            f"there is no bus {url!r}; expected a URL of LCM that begins with one of "
            f"{', '.join(_PROVIDERS)}, or nothing for its default."
        )
    with in_one_line(f"there is no bus {url!r}"):
        return DrakeLcm(url)


class RawSerializer(SerializerInterface):
    """Serializer that passes the bytes of a message unread; no bytes before the first.

    Drake's deserializer exits the program (SystemExit) if the bytes are not a message. These
    bytes are checked before they are decoded. An empty message becomes a zero byte, which
    is not a valid message either.
    """

    def CreateDefaultValue(self) -> AbstractValue:
        """Return no bytes."""
        return AbstractValue.Make(b"")

    def Deserialize(self, buffer: bytes, value: Any) -> None:
        """Keep the bytes."""
        value.set_value(bytes(buffer) or b"\0")

    def Serialize(self, value: Any) -> bytes:
        """Return the bytes."""
        return bytes(value.get_value())
