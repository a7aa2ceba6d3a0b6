"""ProMP over one period of aligned data (Fig. 5a and 6a of the paper)."""

from collections.abc import Sequence

import numpy as np
from scipy.special import softmax
from sklearn.base import clone

from fmp_drake.experiments.baselines.alignment import align_periods, movement_period
from fmp_drake.experiments.baselines.method import (
    Array,
    Forecast,
    Method,
    long_enough,
)
from fmp_drake.experiments.baselines.promp import ProMP

# Narrow bases: near the best on held-out data of all bundled demonstrations. Of the
# paper's cosines (width 100, ridge 3e-7) only polishing has few enough harmonics.
_ONE_PERIOD = ProMP(frequencies=(1.0,), width=0.3, ridge=1e-4, n_components=10)


class AlignedProMP(Method):
    """ProMP-VM in its intended use: one aligned period, f = 1.

    The fundamental period of the recordings is estimated, and they are cut into aligned
    periods of equal length T. Steps count from phase 0, where the channel that varies
    most is greatest.

    Parameters
    ----------
    model : ProMP, optional
        Model of the aligned periods, of frequency 1; with narrow bases (width 0.3, ridge
        1e-4) and 10 Gaussians where None. It is not changed.

    Attributes
    ----------
    n_steps_ : int
        T.
    period_ : float
        Mean of the aligned periods, in samples; T is the estimated one, rounded.
    aligned_ : AlignedPeriods
    model_ : ProMP
        Fitted to the aligned periods.

    Examples
    --------
    >>> import numpy as np
    >>> path = np.sin(np.arange(400) * np.pi / 10)[:, None]
    >>> path += 0.01 * np.random.default_rng(0).standard_normal(path.shape)
    >>> model = AlignedProMP()
    >>> model.fit([path])
    >>> model.n_steps_
    20
    """

    name = "ProMP, aligned"

    def __init__(self, *, model: ProMP | None = None) -> None:
        self.model = model

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        recordings = long_enough(recordings)
        period = movement_period(recordings)
        self.n_steps_ = round(period)
        self.aligned_ = align_periods(recordings, period=period, n_steps=self.n_steps_)
        self.period_ = float(self.aligned_.durations.mean())
        self.model_ = clone(self.model or _ONE_PERIOD).fit(self.aligned_.values)

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Return the expectation over the T phases at which the past (K, D) may start.

        Each is weighted by the evidence of the samples.
        """
        scale = self.n_steps_ / self.period_
        evidence = np.empty(self.n_steps_)
        futures = np.empty((self.n_steps_, horizon, past.shape[1]))
        for phase in range(self.n_steps_):
            observed = phase + scale * np.arange(len(past))
            posterior = self.model_.posterior(observed, past, noise=self.model_.noise_)
            evidence[phase] = posterior.log_evidence
            later = phase + scale * (len(past) + np.arange(horizon))
            mean = posterior.probabilities @ posterior.means
            futures[phase] = self.model_.trajectory(mean, later)
        return Forecast(values=np.tensordot(softmax(evidence), futures, axes=1))
