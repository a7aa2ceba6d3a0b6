"""Other movement primitives to compare FMP with, all with the same methods."""

from fmp_drake.experiments.baselines.aligned_promp import AlignedProMP
from fmp_drake.experiments.baselines.alignment import AlignedPeriods, align_periods
from fmp_drake.experiments.baselines.fourier_model import FourierModel
from fmp_drake.experiments.baselines.periodic_dmp import PeriodicDMP
from fmp_drake.experiments.baselines.periodic_gp import PeriodicGP
from fmp_drake.experiments.baselines.promp import ProMP
from fmp_drake.experiments.baselines.replay import Replay
from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.experiments.baselines.von_mises_basis import VonMisesBasis
from fmp_drake.primitives.data.joining import joined_recordings
from fmp_drake.primitives.model.phase.period import autocorrelation, fundamental_period

__all__ = [
    "AlignedPeriods",
    "AlignedProMP",
    "FourierModel",
    "PeriodicDMP",
    "PeriodicGP",
    "ProMP",
    "Replay",
    "TrajectoryModel",
    "VonMisesBasis",
    "align_periods",
    "autocorrelation",
    "fundamental_period",
    "joined_recordings",
]
