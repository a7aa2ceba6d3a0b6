"""Processes that are forked from one that has imported the package, and is warmed up.

They start in milliseconds; a new Python that imports Drake takes two seconds of a core,
and another one to read what is compiled.
"""

import multiprocessing
import os
import sys
from multiprocessing.forkserver import ensure_running

import pytest

_context = multiprocessing.get_context("forkserver")
_PRELOADED = ["fmp_drake.apps.arm", "fmp_drake.apps.wipe", "warmed_up"]


def forkserver():
    """Return the context of these processes."""
    _context.set_forkserver_preload(_PRELOADED)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        ensure_running()
    return _context


class Forked(_context.Process):
    """A function of a module that runs in a process of its own, with the methods of Popen.

    Parameters
    ----------
    function : callable
    *arguments
    output : Path
        File of what it prints.
    folder : Path
        Where it runs.
    """

    def __init__(self, function, *arguments, output, folder):
        super().__init__(target=function, args=arguments)
        self._output, self._folder = output, folder
        output.touch()
        forkserver()
        self.start()

    def run(self):
        """Run the function, in the new process."""
        os.chdir(self._folder)
        opened = os.open(self._output, os.O_WRONLY | os.O_APPEND)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(opened, stream.fileno())
            stream.reconfigure(line_buffering=True)
        super().run()

    def poll(self):
        """Return the exit code, or None while the process runs."""
        return self.exitcode

    def wait(self, timeout=None):
        """Wait for the end of the process, and return its exit code."""
        self.join(timeout)
        return self.exitcode

    def send_signal(self, number):
        """Send a signal to the process."""
        os.kill(self.pid, number)
