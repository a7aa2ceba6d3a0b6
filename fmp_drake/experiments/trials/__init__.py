"""Randomised scenarios: drawn from distributions, checked, run and judged.

A `TrialSpec` has the distributions, `run_trials` runs the trials that a `TrialStore` does
not have yet, and `TrialsReport` of `fmp_drake.experiments.trials.trials_report` writes
the results.
"""

from fmp_drake.experiments.trials.running import run_trials
from fmp_drake.experiments.trials.spec import TrialSpec
from fmp_drake.experiments.trials.store import TrialStore

__all__ = ["TrialSpec", "TrialStore", "run_trials"]
