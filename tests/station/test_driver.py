"""Facts about the drivers between an arm and its controller."""

import numpy as np
import pytest
from drake import lcmt_panda_command, lcmt_panda_status
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.lcm import DrakeLcm
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.lcm import LcmSubscriberSystem

from fmp_drake.errors import StationError
from fmp_drake.station import LcmPanda
from fmp_drake.station.robots.driver import MakeDriver, SimulatedDriver
from fmp_drake.station.robots.panda_lcm import LoadPanda, OpenLcm
from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel
from fmp_drake.station.scenario_parts import SensorConfig
from fmp_drake.systems import GateConfig, GateMode
from fmp_drake.systems.panda.arm_status import GateFault

OUTPUTS = {"state": 14, "torque_measured": 7, "torque_external": 7, "mode": 1, "age": 1}
NOW = 1.7e9
INITIAL = np.full(7, 0.2)


@pytest.fixture(scope="module")
def arm():
    return MakeRobotModel(LoadRobot("panda")).plant


def show(driver, context, name):
    return driver.GetOutputPort(name).Eval(context)


def test_every_driver_has_the_same_ports(arm):
    for config in (SimulatedDriver(), LcmPanda(url="memq://")):
        driver = MakeDriver(config, arm=arm)
        assert driver.GetInputPort("torque").size() == 7
        for name, size in OUTPUTS.items():
            assert driver.GetOutputPort(name).size() == size


def test_a_driver_has_as_many_joints_as_its_arm():
    arm = MultibodyPlant(time_step=0.0)
    body = arm.world_body()
    for i in range(3):
        link = arm.AddRigidBody(f"link{i}", SpatialInertia.SolidSphereWithMass(1, 0.1))
        arm.AddJoint(
            RevoluteJoint(
                f"joint{i}", body.body_frame(), link.body_frame(), [0.0, 0.0, 1.0]
            )
        )
        body = link
    arm.Finalize()
    driver = MakeDriver(SimulatedDriver(), arm=arm)
    assert driver.GetInputPort("torque").size() == 3
    assert driver.GetOutputPort("state").size() == 6
    assert driver.GetOutputPort("torque_measured").size() == 3


def test_simulated_arm_passes_torque_and_adds_its_weight(arm):
    driver = MakeDriver(SimulatedDriver(), arm=arm)
    context = driver.CreateDefaultContext()
    values = {"torque": 7, "plant_state": 14, "plant_external": 7}
    inputs = {name: np.linspace(0.1, 1.0, size) for name, size in values.items()}
    for name, value in inputs.items():
        driver.GetInputPort(name).FixValue(context, value)
    assert_array_equal(show(driver, context, "plant_actuation"), inputs["torque"])
    assert_array_equal(show(driver, context, "state"), inputs["plant_state"])
    assert_array_equal(
        show(driver, context, "torque_external"), inputs["plant_external"]
    )
    own = arm.CreateDefaultContext()
    arm.SetPositionsAndVelocities(own, inputs["plant_state"])
    weight = -arm.CalcGravityGeneralizedForces(own)
    measured = show(driver, context, "torque_measured")
    assert_allclose(measured, inputs["torque"] + weight, atol=1e-12)
    assert show(driver, context, "mode") == GateMode.OPEN


def test_simulated_arm_may_be_measured_late(arm):
    sensors = SensorConfig(rate=1000.0, delay=0.002)
    driver = MakeDriver(
        SimulatedDriver(sensors=sensors), arm=arm, initial=np.full(7, 0.2)
    )
    context = driver.CreateDefaultContext()
    assert show(driver, context, "age") == 0.002
    assert_array_equal(show(driver, context, "state"), [0.2] * 7 + [0.0] * 7)


# Over LCM -----------------------------------------------------------------------------


class Bench:
    """A driver over `memq://`, with its clock, its operator and the arm in the test."""

    def __init__(self, arm, **gate):
        self.lcm = DrakeLcm("memq://")
        config = LcmPanda(gate=GateConfig(return_speed=1.0, **gate))
        self.driver = MakeDriver(config, arm=arm, initial=INITIAL, lcm=self.lcm)
        self.simulator = Simulator(self.driver)
        self.context = self.simulator.get_mutable_context()
        # A callback of Python's on this bus would end the interpreter.
        receiver = LcmSubscriberSystem.Make(
            channel="PANDA_COMMAND", lcm_type=lcmt_panda_command, lcm=self.lcm
        )
        self.receiver = Simulator(receiver)
        self.driver.GetInputPort("torque").FixValue(self.context, np.full(7, 3.0))
        self.ticks = self.go = 0

    def tick(self, *, raw=None, silent=False, **values):
        """Send a status, advance for a millisecond, return the torque that came."""
        wall_time = NOW + 1e-3 * self.ticks
        message = lcmt_panda_status()
        message.utime, message.num_joints = round(1e6 * wall_time), 7
        for name in message.__slots__:
            if name.startswith("joint_"):
                setattr(message, name, [0.1] * 7)
        message.joint_velocity = [0.0] * 7
        # Each with the noise of an encoder.
        q = np.array([0.0, 0.4, 0.0, -2.2, 0.0, 2.6, 0.8])
        message.joint_position = (q + 1e-6 * (self.ticks % 5)).tolist()
        message.robot_mode, message.control_mode = 2, 4
        for name, value in values.items():
            setattr(message, name, value)
        if not silent:
            self.lcm.Publish("PANDA_STATUS", message.encode() if raw is None else raw)
        self.driver.GetInputPort("wall_time").FixValue(self.context, [wall_time])
        self.driver.GetInputPort("go").FixValue(self.context, [float(self.go)])
        self.ticks += 1
        self.simulator.AdvanceTo(1e-3 * self.ticks)
        return np.array(self.received().joint_torque)

    def received(self):
        """Return the last command."""
        self.lcm.HandleSubscriptions(0)
        self.receiver.AdvanceTo(1e-3 * self.ticks)
        port = self.receiver.get_system().get_output_port()
        return port.Eval(self.receiver.get_context())

    def show(self, name):
        return show(self.driver, self.context, name)


