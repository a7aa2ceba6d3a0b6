"""Scores of a method: prediction of the next second, and playback of a minute."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from fmp_drake.errors import DemonstrationError
from fmp_drake.experiments.baselines.alignment import movement_period
from fmp_drake.experiments.baselines.method import RATE, Array, Method
from fmp_drake.experiments.benchmark.splits import Movement, Split, instants
from fmp_drake.experiments.metrics import inside_ellipsoids

# Steps at which the coverage of the 95 % ellipsoids is measured: 0.25, 0.5 and 1 s.
STEPS = (5, 10, 20)
PLAYED_SECONDS = 60.0
# Seconds of a playback that are not judged, and the distance from the demonstrated path,
# relative to the size of the movement, up to which a playback stays with it.
_SETTLING = 10.0
_NEAR = 0.15


def score_predictions(
    method: Method, split: Split, *, most: int
) -> dict[str, float | None]:
    """Score the predictions of a fitted method on the held-out parts of a split.

    Returns
    -------
    dict of str to float or None
        `error_mm`, rms over the next second; `log_density`, nats per sample, mean over
        the second; `inside_5`, `inside_10`, `inside_20`, fractions of true samples in the
        95 % ellipsoids. None where the method has no uncertainty.
    """
    errors, densities, inside = [], [], []
    for past, truth in instants(split.held, most):
        forecast = method.predict(past, len(truth))
        off = truth - forecast.values
        errors.append(float(np.mean(np.sum(off**2, axis=1))))
        if forecast.covariances is None:
            continue
        densities.append(float(np.mean(forecast.log_densities(truth))))
        at = np.array(STEPS) - 1
        inside.append(inside_ellipsoids(off[at], forecast.covariances[at]))
    scores: dict[str, float | None] = {
        "error_mm": 1e3 * float(np.sqrt(np.mean(errors))),
        "log_density": float(np.mean(densities)) if densities else None,
    }
    fractions = np.mean(inside, axis=0) if inside else [None] * len(STEPS)
    for step, fraction in zip(STEPS, fractions, strict=True):
        scores[f"inside_{step}"] = None if fraction is None else float(fraction)
    return scores


def score_playback(
    method: Method, movement: Movement, split: Split, *, seed: int
) -> dict[str, Any] | None:
    """Score a minute that a fitted method plays from a held-out part.

    Returns
    -------
    dict or None
        `stays`, fraction of samples near the demonstrated path; `size` and `tempo`,
        relative to the demonstrated ones; `variety`, the difference of successive
        cycles, relative to the demonstrated one (1 is as varied as the person). None
        where the method cannot play.
    """
    past = split.held[0][:10]
    path = method.play(past, round(PLAYED_SECONDS * RATE), seed=seed)
    if path is None:
        return None
    if not np.all(np.isfinite(path)):
        return {"stays": 0.0, "size": None, "tempo": None, "variety": None}
    path = path[round(_SETTLING * RATE) :]
    samples = np.concatenate(movement.parts)
    size = _size([samples])
    distance = KDTree(samples).query(path)[0]
    scores: dict[str, Any] = {
        "stays": float(np.mean(distance < _NEAR * size)),
        "size": _size([path]) / size,
        "tempo": None,
        "variety": None,
    }
    try:
        period = movement_period([path])
    except DemonstrationError:
        return scores
    scores["tempo"] = movement.period / period
    shown = _variation(movement.parts, movement.period)
    played = _variation([path], period)
    if shown is not None and played is not None:
        scores["variety"] = played / shown
    return scores


def _size(parts: Sequence[Array]) -> float:
    """Return the standard deviation of positions about their mean, m."""
    return float(np.sqrt(np.sum(np.var(np.concatenate(list(parts)), axis=0))))


def _variation(parts: Sequence[Array], period: float) -> float | None:
    """Return the rms distance of samples to the path one cycle later, m.

    The later sample is the nearest within a quarter of a period about it, so that tempo
    does not count.
    """
    lags = np.arange(0.75 * period, 1.25 * period, 0.05)
    distances = []
    for y in parts:
        count = len(y) - int(np.ceil(lags[-1]))
        if count > 0:
            times = lags[:, None] + np.arange(count)
            later = CubicSpline(np.arange(len(y)), y)(times)
            off = np.sum((later - y[:count]) ** 2, axis=2)
            distances.append(off.min(axis=0))
    if not distances:
        return None
    return float(np.sqrt(np.mean(np.concatenate(distances))))
