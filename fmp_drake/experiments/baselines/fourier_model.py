"""Fourier movement primitives behind the interface of the baselines."""

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from fmp_drake.experiments.baselines.checks import (
    checked_count,
    checked_keypoints,
    checked_prefix,
    checked_windows,
)
from fmp_drake.experiments.baselines.trajectory_model import Conditioned
from fmp_drake.primitives.model.mapping import MappingPlan
from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


class FourierModel(BaseEstimator):  # type: ignore[misc]
    """FMP: mapping instead of conditioning (section IV-B).

    Parameters
    ----------
    settings : dict, optional
        Parameters of `FourierMovementPrimitive` that differ from its defaults, except
        `n_steps`, which is that of the windows.

    Attributes
    ----------
    n_steps_, n_channels_ : int
        T and D.
    skill_ : FourierMovementPrimitive
    """

    def __init__(self, *, settings: dict[str, Any] | None = None) -> None:
        self.settings = settings

    def fit(self, windows: ArrayLike) -> Self:
        """Learn from windows, shape (N, T, D), at least 2."""
        y = checked_windows(windows, at_least=2)
        settings = {"overlap": min(10, y.shape[1] // 2), **(self.settings or {})}
        self.skill_ = FourierMovementPrimitive(
            **{**settings, "n_steps": y.shape[1]}
        ).fit(y)
        self.n_steps_, self.n_channels_ = y.shape[1:]
        return self

    def sample(
        self, n: int = 1, *, seed: int = 0, with_noise: bool = False
    ) -> NDArray[np.float64]:
        """Draw trajectories, shape (n, T, D)."""
        self.check_fitted()
        checked_count(n, seed)
        return self.skill_.sample(n, seed=seed, with_noise=with_noise)

    def log_density(self, windows: ArrayLike) -> NDArray[np.float64]:
        """Return the log density per time step of windows (N, T, D), shape (N,)."""
        self.check_fitted()
        y = checked_windows(windows, shape=(self.n_steps_, self.n_channels_))
        return self.skill_.score_samples(y) / self.n_steps_

    def condition(self, steps: ArrayLike, values: ArrayLike) -> Conditioned:
        """Map values (K, D) at steps (K,): (14) to (16), with the covariance (18).

        The component is the skill's choice; the mean is that of the mapped weights, before
        any tracking. The responsibilities are those of the evidence, or of the
        cost (15) in its place where the skill selects by it.
        """
        self.check_fitted()
        steps, y = checked_keypoints(
            steps, values, n_steps=self.n_steps_, n_channels=self.n_channels_
        )
        skill = self.skill_
        mapping = skill.mapping_plan(steps).map(y.ravel())
        every = range(self.n_steps_)
        return Conditioned(
            mean=skill.synthesize(mapping.weights),
            covariance=np.stack(
                [skill.covariance(mapping.component, t) for t in every]
            ),
            component=mapping.component,
            responsibilities=softmax(-mapping.costs),
        )

    def predict(self, prefix: ArrayLike, horizon: int) -> NDArray[np.float64]:
        """Return the continuation (horizon, D) of samples (K, D).

        They are mapped onto the first K steps; past the end of the window the last K values
        are mapped anew, as in section V-D, without tracking.
        """
        self.check_fitted()
        y = checked_prefix(prefix, horizon, n_channels=self.n_channels_)
        k = min(len(y), self.n_steps_ // 2)
        plan: MappingPlan = self.skill_.mapping_plan(np.arange(k))
        path = y
        while len(path) < len(y) + horizon:
            mapping = plan.map(path[-k:].ravel())
            window = self.skill_.synthesize(mapping.weights)
            path = np.concatenate([path, window[k:]])
        return path[len(y) : len(y) + horizon]

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self, "skill_")
