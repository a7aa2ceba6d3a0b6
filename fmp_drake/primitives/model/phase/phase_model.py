"""A movement whose phase is an angle: cycle, residual and tempo."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from fmp_drake.numeric import finite_array
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.history import CycleHistory
from fmp_drake.primitives.model.phase.path import phase_path
from fmp_drake.primitives.model.phase.residual import Residual
from fmp_drake.primitives.model.phase.tempo import Tempo

# How far from its anchor a component is at most entered, rad.
_FARTHEST = 0.5


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
    anchors: NDArray[np.float64]
    spacing: NDArray[np.float64]
    pinned: int
    calibration: NDArray[np.float64]
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

    def widening(self, horizon: int) -> NDArray[np.float64]:
        """Return what covariances of the next samples are multiplied by, (horizon,)."""
        return np.interp(np.arange(1, horizon + 1), *self.calibration.T)

    def phase(self, values: ArrayLike) -> NDArray[np.float64]:
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
        past: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
            The first samples of the window: their phase and tempo go on.

        Returns
        -------
        centre, deviation : ndarray, shape (size, count, D)
            The cycle, with a tempo that varies, and the residual.
        """
        d = self.cycle.coefficients.shape[1]
        of_tempo = len(self.tempo.process.coefficients) + count - 1
        of_residual = len(self.residual.process.coefficients) + count
        # In one draw, so that the first sample is the same, however many there are.
        normals = rng.standard_normal((size, 1 + of_tempo + of_residual * d))
        within = self.spacing[component] * (ndtr(normals[:, :1]) - 0.5)
        begin = None
        if past is not None:
            within, begin = self._passing(past, component)
        path = self.tempo.sample(
            normals[:, 1 : 1 + of_tempo], pinned=self.pinned, begin=begin
        )
        path += self.anchors[component] + within
        v = normals[:, 1 + of_tempo :].reshape(size, of_residual, d)
        v = self.residual.process.sample(v)
        deviation = (self.residual.factor(path) @ v[..., None])[..., 0]
        return self.cycle.values(path), deviation

    def _passing(
        self, past: NDArray[np.float64], component: int
    ) -> tuple[float, float]:
        """Return how far a window gets past an anchor, rad, and at which tempo."""
        steps = np.arange(float(len(past))) - self.pinned
        path = self.anchors[component] + self.tempo.mean * steps
        along = self.cycle.values(path, 1)
        # By how much the phase differs from the path: a straight line in time.
        rows = np.stack([along, along * steps[:, None]], axis=-1).reshape(-1, 2)
        off = (past - self.cycle.values(path)).ravel()
        ahead, faster = np.linalg.lstsq(rows, off)[0]
        ahead = np.clip(ahead, -_FARTHEST, _FARTHEST)
        return float(ahead), self.tempo.mean + float(faster)

    def transformed(
        self, matrix: NDArray[np.float64], offset: NDArray[np.float64]
    ) -> "PhaseModel":
        """Return the model of A y + b, for a matrix (D, D) and an offset (D,)."""
        coefficients = self.cycle.coefficients @ matrix.T
        coefficients[0] += offset
        return replace(
            self,
            cycle=Cycle(coefficients=coefficients),
            residual=replace(self.residual, factors=matrix @ self.residual.factors),
            history=replace(self.history, shifts=self.history.shifts @ matrix.T),
        )
