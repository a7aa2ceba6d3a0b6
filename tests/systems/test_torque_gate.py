"""Facts about the torque that may be sent to a real arm."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from drake import lcmt_panda_command, lcmt_panda_status
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import SystemsError
from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel
from fmp_drake.systems import GateConfig, GateMode
from fmp_drake.systems.interface.arm_model import joint_limits
from fmp_drake.systems.panda.arm_status import GateFault, read_status
from fmp_drake.systems.panda.gate import (
    CommandTrack,
    GateInputs,
    GateState,
    command_utime,
    gate_step,
    initial_gate,
    limited_change,
    track_commands,
)
from fmp_drake.systems.torque_gate import TorqueGate

NOW = 1.7e9
LIMITS = joint_limits(MakeRobotModel(LoadRobot("panda")).plant)
LIMIT = LIMITS.upper_effort
Q = np.array([0.0, 0.4, 0.0, -2.2, 0.0, 2.6, 0.8])
# Without the slow return: what is sent is the controller's torque at once.
AT_ONCE = GateConfig(return_speed=1.0).completed(LIMITS)
ANY = st.floats(allow_nan=True, allow_infinity=True)
# What a clock, a network and a person may do; mostly what they should.
STEPS = st.lists(
    st.fixed_dictionaries(
        {
            "elapsed": st.one_of(st.just(1e-3), st.floats(-1e-3, 0.06), ANY),
            "age": st.one_of(st.just(0.0), st.floats(-0.06, 0.2), ANY),
            "torque": st.one_of(st.floats(-200, 200), ANY),
            "status": st.sampled_from(
                ["good"] * 12 + ["no joints", "nan", "huge", "idle", "position", "none"]
            ),
            "go": st.sampled_from([0] * 6 + [1, 1, 1, -1]),
        }
    ),
    max_size=60,
)


def status(time=NOW, kind="good", **values):
    message = lcmt_panda_status()
    message.utime = round(1e6 * time) if abs(time) < 1e12 else 0
    message.num_joints = 7
    for name in message.__slots__:
        if name.startswith("joint_"):
            setattr(message, name, [0.1] * 7)
    # An arm at rest, with the noise of its encoders.
    noise = 1e-6 * np.sin(1e5 * (time - NOW) + np.arange(7)) if abs(time) < 1e12 else 0
    message.joint_position = (Q + noise).tolist()
    message.joint_velocity = [0.0] * 7
    message.robot_mode = lcmt_panda_status.kMove
    message.control_mode = lcmt_panda_status.CONTROL_MODE_TORQUE
    if kind == "no joints":
        message.joint_position = []
    elif kind in ("nan", "huge"):
        message.joint_velocity = [0.0] * 6 + [np.nan if kind == "nan" else 1e200]
    elif kind == "idle":
        message.robot_mode = lcmt_panda_status.kIdle
    elif kind == "position":
        message.control_mode = lcmt_panda_status.CONTROL_MODE_POSITION
    for name, value in values.items():
        setattr(message, name, value)
    return None if kind == "none" else message


def play(steps, config=None):
    """Yield the gate before and after each step, and the step."""
    gate, wall, gos = initial_gate(), NOW, 0
    for each in steps:
        wall_time = wall + each["elapsed"]
        if np.isfinite(wall_time) and abs(wall_time - NOW) < 1e3:
            wall = wall_time
        gos += each["go"] > 0
        inputs = GateInputs(
            command=lcmt_panda_command(),
            command_count=0.0,
            reading=read_status(status(wall - each["age"], each["status"])),
            torque=np.full(7, each["torque"]),
            wall_time=wall_time,
            go=-1.0 if each["go"] < 0 else gos,
        )
        after = gate_step(config or AT_ONCE, gate, inputs, limits=LIMITS)
        yield gate, after, {**each, "wall_time": wall_time}
        gate = after


# Whatever happens ---------------------------------------------------------------------


@given(STEPS)
def test_torque_is_finite_and_within_its_limits(steps):
    for _, after, _ in play(steps):
        assert np.all(np.abs(after.torque) <= LIMIT)


@given(STEPS)
def test_torque_changes_by_at_most_its_rate_times_the_wall_time(steps):
    for before, after, step in play(steps):
        change = np.max(np.abs(after.torque - before.torque))
        assert change <= 0.9 + 1e-12
        elapsed = step["wall_time"] - before.wall_time
        if np.isfinite(elapsed):
            assert change <= 900 * max(elapsed, 0.0) + 1e-12


@given(STEPS)
def test_torque_of_a_gate_that_is_not_open_does_not_grow(steps):
    for before, after, _ in play(steps):
        if after.mode is not GateMode.OPEN:
            assert np.all(np.abs(after.torque) <= np.abs(before.torque))


@pytest.mark.parametrize("wall_time", [np.nan, np.inf, -np.inf, 1e13, 1.8e302])
def test_a_time_that_no_message_can_have_is_refused(wall_time):
    step = {"elapsed": 1e-3, "age": 0.0, "torque": 1.0, "status": "good", "go": 1}
    impossible = {**step, "elapsed": wall_time - NOW, "go": 0}
    *_, (before, after, _) = play([step] * 5 + [impossible])
    assert before.mode is GateMode.OPEN
    assert after.mode is not GateMode.OPEN
    assert after.wall_time == before.wall_time


@given(STEPS)
def test_a_gate_opens_only_on_request_and_at_zero_torque(steps):
    for before, after, step in play(steps):
        if after.mode is GateMode.OPEN and before.mode is not GateMode.OPEN:
            assert step["go"] > 0
            assert step["status"] == "good"
            assert not np.any(before.torque)


@given(STEPS)
def test_an_open_gate_has_a_status_that_is_young_and_good(steps):
    for _, after, step in play(steps):
        if after.mode is GateMode.OPEN:
            assert step["status"] == "good"
            assert abs(after.wall_time - after.status_time) <= 0.05 + 1e-6
            assert np.isfinite(step["torque"])


@given(STEPS)
def test_a_dry_gate_sends_zeros_in_the_same_modes(steps):
    wet, dry = play(steps), play(steps, replace(AT_ONCE, dry=True))
    for (_, after, _), (_, never, _) in zip(wet, dry, strict=True):
        assert not np.any(never.torque)
        if after.mode is not never.mode:
            break  # A go is void while the torque is on its way to zero.
        assert never.status_time == after.status_time


@given(STEPS)
def test_a_gate_is_four_vectors(steps):
    for _, after, _ in play(steps):
        again = GateState.from_vectors(*after.vectors())
        for vector, other in zip(again.vectors(), after.vectors(), strict=True):
            assert_array_equal(vector, other)


@given(
    st.lists(st.floats(-100, 100), min_size=7, max_size=7),
    st.lists(st.floats(-100, 100), min_size=7, max_size=7),
    st.floats(0, 1),
)
def test_limited_change_keeps_its_direction(previous, wanted, most):
    previous = np.clip(previous, -LIMIT, LIMIT)
    wanted = np.clip(wanted, -LIMIT, LIMIT)
    change = limited_change(previous, wanted, most, LIMIT) - previous
    whole = wanted - previous
    assert np.max(np.abs(change)) <= most + 1e-12
    assert np.linalg.norm(np.outer(change, whole) - np.outer(whole, change)) < 1e-9


@given(st.binary(max_size=600))
def test_any_message_can_be_read(data):
    whole = status().encode()
    for raw in (data, whole[:40] + data + whole[40 + len(data) :]):
        try:
            message = lcmt_panda_status.decode(raw)
        except (ValueError, struct.error):
            message = None
        reading = read_status(message)
        assert not reading.is_finite or np.all(np.isfinite(np.r_[reading[1:4]]))


def test_faults_can_be_told_apart_when_they_are_combined():
    bits = [fault.value for fault in GateFault]
    assert all(bit & (bit - 1) == 0 for bit in bits)
    assert len(bits) == len(GateFault.__members__) == len(set(bits))


@pytest.mark.parametrize(
    "name",
    ["joint_position", "joint_velocity", "joint_torque", "joint_torque_external"],
)
@pytest.mark.parametrize("sign", [-1, 1])
def test_numbers_of_a_status_are_below_1000(name, sign):
    for value, is_finite in ((999.0, True), (1001.0, False)):
        numbers = [0.0] * 6 + [sign * value]
        assert read_status(status(**{name: numbers})).is_finite == is_finite


def test_status_that_cannot_be_read_is_an_empty_one_of_the_same_shape():
    good, broken = read_status(status()), read_status(None)
    assert broken.faults is GateFault.CORRUPT
    assert broken.time == -np.inf
    assert [np.shape(x) for x in broken] == [np.shape(x) for x in good]
    assert read_status(status(num_joints=6)).faults is GateFault.CORRUPT


# One after the other -----------------------------------------------------------------


def step(**values):
    usual = {"elapsed": 1e-3, "age": 0.0, "torque": 5.0, "status": "good", "go": 0}
    return usual | values


def last_of(steps, config=None):
    return list(play(steps, config))[-1][1]


OPENED = [step(), step(go=1), *[step()] * 20]


def test_torque_is_zero_until_enabled_and_then_increases_at_its_rate():
    assert not np.any(last_of([step()] * 50).torque)
    opened = [after.torque[0] for _, after, _ in play(OPENED)]
    assert np.allclose(opened[:8], [0, 0.9, 1.8, 2.7, 3.6, 4.5, 5.0, 5.0], atol=1e-3)


@pytest.mark.parametrize(
    ("wrong", "fault"),
    [
        ({"age": 0.051}, GateFault.STALE | GateFault.OUT_OF_ORDER),
        ({"age": -0.06}, GateFault.STALE),
        ({"age": 0.01}, GateFault.OUT_OF_ORDER),
        ({"status": "no joints"}, GateFault.CORRUPT),
        ({"status": "nan"}, GateFault.NOT_FINITE),
        ({"status": "huge"}, GateFault.NOT_FINITE),
        ({"status": "idle"}, GateFault.WRONG_MODE),
        ({"status": "position"}, GateFault.WRONG_MODE),
        ({"elapsed": 1.0}, GateFault.GAP),
        ({"elapsed": -0.01}, GateFault.CLOCK | GateFault.OUT_OF_ORDER),
        ({"elapsed": np.nan}, GateFault.CLOCK),
        ({"torque": np.nan}, GateFault.NO_TORQUE),
        ({"go": -1}, GateFault.STOPPED),
    ],
)
def test_fault_stops_the_arm_until_the_operator_enables_it(wrong, fault):
    stopped = last_of([*OPENED, step(**wrong)])
    assert stopped.mode is GateMode.STOPPED
    assert stopped.faults & fault == fault
    calm = [*OPENED, step(**wrong), *[step()] * 50]
    assert not np.any(last_of(calm).torque)
    assert last_of(calm).mode is GateMode.STOPPED
    again = last_of([*calm, step(go=1), *[step()] * 20])
    assert again.mode is GateMode.OPEN
    assert again.torque[0] == 5.0


def test_an_enable_request_during_a_fault_or_torque_is_ignored():
    refused = last_of([step(), step(go=1, status="idle"), *[step()] * 5])
    assert refused.mode is GateMode.WAITING
    assert refused.faults is GateFault.WRONG_MODE
    hasty = [*OPENED, step(age=1.0), step(go=1), *[step()] * 20]
    assert last_of(hasty).mode is GateMode.STOPPED


def test_a_torque_that_stays_zero_is_not_sent_so_that_the_arm_is_damped():
    live = [after.is_live for _, after, _ in play([*OPENED, step(age=1.0)])]
    assert live == [False, *[True] * (len(OPENED))]
    assert not last_of([*OPENED, step(age=1.0), *[step()] * 20]).is_live
    assert last_of(OPENED, replace(AT_ONCE, dry=True)).is_live


def test_the_command_that_ends_a_stop_has_expired_so_that_the_arm_is_damped_at_once():
    sent = [
        a for _, a, _ in play([*OPENED, step(age=1.0), *[step()] * 20]) if a.is_live
    ]
    *earlier, last = sent
    assert all(each.command_time == each.wall_time for each in earlier)
    assert not np.any(last.torque)
    assert np.all([np.any(each.torque) for each in earlier[1:]])
    # The robot ignores a command that is older than 0.1 s.
    assert last.wall_time - last.command_time > 0.1
    # An arm that is enabled gets zeros that count.
    zeros = last_of([step(), step(go=1, torque=0.0), *[step(torque=0.0)] * 20])
    assert zeros.is_live
    assert zeros.command_time == zeros.wall_time


@pytest.mark.parametrize("mode", [0, 1, 2, 5, 7])
def test_a_status_must_report_torque_control(mode):
    # A driver that leaves the mode out may expect positions: its arm is not enabled.
    assert read_status(status(control_mode=mode)).faults is GateFault.WRONG_MODE


def test_full_torque_is_zero_after_a_tenth_of_a_second():
    full = [step(), step(go=1, torque=80.0), *[step(torque=80.0)] * 100]
    assert last_of(full).torque[0] == 80.0
    assert not np.any(last_of([*full, step(age=1.0), *[step(torque=80.0)] * 90]).torque)


def test_torque_continues_after_a_frozen_second():
    after = last_of([*OPENED, step(elapsed=1.0, torque=-80.0)])
    assert after.torque[0] == pytest.approx(5.0 - 0.9)


@pytest.mark.parametrize("torque", [0.0, 1.0])
def test_a_stop_brakes_a_moving_arm_for_three_tenths_of_a_second(torque):
    gate, speed, gates = initial_gate(), 0.1, []
    for i in range(400):
        wall_time = NOW + 1e-3 * i
        message = status(
            wall_time,
            joint_position=(Q + 1e-3 * i * speed).tolist(),
            # No encoder gives the same velocity again and again.
            joint_velocity=[speed + 1e-9 * i] * 7,
        )
        inputs = GateInputs(
            command=lcmt_panda_command(),
            command_count=0.0,
            reading=read_status(message),
            torque=np.full(7, torque),
            wall_time=wall_time,
            go=1.0 if 0 < i < 50 else -1.0,
        )
        gate = gate_step(AT_ONCE, gate, inputs, limits=LIMITS)
        gates.append(gate)
    damping = np.array([37.5, 50, 37.5, 25, 5, 3.75, 2.5])
    torques = np.array([gate.torque for gate in gates])
    assert np.allclose(torques[10:50], torque)
    # It grows without a pause, and the robot gets each torque.
    assert np.all(np.diff(torques[49:60, 1]) <= 0)
    assert all(gate.command_time == gate.wall_time for gate in gates[1:349])
    assert np.allclose(torques[60:348], -damping * speed)
    assert not np.any(torques[358:])
    # One expired command ends the stop, and nothing follows.
    live = [gate.is_live for gate in gates]
    (end,) = np.flatnonzero(~torques.any(axis=1) & live & (np.arange(400) > 50))
    assert gates[end].command_time < gates[end].wall_time
    assert not any(live[end + 1 :])


def test_a_return_ends_after_a_small_torque_for_a_tenth_of_a_second():
    config = GateConfig().completed(LIMITS)
    calm = [step(torque=0.5)] * 130
    begun = [step(), step(go=1, torque=0.5), *calm]
    modes = [after.mode for _, after, _ in play(begun, config)]
    assert modes.index(GateMode.RETURNING) == 1
    assert 100 <= modes.index(GateMode.OPEN) <= 103
    begun = [*begun[:50], step(torque=30.0), *calm]
    modes = [after.mode for _, after, _ in play(begun, config)]
    assert 149 <= modes.index(GateMode.OPEN) <= 153


def test_a_command_is_stamped_with_the_nearest_microsecond():
    assert command_utime(1.0000004) == 1_000_000
    assert command_utime(1.0000006) == 1_000_001


# Commands of another program ----------------------------------------------------------


class CommandBus:
    """The gate's own commands, each of which is heard later, and others."""

    def __init__(self):
        self.track, self.time, self.count = CommandTrack(), NOW, 0
        self.sent, self.newest, self.is_foreign = [], lcmt_panda_command(), False

    def send(self):
        self.time += 1e-3
        torque = np.sin(self.time * np.arange(1, 8))
        self.sent.append(command(self.time, torque))
        self.track = self.track.after(self.time, torque)

    def hear(self, *messages):
        """Look at the bus, where messages have come since the last look."""
        self.count += len(messages)
        self.newest = messages[-1] if messages else self.newest
        self.track, is_foreign = track_commands(
            self.track, self.newest, self.count, self.time
        )
        self.is_foreign |= is_foreign
        # The memory is a vector of numbers.
        self.track = CommandTrack.from_vector(self.track.vector())
        return is_foreign


