"""Section V of the paper again: methods, held-out scores and the report.

`fmp_drake.experiments.baselines` has the movement primitives it compares with.
"""

from fmp_drake.experiments.finding import Finding
from fmp_drake.experiments.held_out import evaluate, held_out_finding, score, summary
from fmp_drake.experiments.methods import compared, fmp, fmp_paper, promp_mult
from fmp_drake.experiments.metrics import heatmap, kl_divergence
from fmp_drake.experiments.profile import FULL, QUICK, Profile
from fmp_drake.experiments.report import write_report

__all__ = [
    "FULL",
    "QUICK",
    "Finding",
    "Profile",
    "compared",
    "evaluate",
    "fmp",
    "fmp_paper",
    "heatmap",
    "held_out_finding",
    "kl_divergence",
    "promp_mult",
    "score",
    "summary",
    "write_report",
]
