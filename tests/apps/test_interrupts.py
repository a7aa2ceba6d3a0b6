"""Facts about Ctrl-C and SIGTERM: one line, and the exit code of the signal."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from fmp_drake.apps import commands
from fmp_drake.apps.terminal import begin_command
from fmp_drake.station.models.model_files import models_dir

WIPING = models_dir() / "demonstrations" / "wiping.npz"
COMMANDS = {
    "wipe": ["wipe", "--duration", "60", "--report", "report.json"],
    "wipe headless": [
        *("wipe", "--headless", "--duration", "1.5", "--report", "report.json"),
        *("--plot", "plot.png", "--log", "log.npz"),
    ],
    "check": ["check", "--plot", "check.png", "--report", "check.json"],
    "learn": ["learn", str(WIPING), "--out", "skill.npz"],
    "inspect": ["inspect", str(WIPING), "--plot", "plot.png"],
    "teach": ["teach"],
    "record": ["record", "--duration", "5", "--out", "demo.npz"],
    "worlds": [
        *("worlds", "default", "--count", "1", "--duration", "1", "--jobs", "1"),
        *("--out", "out", "--markdown", "report.md"),
    ],
    "reproduce": ["reproduce", "--quick", "--out", "out"],
    "benchmark": ["benchmark", str(WIPING.parent), "--quick", "--out", "out"],
    "arm": ["arm", "--duration", "3", "--report", "report.json"],
    "arm guided": ["arm", "--task", "wiping", "--duration", "3"],
    "robots": ["robots"],
    "scenarios": ["scenarios"],
}


START = """
import atexit
from fmp_drake.apps.main import main
print("here", flush=True)
try:
    main()
finally:
    atexit.register(print, "over", flush=True)
"""


def start(folder, *arguments):
    """Start the command line in a group of processes, as a terminal does."""
    process = subprocess.Popen(
        [sys.executable, "-c", START, *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    # Interrupts cannot be caught while Python itself starts.
    assert process.stdout.readline() == "here\n"
    return process


def processor_seconds(group):
    """Return how long processes have used a processor, s: a busy machine is slower."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[2]) == group:
                ticks += sum(map(int, fields[11:13]))
    return ticks / os.sysconf("SC_CLK_TCK")


def signalled(process, number):
    """Send a signal after a random time of a processor; return that time, s.

    The instant differs from run to run on purpose, as does the signal of a test. Before
    0.3 s of a processor Python itself may be starting, which nobody can catch. The time is
    None where the command ended earlier.
    """
    delay, end = random.uniform(0.3, 4.0), time.monotonic() + 20.0
    while process.poll() is None and time.monotonic() < end:
        if processor_seconds(process.pid) > delay:
            break
        time.sleep(0.02)
    if process.poll() is not None:
        return None
    os.killpg(process.pid, number)
    return delay


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_signal_at_any_time_ends_in_one_line(name, tmp_path):
    number = random.choice([signal.SIGINT, signal.SIGTERM])
    process = start(tmp_path, *COMMANDS[name])
    delay = signalled(process, number)
    has_ended = delay is None
    output, errors = process.communicate(timeout=60)
    # Python itself takes a moment to end, in which a signal still ends it.
    if output.endswith("over\n"):
        has_ended = has_ended or process.returncode in (-number, 0)
    lines = [line for line in errors.splitlines() if line]
    assert "Traceback" not in errors, (number, delay, errors)
    assert has_ended or process.returncode == 128 + number, (number, delay, errors)
    assert has_ended or lines[-1] == "fmp-drake: stopped.", (number, delay, errors)
    assert len(lines) <= 2, (
        number,
        delay,
        errors,
    )  # The other one says that it compiles.
    assert_whole(tmp_path)
    assert not list(tmp_path.rglob(".*"))


def assert_whole(folder):
    """Check that each file under its own name can be read."""
    for path in folder.rglob("[!.]*.*"):
        if path.suffix == ".npz":
            with np.load(path) as file:
                assert all(file[name].size >= 0 for name in file.files)
        elif path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".png":
            assert matplotlib.image.imread(path).size
        else:
            assert path.stat().st_size


@pytest.mark.slow
@pytest.mark.parametrize("name", ["learn", "wipe headless", "worlds"])
def test_killed_command_leaves_whole_files_and_does_not_block_the_next(
    name, tmp_path, command, monkeypatch
):
    process = start(tmp_path, *COMMANDS[name])
    signalled(process, signal.SIGKILL)
    process.communicate(timeout=60)
    assert_whole(tmp_path)
    monkeypatch.chdir(tmp_path)
    again = command(*COMMANDS[name])
    assert again.code in (0, 1), again
    assert_whole(tmp_path)
    assert not list(tmp_path.rglob(".*.part*"))


EARLY = """
import os, signal
from fmp_drake.apps import terminal
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # This test may run under nohup.
with terminal.interrupts():
    os.kill(os.getpid(), signal.{name})
    print("went on")
"""


@pytest.mark.parametrize(
    ("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)]
)
def test_signal_before_the_command_begins_ends_the_process_at_once(name, code):
    done = subprocess.run(
        [sys.executable, "-c", EARLY.format(name=name)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr == "fmp-drake: stopped.\n"


@pytest.fixture
def run(monkeypatch, command):
    """The function that runs a function in place of the command."""

    def run(function):
        def main(**_):
            begin_command()
            function()

        monkeypatch.setattr(commands.app, "main", main)
        return command("wipe")

    return run


def test_sigterm_ends_like_ctrl_c_with_its_own_code(run):
    ended = []

    def work():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        finally:
            ended.append(True)

    result = run(work)
    assert (result.code, result.err) == (143, "fmp-drake: stopped.\n")
    assert ended


def test_end_of_the_terminal_is_ignored_where_the_parent_ignores_it(run):
    previous = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # As nohup does.
    try:
        result = run(lambda: os.kill(os.getpid(), signal.SIGHUP))
    finally:
        signal.signal(signal.SIGHUP, previous)
    assert (result.code, result.err) == (0, "")


def test_error_of_an_interrupted_compilation_is_an_interrupt(run):
    def work():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)
        except KeyboardInterrupt:
            raise RuntimeError("no compiled object yet") from None

    result = run(work)
    assert (result.code, result.err) == (130, "fmp-drake: stopped.\n")


def test_interrupt_that_a_destructor_swallows_is_repeated(run):
    class Mute:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.5)

    def work():
        Mute()
        for _ in range(500):
            time.sleep(0.01)
        pytest.fail("it went on")

    result = run(work)
    assert (result.code, result.err) == (130, "fmp-drake: stopped.\n")


def test_interrupt_is_not_repeated_after_the_end_of_the_command(run):
    class Mute:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)

    def work():
        Mute()

    result = run(work)
    assert (result.code, result.err) == (130, "fmp-drake: stopped.\n")
    time.sleep(0.3)  # Ends by KeyboardInterrupt if it is repeated.


def test_errors_without_a_signal_are_shown_and_handlers_restored(run):
    before = signal.getsignal(signal.SIGINT), sys.unraisablehook

    def work():
        assert signal.getsignal(signal.SIGINT) is not before[0]
        raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        run(work)
    assert (signal.getsignal(signal.SIGINT), sys.unraisablehook) == before
