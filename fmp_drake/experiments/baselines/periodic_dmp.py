"""Periodic dynamic movement primitives, of constant or adaptive frequency."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.signal import StateSpace, lsim, savgol_filter
from scipy.special import softmax

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines.alignment import align_periods, movement_period
from fmp_drake.experiments.baselines.method import Forecast, Method, long_enough
from fmp_drake.numeric import Array

# Number of kernels psi_i of a period, and the ridge of the least squares for the w_i.
_BASES, _RIDGE = 25, 1e-6
# Gains of Gams et al.; critically damped, beta = alpha / 4.
_ALPHA, _BETA = 8.0, 2.0
# Integration steps for each sample.
_SUBSTEPS = 12
# Points of a period, and the length of the Savitzky-Golay filter over them.
_POINTS, _FILTER_LENGTH = 400, 41
# Periods until the influence of a start has decayed.
_SETTLING_PERIODS = 4
# Adaptive oscillator: number of harmonics; K, K' and eta, per radian of the movement;
# greatest factor of the frequency in one pass; number of passes and integration steps.
_HARMONICS = 5
_COUPLING, _ADAPTATION, _LEARNING = 0.3, 0.02, 0.2
_GREATEST_FACTOR = 1.3
_PASSES, _OSCILLATOR_SUBSTEPS = 3, 4


class PeriodicDMP(Method):
    """Rhythmic dynamic movement primitive: one attracting limit cycle.

    The phase phi runs with the constant frequency Omega, and each channel follows::

        dz / dphi = alpha (beta (g - y) - z) + f(phi)
        dy / dphi = z
        f(phi) = sum_i psi_i w_i / sum_i psi_i,  psi_i = exp(h (cos(phi - c_i) - 1))

    Frequency and phase come from the aligned periods of the recordings (see
    `align_periods`); f is fitted to their mean. The movement converges to its cycle from
    any start. It has no uncertainty.

    Attributes
    ----------
    frequency_ : float
        Omega, rad per sample.
    goal_ : ndarray, shape (D,)
        g, the mean of the aligned periods.
    weights_ : ndarray, shape (25, D)
        The w_i.
    cycle : CubicSpline
        Returns the limit cycle at phases (...,) in rad, shape (..., D).

    Examples
    --------
    >>> import numpy as np
    >>> path = np.sin(np.arange(400) * np.pi / 10)[:, None]
    >>> model = PeriodicDMP()
    >>> model.fit([path])
    >>> round(2 * np.pi / model.frequency_, 1)
    20.0

    References
    ----------
    A. J. Ijspeert et al., "Dynamical movement primitives: learning attractor models for
    motor behaviors", Neural Computation 25(2), 2013.
    A. Gams et al., "On-line learning and modulation of periodic movements with nonlinear
    dynamical systems", Autonomous Robots 27(1), 2009.
    """

    name = "periodic DMP"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        recordings = long_enough(recordings)
        period, mean = _mean_period(recordings)
        self.frequency_ = 2 * np.pi / period
        self.goal_ = mean.mean(axis=0)
        phases = 2 * np.pi * np.arange(_POINTS + 1) / _POINTS
        y, dy, ddy = (
            savgol_filter(
                mean,
                _FILTER_LENGTH,
                3,
                deriv=order,
                delta=phases[1],
                axis=0,
                mode="wrap",
            )
            for order in range(3)
        )
        forces = ddy - _ALPHA * (_BETA * (self.goal_ - y) - dy)
        psi = self._kernels(phases[:-1])
        normal = psi.T @ psi + _RIDGE * len(psi) * np.eye(_BASES)
        self.weights_ = np.linalg.solve(normal, psi.T @ forces)
        settling = phases[1] * np.arange((_SETTLING_PERIODS + 1) * _POINTS + 1)
        cycle = self._integrate(self.goal_, 0 * self.goal_, settling)[-_POINTS - 1 :]
        cycle[-1] = cycle[0]
        self.cycle = CubicSpline(phases, cycle, bc_type="periodic")

    def rollout(
        self,
        start: ArrayLike,
        n_steps: int,
        *,
        phase: float = 0.0,
        velocity: ArrayLike | None = None,
        frequency: float | None = None,
    ) -> Array:
        """Integrate from a start (D,) at a phase, shape (n_steps, D).

        Parameters
        ----------
        start : array_like, shape (D,)
        n_steps : int
            Number of samples, with the start.
        phase : float
            rad.
        velocity : array_like, shape (D,), optional
            Per sample; zero by default.
        frequency : float, optional
            rad per sample; that of the recordings by default.
        """
        y = np.asarray(start, dtype=float)
        z = np.zeros(len(y)) if velocity is None else np.asarray(velocity)
        frequency = frequency or self.frequency_
        step = frequency / _SUBSTEPS
        phases = phase + step * np.arange((n_steps - 1.0) * _SUBSTEPS + 1)
        return self._integrate(y, z / frequency, phases)[::_SUBSTEPS]

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (K, D)."""
        return Forecast(values=self.continued(past, horizon, frequency=self.frequency_))

    def play(self, past: Array, count: int, *, seed: int) -> Array:  # noqa: ARG002
        """Return the movement that converges to the limit cycle."""
        return self.continued(past, count, frequency=self.frequency_)

    def continued(self, prefix: Array, horizon: int, *, frequency: float) -> Array:
        """Continue samples (K, D) from the last one, with its velocity and phase.

        Parameters
        ----------
        prefix : ndarray, shape (K, D)
        horizon : int
            Number of samples to return.
        frequency : float
            rad per sample.
        """
        steps = frequency * np.arange(len(prefix))
        grid = 2 * np.pi * np.arange(_POINTS) / _POINTS
        error = self.cycle(grid[:, None] + steps) - prefix
        phase = grid[np.argmin(np.sum(error**2, axis=(1, 2)))] + steps[-1]
        velocity = frequency * self.cycle(phase, 1)
        if len(prefix) > 1:
            velocity = prefix[-1] - prefix[-2]
        path = self.rollout(
            prefix[-1],
            horizon + 1,
            phase=phase,
            velocity=velocity,
            frequency=frequency,
        )
        return path[1:]

    def _kernels(self, phases: Array) -> Array:
        centres = 2 * np.pi * np.arange(_BASES) / _BASES
        # Neighbours cross at about 0.7.
        sharpness = 2.5 * (_BASES / (2 * np.pi)) ** 2
        return softmax(sharpness * np.cos(phases[:, None] - centres), axis=1)

    def _integrate(self, y: Array, z: Array, phases: Array) -> Array:
        """Return the movement at evenly spaced phases (P,), shape (P, D)."""
        stiffness, damping = _ALPHA * _BETA, _ALPHA
        system = StateSpace([[0, 1], [-stiffness, -damping]], [[0], [1]], [[1, 0]], 0)
        forces = self._kernels(phases) @ self.weights_
        error = y - self.goal_
        channels = [
            np.atleast_1d(lsim(system, force, phases - phases[0], [e, speed])[1])
            for force, e, speed in zip(forces.T, error, z, strict=True)
        ]
        return self.goal_ + np.stack(channels, axis=1)


