"""Heatmaps and divergences, with the grid and the floor stated."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fmp_drake.experiments.metrics import heatmap, kl_divergence

# The grid of Table I here; the paper does not state its own. The sensitivity study
# varies both.
BINS = 30
FLOOR = 1e-6
SENSITIVITY_BINS = (10, 20, 30, 40, 60, 80, 100)
SENSITIVITY_FLOORS = (1e-8, 1e-6, 1e-4)
_MARGIN = 0.15

Samples = NDArray[np.float64]


def grid_extent(demonstrated: Samples) -> NDArray[np.float64]:
    """Return the box of the first two channels, 15 % wider on every side, (2, 2)."""
    flat = demonstrated.reshape(-1, demonstrated.shape[-1])[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    room = _MARGIN * (high - low)
    return np.stack([low - room, high + room], axis=1)


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
    samples: Mapping[str, Samples], *, extent: NDArray[np.float64], bins: int = 60
) -> Figure:
    """Draw heatmaps of several sets of trajectories on one scale of colours."""
    figure = Figure(figsize=(4.2 * len(samples), 4.2), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(samples)))
    grids = [heatmap(s, bins=bins, extent=extent) for s in samples.values()]
    top = float(np.percentile(np.concatenate([g[g > 0] for g in grids]), 99))
    for ax, name, grid in zip(axes, samples, grids, strict=True):
        image = ax.imshow(
            grid,
            origin="lower",
            extent=(*extent[1], *extent[0]),
            cmap="viridis",
            vmin=0,
            vmax=top,
        )
        ax.invert_xaxis()
        ax.set(title=name, xlabel="y (m)", ylabel="x (m)")
    figure.colorbar(image, ax=axes, label="share of the samples", shrink=0.8)
    return figure
