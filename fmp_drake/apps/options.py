"""Options that several commands share."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

PATH = click.Path(path_type=Path)


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
            help="Seconds in a window: one or more periods [default: 6].",
        ),
        click.option(
            "--components",
            type=int,
            help="Gaussians in the mixture [default: 80].",
        ),
    ):
        command = option(command)
    return command
