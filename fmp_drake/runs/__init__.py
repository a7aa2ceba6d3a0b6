"""A wiping station with loggers, its metrics and its log file."""

from fmp_drake.runs.log import RunLog, Signal
from fmp_drake.runs.metrics import run_figures
from fmp_drake.runs.skills import (
    bundled_demonstrations,
    default_demonstration,
    learn_skill,
    load_on_board,
    scenario_skill,
)
from fmp_drake.runs.wiping_run import WipingRun

__all__ = [
    "RunLog",
    "Signal",
    "WipingRun",
    "bundled_demonstrations",
    "default_demonstration",
    "learn_skill",
    "load_on_board",
    "run_figures",
    "scenario_skill",
]
