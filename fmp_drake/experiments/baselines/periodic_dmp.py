"""Periodic dynamic movement primitives with an adaptive frequency."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import DemonstrationError
from fmp_drake.experiments.baselines.checks import (
    check_ranges,
    checked_count,
    checked_keypoints,
    checked_prefix,
    checked_windows,
)
from fmp_drake.experiments.baselines.joining import joined_recordings
from fmp_drake.experiments.baselines.oscillators import entrain
from fmp_drake.experiments.baselines.trajectory_model import Conditioned

_SMOOTHING = 7  # Samples of the Savitzky-Golay filter that differentiates.
_SUBSTEPS = 4
_CYCLE_POINTS = 400


class PeriodicDMP(BaseEstimator):  # type: ignore[misc]
    """A rhythmic DMP whose frequency an adaptive oscillator finds.

    The two layers of Gams et al. (2009): a pool of oscillators finds frequency Omega and
    phase phi of the raw signal (see `entrain`); then each channel is::

        dz / dt = Omega (alpha (beta (g - y) - z) + f(phi))
        dy / dt = Omega z
        dphi / dt = Omega
        f(phi) = sum_i psi_i w_i / sum_i psi_i,  psi_i = exp(h (cos(phi - c_i) - 1))

    One limit cycle, to which it converges from any start. There is no distribution: a
    sample is the limit cycle from another phase, and there is no density.

    Parameters
    ----------
    n_bases : int
        Kernels psi_i of a period.
    alpha, beta : float
        Gains; beta = alpha / 4 is critically damped. Gams et al. take 8 and 2.
    ridge : float
        Of the least squares for the w_i.

    Attributes
    ----------
    n_steps_, n_channels_ : int
        T and D.
    frequency_ : float
        Omega, rad per sample.
    goal_ : ndarray, shape (D,)
        g, the mean of the signal.
    weights_ : ndarray, shape (n_bases, D)

    References
    ----------
    A. J. Ijspeert et al., "Dynamical movement primitives: learning attractor models for
    motor behaviors", Neural Computation 25(2), 2013.
    A. Gams et al., "On-line learning and modulation of periodic movements with nonlinear
    dynamical systems", Autonomous Robots 27(1), 2009.
    """

    def __init__(
        self,
        *,
        n_bases: int = 25,
        alpha: float = 8.0,
        beta: float = 2.0,
        ridge: float = 1e-6,
    ) -> None:
        self.n_bases = n_bases
        self.alpha = alpha
        self.beta = beta
        self.ridge = ridge

    def fit(self, windows: ArrayLike) -> Self:
        """Learn from windows (N, T, D), joined to the recordings they come from."""
        check_ranges(
            self,
            ("n_bases", "at least 3", self.n_bases >= 3),
            ("alpha", "positive", self.alpha > 0),
            ("beta", "positive", self.beta > 0),
            ("ridge", "positive", self.ridge > 0),
        )
        y = checked_windows(windows)
        if y.shape[1] < 2 * _SMOOTHING:
            raise DemonstrationError(
                f"the windows have {y.shape[1]} samples; at least {2 * _SMOOTHING} are "
                "needed."
            )
        recordings = joined_recordings(y)
        found = entrain(recordings, slowest=1.3 * y.shape[1])
        self.frequency_ = omega = found.frequency
        self.goal_ = np.concatenate(recordings).mean(axis=0)
        forces = []
        for recording in recordings:
            smooth, velocity, acceleration = (
                savgol_filter(recording, _SMOOTHING, 3, deriv=order, axis=0)
                for order in range(3)
            )
            pull = self.beta * (self.goal_ - smooth) - velocity / omega
            forces.append(acceleration / omega**2 - self.alpha * pull)
        psi = self._kernels(np.concatenate(found.phases))
        normal = psi.T @ psi + self.ridge * len(psi) * np.eye(self.n_bases)
        self.weights_ = np.linalg.solve(normal, psi.T @ np.concatenate(forces))
        self.n_steps_, self.n_channels_ = y.shape[1:]
        self._find_cycle()
        return self

    def rollout(
        self,
        start: ArrayLike,
        n_steps: int,
        *,
        phase: float = 0.0,
        velocity: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """Integrate from a start (D,) at a phase: shape (n_steps, D).

        Parameters
        ----------
        start : array_like, shape (D,)
        n_steps : int
            Samples, the start included.
        phase : float
            rad.
        velocity : array_like, shape (D,), optional
            Per sample; at rest where None.
        """
        self.check_fitted()
        y = checked_prefix(np.atleast_2d(start), n_steps, n_channels=self.n_channels_)[
            0
        ]
        z = (
            np.zeros_like(y)
            if velocity is None
            else np.asarray(velocity) / self.frequency_
        )
        state = np.stack([y, z])
        out = np.empty((n_steps, self.n_channels_))
        h = self.frequency_ / _SUBSTEPS  # Of the phase.
        halves = phase + 0.5 * h * np.arange(2.0 * _SUBSTEPS * n_steps)
        forces = self._kernels(halves) @ self.weights_
        for t in range(n_steps):
            out[t] = state[0]
            for s in range(_SUBSTEPS if t < n_steps - 1 else 0):
                at = 2 * (t * _SUBSTEPS + s)
                k1 = self._slope(state, forces[at])
                k2 = self._slope(state + 0.5 * h * k1, forces[at + 1])
                k3 = self._slope(state + 0.5 * h * k2, forces[at + 1])
                k4 = self._slope(state + h * k3, forces[at + 2])
                state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return out

    def cycle(self, phases: ArrayLike) -> NDArray[np.float64]:
        """Return the limit cycle at phases (...,) in rad, shape (..., D)."""
        self.check_fitted()
        return self._cycle(np.mod(phases, 2 * np.pi))

    def sample(self, n: int = 1, *, seed: int = 0) -> NDArray[np.float64]:
        """Return the limit cycle from n random phases, shape (n, T, D).

        This is all that can vary: a DMP has no distribution of shapes.
        """
        self.check_fitted()
        checked_count(n, seed)
        first = np.random.default_rng(seed).uniform(0, 2 * np.pi, n)
        return self.cycle(first[:, None] + self.frequency_ * np.arange(self.n_steps_))

    def log_density(self, windows: ArrayLike) -> None:  # noqa: ARG002 - the interface
        """Return None: a DMP has no density."""
        self.check_fitted()

    def condition(self, steps: ArrayLike, values: ArrayLike) -> Conditioned:
        """Start at the first of the keypoints; the others choose only the phase.

        The phase is that at which the limit cycle is nearest to all keypoints. Before the
        first keypoint the mean is the limit cycle. There is no covariance.
        """
        self.check_fitted()
        steps, y = checked_keypoints(
            steps, values, n_steps=self.n_steps_, n_channels=self.n_channels_
        )
        order = np.argsort(steps)
        steps, y = steps[order], y[order]
        phase = self._nearest_phase(steps, y)
        out = self.cycle(phase + self.frequency_ * np.arange(self.n_steps_))
        first = int(np.ceil(steps[0]))
        # On the cycle's own velocity, from the keypoint's place.
        out[first:] = self.rollout(
            y[0],
            self.n_steps_ - first,
            phase=phase + self.frequency_ * first,
            velocity=self._cycle_velocity(phase + self.frequency_ * first),
        )
        return Conditioned(
            mean=out, covariance=None, component=0, responsibilities=np.ones(1)
        )

    def predict(self, prefix: ArrayLike, horizon: int) -> NDArray[np.float64]:
        """Continue samples (K, D) from the last one, its velocity and their phase."""
        self.check_fitted()
        y = checked_prefix(prefix, horizon, n_channels=self.n_channels_)
        steps = np.arange(len(y), dtype=float)
        phase = self._nearest_phase(steps, y) + self.frequency_ * steps[-1]
        velocity = y[-1] - y[-2] if len(y) > 1 else self._cycle_velocity(phase)
        return self.rollout(y[-1], horizon + 1, phase=phase, velocity=velocity)[1:]

    def check_fitted(self) -> None:
        """Raise scikit-learn's NotFittedError before `fit`."""
        check_is_fitted(self, "weights_")

    def _kernels(self, phases: NDArray[np.floating]) -> NDArray[np.float64]:
        centres = 2 * np.pi * np.arange(self.n_bases) / self.n_bases
        # Neighbours cross at about 0.7.
        sharpness = 2.5 * (self.n_bases / (2 * np.pi)) ** 2
        psi = np.exp(sharpness * (np.cos(phases[:, None] - centres) - 1))
        return psi / psi.sum(axis=1, keepdims=True)

    def _slope(
        self, state: NDArray[np.float64], force: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        y, z = state
        return np.stack([z, self.alpha * (self.beta * (self.goal_ - y) - z) + force])

    def _find_cycle(self) -> None:
        """Integrate until nothing is left of the start; keep the last period."""
        per_period = 2 * np.pi / self.frequency_
        settle = int(np.ceil(4 * per_period))
        path = self.rollout(self.goal_, settle + int(np.ceil(per_period)) + 4)
        phases = self.frequency_ * np.arange(len(path))
        spline = CubicSpline(phases, path)
        start = 2 * np.pi * 4
        grid = np.linspace(0, 2 * np.pi, _CYCLE_POINTS + 1)
        points = spline(start + grid)
        points[-1] = points[0]
        self._cycle = CubicSpline(grid, points, bc_type="periodic")

    def _cycle_velocity(self, phase: float) -> NDArray[np.float64]:
        return self.frequency_ * self._cycle(np.mod(phase, 2 * np.pi), 1)

    def _nearest_phase(
        self, steps: NDArray[np.float64], values: NDArray[np.float64]
    ) -> float:
        """Return the phase at step 0 at which the cycle is nearest to values (K, D)."""
        grid = 2 * np.pi * np.arange(_CYCLE_POINTS) / _CYCLE_POINTS
        error = self.cycle(grid[:, None] + self.frequency_ * steps) - values
        return float(grid[np.argmin(np.sum(error**2, axis=(1, 2)))])
