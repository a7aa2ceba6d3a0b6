"""`fmp-drake record`."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

from pydrake.systems.analysis import Simulator

from fmp_drake.apps.arm_console import arm_config, guide_arm, recorded_text
from fmp_drake.apps.options import (
    ScenarioOptions,
    arm_option,
    command,
    host_option,
    option,
)
from fmp_drake.apps.page import make_console, open_page, print_next, show_progress
from fmp_drake.apps.terminal import noted_interrupts
from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number
from fmp_drake.primitives.data.demonstration import check_ending
from fmp_drake.primitives.data.files import check_writable
from fmp_drake.runs.simulation_loop import advance
from fmp_drake.station import MakeStation
from fmp_drake.station.external_forces import DemonstrationFromRecorder, SimulatedHand
from fmp_drake.systems.teaching.hand_motion import HandMotion, Task

# Time in which the hand settles on the board before the recording, s.
_SETTLING_TIME = 2.0
# Longest simulated recording, s.
_LONGEST = 36_000.0


@dataclass(frozen=True, kw_only=True)
class RecordOptions(ScenarioOptions):
    """Motion, scene, and file to write."""

    task: Task = option("wiping", "Movement of the simulated person.")
    duration: float = option(120.0, "Length of the recording, s.", above=0)
    minutes: float | None = option(
        None, "Former --duration, in minutes.", hidden=True, above=0
    )
    seed: int = option(0, "Seed of the simulated person.", least=0)
    out: Path = option(help="File (.npz or .csv) to write.")
    page: bool = option(False, "Show the recording on a page, in real time.")
    arm: str | None = arm_option(
        "Record an arm that a person guides, for at most --duration, instead of a simulation."
    )
    host: str = host_option()


@command(
    {
        "fmp-drake record --task eight --out eight.npz": "two minutes of the figure 8",
        "fmp-drake record --task stirring --scenario stir --out stir.npz": "with orientation",
    }
)
def record(to: RecordOptions) -> None:
    """Record a demonstration: a simulated person guides the arm over the board.

    With --arm a person guides a real arm, until Enter or Ctrl-C.
    """
    console = make_console()
    if to.minutes is not None:
        to = replace(to, duration=60 * to.minutes, minutes=None)
    check_writable(to.out)
    check_ending(to.out)
    if to.arm is not None:
        if to.page:
            raise RunError("there is no page with --arm; leave out --page.")
        simulated = RecordOptions(out=to.out)
        if (to.task, to.seed) != (simulated.task, simulated.seed):
            raise RunError(
                "--task and --seed are for the simulated person; leave them out with --arm."
            )
        arm = to.load(), arm_config(to.arm), to.duration
        with noted_interrupts() as is_ended:
            guide_arm(console, *arm, is_ended=is_ended).save(to.out)
        console.print(f"wrote {to.out}")
        return
    check_number(to.duration, "duration", most=_LONGEST, unit="s", error=RunError)
    end = _SETTLING_TIME + to.duration
    motion = HandMotion.make(to.task, duration=end + 1, seed=to.seed)
    check_ending(to.out, has_rotation="rx" in motion.channels)
    panel = open_page(console, title=to.scenario, host=to.host) if to.page else None
    meshcat = None if panel is None else panel.meshcat
    hand = SimulatedHand(motion)
    scenario = to.load()
    station = MakeStation(scenario, hand, meshcat=meshcat)
    simulator = Simulator(station)
    simulator.set_target_realtime_rate(1.0 if to.page else 0.0)
    start = time.perf_counter()
    times = advance(simulator, end)
    show_progress(console, times, until=end, label=f"guiding: {to.task}")
    demonstration = DemonstrationFromRecorder(
        station,
        simulator.get_context(),
        skip=_SETTLING_TIME,
        note=f"simulated: a modelled hand guides the simulated arm ({to.task}, seed "
        f"{to.seed}); not recorded on a robot",
    )
    demonstration.save(to.out)
    console.print(recorded_text(demonstration, has_board=scenario.has_board))
    console.print(f"wrote {to.out} in {time.perf_counter() - start:.0f} s")
    print_next(console, "learn", str(to.out), "--out", "skill.npz")
