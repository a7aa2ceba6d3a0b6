"""Drivers: the interface between an arm and its controller."""

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from pydrake.lcm import DrakeLcmInterface
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, PassThrough

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array
from fmp_drake.settings import check_settings
from fmp_drake.station.robots.robot import RobotConfig
from fmp_drake.station.scenario_parts import SensorConfig
from fmp_drake.systems import GateMode
from fmp_drake.systems.sensor_model import SensorModel


class Driver(ABC):
    """Base class of the drivers, one for each way to reach an arm.

    A driver is a dataclass, so that YAML can describe it. `MakeDriver` makes its diagram.
    """

    @property
    def control_period(self) -> float | None:
        """Required period of the controller, s; None for any."""
        return None

    def check_robot(self, robot: RobotConfig) -> None:  # noqa: B027
        """Check that the driver supports a robot; the simulated driver supports any.

        Raises
        ------
        StationError
        """

    @abstractmethod
    def AddTo(
        self,
        builder: DiagramBuilder,
        *,
        arm: MultibodyPlant,
        initial: Array,
        lcm: DrakeLcmInterface | None,
    ) -> None:
        """Add the driver's systems and export its ports.

        Parameters
        ----------
        builder : DiagramBuilder
            Of the driver's own diagram.
        arm, initial, lcm
            As for `MakeDriver`.
        """


@dataclass(kw_only=True)
class SimulatedDriver(Driver):
    """An arm in a MultibodyPlant without gravity.

    Attributes
    ----------
    sensors : SensorConfig

    Examples
    --------
    >>> SimulatedDriver().sensors.rate
    0.0
    """

    sensors: SensorConfig = field(default_factory=SensorConfig)

    def AddTo(
        self,
        builder: DiagramBuilder,
        *,
        arm: MultibodyPlant,
        initial: Array,
        lcm: DrakeLcmInterface | None,  # noqa: ARG002
    ) -> None:
        """Add systems gravity_compensation and actuation, and sensors with a rate."""
        n = arm.num_velocities()
        sizes, inputs = {"torque": n, "plant_state": 2 * n, "plant_external": n}, []
        for name, size in sizes.items():
            system = builder.AddNamedSystem(name, PassThrough(size))
            builder.ExportInput(system.get_input_port(), name)
            inputs.append(system.get_output_port())
        torque, state, external = inputs
        compensation = InverseDynamics(
            arm, InverseDynamics.InverseDynamicsMode.kGravityCompensation
        )
        builder.AddNamedSystem("gravity_compensation", compensation)
        total = builder.AddNamedSystem("actuation", Adder(2, n))
        builder.Connect(state, compensation.get_input_port_estimated_state())
        builder.Connect(torque, total.get_input_port(0))
        builder.Connect(
            compensation.get_output_port_generalized_force(), total.get_input_port(1)
        )
        measured, sensors = state, self.sensors
        if sensors.rate > 0:
            at_rest = np.concatenate([initial, np.zeros(n)])
            model = builder.AddSystem(SensorModel(initial=at_rest, **asdict(sensors)))
            builder.Connect(state, model.get_input_port())
            measured = model.get_output_port()
        builder.ExportOutput(torque, "plant_actuation")
        builder.ExportOutput(measured, "state")
        builder.ExportOutput(total.get_output_port(), "torque_measured")
        builder.ExportOutput(external, "torque_external")
        for name, value in (("mode", float(GateMode.OPEN)), ("age", sensors.delay)):
            constant = ConstantVectorSource(np.array([value]))
            source = builder.AddNamedSystem(name, constant)
            builder.ExportOutput(source.get_output_port(), name)


def MakeDriver(
    driver: Driver,
    *,
    arm: MultibodyPlant,
    initial: ArrayLike | None = None,
    lcm: DrakeLcmInterface | None = None,
) -> Diagram:
    """Make the diagram between an arm of n joints and its controller.

    Every driver has the same ports. Input port: torque (n,), without gravity, Nm. Output
    ports: state (2n,), angles and velocities, rad and rad/s; torque_measured (n,), with
    gravity, and torque_external (n,), of the contacts on the arm, Nm; mode (1,), a
    `GateMode`; age (1,), of the measurement, s.

    A simulated arm also has the input ports plant_state and plant_external (its state and
    its generalized contact forces) and the output port plant_actuation, for the plant that
    it is a part of. An arm behind LCM also has the input ports wall_time and go and the
    output ports torque_sent and faults.

    Parameters
    ----------
    driver : Driver
        `SimulatedDriver` or `LcmPanda`.
    arm : MultibodyPlant
        The arm and its tool, with their weight.
    initial : array_like, shape (n,), optional
        Angles that are shown before the first measurement, rad; the arm's default.
    lcm : DrakeLcmInterface, optional
        The bus instead of the driver's own; it must outlive the diagram.

    Raises
    ------
    StationError
        If the driver's settings cannot be used.

    Examples
    --------
    >>> from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel
    >>> arm = MakeRobotModel(LoadRobot("panda")).plant
    >>> diagram = MakeDriver(SimulatedDriver(), arm=arm)
    >>> diagram.GetInputPort("torque").size(), diagram.GetOutputPort("state").size()
    (7, 14)
    """
    check_settings(driver, StationError)
    angles = arm.GetDefaultPositions() if initial is None else initial
    builder = DiagramBuilder()
    driver.AddTo(builder, arm=arm, initial=np.asarray(angles, dtype=float), lcm=lcm)
    diagram = builder.Build()
    diagram.set_name("driver")
    return diagram
