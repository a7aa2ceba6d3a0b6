"""How a movement goes on, with a covariance."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax

from fmp_drake.errors import SkillError
from fmp_drake.numeric import check_number, finite_array

if TYPE_CHECKING:
    from fmp_drake.primitives.model.trajectory_mixture import TrajectoryMixture

# Components of less probability do not count.
_LEAST_PROBABILITY = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """The next samples of a movement.

    Attributes
    ----------
    values : ndarray, shape (H, D)
        Expected.
    covariances : ndarray, shape (H, D, D)
        Of each sample: of the mixture, so it says also how unsure it is which component
        goes on.

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
        seen = k * d
        noise = np.tile(skill.tolerance * skill.scales_**2, k)
        self._shape = (k, d)
        self._whitening, self._expected, self._offsets = [], [], []
        self._ahead, self._gains, self._covariances = [], [], []
        for proportion, component in zip(
            skill.proportions_, skill.components_, strict=True
        ):
            mean, covariance = component.marginal(rows)
            observed = covariance[:seen, :seen] + np.diag(noise)
            whitening = np.linalg.inv(np.linalg.cholesky(observed))
            root = covariance[seen:, :seen] @ whitening.T
            # Of each sample ahead its own block.
            blocks = root.reshape(horizon, d, seen)
            own = np.arange(horizon)
            later = covariance[seen:, seen:].reshape(horizon, d, horizon, d)
            self._covariances.append(
                later[own, :, own] - blocks @ np.swapaxes(blocks, 1, 2)
            )
            self._whitening.append(whitening)
            self._expected.append(mean[:seen])
            self._ahead.append(mean[seen:])
            self._gains.append(root)
            self._offsets.append(
                np.log(proportion) + float(np.sum(np.log(np.diag(whitening))))
            )

    def predict(self, values: ArrayLike) -> Prediction:
        """Return the next samples after observed ones (n, D), of which K count."""
        k, d = self._shape
        y = finite_array(values, "the observed samples", ("n", d))
        if len(y) < k:
            raise SkillError(
                f"{len(y)} samples were observed; a prediction needs the last {k}."
            )
        flat = y[-k:].ravel()
        whitened = [
            w @ (flat - e) for w, e in zip(self._whitening, self._expected, strict=True)
        ]
        evidence = [
            offset - 0.5 * float(z @ z)
            for offset, z in zip(self._offsets, whitened, strict=True)
        ]
        probabilities = softmax(evidence)
        probabilities[probabilities < _LEAST_PROBABILITY] = 0.0
        probabilities /= probabilities.sum()
        chosen = np.flatnonzero(probabilities)
        means = np.stack(
            [self._ahead[j] + self._gains[j] @ whitened[j] for j in chosen]
        ).reshape(len(chosen), -1, d)
        probability = probabilities[chosen]
        mean = np.tensordot(probability, means, axes=1)
        off = means - mean
        covariances = np.stack([self._covariances[j] for j in chosen])
        covariances = covariances + off[..., :, None] * off[..., None, :]
        return Prediction(
            values=mean, covariances=np.tensordot(probability, covariances, axes=1)
        )
