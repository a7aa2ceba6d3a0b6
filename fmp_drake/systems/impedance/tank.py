"""The energy tank that a varying stiffness draws on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(kw_only=True)
class EnergyTankConfig:
    """How much energy a varying stiffness may bring into the motion.

    Attributes
    ----------
    initial_energy, capacity : float
        In the tank at the start, and at most, J. A stretched spring that is made
        stiffer has more energy: the contact never gets more than the `capacity`
        out of it beyond what it brought in and was dissipated.
    share : float
        Part of the power dissipated by the controller's damping that is stored.
    """

    initial_energy: float = 0.5
    capacity: float = 1.0
    share: float = 0.9


def admit_stiffness(
    stiffness: Array, wanted: Array, *, error: Array, energy: float
) -> tuple[Array, float, bool]:
    """Go from one stiffness towards another as far as the energy allows.

    Stretching by ``e`` a spring whose stiffness changes by ``ΔK`` costs
    ``½ eᵀ ΔK e``. Where the tank has less, only the part of ``ΔK`` that it can pay
    is admitted; what a softer spring releases is lost, not stored.

    Parameters
    ----------
    stiffness, wanted : array, shape (6, 6)
        Present and wanted K; the result is between them, thus a spring as well.
    error : array, shape (6,)
        e, rad and m.
    energy : float
        In the tank, J.

    Returns
    -------
    stiffness : array, shape (6, 6)
    energy : float
        What is left, J.
    held_back : bool
        Whether the tank was too empty.

    References
    ----------
    .. [1] F. Ferraguti, C. Secchi, C. Fantuzzi, "A tank-based approach to impedance
       control with variable stiffness", ICRA 2013.
    """
    change = wanted - stiffness
    cost = 0.5 * float(np.dot(error, np.dot(change, error)))
    if cost <= energy:
        return wanted, energy - max(cost, 0.0), False
    return stiffness + (energy / cost) * change, 0.0, True


def refill(config: EnergyTankConfig, energy: float, *, dissipated: float) -> float:
    """Store a part of what the damping has dissipated, J, up to the capacity."""
    return min(energy + config.share * dissipated, config.capacity)
