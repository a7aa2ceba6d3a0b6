"""A wiping station with loggers, its metrics, its log file and its saved state."""

from fmp_drake.runs.advancing import RunButtons, advance
from fmp_drake.runs.arm.arm_bench import ArmBench, NetworkFaults
from fmp_drake.runs.arm.arm_run import ArmRun
from fmp_drake.runs.arm.listening import check_arm, record_arm
from fmp_drake.runs.context_file import load_context, save_context
from fmp_drake.runs.log import RunLog, Signal
from fmp_drake.runs.run_event import RunEvent
from fmp_drake.runs.skills import (
    bundled_demonstrations,
    default_demonstration,
    learn_skill,
    load_on_board,
    scenario_skill,
)
from fmp_drake.runs.teaching.teach_page import TeachPage
from fmp_drake.runs.teaching.teaching_session import TeachingSession
from fmp_drake.runs.wiping_run import WipingRun

__all__ = [
    "ArmBench",
    "ArmRun",
    "NetworkFaults",
    "RunButtons",
    "RunEvent",
    "RunLog",
    "Signal",
    "TeachPage",
    "TeachingSession",
    "WipingRun",
    "advance",
    "bundled_demonstrations",
    "check_arm",
    "default_demonstration",
    "learn_skill",
    "load_context",
    "load_on_board",
    "record_arm",
    "save_context",
    "scenario_skill",
]
