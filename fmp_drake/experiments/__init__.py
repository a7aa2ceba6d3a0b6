"""Section V of the paper again: methods, held-out scores and the report.

`polishing`, `eight` and `wiping` rerun its experiments, at the sizes of a `Profile`, and
return what they found, each a `Finding`; `write_report` makes a page of them.
`fmp_drake.experiments.worlds` runs scenarios that are drawn at random.
`fmp_drake.experiments.baselines` has the movement primitives that FMP is compared with.
"""

from fmp_drake.experiments.eight import eight, learn_and_sample, table_one, table_rows
from fmp_drake.experiments.finding import Finding
from fmp_drake.experiments.held_out import evaluate, held_out_finding, score, summary
from fmp_drake.experiments.methods import (
    aligned_promp,
    compared,
    fmp,
    fmp_paper,
    promp_mult,
)
from fmp_drake.experiments.metrics import divergences, heatmap, kl_divergence
from fmp_drake.experiments.polishing import polishing
from fmp_drake.experiments.profile import FULL, QUICK, Profile
from fmp_drake.experiments.report import write_report
from fmp_drake.experiments.short_recordings import short_recordings
from fmp_drake.experiments.wiping import wiping

__all__ = [
    "FULL",
    "QUICK",
    "Finding",
    "Profile",
    "aligned_promp",
    "compared",
    "divergences",
    "eight",
    "evaluate",
    "fmp",
    "fmp_paper",
    "heatmap",
    "held_out_finding",
    "kl_divergence",
    "learn_and_sample",
    "polishing",
    "promp_mult",
    "score",
    "short_recordings",
    "summary",
    "table_one",
    "table_rows",
    "wiping",
    "write_report",
]
