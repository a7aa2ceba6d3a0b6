"""What the commands read: demonstrations and skills, laid onto the board."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.placement import Placement, fit_placement
from fmp_drake.station.model_files import models_dir
from fmp_drake.station.scenario import Scenario

PATH = click.Path(path_type=Path)

# What is left of the board around the eraser, m.
_MARGIN = 0.02


def skill_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say how a skill is learned."""
    for option in (
        click.option(
            "--transform",
            type=float,
            nargs=6,
            metavar="X Y Z ROLL PITCH YAW",
            help="Pose of the demonstration's frame in the board's (m, rad), instead of "
            "fitting its plane and laying it on the middle of the board.",
        ),
        click.option(
            "--stretch",
            type=float,
            default=1.0,
            show_default=True,
            help="Slow a demonstration down by this factor.",
        ),
        click.option(
            "--window",
            type=float,
            default=6.0,
            show_default=True,
            help="Seconds in a window: one or more periods.",
        ),
        click.option(
            "--components",
            type=int,
            default=80,
            show_default=True,
            help="Gaussians in the mixture.",
        ),
    ):
        command = option(command)
    return command


def default_demonstration(task: str = "wiping") -> Path:
    """Return a demonstration that comes with the package."""
    return models_dir() / "demonstrations" / f"{task}.npz"


def load_on_board(
    paths: Sequence[Path],
    *,
    scenario: Scenario,
    transform: Sequence[float] | None,
    stretch: float,
) -> tuple[list[Demonstration], list[str]]:
    """Load demonstrations in the frame of the board, and say what was done."""
    if not (np.isfinite(stretch) and stretch > 0):
        raise DemonstrationError(f"stretch is {stretch}; it must be positive.")
    usable = np.array(scenario.board.size) - scenario.eraser.footprint - _MARGIN
    demonstrations, remarks = [], []
    for path in paths:
        demonstration = Demonstration.load(path)
        if demonstration.n_channels != 3:
            raise DemonstrationError(
                f"{path} has {demonstration.n_channels} channels "
                f"({', '.join(demonstration.channels)}); the board needs x, y and z."
            )
        if stretch != 1.0:
            demonstration = replace(demonstration, time=demonstration.time * stretch)
        if transform is not None:
            placement = Placement(
                rotation=Rotation.from_euler("xyz", transform[3:]).as_matrix(),
                translation=np.array(transform[:3]),
            )
            demonstration = placement.apply(demonstration)
        elif demonstration.frame != "board":
            placement = fit_placement(demonstration, usable=usable)
            demonstration = placement.apply(demonstration)
            remarks.append(
                f"{path.name}: laid onto the middle of the board by its plane, at "
                f"{100 * placement.scale:.0f} % of its size; it touches the board "
                f"{100 * placement.touching:.0f} % of the time"
            )
        demonstrations.append(demonstration)
    return demonstrations, remarks


def learn_skill(
    demonstrations: Sequence[Demonstration],
    *,
    window: float,
    components: int,
    progress: Callable[[str], None] | None = None,
) -> FourierMovementPrimitive:
    """Learn a skill with the options of the command line."""
    rate = FourierMovementPrimitive().rate
    if not (np.isfinite(window) and window > 0):
        raise DemonstrationError(f"window is {window} s; it must be positive.")
    n_steps = max(8, round(window * rate))
    longest = max(d.duration for d in demonstrations)
    if longest < n_steps / rate:
        raise DemonstrationError(
            f"the longest demonstration lasts {longest:.3g} s, a window {window:g} s; at "
            "least two windows must fit. Record for longer, choose shorter windows "
            "(--window) that still hold a whole period, or slow the demonstration "
            "down (--stretch)."
        )
    return FourierMovementPrimitive(
        n_steps=n_steps,
        n_components=components,
        overlap=min(10, n_steps // 4),
    ).fit(list(demonstrations), progress=progress)