def _mean_period(recordings: list[Array]) -> tuple[float, Array]:
    """Return the mean duration, samples, and the mean period, (_POINTS, D).

    With fewer than two aligned periods it is the last one, closed by a linear correction.
    """
    period = movement_period(recordings)
    try:
        aligned = align_periods(recordings, period=period, n_steps=_POINTS)
    except ExperimentError:
        longest = max(recordings, key=len)
        first = len(longest) - 1 - period
        ticks = first + period * np.arange(_POINTS + 1) / _POINTS
        cycle = CubicSpline(np.arange(len(longest)), longest)(ticks)
        ramp = np.linspace(0, 1, _POINTS + 1)[:, None]
        return period, (cycle - ramp * (cycle[-1] - cycle[0]))[:-1]
    return float(aligned.durations.mean()), aligned.values.mean(axis=0)


class AdaptiveOscillatorDMP(Method):
    """Adaptive-frequency oscillator that drives a periodic DMP, online.

    The phase oscillator with adaptive Fourier series follows the first principal component
    of the recording::

        dphi/dt = omega - K e sin(phi),  domega/dt = -K' omega e sin(phi)
        e = y - sum_k (a_k cos(k phi) + b_k sin(k phi))
        da_k/dt = eta cos(k phi) e,  db_k/dt = eta sin(k phi) e

    It starts from the estimated frequency and passes over the recording three times. To
    predict, it also passes over the observed samples, from the phase that fits them best.
    A DMP of one mean period (`PeriodicDMP`) continues from there at the adapted frequency.
    It has no uncertainty.

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
                phase, omega, state = _adapt(signal, phase, omega, state)
        self.frequency_ = omega
        self._coefficients = state
        least_size = max(2 * round(2 * np.pi / omega), 8)
        least_size = min(least_size, max(map(len, recordings)) - 1)
        self._dmp = PeriodicDMP()
        self._dmp.fit([y for y in recordings if len(y) > least_size])

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D)."""
        signal = (past - self._mean) @ self._axis
        grid = np.linspace(0, 2 * np.pi, 60, endpoint=False)
        steps = self.frequency_ * np.arange(len(past))
        series = _fourier_series(self._coefficients, grid[:, None] + steps)
        slope_errors = np.diff(series, axis=1) - np.diff(signal)
        errors = np.concatenate([series - signal, 3 * slope_errors], axis=1)
        first = grid[int(np.argmin(np.sum(errors**2, axis=1)))]
        _, omega, _ = _adapt(
            signal, first, self.frequency_, self._coefficients, learning_rate=0.0
        )
        # A tenth of a period hardly determines its frequency.
        limit = 0.2 * self.frequency_
        omega = float(np.clip(omega, self.frequency_ - limit, self.frequency_ + limit))
        return Forecast(values=self._dmp.continued(past, horizon, frequency=omega))


