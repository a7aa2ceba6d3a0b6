"""How close a learned distribution is to the demonstrated one: heatmaps, divergences."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import ExperimentError
from fmp_drake.numeric import check_number, finite_array
from fmp_drake.plots.style import set_title, shape_of

# The grid of Table I here; the paper does not state its own. The sensitivity study
# varies both.
BINS = 30
FLOOR = 1e-6
SENSITIVITY_BINS = (10, 20, 30, 40, 60, 80, 100)
SENSITIVITY_FLOORS = (1e-8, 1e-6, 1e-4)
_MARGIN = 0.15

Samples = NDArray[np.float64]


def heatmap(
    trajectories: ArrayLike, *, bins: int, extent: ArrayLike
) -> NDArray[np.float64]:
    """Return the fraction of samples in each cell of a grid (Fig. 8 of the paper).

    Parameters
    ----------
    trajectories : array_like, shape (..., D)
        Of which the first two channels are counted.
    bins : int
        Cells along each of the two axes.
    extent : array_like, shape (2, 2)
        Least and greatest value, of the first and of the second channel. Samples
        outside count in the nearest cell.

    Returns
    -------
    ndarray, shape (bins, bins)
        Summing to 1; the first axis is the first channel.
    """
    values = finite_array(
        trajectories, "the trajectories", ("...", "N", "D"), error=ExperimentError
    )
    check_number(bins, "bins", least=1, whole=True, error=ExperimentError)
    box = finite_array(extent, "the extent", (2, 2), error=ExperimentError)
    for low, high in box:
        check_number(high, "the end of the extent", above=low, error=ExperimentError)
    points = np.clip(values.reshape(-1, values.shape[-1])[:, :2], *box.T)
    x, y = points.T
    counts: NDArray[np.float64] = np.histogram2d(x, y, bins=bins, range=box)[0]
    return counts / len(points)


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
    check_number(floor, "floor", above=0.0, error=ExperimentError)
    a = finite_array(p, "the first heatmap", error=ExperimentError)
    b = finite_array(q, "the second heatmap", a.shape, error=ExperimentError)
    a, b = (a + floor) / np.sum(a + floor), (b + floor) / np.sum(b + floor)
    return float(np.sum(a * np.log(a / b)))


def grid_extent(demonstrated: Samples) -> NDArray[np.float64]:
    """Return the box of the first two channels, 15 % wider on every side, (2, 2)."""
    flat = demonstrated.reshape(-1, demonstrated.shape[-1])[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    margin = _MARGIN * (high - low)
    return np.stack([low - margin, high + margin], axis=1)


def divergences(
    learned: Samples,
    demonstrated: Samples,
    *,
    extent: NDArray[np.float64],
    bins: int = BINS,
    floor: float = FLOOR,
) -> tuple[float, float]:
    """Return the forward and the reverse KL divergence of section V-C, nats."""
    p = heatmap(learned, bins=bins, extent=extent)
    q = heatmap(demonstrated, bins=bins, extent=extent)
    return kl_divergence(p, q, floor=floor), kl_divergence(q, p, floor=floor)


def draw_grids(
    samples: Mapping[str, Samples], *, extent: NDArray[np.float64]
) -> Figure:
    """Draw heatmaps of several sets of trajectories with one colour scale."""
    columns = min(4, len(samples))
    rows = -(-len(samples) // columns)
    height = 0.9 + 3.0 * shape_of(*np.ptp(extent, axis=1))
    figure = Figure(figsize=(0.8 + 3.8 * columns, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    grids = [heatmap(s, bins=60, extent=extent) for s in samples.values()]
    top = float(np.percentile(np.concatenate([g[g > 0] for g in grids]), 99))
    for ax in axes[len(samples) :]:
        ax.remove()
    for ax, name, grid in zip(axes, samples, grids, strict=False):
        box = (*extent[1], *extent[0])
        image = ax.imshow(grid, origin="lower", extent=box, vmin=0, vmax=top)
        ax.invert_xaxis()
        set_title(ax, name)
        ax.set(xlabel="y (m)", ylabel="x (m)")
    shown = list(axes[: len(samples)])
    figure.colorbar(image, ax=shown, label="fraction of the samples", extend="max")
    return figure
