"""`fmp-drake robots`."""

from pathlib import Path

import click
import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RotationMatrix
from rich.table import Table
from rich.text import Text

from fmp_drake.apps.page import make_console, print_next
from fmp_drake.errors import FmpError
from fmp_drake.station.reach.board_reach import ArmClearance
from fmp_drake.station.reach.posture import LEVEL_HEIGHT, FindLevelReach
from fmp_drake.station.robots.robot import (
    ListRobots,
    LoadRobot,
    MakeRobotModel,
    Robot,
)
from fmp_drake.station.robots.stability import CheckStability
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.interface.arm_model import ArmModel

# Turns of the tool on the flange to compare, rad, and a gain of reach that counts, m.
_TURNS, _LONGER = (np.pi, np.pi / 2, -np.pi / 2), 0.10


@click.command()
@click.argument("files", nargs=-1)
def robots(files: tuple[str, ...]) -> None:
    """List the robots that come with the package, or those of YAML FILES."""
    console = make_console()
    table = Table(show_header=True, box=None, padding=(0, 2, 0, 0))
    for column in ("robot", "joints", "mass", "reach", ""):
        table.add_column(column, overflow="fold")
    problems, remarks = [], []
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
        reach = FindLevelReach(robot)
        if not reach:
            problems.append(
                f"{Path(config.model).stem} cannot hold the eraser level anywhere from 0.2 to "
                f"2 m in front of it, {LEVEL_HEIGHT:g} m high; check its mount and posture."
            )
        remarks += _turned(robot, reach) if files else []
        table.add_row(
            Text(Path(name).stem, style="bold"),
            str(len(config.posture)),
            f"{mass:.1f} kg",
            f"{reach:.2f} m" if reach else "none",
            config.description,
        )
    console.print(table)
    console.print(
        "reach: greatest distance in front of the base at which the eraser can lie level on "
        "a table"
    )
    for message in problems + remarks:
        console.print(message, soft_wrap=True)
    if not problems:
        print_next(console, "wipe", "--robot", files[0] if files else "NAME")


def _turned(robot: Robot, reach: float) -> list[str]:
    """Return the mount with which an arm reaches much farther, where there is one."""
    reaches = [FindLevelReach(robot, turn=turn) for turn in _TURNS]
    best = int(np.argmax(reaches))
    if reaches[best] < reach + _LONGER:
        return []
    turn = RotationMatrix.MakeZRotation(_TURNS[best])
    R_FM = robot.config.mount.transform().rotation() @ turn
    rpy = (R_FM.ToRollPitchYaw().vector().round(4) + 0.0).tolist()
    text = (
        f"With mount.rpy {rpy}, the tool turned by {np.rad2deg(_TURNS[best]):.0f} degrees on "
        f"the flange, the reach would be {reaches[best]:.2f} m."
    )
    return [text]
