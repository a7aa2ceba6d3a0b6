"""Compared methods, and the windows that they learn from."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.experiments.baselines.aligned_promp import AlignedProMP
from fmp_drake.experiments.baselines.fourier_model import FourierModel
from fmp_drake.experiments.baselines.periodic_dmp import PeriodicDMP
from fmp_drake.experiments.baselines.periodic_gp import PeriodicGP
from fmp_drake.experiments.baselines.promp import ProMP
from fmp_drake.experiments.baselines.replay import Replay
from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.primitives import (
    PAPER_SETTINGS,
    Demonstration,
    FourierMovementPrimitive,
    Player,
)
from fmp_drake.primitives.data.windows import DEFAULT_RATE, as_windows

RATE = DEFAULT_RATE
N_STEPS = 120
FMP_STRIDE = FourierMovementPrimitive(n_steps=N_STEPS).window_stride
PAPER_STRIDE = int(PAPER_SETTINGS["stride"])

MULT = "ProMP-VM-Mult"
ALIGNED = "ProMP-VM, aligned"
FMP = "FMP"
FMP_PAPER = "FMP, paper's settings"
PHASE = "FMP, phase model"
MULT_OWN = f"{MULT}, own frequency, M = 80"
REPLAY = "replay"
GP, DMP = "periodic GP", "periodic DMP"
# Learned once: they have no randomness.
SEEDLESS = (PHASE, REPLAY, GP, DMP)


def fmp(seed: int = 0) -> FourierModel:
    """Return FMP with the mixture and the defaults of the estimator."""
    return FourierModel(settings={"model": "mixture", "random_state": seed})


def phase(_: int = 0) -> FourierModel:
    """Return FMP with the phase model where the movement is periodic."""
    return FourierModel(settings={"model": "automatic"})


def fmp_paper(seed: int = 0) -> FourierModel:
    """Return FMP with the settings of the paper; windows set the stride."""
    return FourierModel(settings={**PAPER_SETTINGS, "random_state": seed}, maps=True)


def promp_mult(seed: int = 0) -> ProMP:
    """Return ProMP-VM-Mult: f = 1 to 5, 20 bases each, 10 Gaussians (V-C)."""
    return ProMP(
        frequencies=(1.0, 2.0, 3.0, 4.0, 5.0),
        n_components=10,
        random_state=seed,
    )


def promp_own(seed: int = 0) -> ProMP:
    """Return the best ProMP-VM-Mult: f = k T / P, and as many Gaussians as FMP."""
    return ProMP(frequencies=5, n_components=80, random_state=seed)


def aligned_promp(seed: int = 0) -> AlignedProMP:
    """Return ProMP-VM over one aligned period: 10 Gaussians, narrow bases."""
    model = ProMP(
        frequencies=(1.0,), width=0.3, ridge=1e-4, n_components=10, random_state=seed
    )
    return AlignedProMP(model=model)


Maker = Callable[[int], TrajectoryModel]


def compared() -> dict[str, tuple[Maker, int]]:
    """Return all methods of the held-out table, with the strides of their windows."""
    return {
        PHASE: (phase, FMP_STRIDE),
        FMP: (fmp, FMP_STRIDE),
        FMP_PAPER: (fmp_paper, PAPER_STRIDE),
        MULT: (promp_mult, PAPER_STRIDE),
        MULT_OWN: (promp_own, FMP_STRIDE),
        ALIGNED: (aligned_promp, PAPER_STRIDE),
        DMP: (lambda _: PeriodicDMP(), PAPER_STRIDE),
        GP: (lambda _: PeriodicGP(), PAPER_STRIDE),
        REPLAY: (lambda _: Replay(), FMP_STRIDE),
    }


def cut(
    demonstrations: Sequence[Demonstration], *, stride: int, n_steps: int = N_STEPS
) -> NDArray[np.float64]:
    """Return the windows of demonstrations, (N, T, D)."""
    return as_windows(demonstrations, n_steps=n_steps, stride=stride, rate=RATE).values


def play(
    skill: FourierMovementPrimitive, starts: ArrayLike, seconds: float
) -> NDArray[np.float64]:
    """Return the paths that Algorithm 2 plays from starts (S, D), (S, ticks, D)."""
    return Player(skill).rollout(np.atleast_2d(starts), seconds)[:, :, 0]
