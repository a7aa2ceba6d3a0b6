"""Facts about the commands that speak a real arm's messages."""

import json
import signal
import sys
import time

import pytest
from network import Network, needs_network

from fmp_drake.apps.arm_console import arm_config
from fmp_drake.apps.main import main
from fmp_drake.errors import StationError
from fmp_drake.station import LcmPanda


def test_arm_names_a_bus_or_a_file(tmp_path):
    assert arm_config("lcm", dry=False) == LcmPanda()
    assert arm_config("lcm:memq://", dry=True).url == "memq://"
    assert arm_config("lcm:memq://", dry=True).gate.dry
    path = tmp_path / "arm.yaml"
    path.write_text("panda: !LcmPanda {gate: {expiry: 0.02}}")
    assert arm_config(str(path), dry=False).gate.expiry == 0.02
    path.write_text("panda: !ReplayPanda {log: run.npz}")
    for wrong in (str(path), "ros"):
        with pytest.raises(StationError, match="expected"):
            arm_config(wrong, dry=False)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--no-torque"], "name it with --arm"),
        (["--go"], "name it with --arm"),
        (["--controls"], "name it with --arm"),
        (["--arm", "lcm:memq://", "--html", "page.html"], "only a --report"),
        (["--arm", "ros"], "expected lcm"),
        (["--arm", "lcm:memq://"], "nobody can say go"),
        (["--arm", "lcm:no bus", "--go"], "there is no bus 'no bus'"),
    ],
)
def test_what_cannot_be_done_with_an_arm_is_refused(
    options, message, capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(SystemExit) as ended:
        main(["wipe", "--headless", *options])
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def test_an_arm_that_says_nothing_is_not_good_and_cannot_be_recorded(
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
        ["record", "--minutes", "0.01", "--out", "shown.npz"],
        ["teach", "--duration", "0.5"],
    ):
        with pytest.raises(SystemExit):
            main([*options, "--arm", "lcm:memq://"])
        assert "nothing was heard" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["record", "--out", "shown.npz", "--page", "--arm", "lcm:memq://"])
    assert "leave out --page" in capsys.readouterr().err


@pytest.mark.slow
@needs_network
def test_killed_frozen_and_started_again_an_arm_moves_only_when_asked(tmp_path):
    with Network(tmp_path, pace=0.1) as network:
        arm = network.start("arm", "--duration", "200")
        network.wait_for("arm", "a simulated arm")
        # Of the controller: frozen, it stops, and does not go on; then it is killed.
        first = network.start("wipe", "--headless", "--go", name="first")
        network.wait_for("first", "open")
        first.send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        first.send_signal(signal.SIGCONT)
        network.wait_for("first", "stopped")
        first.kill()
        # Of the arm.
        second = network.start("wipe", "--headless", "--go", name="second")
        network.wait_for("second", "open")
        arm.send_signal(signal.SIGSTOP)
        network.wait_for("second", "stopped")
        arm.send_signal(signal.SIGCONT)
        second.terminate()
        assert second.wait(30) == 130
        time.sleep(4.0)  # 0.4 s of the arm's clock, to be damped in.
        arm.terminate()
        assert arm.wait(30) == 130
        # Killed and started again, it is not moved by the controller that it had.
        arm = network.start("arm", "--duration", "200", name="killed")
        network.wait_for("killed", "a simulated arm")
        third = network.start("wipe", "--headless", "--go", name="third")
        network.wait_for("third", "open")
        arm.kill()
        network.wait_for("third", "stopped")
        arm = network.start("arm", "--duration", "200", name="again")
        network.wait_for("again", "a simulated arm")
        time.sleep(2.0)
        assert third.poll() is None
        third.terminate()
        assert third.wait(30) == 130
        arm.terminate()
        assert arm.wait(30) == 130
    again = network.report("again")
    assert again["followed_ms"] == 0
    assert again["last_speed"] < 0.05
    assert (tmp_path / "third.log").read_text().count("open\n") == 1
    bench = network.report("arm")
    assert bench["followed_ms"] > 0
    assert bench["reflex_ms"] == 0
    assert bench["greatest_step"] <= 1.0
    assert bench["last_speed"] < 0.05
    assert network.report("second")["open_seconds"] > 0
    assert (tmp_path / "first.log").read_text().count("open\n") == 1
