"""The Panda, its eraser and a whiteboard, wired for simulation.

`LoadScenario` reads what is built, `MakeWipingStation` and `MakeTeachingStation`
build it; `CheckFeasibility` says before whether the arm can follow a skill on it. The
`Add...` functions add its parts to a diagram of your own.
"""

from fmp_drake.station.board_station import MakeBoardStation, MakeSkillStation
from fmp_drake.station.feasibility import CheckFeasibility, Feasibility
from fmp_drake.station.models.eraser import AddEraser
from fmp_drake.station.models.model_files import AddPandaWithEraser, models_dir
from fmp_drake.station.models.whiteboard import AddWhiteboard
from fmp_drake.station.panda_driver import (
    LcmPanda,
    LoadPanda,
    MakePandaDriver,
    ReplayPanda,
    SimulatedPanda,
)
from fmp_drake.station.parts.arm_controller import AddArmController
from fmp_drake.station.parts.board_ink import AddInk
from fmp_drake.station.parts.board_reach import FollowingBounds
from fmp_drake.station.parts.board_scene import (
    AddBoardScene,
    BoardScene,
)
from fmp_drake.station.parts.external_forces import AddExternalForces
from fmp_drake.station.parts.hands import MouseOnPage, SimulatedHand, TeachingHand
from fmp_drake.station.parts.joint_recording import EraserPath, PandaJoints
from fmp_drake.station.parts.mouse import AddMouseHand, AddMousePull
from fmp_drake.station.parts.page_scene import AddBodies, AddPage
from fmp_drake.station.parts.posture import SolvePosture
from fmp_drake.station.parts.stage import RenderLights, SetStage
from fmp_drake.station.scenario import (
    ListScenarios,
    LoadScenario,
    ParseScenario,
    Scenario,
)
from fmp_drake.station.scenario_parts import (
    BoardConfig,
    BoardError,
    BoardMotion,
    CameraConfig,
    Disturbance,
    EraserConfig,
    InkConfig,
    PressConfig,
    SensorConfig,
    ShowConfig,
)
from fmp_drake.station.skill_config import SkillConfig
from fmp_drake.station.teaching_station import (
    DemonstrationFromRecorder,
    MakeTeachingStation,
)
from fmp_drake.station.warm_up import WarmUp
from fmp_drake.station.wiping_station import MakeWipingStation

__all__ = [
    "AddArmController",
    "AddBoardScene",
    "AddBodies",
    "AddEraser",
    "AddExternalForces",
    "AddInk",
    "AddMouseHand",
    "AddMousePull",
    "AddPage",
    "AddPandaWithEraser",
    "AddWhiteboard",
    "BoardConfig",
    "BoardError",
    "BoardMotion",
    "BoardScene",
    "CameraConfig",
    "CheckFeasibility",
    "DemonstrationFromRecorder",
    "Disturbance",
    "EraserConfig",
    "EraserPath",
    "Feasibility",
    "FollowingBounds",
    "InkConfig",
    "LcmPanda",
    "ListScenarios",
    "LoadPanda",
    "LoadScenario",
    "MakeBoardStation",
    "MakePandaDriver",
    "MakeSkillStation",
    "MakeTeachingStation",
    "MakeWipingStation",
    "MouseOnPage",
    "PandaJoints",
    "ParseScenario",
    "PressConfig",
    "RenderLights",
    "ReplayPanda",
    "Scenario",
    "SensorConfig",
    "SetStage",
    "ShowConfig",
    "SimulatedHand",
    "SimulatedPanda",
    "SkillConfig",
    "SolvePosture",
    "TeachingHand",
    "WarmUp",
    "models_dir",
]
