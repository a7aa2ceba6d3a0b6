"""The terminal: its keyboard, and interrupts, which end a command with one line."""

import atexit
import os
import select
import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

MESSAGE = "fmp-drake: stopped."
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Time after which an interrupt that Python could not raise is repeated, s: long enough for
# the hook below to return on a busy machine.
_REPEAT_DELAY = 0.1
_received: list[int] = []
_has_begun = _is_noted = False


@contextmanager
def interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt at signals; before `begin_command`, end the process.

    They are SIGINT, SIGTERM and, unless it is ignored (nohup), SIGHUP of a closed terminal.
    Python only prints exceptions in some places, such as callbacks of the garbage
    collector. There an interrupt is raised again.
    """
    global _has_begun, _is_noted
    _received.clear()
    _has_begun = _is_noted = False
    if not _is_main():
        yield
        return
    hook, timers = sys.unraisablehook, list[threading.Timer]()

    def repeat(unraisable: "sys.UnraisableHookArgs") -> None:
        if _received:
            timers.append(threading.Timer(_REPEAT_DELAY, interrupt_main))
            timers[-1].start()
        else:
            hook(unraisable)

    previous = _handle(_interrupt)
    sys.unraisablehook = repeat
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for timer in timers:  # Python, while it ends, waits for them.
            timer.cancel()
        for number, handler in previous.items():
            signal.signal(number, handler)
        # Python, while it ends, would print the traceback of an interrupt and ignore it.
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_DFL)


@contextmanager
def noted_interrupts() -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether a signal has come, in place of an exception.

    A second signal raises it. The exit code is that of an interrupted command.
    """

    def note(number: int, _frame: FrameType | None) -> None:
        global _is_noted
        _received.append(number)
        _is_noted = len(_received) == 1
        if not _is_noted:
            raise KeyboardInterrupt

    previous = _handle(note) if _is_main() else {}
    try:
        yield lambda: bool(_received)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _handle(handler: Callable[[int, FrameType | None], None]) -> dict[int, Any]:
    """Set the handler of the signals; return the previous ones."""
    numbers = [
        number
        for number in _SIGNALS
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    ]
    return {number: signal.signal(number, handler) for number in numbers}


def is_noted() -> bool:
    """Return whether a signal was noted, and has interrupted nothing."""
    return _is_noted


def begin_command() -> None:
    """Declare that a command begins, which an interrupt ends by an exception."""
    global _has_begun
    _has_begun = True


def exit_code(error: BaseException | None) -> int | None:
    """Return the exit code of an interrupted command, None if it was not interrupted.

    After a signal every error is an interrupt, because compilation and compiled code turn
    interrupts into other errors. Further signals are ignored.
    """
    while isinstance(error, SystemError):
        error = error.__cause__ or error.__context__
    if not _received and not isinstance(error, KeyboardInterrupt):
        return None
    if _is_main():
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    return 128 + (_received or [signal.SIGINT])[0]


def _is_main() -> bool:
    return threading.current_thread() is threading.main_thread()


def _interrupt(number: int, _frame: FrameType | None) -> None:
    if not _has_begun:
        # Some of the modules that are now imported print errors and continue. Nothing has
        # to be cleaned up yet.
        with suppress(OSError):
            os.write(2, f"{MESSAGE}\n".encode())
        os._exit(128 + number)
    _received.append(number)
    raise KeyboardInterrupt


def has_terminal() -> bool:
    """Return whether there is a terminal on which Enter can be pressed."""
    return sys.stdin is not None and sys.stdin.isatty()


def is_enter_pressed() -> bool:
    """Return whether Enter was pressed since the last call."""
    if not (has_terminal() and select.select([sys.stdin], [], [], 0)[0]):
        return False
    sys.stdin.readline()
    return True