def command(time, torque):
    message = lcmt_panda_command()
    message.utime, message.num_joint_torque = command_utime(time), 7
    message.joint_torque = list(torque)
    return message


@pytest.fixture
def bus():
    """Return a bus on which each command has been heard in the next millisecond."""
    bus = CommandBus()
    for _ in range(300):
        bus.send()
        assert not bus.hear(bus.sent[-1])
    return bus


def test_own_commands_may_come_late_and_all_at_once(bus):
    for delay in (1, 5, 80, 120):
        for _ in range(delay):
            bus.send()
            assert not bus.hear()
        assert not bus.hear(*bus.sent[-delay:])


@given(st.lists(st.tuples(st.integers(0, 3), st.booleans()), max_size=200))
def test_own_commands_may_be_late_by_3_ms_and_change_their_order(echoes):
    bus, due = CommandBus(), {}
    for time, (delay, is_heard_first) in enumerate(echoes):
        bus.send()
        messages = due.setdefault(time + delay, [])
        messages.insert(0 if is_heard_first else len(messages), bus.sent[-1])
        assert not bus.hear(*due.pop(time, []))


@given(st.lists(st.booleans(), max_size=300))
def test_own_commands_may_be_lost(are_lost):
    bus = CommandBus()
    for is_lost in are_lost:
        bus.send()
        assert not bus.hear(*[] if is_lost else bus.sent[-1:])


