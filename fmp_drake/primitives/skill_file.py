"""Skill files: one fitted skill in one `.npz`, without pickle."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from fmp_drake.errors import FmpError, SkillFileError
from fmp_drake.primitives.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.movement_primitive import FourierMovementPrimitive
from fmp_drake.primitives.npz_file import read_npz, write_npz

FORMAT = "fmp-drake-skill"
VERSION = 1


def save_skill(skill: FourierMovementPrimitive, path: str | Path) -> None:
    """Write a fitted skill to a file; an existing one is replaced at the end."""
    skill.check_fitted()
    path = Path(path)
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "parameters": skill.get_params(),
        "n_windows": skill.n_windows_,
        "channels": skill.channels_,
        "units": skill.units_,
        "frame": skill.frame_,
    }
    write_npz(
        path,
        {
            "metadata": np.array(json.dumps(metadata, default=_plain)),
            "proportions": skill.proportions_,
            "extent": skill.extent_,
            "means": np.stack([c.mean for c in skill.components_]),
            "ranks": np.array([c.rank for c in skill.components_]),
            "bases": np.concatenate([c.basis for c in skill.components_], axis=1),
            "variances": np.concatenate([c.variances for c in skill.components_]),
            "noise": np.array([c.noise for c in skill.components_]),
        },
    )


def _plain(value: Any) -> Any:
    """Return a NumPy number, as a parameter search sets them, as Python's own."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} cannot be written to a skill file.")


def load_skill(path: str | Path) -> FourierMovementPrimitive:
    """Read a fitted skill.

    Raises
    ------
    SkillFileError
        Where the file is missing, broken, foreign or from a newer version.
    """
    path = Path(path)
    if not path.is_file():
        raise SkillFileError(f"there is no skill file {path}.")
    foreign = f"{path} is not a skill of fmp_drake; write one with `save_skill`."
    arrays = read_npz(
        path, "a skill file is written by `save_skill` or `fmp-drake learn`"
    )
    try:
        metadata = json.loads(str(arrays["metadata"]))
        if metadata["format"] != FORMAT:
            raise SkillFileError(foreign)
        version = int(metadata["version"])
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, FmpError):
            raise
        raise SkillFileError(foreign) from None
    if version > VERSION:
        raise SkillFileError(
            f"{path} has version {version}; this fmp_drake reads up to version "
            f"{VERSION}. Update fmp_drake."
        )
    try:
        skill = FourierMovementPrimitive(**metadata["parameters"])
        ends = np.cumsum(arrays["ranks"])
        skill.components_ = tuple(
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
        skill.proportions_ = arrays["proportions"]
        skill.extent_ = arrays["extent"]
        skill.n_channels_ = skill.extent_.shape[1]
        skill.n_windows_ = int(metadata["n_windows"])
        skill.channels_ = tuple(metadata["channels"])
        skill.units_ = tuple(metadata["units"])
        skill.frame_ = str(metadata["frame"])
        skill.check_parameters()
        d, m = skill.n_channels_, len(skill.components_)
        if (
            skill.extent_.shape != (2, d)
            or skill.proportions_.shape != (m,)
            or any(c.dim != d * skill.n_steps for c in skill.components_)
        ):
            raise SkillFileError("its arrays do not fit together")
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise SkillFileError(f"{path} is an incomplete skill file: {error}.") from None
    return skill
