"""Facts about the commands that speak a real arm's messages."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from fmp_drake.apps.arm_console import arm_config
from fmp_drake.apps.main import main
from fmp_drake.errors import StationError
from fmp_drake.station import LcmPanda

URL = "udpm://239.255.76.67:7667?ttl=0"
PREPARE = "ip link set lo up && ip route add 224.0.0.0/4 dev lo"
NAMESPACE = ["unshare", "-n", "sh", "-c"]


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


def has_namespaces():
    """Tell whether a network namespace with multicast can be made here."""
    if not (shutil.which("unshare") and shutil.which("ip")):
        return False
    made = subprocess.run([*NAMESPACE, PREPARE], capture_output=True, check=False)
    return made.returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not has_namespaces(), reason="no network namespace can be made")
def test_two_processes_wipe_over_multicast_and_a_kill_leaves_the_arm_damped(tmp_path):
    command = f'"{sys.executable}" -m fmp_drake.apps.main'
    script = f"""{PREPARE} || exit 9
    {command} arm --lcm '{URL}' --duration 90 --drop 0.01 --report arm.json &
    echo $!
    {command} wipe --headless --arm 'lcm:{URL}' --go --duration 60 --report wipe.json &
    echo $!; wait
    """
    with subprocess.Popen(
        [*NAMESPACE, script],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={
            **os.environ,
            "MPLBACKEND": "Agg",
            "DRAKE_ALLOW_NETWORK": "lcm:package_map",
        },
    ) as both:
        try:
            arm, wiper = (int(both.stdout.readline()) for _ in range(2))
            opened = any(line.strip() == "open" for line in both.stdout)
            assert opened
            for process, seconds in ((wiper, 3), (arm, 1)):
                time.sleep(seconds)
                os.kill(process, signal.SIGTERM)
            both.communicate(timeout=60)
        finally:
            if both.poll() is None:
                os.killpg(both.pid, signal.SIGKILL)
    wiped = json.loads((tmp_path / "wipe.json").read_text())
    bench = json.loads((tmp_path / "arm.json").read_text())
    assert wiped["open_seconds"] > 0
    assert bench["followed_ms"] > 0
    assert bench["reflex_ms"] == 0
    assert bench["greatest_step"] <= 1.0
    assert bench["greatest_speed"] < 0.05
