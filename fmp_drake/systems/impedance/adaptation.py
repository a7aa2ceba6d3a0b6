"""The stiffness, as far as the inputs change it."""

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import inlined
from fmp_drake.systems.impedance.packing import (
    ImpedanceMemory,
    StepInputs,
)
from fmp_drake.systems.impedance.settings import ImpedanceSettings
from fmp_drake.systems.impedance.status import StatusFlag
from fmp_drake.systems.impedance.stiffness import (
    admit_stiffness,
    filter_fraction,
    is_covariance,
    is_spring,
    stiffness_from_covariance,
)

Array = NDArray[np.float64]

# Plain integers, because compiled functions take no enumerations.
_STIFFNESS_REFUSED = int(StatusFlag.STIFFNESS_REFUSED)
_TANK_EMPTY = int(StatusFlag.TANK_EMPTY)


@inlined
def next_stiffness(
    settings: ImpedanceSettings,
    memory: ImpedanceMemory,
    inputs: StepInputs,
    error: Array,
) -> tuple[Array, float, int]:
    """Return K, the energy left in the tank, and flags."""
    config, K, energy = settings.config, settings.stiffness.copy(), memory.tank_energy
    if not (inputs.has_stiffness or inputs.has_covariance):
        return K, energy, 0
    present = memory.stiffness
    if not inputs.finite:
        return present, energy, 0
    if inputs.has_stiffness:
        K = 0.5 * (inputs.stiffness + inputs.stiffness.T)
        if not is_spring(inputs.stiffness):
            return present, energy, _STIFFNESS_REFUSED
    if inputs.has_covariance:
        if not is_covariance(inputs.covariance):
            return present, energy, _STIFFNESS_REFUSED
        K = stiffness_from_covariance(config.covariance_stiffness, inputs.covariance, K)
    passed = filter_fraction(config.control_period, config.stiffness_time_constant)
    K, energy, held_back = admit_stiffness(
        present, present + passed * (K - present), error, energy
    )
    return K, energy, _TANK_EMPTY * held_back
