"""Stations: a robot with a tool at a board and its operator, wired as a diagram.

`LoadScenario` reads a scenario, and `MakeStation` builds its station: with a skill, or a
hand that guides the arm, for a simulated arm or a real one. `CheckFeasibility` predicts
whether the arm can follow a skill. The `Add...` functions add parts of a station to a diagram
of your own.
"""

from fmp_drake.station.arm_controller import AddArmController
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.external_forces import MouseOnPage, SimulatedHand
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.page import SetStage
from fmp_drake.station.reach.feasibility import CheckFeasibility
from fmp_drake.station.reach.posture import SolvePosture
from fmp_drake.station.robots.panda_lcm import LcmPanda
from fmp_drake.station.robots.robot import AddRobot, LoadRobot
from fmp_drake.station.scenario import (
    ListScenarios,
    LoadScenario,
    ParseScenario,
    Scenario,
)
from fmp_drake.station.station import MakeStation, MakeWipingStation
from fmp_drake.station.tasks.wiping import AddInk
from fmp_drake.station.warm_up import WarmUp

__all__ = [
    "AddArmController",
    "AddBoardScene",
    "AddInk",
    "AddRobot",
    "CheckFeasibility",
    "LcmPanda",
    "ListScenarios",
    "LoadRobot",
    "LoadScenario",
    "MakeStation",
    "MakeWipingStation",
    "MouseOnPage",
    "ParseScenario",
    "Scenario",
    "SetStage",
    "SimulatedHand",
    "SolvePosture",
    "WarmUp",
    "models_dir",
]
