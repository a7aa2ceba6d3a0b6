"""The time of the wall clock, as well as a program of Python keeps it."""

import ctypes
import gc
import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

import numpy as np

# What is made up for after a pause, at most, s.
MOST_REPLAYED = 0.01
# Of threads that run before all others, and what may be locked: all that is and will be.
_PRIORITY, _LOCK_ALL = 20, 3


@dataclass
class WallClock:
    """The wall clock, or one that both sides of a test bench let run slower.

    Attributes
    ----------
    pace : float
        Seconds of this clock per second.

    Examples
    --------
    >>> 2 * WallClock(pace=0.5).now() < time.time() + 1
    True
    """

    pace: float = 1.0

    def now(self) -> float:
        """Return the time, s: two processes agree on it."""
        return self.pace * time.time()

    def sleep(self, seconds: float) -> None:
        """Wait for so many seconds of this clock."""
        time.sleep(seconds / self.pace)

    def ticks(self, period: float, duration: float) -> Iterator[tuple[float, float]]:
        """Yield the time at which each tick begins, and how late that is, s.

        What was missed is made up for as far as `MOST_REPLAYED`; a tick that is later
        than that begins a new count.

        Parameters
        ----------
        period, duration : float
            s.
        """
        began = due = self.now()
        while (now := self.now()) < began + duration:
            if now < due:
                self.sleep(due - now)
                continue
            late = now - due
            due = (now if late > MOST_REPLAYED else due) + period
            yield now, late


@contextmanager
def undisturbed() -> Iterator[None]:
    """Collect no garbage meanwhile, and let SIGTERM end a block as SIGINT does."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        signal.signal(signal.SIGTERM, previous)


def age_metrics(name: str, ages: Sequence[float]) -> dict[str, float | None]:
    """Return median, 99th percentile and maximum of ages, s; None where there is none.

    Examples
    --------
    >>> age_metrics("status_age", [0.001])["status_age_99"]
    0.001
    """
    kinds = {"median": 0.5, "99": 0.99, "max": 1.0}
    found = np.quantile(ages, list(kinds.values())).tolist() if ages else [None] * 3
    return {f"{name}_{kind}": age for kind, age in zip(kinds, found, strict=True)}


def take_precedence() -> list[str]:
    """Ask to run before all other programs and to stay in memory; say what was refused.

    Threads that are begun later do as well, such as those that receive messages: call it
    after what shows the page, and before what opens a bus.

    Examples
    --------
    ::

        for refused in take_precedence():
            print(refused)
    """
    refused = []
    if not hasattr(os, "sched_setscheduler"):
        return ["SCHED_FIFO and memory locking are Linux's only"]
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except OSError as error:
        refused.append(
            f"no SCHED_FIFO ({error.strerror}): other programs may delay a step. Allow "
            f"it with `rtprio {_PRIORITY}` in /etc/security/limits.conf."
        )
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_LOCK_ALL) != 0:
        reason = os.strerror(ctypes.get_errno())
        refused.append(
            f"no locked memory ({reason}): a step may wait for the disk. Allow it with "
            "`memlock unlimited` in /etc/security/limits.conf."
        )
    return refused
