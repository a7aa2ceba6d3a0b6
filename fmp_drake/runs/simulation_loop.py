"""Loop of a simulation, with buttons on a page to pause, reset and stop it."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from math import floor
from typing import Self

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, System
from pydrake.systems.primitives import VectorLogSink

from fmp_drake.runs.log import MILLISECOND
from fmp_drake.systems import PagePanel

# Simulated milliseconds between two polls of the buttons, and real seconds between two
# polls during a pause.
_STEP = 100
_POLL = 0.02
# Largest lag behind the clock for which a simulation catches up, s.
_MAX_LAG = 0.5


class RunButtons:
    """Context manager of a page's buttons to pause, reset and stop a run.

    The page has the buttons within the context. On a panel, their labels show the effect
    of the next click.

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
    STOP = "stop"

    def __init__(self, meshcat: Meshcat, panel: PagePanel | None = None) -> None:
        self._meshcat, self._panel = meshcat, panel
        self._clicks: dict[str, int] = {}
        self._shown: bool | None = None

    def __enter__(self) -> Self:
        """Add the buttons."""
        self._meshcat.AddButton(self.PAUSE, "KeyP")
        self._meshcat.AddButton(self.RESET, "KeyR")
        self._meshcat.AddButton(self.STOP, "")
        self._clicks = {self.RESET: 0, self.STOP: 0}
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the buttons."""
        for name in (self.PAUSE, self.RESET, self.STOP):
            self._meshcat.DeleteButton(name, strict=False)
        self._show(False)

    @property
    def paused(self) -> bool:
        """Return whether the pause button was clicked an odd number of times."""
        paused = self._meshcat.GetButtonClicks(self.PAUSE) % 2 == 1
        self._show(paused)
        return paused

    def _show(self, paused: bool) -> None:
        if self._panel is not None and paused != self._shown:
            label = "resume (P)" if paused else "pause (P)"
            self._panel.show(
                paused=paused,
                buttons={
                    self.PAUSE: {"label": label, "hint": "the key P does the same"},
                    self.RESET: {
                        "label": "reset (R)",
                        "hint": "discard the results and start again",
                    },
                    self.STOP: {"hint": "end the run and show its results"},
                },
            )
            self._shown = paused

    def was_clicked(self, name: str) -> bool:
        """Return whether `RESET` or `STOP` was clicked since the last call."""
        clicks = self._meshcat.GetButtonClicks(name)
        was_clicked, self._clicks[name] = clicks != self._clicks[name], clicks
        return was_clicked


def advance(
    simulator: Simulator,
    until: float,
    *,
    meshcat: Meshcat | None = None,
    panel: PagePanel | None = None,
    advance_to: Callable[[float], object] | None = None,
    on_reset: Callable[[], None] | None = None,
    keep_running: Callable[[], bool] | None = None,
) -> Iterator[float]:
    """Advance a simulation in intervals of 0.1 s; yield its time after each, and in pauses.

    With a page and without, the intervals end at multiples of a millisecond. An integrator
    with error control then takes the same steps.

    Parameters
    ----------
    simulator : Simulator
        A run starts from the default Context of its system.
    until : float
        Simulated time of the end, s.
    meshcat : Meshcat, optional
        Its page gets buttons to pause, reset and stop the run.
    panel : PagePanel, optional
        Panel of the page; it shows whether the run is paused.
    advance_to : callable, optional
        Called with the time to advance to; by default ``simulator.AdvanceTo``.
    on_reset : callable, optional
        Called after a reset, to restore state outside the Context.
    keep_running : callable, optional
        Returns whether the simulation continues after `until`; it does not by default.
    """
    with ExitStack() as stack:
        buttons = None
        if meshcat is not None:
            buttons = stack.enter_context(RunButtons(meshcat, panel))
        context = simulator.get_context()
        simulator.Initialize()
        # Drake does not leave out the time of the first events, which may compile.
        simulator.ResetStatistics()
        rate = simulator.get_target_realtime_rate()
        ahead = time.monotonic() * rate - context.get_time()
        while context.get_time() < until or (
            keep_running is not None and keep_running()
        ):
            if buttons is not None:
                if buttons.was_clicked(buttons.STOP):
                    return
                if buttons.was_clicked(buttons.RESET):
                    reset(simulator)
                    simulator.Initialize()
                    if on_reset is not None:
                        on_reset()
                if buttons.paused:
                    time.sleep(_POLL)
                    # Otherwise Drake would run faster to compensate for the pause.
                    simulator.ResetStatistics()
                    yield context.get_time()
                    continue
            # Nor does it compensate for a compilation or a machine that stood still.
            if (now := time.monotonic() * rate - context.get_time()) - ahead > _MAX_LAG:
                simulator.ResetStatistics()
                ahead = now
            count = floor(context.get_time() / (_STEP * MILLISECOND) + 1e-6)
            end = _STEP * (count + 1) * MILLISECOND
            if context.get_time() < until:
                end = min(end, until)
            (advance_to or simulator.AdvanceTo)(end)
            yield context.get_time()


def reset(simulator: Simulator) -> None:
    """Reset a simulation to the default Context, with empty logs.

    After an initialisation, the next run is identical to the first.
    """
    context = simulator.get_mutable_context()
    system = simulator.get_system()
    system.SetDefaultContext(context)
    context.SetTime(0.0)
    for log in _logs(system):
        log.FindMutableLog(context).Clear()


def _logs(system: System) -> list[VectorLogSink]:
    """Return the log sinks in a system and its subdiagrams."""
    if isinstance(system, Diagram):
        return [log for part in system.GetSystems() for log in _logs(part)]
    return [system] if isinstance(system, VectorLogSink) else []
