"""Heatmaps: how often positions are visited (Fig. 8)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fmp_drake.plots.panels import Channels, Demonstrations, PlanePanel, as_list
from fmp_drake.plots.style import DENSITY_MAP, add_colorbar
from fmp_drake.primitives import FourierMovementPrimitive

_SAMPLES = 1000
_CELLS = 60  # Along the longer side.
# Percentile of the positive densities at which the colour scale ends.
_CLIPPED = 99
_REFINED = 4  # Points for each step of a path: it also passes cells between samples.


def draw_heatmaps(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    axes: Sequence[Axes],
) -> None:
    """Draw heatmaps of demonstrations and of samples, with one grid and colour scale.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    demonstrations : Demonstration or sequence of Demonstration
    axes : sequence of two Axes
    """
    recordings = as_list(demonstrations)
    channels = Channels.of_skill(skill)
    Channels.of_demonstrations(recordings)
    channels.check(recordings)
    samples = skill.sample(_SAMPLES, seed=0, with_noise=False)
    bulk = np.percentile(samples, [0.1, 99.9], axis=(0, 1))
    points = np.concatenate([*(d.values for d in recordings), bulk])[:, :2]
    up, left = channels.units[:2]
    edges = grid_edges(points, square=up == left)
    shown = {
        "visited in the demonstrations": density(
            [d.values for d in recordings],
            [np.diff(d.time) for d in recordings],
            edges,
        ),
        f"visited in {_SAMPLES} samples": density(
            list(samples), [np.ones(skill.n_steps - 1)] * _SAMPLES, edges
        ),
    }
    top = max(np.percentile(d[d > 0], _CLIPPED) for d in shown.values())
    for ax, (title, values) in zip(axes, shown.items(), strict=True):
        panel = PlanePanel(channels, ax)
        mesh = ax.pcolormesh(
            edges[1],
            edges[0],
            np.ma.masked_equal(values, 0),
            cmap=DENSITY_MAP,
            vmin=0,
            vmax=top,
            rasterized=True,
        )
        panel.finish(title)
    unit = f"{up}²" if up == left else f"({up} {left})"
    add_colorbar(axes[1], mesh, f"density (1/{unit})", extend="max")


def density(
    paths: Sequence[NDArray[np.float64]],
    steps: Sequence[NDArray[np.float64]],
    edges: Sequence[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return the density of positions over the cells of a grid.

    Parameters
    ----------
    paths : sequence of ndarray, shape (N, D)
    steps : sequence of ndarray, shape (N - 1,)
        Duration of the steps of each path, which need not be equal.
    edges : sequence of two ndarray
        Edges of the cells, of the first and of the second channel, rising.

    Returns
    -------
    ndarray, shape (rows, columns)
    """
    points = np.concatenate([_refined(path) for path in paths])
    weights = np.repeat(np.concatenate(steps), _REFINED)
    counts, *_ = np.histogram2d(points[:, 0], points[:, 1], bins=edges, weights=weights)
    area = np.diff(edges[0])[0] * np.diff(edges[1])[0]
    out: NDArray[np.float64] = counts / (np.sum(weights) * area)
    return out


def grid_edges(
    points: NDArray[np.float64], *, square: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the edges of cells that contain points (N, 2), with a small margin.

    There are 60 cells along the longer side, square ones; or 60 along both.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.03 * np.maximum(high - low, 1e-6)
    low, widths = low - margin, high - low + 2 * margin
    cell = (np.full(2, widths.max()) if square else widths) / _CELLS
    counts = np.ceil(widths / cell - 1e-9).astype(int)
    rows, columns = (low[i] + cell[i] * np.arange(counts[i] + 1) for i in range(2))
    return rows, columns


def _refined(path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points along a path (N, D), `_REFINED` for every step: (.., D)."""
    ratio = (np.arange(_REFINED) / _REFINED)[:, None]
    between = path[:-1, None] * (1 - ratio) + path[1:, None] * ratio
    return between.reshape(-1, path.shape[1])