def opened(arm, **gate):
    bench = Bench(arm, **gate)
    for _ in range(5):
        assert not np.any(bench.tick())
    bench.go = 1
    for _ in range(10):
        torque = bench.tick()
    return bench, torque


def test_torque_is_sent_over_lcm_once_the_operator_enables_it(arm):
    bench, torque = opened(arm)
    assert_array_equal(torque, np.full(7, 3.0))
    assert_allclose(bench.show("state")[:4], [0.0, 0.4, 0.0, -2.2], atol=1e-5)
    assert_array_equal(bench.show("torque_external"), np.full(7, -0.1))
    assert bench.show("mode") == GateMode.OPEN
    assert 0 <= bench.show("age") < 0.003
    message = bench.received()
    # Received in the step after the one that stamped it.
    assert message.utime == round(1e6 * (NOW + 1e-3 * (bench.ticks - 1)))
    assert message.num_joint_torque == 7
    assert message.num_joint_position == message.num_joint_velocity == 0
    assert message.control_mode_expected == lcmt_panda_status.CONTROL_MODE_TORQUE


def test_a_dry_run_sends_zeros(arm):
    bench, torque = opened(arm, dry=True)
    assert not np.any(torque)
    assert bench.show("mode") == GateMode.OPEN


@pytest.mark.parametrize(
    ("wrong", "fault"),
    [
        ({"silent": True}, GateFault.STALE),
        ({"raw": b"no message"}, GateFault.CORRUPT),
        ({"raw": b""}, GateFault.CORRUPT),
        ({"num_joints": 6}, GateFault.CORRUPT),
        ({"robot_mode": lcmt_panda_status.kReflex}, GateFault.WRONG_MODE),
        ({"robot_mode": lcmt_panda_status.kUserStopped}, GateFault.WRONG_MODE),
        ({"utime": 5}, GateFault.OUT_OF_ORDER),
    ],
)
def test_a_fault_of_a_message_stops_the_arm_until_it_is_enabled(arm, wrong, fault):
    bench, torque = opened(arm)
    for _ in range(60):
        before, torque = torque, bench.tick(**wrong)
        assert np.max(np.abs(torque - before)) <= 0.9 + 1e-9
    assert not np.any(torque)
    assert GateFault(int(bench.show("faults")[0])) & fault
    for _ in range(10):
        assert not np.any(bench.tick())
    bench.go = 2
    for _ in range(10):
        torque = bench.tick()
    assert_array_equal(torque, np.full(7, 3.0))


@pytest.mark.parametrize(
    ("first", "faults"),
    [
        ({"silent": True}, GateFault.STALE),
        ({"raw": b""}, GateFault.STALE | GateFault.CORRUPT),
    ],
)
def test_before_the_first_status_an_arm_is_stale_and_not_corrupt(arm, first, faults):
    bench = Bench(arm)
    for _ in range(5):
        bench.tick(**first)
    bench.go = 1
    bench.tick(**first)
    assert GateFault(int(bench.show("faults")[0])) is faults
    assert_array_equal(bench.show("state"), [*INITIAL, *np.zeros(7)])
    assert bench.show("age") == np.inf


# Configurations -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "url", ["bogus", "bogus://", "memq", "udpm:239.255.76.67:7667"]
)
def test_bus_that_lcm_does_not_know_is_refused_with_those_it_knows(url):
    words = (
        f"there is no bus '{url}'; expected a URL of LCM that begins with one of udpm"
    )
    with pytest.raises(StationError, match=words):
        OpenLcm(url)
    assert OpenLcm("memq://").get_lcm_url() == "memq://"


def test_yaml_selects_the_arm(tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("panda: !LcmPanda {url: 'memq://', gate: {expiry: 0.02}}")
    loaded = LoadPanda(path)
    assert loaded == LcmPanda(url="memq://", gate=GateConfig(expiry=0.02))
    path.write_text("panda: !SimulatedDriver {sensors: {rate: 500.0}}")
    assert LoadPanda(path) == SimulatedDriver(sensors=SensorConfig(rate=500.0))


def test_invalid_yaml_or_settings_are_refused(tmp_path, arm):
    path = tmp_path / "arm.yaml"
    for text in ("panda: !OtherArm {}", "panda: !LcmPanda {speed: 3}", "arm: 3"):
        path.write_text(text)
        with pytest.raises(StationError, match="does not name an arm"):
            LoadPanda(path)
    with pytest.raises(StationError, match=r"gate.max_rate is 2000.0"):
        MakeDriver(LcmPanda(gate=GateConfig(max_rate=2000.0)), arm=arm)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ("pace: 0.0", "pace is 0.0; it must be at least 0.01"),
        ("pace: 1.0e-9", "pace is 1e-09; it must be at least 0.01"),
        ("gate: {period: 1.0e-9}", "gate.period is 1e-09; it must be at least 0.0005"),
    ],
)
def test_file_of_an_arm_that_would_never_step_is_refused(tmp_path, values, reason):
    path = tmp_path / "arm.yaml"
    path.write_text(f"panda: !LcmPanda {{{values}}}")
    with pytest.raises(StationError, match=reason):
        LoadPanda(path)
