"""How many worlds an hour of one core runs."""

import numpy as np

from fmp_drake.experiments.worlds import Task, WorldSpec, run_world
from fmp_drake.experiments.worlds.world import code_version

WORLDS = 4
# Simulated seconds: from the first of them on the eraser is on the board.
SHORT, LONG = 3.0, 6.0
WANTED = 30.0


def cpu_seconds(lengths):
    """Return the seconds of the processor that each world of each length takes."""
    spec, code = WorldSpec.load("default"), code_version()
    worlds = [spec.draw(seed=0, number=number) for number in range(WORLDS)]
    took = np.empty((WORLDS, len(lengths)))
    # What is compiled and learned once for a process does not count.
    for world in worlds:
        run_world(Task(0, world.scenario, 0.1, force=True, code=code))
    for i, world in enumerate(worlds):
        for j, seconds in enumerate(lengths):
            task = Task(i, world.scenario, seconds, force=True, code=code)
            took[i, j] = run_world(task).cpu_seconds
    return took


def test_worlds_of_an_hour(benchmark, figures):
    took = benchmark.pedantic(cpu_seconds, args=((SHORT, LONG),), rounds=1)
    short, long = np.mean(took, axis=0)
    second = (long - short) / (LONG - SHORT)
    whole = short + (WANTED - SHORT) * second
    figures.section = (
        f"Worlds: {WORLDS} bundled ones for {SHORT:g} and {LONG:g} s, and what follows "
        f"for {WANTED:g} s"
    )
    figures.add(f"checked, built, the first {SHORT:g} s", short, "s of a core")
    figures.add("a further second", second, "s of a core")
    figures.add(f"worlds of {WANTED:g} s", 3600 / whole, "per hour and core", digits=3)
