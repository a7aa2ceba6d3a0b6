"""Advancing a simulation that a page may pause and reset."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from math import floor
from typing import Self

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, System
from pydrake.systems.primitives import VectorLogSink

from fmp_drake.runs.signals import MILLISECOND
from fmp_drake.systems.viewer.page_panel import PagePanel

# Simulated milliseconds between two looks at the buttons, and real seconds between
# those of a pause.
_STRETCH = 100
_POLL = 0.02


class RunButtons:
    """The page's buttons to pause and to reset a run; a context manager.

    The buttons are in the page while the context is entered. A panel says what the next
    click on them does.

    Parameters
    ----------
    meshcat : Meshcat
    panel : PagePanel, optional

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> with RunButtons(Meshcat()) as buttons:
    ...     buttons.paused
    False
    """

    PAUSE = "pause / resume"
    RESET = "reset"

    def __init__(self, meshcat: Meshcat, panel: PagePanel | None = None) -> None:
        self._meshcat, self._panel = meshcat, panel
        self._resets = 0
        self._shown: bool | None = None

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
        self._show(False)

    @property
    def paused(self) -> bool:
        """Whether the pause button was clicked an odd number of times."""
        paused = self._meshcat.GetButtonClicks(self.PAUSE) % 2 == 1
        self._show(paused)
        return paused

    def _show(self, paused: bool) -> None:
        if self._panel is not None and paused != self._shown:
            label = "resume (P)" if paused else "pause (P)"
            self._panel.show(
                paused=paused,
                buttons={
                    self.PAUSE: {"label": label},
                    self.RESET: {"label": "reset (R)"},
                },
            )
            self._shown = paused

    def take_reset(self) -> bool:
        """Return whether the reset button was clicked since the last question."""
        clicks = self._meshcat.GetButtonClicks(self.RESET)
        clicked, self._resets = clicks != self._resets, clicks
        return clicked


def advance(
    simulator: Simulator,
    until: float,
    *,
    meshcat: Meshcat | None = None,
    panel: PagePanel | None = None,
    advance_to: Callable[[float], object] | None = None,
    on_reset: Callable[[], None] | None = None,
) -> Iterator[float]:
    """Advance a simulation in stretches of 0.1 s; yield its time after each.

    The stretches end at multiples of a millisecond, with a page and without, so that
    an integrator with error control takes the same steps.

    Parameters
    ----------
    simulator : Simulator
        Its system's default context is where a run begins.
    until : float
        When to end, s of simulated time.
    meshcat : Meshcat, optional
        Its page gets buttons to pause and to reset the run.
    panel : PagePanel, optional
        Of the page, to say whether the run is paused.
    advance_to : callable, optional
        Called with a time to advance to; the simulator's own by default.
    on_reset : callable, optional
        Called after a reset, for what is not in the context.
    """
    with ExitStack() as stack:
        buttons = None
        if meshcat is not None:
            buttons = stack.enter_context(RunButtons(meshcat, panel))
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
            done = floor(context.get_time() / (_STRETCH * MILLISECOND) + 1e-6)
            end = min(_STRETCH * (done + 1) * MILLISECOND, until)
            (advance_to or simulator.AdvanceTo)(end)
            yield context.get_time()


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
