"""Variable stiffness, from a covariance or a port, with an energy tank."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array
from fmp_drake.settings import bounded
from fmp_drake.systems.impedance.algebra import (
    applied,
    cholesky,
    dot,
    largest,
    product,
    solve_lower,
)
from fmp_drake.systems.impedance.controller_status import StatusFlag


@dataclass(kw_only=True)
class CovarianceStiffnessConfig:
    """Minimal intervention: stiff where the demonstrations agree, compliant elsewhere.

    Attributes
    ----------
    enabled : bool
        Whether the port `covariance` is used.
    min_stiffness, max_stiffness : float
        Bounds of every eigenvalue, N/m.
    deviation : float
        Standard deviation at which the stiffness is midway between its bounds, m.
    axes : list of 3 bools
        Axes of T along which the stiffness follows the covariance; the others keep
        theirs. By default without the normal, along which the force is controlled, not
        the position.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> soft = CovarianceStiffnessConfig(enabled=True, min_stiffness=200.0)
    >>> ImpedanceConfig(covariance_stiffness=soft).covariance_stiffness.deviation
    0.02
    """

    enabled: bool = False
    min_stiffness: float = bounded(300.0, above=0)
    max_stiffness: float = bounded(1500.0, above=0)
    deviation: float = bounded(0.02, above=0)
    axes: list[bool] = bounded([True, True, False])

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        if self.max_stiffness >= self.min_stiffness:
            return ""
        return (
            f"covariance_stiffness.max_stiffness is {self.max_stiffness} N/m; it must "
            f"be at least min_stiffness, {self.min_stiffness} N/m."
        )


@dataclass(kw_only=True)
class EnergyTankConfig:
    """Energy that a variable stiffness may bring into the motion.

    Attributes
    ----------
    initial_energy, capacity : float
        Energy in the tank at the start, and its maximum, J. A stretched spring that is
        made stiffer stores more energy, which the tank supplies: whatever the changes
        of the stiffness, the environment gains at most the `capacity`.
    stored_fraction : float
        Part of the power dissipated by the controller's damping that is stored.

    Examples
    --------
    >>> from fmp_drake.systems import ImpedanceConfig
    >>> ImpedanceConfig(tank=EnergyTankConfig(initial_energy=0.2)).tank.capacity
    1.0
    """

    initial_energy: float = bounded(0.5, least=0)
    capacity: float = bounded(1.0, least=0)
    stored_fraction: float = bounded(0.9, least=0, most=1)

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        if self.initial_energy <= self.capacity:
            return ""
        return (
            f"tank.initial_energy is {self.initial_energy} J; it must be at most "
            f"tank.capacity, {self.capacity} J."
        )


@compiled
def stiffness_from_covariance(
    config: CovarianceStiffnessConfig, covariance: Array, stiffness: Array
) -> Array:
    """Turn the covariance of the desired position into a stiffness.

    ``K = k_min I + (k_max − k_min) (I + Σ / σ²)⁻¹``: between the bounds it falls as
    the precision ``Σ⁻¹`` of the minimal-intervention principle; it has Σ's
    axes; it is smooth in Σ; and ``k_min I ≤ K ≤ k_max I`` for every covariance.

    Parameters
    ----------
    config : CovarianceStiffnessConfig
    covariance : array, shape (3, 3)
        Σ of the desired p_TE, in T, m². Positive semidefinite.
    stiffness : array, shape (6, 6)
        Of the directions that do not follow the covariance, in T.

    Returns
    -------
    array, shape (6, 6)
        K, in T.

    References
    ----------
    .. [1] S. Calinon, D. Bruno, D. G. Caldwell, "A task-parameterized probabilistic
       model with minimal intervention control", ICRA 2014.
    """
    chosen, span = config.axes, config.max_stiffness - config.min_stiffness
    # Axes that are not chosen are left out of Σ.
    precision = np.eye(3)
    for i in range(3):
        for j in range(3):
            part = chosen[i] * chosen[j] / config.deviation**2
            precision[i, j] += part * covariance[i, j]
    L, _ = cholesky(precision)
    root = solve_lower(L, np.eye(3))
    inverse = product(root.T, root)
    K = stiffness.copy()
    for i in range(3):
        if chosen[i]:
            for j in range(6):
                K[3 + i, j] = K[j, 3 + i] = 0.0
    for i in range(3):
        for j in range(3):
            if chosen[i] and chosen[j]:
                K[3 + i, 3 + j] = span * inverse[i, j]
        if chosen[i]:
            K[3 + i, 3 + i] += config.min_stiffness
    return K


@compiled
def symmetric(A: Array) -> Array:
    """Return the symmetric part of a matrix."""
    S = np.empty(A.shape)
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            S[i, j] = 0.5 * (A[i, j] + A[j, i])
    return S


@compiled
def between(A: Array, B: Array, fraction: float) -> Array:
    """Return the matrix between A (fraction 0) and B (fraction 1)."""
    C = np.empty(A.shape)
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            C[i, j] = A[i, j] + fraction * (B[i, j] - A[i, j])
    return C


@compiled
def is_positive_definite(stiffness: Array) -> bool:
    """Return whether a matrix is symmetric, positive definite and finite."""
    size = largest(stiffness)
    for i in range(len(stiffness)):
        for j in range(i):
            if not abs(stiffness[i, j] - stiffness[j, i]) <= 1e-6 * size:
                return False
    return cholesky(stiffness)[1]


@compiled
def is_covariance(covariance: Array) -> bool:
    """Return whether a matrix is symmetric and positive semidefinite, up to rounding."""
    shift = 1e-6 * max(largest(covariance), 1e-12)
    shifted = covariance.copy()
    for i in range(3):
        shifted[i, i] += shift
    return is_positive_definite(shifted)


@compiled
def filter_fraction(period: float, time_constant: float) -> float:
    """Return the fraction of a step that a low-pass filter passes in one period (s)."""
    return 1 - math.exp(-period / time_constant) if time_constant > 0 else 1.0


@compiled
def admit_stiffness(
    stiffness: Array, desired: Array, error: Array, energy: float
) -> tuple[Array, float, bool]:
    """Change a stiffness towards another one as far as the energy allows.

    A change ``ΔK`` of the stiffness of a spring that is stretched by ``e`` needs the
    energy ``½ eᵀ ΔK e``. Where the tank has less, only the part of ``ΔK`` that it can
    supply is admitted. Energy that a softer spring releases is not stored.

    Parameters
    ----------
    stiffness, desired : array, shape (6, 6)
        Present and desired K; the result is between them, so it is positive definite,
        too.
    error : array, shape (6,)
        e, rad and m.
    energy : float
        In the tank, J.

    Returns
    -------
    stiffness : array, shape (6, 6)
    energy : float
        Remaining energy, J.
    held_back : bool
        Whether the tank was too empty.

    References
    ----------
    .. [1] F. Ferraguti, C. Secchi, C. Fantuzzi, "A tank-based approach to impedance
       control with variable stiffness", ICRA 2013.
    """
    change = desired - stiffness
    cost = 0.5 * dot(error, applied(change, error))
    if cost <= energy:
        return desired, energy - max(cost, 0.0), False
    return stiffness + (energy / cost) * change, 0.0, True


@compiled
def next_stiffness(
    settings: Any,
    memory: np.record,
    inputs: np.record,
    error: Array,
) -> tuple[Array, float, int]:
    """Return the stiffness of the next update, from the ports that are used.

    Parameters
    ----------
    settings : ImpedanceSettings
        Of the controller.
    memory, inputs : record
        Of the types `MEMORY` and `PACKED`.
    error : array, shape (6,)
        Of the pose, rad and m.

    Returns
    -------
    stiffness : array, shape (6, 6)
        K, in T.
    energy : float
        Left in the tank, J.
    flags : int
        `StatusFlag.STIFFNESS_REFUSED` or `StatusFlag.TANK_EMPTY`, or 0.
    """
    config, K, energy = settings.config, settings.stiffness[:], memory.tank_energy
    if not (inputs.has_stiffness > 0 or inputs.has_covariance > 0):
        return K, energy, 0
    present = memory.stiffness[:]
    if not inputs.finite:
        return present, energy, 0
    if inputs.has_stiffness:
        given, bounds = inputs.stiffness[:], config.watchdog
        K = symmetric(given)
        if not is_positive_definite(given):
            return present, energy, StatusFlag.STIFFNESS_REFUSED.value
        for i in range(3):
            if (
                K[i, i] > bounds.max_rotational_stiffness
                or K[3 + i, 3 + i] > bounds.max_stiffness
            ):
                return present, energy, StatusFlag.STIFFNESS_REFUSED.value
    if inputs.has_covariance:
        covariance = inputs.covariance[:]
        if not is_covariance(covariance):
            return present, energy, StatusFlag.STIFFNESS_REFUSED.value
        K = stiffness_from_covariance(config.covariance_stiffness, covariance, K)
    fraction = filter_fraction(config.control_period, config.stiffness_time_constant)
    K, energy, held_back = admit_stiffness(
        present, between(present, K, fraction), error, energy
    )
    return K, energy, StatusFlag.TANK_EMPTY.value * held_back


@compiled
def refill(config: EnergyTankConfig, energy: float, dissipated: float) -> float:
    """Return the tank energy after storing a part of the dissipated energy, J."""
    return min(energy + config.stored_fraction * dissipated, config.capacity)
