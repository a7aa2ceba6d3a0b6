"""How close a learned distribution is to the demonstrated one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError


def heatmap(
    trajectories: ArrayLike,
    *,
    bins: int,
    extent: ArrayLike,
    channels: Sequence[int] = (0, 1),
) -> NDArray[np.float64]:
    """Return the share of samples in each cell of a grid (Fig. 8 of the paper).

    Parameters
    ----------
    trajectories : array_like, shape (..., D)
    bins : int
        Cells along each of the two axes.
    extent : array_like, shape (2, 2)
        Least and greatest value, of the first and of the second channel. Samples
        outside count in the nearest cell.
    channels : sequence of int
        The two channels.

    Returns
    -------
    ndarray, shape (bins, bins)
        Summing to 1; the first axis is the first channel.
    """
    values = np.asarray(trajectories, dtype=float)
    if bins < 1 or values.size == 0:
        raise SkillError(
            f"bins is {bins} and there are {values.size} values; both must be positive."
        )
    low, high = np.asarray(extent, dtype=float).T
    if not np.all(high > low):
        raise SkillError(
            f"the extent is {extent!r}; each second number must be greater."
        )
    points = values.reshape(-1, values.shape[-1])[:, list(channels)]
    cells = np.floor((points - low) / (high - low) * bins).astype(int)
    cells = np.clip(cells, 0, bins - 1)
    counts = np.bincount(cells[:, 0] * bins + cells[:, 1], minlength=bins * bins)
    return counts.reshape(bins, bins) / len(points)


def kl_divergence(p: ArrayLike, q: ArrayLike, *, floor: float) -> float:
    """Return D_KL(P || Q) = sum P log(P / Q) of two heatmaps, in nats.

    With P learned and Q demonstrated this is the paper's forward divergence, with
    P and Q exchanged its reverse one (section V-C).

    Parameters
    ----------
    p, q : array_like
        Of the same shape, each summing to 1.
    floor : float
        Added to every cell of both before they are normalised anew, positive: an empty
        cell would make the divergence infinite.
    """
    a, b = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    if a.shape != b.shape or not floor > 0:
        raise SkillError(
            f"the heatmaps have shapes {a.shape} and {b.shape} and floor is {floor}; "
            "the shapes must agree and the floor must be positive."
        )
    a, b = (a + floor) / np.sum(a + floor), (b + floor) / np.sum(b + floor)
    return float(np.sum(a * np.log(a / b)))