def _fourier_series(coefficients: Array, phase: Array) -> Array:
    """Return the series of coefficients a_1 .. a_5, b_1 .. b_5 at phases (...,)."""
    k = np.arange(1, _HARMONICS + 1)
    angles = np.multiply.outer(phase, k)
    out: Array = np.cos(angles) @ coefficients[:_HARMONICS]
    out += np.sin(angles) @ coefficients[_HARMONICS:]
    return out


def _adapt(
    signal: Array,
    phase: float,
    omega: float,
    coefficients: Array,
    *,
    learning_rate: float = _LEARNING,
) -> tuple[float, float, Array]:
    """Run the oscillator on a signal (n,); return phase, frequency and coefficients."""
    k = np.arange(1, _HARMONICS + 1)
    coefficients = coefficients.copy()
    bounds = omega / _GREATEST_FACTOR, omega * _GREATEST_FACTOR
    dt = omega / _OSCILLATOR_SUBSTEPS  # Gains are per radian.
    count = (len(signal) - 1) * _OSCILLATOR_SUBSTEPS + 1
    times = np.arange(count) / _OSCILLATOR_SUBSTEPS
    for y in np.interp(times, np.arange(len(signal)), signal):
        basis = np.concatenate([np.cos(k * phase), np.sin(k * phase)])
        error = float(y - basis @ coefficients)
        push = -error * np.sin(phase)
        phase += omega / _OSCILLATOR_SUBSTEPS + _COUPLING * push * dt
        omega *= 1 + _ADAPTATION * push * dt
        omega = float(np.clip(omega, *bounds))
        coefficients += learning_rate * basis * error * dt
    return phase, omega, coefficients
