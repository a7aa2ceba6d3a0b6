"""Normalised von Mises basis functions: (21) of the paper."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import ExperimentError
from fmp_drake.numeric import check_number


@dataclass(frozen=True, kw_only=True)
class VonMisesBasis:
    """Normalised von Mises bases of one or several frequencies.

    (21) is read so: z_t = t / T is the time in windows, f is in cycles per window, and
    the n centres of a frequency are c_i = i / (n f), i = 0 to n - 1. So the angles
    2 pi f c_i are uniform over [0, 2 pi), the end left out, where it would repeat the
    first ("uniformly placed between 0 and 2 pi"; in the time of z_t itself they would
    lie anywhere). The sum in the denominator is over the bases of the same frequency;
    with several frequencies (ProMP-VM-Mult) the bases of each sum to one.

    For a large width h a basis is a cosine: b_i ~ 1 + cos(.) / h, and
    Phi_i ~ (1 + cos(.) / h) / n. What remains of harmonic k falls like h^-k.

    Attributes
    ----------
    frequencies : tuple of float
        f, cycles per window.
    n_bases : int
        n, of each frequency.
    width : float
        h of (21).

    Examples
    --------
    >>> basis = VonMisesBasis(frequencies=(1.0, 2.0), n_bases=5)
    >>> basis.rows([0.0, 0.25, 0.5]).shape
    (3, 10)

    References
    ----------
    A. Paraschos et al., "Probabilistic movement primitives", NIPS 2013; "Using
    probabilistic movement primitives in robotics", Autonomous Robots 42(3), 2018.
    """

    frequencies: tuple[float, ...]
    n_bases: int = 20
    width: float = 100.0

    def __post_init__(self) -> None:
        """Check the parameters."""
        for frequency in self.frequencies:
            check_number(frequency, "a frequency", above=0.0, error=ExperimentError)
        if not self.frequencies:
            raise ExperimentError("there are no frequencies; give at least one.")
        check_number(
            self.n_bases, "n_bases", least=3, whole=True, error=ExperimentError
        )
        check_number(self.width, "width", above=0.0, error=ExperimentError)

    def rows(self, z: ArrayLike) -> NDArray[np.float64]:
        """Return all B bases (21) at times z (K,), in windows, shape (K, B)."""
        f = np.asarray(self.frequencies, dtype=float)
        centres = np.arange(self.n_bases) / self.n_bases  # f c_i, in periods
        periods = np.multiply.outer(np.asarray(z, dtype=float), f)[..., None]
        # Divided by exp(1 / h), which the normalisation cancels.
        b = np.exp((np.cos(2 * np.pi * (periods - centres)) - 1) / self.width)
        b /= b.sum(axis=-1, keepdims=True)
        return b.reshape(len(b), -1)
