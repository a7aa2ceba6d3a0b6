"""A movement whose phase is an angle: cycle, residual and tempo."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from fmp_drake.numeric import finite_array
from fmp_drake.primitives.model.phase.closing import closed
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.history import CycleHistory
from fmp_drake.primitives.model.phase.path import phase_path
from fmp_drake.primitives.model.phase.residual import Residual
from fmp_drake.primitives.model.phase.tempo import Tempo

Array = NDArray[np.float64]

# Standard deviation of how far from its anchor a component is entered, rad, and variance
# of samples beside all that is modelled.
_FARTHEST = 0.5
_NOISE = 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseModel:
    """y_t = f(phase_t) + L(phase_t) v_t, with a phase that runs at a varying tempo.

    Values are those of a skill divided by its scales.

    Attributes
    ----------
    cycle : Cycle
        f.
    residual : Residual
        L and v.
    tempo : Tempo
        Of the phase, per sample.
    anchors : ndarray, shape (M,)
        The phase of each component of the skill at the sample `pinned`, rad.
    spacing : ndarray, shape (M,)
        The width of the phases around each anchor that are nearest to it, rad.
    pinned : int
        The sample of a window at which a component knows the phase.
    calibration : ndarray, shape (A, 2)
        Samples ahead, and what covariances of predictions so far are multiplied by.
    history : CycleHistory
        Of the whole cycles that were learned from.
    paused, approach : float
        Samples of the recordings that were left out: the movement paused, or had not
        begun yet or was over.

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
    tempo: Tempo
    anchors: Array
    spacing: Array
    pinned: int
    calibration: Array
    history: CycleHistory
    paused: float
    approach: float

    @property
    def period(self) -> float:
        """The mean period, in samples."""
        return 2 * np.pi / self.tempo.mean

    @property
    def cycles(self) -> int:
        """How many whole cycles were learned from."""
        return len(self.history.lengths)

    def fits(self, components: int, channels: int, n_steps: int) -> bool:
        """Return whether it can be that of a skill of so many of each."""
        shape = self.cycle.coefficients.shape[1], self.anchors.shape
        return shape == (channels, (components,)) and 0 <= self.pinned < n_steps

    def widening(self, horizon: int) -> Array:
        """Return what covariances of the next samples are multiplied by, (horizon,)."""
        return np.interp(np.arange(1, horizon + 1), *self.calibration.T)

    def phase(self, values: ArrayLike) -> Array:
        """Return the unwrapped phase (n,) of consecutive samples (n, D), rad."""
        y = finite_array(values, "the values", ("n", self.cycle.coefficients.shape[1]))
        return phase_path(y, self.cycle, tempo=self.tempo.mean)

    def draw(
        self,
        rng: np.random.Generator,
        component: int,
        size: int,
        count: int,
        *,
        past: Array | None = None,
    ) -> tuple[Array, Array]:
        """Draw windows at the phase of a component, as two parts to be added.

        Parameters
        ----------
        rng : numpy.random.Generator
        component : int
            Index of its anchor.
        size : int
        count : int
            Samples of a window.
        past : ndarray, shape (K, D), optional
            The first samples of the window: their phase, tempo and residual go on, up to
            where it is `closed`.

        Returns
        -------
        centre, deviation : ndarray, shape (size, count, D)
            The cycle, with a tempo that varies, and what is left of the past's residual;
            the residual that is new.
        """
        tempo, process = self.tempo, self.residual.process
        of_tempo = len(tempo.process.coefficients) + count - 1
        of_residual = len(process.coefficients) + count
        d = self.cycle.coefficients.shape[1]
        # In one draw, so that the first sample is the same, however many there are.
        normals = rng.standard_normal((size, 1 + of_tempo + of_residual * d))
        place, normals = normals[:, :1], normals[:, 1:]
        of_v = normals[:, of_tempo:].reshape(size, of_residual, d)
        normals = normals[:, :of_tempo]
        if past is not None:
            known = len(past)
            return self._going_on(
                past, component, normals[:, known - 1 :], of_v[:, known:]
            )
        path = tempo.sample(normals, pinned=self.pinned)
        path += self.anchors[component] + self.spacing[component] * (ndtr(place) - 0.5)
        return self.cycle.values(path), self.residual.values(path, process.sample(of_v))

    def expected(self, component: int, count: int, *, past: Array) -> Array:
        """Return how the first samples of a window (K, D) go on, shape (count, D).

        With the tempo and the residual that are expected, the cycle has its full size. The
        mean over all windows that begin so is smaller, as their phases spread.
        """
        later = count - len(past)
        d = self.cycle.coefficients.shape[1]
        normals = np.zeros((1, len(self.tempo.process.coefficients) + later))
        of_v = np.zeros((1, len(self.residual.process.coefficients) + later, d))
        return self._going_on(past, component, normals, of_v)[0][0]

    def _going_on(
        self, past: Array, component: int, normals: Array, of_v: Array
    ) -> tuple[Array, Array]:
        """Return windows of standard normals of the tempo and the residual; see `draw`."""
        begun = self._begun(past, component)
        path = self.tempo.going_on(normals, begun)
        size, known = len(path), len(past)
        kept = np.zeros((1 + size, *past.shape))
        kept[0] = self.residual.standardised(begun, past - self.cycle.values(begun))
        v = self.residual.process.sample(
            np.concatenate([np.zeros_like(of_v[:1]), of_v]), past=kept
        )
        centre = self.cycle.values(path)
        deviation = np.zeros_like(centre)
        centre[:, :known] = past
        centre[:, known:] += self.residual.values(path[:, known:], v[:1])
        deviation[:, known:] = self.residual.values(path[:, known:], v[1:])
        return closed(centre), closed(deviation)

    def _begun(self, past: Array, component: int) -> Array:
        """Return the likeliest phases (K,) of the first samples (K, D) of a window.

        Near its anchor a phase that strays moves the samples along the cycle, so phases,
        residual and samples are Gaussian together: the first are conditioned on the last.
        """
        k, d = past.shape
        steps = np.arange(float(k)) - self.pinned
        path = self.anchors[component] + self.tempo.mean * steps
        along = self.cycle.values(path, 1)
        straying = self.tempo.straying(k) + _FARTHEST**2
        moved = straying[:, :, None] * along
        v = self.residual.process.covariance(np.arange(k))
        seen = self.residual.formed(path, v) + _NOISE * np.eye(k * d)
        seen += (along[:, :, None, None] * moved[:, None]).reshape(k * d, k * d)
        off = (past - self.cycle.values(path)).ravel()
        out: Array = path + moved.reshape(k, k * d) @ np.linalg.solve(seen, off)
        return out

    def transformed(self, matrix: Array, offset: Array) -> "PhaseModel":
        """Return the model of A y + b, for a matrix (D, D) and an offset (D,)."""
        coefficients = self.cycle.coefficients @ matrix.T
        coefficients[0] += offset
        return replace(
            self,
            cycle=Cycle(coefficients=coefficients),
            residual=replace(self.residual, factors=matrix @ self.residual.factors),
            history=replace(self.history, shifts=self.history.shifts @ matrix.T),
        )
