"""Options that several commands share."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from fmp_drake.primitives import ReadingOptions

PATH = click.Path(path_type=Path)


host_option = click.option(
    "--host",
    default="localhost",
    show_default=True,
    help="Address that the page is served at. With another one than localhost (0.0.0.0 for "
    "all of this machine's) everybody in the network can watch, and pull the arm.",
)


real_time_option = click.option(
    "--real-time",
    is_flag=True,
    help="At an arm: run before all other programs (SCHED_FIFO, locked memory).",
)


def arm_option(text: str) -> Callable[..., Any]:
    """Return the option that names an arm which is not simulated here."""
    return click.option(
        "--arm",
        metavar="lcm[:URL]",
        help=f"{text} The arm that speaks LCM messages, or that of a YAML file.",
    )


def reading_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say what files do not: the command gets them as `reading`."""

    @wraps(command)
    def reads(
        *,
        columns: str,
        unit: str,
        sample_rate: float | None,
        topic: str,
        **others: Any,
    ) -> None:
        reading = ReadingOptions.parse(
            columns, unit=unit, rate=sample_rate, topic=topic
        )
        command(reading=reading, **others)

    for option in (
        click.option(
            "--topic", default="", help="Topic of a bag, or feature of a dataset."
        ),
        click.option(
            "--sample-rate",
            type=float,
            help="Samples per second (Hz) of a recording without times.",
        ),
        click.option("--unit", default="", help="Of positions: m, cm, mm ..."),
        click.option(
            "--columns",
            default="",
            metavar="NAME=COLUMN,...",
            help="Which columns are read, by name or number: time=stamp [ms],x=2,y=3.",
        ),
    ):
        reads = option(reads)
    return reads


def skill_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say how a skill is read and learned."""
    command = reading_options(command)
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
            help="Gaussians in the mixture [default: 80, fewer for short recordings].",
        ),
    ):
        command = option(command)
    return command


def scene_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say what is played, and where."""
    for option in (
        click.option(
            "--start",
            type=float,
            nargs=3,
            metavar="X Y Z",
            help="Where the eraser starts, m: in the frame of the board, z above it.",
        ),
        click.option(
            "--skill", "skill_file", type=PATH, help="Play this skill instead."
        ),
        click.option(
            "--demo",
            "demos",
            type=PATH,
            multiple=True,
            help="Learn from this file (again), not from the scenario's.",
        ),
        click.option(
            "--scenario",
            default="table_top",
            show_default=True,
            help="Name of a scenario (see `fmp-drake scenarios`), or a YAML file.",
        ),
    ):
        command = option(command)
    return command
