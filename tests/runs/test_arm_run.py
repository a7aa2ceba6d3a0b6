"""Facts about a skill on an arm behind LCM messages, in one process over `memq://`."""

import ctypes
import os
import signal

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcm

from fmp_drake.apps.arm_console import arm_in_words
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.runs import ArmRun, WipingRun
from fmp_drake.runs.arm_bench import ArmBench, NetworkFaults, Reaction
from fmp_drake.runs.real_time import WallClock, request_priority
from fmp_drake.station import LcmPanda, LoadScenario, models_dir
from fmp_drake.systems import GateConfig, GateMode, StatusFlag
from fmp_drake.systems.panda.arm_status import GateFault

NOW = 1.7e9


@pytest.fixture(scope="module")
def skill():
    path = models_dir() / "demonstrations" / "wiping.npz"
    skill = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4)
    return skill.fit(Demonstration.load(path))


class Loop:
    """A bench and a run on one bus, with a clock of the test's."""

    def __init__(
        self,
        skill,
        *,
        scenario="table_top",
        gate=None,
        press=False,
        meshcat=None,
        controls=False,
        **faults,
    ):
        self.lcm, self.skill = DrakeLcm("memq://"), skill
        self.scenario = LoadScenario(scenario)
        self.scenario.impedance.force_control.enabled = press
        self.scenario.show.controls = controls
        self.meshcat = meshcat
        self.config = LcmPanda(gate=GateConfig(**(gate or {})))
        self.ticks, self.sent = 0, []
        self.start_arm(**faults)
        self.start_controller()

    def start_arm(self, **faults):
        self.bench = ArmBench(self.scenario, self.lcm, faults=NetworkFaults(**faults))

    def start_controller(self):
        self.run = ArmRun(
            self.scenario, self.skill, self.config, lcm=self.lcm, meshcat=self.meshcat
        )

    def advance(self, milliseconds, *, arm=True, controller=True):
        for _ in range(milliseconds):
            wall_time = NOW + 1e-3 * self.ticks
            if arm:
                self.bench.step(wall_time)
            if controller and self.ticks % round(1e3 * self.run.period) == 0:
                self.run.step(wall_time)
                self.sent.append(self.run.output("torque_sent"))
            self.ticks += 1
        return self

    def begin(self):
        self.advance(20)
        self.run.go()
        return self.advance(320)

    def greatest_step(self):
        return np.max(np.abs(np.diff(self.sent, axis=0)))


def test_the_arm_moves_over_lcm_only_after_an_enable_request(skill):
    loop = Loop(skill)
    loop.advance(50)
    assert loop.run.mode is GateMode.WAITING
    assert not np.any(loop.sent)
    first = loop.run.output("measured_position")
    loop.run.go()
    loop.advance(1200)
    assert loop.run.mode is GateMode.OPEN
    assert not loop.run.stops
    assert np.linalg.norm(loop.run.output("measured_position") - first) > 0.02
    assert loop.run.metrics()["tracking_rms_m"] < 0.02
    assert loop.greatest_step() <= 0.9 + 1e-9
    assert loop.bench.torque_rate <= 900 + 1e-6


def test_an_arm_behind_lcm_stirs_in_free_space():
    shown = Demonstration.load(models_dir() / "demonstrations" / "stirring.npz")
    skill = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4).fit(shown)
    loop = Loop(skill, scenario="stir").begin().advance(1500)
    assert loop.run.mode is GateMode.OPEN
    assert not loop.run.stops
    first = loop.run.output("measured_pose")
    loop.advance(400)
    # It moves and leans, and follows both.
    pose = loop.run.output("measured_pose")
    assert np.linalg.norm(pose[4:] - first[4:]) > 0.01
    assert 2 * np.arccos(min(abs(pose[:4] @ first[:4]), 1.0)) > 0.05
    error = loop.run.output("tracking_error")
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.6
    assert np.linalg.norm(error[3:]) < 0.0015
    metrics = loop.run.metrics()
    # From the start on, where the tool was still upright.
    assert 0.1 < metrics["orientation_rms_deg"] < 5.0
    # The arm's side has no ink, and neither side a normal force.
    assert loop.bench.torque_rate <= 900 + 1e-6
    assert not {"cleaned_fraction", "normal_force_mean_n"} & loop.bench.metrics().keys()
    assert "normal_force_mean_n" not in metrics


