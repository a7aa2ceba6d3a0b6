"""Skill files: one fitted skill in one `.npz` file, without pickle."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from fmp_drake.errors import SkillFileError
from fmp_drake.numeric import GREATEST, all_finite, as_path
from fmp_drake.primitives.data.files import FileFormat
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.movement_primitive import (
    FourierMovementPrimitive,
    build_skill,
)
from fmp_drake.primitives.model.phase.calibration import Calibration
from fmp_drake.primitives.model.phase.phase_model import PhaseModel
from fmp_drake.primitives.model.phase.rhythm import Part, Rhythm
from fmp_drake.primitives.model.trajectory_mixture import check_skill

FORMAT = FileFormat(
    name="fmp-drake-skill",
    # 2 added the scales of the channels, which had been 1, and the rotation reference;
    # 3 the phase model; 4 the rhythm.
    version=4,
    what="skill file",
    source="written by `save_skill` or `fmp-drake learn`",
    compressed=False,
)
# Arrays of a skill: name in the file and shape. The same letter is the same length in all
# arrays of a file.
_ARRAYS = (("extent", "2D"), ("scales", "D"), ("proportions", "M"), ("ranks", "M"))
# Arrays of a phase model: name in the file, attribute and shape.
_PHASE_ARRAYS = (
    ("phase_cycle", "cycle.coefficients", "hD"),
    ("phase_factors", "residual.factors", "GDD"),
    ("phase_residual", "residual.process.coefficients", "pDD"),
    ("phase_residual_innovation", "residual.process.innovation", "DD"),
    ("phase_tempo", "velocity.process.coefficients", "q11"),
    ("phase_tempo_innovation", "velocity.process.innovation", "11"),
    ("phase_anchors", "grid.phases", "M"),
    ("phase_spacing", "grid.cell_widths", "M"),
    ("phase_lengths", "history.lengths", "C"),
    ("phase_amplitudes", "history.amplitudes", "C"),
    ("phase_shifts", "history.shifts", "CD"),
)
# Numbers of a phase model: name in the metadata, attribute and type.
_PHASE_NUMBERS = (
    ("tempo", "velocity.mean", float),
    ("tempo_spread", "velocity.spread", float),
    ("pinned", "reference_step", int),
)
# Values of a calibration: name in the file, attribute and shape; "" is a number.
_CALIBRATION = (
    ("calibration_ahead", "horizons", "A"),
    ("calibration_factors", "factors", "A"),
    ("calibration_errors", "error_covariances", "ADD"),
    ("calibration_changes", "change_covariances", "ADD"),
    ("calibration_played", "playback_covariances", "ADD"),
    ("calibration_weight", "model_weight", ""),
    ("calibration_local", "local_factor", ""),
    ("calibration_degrees", "degrees_of_freedom", ""),
    ("calibration_background", "background_weight", ""),
)
# Length of each letter in the shapes of a file.
type _Sizes = dict[str, int]
type _Values = Mapping[str, Any]

_LENGTHS = {"paths": "path_lengths", "memory": "memory_lengths"}


def save_skill(skill: FourierMovementPrimitive, path: str | Path) -> None:
    """Write a fitted skill to a file; an existing file is replaced at the end."""
    check_skill(skill, "save_skill(skill, path)")
    phase = skill.phase_model_
    metadata = {
        "parameters": skill.get_params(),
        "n_steps": skill.n_steps,
        "overlap": skill.overlap,
        "n_windows": skill.n_windows_,
        "channels": skill.channels_,
        "units": skill.units_,
        "frame": skill.frame_,
        "rotation_reference": skill.rotation_reference_,
        "model_reason": skill.model_reason_,
        "rhythm": None if skill.rhythm_ is None else asdict(skill.rhythm_),
        "phase": None if phase is None else _values_of(phase, _PHASE_NUMBERS),
    }
    FORMAT.write(
        as_path(path, error=SkillFileError),
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
            **({} if phase is None else _values_of(phase, _PHASE_ARRAYS)),
            **_calibration_arrays(skill),
        },
    )


def load_skill(path: str | Path) -> FourierMovementPrimitive:
    """Read a fitted skill.

    Raises
    ------
    SkillFileError
        If the file is missing, broken, foreign or from a newer version.
    """
    path = as_path(path, error=SkillFileError)
    metadata, arrays = FORMAT.read(path)
    try:
        fitted = _fitted(metadata, arrays)
        skill = build_skill(_parameters(metadata, fitted), fitted)
        skill.check_parameters()
        _check_arrays(skill)
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise SkillFileError(f"{path} is an incomplete skill file: {error}.") from None
    return skill


def _check_arrays(skill: FourierMovementPrimitive) -> None:
    """Raise SkillFileError where the arrays of a skill cannot come from a fit."""
    d, proportions = skill.n_channels_, skill.proportions_
    phase, n_steps = skill.phase_model_, skill.n_steps
    if (
        not np.all(skill.scales_ > 1 / GREATEST)
        or any(c.dim != d * n_steps for c in skill.components_)
        # Only the window of a rhythm is shortened to its bouts.
        or (phase is None and skill.get_params()["n_steps"] not in (None, n_steps))
        or (phase is not None and not 0 <= phase.reference_step < n_steps)
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


def _parameters(
    metadata: Mapping[str, Any], fitted: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the parameters of the constructor; earlier versions had more choices."""
    parameters = dict(metadata["parameters"])
    parameters.pop("selection", None)
    if parameters.get("n_components") == "bic":
        parameters["n_components"] = len(fitted["components_"])
    return parameters


