"""Adaptive-frequency oscillator that drives a periodic DMP, online."""

from collections.abc import Sequence

import numpy as np

from fmp_drake.experiments.baselines.alignment import movement_period
from fmp_drake.experiments.baselines.method import Array, Forecast, Method
from fmp_drake.experiments.baselines.periodic_dmp import PeriodicDMP

_HARMONICS = 5
# K of phase and frequency, and eta, per radian of the movement; the greatest factor by which
# the frequency changes in one pass.
_COUPLING, _ADAPTATION, _LEARNING = 0.3, 0.02, 0.2
_MOST_CHANGE = 1.3
_PASSES = 3
_SUBSTEPS = 4


class AdaptiveOscillatorDMP(Method):
    """A phase oscillator with adaptive Fourier series, then a periodic DMP.

    The oscillator follows the strongest direction of the recording::

        dphi/dt = omega - K e sin(phi),  domega/dt = -K' omega e sin(phi)
        e = y - sum_k (a_k cos(k phi) + b_k sin(k phi))
        da_k/dt = eta cos(k phi) e,  db_k/dt = eta sin(k phi) e

    It starts from the estimated frequency and passes the recording three times. To
    predict, it also passes the observed samples, from the phase that fits them best; a
    DMP of one mean period (`PeriodicDMP`) continues from there at the adapted
    frequency. It has no uncertainty.

    References
    ----------
    A. Gams et al., "On-line learning and modulation of periodic movements with nonlinear
    dynamical systems", Autonomous Robots 27(1), 2009. T. Petrič et al., "On-line
    frequency adaptation and movement imitation for rhythmic robotic tasks",
    International Journal of Robotics Research 30(14), 2011.
    """

    name = "adaptive oscillator, DMP"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        samples = np.concatenate(list(recordings))
        self._mean = samples.mean(axis=0)
        _, sizes, axes = np.linalg.svd(samples - self._mean, full_matrices=False)
        self._axis = axes[0] * np.sqrt(len(samples)) / sizes[0]
        omega = 2 * np.pi / movement_period(recordings)
        state = np.zeros(2 * _HARMONICS)
        state[0] = np.sqrt(2.0)
        phase = 0.0
        for _ in range(_PASSES):
            for recording in recordings:
                signal = (recording - self._mean) @ self._axis
                phase, omega, state = _follow(signal, phase, omega, state)
        self.frequency_ = omega
        self._series = state
        size = 2 * round(2 * np.pi / omega)
        longest = max(map(len, recordings))
        size = min(max(size, 8), longest - 1)
        self._dmp = PeriodicDMP()
        self._dmp.fit([y for y in recordings if len(y) > size])

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D)."""
        signal = (past - self._mean) @ self._axis
        grid = np.linspace(0, 2 * np.pi, 60, endpoint=False)
        steps = self.frequency_ * np.arange(len(past))
        off = _series(self._series, grid[:, None] + steps) - signal
        speed = np.diff(_series(self._series, grid[:, None] + steps), axis=1)
        off = np.concatenate([off, 3 * (speed - np.diff(signal))], axis=1)
        first = grid[int(np.argmin(np.sum(off**2, axis=1)))]
        _, omega, _ = _follow(signal, first, self.frequency_, self._series, learn=0.0)
        # A tenth of a period hardly determines its frequency.
        limit = 0.2 * self.frequency_
        omega = float(np.clip(omega, self.frequency_ - limit, self.frequency_ + limit))
        return Forecast(values=self._dmp.continued(past, horizon, frequency=omega))


def _series(state: Array, phase: Array) -> Array:
    """Return the Fourier series (a_1 .. a_5, b_1 .. b_5) at phases (...,)."""
    k = np.arange(1, _HARMONICS + 1)
    angles = np.multiply.outer(phase, k)
    out: Array = np.cos(angles) @ state[:_HARMONICS]
    out += np.sin(angles) @ state[_HARMONICS:]
    return out


def _follow(
    signal: Array, phase: float, omega: float, state: Array, *, learn: float = 1.0
) -> tuple[float, float, Array]:
    """Run the oscillator on a signal (n,); return phase, frequency and series."""
    k = np.arange(1, _HARMONICS + 1)
    state = state.copy()
    bounds = omega / _MOST_CHANGE, omega * _MOST_CHANGE
    dt = omega / _SUBSTEPS  # Gains are per radian.
    at = np.arange((len(signal) - 1) * _SUBSTEPS + 1) / _SUBSTEPS
    for y in np.interp(at, np.arange(len(signal)), signal):
        basis = np.concatenate([np.cos(k * phase), np.sin(k * phase)])
        error = float(y - basis @ state)
        push = -error * np.sin(phase)
        phase += omega / _SUBSTEPS + _COUPLING * push * dt
        omega *= 1 + _ADAPTATION * push * dt
        omega = float(np.clip(omega, *bounds))
        state += learn * _LEARNING * basis * error * dt
    return phase, omega, state
