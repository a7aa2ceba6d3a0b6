"""How the phase of a movement runs on: a tempo that varies around its mean."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.model.phase.autoregression import Autoregression

_ORDER = 4
# Fraction of the windows, those with the greatest deviations, that do not count.
_LEFT_OUT = 0.05
# Whole windows for each of their samples that are enough to learn from.
_MANY = 5
# Standard deviations from the mean that a tempo to go on from may have.
_MOST = 2.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Tempo:
    """The increments of the phase from sample to sample.

    Attributes
    ----------
    mean : float
        rad per sample.
    spread : float
        Standard deviation, rad per sample.
    process : Autoregression
        Of the deviations from the mean, in their standard deviation.

    Examples
    --------
    >>> import numpy as np
    >>> tempo = Tempo.fit([0.1 * np.arange(50)])
    >>> round(tempo.mean, 3), round(tempo.spread, 3)
    (0.1, 0.0)
    """

    mean: float
    spread: float
    process: Autoregression

    @classmethod
    def fit(cls, phases: Sequence[NDArray[np.float64]]) -> "Tempo":
        """Learn from the unwrapped phases (n,) of recordings."""
        increments = [np.diff(p) for p in phases]
        mean = float(np.mean(np.concatenate(increments)))
        spread = max(float(np.std(np.concatenate(increments))), 1e-9)
        process = Autoregression.fit(
            [(i[:, None] - mean) / spread for i in increments], order=_ORDER
        )
        return cls(mean=mean, spread=spread, process=process)

    def sample(
        self, normals: NDArray[np.float64], *, pinned: int
    ) -> NDArray[np.float64]:
        """Make phases (S, n) that are 0 at the sample `pinned`.

        Parameters
        ----------
        normals : ndarray, shape (S, p + n - 1)
            Standard normals; p is the order of the process.
        pinned : int
        """
        phase = self._phases(self.process.sample(normals[..., None]))
        return phase - phase[:, pinned, None]

    def going_on(
        self, normals: NDArray[np.float64], begun: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Make phases (S, k + n) that go on from known ones, (k,).

        Parameters
        ----------
        normals : ndarray, shape (S, p + n)
        begun : ndarray, shape (k,)
        """
        past = (np.diff(begun) - self.mean) / self.spread
        past = np.clip(past, -_MOST, _MOST)[None, :, None]
        past = np.repeat(past, len(normals), axis=0)
        after = self._phases(self.process.sample(normals[..., None], past=past))
        before = np.repeat(begun[None], len(normals), axis=0)
        return np.concatenate([before, begun[-1] + after[:, 1:]], axis=1)

    def _phases(self, deviations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the phases (S, n + 1) from 0 that have tempi with deviations (S, n, 1)."""
        increments = self.mean + self.spread * deviations[..., 0]
        phase = np.zeros((len(increments), increments.shape[1] + 1))
        np.cumsum(increments, axis=1, out=phase[:, 1:])
        return phase

    def straying(self, count: int) -> NDArray[np.float64]:
        """Return the covariance of n phases, beside the first and a constant tempo."""
        tempi = self.process.covariance(np.arange(count - 1))[:, 0, :, 0]
        out = np.zeros((count, count))
        out[1:, 1:] = self.spread**2 * np.cumsum(np.cumsum(tempi, axis=0), axis=1)
        return out


def phase_covariance(
    phases: Sequence[NDArray[np.float64]], tempo: float, *, count: int, pinned: int
) -> NDArray[np.float64]:
    """Return how the phase strays from a constant tempo, shape (count, count).

    E[psi psi'] of psi(tau) = phase(t + tau) - phase(t + pinned) - tempo (tau - pinned)
    over all windows of `count` samples but the few with the greatest deviations. Where
    few windows are whole, those count that at least begin in a recording, as far as they
    are in it.
    """
    whole = sum(max(0, len(p) - count + 1) for p in phases)
    cut = 0 if whole >= _MANY * count else 2 * (count - 1 - pinned) // 3
    lacking = np.full(cut, np.nan)
    windows = [
        np.lib.stride_tricks.sliding_window_view(np.concatenate([p, lacking]), count)
        for p in phases
        if len(p) + len(lacking) >= count
    ]
    psi, steps = np.concatenate(windows), np.arange(count) - pinned
    psi = psi - psi[:, pinned, None] - tempo * steps
    sizes = np.nanmean(psi**2, axis=1)
    psi = psi[sizes <= np.quantile(sizes, 1 - _LEFT_OUT)]
    known = np.isfinite(psi).astype(float)
    psi = np.where(known > 0, psi, 0.0)
    out = psi.T @ psi / np.maximum(known.T @ known, 1.0)
    variances, vectors = np.linalg.eigh(out)
    return np.asarray((vectors * np.maximum(variances, 0.0)) @ vectors.T)
