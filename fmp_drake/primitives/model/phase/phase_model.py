"""Phase model of a rhythmic movement: mean cycle, residual and phase velocity."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from fmp_drake.numeric import Array
from fmp_drake.primitives.model.basis import close_windows
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.phase.calibration import Calibration, calibrate
from fmp_drake.primitives.model.phase.components import (
    PhaseGrid,
    phase_components,
    phase_grid,
)
from fmp_drake.primitives.model.phase.cycle import Cycle, CycleHistory
from fmp_drake.primitives.model.phase.random_processes import PhaseVelocity, Residual
from fmp_drake.primitives.model.phase.tracking import PhaseTrack, phase_path

# Standard deviation of the phase of a movement at the reference step of the component that
# it is mapped to, rad; variance of white noise in the samples.
_PHASE_DEVIATION = 0.5
_NOISE = 1e-10
LEAST_COMPONENTS, _MOST_COMPONENTS = 30, 80
# With fewer cycles, more components gain nothing.
_FEW_CYCLES, _COMPONENTS_OF_FEW = 4.0, 40
_RANK = 160


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseModel:
    """Model y_t = f(phase_t) + L(phase_t) v_t with a varying phase velocity.

    Values are those of a skill divided by its scales.

    Attributes
    ----------
    cycle : Cycle
        f.
    residual : Residual
        L and v.
    velocity : PhaseVelocity
        Rad per sample.
    grid : PhaseGrid
        Phases of the M components of the skill at the sample `reference_step`.
    reference_step : int
        The sample of a window at which the phase of a component is defined.
    history : CycleHistory
        Statistics of the demonstrated whole cycles.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import FourierMovementPrimitive
    >>> rng = np.random.default_rng(0)
    >>> phase = np.cumsum(rng.normal(0.2, 0.01, 600))
    >>> path = np.column_stack([np.cos(phase), np.sin(phase)])
    >>> windows = np.stack([path[i : i + 120] for i in range(0, 480, 2)])
    >>> model = FourierMovementPrimitive(model="phase").fit(windows).phase_model_
    >>> print(round(model.period), model.cycles)
    31 18
    """

    cycle: Cycle
    residual: Residual
    velocity: PhaseVelocity
    grid: PhaseGrid
    reference_step: int
    history: CycleHistory

    @property
    def period(self) -> float:
        """The mean period, in samples."""
        return 2 * np.pi / self.velocity.mean

    @property
    def cycles(self) -> int:
        """The number of whole cycles that were demonstrated."""
        return len(self.history.lengths)

    def phase(self, values: Array) -> Array:
        """Return the unwrapped phase (n,) of consecutive samples (n, D), rad."""
        return phase_path(values, self.cycle, velocity=self.velocity.mean)

    def draw(
        self,
        rng: np.random.Generator,
        component: int,
        size: int,
        count: int,
        *,
        past: Array | None = None,
    ) -> tuple[Array, Array]:
        """Draw windows at the phase of a component, as two parts that add up.

        Parameters
        ----------
        rng : numpy.random.Generator
        component : int
            Index of its phase in the grid.
        size : int
        count : int
            Samples of a window.
        past : ndarray, shape (K, D), optional
            The first samples of the window, which the drawn windows continue.

        Returns
        -------
        centre, deviation : ndarray, shape (size, count, D)
            The cycle at a random phase velocity with the decaying residual of the past,
            and the new residual.
        """
        velocity, process = self.velocity, self.residual.process
        n_velocity = len(velocity.process.coefficients) + count - 1
        n_residual = len(process.coefficients) + count
        d = self.cycle.coefficients.shape[1]
        # One draw, so that the first window does not depend on the number of windows.
        normals = rng.standard_normal((size, 1 + n_velocity + n_residual * d))
        uniform, normals = normals[:, :1], normals[:, 1:]
        draws = normals[:, n_velocity:].reshape(size, n_residual, d)
        normals = normals[:, :n_velocity]
        if past is not None:
            known = len(past)
            return self._continued(
                past, component, normals[:, known - 1 :], draws[:, known:]
            )
        path = velocity.sample(normals, reference_step=self.reference_step)
        width = self.grid.cell_widths[component]
        path += self.grid.phases[component] + width * (ndtr(uniform) - 0.5)
        v = process.sample(draws)
        return self.cycle.values(path), self.residual.values(path, v)

    def expected(self, component: int, count: int, *, past: Array) -> Array:
        """Return the window (count, D) that continues its first samples (K, D).

        With the expected phase velocity and residual the cycle has its full size. The
        mean over all windows that begin in this way is smaller, because their phases
        spread.
        """
        later = count - len(past)
        d = self.cycle.coefficients.shape[1]
        normals = np.zeros((1, len(self.velocity.process.coefficients) + later))
        draws = np.zeros((1, len(self.residual.process.coefficients) + later, d))
        return self._continued(past, component, normals, draws)[0][0]

    def _continued(
        self, past: Array, component: int, normals: Array, draws: Array
    ) -> tuple[Array, Array]:
        """Return windows from normals of the velocity and of v; see `draw`."""
        start = self._past_phase(past, component)
        path = self.velocity.continued(normals, start)
        size, known = len(path), len(past)
        past_v = np.zeros((1 + size, *past.shape))
        past_v[0] = self.residual.standardised(start, past - self.cycle.values(start))
        v = self.residual.process.sample(
            np.concatenate([np.zeros_like(draws[:1]), draws]), past=past_v
        )
        centre = self.cycle.values(path)
        deviation = np.zeros_like(centre)
        centre[:, :known] = past
        centre[:, known:] += self.residual.values(path[:, known:], v[:1])
        deviation[:, known:] = self.residual.values(path[:, known:], v[1:])
        return close_windows(centre), close_windows(deviation)

    def _past_phase(self, past: Array, component: int) -> Array:
        """Return the most likely phases (K,) of the first samples (K, D) of a window.

        Near the phase of its component phase noise moves the samples along the cycle, so
        phases, residual and samples are jointly Gaussian; condition on the samples.
        """
        k, d = past.shape
        steps = np.arange(float(k)) - self.reference_step
        path = self.grid.phases[component] + self.velocity.mean * steps
        rates = self.cycle.values(path, 1)
        noise = self.velocity.phase_noise(k) + _PHASE_DEVIATION**2
        cross = noise[:, :, None] * rates
        v = self.residual.process.covariance(np.arange(k))
        covariance = self.residual.shaped_covariance(path, v) + _NOISE * np.eye(k * d)
        covariance += (rates[:, :, None, None] * cross[:, None]).reshape(k * d, k * d)
        error = (past - self.cycle.values(path)).ravel()
        return path + cross.reshape(k, k * d) @ np.linalg.solve(covariance, error)

    def transformed(self, matrix: Array, offset: Array) -> "PhaseModel":
        """Return the model of A y + b for a matrix (D, D) and an offset (D,)."""
        coefficients = self.cycle.coefficients @ matrix.T
        coefficients[0] += offset
        return replace(
            self,
            cycle=Cycle(coefficients=coefficients),
            residual=replace(self.residual, factors=matrix @ self.residual.factors),
            history=replace(self.history, shifts=self.history.shifts @ matrix.T),
        )


def fit_phase_model(
    track: PhaseTrack, *, n_steps: int, reference_step: int, most_components: int
) -> tuple[PhaseModel, tuple[LowRankGaussian, ...], Calibration]:
    """Return the phase model of tracked recordings, its components and their calibration.

    Parameters
    ----------
    track : PhaseTrack
        Of values divided by the scales of a skill.
    n_steps : int
        T, samples in a window.
    reference_step : int
        The sample of a window at which the phase of a component is defined: the last
        sample that is observed when a skill is played.
    most_components : int
    """
    track = track.with_smooth_cycle()
    velocity = PhaseVelocity.fit(track.phases)
    residual = Residual.fit(track.phases, track.residuals())
    most = _MOST_COMPONENTS if track.cycles >= _FEW_CYCLES else _COMPONENTS_OF_FEW
    count = int(np.clip(round(2 * np.pi / velocity.mean), LEAST_COMPONENTS, most))
    grid = phase_grid(track, min(count, most_components))
    calibration = calibrate(track, grid, n_steps=n_steps, reference_step=reference_step)
    later = calibration.at(n_steps - reference_step)
    components = phase_components(
        track,
        residual,
        grid,
        n_steps=n_steps,
        reference_step=reference_step,
        factors=later.factors,
        errors=later.error_covariances,
        rank=_RANK,
    )
    model = PhaseModel(
        cycle=track.cycle,
        residual=residual,
        velocity=velocity,
        grid=grid,
        reference_step=reference_step,
        history=track.history,
    )
    return model, components, calibration
