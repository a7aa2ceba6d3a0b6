"""How a movement goes on, with a covariance."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.numeric import check_number, finite_array
from fmp_drake.primitives.model.conditioning import Conditioning

if TYPE_CHECKING:
    from fmp_drake.primitives.model.trajectory_mixture import TrajectoryMixture


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """The next samples of a movement.

    Attributes
    ----------
    values : ndarray, shape (H, D)
        Expected.
    covariances : ndarray, shape (H, D, D)
        Of each sample: of the mixture, so it says also how unsure it is which component
        goes on. With a phase model they are scaled so that of what was left out in
        turn while learning, 95 % lies in the ellipsoids of 95 %.

    Examples
    --------
    >>> import numpy as np
    >>> prediction = Prediction(
    ...     values=np.zeros((1, 2)), covariances=np.eye(2)[None]
    ... )
    >>> prediction.values.shape
    (1, 2)
    """

    values: NDArray[np.float64]
    covariances: NDArray[np.float64]


class PredictionPlan:
    """Prediction from the last K samples of a movement, prepared for a skill.

    Each component is conditioned on the samples; they are averaged by their evidence.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    horizon : int
        Samples to predict, at most T - K.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import FourierMovementPrimitive
    >>> t = np.arange(1200) / 20
    >>> circles = np.stack([np.cos(2 * t), np.sin(2 * t)], axis=1)
    >>> windows = np.stack([circles[i : i + 120] for i in range(0, 1080, 5)])
    >>> skill = FourierMovementPrimitive(n_components=16).fit(windows)
    >>> prediction = PredictionPlan(skill, horizon=20).predict(circles[100:110])
    >>> bool(np.allclose(prediction.values, circles[110:130], atol=0.01))
    True
    """

    def __init__(self, skill: "TrajectoryMixture", horizon: int) -> None:
        skill.check_fitted()
        k, d = skill.overlap, skill.n_channels_
        check_number(
            horizon, "the horizon", least=1, most=skill.n_steps - k, whole=True
        )
        rows = skill.observation_rows(np.arange(k + horizon))
        parts = [component.marginal(rows) for component in skill.components_]
        self._conditioning = Conditioning(
            skill.proportions_,
            np.stack([mean.reshape(-1, d) for mean, _ in parts]),
            np.stack([covariance for _, covariance in parts]),
            seen=k,
            noise=np.tile(skill.tolerance * skill.scales_**2, k),
        )
        phase = skill.phase_model_
        self._widening = np.ones(horizon) if phase is None else phase.widening(horizon)
        self._shape = (k, d)

    def predict(self, values: ArrayLike) -> Prediction:
        """Return the next samples after observed ones (n, D), of which K count."""
        k, d = self._shape
        y = finite_array(values, "the observed samples", ("n", d))
        if len(y) < k:
            raise SkillError(
                f"{len(y)} samples were observed; a prediction needs the last {k}."
            )
        mean, covariances = self._conditioning.predict(y[-k:])
        return Prediction(
            values=mean, covariances=self._widening[:, None, None] * covariances
        )
