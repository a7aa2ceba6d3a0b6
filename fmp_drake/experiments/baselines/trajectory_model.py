"""Interface of the movement primitives that learn from windows."""

from abc import ABC, abstractmethod
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import ExperimentError
from fmp_drake.numeric import check_number, finite_array
from fmp_drake.primitives.model.prediction import Prediction


class TrajectoryModel(ABC, BaseEstimator):  # type: ignore[misc]
    """A movement primitive that learns from windows of T samples of D channels.

    The base class of baselines. It checks all arguments; a method implements `_learn`,
    `_continue` and, where it has covariances, `tubes`. Time is counted in samples, values
    are in the units of the windows.

    Attributes
    ----------
    n_steps_ : int
        T of the trajectories of the fitted model: the length of the windows, or of one
        period where the model only represents a period.
    n_channels_ : int
        D.

    Examples
    --------
    >>> class MeanWindow(TrajectoryModel):
    ...     def _learn(self, windows):
    ...         self.mean_ = windows.mean(axis=0)
    ...
    ...     def _continue(self, prefix, horizon):
    ...         return self.mean_[len(prefix) :][:horizon]
    >>> model = MeanWindow().fit(np.ones((5, 20, 2)))
    >>> model.predict(np.ones((4, 2)), horizon=3).shape
    (3, 2)
    """

    n_steps_: int
    n_channels_: int

    def fit(self, windows: ArrayLike) -> Self:
        """Learn from windows.

        Parameters
        ----------
        windows : array_like, shape (N, T, D)
            At least 2, in the order in which they were cut from the recordings.

        Raises
        ------
        ExperimentError
            Where the windows or a parameter of the model cannot be used.
        """
        y = finite_array(windows, "the windows", ("N", "T", "D"), error=ExperimentError)
        if len(y) < 2:
            raise ExperimentError("there is 1 window; at least 2 are needed.")
        self.n_steps_, self.n_channels_ = y.shape[1:]
        self._learn(y)
        return self

    def predict(self, prefix: ArrayLike, horizon: int) -> NDArray[np.float64]:
        """Return the expected continuation (horizon, D) of observed samples (K, D)."""
        self.check_fitted()
        check_number(horizon, "horizon", least=1, whole=True, error=ExperimentError)
        shape = ("K", self.n_channels_)
        y = finite_array(prefix, "the prefix", shape, error=ExperimentError)
        return self._continue(y, horizon)

    def tubes(self, prefix: ArrayLike, horizon: int) -> Prediction | None:  # noqa: ARG002
        """Return the continuation with a covariance of each sample.

        None where the model has none.
        """
        self.check_fitted()
        return None

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self)

    def _check_parameters(self, **least: float) -> None:
        """Check the least values of parameters; 0 stands for positive."""
        for name, bound in least.items():
            check_number(
                getattr(self, name),
                name,
                above=None if bound else 0.0,
                least=bound or None,
                error=ExperimentError,
            )

    @abstractmethod
    def _learn(self, windows: NDArray[np.float64]) -> None: ...

    @abstractmethod
    def _continue(
        self, prefix: NDArray[np.float64], horizon: int
    ) -> NDArray[np.float64]: ...
