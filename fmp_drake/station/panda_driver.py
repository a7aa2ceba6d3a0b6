"""The seam between a Panda and its controller: simulated, real, or a log's."""

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.common.yaml import yaml_load_typed
from pydrake.lcm import DrakeLcm, DrakeLcmInterface
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.lcm import (
    LcmInterfaceSystem,
    LcmSubscriberSystem,
    SerializerInterface,
)
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    PassThrough,
    TrajectorySource,
)
from pydrake.trajectories import PiecewisePolynomial

from fmp_drake.errors import StationError
from fmp_drake.primitives.data.files import read_npz
from fmp_drake.settings import bounded, check_settings
from fmp_drake.station.scenario_parts import SensorConfig
from fmp_drake.systems.panda.gating import GateConfig, GateMode
from fmp_drake.systems.panda.reading import JOINTS
from fmp_drake.systems.sensor_model import SensorModel
from fmp_drake.systems.torque_gate import TorqueGate


@dataclass(kw_only=True)
class SimulatedPanda:
    """An arm of a MultibodyPlant, in which it has no weight.

    Attributes
    ----------
    sensors : SensorConfig

    Examples
    --------
    >>> SimulatedPanda().sensors.rate
    0.0
    """

    sensors: SensorConfig = field(default_factory=SensorConfig)


@dataclass(kw_only=True)
class LcmPanda:
    """An arm behind Drake's LCM messages, real or simulated by another process.

    Attributes
    ----------
    url : str
        Of LCM; empty for its own default.
    status_channel, command_channel : str
    pace : float
        Of a simulated arm that cannot keep up: seconds of the clock of its messages per
        second. Both sides must be given the same one; what a real arm says is then stale.
    gate : GateConfig
        What may be sent.

    Examples
    --------
    >>> LcmPanda(gate=GateConfig(dry=True)).status_channel
    'PANDA_STATUS'
    """

    url: str = ""
    status_channel: str = "PANDA_STATUS"
    command_channel: str = "PANDA_COMMAND"
    pace: float = bounded(1.0, above=0, most=1)
    gate: GateConfig = field(default_factory=GateConfig)


@dataclass(kw_only=True)
class ReplayPanda:
    """The arm of a run's log, which does what it did whatever torque comes.

    Attributes
    ----------
    log : str
        A file of `fmp-drake wipe --log`.

    Examples
    --------
    >>> ReplayPanda(log="run.npz").log
    'run.npz'
    """

    log: str = ""


PandaConfig = SimulatedPanda | LcmPanda | ReplayPanda


@dataclass
class _PandaFile:
    panda: PandaConfig = field(default_factory=SimulatedPanda)


def LoadPanda(path: str | Path) -> PandaConfig:
    """Load what `MakePandaDriver` takes from a YAML file.

    Raises
    ------
    StationError
        Where it cannot be read; it says why.

    Examples
    --------
    ::

        panda: !LcmPanda
          url: udpm://239.255.76.67:7667?ttl=0
          gate: {expiry: 0.05, max_rate: 500.0}
    """
    try:
        loaded: _PandaFile = yaml_load_typed(  # type: ignore[no-untyped-call]
            schema=_PandaFile, filename=str(path), defaults=_PandaFile()
        )
    except (RuntimeError, TypeError, ValueError, KeyError, OSError) as error:
        reason = str(error).strip().splitlines()[0]
        raise StationError(
            f"{path} does not say which arm: {reason}. Expected panda: with one of "
            "!SimulatedPanda, !LcmPanda, !ReplayPanda."
        ) from None
    return loaded.panda


def OpenLcm(url: str) -> DrakeLcm:
    """Open a bus of LCM; empty for its default.

    Raises
    ------
    StationError
        Where there is none; it says why.
    """
    try:
        return DrakeLcm(url)
    except RuntimeError as error:
        raise StationError(f"there is no bus {url!r}: {error}.") from None


def MakePandaDriver(
    config: PandaConfig,
    *,
    arm: MultibodyPlant,
    initial: ArrayLike | None = None,
    lcm: DrakeLcmInterface | None = None,
) -> Diagram:
    """Make the diagram that stands for the arm, with the same ports in every case.

    Input port: torque (7,), without gravity, Nm. Output ports: state (14,), angles and
    speeds, rad and rad/s; torque_measured (7,), with gravity, and torque_external (7,),
    of what touches the arm on the arm, Nm; mode (1,), a `GateMode`; age (1,), of
    what is measured, s.

    Besides, the simulated arm has the input ports plant_state and plant_external (its
    state and generalized contact forces) and the output port plant_actuation, for the
    plant that it is a part of. The arm behind LCM has the input ports wall_time and go
    and the output ports torque_sent and faults of its `TorqueGate`.

    Parameters
    ----------
    config : SimulatedPanda, LcmPanda or ReplayPanda
    arm : MultibodyPlant
        The arm and its tool, with their weight.
    initial : array_like, shape (7,), optional
        Angles that are shown until something is measured, rad; the arm's default.
    lcm : DrakeLcmInterface, optional
        The bus instead of one of `config.url`; it must outlive the diagram.

    Raises
    ------
    StationError
        Where the configuration cannot be used.

    Examples
    --------
    >>> from fmp_drake.station import AddPandaWithEraser
    >>> arm = MultibodyPlant(time_step=0.0)
    >>> _ = AddPandaWithEraser(arm)
    >>> arm.Finalize()
    >>> driver = MakePandaDriver(SimulatedPanda(), arm=arm)
    >>> driver.GetInputPort("torque").size(), driver.GetOutputPort("state").size()
    (7, 14)
    """
    check_settings(config, StationError)
    builder = DiagramBuilder()
    if initial is None:
        initial = arm.GetDefaultPositions()
    if isinstance(config, SimulatedPanda):
        _AddSimulated(builder, config, arm, initial)
    elif isinstance(config, LcmPanda):
        _AddLcm(builder, config, lcm, initial)
    else:
        _AddReplay(builder, config)
    diagram = builder.Build()
    diagram.set_name("panda_driver")
    return diagram


