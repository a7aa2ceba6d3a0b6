"""Number of trials in an hour of one core."""

from dataclasses import replace

import numpy as np

from fmp_drake.experiments.trials import TrialSpec
from fmp_drake.experiments.trials.running import code_version, run_trial

TRIALS = 4
# Simulated seconds: from the first of them on the eraser is on the board.
SHORT, LONG = 3.0, 6.0
WANTED = 30.0


def cpu_seconds(lengths):
    """Return the seconds of the processor that each trial of each length takes."""
    spec, code = TrialSpec.load("default"), code_version()
    trials = [
        replace(spec.draw(seed=0, number=number), code=code) for number in range(TRIALS)
    ]
    took = np.empty((TRIALS, len(lengths)))
    # What is compiled and learned once for a process does not count.
    for trial in trials:
        run_trial(trial, duration=0.1, force=True)
    for i, trial in enumerate(trials):
        for j, seconds in enumerate(lengths):
            took[i, j] = run_trial(trial, duration=seconds, force=True).cpu_seconds
    return took


def test_trials_of_an_hour(benchmark, figures):
    took = benchmark.pedantic(cpu_seconds, args=((SHORT, LONG),), rounds=1)
    short, long = np.mean(took, axis=0)
    second = (long - short) / (LONG - SHORT)
    whole = short + (WANTED - SHORT) * second
    figures.section = (
        f"Trials: {TRIALS} bundled ones for {SHORT:g} and {LONG:g} s, and what follows "
        f"for {WANTED:g} s"
    )
    figures.add(f"checked, built, the first {SHORT:g} s", short, "s of a core")
    figures.add("a further second", second, "s of a core")
    figures.add(f"trials of {WANTED:g} s", 3600 / whole, "per hour and core", digits=3)
