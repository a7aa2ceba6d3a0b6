"""One cycle of a movement as a function of its phase."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Ridge of a harmonic k is _RIDGE (k / _KNEE)^4 per sample.
_RIDGE = 1e-7
_KNEE = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycle:
    """A closed curve over the phase: a Fourier series of each channel.

    Attributes
    ----------
    coefficients : ndarray, shape (1 + 2 h, D)
        Of 1, cos(phase), sin(phase), cos(2 phase), ... sin(h phase).

    Examples
    --------
    >>> import numpy as np
    >>> phase = np.linspace(0, 6, 50)
    >>> circle = np.column_stack([np.cos(phase), np.sin(phase)])
    >>> Cycle.fit(phase, circle, harmonics=3).values([np.pi / 2]).round(3) + 0.0
    array([[0., 1.]])
    """

    coefficients: NDArray[np.float64]

    @classmethod
    def fit(
        cls, phase: NDArray[np.float64], values: NDArray[np.float64], *, harmonics: int
    ) -> "Cycle":
        """Return the cycle through values (n, D) at phases (n,), by least squares."""
        rows = _rows(phase, harmonics, 0)
        order = np.repeat(np.arange(1, harmonics + 1), 2)
        ridge = _RIDGE * len(phase) * np.concatenate([[0.0], (order / _KNEE) ** 4])
        gram = rows.T @ rows + np.diag(ridge)
        solution = np.linalg.solve(gram, rows.T @ values)
        return cls(coefficients=np.ascontiguousarray(solution))

    def values(self, phase: ArrayLike, derivative: int = 0) -> NDArray[np.float64]:
        """Return the values at phases (...), or a derivative by the phase, (..., D)."""
        harmonics = len(self.coefficients) // 2
        return _rows(np.asarray(phase, dtype=float), harmonics, derivative) @ (
            self.coefficients
        )

    def folds(self, tolerance: float) -> int:
        """Return of how many equal cycles it consists, up to a fraction of its variance."""
        energy = np.sum(self.coefficients[1:] ** 2, axis=1).reshape(-1, 2).sum(axis=1)
        order = np.arange(1, len(energy) + 1)
        for folds in (5, 4, 3, 2):
            if energy[order % folds != 0].sum() < tolerance * energy.sum():
                return folds
        return 1


def _rows(
    phase: NDArray[np.float64], harmonics: int, derivative: int
) -> NDArray[np.float64]:
    out = np.empty((*phase.shape, 1 + 2 * harmonics))
    out[..., 0] = derivative == 0
    # Products of a turn take a fifth of the time of sines and cosines of each order.
    turn = np.exp(1j * phase)
    turned = np.full_like(turn, 1j**derivative)
    for order in range(1, harmonics + 1):
        turned *= turn
        out[..., 2 * order - 1] = order**derivative * turned.real
        out[..., 2 * order] = order**derivative * turned.imag
    return out