def _AddSimulated(
    builder: DiagramBuilder,
    config: SimulatedPanda,
    arm: MultibodyPlant,
    initial: ArrayLike,
) -> None:
    """Add systems gravity_compensation and actuation, and sensors with a rate."""
    config.sensors.check()
    inputs = {}
    for name, size in (
        ("torque", JOINTS),
        ("plant_state", 2 * JOINTS),
        ("plant_external", JOINTS),
    ):
        inputs[name] = builder.AddNamedSystem(name, PassThrough(size))
        builder.ExportInput(inputs[name].get_input_port(), name)
    torque, state, external = (each.get_output_port() for each in inputs.values())
    compensation = InverseDynamics(
        arm, InverseDynamics.InverseDynamicsMode.kGravityCompensation
    )
    builder.AddNamedSystem("gravity_compensation", compensation)
    total = builder.AddNamedSystem("actuation", Adder(2, JOINTS))
    builder.Connect(state, compensation.get_input_port_estimated_state())
    builder.Connect(torque, total.get_input_port(0))
    builder.Connect(
        compensation.get_output_port_generalized_force(), total.get_input_port(1)
    )
    measured, sensors = state, config.sensors
    if sensors.rate > 0:
        model = builder.AddSystem(
            SensorModel(
                initial=np.concatenate([initial, np.zeros(JOINTS)]),
                rate=sensors.rate,
                delay=sensors.delay,
                position_noise=sensors.position_noise,
                velocity_noise=sensors.velocity_noise,
                seed=sensors.seed,
            )
        )
        builder.Connect(state, model.get_input_port())
        measured = model.get_output_port()
    builder.ExportOutput(torque, "plant_actuation")
    builder.ExportOutput(measured, "state")
    builder.ExportOutput(total.get_output_port(), "torque_measured")
    builder.ExportOutput(external, "torque_external")
    _ExportConstant(builder, "mode", [float(GateMode.OPEN)])
    _ExportConstant(builder, "age", [sensors.delay])


def _AddLcm(
    builder: DiagramBuilder,
    config: LcmPanda,
    lcm: DrakeLcmInterface | None,
    initial: ArrayLike,
) -> None:
    """Add systems bus, status and torque_gate."""
    bus = OpenLcm(config.url) if lcm is None else lcm
    pump = LcmInterfaceSystem(bus)
    builder.AddNamedSystem("bus", pump)
    status = LcmSubscriberSystem(
        channel=config.status_channel,
        serializer=RawSerializer(),
        lcm=pump,
    )
    builder.AddNamedSystem("status", status)
    gate = TorqueGate(
        config.gate, initial=initial, send=partial(bus.Publish, config.command_channel)
    )
    builder.AddSystem(gate)
    builder.Connect(status.get_output_port(), gate.GetInputPort("status"))
    for name in ("torque", "wall_time", "go"):
        builder.ExportInput(gate.GetInputPort(name), name)
    for i in range(gate.num_output_ports()):
        port = gate.get_output_port(i)
        builder.ExportOutput(port, port.get_name())


def _AddReplay(builder: DiagramBuilder, config: ReplayPanda) -> None:
    """Add a source of what was logged, which holds each sample until the next."""
    logged: Any = read_npz(
        Path(config.log), "give a file of `fmp-drake wipe --log`", StationError
    )
    torque = builder.AddNamedSystem("torque", PassThrough(JOINTS))
    builder.ExportInput(torque.get_input_port(), "torque")
    for signal, name in (("state", "state"), ("actuation", "torque_measured")):
        try:
            about = json.loads(str(logged["metadata"]))["signals"][signal]
            seconds, values = logged[about["times"]], logged[signal]
        except (KeyError, ValueError):
            raise StationError(
                f"{config.log} has no signal {signal}; give a file that `fmp-drake "
                "wipe --log` wrote."
            ) from None
        # The last sample is held, too.
        times: Any = np.append(seconds, seconds[-1] + 1)
        samples: Any = np.vstack([values, values[-1:]]).T
        held = PiecewisePolynomial.ZeroOrderHold(times, samples)
        source = builder.AddNamedSystem(name, TrajectorySource(held))
        builder.ExportOutput(source.get_output_port(), name)
    _ExportConstant(builder, "torque_external", np.zeros(JOINTS))
    _ExportConstant(builder, "mode", [float(GateMode.OPEN)])
    _ExportConstant(builder, "age", [0.0])


def _ExportConstant(builder: DiagramBuilder, name: str, value: ArrayLike) -> None:
    source = builder.AddNamedSystem(name, ConstantVectorSource(np.array(value)))
    builder.ExportOutput(source.get_output_port(), name)


class RawSerializer(SerializerInterface):
    """Leaves a message as the bytes that came, which are cheap to copy."""

    def CreateDefaultValue(self) -> AbstractValue:
        """Return no bytes."""
        return AbstractValue.Make(b"")

    def Deserialize(self, buffer: bytes, value: Any) -> None:
        """Keep the bytes."""
        value.set_value(bytes(buffer))

    def Serialize(self, value: Any) -> bytes:
        """Return the bytes."""
        return bytes(value.get_value())