def test_one_command_more_is_found_where_the_newest_is_the_gates_own(bus):
    other = command(bus.time, np.zeros(7))
    bus.send()
    assert bus.hear(other, bus.sent[-1])
    # It is over.
    bus.send()
    assert not bus.hear(bus.sent[-1])


@pytest.mark.parametrize("age", [1, 2, 50, 127])
def test_a_repeated_command_of_the_gate_is_found(bus, age):
    bus.send()
    assert bus.hear(bus.sent[-age], bus.sent[-1])
    bus.send()
    assert bus.hear(bus.sent[-1], bus.sent[-age])
    assert bus.hear(bus.sent[-age])


def test_another_program_is_found_among_lost_and_late_commands(bus):
    for _ in range(30):
        bus.send()
        bus.hear()
    found = []
    for i in range(20):
        bus.send()
        found.append(bus.hear(*bus.sent[-2 : -1 if i % 5 else -2], *bus.sent[-2:-1]))
    # As many as four missing commands hide as many others.
    assert True in found[:8]


def test_a_missing_command_hides_no_other_later_than_20_ms(bus):
    bus.send()
    bus.hear()
    bus.send()
    bus.hear(bus.sent[-1])
    for _ in range(25):
        bus.send()
        bus.hear(bus.sent[-1])
    bus.send()
    assert bus.hear(command(bus.time, np.zeros(7)), bus.sent[-1])