def speed(loop):
    return np.max(np.abs(loop.bench.output("state")[7:]))


def assert_stopped_until_go(loop, fault):
    """The arm stands, no torque was broken, and it goes on when asked only."""
    run = loop.run
    assert run.mode is GateMode.STOPPED
    assert run.faults & fault
    assert speed(loop) < 0.02
    loop.advance(100)
    assert not np.any(loop.sent[-1])
    run.go()
    loop.advance(900)
    assert run.mode is GateMode.OPEN
    assert loop.greatest_step() <= 0.9 + 1e-9


def test_a_frozen_controller_leaves_the_arm_damped_until_it_is_enabled(skill):
    loop = Loop(skill).begin().advance(300)
    before = speed(loop)
    loop.advance(200, controller=False)
    assert loop.bench.reactions[Reaction.DAMPED] > 100
    assert speed(loop) < 0.2 * before
    loop.advance(500, controller=False)
    loop.advance(100)
    assert_stopped_until_go(loop, GateFault.GAP)


def test_a_silent_arm_gets_no_torque_until_it_is_enabled(skill):
    loop = Loop(skill).begin().advance(200)
    loop.advance(160, arm=False)
    assert not np.any(loop.sent[-1])
    damped = loop.bench.reactions[Reaction.DAMPED]
    loop.advance(500)
    assert loop.bench.reactions[Reaction.DAMPED] > damped + 450
    assert_stopped_until_go(loop, GateFault.STALE)


def test_restarted_controller_moves_the_arm_only_when_enabled(skill):
    loop = Loop(skill).begin().advance(300)
    assert np.any(loop.bench.commanded)
    before = speed(loop)
    loop.run = None
    loop.advance(200, controller=False)
    assert speed(loop) < 0.2 * before
    loop.start_controller()
    loop.sent = []
    loop.advance(100)
    assert loop.run.mode is GateMode.WAITING
    assert not np.any(loop.sent)
    loop.run.go()
    loop.advance(500)
    assert loop.run.mode is GateMode.OPEN
    assert loop.greatest_step() <= 0.9 + 1e-9
    assert loop.bench.torque_rate <= 900 + 1e-6


def test_restarted_arm_is_moved_only_when_enabled(skill):
    loop = Loop(skill).begin().advance(200)
    loop.bench = None
    loop.advance(150, arm=False)
    loop.start_arm()
    loop.advance(50)
    assert_stopped_until_go(loop, GateFault.STALE)
    assert loop.bench.torque_rate <= 900 + 1e-6


def test_force_loop_is_closed_over_the_external_torque(skill):
    loop = Loop(skill, press=True).begin().advance(1500)
    status = int(loop.run.output("status")[0])
    assert status & StatusFlag.FORCE_CONTROL
    force = loop.bench.output("normal_force")
    assert loop.run.output("normal_force") == pytest.approx(force, abs=0.5)
    assert force == pytest.approx(10.0, abs=3.0)


@pytest.mark.parametrize(("period", "rate"), [(0.001, 900.0), (0.002, 450.0)])
def test_rates_are_per_second_whatever_the_period(skill, period, rate):
    # The robot sees each step within one of its milliseconds: never more than 0.9 Nm.
    gate = {"period": period, "return_speed": 1.0}
    loop = Loop(skill, gate=gate).begin().advance(1000)
    assert loop.run.mode is GateMode.OPEN
    assert len(loop.sent) == loop.ticks / (1e3 * period)
    assert loop.greatest_step() == pytest.approx(0.9, abs=1e-3)
    assert loop.bench.torque_rate == pytest.approx(rate, rel=1e-3)
    metrics = loop.run.metrics()
    assert metrics["torque_rate_max_nm_per_s"] == pytest.approx(rate, rel=1e-3)
    assert metrics["tracking_rms_m"] < 0.02


