"""Other movement primitives, behind one small interface, to compare FMP with."""

from fmp_drake.experiments.baselines.aligned_promp import AlignedProMP
from fmp_drake.experiments.baselines.alignment import AlignedPeriods, align_periods
from fmp_drake.experiments.baselines.fourier_model import FourierModel
from fmp_drake.experiments.baselines.held_out import best_on_held_out
from fmp_drake.experiments.baselines.joining import joined_recordings
from fmp_drake.experiments.baselines.oscillators import Entrainment, entrain
from fmp_drake.experiments.baselines.period import autocorrelation, fundamental_period
from fmp_drake.experiments.baselines.periodic_dmp import PeriodicDMP
from fmp_drake.experiments.baselines.periodic_gp import PeriodicGP
from fmp_drake.experiments.baselines.promp import ProMP
from fmp_drake.experiments.baselines.trajectory_model import (
    Conditioned,
    TrajectoryModel,
)
from fmp_drake.experiments.baselines.von_mises_basis import VonMisesBasis

__all__ = [
    "AlignedPeriods",
    "AlignedProMP",
    "Conditioned",
    "Entrainment",
    "FourierModel",
    "PeriodicDMP",
    "PeriodicGP",
    "ProMP",
    "TrajectoryModel",
    "VonMisesBasis",
    "align_periods",
    "autocorrelation",
    "best_on_held_out",
    "entrain",
    "fundamental_period",
    "joined_recordings",
]
