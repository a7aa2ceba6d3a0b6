"""Section V of the paper again: experiments, held-out scores and a report.

`run_experiments` of `fmp_drake.experiments.reproduction` reruns the paper's experiments at
the sizes of a `Profile`; each result is a `Finding`, and `write_report` makes a page of
them. `fmp_drake.experiments.benchmark` compares methods on any recordings,
`fmp_drake.experiments.baselines` has the movement primitives that FMP is compared with, and
`fmp_drake.experiments.trials` runs randomised scenarios.
"""

from fmp_drake.experiments.report import FULL, QUICK, Profile, write_report

__all__ = ["FULL", "QUICK", "Profile", "write_report"]
