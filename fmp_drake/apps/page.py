"""Output to the console and the page, progress bars, and input from the page."""

import logging
import shlex
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common import use_native_cpp_logging
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from fmp_drake.apps.options import SceneOptions, arguments
from fmp_drake.apps.terminal import has_terminal, is_enter_pressed
from fmp_drake.errors import FmpError, RunError, SystemsError
from fmp_drake.primitives.data.files import write_json
from fmp_drake.station import Scenario
from fmp_drake.station.page import ShowStill
from fmp_drake.station.reach.feasibility import Feasibility
from fmp_drake.station.warm_up import LawCompilation
from fmp_drake.systems import PagePanel, hidden_meshcat

# Time between two polls of the buttons, s.
_POLL_PERIOD = 0.05


def make_console() -> Console:
    """Return a console that prints text as it is, and does not wrap it in a file or a pipe."""
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = 1000
    return console


@cache
def log_natively() -> None:
    """Let Drake write its warnings itself, without Python's logging.

    Threads of Meshcat also warn, for example of a wrong address. If Python collected garbage
    in such a thread, it would free objects of the main thread, and the process would crash.
    """
    logging.getLogger("drake").setLevel(logging.WARNING)
    use_native_cpp_logging()  # type: ignore[no-untyped-call]


def open_page(
    console: Console | None = None, *, title: str = "fmp_drake", host: str = "localhost"
) -> PagePanel:
    """Start Meshcat with a panel beside it and print the page's address.

    Parameters
    ----------
    console : Console, optional
        Console on which the address is printed.
    title : str
        Title of the panel and the tab.
    host : str
        Address of this machine at which the page is served. The printed address contains a
        token: with it the arm can be pulled and the sliders moved, without it only watched.

    Raises
    ------
    FmpError
        If the page cannot be served there.
    """
    log_natively()
    try:
        panel = PagePanel(hidden_meshcat(), host=host)
    except SystemsError as error:
        raise FmpError(
            f"the page cannot be served at {host}; give one of this machine's IPv4 addresses, "
            "0.0.0.0 for all of them, or localhost for this machine only."
        ) from error
    panel.show(title=title)
    if console is not None:
        console.print(f"watch it at {panel.url}")
    return panel


def show_preparation(panel: PagePanel, scenario: Scenario | None) -> None:
    """Show learning and compilation, with a scenario at rest.

    It is None for an arm that is not simulated, whose pose is not known yet.
    """
    panel.show(
        mode="getting ready",
        level="idle",
        detail="a few seconds; up to half a minute the first time on a machine",
        progress=0.1,
    )
    if scenario is not None:
        ShowStill(scenario, panel.meshcat)


def wait_for_law(
    console: Console, panel: PagePanel | None, law: LawCompilation
) -> None:
    """Wait until the control law is compiled, and show the progress."""
    text = "compiling the control law, once per machine"
    with console.status(text):
        for fraction in law.progress():
            if panel is not None:
                panel.show(detail=text, progress=fraction)


def say(console: Console, panel: PagePanel | None, text: str) -> None:
    """Print a message in the terminal, and show it on the page."""
    console.print(text)
    if panel is not None:
        panel.say(text)


def is_watched(panel: PagePanel | None) -> bool:
    """Return whether the page is open in a browser, which may be reloading it."""
    return panel is not None and panel.is_open()


@contextmanager
def ended_page(panel: PagePanel | None) -> Iterator[None]:
    """Show on the page, at the end of a block, that the program has ended, and why."""
    if panel is None:
        yield
        return
    try:
        yield
    except FmpError as error:
        panel.show(mode="refused", level="bad", detail=str(error))
        raise
    except KeyboardInterrupt:
        panel.show(mode="stopped", level="idle", detail="")
        raise
    finally:
        panel.show(ended=True, progress=None, grab="")


def wait_for_click(panel: PagePanel, names: Mapping[str, str]) -> str | None:
    """Wait for a click on a button of the page, and return the name of the button.

    It returns None after Enter in the terminal; without a terminal, when the page is closed.

    Parameters
    ----------
    panel : PagePanel
    names : mapping from str to str
        Names of the buttons, with their hints.
    """
    panel.show(buttons={name: {"hint": hint} for name, hint in names.items()})
    for name in names:
        panel.meshcat.AddButton(name)
    try:
        while has_terminal() or is_watched(panel):
            if is_enter_pressed():
                return None
            for name in names:
                if panel.meshcat.GetButtonClicks(name):
                    return name
            time.sleep(_POLL_PERIOD)
        return None
    finally:
        for name in names:
            panel.meshcat.DeleteButton(name, strict=False)


def make_progress(console: Console) -> Progress:
    """Return a progress bar, which is not shown in a file or a pipe.

    It has no thread: if Python collected garbage there, it would free a Meshcat of the main
    thread, and the process would crash.
    """
    return Progress(
        console=console, disable=not console.is_terminal, auto_refresh=False
    )


def show_progress(
    console: Console, times: Iterable[float], *, until: float, label: str
) -> None:
    """Run a simulation to its end, with a progress bar, and report pauses.

    Parameters
    ----------
    console : Console
    times : iterable of float
        Simulated times from `advance`, s, which repeat in a pause.
    until : float
        Simulated time of the end, s.
    label : str
        Text before the bar.
    """
    with make_progress(console) as progress:
        bar = progress.add_task(label, total=until)
        last, was_paused = -1.0, False
        for now in times:
            is_paused = now == last
            if is_paused and not was_paused:
                console.print(
                    f"paused at {now:.1f} s: resume on the page; Ctrl-C ends the run"
                )
            last, was_paused = now, is_paused
            progress.update(bar, completed=now, total=max(until, now), refresh=True)


def print_table(console: Console, rows: Mapping[str, str]) -> None:
    """Print a table of names and texts."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, text in rows.items():
        table.add_row(Text(name, style="bold"), text)
    console.print(table)


def track_frames(console: Console, frames: Sequence[int]) -> Iterable[int]:
    """Iterate over the frames of a film, with a progress bar."""
    with make_progress(console) as progress:
        yield from progress.track(frames, description="rendering")


def write_metrics(
    console: Console, metrics: Mapping[str, object], path: Path | None
) -> None:
    """Write metrics to a file (.json), if one is given."""
    if path is not None:
        write_json(path, metrics, RunError)
        console.print(f"wrote {path}")


def make_folder(path: Path) -> None:
    """Create an output folder if it is missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        text = f"cannot write into {path}: it is a file; name a folder."
        raise FmpError(text) from None
    except OSError as error:
        raise FmpError(f"cannot write into {path}: {error.strerror}.") from None


def print_next(console: Console, *arguments: str) -> None:
    """Print the next command."""
    # A file with a leading dash would be taken for an option.
    words = [
        f"./{w}" if w.startswith("-") and Path(w).exists() else w for w in arguments
    ]
    line = shlex.join(["fmp-drake", *words])
    console.print(f"next: {line}", soft_wrap=True)


def advice(feasibility: Feasibility, scene: SceneOptions, *groups: Any) -> str:
    """Return the command that makes a skill feasible, with groups of options; or nothing."""
    changed = feasibility.suggestion
    if not changed:
        return ""
    others: dict[str, Any] = dict.fromkeys(changed)
    flags = arguments(replace(scene, **others), *groups)
    for name, value in changed.items():
        if name == "move_board" and scene.move_board is not None:
            value = np.add(value, scene.move_board)
        numbers = [f"{number:g}" for number in np.ravel(value)]
        flags += [f"--{name.replace('_', '-')}", *numbers]
    return f"Try: {shlex.join(['fmp-drake', 'wipe', *flags])}"
