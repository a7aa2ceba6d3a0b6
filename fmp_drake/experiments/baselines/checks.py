"""Checks of what the models are given."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import DemonstrationError, SkillError


def checked_windows(
    windows: ArrayLike, *, shape: tuple[int, int] | None = None, at_least: int = 1
) -> NDArray[np.float64]:
    """Return windows (N, T, D) as numbers.

    Parameters
    ----------
    windows : array_like, shape (N, T, D)
    shape : tuple of int, optional
        The (T, D) that they must have.
    at_least : int
        The least N.
    """
    try:
        y = np.asarray(windows, dtype=float)
    except (TypeError, ValueError):
        raise DemonstrationError(
            f"{type(windows).__name__} cannot be learned from; give windows "
            "(windows, n_steps, channels)."
        ) from None
    expected = "n_steps, channels" if shape is None else f"{shape[0]}, {shape[1]}"
    if y.ndim != 3 or 0 in y.shape[1:] or (shape and y.shape[1:] != shape):
        raise DemonstrationError(
            f"the windows have shape {y.shape}; expected (windows, {expected})."
        )
    if len(y) < at_least:
        raise DemonstrationError(
            f"there are {len(y)} windows; at least {at_least} are needed."
        )
    if not np.all(np.isfinite(y)):
        raise DemonstrationError("the windows hold NaN or infinite numbers.")
    return y


def checked_keypoints(
    steps: ArrayLike, values: ArrayLike, *, n_steps: int, n_channels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return keypoints as steps (K,), from 0 to T - 1, and values (K, D)."""
    t = np.atleast_1d(np.asarray(steps, dtype=float))
    y = np.atleast_2d(np.asarray(values, dtype=float))
    if t.ndim != 1 or not len(t) or y.shape != (len(t), n_channels):
        raise SkillError(
            f"the keypoints have steps {t.shape} and values {y.shape}; expected (K,) "
            f"and (K, {n_channels}), at least one."
        )
    if not np.all((t >= 0) & (t <= n_steps - 1)):
        raise SkillError(
            f"a keypoint is at step {t[~((t >= 0) & (t <= n_steps - 1))][0]:g}; every "
            f"one must be from 0 to {n_steps - 1}."
        )
    if not np.all(np.isfinite(y)):
        raise SkillError("the keypoints hold NaN or infinite values.")
    return t, y


def checked_prefix(
    prefix: ArrayLike, horizon: int, *, n_channels: int, at_least: int = 1
) -> NDArray[np.float64]:
    """Return the samples (K, D) that a prediction starts from."""
    y = np.asarray(prefix, dtype=float)
    if y.ndim != 2 or len(y) < at_least or y.shape[1] != n_channels:
        raise SkillError(
            f"the prefix has shape {y.shape}; expected ({at_least} or more, "
            f"{n_channels})."
        )
    if not np.all(np.isfinite(y)):
        raise SkillError("the prefix holds NaN or infinite values.")
    if int(horizon) < 1:
        raise SkillError(f"the horizon is {horizon} samples; it must be at least 1.")
    return y


def checked_count(n: int, seed: int) -> None:
    """Raise SkillError where n samples of a seed cannot be drawn."""
    if int(n) < 0 or int(seed) < 0:
        raise SkillError(f"n is {n} and seed {seed}; neither may be negative.")


def check_ranges(model: Any, *ranges: tuple[str, str, bool]) -> None:
    """Raise SkillError for the first (parameter, what is allowed, fine) not fine."""
    for name, allowed, fine in ranges:
        if not fine:
            raise SkillError(
                f"{name} is {getattr(model, name)!r}; it must be {allowed}."
            )