def test_an_arm_has_the_metrics_and_events_of_a_simulated_run(skill):
    loop = Loop(skill).begin().advance(1200)
    loop.run.stop()
    loop.advance(100)
    metrics = loop.run.metrics()
    simulated = WipingRun(loop.scenario, skill).metrics()
    # Ink is the bench's; nothing measures the penetration; a go makes the target jump.
    others = loop.bench.metrics().keys() | {
        *("penetration_max_m", "desired_position_jump_max_m"),
        *("remap_count", "reactive_remap_count"),
    }
    assert simulated.keys() - others <= metrics.keys()
    assert "contact_fraction" in metrics
    assert 0 < metrics["torque_ratio_max"] < 1
    assert 0 < metrics["joint_speed_ratio_max"] < 1
    assert metrics["joint_limit_margin_min_rad"] > 0.1
    assert metrics["fault_fraction"] == 0
    assert [event.text for event in loop.run.events()] == [
        f"arm stopped at {loop.run.stops[0][0]:.1f} s: the operator pressed Enter (STOPPED)"
    ]


def test_lost_and_late_messages_break_no_limit_and_stop_nothing(skill):
    loop = Loop(skill, drop=0.05, jitter=0.005).begin().advance(1000)
    assert loop.run.mode is GateMode.OPEN
    assert not loop.run.stops
    assert loop.greatest_step() <= 0.9 + 1e-9
    assert 0.001 < loop.run.metrics()["status_age_99"] < 0.02
    assert loop.run.metrics()["tracking_rms_m"] < 0.02


@pytest.mark.parametrize(
    "faults", [{"corrupt": 0.05}, {"reorder": 0.05, "jitter": 0.005}]
)
def test_broken_or_reordered_messages_stop_the_arm(skill, faults):
    loop = Loop(skill)
    loop.begin()
    loop.bench.set_faults(NetworkFaults(**faults))
    loop.advance(400)
    assert loop.run.mode is GateMode.STOPPED
    assert not np.any(loop.sent[-1])
    assert loop.greatest_step() <= 0.9 + 1e-9
    assert loop.bench.torque_rate <= 900 + 1e-6


def test_a_dry_run_moves_nothing(skill):
    loop = Loop(skill, gate={"dry": True})
    first = loop.bench.output("state")
    loop.begin().advance(200)
    assert loop.run.mode is GateMode.OPEN
    assert np.any(loop.run.output("torque"))
    assert not np.any(loop.sent)
    np.testing.assert_allclose(loop.bench.output("state"), first, atol=1e-9)


# On a page ---------------------------------------------------------------------------


def test_a_page_shows_the_measured_arm_and_touches_nothing(skill):
    meshcat = Meshcat()
    shown = Loop(skill, meshcat=meshcat).begin().advance(200)
    bare = Loop(skill).begin().advance(200)
    np.testing.assert_array_equal(shown.sent, bare.sent)
    assert not meshcat.GetSliderNames()
    assert meshcat.HasPath("/drake/bodies/panda/panda_link7")
    assert arm_in_words(shown.run)["mode"] == "in the air"
    shown.run.stop()
    shown.advance(50)
    assert arm_in_words(shown.run)["detail"] == "the operator pressed Enter (STOPPED)"


def test_sliders_act_only_where_the_operator_wants_them(skill):
    meshcat = Meshcat()
    loop = Loop(skill, meshcat=meshcat, controls=True)

    def played():
        station, root = loop.run.station, loop.run.simulator.get_context()
        context = station.GetMyContextFromRoot(root)
        names = ("tempo", "desired_normal_force")
        return [station.GetInputPort(name).Eval(context)[0] for name in names]

    loop.begin()
    assert loop.run.mode is GateMode.RETURNING
    assert played() == [0.0, 0.0]
    loop.advance(200)
    assert played() == [1.0, 10.0]
    meshcat.SetSliderValue("tempo", 0.5)
    meshcat.SetSliderValue("press force (N)", 4.0)
    loop.advance(300)
    assert played() == [0.5, 4.0]
    loop.run.stop()
    loop.advance(40)
    assert played() == [0.0, 0.0]


# Before all other programs -----------------------------------------------------------


