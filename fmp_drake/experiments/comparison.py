"""Comparison of learned and demonstrated paths in section V: heatmaps, divergences, distances."""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.stats import entropy

from fmp_drake.numeric import Array
from fmp_drake.plots import draw_demonstrations_in_plane
from fmp_drake.plots.style import (
    DEMONSTRATED,
    PLAYED,
    same_limits,
    set_title,
    shape_of,
)
from fmp_drake.primitives import (
    PAPER_SETTINGS,
    Demonstration,
    FourierMovementPrimitive,
    Player,
)
from fmp_drake.primitives.data.windows import DEFAULT_RATE, as_windows

RATE = DEFAULT_RATE
N_STEPS = 120
FMP_STRIDE = FourierMovementPrimitive(n_steps=N_STEPS).window_stride
PAPER_STRIDE = int(PAPER_SETTINGS["stride"])

# Grid of Table I, which the paper does not state. The sensitivity study varies it.
BINS = 30
FLOOR = 1e-6
_MARGIN = 0.15


def cut(demonstrations: Sequence[Demonstration], *, stride: int) -> Array:
    """Return the windows of demonstrations, (N, T, D)."""
    return as_windows(demonstrations, n_steps=N_STEPS, stride=stride, rate=RATE).values


def play(skill: FourierMovementPrimitive, starts: ArrayLike, duration: float) -> Array:
    """Return the paths that Algorithm 2 plays from starts (S, D), (S, ticks, D)."""
    return Player(skill).rollout(np.atleast_2d(starts), duration)[:, :, 0]


def heatmap(trajectories: ArrayLike, *, bins: int, extent: ArrayLike) -> Array:
    """Return the fraction of samples in each cell of a grid (Fig. 8 of the paper).

    Parameters
    ----------
    trajectories : array_like, shape (..., D)
        Only the first two channels are used.
    bins : int
        Number of cells along each axis.
    extent : array_like, shape (2, 2)
        Least and greatest value of the first and of the second channel. Samples
        outside count in the nearest cell.

    Returns
    -------
    ndarray, shape (bins, bins)
        Fractions, whose sum is 1; the first axis is the first channel.
    """
    values = np.asarray(trajectories, dtype=float)
    box = np.asarray(extent, dtype=float)
    points = np.clip(values.reshape(-1, values.shape[-1])[:, :2], *box.T)
    x, y = points.T
    counts: Array = np.histogram2d(x, y, bins=bins, range=box)[0]
    return counts / len(points)


def kl_divergence(p: ArrayLike, q: ArrayLike, *, floor: float) -> float:
    """Return D_KL(P || Q) = sum P log(P / Q) of two heatmaps, in nats.

    With P learned and Q demonstrated this is the paper's forward divergence; the other way
    round it is the reverse one (section V-C).

    Parameters
    ----------
    p, q : array_like
        Heatmaps of the same shape, each of sum 1.
    floor : float
        Positive number that is added to every cell before both are normalised, because an
        empty cell would make the divergence infinite.
    """
    return float(entropy(np.asarray(p) + floor, np.asarray(q) + floor, axis=None))


def grid_extent(demonstrated: Array) -> Array:
    """Return the box of the first two channels, 15 % wider on every side, (2, 2)."""
    flat = demonstrated.reshape(-1, demonstrated.shape[-1])[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    margin = _MARGIN * (high - low)
    return np.stack([low - margin, high + margin], axis=1)


def divergences(
    learned: Array, demonstrated: Array, *, bins: int = BINS, floor: float = FLOOR
) -> tuple[float, float]:
    """Return the forward and the reverse KL divergence of section V-C, nats.

    The heatmaps cover the `grid_extent` of the demonstrated samples.
    """
    extent = grid_extent(demonstrated)
    p = heatmap(learned, bins=bins, extent=extent)
    q = heatmap(demonstrated, bins=bins, extent=extent)
    return kl_divergence(p, q, floor=floor), kl_divergence(q, p, floor=floor)


def draw_grids(demonstrated: Array, learned: Mapping[str, Array]) -> Figure:
    """Draw heatmaps of demonstrated and learned trajectories with one colour scale."""
    samples = {"demonstrations": demonstrated, **learned}
    extent = grid_extent(demonstrated)
    columns = min(4, len(samples))
    rows = -(-len(samples) // columns)
    # Sized so that letters are legible on a page of 800 pixels.
    height = 0.9 + 2.2 * shape_of(*np.ptp(extent, axis=1))
    figure = Figure(figsize=(0.8 + 2.6 * columns, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    grids = [heatmap(s, bins=60, extent=extent) for s in samples.values()]
    top = float(np.percentile(np.concatenate([g[g > 0] for g in grids]), 99))
    for ax in axes[len(samples) :]:
        ax.remove()
    axes = axes[: len(samples)]
    for ax, name, grid in zip(axes, samples, grids, strict=True):
        box = (*extent[1], *extent[0])
        image = ax.imshow(grid, origin="lower", extent=box, vmin=0, vmax=top)
        ax.invert_xaxis()
        set_title(ax, fill(name, 26))
        ax.set(xlabel="y (m)", ylabel="x (m)")
        ax.locator_params(nbins=4)
    figure.colorbar(image, ax=list(axes), label="fraction of the samples", extend="max")
    return figure


def draw_paths(
    recording: Demonstration, paths: Mapping[str, Array], *, rows: int = 1
) -> Figure:
    """Draw paths (ticks, D) side by side, each over the demonstration in grey.

    Parameters
    ----------
    recording : Demonstration
    paths : mapping of str to ndarray, shape (ticks, D)
        Keys are titles; a ring marks each start.
    rows : int
        Number of rows of the pictures.
    """
    columns = len(paths) // rows
    points = np.concatenate([recording.values, *paths.values()])[:, :2]
    height = 0.9 + 2.9 * shape_of(*np.ptp(points, axis=0))
    size = (3.8 * columns, 0.4 + height * rows)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, (title, path) in zip(axes, paths.items(), strict=True):
        draw_demonstrations_in_plane([recording], ax=ax)
        ax.lines[-1].set(color=DEMONSTRATED, label="demonstrated")
        x, y = path[:, 0], path[:, 1]
        ax.plot(y, x, color=PLAYED, linewidth=1.2, label="played")
        ax.plot(y[0], x[0], "o", color=PLAYED, fillstyle="none", label="start")
        set_title(ax, title)
    same_limits(list(axes))
    figure.legend(
        handles=axes[0].lines, loc="outside upper right", ncols=3, frameon=False
    )
    return figure


def path_distances(recording: Demonstration, trajectories: Array) -> Array:
    """Return the distances of samples (..., D) to the nearest one of a recording, (...)."""
    out: Array = cKDTree(recording.values).query(trajectories)[0]
    return out


def rms_jerk(trajectories: Array, rate: float) -> float:
    """Return the rms jerk of trajectories (..., ticks, D), in units per s^3."""
    third = np.diff(trajectories, n=3, axis=-2) * rate**3
    return float(np.sqrt(np.mean(np.sum(third**2, axis=-1))))


def millimetres(value: Any) -> str:
    """Return a length in metres as text in millimetres."""
    return f"{1e3 * float(value):.1f} mm"
