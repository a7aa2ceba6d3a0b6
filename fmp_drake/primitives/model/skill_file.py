"""Skill files: one fitted skill in one `.npz`, without pickle."""

from pathlib import Path
from typing import Any

import numpy as np

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import GREATEST, all_finite
from fmp_drake.primitives.data.file_format import FileFormat
from fmp_drake.primitives.model.fitted import build_skill
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive
from fmp_drake.primitives.model.phase.phase_file import (
    phase_arrays,
    phase_numbers,
    read_phase,
)

FORMAT = FileFormat(
    name="fmp-drake-skill",
    # 2 added the scales of the channels, which had been 1, and the rotation reference;
    # 3 the phase model.
    version=3,
    what="skill file",
    source="written by `save_skill` or `fmp-drake learn`",
    compressed=False,
)


def save_skill(skill: FourierMovementPrimitive, path: str | Path) -> None:
    """Write a fitted skill to a file; an existing one is replaced at the end."""
    skill.check_fitted()
    phase = skill.phase_model_
    metadata = {
        "parameters": skill.get_params(),
        "n_windows": skill.n_windows_,
        "channels": skill.channels_,
        "units": skill.units_,
        "frame": skill.frame_,
        "rotation_reference": skill.rotation_reference_,
        "model_reason": skill.model_reason_,
        "phase": None if phase is None else phase_numbers(phase),
    }
    FORMAT.write(
        Path(path),
        metadata,
        {
            "proportions": skill.proportions_,
            "extent": skill.extent_,
            "scales": skill.scales_,
            "paths": np.concatenate([np.empty((0, skill.n_channels_)), *skill.paths_]),
            "path_lengths": np.array([len(path) for path in skill.paths_], dtype=int),
            "means": np.stack([c.mean for c in skill.components_]),
            "ranks": np.array([c.rank for c in skill.components_]),
            "bases": np.concatenate([c.basis for c in skill.components_], axis=1),
            "variances": np.concatenate([c.variances for c in skill.components_]),
            "noise": np.array([c.noise for c in skill.components_]),
            **({} if phase is None else phase_arrays(phase)),
        },
    )


def load_skill(path: str | Path) -> FourierMovementPrimitive:
    """Read a fitted skill.

    Raises
    ------
    SkillFileError
        Where the file is missing, broken, foreign or from a newer version.
    """
    path = Path(path)
    metadata, arrays = FORMAT.read(path)
    try:
        fitted = _fitted(metadata, arrays)
        skill = build_skill(metadata["parameters"], fitted)
        skill.check_parameters()
        _check_arrays(skill)
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise SkillFileError(f"{path} is an incomplete skill file: {error}.") from None
    return skill


def _check_arrays(skill: FourierMovementPrimitive) -> None:
    """Raise SkillFileError where the arrays of a skill cannot come from a fit."""
    d, proportions = skill.n_channels_, skill.proportions_
    phase = skill.phase_model_
    if (
        skill.extent_.shape != (2, d)
        or skill.scales_.shape != (d,)
        or not np.all(skill.scales_ > 1 / GREATEST)
        or proportions.shape != (len(skill.components_),)
        or any(c.dim != d * skill.n_steps for c in skill.components_)
        or (phase is not None and not phase.fits(proportions.size, d, skill.n_steps))
    ):
        raise SkillFileError("its arrays do not fit together")
    for names in (skill.channels_, skill.units_):
        if len(names) != d or not all(isinstance(n, str) for n in names):
            raise SkillFileError("it does not have a name and a unit for each channel")
    if not (np.all(proportions > 0) and abs(proportions.sum() - 1) < 1e-6):
        raise SkillFileError("its proportions are not positive or do not add up to 1")
    for c in skill.components_:
        if np.max(np.abs(c.basis.T @ c.basis - np.eye(c.rank)), initial=0) > 1e-6:
            raise SkillFileError("the basis of a component is not orthonormal")


def _fitted(metadata: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the fitted attributes in a file."""
    for name, array in arrays.items():
        kinds = "i" if name in ("ranks", "path_lengths") else "fi"
        if array.dtype.kind not in kinds or not all_finite(array):
            raise SkillFileError(f"{name} holds something other than finite numbers")
    ends = np.cumsum(arrays["ranks"])
    components = tuple(
        LowRankGaussian(
            mean=mean,
            basis=np.ascontiguousarray(arrays["bases"][:, end - rank : end]),
            variances=arrays["variances"][end - rank : end],
            noise=float(noise),
        )
        for mean, rank, end, noise in zip(
            arrays["means"], arrays["ranks"], ends, arrays["noise"], strict=True
        )
    )
    extent = arrays["extent"]
    d = extent.shape[1]
    # Earlier files hold none: where their skills were demonstrated is not known.
    paths = arrays.get("paths", np.empty((0, d)))
    lengths = arrays.get("path_lengths", np.empty(0, dtype=int))
    fits = lengths.ndim == 1 and paths.shape == (int(lengths.sum()), d)
    if not fits or np.any(lengths < 1):
        raise SkillFileError("its demonstrated paths do not fit together")
    numbers = metadata.get("phase")
    phase = None if numbers is None else read_phase(numbers, arrays)
    reference = metadata.get("rotation_reference")
    if reference is not None:
        x, y, z, w = (float(q) for q in reference)
        reference = (x, y, z, w)
    return {
        "components_": components,
        "proportions_": arrays["proportions"],
        "model_": "mixture" if phase is None else "phase",
        "model_reason_": str(metadata.get("model_reason", "it was the only model")),
        "phase_model_": phase,
        "extent_": extent,
        "paths_": tuple(np.split(paths, np.cumsum(lengths)[:-1])) if len(paths) else (),
        "scales_": np.ones(d) if int(metadata["version"]) < 2 else arrays["scales"],
        "n_channels_": d,
        "n_windows_": int(metadata["n_windows"]),
        "channels_": tuple(metadata["channels"]),
        "units_": tuple(metadata["units"]),
        "frame_": str(metadata["frame"]),
        "rotation_reference_": reference,
    }
