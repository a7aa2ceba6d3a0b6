"""What the models of the experiments have in common."""

from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditioned:
    """A distribution over trajectories that meets keypoints.

    Attributes
    ----------
    mean : ndarray, shape (T, D)
        Of the chosen component.
    covariance : ndarray, shape (T, D, D), or None
        Of the movement at every step, without observation noise; None where the model
        has no distribution.
    component : int
        The chosen one: that with the greatest responsibility.
    responsibilities : ndarray, shape (M,)
        Probability of each component given the keypoints.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64] | None
    component: int
    responsibilities: NDArray[np.float64]


@runtime_checkable
class TrajectoryModel(Protocol):
    """A movement primitive that learns from windows of T samples of D channels.

    Time is counted in samples. Values are in the units of the windows.

    Attributes
    ----------
    n_steps_ : int
        T of what the fitted model gives: that of the windows, or the samples of
        one period where the model knows only a period.
    """

    n_steps_: int

    def fit(self, windows: ArrayLike) -> Self:
        """Learn from windows, shape (N, T, D)."""

    def sample(self, n: int = 1, *, seed: int = 0) -> NDArray[np.float64]:
        """Draw trajectories, shape (n, T, D)."""

    def log_density(self, windows: ArrayLike) -> NDArray[np.float64] | None:
        """Return the log density per time step of windows (N, T, D), shape (N,).

        That of a whole window divided by T; None where the model has no density.
        """

    def condition(self, steps: ArrayLike, values: ArrayLike) -> Conditioned:
        """Meet values (K, D) at steps (K,), each from 0 to T - 1."""

    def predict(self, prefix: ArrayLike, horizon: int) -> NDArray[np.float64]:
        """Return the expected continuation (horizon, D) of samples (K, D)."""
