"""Facts about an arm whose messages are wrong, in lockstep over `memq://`."""

import numpy as np
import pytest
from arm_faults import LIMITS, NOW, FailingNetwork, Fault, Neighbour, frozen

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.runs.arm_bench import Reaction
from fmp_drake.station import models_dir
from fmp_drake.station.robots.panda_lcm import TorquePublisher
from fmp_drake.systems import GateMode
from fmp_drake.systems.panda.arm_status import GateFault

LARGEST = np.radians(2.0)


@pytest.fixture(scope="module")
def skill():
    path = models_dir() / "demonstrations" / "wiping.npz"
    skill = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4)
    return skill.fit(Demonstration.load(path))


def changed(**values):
    """Make a fault that changes rows of every status: joint 4's numbers."""

    def change(ms, message, _earlier):
        for name, offset in values.items():
            row = list(getattr(message, name))
            row[3] += offset(ms) if callable(offset) else offset
            setattr(message, name, row)
        return [message]

    return Fault(status=change)


def mode(value):
    def change(_ms, message, _earlier):
        message.control_mode = value
        return [message]

    return Fault(status=change)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (Fault(status=frozen()), GateFault.FROZEN),
        (changed(joint_position=0.5), GateFault.JUMP),
        (changed(joint_position=900.0), GateFault.OUT_OF_RANGE),
        (changed(joint_velocity=-500.0), GateFault.TOO_FAST),
        (changed(joint_velocity=1.0), GateFault.INCONSISTENT),
        (changed(joint_position=lambda ms: 1e-3 * ms), GateFault.INCONSISTENT),
        (mode(0), GateFault.WRONG_MODE),
        (mode(1), GateFault.WRONG_MODE),
    ],
)
def test_an_implausible_status_stops_the_arm_in_time(skill, fault, name):
    network = FailingNetwork(skill).begin()
    reaction = network.react(fault, 150)
    assert reaction.stopped_after <= 20
    assert reaction.faults & name
    assert reaction.moved < LARGEST
    assert reaction.speed < 1.1 * reaction.speed_before + 0.05
    assert reaction.torque < 0.5
    # It stays stopped.
    assert network.run.mode is GateMode.STOPPED
    assert not np.any(network.run.output("torque_sent"))


def test_the_arm_is_damped_by_its_driver_as_soon_as_its_torque_is_zero(skill):
    network = FailingNetwork(skill).begin(500)
    damped = network.bench.reactions[Reaction.DAMPED]
    reaction = network.react(changed(joint_velocity=np.nan), 100)
    assert reaction.stopped_after <= 2
    # A torque of at most 15 Nm is zero after 17 ms.
    assert network.bench.reactions[Reaction.DAMPED] - damped >= 80
    assert network.bench.torque_rate <= 1000


def test_an_arm_at_rest_is_not_frozen(skill):
    # It has no noise here: its state is the same to the last bit.
    network = FailingNetwork(skill).advance(200)
    states = np.array(network.states)
    assert np.array_equal(states[-1], states[-50])
    assert network.begin(500).run.mode is GateMode.OPEN


class OtherController:
    """A program that sends zeros to the arm, each millisecond."""

    def __init__(self, network):
        self.network = network
        self.publish = TorquePublisher(network.bus, "PANDA_COMMAND")

    def advance(self, milliseconds):
        for _ in range(milliseconds):
            self.publish(np.zeros(7), NOW + 1e-3 * self.network.ticks)
            self.network.advance(1)


def test_an_arm_is_not_enabled_while_another_program_commands_it(skill):
    network = FailingNetwork(skill).advance(20)
    other = OtherController(network)
    network.run.go()
    other.advance(400)
    assert network.run.mode is GateMode.WAITING
    assert network.run.faults is GateFault.OTHER_CONTROLLER
    # An old command of a program that has ended does not count.
    assert network.advance(200).begin(500).run.mode is GateMode.OPEN


def test_an_arm_stops_where_another_program_commands_it(skill):
    network = FailingNetwork(skill).begin()
    before = network.states[-1][:7]
    OtherController(network).advance(20)
    assert network.run.mode is GateMode.STOPPED
    assert network.run.faults & GateFault.OTHER_CONTROLLER
    network.advance(300)
    assert np.max(np.abs(network.states[-1][:7] - before)) < LARGEST


@pytest.fixture
def neighbour(monkeypatch):
    """Let a program that begins when told send beside the gate."""
    kind = type("Told", (Neighbour,), {})
    monkeypatch.setattr("fmp_drake.station.robots.panda_lcm.TorquePublisher", kind)
    return kind


def zeros(_torque):
    return np.zeros(7)


def copied(torque):
    return torque


@pytest.mark.parametrize("place", ["before", "after"])
@pytest.mark.parametrize("torque_of", [zeros, copied])
@pytest.mark.parametrize("stamp_offset", [0.0, -2e-6, -1.0])
def test_another_program_is_found_whenever_its_commands_come(
    skill, neighbour, place, torque_of, stamp_offset
):
    network = FailingNetwork(skill).begin(500)
    setattr(neighbour, place, staticmethod(torque_of))
    neighbour.stamp_offset = stamp_offset
    reaction = network.react(Fault(), 150)
    assert reaction.stopped_after <= 3
    assert reaction.faults is GateFault.OTHER_CONTROLLER
    # Where its zeros come last, they reach the arm instead of the torque that brakes it.
    is_braked = place == "before" or torque_of is copied
    assert reaction.moved < (1.0 if is_braked else 2.0) * LARGEST


