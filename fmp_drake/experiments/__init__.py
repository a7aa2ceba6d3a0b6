"""Reproduction of the paper's section V: experiments, held-out scores and a report.

`run_experiments` of `fmp_drake.experiments.reproduction` repeats the paper's experiments
with the sizes of a `Profile`. Each result is a `Finding`, and `write_report` writes a page
of findings. `fmp_drake.experiments.benchmark` compares methods on any recordings,
`fmp_drake.experiments.baselines` contains the other movement primitives, and
`fmp_drake.experiments.trials` runs randomised scenarios.
"""

from fmp_drake.experiments.report import FULL, QUICK, Profile, write_report

__all__ = ["FULL", "QUICK", "Profile", "write_report"]
