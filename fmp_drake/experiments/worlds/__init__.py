"""Many worlds: scenarios drawn at random, checked in advance, run, and judged.

`WorldSpec` says what they are drawn from, `run_worlds` runs those that a `WorldStore`
does not have yet, and `WorldsReport` says what they show.
"""

from fmp_drake.experiments.worlds.distribution import Distribution
from fmp_drake.experiments.worlds.judging import faults
from fmp_drake.experiments.worlds.replaying import replay_world
from fmp_drake.experiments.worlds.report import WorldsReport
from fmp_drake.experiments.worlds.running import run_worlds
from fmp_drake.experiments.worlds.spec import WorldSpec
from fmp_drake.experiments.worlds.store import World, WorldStore
from fmp_drake.experiments.worlds.world import Outcome, Task, run_world

__all__ = [
    "Distribution",
    "Outcome",
    "Task",
    "World",
    "WorldSpec",
    "WorldStore",
    "WorldsReport",
    "faults",
    "replay_world",
    "run_world",
    "run_worlds",
]
