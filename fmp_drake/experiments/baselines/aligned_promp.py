"""ProMP over one period of aligned data (Fig. 5a and 6a of the paper)."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import DemonstrationError
from fmp_drake.experiments.baselines.alignment import align_periods
from fmp_drake.experiments.baselines.checks import checked_prefix, checked_windows
from fmp_drake.experiments.baselines.joining import joined_recordings
from fmp_drake.experiments.baselines.period import fundamental_period
from fmp_drake.experiments.baselines.promp import ProMP
from fmp_drake.experiments.baselines.trajectory_model import Conditioned


class AlignedProMP(BaseEstimator):  # type: ignore[misc]
    """ProMP-VM as it is meant to be used: one period, f = 1, aligned.

    The windows are joined to recordings, their fundamental period is estimated, and they
    are cut into aligned periods of equal length. T is a period, so samples and
    conditioned trajectories are shorter than the windows, and steps count from phase 0,
    where the channel that varies most is greatest.

    It has no density of windows: they are not one aligned period. That of aligned
    periods is `model_.log_density(aligned_.values)`.

    Parameters
    ----------
    n_steps : int, optional
        T; the period, rounded, where None (so a step is a sample).
    n_bases, width, ridge, n_components, reg_covar, tolerance, random_state
        As those of `ProMP`. The defaults of width and ridge are narrow bases, which were
        near the best on held-out data of all bundled demonstrations; with the paper's
        cosines (width 100, ridge 3e-7) only polishing has few enough
        harmonics.

    Attributes
    ----------
    n_steps_, n_channels_ : int
        T and D.
    period_ : float
        Mean of the aligned periods, in samples.
    aligned_ : AlignedPeriods
    model_ : ProMP
    """

    def __init__(
        self,
        *,
        n_steps: int | None = None,
        n_bases: int = 20,
        width: float = 0.3,
        ridge: float = 1e-4,
        n_components: int = 1,
        reg_covar: float = 1e-6,
        tolerance: float = 1e-8,
        random_state: int = 0,
    ) -> None:
        self.n_steps = n_steps
        self.n_bases = n_bases
        self.width = width
        self.ridge = ridge
        self.n_components = n_components
        self.reg_covar = reg_covar
        self.tolerance = tolerance
        self.random_state = random_state

    def fit(self, windows: ArrayLike) -> Self:
        """Learn from windows, shape (N, T, D), that hold at least 3 periods."""
        y = checked_windows(windows)
        recordings = joined_recordings(y)
        period = fundamental_period(recordings)
        steps = round(period) if self.n_steps is None else self.n_steps
        self.aligned_ = align_periods(recordings, period=period, n_steps=steps)
        if len(self.aligned_.values) < 2:
            raise DemonstrationError(
                f"only one full period of {period:.3g} samples was found; at least 2 are "
                "needed. Record more cycles."
            )
        self.period_ = float(self.aligned_.durations.mean())
        self.model_ = ProMP(
            frequencies=(1.0,),
            n_bases=self.n_bases,
            width=self.width,
            ridge=self.ridge,
            n_components=self.n_components,
            reg_covar=self.reg_covar,
            tolerance=self.tolerance,
            random_state=self.random_state,
        ).fit(self.aligned_.values)
        self.n_steps_, self.n_channels_ = steps, y.shape[2]
        return self

    def sample(self, n: int = 1, *, seed: int = 0) -> NDArray[np.float64]:
        """Draw periods, shape (n, T, D)."""
        self.check_fitted()
        return self.model_.sample(n, seed=seed)

    def log_density(self, windows: ArrayLike) -> None:  # noqa: ARG002 - the interface
        """Return None: there is no density of windows of several periods."""
        self.check_fitted()

    def condition(self, steps: ArrayLike, values: ArrayLike) -> Conditioned:
        """Condition on values (K, D) at steps (K,) of the aligned period."""
        self.check_fitted()
        return self.model_.condition(steps, values)

    def predict(self, prefix: ArrayLike, horizon: int) -> NDArray[np.float64]:
        """Return the expected continuation (horizon, D) of samples (K, D).

        The phase of the samples is not known: the expectation is over T phases, each
        weighted by the evidence of the samples, and over the components.
        """
        self.check_fitted()
        y = checked_prefix(prefix, horizon, n_channels=self.n_channels_)
        scale = self.n_steps_ / self.period_
        evidence = np.empty(self.n_steps_)
        futures = np.empty((self.n_steps_, horizon, self.n_channels_))
        for phase in range(self.n_steps_):
            seen = phase + scale * np.arange(len(y))
            posterior = self.model_.posterior(seen, y, noise=self.model_.noise_)
            evidence[phase] = posterior.log_evidence
            later = phase + scale * (len(y) + np.arange(horizon))
            futures[phase] = self.model_.trajectory(posterior.mean(), later)
        return np.tensordot(softmax(evidence), futures, axes=1)

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self, "model_")
