"""A separate network for processes that use LCM."""

import json
import os
import shutil
import subprocess
import time

import pytest
from forked import Forked

from fmp_drake.apps.main import main

URL = "udpm://239.255.76.67:7667?ttl=0"
_PREPARE = "ip link set lo up && ip route add 224.0.0.0/4 dev lo && echo ready && cat"


class Network:
    """A network namespace in which commands of fmp-drake run; a context manager.

    Leaving it ends what still runs in it.

    Parameters
    ----------
    folder : Path
        Where they run; their output goes to files in it, and there is an arm.yaml.
    pace : float
        Of the clock of the arm's messages: a loaded machine may be slower than an arm.
    """

    def __init__(self, folder, *, pace=1.0):
        self.folder, self._started = folder, {}
        folder.mkdir(exist_ok=True)
        (folder / "arm.yaml").write_text(
            f'panda: !LcmPanda {{url: "{URL}", pace: {pace}}}'
        )

    def __enter__(self):
        # It ends with the end of its input.
        self._holder = subprocess.Popen(
            ["unshare", "-n", "sh", "-c", _PREPARE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._holder.stdout.readline() != "ready\n":
            self.__exit__()
            pytest.skip("no network namespace can be made here")
        return self

    def __exit__(self, *_):
        for process in self._started.values():
            if process.poll() is None:
                process.kill()
            process.wait()
        self._holder.communicate()

    def start(self, command, *options, name=None):
        """Start a command of fmp-drake; it writes NAME.log, and a report NAME.json."""
        name = name or command
        report = ["--report", f"{name}.json", "--arm", "arm.yaml"]
        self._started[name] = Forked(
            _run_in_namespace,
            self._holder.pid,
            [command, *report, *map(str, options)],
            output=self.folder / f"{name}.log",
            folder=self.folder,
        )
        return self._started[name]

    def wait_for(self, name, begin, *, patience=120.0):
        """Wait until a line of what a command says begins so."""
        until = time.monotonic() + patience
        path = self.folder / f"{name}.log"
        while True:
            code = self._started[name].poll()
            said = path.read_text()
            if any(line.startswith(begin) for line in said.splitlines()):
                return
            assert code is None, f"{name} ended with {code}: {said}"
            assert time.monotonic() < until, f"{name} did not say {begin!r}: {said}"
            time.sleep(0.05)

    def report(self, name):
        """Return what a command has measured."""
        return json.loads((self.folder / f"{name}.json").read_text())


def _run_in_namespace(pid, arguments):
    """Run `fmp-drake` in the network namespace of a process."""
    with open(f"/proc/{pid}/ns/net") as namespace:
        os.setns(namespace.fileno(), os.CLONE_NEWNET)
    os.environ["DRAKE_ALLOW_NETWORK"] = "lcm:package_map"
    main(arguments)


needs_network = pytest.mark.skipif(
    not (shutil.which("unshare") and shutil.which("ip")),
    reason="unshare or ip is not installed",
)
