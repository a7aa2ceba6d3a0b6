"""ProMP over one period of aligned data (Fig. 5a and 6a of the paper)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax
from sklearn.base import clone

from fmp_drake.experiments.baselines.alignment import align_periods, movement_period
from fmp_drake.experiments.baselines.promp import ProMP
from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel
from fmp_drake.primitives.data.windows import joined_recordings

# Narrow bases: near the best on held-out data of all bundled demonstrations. Of the
# paper's cosines (width 100, ridge 3e-7) only polishing has few enough harmonics.
_ONE_PERIOD = ProMP(frequencies=(1.0,), width=0.3, ridge=1e-4)


class AlignedProMP(TrajectoryModel):
    """ProMP-VM in its intended use: one aligned period, f = 1.

    The windows are joined to recordings, their fundamental period is estimated, and they
    are cut into aligned periods of equal length. T is a period, so samples and
    conditioned trajectories are shorter than the windows, and steps count from phase 0,
    where the channel that varies most is greatest.

    Parameters
    ----------
    model : ProMP, optional
        Model of the aligned periods, of frequency 1; with narrow bases (width 0.3, ridge
        1e-4) where None. It is not changed.

    Attributes
    ----------
    period_ : float
        Mean of the aligned periods, in samples; T is the estimated one, rounded.
    aligned_ : AlignedPeriods
    model_ : ProMP
        Fitted to the aligned periods.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import sliding_windows
    >>> path = np.sin(np.arange(400) * np.pi / 10)[:, None]
    >>> model = AlignedProMP().fit(sliding_windows(path, n_steps=50, stride=5))
    >>> model.n_steps_
    20
    """

    def __init__(self, *, model: ProMP | None = None) -> None:
        self.model = model

    def _learn(self, windows: NDArray[np.float64]) -> None:
        recordings = joined_recordings(windows)
        period = movement_period(recordings)
        self.n_steps_ = round(period)
        self.aligned_ = align_periods(recordings, period=period, n_steps=self.n_steps_)
        self.period_ = float(self.aligned_.durations.mean())
        self.model_ = clone(self.model or _ONE_PERIOD).fit(self.aligned_.values)

    def sample(self, n: int = 1, *, seed: int = 0) -> NDArray[np.float64]:
        """Draw n periods without observation noise, shape (n, T, D)."""
        self.check_fitted()
        return self.model_.sample(n, seed=seed)

    def condition(self, steps: ArrayLike, values: ArrayLike) -> NDArray[np.float64]:
        """Return the period (T, D) given values (K, D) at its steps (K,)."""
        self.check_fitted()
        return self.model_.condition(steps, values)

    def _continue(
        self, prefix: NDArray[np.float64], horizon: int
    ) -> NDArray[np.float64]:
        """Return the expectation over the T phases at which the prefix may start.

        Each is weighted by the evidence of the samples.
        """
        scale = self.n_steps_ / self.period_
        evidence = np.empty(self.n_steps_)
        futures = np.empty((self.n_steps_, horizon, self.n_channels_))
        for phase in range(self.n_steps_):
            observed = phase + scale * np.arange(len(prefix))
            posterior = self.model_.posterior(
                observed, prefix, noise=self.model_.noise_
            )
            evidence[phase] = posterior.log_evidence
            later = phase + scale * (len(prefix) + np.arange(horizon))
            mean = posterior.probabilities @ posterior.means
            futures[phase] = self.model_.trajectory(mean, later)
        return np.tensordot(softmax(evidence), futures, axes=1)
