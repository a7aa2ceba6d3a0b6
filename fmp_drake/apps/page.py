"""The Meshcat page, and the progress of a simulation."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Self

from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, System
from pydrake.systems.primitives import VectorLogSink
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

# Simulated seconds between two looks at the buttons, and real ones during a pause.
_STRETCH = 0.1
_POLL = 0.02


def make_console() -> Console:
    """Return a console that does not wrap what goes to a file or a pipe."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=160)


def open_page(console: Console | None = None) -> Meshcat:
    """Start Meshcat and print the page's address."""
    meshcat = Meshcat(MeshcatParams(show_stats_plot=False))
    if console is not None:
        console.print(f"watch it at {meshcat.web_url()}")
    return meshcat


class RunButtons:
    """The page's buttons to pause and to reset a run; a context manager.

    The buttons are in the page while the context is entered.

    Parameters
    ----------
    meshcat : Meshcat
    """

    PAUSE = "pause / resume"
    RESET = "reset"

    def __init__(self, meshcat: Meshcat) -> None:
        self._meshcat = meshcat
        self._resets = 0

    def __enter__(self) -> Self:
        """Add the buttons."""
        self._meshcat.AddButton(self.PAUSE, "KeyP")
        self._meshcat.AddButton(self.RESET, "KeyR")
        self._resets = 0
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the buttons."""
        for name in (self.PAUSE, self.RESET):
            self._meshcat.DeleteButton(name, strict=False)

    @property
    def paused(self) -> bool:
        """Whether the pause button was clicked an odd number of times."""
        return self._meshcat.GetButtonClicks(self.PAUSE) % 2 == 1

    def take_reset(self) -> bool:
        """Return whether the reset button was clicked since the last question."""
        clicks = self._meshcat.GetButtonClicks(self.RESET)
        clicked, self._resets = clicks != self._resets, clicks
        return clicked


def advance(
    simulator: Simulator,
    until: float,
    *,
    console: Console,
    label: str,
    meshcat: Meshcat | None = None,
    on_reset: Callable[[], None] | None = None,
) -> None:
    """Advance a simulation and show how far it is.

    Parameters
    ----------
    simulator : Simulator
        Its system's default context is where a run begins.
    until : float
        When to end, s of simulated time.
    console : Console
    label : str
        Before the progress bar.
    meshcat : Meshcat, optional
        Its page gets buttons to pause and to reset the run.
    on_reset : callable, optional
        Called after a reset, for what is not in the context.
    """
    with ExitStack() as stack:
        buttons = None
        if meshcat is not None:
            buttons = stack.enter_context(RunButtons(meshcat))
        progress = stack.enter_context(_progress(console))
        bar = progress.add_task(label, total=until)
        context = simulator.get_context()
        simulator.Initialize()
        waited = False
        while context.get_time() < until:
            if buttons is not None:
                if buttons.take_reset():
                    reset(simulator)
                    simulator.Initialize()
                    if on_reset is not None:
                        on_reset()
                if buttons.paused:
                    waited = True
                    time.sleep(_POLL)
                    continue
            if waited:
                # Drake would make up for the pause.
                simulator.ResetStatistics()
                waited = False
            simulator.AdvanceTo(min(context.get_time() + _STRETCH, until))
            progress.update(bar, completed=context.get_time())


def reset(simulator: Simulator) -> None:
    """Go back to the default context, with empty logs.

    After its initialisation the next run is the same as the first.
    """
    context = simulator.get_mutable_context()
    system = simulator.get_system()
    system.SetDefaultContext(context)
    context.SetTime(0.0)
    for log in _logs(system):
        log.FindMutableLog(context).Clear()


def _logs(system: System) -> list[VectorLogSink]:
    """Return the sinks in a system and in the diagrams within it."""
    if isinstance(system, Diagram):
        return [log for part in system.GetSystems() for log in _logs(part)]
    return [system] if isinstance(system, VectorLogSink) else []


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TimeRemainingColumn(),
        console=console,
        transient=not console.is_terminal,
        disable=not console.is_terminal,
    )
