"""Stand-ins for worlds, for processes that import next to nothing."""

import os
import time
from pathlib import Path


def note(folder, name):
    """Write which process has begun a task, once for each time."""
    with (Path(folder) / "begun").open("a") as stream:
        stream.write(f"{name} {os.getpid()}\n")


def square(task):
    """Wait and return a square; end the process where the task says so."""
    folder, number, seconds, how = task
    note(folder, number)
    if how == "kill":
        os.kill(os.getpid(), 9)
    if how == "kill once":
        once = Path(folder) / f"killed_{number}"
        if not once.exists():
            once.touch()
            os.kill(os.getpid(), 9)
    if how == "raise":
        raise ValueError("no square")
    time.sleep(seconds)
    return number**2