def _fitted(metadata: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the fitted attributes in a file."""
    for name, array in arrays.items():
        kinds = "i" if name in ("ranks", "path_lengths", "memory_lengths") else "fi"
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
    if int(metadata["version"]) < 2:
        arrays["scales"] = np.ones(arrays["extent"].shape[-1])
    sizes = {"1": 1, "2": 2}
    for name, shape in _ARRAYS:
        _check_shape(name, arrays[name], shape, sizes)
    d = sizes["D"]
    numbers = metadata.get("phase")
    phase = None if numbers is None else _phase_model(numbers, arrays, sizes)
    rhythm = metadata.get("rhythm")
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
        "extent_": arrays["extent"],
        "paths_": _paths(arrays, "paths", d),
        "scales_": arrays["scales"],
        "calibration_": _calibration(arrays, sizes),
        "memory_": _paths(arrays, "memory", d),
        "rhythm_": None if rhythm is None else _rhythm(rhythm),
        **{
            f"{name}_": int(metadata.get(name) or metadata["parameters"][name])
            for name in ("n_steps", "overlap")
        },
        "n_channels_": d,
        "n_windows_": int(metadata["n_windows"]),
        "channels_": tuple(metadata["channels"]),
        "units_": tuple(metadata["units"]),
        "frame_": str(metadata["frame"]),
        "rotation_reference_": reference,
    }


def _paths(arrays: Mapping[str, Any], name: str, channels: int) -> tuple[Any, ...]:
    """Return the paths (n, D) with a name in the file; earlier files contain none."""
    paths = arrays.get(name, np.empty((0, channels)))
    lengths = arrays.get(_LENGTHS[name], np.empty(0, dtype=int))
    fits = lengths.ndim == 1 and paths.shape == (int(lengths.sum()), channels)
    if not fits or np.any(lengths < 1):
        raise SkillFileError("its demonstrated paths do not fit together")
    return tuple(np.split(paths, np.cumsum(lengths)[:-1])) if len(paths) else ()


def _rhythm(values: Mapping[str, Any]) -> Rhythm:
    """Return the rhythm in the metadata of a skill file."""
    parts = {
        name: tuple(
            Part(**{**part, "cycle_ends": tuple(part.get("cycle_ends", ()))})
            for part in values[name]
        )
        for name in ("bouts", "left_out")
    }
    irregular = tuple(values.get("irregular", ()))
    return Rhythm(**{**values, **parts, "irregular": irregular})


def _calibration_arrays(skill: FourierMovementPrimitive) -> dict[str, Any]:
    """Return the calibration and the memory of a skill, by their names in a file."""
    out = {}
    for name, attribute, _ in _CALIBRATION:
        if (value := getattr(skill.calibration_, attribute, None)) is not None:
            out[name] = np.asarray(value)
    if skill.memory_:
        out["memory"] = np.concatenate(skill.memory_)
        out["memory_lengths"] = np.array([len(y) for y in skill.memory_])
    return out


def _calibration(arrays: Mapping[str, Any], sizes: _Sizes) -> Calibration | None:
    """Return the calibration in a file; of version 3 it has factors only."""
    values = {
        attribute: arrays[name] for name, attribute, _ in _CALIBRATION if name in arrays
    }
    if "phase_calibration" in arrays:
        table = arrays["phase_calibration"]
        _check_shape("phase_calibration", table, "A2", sizes)
        values = {"horizons": table[:, 0], "factors": np.maximum(table[:, 1], 1.0)}
    if "horizons" not in values:
        return None
    horizons, factors = values["horizons"], values["factors"]
    # Earlier files have factors alone, or errors that the components do not contain.
    if "change_covariances" not in values:
        zeros = np.zeros((horizons.size, sizes["D"], sizes["D"]))
        values |= dict.fromkeys(("error_covariances", "change_covariances"), zeros)
    for name, attribute, shape in _CALIBRATION:
        if attribute in values:
            _check_shape(name, values[attribute], shape, sizes)
            if not shape:
                values[attribute] = float(values[attribute])
    if not (horizons.size and np.all(np.diff(horizons) > 0) and np.all(factors > 0)):
        raise SkillFileError(
            "the horizons of its calibration must increase, and the factors be positive"
        )
    calibration = Calibration(**values)
    if not (
        0 <= calibration.model_weight <= 1
        and 0 <= calibration.local_factor <= 1
        and 0 <= calibration.background_weight < 1
        and calibration.degrees_of_freedom > 2
    ):
        raise SkillFileError("the numbers of its calibration are out of range")
    return calibration


def _check_shape(name: str, array: Any, shape: str, sizes: _Sizes) -> None:
    """Raise SkillFileError unless an array has a shape; new letters are added to sizes."""
    if array.ndim != len(shape) or any(
        sizes.setdefault(letter, length) != length
        for letter, length in zip(shape, array.shape, strict=True)
    ):
        raise SkillFileError(f"{name} has shape {array.shape}")


def _values_of(model: PhaseModel, table: Iterable[tuple[Any, ...]]) -> dict[str, Any]:
    """Return the attributes of a phase model that a table lists, by their names."""
    return {name: attrgetter(attribute)(model) for name, attribute, _ in table}


def _phase_model(numbers: _Values, arrays: _Values, sizes: _Sizes) -> PhaseModel:
    """Return the phase model in a skill file."""
    values: dict[str, Any] = {}
    for name, attribute, shape in _PHASE_ARRAYS:
        _check_shape(name, arrays[name], shape, sizes)
        values[attribute] = arrays[name]
    for name, attribute, kind in _PHASE_NUMBERS:
        values[attribute] = kind(numbers[name])
    forwards = values["velocity.mean"] > 0 and values["velocity.spread"] >= 0
    if not (forwards and sizes["h"] % 2 == 1):
        raise SkillFileError("its phase does not run forwards")
    model: PhaseModel = _object_of(PhaseModel, values)
    return model


def _object_of(of: type, values: Mapping[str, Any], path: str = "") -> Any:
    """Return an object of a type from its attributes, nested ones by dotted names."""
    attributes = {}
    for name, part in get_type_hints(of).items():
        dotted = path + name
        attributes[name] = (
            values[dotted]
            if dotted in values
            else _object_of(part, values, dotted + ".")
        )
    return of(**attributes)
