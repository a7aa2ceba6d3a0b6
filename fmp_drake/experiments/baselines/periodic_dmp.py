"""Periodic dynamic movement primitives."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.signal import StateSpace, lsim, savgol_filter

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines.alignment import align_periods, movement_period
from fmp_drake.experiments.baselines.method import (
    Array,
    Forecast,
    Method,
    long_enough,
)

_BASES = 25  # Kernels psi_i of a period.
# Gains; beta = alpha / 4 is critically damped. Gams et al. take these.
_ALPHA, _BETA = 8.0, 2.0
_RIDGE = 1e-6  # Of the least squares for the w_i.
_SUBSTEPS = 12  # Points of the integration for each sample.
_POINTS = 400  # Of a period.
_SMOOTHING = 41  # Of them, in the Savitzky-Golay filter that differentiates.
_SETTLING = 4  # Periods until nothing is left of a start.


class PeriodicDMP(Method):
    """A rhythmic dynamic movement primitive: one attracting limit cycle.

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
                mean, _SMOOTHING, 3, deriv=order, delta=phases[1], axis=0, mode="wrap"
            )
            for order in range(3)
        )
        forces = ddy - _ALPHA * (_BETA * (self.goal_ - y) - dy)
        psi = self._kernels(phases[:-1])
        normal = psi.T @ psi + _RIDGE * len(psi) * np.eye(_BASES)
        self.weights_ = np.linalg.solve(normal, psi.T @ forces)
        several = phases[1] * np.arange((_SETTLING + 1) * _POINTS + 1)
        last = self._integrate(self.goal_, 0 * self.goal_, several)[-_POINTS - 1 :]
        last[-1] = last[0]
        self._cycle = CubicSpline(phases, last, bc_type="periodic")

    def rollout(
        self,
        start: ArrayLike,
        n_steps: int,
        *,
        phase: float = 0.0,
        velocity: ArrayLike | None = None,
        frequency: float | None = None,
    ) -> Array:
        """Integrate from a start (D,) at a phase: shape (n_steps, D).

        Parameters
        ----------
        start : array_like, shape (D,)
        n_steps : int
            Samples, the start included.
        phase : float
            rad.
        velocity : array_like, shape (D,), optional
            Per sample; zero where None.
        frequency : float, optional
            rad per sample; that of the recordings where None.
        """
        y = np.asarray(start, dtype=float)
        z = np.zeros(len(y)) if velocity is None else np.asarray(velocity)
        frequency = frequency or self.frequency_
        step = frequency / _SUBSTEPS
        phases = phase + step * np.arange((n_steps - 1.0) * _SUBSTEPS + 1)
        return self._integrate(y, z / frequency, phases)[::_SUBSTEPS]

    def cycle(self, phases: ArrayLike) -> Array:
        """Return the limit cycle at phases (...,) in rad, shape (..., D)."""
        return self._cycle(phases)

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (K, D)."""
        return Forecast(values=self.continued(past, horizon, frequency=self.frequency_))

    def play(self, past: Array, count: int, *, seed: int) -> Array:  # noqa: ARG002
        """Return the movement that converges to the limit cycle."""
        return self.continued(past, count, frequency=self.frequency_)

    def continued(self, prefix: Array, horizon: int, *, frequency: float) -> Array:
        """Continue samples (K, D) from the last one, its velocity and their phase.

        Parameters
        ----------
        prefix : ndarray, shape (K, D)
        horizon : int
            Samples to return.
        frequency : float
            rad per sample.
        """
        steps = frequency * np.arange(len(prefix))
        grid = 2 * np.pi * np.arange(_POINTS) / _POINTS
        error = self.cycle(grid[:, None] + steps) - prefix
        phase = grid[np.argmin(np.sum(error**2, axis=(1, 2)))] + steps[-1]
        velocity = frequency * self._cycle(phase, 1)
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
        psi = np.exp(sharpness * (np.cos(phases[:, None] - centres) - 1))
        return psi / psi.sum(axis=1, keepdims=True)

    def _integrate(
        self,
        y: Array,
        z: Array,
        phases: Array,
    ) -> Array:
        """Return the movement at evenly spaced phases (P,), shape (P, D)."""
        stiffness, damping = _ALPHA * _BETA, _ALPHA
        system = StateSpace([[0, 1], [-stiffness, -damping]], [[0], [1]], [[1, 0]], 0)
        forces = self._kernels(phases) @ self.weights_
        error = y - self.goal_
        out = [
            np.atleast_1d(lsim(system, force, phases - phases[0], [e, speed])[1])
            for force, e, speed in zip(forces.T, error, z, strict=True)
        ]
        return self.goal_ + np.stack(out, axis=1)


def _mean_period(
    recordings: list[Array],
) -> tuple[float, Array]:
    """Return the mean duration, samples, and the mean period, (_POINTS, D).

    Of less than two aligned periods it is the last one, closed by a linear correction.
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
