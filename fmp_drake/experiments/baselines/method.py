"""Interface of the methods that the benchmark compares."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points

import numpy as np

from fmp_drake.errors import ExperimentError
from fmp_drake.numeric import Array
from fmp_drake.primitives.model.prediction import Prediction

RATE = 20.0
"""Samples per second of all recordings, Hz."""
PAST = 10
"""Samples that a method observes before it predicts."""
HORIZON = 20
"""Samples that a method predicts: one second."""
ENTRY_POINTS = "fmp_drake.methods"
"""Group of entry points for the methods of other packages."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Forecast:
    """Predicted samples.

    Attributes
    ----------
    values : ndarray, shape (H, D)
        Expected samples.
    covariances : ndarray, shape (H, D, D), or None
        None where a method has no uncertainty.
    degrees_of_freedom : float, optional
        Degrees of freedom of t distributions with these covariances; None for Gaussians.

    Examples
    --------
    >>> forecast = Forecast(
    ...     values=np.zeros((1, 2)), covariances=np.eye(2)[None]
    ... )
    >>> forecast.log_densities(np.zeros((1, 2))).round(3)
    array([-1.838])
    """

    values: Array
    covariances: Array | None = None
    degrees_of_freedom: float | None = None

    def log_densities(self, truth: Array) -> Array:
        """Return the log density of the true samples (H, D), nats, shape (H,)."""
        if self.covariances is None:
            raise ExperimentError("this forecast has no covariances.")
        return Prediction(
            values=self.values,
            covariances=self.covariances,
            degrees_of_freedom=self.degrees_of_freedom,
        ).log_density(truth)


def diagonal(variances: Array) -> Array:
    """Return diagonal covariances (..., D, D) with variances (..., D)."""
    return variances[..., None] * np.eye(variances.shape[-1])


def mixture_moments(
    weights: Array, means: Array, covariances: Array
) -> tuple[Array, Array]:
    """Return mean (H, D) and covariance (H, D, D) of mixtures of P distributions.

    Parameters
    ----------
    weights : ndarray, shape (P,)
    means : ndarray, shape (P, H, D)
    covariances : ndarray, shape (P, H, D, D)
    """
    mean = np.tensordot(weights, means, axes=1)
    differences = means - mean
    return mean, np.tensordot(weights, covariances, axes=1) + np.einsum(
        "p,phd,phe->hde", weights, differences, differences
    )


def long_enough(recordings: Sequence[Array]) -> list[Array]:
    """Return the recordings of at least `PAST` + `HORIZON` samples."""
    return [y for y in recordings if len(y) >= PAST + HORIZON]


class Method(ABC):
    """Method that learns a rhythmic movement, predicts it and plays it.

    A package adds a method with a subclass and an entry point of the group
    `fmp_drake.methods`. For every fit an instance is made without arguments.

    Attributes
    ----------
    name : str
        Name in the tables.

    Examples
    --------
    >>> class Still(Method):
    ...     name = "still"
    ...
    ...     def fit(self, recordings):
    ...         pass
    ...
    ...     def predict(self, past, horizon):
    ...         return Forecast(values=np.repeat(past[-1:], horizon, axis=0))
    >>> method = Still()
    >>> method.fit([np.zeros((40, 3))])
    >>> method.play(np.ones((10, 3)), 50, seed=0).shape
    (50, 3)
    """

    name: str

    @abstractmethod
    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from parts of one movement, each (n, D) at `RATE`, in m.

        Raises
        ------
        FmpError
            Where the method cannot learn from them.
        """

    @abstractmethod
    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D)."""

    def play(self, past: Array, count: int, *, seed: int) -> Array | None:  # noqa: ARG002
        """Return a movement (count, D) that continues `past`, or None.

        By default each second is predicted from the last samples of the previous one.
        """
        path = past
        while len(path) < len(past) + count:
            prediction = self.predict(path[-len(past) :], HORIZON)
            path = np.concatenate([path, prediction.values])
        return path[len(past) : len(past) + count]


def further_methods() -> list[type[Method]]:
    """Return the methods that installed packages offer as entry points."""
    methods = []
    for entry in entry_points(group=ENTRY_POINTS):
        method = entry.load()
        if not (isinstance(method, type) and issubclass(method, Method)):
            raise ExperimentError(
                f"the entry point {entry.name} of {ENTRY_POINTS} is {entry.value}; "
                "expected a subclass of fmp_drake.experiments.benchmark.Method."
            )
        if not isinstance(getattr(method, "name", None), str):
            raise ExperimentError(
                f"the method {entry.value} has no name; give the class an attribute name."
            )
        methods.append(method)
    return methods
