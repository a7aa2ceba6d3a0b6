"""Fourier movement primitives behind the interface of the baselines."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive
from fmp_drake.primitives.model.prediction import Prediction
from fmp_drake.primitives.model.trajectory_mixture import PredictionPlan


class FourierModel(TrajectoryModel):
    """A Fourier movement primitive.

    It predicts over all components, weighted by their evidence; or, as the paper
    does, with the one of least cost (section IV-B).

    Parameters
    ----------
    settings : dict, optional
        Parameters of `FourierMovementPrimitive` that differ from its defaults, except
        `n_steps`, which is that of the windows.
    maps : bool
        Predict by the paper's mapping.

    Attributes
    ----------
    skill_ : FourierMovementPrimitive

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import sliding_windows
    >>> path = np.sin(np.arange(200) * np.pi / 10)[:, None]
    >>> windows = sliding_windows(path, n_steps=40, stride=3)
    >>> model = FourierModel(settings={"n_components": 4}).fit(windows)
    >>> future = model.predict(path[:10], horizon=20)
    >>> bool(np.allclose(future, path[10:30], atol=1e-3))
    True
    """

    def __init__(
        self, *, settings: dict[str, Any] | None = None, maps: bool = False
    ) -> None:
        self.settings = settings
        self.maps = maps

    def _learn(self, windows: NDArray[np.float64]) -> None:
        settings = {"overlap": min(10, self.n_steps_ // 2), **(self.settings or {})}
        skill = FourierMovementPrimitive(**{**settings, "n_steps": self.n_steps_})
        self.skill_ = skill.fit(windows)
        self._plans: dict[int, PredictionPlan] = {}

    def _draw(self, n: int, seed: int) -> NDArray[np.float64]:
        return self.skill_.sample(n, seed=seed, with_noise=False)

    def log_density(self, windows: ArrayLike) -> NDArray[np.float64]:
        """Return the log density of windows (N, T, D) per time step, shape (N,)."""
        y = self._checked_windows(windows)
        return self.skill_.score_samples(y) / self.n_steps_

    def tubes(self, prefix: ArrayLike, horizon: int) -> Prediction:
        """Return the continuation of a prefix (K, D) with covariances."""
        self.check_fitted()
        if horizon not in self._plans:
            self._plans[horizon] = PredictionPlan(self.skill_, horizon)
        return self._plans[horizon].predict(prefix)

    def _continue(
        self, prefix: NDArray[np.float64], horizon: int
    ) -> NDArray[np.float64]:
        """Predict; or map the samples onto the first steps of a window, and read on.

        Past the end of the window its last samples are taken anew, as in section V-D,
        without tracking.
        """
        known, path, total = self.skill_.overlap, prefix, len(prefix) + horizon
        if not self.maps and len(prefix) >= known:
            while len(path) < total:
                ahead = min(total - len(path), self.n_steps_ - known)
                path = np.concatenate([path, self.tubes(path, ahead).values])
            return path[len(prefix) :]
        k = min(len(prefix), self.n_steps_ // 2)
        plan = self.skill_.mapping_plan(np.arange(k))
        while len(path) < total:
            window = self.skill_.synthesize(plan.map(path[-k:].ravel()).weights)
            path = np.concatenate([path, window[k:]])
        return path[len(prefix) : total]
