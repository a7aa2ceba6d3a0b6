"""Facts about what is heard of an arm while nothing is sent: a check, a recording."""

import numpy as np
import pytest
from arm_bus import Bus
from drake import lcmt_panda_command, lcmt_panda_status

from fmp_drake.errors import RunError
from fmp_drake.runs import check_arm, record_arm
from fmp_drake.runs.arm_bench import NetworkFaults
from fmp_drake.station import LcmPanda, SimulatedHand
from fmp_drake.station.robots.robot import LoadRobot, MakeRobotModel
from fmp_drake.systems import HandMotion


def test_arm_that_may_be_enabled_passes_the_check(monkeypatch):
    bus = Bus(monkeypatch)
    results = check_arm(bus.scenario, LcmPanda(), lcm=bus.lcm)
    assert all(result.is_good for result in results), results
    text = " ".join(result.text for result in results)
    for word in ("Drake 1.", "1000 expected", "kMove", "from the start", "Nm"):
        assert word in text


class Odd:
    """An arm that rests at zero, and whose mode is a number that nobody knows."""

    def __init__(self, lcm):
        self.lcm, self.message = lcm, lcmt_panda_status()
        self.message.num_joints, self.message.robot_mode = 7, 17
        for name in self.message.__slots__:
            if name.startswith("joint_"):
                setattr(self.message, name, [0.0] * 7)

    def step(self, now):
        self.message.utime = round(1e6 * now)
        self.lcm.Publish("PANDA_STATUS", self.message.encode())


def test_unnamed_mode_is_reported_by_its_number(monkeypatch):
    bus = Bus(monkeypatch, speaks=False)
    bus.bench = Odd(bus.lcm)
    results = check_arm(bus.scenario, LcmPanda(), lcm=bus.lcm)
    wrong = [result.text for result in results if not result.is_good]
    assert "the robot's mode is 17; it must be kMove, controlled by torque" in wrong


def test_an_arm_is_in_a_reflex_after_an_invalid_command(monkeypatch):
    bus = Bus(monkeypatch)
    command = lcmt_panda_command()  # Of no joint.
    command.utime = round(1e6 * bus.seconds)
    bus.lcm.Publish("PANDA_COMMAND", command.encode())
    results = check_arm(bus.scenario, LcmPanda(), lcm=bus.lcm)
    wrong = [result.text for result in results if not result.is_good]
    assert wrong == [
        "the robot's mode is kReflex; it must be kMove, controlled by torque"
    ]
    assert bus.bench.metrics()["reflex_ms"] > 900


@pytest.mark.parametrize(
    ("bench", "scenario", "word"),
    [
        ({"speaks": False}, {}, "check that the robot's driver runs"),
        ({"faults": NetworkFaults(corrupt=0.2)}, {}, "broken"),
        (
            {"faults": NetworkFaults(jitter=0.1), "stride": 10},
            {},
            "it depends on clocks and network",
        ),
        (
            {"hand": SimulatedHand(HandMotion.make("eight", duration=2.0, seed=0))},
            {},
            "mode is kGuiding; it must be kMove",
        ),
        ({}, {"start": [0.2, 0.2, 0.1]}, "from the start"),
    ],
)
def test_faults_of_an_arm_are_reported(monkeypatch, bench, scenario, word):
    bus = Bus(monkeypatch, **bench)
    for name, value in scenario.items():
        setattr(bus.scenario, name, value)
    results = check_arm(bus.scenario, LcmPanda(), lcm=bus.lcm)
    assert any(word in result.text and not result.is_good for result in results), (
        results
    )


