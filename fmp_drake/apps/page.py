"""The Meshcat page, and the progress of a simulation."""

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import Simulator
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

_CAMERA = np.array([1.12, -0.60, 0.72])
_LOOK_AT = np.array([0.40, 0.0, 0.22])


def make_console() -> Console:
    """Return a console that does not wrap what goes to a file or a pipe."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=160)


def open_page(console: Console | None = None) -> Meshcat:
    """Start Meshcat, look at the board, and print the page's address."""
    meshcat = Meshcat(MeshcatParams(show_stats_plot=False))
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetProperty("/Background", "top_color", [0.86, 0.89, 0.93])
    meshcat.SetProperty("/Background", "bottom_color", [0.97, 0.97, 0.98])
    meshcat.SetCameraPose(_CAMERA, _LOOK_AT)
    if console is not None:
        console.print(f"watch it at {meshcat.web_url()}")
    return meshcat


def advance(
    simulator: Simulator, until: float, *, console: Console, label: str
) -> None:
    """Advance a simulation and show how far it is."""
    context = simulator.get_context()
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
        simulator.Initialize()
        while context.get_time() < until:
            simulator.AdvanceTo(min(context.get_time() + 0.25, until))
            progress.update(bar, completed=context.get_time())
