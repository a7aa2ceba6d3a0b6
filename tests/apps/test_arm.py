"""Facts about the commands that exchange the messages of a real arm."""

import ctypes
import json
import os
import signal
import sys
import time
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import pytest
from arm_bus import Bus
from network import Network, needs_network

from fmp_drake.apps.arm_console import ARM_MODEL, arm_config
from fmp_drake.apps.main import main
from fmp_drake.apps.page import open_page
from fmp_drake.errors import RunError, StationError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    load_skill,
    save_skill,
)
from fmp_drake.skills import scenario_skill
from fmp_drake.station import LcmPanda, LoadScenario, SimulatedHand, models_dir
from fmp_drake.systems import HandMotion


def test_arm_names_a_bus_or_a_file(tmp_path):
    assert arm_config("lcm", dry=False) == LcmPanda()
    assert arm_config("lcm:memq://", dry=True).url == "memq://"
    assert arm_config("lcm:memq://", dry=True).gate.dry
    path = tmp_path / "arm.yaml"
    path.write_text("panda: !LcmPanda {gate: {expiry: 0.02}}")
    assert arm_config(str(path), dry=False).gate.expiry == 0.02
    path.write_text("panda: !SimulatedDriver {}")
    for wrong in (str(path), "ros"):
        with pytest.raises(StationError, match="expected"):
            arm_config(wrong, dry=False)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--dry"], "name it with --arm"),
        (["--go"], "name it with --arm"),
        (["--controls"], "name it with --arm"),
        (
            ["--arm", "lcm:memq://", "--html", "page.html"],
            "only --report can be written",
        ),
        (["--arm", "lcm:memq://", "--mean"], "--sample, --mean, --seed and"),
        (["--arm", "ros"], "expected lcm"),
        (["--arm", "lcm:memq://"], "no terminal in which to enable the arm"),
        (["--arm", "lcm:no bus", "--go"], "there is no bus 'no bus'; expected a URL"),
    ],
)
def test_impossible_options_of_an_arm_are_refused(
    options, message, capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(SystemExit) as ended:
        main(["wipe", "--headless", *options])
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def test_silent_arm_fails_the_check_and_cannot_be_recorded(
    capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["check", "--arm", "lcm:memq://", "--report", "check.json"])
    assert ended.value.code == 1
    assert "BAD   0 messages on PANDA_STATUS" in capsys.readouterr().out
    checked = json.loads((tmp_path / "check.json").read_text())
    assert [each["is_good"] for each in checked["arm"]] == [True, False]
    monkeypatch.setattr(sys, "stdin", None)
    for options in (
        ["record", "--duration", "1.3", "--out", "shown.npz"],
        ["teach", "--duration", "0.5"],
    ):
        with pytest.raises(SystemExit):
            main([*options, "--arm", "lcm:memq://"])
        printed = capsys.readouterr()
        assert "no status was received" in printed.err
        assert ("no status on PANDA_STATUS yet" in printed.out) == ("1.3" in options)
    refusals = {
        "leave out --page": ["--page"],
        "--task and --seed are for the simulated person": ["--task", "eight"],
    }
    for words, options in refusals.items():
        with pytest.raises(SystemExit):
            main(["record", "--out", "shown.npz", "--arm", "lcm:memq://", *options])
        assert words in capsys.readouterr().err


# On one bus with a simulated arm, in this process.


@pytest.fixture
def no_precedence(monkeypatch):
    """Machine that refuses real-time priority and locked memory."""

    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    load, library = ctypes.CDLL, SimpleNamespace(mlockall=lambda _: -1)
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(
        ctypes, "CDLL", lambda name, **how: load(name, **how) if name else library
    )


def guided(seconds):
    return SimulatedHand(HandMotion.make("eight", duration=seconds, seed=0))


@pytest.mark.usefixtures("no_precedence")
def test_guided_arm_is_simulated_for_its_duration(command):
    result = command(
        *("arm", "--arm", "lcm:memq://", "--task", "eight"),
        *("--duration", 0.05, "--real-time"),
    )
    assert result.code == 0, result
    assert "no SCHED_FIFO (Operation not permitted): " in result.out
    assert "no locked memory (" in result.out
    assert "followed_ms: 0" in result.out
    seconds = result.out.split("\nseconds: ")[1].split()[0]
    assert 0 < float(seconds) <= 0.06


def test_a_guided_arm_is_recorded_until_enter(command, outputs, monkeypatch, enter):
    bus, path = Bus(monkeypatch, hand=guided(5.0)), outputs / "shown.npz"
    bus.at[1500] = enter
    result = command("record", "--out", path, "--arm", "lcm:memq://")
    assert result.code == 0, result
    assert "nothing is sent: guide the arm now, pressing lightly; Enter" in result.out
    shown = Demonstration.load(path)
    assert f"recorded {shown.duration:.1f} s at 20 Hz: x " in result.out
    assert f"wrote {path}" in result.out
    assert 0.9 < shown.duration < 1.6
    assert bus.bench.metrics()["followed_ms"] == 0


def test_a_guided_arm_is_recorded_until_ctrl_c(command, outputs, monkeypatch):
    bus, path = Bus(monkeypatch, hand=guided(5.0)), outputs / "shown.npz"
    monkeypatch.setattr(sys, "stdin", None)
    bus.at[1500] = lambda: os.kill(os.getpid(), signal.SIGINT)
    result = command("record", "--out", path, "--arm", "lcm:memq://")
    assert (result.code, result.err) == (130, "fmp-drake: stopped.\n")
    assert f"wrote {path}" in result.out
    assert 0.9 < Demonstration.load(path).duration < 1.6


def test_recording_that_is_ended_and_cannot_be_saved_says_so(
    command, outputs, monkeypatch
):
    def fail(*_):
        raise RunError("the disk is full.")

    bus, path = Bus(monkeypatch, hand=guided(5.0)), outputs / "shown.npz"
    monkeypatch.setattr(sys, "stdin", None)
    monkeypatch.setattr(Demonstration, "save", fail)
    bus.at[1500] = lambda: os.kill(os.getpid(), signal.SIGINT)
    result = command("record", "--out", path, "--arm", "lcm:memq://")
    assert (result.code, result.err) == (130, "fmp-drake: the disk is full.\n")


def test_teaching_of_an_arm_ends_with_ctrl_c(command, outputs, monkeypatch):
    bus = Bus(monkeypatch, hand=guided(5.0))
    monkeypatch.setattr(sys, "stdin", None)
    bus.at[1500] = lambda: os.kill(os.getpid(), signal.SIGINT)
    files = ("--out", outputs / "shown.npz", "--skill", outputs / "skill.npz")
    result = command("teach", "--duration", 60, "--arm", "lcm:memq://", *files)
    assert (result.code, result.err.strip()) == (130, "fmp-drake: stopped.")


@pytest.mark.parametrize(
    ("press", "reason"),
    [(10, "no terminal in which to enable the arm"), (60, "friction holds the eraser")],
)
def test_skill_taught_to_an_arm_is_saved_and_played(
    refused, outputs, monkeypatch, tmp_path, press, reason
):
    scenario = tmp_path / "scene.yaml"
    scenario.write_text(f"press: {{force: {press}}}\nskill: {{window: 1.0}}\n")
    monkeypatch.setattr(sys, "stdin", None)
    Bus(monkeypatch, hand=guided(5.0))
    shown, skill = outputs / "shown.npz", outputs / "skill.npz"
    line = refused(
        *("teach", "--scenario", scenario, "--duration", 2.5, "--arm", "lcm:memq://"),
        *("--out", shown, "--skill", skill),
    )
    assert reason in line
    assert Demonstration.load(shown).duration > 2.0
    assert load_skill(skill).n_steps == 20


@pytest.mark.usefixtures("no_precedence")
def test_enter_enables_and_stops_an_arm_and_the_page_reports_it(
    command, outputs, monkeypatch, enter
):
    skill = outputs / "skill.npz"
    shown = Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")
    learned = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4)
    save_skill(learned.fit(shown), skill)
    panels, shown_fields = [], []

    def open_and_keep(*arguments, **options):
        panels.append(open_page(*arguments, **options))
        show = panels[-1].show
        monkeypatch.setattr(
            panels[-1],
            "show",
            lambda **fields: (shown_fields.append(fields), show(**fields)),
        )
        return panels[-1]

    monkeypatch.setattr("fmp_drake.apps.wipe.open_page", open_and_keep)
    bus, messages = Bus(monkeypatch), []
    bus.at = {150: enter, 750: enter}
    bus.at |= dict.fromkeys(
        (140, 740, 990),
        lambda: messages.append([panels[0].shown[k] for k in ("mode", "detail")]),
    )
    # Without a duration it waits for Enter, and ends with Ctrl-C.
    monkeypatch.setattr("fmp_drake.apps.wipe._DURATION", 0.1)
    bus.at[1000] = lambda: os.kill(os.getpid(), signal.SIGINT)
    result = command(
        *("wipe", "--arm", "lcm:memq://", "--skill", skill, "--force", "--real-time")
    )
    assert result.code == 130, result
    for line in ("watch it at http://", "no SCHED_FIFO (", "Enter enables the arm"):
        assert line in result.out
    modes = ("waiting\n", "open\n", "stopped (STOPPED)\n")
    assert list(map(result.out.count, modes)) == [1, 1, 1]
    enables = "Enter in the terminal enables the arm"
    assert messages == [
        ["waiting", enables],
        ["in the air", messages[1][1]],
        ["stopped", f"the operator pressed Enter (STOPPED); {enables} again"],
    ]
    # Before, the page was empty while the skill was made ready.
    modes = [fields["mode"] for fields in shown_fields if "mode" in fields]
    assert modes[0] == "getting ready"
    assert panels[0].shown["progress"] is None
    assert panels[0].shown["mode"] == "stopped"
    assert 0.1 < float(result.out.split("open seconds: ")[1].split()[0]) < 0.6
    assert result.out.split("stops: ")[1].splitlines()[0].endswith("'STOPPED')]")
    for _ in range(3):  # The last command of the ramp arrives.
        bus.now()
    assert not np.any(bus.bench.commanded)