# The system --------------------------------------------------------------------------


def fixed(gate, context, *, torque=5.0, wall_time=NOW, go=0.0, message=None):
    message = status(wall_time) if message is None else message
    gate.GetInputPort("torque").FixValue(context, np.full(7, torque))
    gate.GetInputPort("status").FixValue(context, AbstractValue.Make(message.encode()))
    gate.GetInputPort("wall_time").FixValue(context, [wall_time])
    gate.GetInputPort("go").FixValue(context, [go])


def show(gate, context, name):
    return gate.GetOutputPort(name).Eval(context)


@pytest.mark.parametrize("caching", [True, False])
def test_the_system_steps_the_gate_and_shows_it(caching):
    sent = []
    gate = TorqueGate(
        AT_ONCE,
        initial=np.full(7, 0.3),
        limits=LIMITS,
        send=lambda torque, stamp: sent.append((torque.copy(), stamp)),
    )
    simulator = Simulator(gate)
    context = simulator.get_mutable_context()
    if not caching:
        context.DisableCaching()
    fixed(gate, context, message=lcmt_panda_status())
    assert_array_equal(show(gate, context, "state"), [0.3] * 7 + [0.0] * 7)
    assert show(gate, context, "age") == np.inf
    expected = initial_gate()
    for i in range(8):
        wall_time = NOW + 1e-3 * i
        fixed(gate, context, wall_time=wall_time, go=float(i > 2))
        simulator.AdvanceTo(1e-3 * i + 5e-4)
        inputs = GateInputs(
            command=lcmt_panda_command(),
            command_count=0.0,
            reading=read_status(status(wall_time)),
            torque=np.full(7, 5.0),
            wall_time=wall_time,
            go=float(i > 2),
        )
        expected = gate_step(AT_ONCE, expected, inputs, limits=LIMITS)
        clone = context.Clone()
        for each in (context, clone):
            assert_array_equal(show(gate, each, "torque_sent"), expected.torque)
            assert show(gate, each, "mode") == expected.mode
    torques = [torque[0] for torque, _ in sent]
    assert torques == pytest.approx([0.9, 1.8, 2.7, 3.6], abs=1e-3)
    assert sent[0][1] == NOW + 3e-3
    assert expected.mode is GateMode.OPEN
    measured = read_status(status(wall_time)).state
    assert_array_equal(show(gate, context, "state"), measured)
    assert_array_equal(show(gate, context, "torque_external"), [-0.1] * 7)
    # A broken message is not seen: the last good one is.
    fixed(gate, context, message=status(NOW + 1, "nan", joint_position=[9.0] * 7))
    assert_array_equal(show(gate, context, "state"), measured)


