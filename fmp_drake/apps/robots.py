"""`fmp-drake robots`."""

from pathlib import Path

import click
import numpy as np
from pydrake.geometry import SceneGraph
from rich.table import Table
from rich.text import Text

from fmp_drake.apps.page import make_console, print_next
from fmp_drake.errors import FmpError, StationError
from fmp_drake.station.reach.board_reach import ArmClearance
from fmp_drake.station.reach.posture import FindLevelReach
from fmp_drake.station.robots.robot import ListRobots, LoadRobot, MakeRobotModel
from fmp_drake.station.robots.stability import CheckStability
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.interface.arm_model import ArmModel


@click.command()
@click.argument("files", nargs=-1)
def robots(files: tuple[str, ...]) -> None:
    """List the robots that come with the package, or those of YAML FILES."""
    console = make_console()
    table = Table(show_header=True, box=None, padding=(0, 2, 0, 0))
    for column in ("robot", "joints", "mass", "reach", ""):
        table.add_column(column, overflow="fold")
    problems = []
    for name in files or ListRobots():
        config = LoadRobot(name)
        # Pictures are read for a scene graph only.
        scene_graph = SceneGraph() if files else None
        robot = MakeRobotModel(config, scene_graph=scene_graph)
        try:
            ArmModel(robot.plant, robot.tip)
            CheckStability(robot, ImpedanceConfig())
            posture = np.array([config.posture])
            if files and (pair := ArmClearance(config).self_contact(posture)[1]):
                problems.append(
                    f"{pair} touch each other in the posture; choose another one, or list "
                    "them in contact_free if they cannot meet."
                )
        except FmpError as error:
            problems.append(str(error))
        context = robot.plant.CreateDefaultContext()
        mass = robot.plant.CalcTotalMass(context, [robot.arm])
        try:
            reach = f"{FindLevelReach(robot):.2f} m"
        except StationError as error:
            reach = "none"
            problems.append(str(error))
        table.add_row(
            Text(Path(name).stem, style="bold"),
            str(len(config.posture)),
            f"{mass:.1f} kg",
            reach,
            config.description,
        )
    console.print(table)
    console.print(
        "reach: greatest distance in front of the base at which the eraser can lie level on "
        "a table"
    )
    for message in problems:
        console.print(message, soft_wrap=True)
    if not problems:
        print_next(console, "wipe", "--robot", files[0] if files else "NAME")
