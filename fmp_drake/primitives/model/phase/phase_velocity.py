"""Phase velocity of a movement: a stationary process around its mean."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.model.phase.autoregression import Autoregression

_ORDER = 4
# Fraction of the windows, those with the greatest phase noise, that are left out.
_LEFT_OUT = 0.05
# Whole windows per sample of a window that suffice.
_MANY = 5
# Greatest deviation of an initial phase velocity, in standard deviations.
_MOST = 2.5


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseVelocity:
    """Increments of the phase from sample to sample.

    Attributes
    ----------
    mean : float
        rad per sample.
    spread : float
        Standard deviation, rad per sample.
    process : Autoregression
        Deviations from the mean, in standard deviations.

    Examples
    --------
    >>> import numpy as np
    >>> velocity = PhaseVelocity.fit([0.1 * np.arange(50)])
    >>> round(velocity.mean, 3), round(velocity.spread, 3)
    (0.1, 0.0)
    """

    mean: float
    spread: float
    process: Autoregression

    @classmethod
    def fit(cls, phases: Sequence[NDArray[np.float64]]) -> "PhaseVelocity":
        """Fit the unwrapped phases (n,) of recordings."""
        increments = [np.diff(p) for p in phases]
        mean = float(np.mean(np.concatenate(increments)))
        spread = max(float(np.std(np.concatenate(increments))), 1e-9)
        process = Autoregression.fit(
            [(i[:, None] - mean) / spread for i in increments], order=_ORDER
        )
        return cls(mean=mean, spread=spread, process=process)

    def sample(
        self, normals: NDArray[np.float64], *, reference_step: int
    ) -> NDArray[np.float64]:
        """Return sampled phases (S, n) that are 0 at the sample `reference_step`.

        Parameters
        ----------
        normals : ndarray, shape (S, p + n - 1)
            Standard normals; p is the order of the process.
        reference_step : int
        """
        phase = self._phases(self.process.sample(normals[..., None]))
        return phase - phase[:, reference_step, None]

    def continued(
        self, normals: NDArray[np.float64], start: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return sampled phases (S, k + n) that continue known ones, (k,).

        Parameters
        ----------
        normals : ndarray, shape (S, p + n)
        start : ndarray, shape (k,)
        """
        past = (np.diff(start) - self.mean) / self.spread
        past = np.clip(past, -_MOST, _MOST)[None, :, None]
        past = np.repeat(past, len(normals), axis=0)
        after = self._phases(self.process.sample(normals[..., None], past=past))
        before = np.repeat(start[None], len(normals), axis=0)
        return np.concatenate([before, start[-1] + after[:, 1:]], axis=1)

    def _phases(self, deviations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Integrate deviations (S, n, 1) of the velocity to phases (S, n + 1) from 0."""
        increments = self.mean + self.spread * deviations[..., 0]
        phase = np.zeros((len(increments), increments.shape[1] + 1))
        np.cumsum(increments, axis=1, out=phase[:, 1:])
        return phase

    def phase_noise(self, count: int) -> NDArray[np.float64]:
        """Return the covariance (n, n) of n phases relative to the first, beside the mean."""
        velocities = self.process.covariance(np.arange(count - 1))[:, 0, :, 0]
        out = np.zeros((count, count))
        out[1:, 1:] = self.spread**2 * np.cumsum(np.cumsum(velocities, axis=0), axis=1)
        return out


def phase_covariance(
    phases: Sequence[NDArray[np.float64]],
    velocity: float,
    *,
    count: int,
    reference_step: int,
) -> NDArray[np.float64]:
    """Return the covariance of the phase noise in a window, shape (count, count).

    The phase noise is psi(tau) = phase(t + tau) - phase(t + r) - velocity (tau - r) with
    r the `reference_step`; E[psi psi'] is over all windows of `count` samples but the few
    with the greatest noise. If there are few whole windows, those that are cut by the
    end of a recording count as far as they go, and the process of the velocity as half a
    window's worth of them.
    """
    whole = sum(max(0, len(p) - count + 1) for p in phases)
    few = whole < _MANY * count
    cut = count - 2 - reference_step if few else 0
    lacking = np.full(cut, np.nan)
    windows = [
        np.lib.stride_tricks.sliding_window_view(np.concatenate([p, lacking]), count)
        for p in phases
        if len(p) + len(lacking) >= count
    ]
    psi, steps = np.concatenate(windows), np.arange(count) - reference_step
    psi = psi - psi[:, reference_step, None] - velocity * steps
    sizes = np.nanmean(psi**2, axis=1)
    psi = psi[sizes <= np.quantile(sizes, 1 - _LEFT_OUT)]
    known = np.isfinite(psi).astype(float)
    psi = np.where(known > 0, psi, 0.0)
    squares, counts = psi.T @ psi, known.T @ known
    if few:
        # What no window shows follows from the process of the velocity.
        process = PhaseVelocity.fit(phases).phase_noise(count)
        row = process[reference_step]
        process = process - row - row[:, None] + row[reference_step]
        squares, counts = squares + count / 2 * process, counts + count / 2
    out = squares / np.maximum(counts, 1.0)
    variances, vectors = np.linalg.eigh(out)
    return np.asarray((vectors * np.maximum(variances, 0.0)) @ vectors.T)