def test_a_gate_that_sends_nowhere_steps_too():
    gate = TorqueGate(AT_ONCE, initial=np.zeros(7), limits=LIMITS)
    simulator = Simulator(gate)
    context = simulator.get_mutable_context()
    for i in range(4):
        message = status(NOW + 1e-3 * i)
        fixed(gate, context, message=message, wall_time=NOW + 1e-3 * i, go=float(i > 1))
        simulator.AdvanceTo(1e-3 * i + 5e-4)
    assert show(gate, context, "mode") == GateMode.OPEN


def test_the_torque_sent_feeds_nothing_through():
    gate = TorqueGate(AT_ONCE, initial=np.zeros(7), limits=LIMITS)
    index = gate.GetOutputPort("torque_sent").get_index()
    for i in range(gate.num_input_ports()):
        assert not gate.HasDirectFeedthrough(i, index)
    seen = gate.GetOutputPort("state").get_index()
    assert gate.HasDirectFeedthrough(gate.GetInputPort("status").get_index(), seen)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"max_rate": 2000.0}, "max_rate is 2000.0; .* at most 1000"),
        ({"max_torque": [100.0] * 7}, r"max_torque\[0\] is 100.0; .* at most 87"),
        ({"expiry": 1.0}, "expiry is 1.0; .* at most 0.1"),
    ],
)
def test_settings_outside_the_limits_of_a_panda_are_refused(values, message):
    with pytest.raises(SystemsError, match=message):
        TorqueGate(GateConfig(**values), initial=np.zeros(7), limits=LIMITS)


def test_angles_of_another_arm_are_refused():
    with pytest.raises(SystemsError, match=r"shape \(6,\); expected \(7,\)"):
        TorqueGate(GateConfig(), initial=np.zeros(6), limits=LIMITS)
    with pytest.raises(SystemsError, match="NaN"):
        TorqueGate(GateConfig(), initial=np.full(7, np.nan), limits=LIMITS)
    six = type(LIMITS)(*(values[:6] for values in LIMITS))
    with pytest.raises(SystemsError, match=r"the limits of shape \(6,\)"):
        TorqueGate(GateConfig(), initial=np.zeros(7), limits=six)
