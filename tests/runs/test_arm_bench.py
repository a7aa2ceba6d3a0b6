"""Facts about how a robot's side treats the torque that is sent to it."""

import numpy as np
import pytest
from drake import lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcm

from fmp_drake.runs import real_time
from fmp_drake.runs.arm_bench import (
    DAMPING,
    ArmBench,
    FirmwareState,
    Reaction,
    firmware_step,
)
from fmp_drake.station import Scenario

NOW = 1.7e9
ZERO = np.zeros(7)
# What 1 rad/s is damped by within a millisecond: the fastest joint changes by 1 Nm.
DAMPED = -np.array(DAMPING) / max(DAMPING)


def torque_command(torque, time):
    message = lcmt_panda_command()
    message.utime = round(1e6 * time)
    message.num_joint_torque, message.joint_torque = len(torque), list(torque)
    message.control_mode_expected = lcmt_panda_status.CONTROL_MODE_TORQUE
    return message


def stepped(command, state=None, *, velocity=ZERO):
    return firmware_step(
        state or FirmwareState(ZERO, ZERO),
        command=command,
        wall_time=NOW,
        velocity=velocity,
    )


def test_a_fresh_torque_is_followed_as_fast_as_its_rate_allows():
    state = stepped(torque_command(np.full(7, 5.0), NOW))
    assert state.reaction is Reaction.FOLLOWED
    np.testing.assert_allclose(state.limited, 1.0)
    # Through a low-pass filter of 30 Hz.
    blend = 1 - np.exp(-2 * np.pi * 30 * 0.001)
    np.testing.assert_allclose(state.torque, blend)
    later = stepped(torque_command(np.full(7, 5.0), NOW), state)
    np.testing.assert_allclose(later.limited, 2.0)
    np.testing.assert_allclose(later.torque, blend + blend * (2.0 - blend))


def test_without_a_fresh_torque_the_joints_are_damped():
    state = stepped(torque_command(np.full(7, 5.0), NOW - 0.06), velocity=np.ones(7))
    assert state.reaction is Reaction.DAMPED
    np.testing.assert_allclose(state.limited, DAMPED)


@pytest.mark.parametrize("wrong", ["NaN", "one NaN", "positions", "six joints"])
def test_a_wrong_command_causes_a_permanent_reflex(wrong):
    command = torque_command(np.full(7, np.nan if wrong == "NaN" else 1.0), NOW)
    if wrong == "one NaN":
        command.joint_torque = [1.0] * 6 + [np.nan]
    if wrong == "positions":
        command.control_mode_expected = 0
    if wrong == "six joints":
        command.joint_torque = [1.0] * 6
    state = stepped(command, velocity=np.ones(7))
    assert state.reaction is Reaction.REFLEX
    np.testing.assert_allclose(state.limited, DAMPED)
    later = stepped(torque_command(np.ones(7), NOW), state)
    assert later.reaction is Reaction.REFLEX


class SlowClock:
    """Time of a machine that takes a while for each step, and once is busy for longer."""

    def __init__(self):
        self.now = NOW

    def time(self):
        return self.now

    def sleep(self, seconds):
        self.now += max(seconds, 1e-6)


@pytest.mark.parametrize(
    ("busy", "cost"), [(0.03, 3e-4), (0.08, 3e-4), (0.0, 1.05e-3), (0.0, 2e-3)]
)
def test_a_late_step_has_the_time_of_its_state_and_follows_present_commands(
    busy, cost, monkeypatch
):
    clock, lcm = SlowClock(), DrakeLcm("memq://")
    monkeypatch.setattr(real_time, "time", clock)
    bench = ArmBench(Scenario(), lcm)
    stamps, reactions, step = [], [], bench.step

    def timed_step(now, *, late=0.0):
        if len(stamps) == 300:
            clock.now += busy
        message = torque_command(ZERO, clock.now - 0.001)
        lcm.Publish("PANDA_COMMAND", message.encode())
        lcm.HandleSubscriptions(0)
        before = dict(bench.reactions)
        step(now, late=late)
        clock.now += cost
        stamps.append(now - late)
        reactions.append(next(k for k, n in bench.reactions.items() if n != before[k]))

    monkeypatch.setattr(bench, "step", timed_step)
    bench.play(1.0)
    assert reactions[5:].count(Reaction.FOLLOWED) >= len(reactions) - 7
    assert min(bench.ages[5:]) > 0
    # Between two statuses as much time has passed as was simulated, but for skipped time.
    steps = np.diff(stamps)
    skipped = np.count_nonzero(np.abs(steps - 0.001) > 1e-5)
    assert skipped <= (0 if busy == 0.03 else 0.2 * len(steps))