def test_a_person_who_guides_an_arm_is_recorded_by_its_kinematics(monkeypatch):
    hand = SimulatedHand(HandMotion.make("eight", duration=5.0, seed=0))
    bus = Bus(monkeypatch, hand=hand)
    states = []

    def until(seconds):
        states.append(bus.bench.output("state").copy())
        return seconds >= 3.0

    demonstration = record_arm(bus.scenario, LcmPanda(), lcm=bus.lcm, until=until)
    assert demonstration.frame == "board"
    assert demonstration.duration > 2.5
    np.testing.assert_allclose(np.diff(demonstration.time), 0.05)
    robot = MakeRobotModel(LoadRobot("panda"), bus.scenario.eraser)
    arm, tip = robot.plant, robot.tip
    context, X_BW = arm.CreateDefaultContext(), bus.scenario.board.pose().inverse()
    path = []
    for state in states[::5]:
        arm.SetPositionsAndVelocities(context, state)
        path.append(X_BW.multiply(tip.CalcPoseInWorld(context).translation()))
    off = np.linalg.norm(demonstration.values[:, None] - np.array(path)[None], axis=2)
    assert np.max(np.min(off, axis=1)) < 2e-3
    assert np.ptp(demonstration.values[:, 0]) > 0.02
    assert bus.bench.metrics()["followed_ms"] == 0


@pytest.mark.parametrize("faults", [{"corrupt": 0.3}, {"reorder": 0.2}])
def test_wrong_bits_and_reordered_statuses_are_not_recorded(monkeypatch, faults):
    shown = []
    for network in (None, NetworkFaults(**faults)):
        hand = SimulatedHand(HandMotion.make("eight", duration=5.0, seed=0))
        bus = Bus(monkeypatch, hand=hand, faults=network)
        shown.append(
            record_arm(bus.scenario, LcmPanda(), lcm=bus.lcm, until=lambda s: s >= 3.0)
        )
    clean, broken = shown
    assert broken.duration == pytest.approx(clean.duration, abs=0.11)
    count = min(len(clean.values), len(broken.values))
    np.testing.assert_allclose(
        broken.values[:count], clean.values[:count], atol=0.01, rtol=0
    )


def test_recording_reports_once_and_soon_that_no_status_arrives(monkeypatch):
    bus, times, remarks = Bus(monkeypatch, speaks=False), [], []

    def until(seconds):
        times.append(seconds)
        return seconds >= 10.0

    with pytest.raises(RunError, match="no status was received"):
        record_arm(
            *(bus.scenario, LcmPanda()),
            lcm=bus.lcm,
            until=until,
            remark=lambda text: remarks.append((times[-1], text)),
        )
    [(seconds, text)] = remarks
    assert seconds < 2.0
    assert text.startswith(
        "no status on PANDA_STATUS yet: check that the robot's driver"
    )
    remarks.clear()
    hand = SimulatedHand(HandMotion.make("eight", duration=4.0, seed=0))
    bus = Bus(monkeypatch, hand=hand)
    record_arm(
        *(bus.scenario, LcmPanda()),
        lcm=bus.lcm,
        until=lambda s: s >= 2.5,
        remark=remarks.append,
    )
    assert not remarks


def test_silent_or_resting_arm_has_no_recording(monkeypatch):
    for speaks, word in ((False, "no status was received"), (True, "nothing moved")):
        bus = Bus(monkeypatch, speaks=speaks)
        with pytest.raises(RunError, match=word):
            record_arm(bus.scenario, LcmPanda(), lcm=bus.lcm, until=lambda s: s >= 0.3)


def test_positions_over_a_curved_board_are_those_on_its_surface(monkeypatch):
    bus = Bus(monkeypatch, scenario="polish_pipe")
    results = check_arm(bus.scenario, LcmPanda(), lcm=bus.lcm)
    (start,) = [r for r in results if "from the start" in r.text]
    assert start.is_good, start.text
    hand = SimulatedHand(HandMotion.make("wiping", duration=6.0, seed=0))
    bus = Bus(monkeypatch, scenario="polish_pipe", hand=hand)
    shown = record_arm(
        bus.scenario, LcmPanda(), lcm=bus.lcm, until=lambda seconds: seconds >= 4.0
    )
    # Away from the crest of the pipe a height along z would be far below it.
    assert np.ptp(shown.values[:, 1]) > 0.05
    assert np.all(np.abs(shown.values[20:, 2]) < 0.012)
