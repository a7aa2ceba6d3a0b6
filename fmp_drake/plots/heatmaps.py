"""Heatmaps: how often positions are visited (Fig. 8)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number, finite_array
from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.learned import sample_windows
from fmp_drake.plots.panels import PlanePanel
from fmp_drake.plots.style import DENSITY_MAP, add_colorbar, shape_of
from fmp_drake.primitives import FourierMovementPrimitive

# Of the densities that are not 0, %: a colour scale ends here.
_CLIPPED = 99
_REFINED = 4  # A path passes cells between two samples, too.


def draw_heatmap(
    source: FourierMovementPrimitive | Demonstrations,
    *,
    n: int = 1000,
    seed: int = 0,
    cells: int = 60,
    bounds: ArrayLike | None = None,
    plane: Sequence[str] | None = None,
    colorbar: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw how often positions are visited, as a density over a grid (Fig. 8).

    Parameters
    ----------
    source : FourierMovementPrimitive, Demonstration or sequence of Demonstration
        Samples are drawn of a skill.
    n, seed : int
        How many samples, and of which seed.
    cells : int
        Cells along the longer side, square ones; along both sides where the
        channels have different units.
    bounds : array_like, shape (2, 2), optional
        Least and greatest value of the upward and of the leftward channel; where None,
        those of nearly all positions.
    plane : sequence of two str, optional
        The upward channel and the one to the left; the first two where None.
    colorbar : bool
    ax : Axes, optional
    """
    if isinstance(source, FourierMovementPrimitive):
        names = Channels.of_skill(source)
        panel = PlanePanel(names, plane, ax)
        samples = sample_windows(source, n, seed)
        paths, steps = list(samples), [np.ones(source.n_steps - 1)] * n
        if bounds is None:
            bounds = _bounds(_bulk(samples)[:, panel.plane])
        title = f"visited in {n} samples"
    else:
        recorded = as_list(source)
        names = Channels.of_demonstrations(recorded)
        panel = PlanePanel(names, plane, ax)
        # Samples of a recording need not be spaced evenly.
        paths, steps = [d.values for d in recorded], [np.diff(d.time) for d in recorded]
        title = "visited in the demonstrations"
    indices = list(panel.plane)
    points = np.concatenate([_refined(path) for path in paths])[:, indices]
    weights = np.repeat(np.concatenate(steps), _REFINED)
    limits = _bounds(points) if bounds is None else bounds
    square = names.units[indices[0]] == names.units[indices[1]]
    edges = _edges(limits, cells, square=square)
    counts, *_ = np.histogram2d(points[:, 0], points[:, 1], bins=edges, weights=weights)
    size = [np.diff(e)[0] for e in edges]
    density = counts / (np.sum(weights) * size[0] * size[1])
    mesh = panel.ax.pcolormesh(
        edges[1],
        edges[0],
        np.ma.masked_equal(density, 0),
        cmap=DENSITY_MAP,
        vmin=0,
        vmax=np.percentile(density[density > 0], _CLIPPED) if density.any() else None,
        rasterized=True,
    )
    if colorbar:
        _add_density_bar(panel.ax, mesh, names, indices)
    return panel.finish(title)


def draw_heatmaps(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    *,
    n: int = 1000,
    seed: int = 0,
    cells: int = 60,
    plane: Sequence[str] | None = None,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, Axes]:
    """Draw heatmaps of demonstrations and of samples that can be compared (Fig. 8).

    Both have the same cells and the same scale of colours.

    Parameters
    ----------
    skill, demonstrations, n, seed, cells, plane
        As for `draw_heatmap`.
    axes : sequence of two Axes, optional

    Returns
    -------
    tuple of two Axes
    """
    recorded = as_list(demonstrations)
    names = Channels.of_skill(skill)
    indices = list(names.plane(plane))
    Channels.of_demonstrations(recorded)
    names.check(recorded)
    samples = sample_windows(skill, n, seed)
    shown = [np.concatenate([d.values for d in recorded]), _bulk(samples)]
    bounds = _bounds(np.concatenate(shown)[:, indices])
    if axes is None:
        height = 0.9 + 3.4 * shape_of(*np.ptp(bounds, axis=1))
        figure = Figure(figsize=(9, height), layout="constrained")
        axes = figure.subplots(1, 2)
    made = tuple(axes)
    if len(made) != 2:
        raise RunError(f"{len(made)} axes are given; two heatmaps need 2.")
    sources: list[FourierMovementPrimitive | Demonstrations] = [recorded, skill]
    for ax, source in zip(made, sources, strict=True):
        draw_heatmap(
            source,
            n=n,
            seed=seed,
            cells=cells,
            bounds=bounds,
            plane=[names.names[i] for i in indices],
            colorbar=False,
            ax=ax,
        )
    meshes = [ax.collections[-1] for ax in made]
    greatest = max(mesh.get_clim()[1] for mesh in meshes)
    for mesh in meshes:
        mesh.set_clim(0, greatest)
    _add_density_bar(made[1], meshes[1], names, indices)
    return made[0], made[1]


def _refined(path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points along a path (N, D), `_REFINED` for every step: (.., D)."""
    ratio = (np.arange(_REFINED) / _REFINED)[:, None]
    between = path[:-1, None] * (1 - ratio) + path[1:, None] * ratio
    return between.reshape(-1, path.shape[1])


def _bulk(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners of the box that few samples leave, (2, D)."""
    return np.percentile(samples, [0.1, 99.9], axis=(0, 1))


def _bounds(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return least and greatest values with a little room, (2, 2)."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.03 * np.maximum(high - low, 1e-6)
    return np.column_stack([low - room, high + room])


def _edges(bounds: ArrayLike, cells: int, *, square: bool) -> list[NDArray[np.float64]]:
    """Return the edges of cells that fill the bounds."""
    limits = finite_array(bounds, "the bounds", (2, 2), error=RunError)
    check_number(cells, "cells", least=1, whole=True, error=RunError)
    if not np.all(limits[:, 0] < limits[:, 1]):
        raise RunError(
            f"bounds are {limits.tolist()}; expected [[least, greatest], [least, "
            "greatest]] of the upward and of the leftward channel."
        )
    widths = limits[:, 1] - limits[:, 0]
    cell = (np.full(2, widths.max()) if square else widths) / cells
    counts = np.ceil(widths / cell - 1e-9).astype(int)
    return [limits[i, 0] + cell[i] * np.arange(counts[i] + 1) for i in range(2)]


def _add_density_bar(
    ax: Axes, mesh: QuadMesh, names: Channels, plane: Sequence[int]
) -> None:
    up, left = (names.units[i] for i in plane)
    unit = f"{up}²" if up == left else f"({up} {left})"
    add_colorbar(ax, mesh, f"density (1/{unit})", extend="max")