@pytest.mark.slow
@needs_network
def test_after_kill_freeze_and_restart_an_arm_moves_only_when_enabled(tmp_path):
    skill, *_ = scenario_skill(LoadScenario("table_top"), model=ARM_MODEL)
    save_skill(skill, tmp_path / "skill.npz")
    plays = ("wipe", "--headless", "--force", "--go", "--skill", tmp_path / "skill.npz")
    # Each has its own network, because they wait at the same time.
    names = ("frozen controller", "frozen arm", "killed arm")
    with ExitStack() as stack:
        networks = [
            stack.enter_context(Network(tmp_path / name, pace=0.1)) for name in names
        ]
        arms = [each.start("arm", "--duration", "200") for each in networks]
        for each in networks:
            each.wait_for("arm", "a simulated arm")
        controllers = [each.start(*plays) for each in networks]
        for each in networks:
            each.wait_for("wipe", "open")
        for frozen in (controllers[0], arms[1]):
            frozen.send_signal(signal.SIGSTOP)
        arms[2].kill()
        time.sleep(1.0)
        for frozen in (controllers[0], arms[1]):
            frozen.send_signal(signal.SIGCONT)
        for each in networks:
            each.wait_for("wipe", "stopped")
        # A controller that was killed is followed by another one.
        controllers[0].kill()
        controllers[0] = networks[0].start(*plays, name="second")
        # A restarted arm is not moved by the earlier controller.
        arms[2] = networks[2].start("arm", "--duration", "200", name="again")
        networks[2].wait_for("again", "a simulated arm")
        networks[0].wait_for("second", "open")
        controllers[0].terminate()
        assert controllers[0].wait(30) == 143
        time.sleep(2.5)  # 0.25 s of the arm's clock, to be damped in.
        for each in (*controllers[1:], *arms):
            assert each.poll() is None
            each.terminate()
            assert each.wait(30) == 143
    observations = (
        ("arm", "second", "GAP"),
        ("arm", "wipe", "STALE"),
        ("again", "wipe", "STALE"),
    )
    for network, (arm, last, fault) in zip(networks, observations, strict=True):
        bench, wiped = network.report(arm), network.report(last)
        assert bench["reflex_ms"] == 0
        assert bench["torque_rate_max_nm_per_s"] <= 1000
        assert bench["joint_speed_end_rad_per_s"] < 0.05
        assert (bench["followed_ms"] > 0) == (arm == "arm")
        assert wiped["open_seconds"] > 0
        log = (network.folder / "wipe.log").read_text()
        assert log.count("open\n") == 1
        assert fault in log.split("\nstopped ")[1].splitlines()[0]
