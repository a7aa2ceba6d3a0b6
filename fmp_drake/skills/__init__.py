"""Skills for a station: find, learn, place on a surface, inspect, describe."""

from fmp_drake.skills.joint_recording import EraserPath, RobotJoints
from fmp_drake.skills.learning import default_demonstration, learn_skill, scenario_skill
from fmp_drake.skills.loading import load_on_board

__all__ = [
    "EraserPath",
    "RobotJoints",
    "default_demonstration",
    "learn_skill",
    "load_on_board",
    "scenario_skill",
]