@pytest.fixture
def machine(monkeypatch):
    """Stand in for a machine; refuse what is put into its set."""
    refuses = set()

    def schedule(*_):
        if "SCHED_FIFO" in refuses:
            raise PermissionError(1, "Operation not permitted")

    class Library:
        @staticmethod
        def mlockall(_):
            ctypes.set_errno(12)
            return -1 if "locked memory" in refuses else 0

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: Library)
    return refuses


@pytest.mark.parametrize(
    "refused",
    [(), ("SCHED_FIFO",), ("locked memory",), ("SCHED_FIFO", "locked memory")],
)
def test_missing_permission_is_reported_with_advice(machine, refused):
    machine.update(refused)
    reasons = {"SCHED_FIFO": "not permitted", "locked memory": "Cannot allocate memory"}
    refusals = request_priority()
    assert len(refusals) == len(refused)
    for line, what in zip(refusals, refused, strict=True):
        assert line.startswith(f"no {what} (")
        assert reasons[what] in line
        assert "/etc/security/limits.conf" in line


def test_real_time_priority_needs_linux(monkeypatch):
    monkeypatch.delattr(os, "sched_setscheduler")
    assert request_priority() == ["SCHED_FIFO and memory locking need Linux"]


# In the time of a wall clock ---------------------------------------------------------


class Clock(WallClock):
    """A clock that a run may sleep on; the arm is stepped with it."""

    def __init__(self, loop):
        super().__init__()
        self.loop, self.time, self.steps = loop, NOW + 1e-3 * loop.ticks, []
        self.on_sleep = lambda: None

    def now(self):
        return self.time

    def sleep(self, seconds):
        assert 0 < seconds <= 0.001 + 1e-6
        self.time += seconds
        self.loop.bench.step(self.time)
        self.on_sleep()


class Broken(Exception):
    """What an operator raises here."""


@pytest.mark.parametrize("end", ["error", "SIGTERM", "SIGINT"])
def test_whatever_ends_a_run_torque_goes_to_zero_at_its_rate(skill, end):
    loop = Loop(skill).begin().advance(700)
    clock = Clock(loop)
    number = getattr(signal, end, None)

    def operator(_run):
        clock.steps.append(clock.time)
        if len(clock.steps) == 5:
            # Whoever is impatient presses Ctrl-C again while the torque goes to zero.
            clock.on_sleep = lambda: os.kill(os.getpid(), number or signal.SIGINT)
            if number is None:
                raise Broken
            os.kill(os.getpid(), number)

    assert np.max(np.abs(loop.sent[-1])) > 0.9
    damped = loop.bench.reactions[Reaction.DAMPED]
    with pytest.raises(Broken if number is None else KeyboardInterrupt):
        loop.run.play(1.0, operator, clock=clock)
    assert 5 <= len(clock.steps) < 8
    for _ in range(2):
        loop.bench.step(clock.time)
    assert not np.any(loop.bench.commanded)
    assert loop.bench.reactions[Reaction.DAMPED] > damped
    assert loop.bench.torque_rate <= 900 + 1e-6


def test_a_run_catches_up_at_most_ten_milliseconds(skill):
    loop = Loop(skill).advance(5)
    clock = Clock(loop)

    def operator(_run):
        clock.steps.append(clock.time)
        if len(clock.steps) == 3:
            clock.time += 1.0
        if len(clock.steps) == 10:
            clock.time += 0.008

    loop.run.play(1.05, operator, clock=clock)
    at_once = np.diff(clock.steps) < 1e-6
    assert 5 <= np.sum(at_once) <= 10
    assert loop.run.skipped == pytest.approx(0.999, abs=0.002)
    assert len(clock.steps) < 60


def test_the_force_is_compared_with_that_of_the_slider(skill):
    meshcat = Meshcat()
    loop = Loop(skill, meshcat=meshcat, controls=True).advance(50)
    meshcat.SetSliderValue("press force (N)", 3.0)
    loop.advance(500)
    loop.run.go()
    loop.advance(4000)
    assert loop.run.desired_force == 3
    metrics = loop.run.metrics()
    assert metrics["normal_force_mean_n"] == pytest.approx(3, abs=0.5)
    assert metrics["normal_force_wanted_fraction"] > 0.9
    assert metrics["normal_force_precise_fraction"] > 0.3
