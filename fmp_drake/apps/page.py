"""The console, the Meshcat page, and the progress of a simulation."""

import logging
from collections.abc import Iterable, Sequence
from functools import cache

from pydrake.common import use_native_cpp_logging
from pydrake.geometry import Meshcat, MeshcatParams
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn, track

from fmp_drake.errors import FmpError
from fmp_drake.station.parts.page_scene import ShowStill
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.viewer.page_panel import PagePanel

LOCAL = "localhost"
"""Where a page is open for this machine only."""


def make_console() -> Console:
    """Return a console that does not wrap what goes to a file or a pipe."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=160)


@cache
def log_natively() -> None:
    """Let Drake write its warnings itself, without Python's logging.

    The threads of Meshcat warn, too, of a wrong address for example. In them Python may
    collect garbage, and what must not end in another thread than the first ends the process.
    """
    logging.getLogger("drake").setLevel(logging.WARNING)
    use_native_cpp_logging()  # type: ignore[no-untyped-call]


def open_page(
    console: Console | None = None, *, title: str = "fmp_drake", host: str = LOCAL
) -> PagePanel:
    """Start Meshcat with a panel beside it and print the page's address.

    Parameters
    ----------
    console : Console, optional
        Where to print it.
    title : str
        Of the panel and the tab.
    host : str
        At which address of this machine the page is served. Whoever reaches it can pull
        the arm and move the sliders.

    Raises
    ------
    FmpError
        Where the page cannot be served there.
    """
    log_natively()
    try:
        meshcat = Meshcat(MeshcatParams(host=host, show_stats_plot=False))
    except RuntimeError as error:
        raise FmpError(
            f"the page cannot be served at {host}; give one of this machine's addresses, "
            f"0.0.0.0 for all of them, or {LOCAL} for this machine only."
        ) from error
    panel = PagePanel(meshcat, host=host)
    panel.show(title=title)
    if console is not None:
        console.print(f"watch it at {panel.url}")
    return panel


def get_ready(panel: PagePanel, scenario: Scenario, *, visuals: str = "own") -> None:
    """Show a scenario at rest, while it is learned and compiled."""
    panel.show(
        mode="getting ready",
        level="idle",
        detail="a few seconds; half a minute the first time on a computer, to compile",
    )
    ShowStill(scenario, panel.meshcat, visuals=visuals)


def show_progress(
    console: Console, times: Iterable[float], *, until: float, label: str
) -> None:
    """Let a simulation run to its end, with a bar that shows how far it is.

    Parameters
    ----------
    console : Console
    times : iterable of float
        As `advance` yields them, s.
    until : float
        When it ends, s of simulated time.
    label : str
        Before the progress bar.
    """
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TimeRemainingColumn(),
        console=console,
        transient=not console.is_terminal,
        disable=not console.is_terminal,
    ) as progress:
        bar = progress.add_task(label, total=until)
        for time in times:
            progress.update(bar, completed=time)


def track_frames(console: Console, frames: Sequence[int]) -> Iterable[int]:
    """Go through the frames of a film, with a bar that shows how far it is rendered."""
    return track(
        frames,
        "rendering",
        console=console,
        transient=not console.is_terminal,
        disable=not console.is_terminal,
    )
