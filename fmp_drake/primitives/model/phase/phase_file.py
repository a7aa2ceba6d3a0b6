"""A phase model as the arrays and numbers of a skill file."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.model.phase.autoregression import Autoregression
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.history import CycleHistory
from fmp_drake.primitives.model.phase.phase_model import PhaseModel
from fmp_drake.primitives.model.phase.residual import Residual
from fmp_drake.primitives.model.phase.tempo import Tempo


def phase_arrays(model: PhaseModel) -> dict[str, NDArray[np.float64]]:
    """Return the arrays of a phase model, by the names that a skill file gives them."""
    return {
        "phase_cycle": model.cycle.coefficients,
        "phase_factors": model.residual.factors,
        "phase_residual": model.residual.process.coefficients,
        "phase_residual_innovation": model.residual.process.innovation,
        "phase_tempo": model.tempo.process.coefficients,
        "phase_tempo_innovation": model.tempo.process.innovation,
        "phase_anchors": model.anchors,
        "phase_spacing": model.spacing,
        "phase_calibration": model.calibration,
        "phase_lengths": model.history.lengths,
        "phase_amplitudes": model.history.amplitudes,
        "phase_shifts": model.history.shifts,
    }


def phase_numbers(model: PhaseModel) -> dict[str, float]:
    """Return the numbers of a phase model, for the metadata of a skill file."""
    return {
        "tempo": model.tempo.mean,
        "tempo_spread": model.tempo.spread,
        "pinned": model.pinned,
        "paused": model.paused,
        "approach": model.approach,
    }


def read_phase(
    numbers: Mapping[str, Any], arrays: Mapping[str, NDArray[np.float64]]
) -> PhaseModel:
    """Return the phase model in a skill file.

    Raises
    ------
    SkillFileError
        Where the arrays cannot come from a fit.
    """
    cycle = arrays["phase_cycle"]
    d = cycle.shape[1]
    count, cycles = arrays["phase_anchors"].size, arrays["phase_lengths"].size
    for name, shape in (
        ("phase_factors", (-1, d, d)),
        ("phase_residual", (-1, d, d)),
        ("phase_residual_innovation", (d, d)),
        ("phase_tempo", (-1, 1, 1)),
        ("phase_tempo_innovation", (1, 1)),
        ("phase_anchors", (count,)),
        ("phase_spacing", (count,)),
        ("phase_calibration", (-1, 2)),
        ("phase_lengths", (cycles,)),
        ("phase_amplitudes", (cycles,)),
        ("phase_shifts", (cycles, d)),
    ):
        found = arrays[name].shape
        if len(found) != len(shape) or any(
            want not in (-1, have) for want, have in zip(shape, found, strict=True)
        ):
            raise SkillFileError(f"{name} has shape {found}")
    tempo = float(numbers["tempo"])
    if not (tempo > 0 and float(numbers["tempo_spread"]) >= 0 and len(cycle) % 2 == 1):
        raise SkillFileError("its phase does not run forwards")
    ahead, widening = arrays["phase_calibration"].T
    if not (ahead.size and np.all(np.diff(ahead) > 0) and np.all(widening > 0)):
        raise SkillFileError("its predictions have no covariances")
    return PhaseModel(
        cycle=Cycle(coefficients=cycle),
        residual=Residual(
            factors=arrays["phase_factors"],
            process=Autoregression(
                coefficients=arrays["phase_residual"],
                innovation=arrays["phase_residual_innovation"],
            ),
        ),
        tempo=Tempo(
            mean=tempo,
            spread=float(numbers["tempo_spread"]),
            process=Autoregression(
                coefficients=arrays["phase_tempo"],
                innovation=arrays["phase_tempo_innovation"],
            ),
        ),
        anchors=arrays["phase_anchors"],
        spacing=arrays["phase_spacing"],
        pinned=int(numbers["pinned"]),
        calibration=arrays["phase_calibration"],
        history=CycleHistory(
            lengths=arrays["phase_lengths"],
            amplitudes=arrays["phase_amplitudes"],
            shifts=arrays["phase_shifts"],
        ),
        paused=float(numbers["paused"]),
        approach=float(numbers["approach"]),
    )
