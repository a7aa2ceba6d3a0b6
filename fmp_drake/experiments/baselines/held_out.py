"""Choosing parameters on held-out windows."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.experiments.baselines.checks import checked_windows
from fmp_drake.experiments.baselines.trajectory_model import TrajectoryModel


def best_on_held_out(
    candidates: Sequence[TrajectoryModel],
    training: ArrayLike,
    held_out: ArrayLike,
    *,
    score: Callable[[TrajectoryModel, NDArray[np.float64]], float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[TrajectoryModel, NDArray[np.float64]]:
    """Fit every candidate; return the one with the greatest held-out score.

    Parameters
    ----------
    candidates : sequence of TrajectoryModel
        They are fitted in place.
    training, held_out : array_like, shape (N, T, D)
    score : callable, optional
        Of a fitted model and the held-out windows, greater is better; the mean log
        density per time step where None.
    progress : callable, optional
        Told about every candidate.

    Returns
    -------
    best : TrajectoryModel
    scores : ndarray, shape (len(candidates),)
        -inf where a candidate could not be fitted or has no finite score.

    Raises
    ------
    SkillError
        Where no candidate has a score.
    """
    held = checked_windows(held_out)
    scores = np.full(len(candidates), -np.inf)
    for i, model in enumerate(candidates):
        try:
            model.fit(training)
            value = _density(model, held) if score is None else score(model, held)
        except SkillError:
            continue
        if np.isfinite(value):
            scores[i] = value
        if progress is not None:
            progress(f"{model!r}: {scores[i]:.3f}")
    if not np.any(np.isfinite(scores)):
        raise SkillError(
            f"none of the {len(candidates)} candidates has a finite score of the "
            "held-out windows; give models that have a density, or a score."
        )
    return candidates[int(np.argmax(scores))], scores


def _density(model: TrajectoryModel, windows: NDArray[np.float64]) -> float:
    densities = model.log_density(windows)
    return -np.inf if densities is None else float(np.mean(densities))
