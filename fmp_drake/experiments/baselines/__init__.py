"""Other movement primitives to compare FMP with."""

from fmp_drake.experiments.baselines.aligned_promp import AlignedProMP
from fmp_drake.experiments.baselines.periodic_dmp import PeriodicDMP
from fmp_drake.experiments.baselines.periodic_gp import PeriodicGP
from fmp_drake.experiments.baselines.promp import ProMP

__all__ = [
    "AlignedProMP",
    "PeriodicDMP",
    "PeriodicGP",
    "ProMP",
]