@pytest.mark.parametrize("hertz", [50, 100, 200])
def test_a_slow_program_just_before_the_gate_is_found_at_its_first_command(
    skill, neighbour, hertz
):
    network = FailingNetwork(skill).begin(500)
    ticks = []

    def sometimes(torque):
        ticks.append(network.ticks)
        # In the other milliseconds it sends nothing that the arm would hear.
        return torque

    for _ in range(3):
        network.advance(1000 // hertz - 1)
        neighbour.before = staticmethod(sometimes)
        network.advance(1)
        neighbour.before = None
    network.advance(2)
    assert network.run.faults is GateFault.OTHER_CONTROLLER
    assert 1e3 * network.run.stops[0][0] - ticks[0] <= 3


@pytest.mark.parametrize("pause", [1, 20, 45, 80])
def test_a_pause_is_not_another_program(skill, pause):
    network = FailingNetwork(skill).begin(500)
    network.react(Fault(controller_pause=pause, duration=pause), pause + 200)
    assert not network.run.faults & GateFault.OTHER_CONTROLLER
    assert (network.run.mode is GateMode.STOPPED) == (pause > 50)
    if pause > 50:
        network.advance(200).begin(500)
    assert network.run.mode is GateMode.OPEN


def moved_by_hand(network, offset):
    """Put the stopped arm elsewhere, as a person would, within a second."""
    simulator, plant = network.bench.simulator, network.bench.plant
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = network.states[-1][:7]
    for blend in np.linspace(0, 1, 1000):
        smooth = blend**2 * (3 - 2 * blend)
        plant.SetPositions(context, network.bench.arm, start + smooth * offset)
        velocity = 6 * blend * (1 - blend) * offset
        plant.SetVelocities(context, network.bench.arm, velocity)
        network.advance(1)
    plant.SetVelocities(context, network.bench.arm, np.zeros(7))
    network.advance(600)


@pytest.mark.parametrize("joints", [(0, 1, 3), (4, 5, 6)])
def test_displaced_arm_returns_slowly(skill, joints):
    network = FailingNetwork(skill).begin(500)
    network.run.stop()
    network.advance(400)
    offset = np.zeros(7)
    offset[list(joints)] = (0.3, -0.3, 0.3)
    moved_by_hand(network, offset)
    first = len(network.states)
    network.run.go()
    network.advance(310)
    assert network.run.mode is GateMode.RETURNING
    while network.run.mode is GateMode.RETURNING:
        network.advance(1)
        assert len(network.states) < first + 15000
    speeds = np.abs(np.array(network.states[first:])[:, 7:]) / LIMITS.speed
    assert np.max(speeds) < 0.15
    assert network.run.mode is GateMode.OPEN
    network.advance(500)
    assert not network.run.stops[1:]
    assert np.max(np.abs(network.states[-1][7:]) / LIMITS.speed) < 0.5


@pytest.mark.parametrize("pause", [10, 40])
def test_torque_goes_to_zero_while_statuses_are_missing_for_20_ms(skill, pause):
    network = FailingNetwork(skill).begin(500)
    network.fault = Fault(status=lambda *_: [], duration=pause)
    network.began = network.ticks
    network.advance(pause)
    before, end = np.abs(np.array(network.torques)[[-pause - 1, -1]]).max(axis=1)
    # The torque of 7 Nm decreases from 20 ms to 28 ms.
    assert before > 5
    assert (end == 0) == (pause == 40)
    network.advance(500)
    assert network.run.mode is GateMode.OPEN
    assert not network.run.stops
    assert np.max(np.abs(network.torques[-1])) > 1
    assert network.bench.torque_rate <= 1000


def test_without_statuses_the_arm_moves_by_less_than_4_degrees(skill):
    network = FailingNetwork(skill).begin(500)
    reaction = network.react(Fault(status=lambda *_: []))
    assert reaction.faults is GateFault.STALE
    assert reaction.moved < np.radians(4.0)
    assert reaction.speed < reaction.speed_before + 0.1


@pytest.mark.parametrize("hertz", [200, 1000])
def test_a_slow_arm_is_plausible_and_its_freeze_is_seen(skill, hertz):
    stride = 1000 // hertz

    def seldom(ms, message, _earlier):
        return [message] if ms % stride == 0 else []

    network = FailingNetwork(skill)
    network.fault = Fault(status=seldom)
    network.begin()
    freeze = frozen()

    def both(ms, message, earlier):
        return freeze(ms, message, earlier) if ms % stride == 0 else []

    reaction = network.react(Fault(status=both), 150)
    assert reaction.stopped_after <= 20
    assert reaction.faults & GateFault.FROZEN
    assert reaction.moved < LARGEST
