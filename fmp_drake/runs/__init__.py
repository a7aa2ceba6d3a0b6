"""Runs of a station: metrics, events, logs, rehearsals, saved states, teaching, a real arm."""

from fmp_drake.runs.arm_listener import check_arm, record_arm
from fmp_drake.runs.arm_run import ArmRun
from fmp_drake.runs.context_file import load_context, save_context
from fmp_drake.runs.log import RunLog
from fmp_drake.runs.rehearsal import CheckWithRehearsal
from fmp_drake.runs.station_run import MakeRun, StationRun, WipingRun
from fmp_drake.runs.teaching_session import TeachingSession

__all__ = [
    "ArmRun",
    "CheckWithRehearsal",
    "MakeRun",
    "RunLog",
    "StationRun",
    "TeachingSession",
    "WipingRun",
    "check_arm",
    "load_context",
    "record_arm",
    "save_context",
]
