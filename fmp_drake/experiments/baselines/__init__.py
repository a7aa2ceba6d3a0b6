"""Other movement primitives, which are compared with FMP."""

from fmp_drake.experiments.baselines.gaussian_processes import PeriodicGP
from fmp_drake.experiments.baselines.periodic_dmp import PeriodicDMP
from fmp_drake.experiments.baselines.promp import AlignedProMP, ProMP

__all__ = [
    "AlignedProMP",
    "PeriodicDMP",
    "PeriodicGP",
    "ProMP",
]
