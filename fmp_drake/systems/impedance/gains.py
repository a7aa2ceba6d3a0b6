"""The gains and clips of the impedance law."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import StationError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class ImpedanceGains:
    """Everything that the law needs besides the arm's state and the target.

    Parameters
    ----------
    stiffness : array, shape (6, 6)
        K, symmetric and positive definite: Nm/rad, N/m and, in the blocks that
        couple them, Nm/m = N/rad. Expressed in T. A copy is kept, read-only.
    damping_ratio : float
        ζ of every mode of the end effector.
    posture_frequency : float
        Natural frequency of the motion inside the nullspace, in rad/s: the
        posture's stiffness is ``M ω²``. Zero leaves damping out as well.
    posture_damping_ratio : float
        ζ of the motion inside the nullspace.
    max_rotation_error, max_translation_error, max_posture_error : float
        Lengths, in rad, m and rad, to which the errors are shortened before the
        stiffness sees them.
    max_effective_mass : float
        Largest eigenvalue of Λ that is used, in kg; rotations are made
        comparable by `characteristic_length`. It bounds Λ at singularities.
    characteristic_length : float
        The length in m that turns a rotation into a displacement.
    """

    stiffness: Array
    damping_ratio: float
    posture_frequency: float
    posture_damping_ratio: float
    max_rotation_error: float
    max_translation_error: float
    max_posture_error: float
    max_effective_mass: float
    characteristic_length: float

    def __post_init__(self) -> None:
        """Refuse a stiffness that is no spring, and keep a read-only copy."""
        K = np.array(self.stiffness, dtype=float)
        if K.shape != (6, 6) or not np.all(np.isfinite(K)):
            raise StationError(
                f"stiffness must be finite numbers of shape (6, 6), got shape "
                f"{K.shape}:\n{K}"
            )
        asymmetry = np.abs(K - K.T).max()
        smallest = np.linalg.eigvalsh(K)[0]
        if asymmetry > 1e-9 * np.abs(K).max() or smallest <= 0:
            raise StationError(
                "stiffness must be symmetric and positive definite, got smallest "
                f"eigenvalue {smallest:g} and asymmetry {asymmetry:g}"
            )
        K.setflags(write=False)
        object.__setattr__(self, "stiffness", K)
