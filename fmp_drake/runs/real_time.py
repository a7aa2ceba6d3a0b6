"""Clock, timing metrics and priority of a run in real time."""

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

# Longest delay after which missed ticks are replayed, s.
MAX_REPLAYED = 0.01
# Real-time priority of the threads, and flags to lock current and future memory.
_PRIORITY, _LOCK_ALL = 20, 3


@dataclass
class WallClock:
    """Wall clock, or a slower clock for both sides of a test bench.

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
        """Return the time, s, which is the same in all processes."""
        return self.pace * time.time()

    def sleep(self, seconds: float) -> None:
        """Wait for a duration of this clock, s."""
        time.sleep(seconds / self.pace)

    def ticks(
        self, period: float, duration: float, *, replayed: float = MAX_REPLAYED
    ) -> Iterator[tuple[float, float]]:
        """Yield the time of each tick and its delay, s.

        Parameters
        ----------
        period, duration : float
            s.
        replayed : float
            Delay up to which missed ticks are replayed, s; after a longer one they are
            skipped.
        """
        start = due = self.now()
        while (now := self.now()) < start + duration:
            if now < due:
                self.sleep(due - now)
                continue
            late = now - due
            due = (now if late > replayed else due) + period
            yield now, late


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Run a block without garbage collection; SIGTERM ends it as SIGINT does."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    # A command has a handler of its own, which raises the same.
    given = signal.getsignal(signal.SIGTERM)
    handler = interrupt if given is signal.SIG_DFL else given
    previous = signal.signal(signal.SIGTERM, handler)
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        signal.signal(signal.SIGTERM, previous)


@contextmanager
def ignored_signals() -> Iterator[None]:
    """Run a block that a second Ctrl-C or SIGTERM does not end."""
    previous = {
        number: signal.signal(number, signal.SIG_IGN)
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def age_metrics(name: str, ages: Sequence[float]) -> dict[str, float | None]:
    """Return median, 99th percentile and maximum of ages, s; None without ages.

    Examples
    --------
    >>> age_metrics("status_age", [0.001])["status_age_99"]
    0.001
    """
    levels = {"median": 0.5, "99": 0.99, "max": 1.0}
    values = np.quantile(ages, list(levels.values())).tolist() if ages else [None] * 3
    return {f"{name}_{level}": age for level, age in zip(levels, values, strict=True)}


def request_priority() -> list[str]:
    """Request real-time priority and locked memory; return the refusals.

    Threads that start later inherit both, such as those that receive messages. Call this
    function after the page is opened and before a bus is opened.

    Examples
    --------
    ::

        for refusal in request_priority():
            print(refusal)
    """
    refusals = []
    if not hasattr(os, "sched_setscheduler"):
        return ["SCHED_FIFO and memory locking need Linux"]
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except OSError as error:
        refusals.append(
            f"no SCHED_FIFO ({error.strerror}): other programs may delay a step. Allow "
            f"it with `rtprio {_PRIORITY}` in /etc/security/limits.conf."
        )
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_LOCK_ALL) != 0:
        reason = os.strerror(ctypes.get_errno())
        refusals.append(
            f"no locked memory ({reason}): a step may wait for the disk. Allow it with "
            "`memlock unlimited` in /etc/security/limits.conf."
        )
    return refusals
