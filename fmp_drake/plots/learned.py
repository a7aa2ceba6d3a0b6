"""Pictures of what was learned: samples and components."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray
from scipy.stats import chi2

from fmp_drake.errors import SkillError
from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.style import (
    SAMPLED,
    component_color,
    draw_grey_paths,
    draw_path,
    finish_plane,
    finish_times,
    legend_above,
    lighten,
    plane_axes,
    set_title,
    time_axes,
)
from fmp_drake.primitives import FourierMovementPrimitive

_ANGLES = np.linspace(0, 2 * np.pi, 48, endpoint=False)
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def sample_windows(
    skill: FourierMovementPrimitive, n: int, seed: int
) -> NDArray[np.float64]:
    """Return windows sampled from a skill without the isotropic noise, (n, T, D)."""
    if n < 1:
        raise SkillError(f"n is {n}; at least 1 sample must be drawn.")
    return skill.sample(n, seed=seed, with_noise=False)


def draw_samples_in_plane(
    skill: FourierMovementPrimitive,
    *,
    n: int = 20,
    seed: int = 0,
    demonstrations: Demonstrations = (),
    plane: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw windows sampled from a skill, over its demonstrations (Fig. 7).

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    n, seed : int
        How many samples, and of which seed; without the isotropic noise.
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey behind.
    plane : sequence of two str, optional
        The upward channel and the one to the left; the first two where None.
    ax : Axes, optional
    """
    names = Channels.of_skill(skill)
    indices = names.plane(plane)
    samples = sample_windows(skill, n, seed)
    fit = ax is None
    ax = plane_axes(ax)
    _background(ax, demonstrations, names, indices)
    for sample in samples:
        draw_path(ax, sample, indices, color=SAMPLED, linewidth=0.8, alpha=0.8)
    set_title(ax, f"{n} samples of {skill.n_steps / skill.rate:g} s")
    finish_plane(ax, names, indices, fit=fit)
    return ax


def draw_component_over_time(
    skill: FourierMovementPrimitive,
    *,
    component: int = 0,
    channels: Sequence[str] | None = None,
    axes: Axes | Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw the mean of a component, and 2 standard deviations about it, over time.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    component : int
        Components are sorted: 0 is the most frequent one.
    channels : sequence of str, optional
        The channels to draw; all where None.
    axes : sequence of Axes, optional
        One for each channel.

    Returns
    -------
    tuple of Axes
    """
    names = Channels.of_skill(skill)
    mean, covariances = _moments(skill, component)
    indices = names.indices(channels)
    made = time_axes(axes, names, len(indices))
    color = component_color(component)
    time = np.arange(skill.n_steps) / skill.rate
    for ax, i in zip(made, indices, strict=True):
        spread = 2 * np.sqrt(covariances[:, i, i])
        ax.fill_between(
            time,
            mean[:, i] - spread,
            mean[:, i] + spread,
            color=lighten(color, 0.7),
            linewidth=0,
            label="2 standard deviations",
        )
        ax.plot(time, mean[:, i], color=color, linewidth=1.6, label="mean")
    share = 100 * skill.proportions_[component]
    set_title(made[0], f"component {component} ({share:.0f} % of the windows)")
    legend_above(made[0])
    labels = [names.label(i) for i in indices]
    finish_times(made, labels, xlabel="time in the window (s)")
    return made


def draw_component_in_plane(
    skill: FourierMovementPrimitive,
    *,
    component: int = 0,
    confidence: float = 0.95,
    demonstrations: Demonstrations = (),
    plane: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the mean of a component and the tube that its ellipses sweep.

    At every step of the window the tube holds `confidence` of the component; the
    outlines are ellipses at twelve steps, the dot is the start.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    component : int
        Components are sorted: 0 is the most frequent one.
    confidence : float
        In (0, 1).
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey.
    plane : sequence of two str, optional
        The upward channel and the one to the left; the first two where None.
    ax : Axes, optional
    """
    if not 0 < confidence < 1:
        raise SkillError(f"confidence is {confidence}; it must be in (0, 1).")
    names = Channels.of_skill(skill)
    up, left = names.plane(plane)
    mean, covariances = _moments(skill, component)
    centres = mean[:, [left, up]]
    roots = np.linalg.cholesky(covariances[:, [[left], [up]], [left, up]])
    roots *= np.sqrt(chi2.ppf(confidence, 2))
    color = component_color(component)
    fit = ax is None
    ax = plane_axes(ax)
    light = lighten(color, 0.75)
    tube = PolyCollection(
        list(_swept(centres, roots)), facecolor=light, edgecolor=light
    )
    tube.set(linewidth=0.5, zorder=1.0, label=f"{100 * confidence:g} %")
    ax.add_collection(tube)
    _background(ax, demonstrations, names, (up, left))
    every = max(1, round(skill.n_steps / 12))
    outlines = PolyCollection(
        list(_ellipses(centres, roots)[::every]),
        facecolor="none",
        edgecolor=lighten(color, 0.35),
        linewidth=0.6,
        zorder=2.0,
    )
    ax.add_collection(outlines)
    ax.plot(*centres.T, color=color, linewidth=1.6, label="mean", zorder=3.0)
    ax.plot(*centres[:1].T, "o", color=color, markersize=5, zorder=3.0)
    share = 100 * skill.proportions_[component]
    title = f"component {component} ({share:.0f} %): mean, {100 * confidence:g} % tube"
    set_title(ax, title)
    finish_plane(ax, names, (up, left), fit=fit)
    return ax


def _background(
    ax: Axes, demonstrations: Demonstrations, names: Channels, plane: tuple[int, int]
) -> None:
    recorded = as_list(demonstrations)
    names.check(recorded)
    draw_grey_paths(ax, [d.values for d in recorded], plane)


def _moments(
    skill: FourierMovementPrimitive, component: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean (T, D) and covariance (T, D, D) of a component at every step."""
    m = len(skill.components_)
    if not 0 <= component < m:
        raise SkillError(f"component is {component}; the skill has 0 to {m - 1}.")
    mean = skill.synthesize(skill.components_[component].mean)
    covariances = [skill.covariance(component, t) for t in range(skill.n_steps)]
    return mean, np.stack(covariances)


def _ellipses(
    centres: NDArray[np.float64], roots: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points of the ellipses centre + root @ circle, (T, points, 2)."""
    return centres[:, None] + _CIRCLE @ np.swapaxes(roots, 1, 2)


def _swept(
    centres: NDArray[np.float64], roots: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the convex hulls of consecutive ellipses, (T - 1, points, 2).

    A hull is drawn by its farthest points in the directions that are normal to either
    ellipse at the points of `_ellipses`: also thin ones are met well.
    """
    normals = _CIRCLE @ np.linalg.inv(roots)
    both = np.concatenate([normals[:-1], normals[1:]], axis=1)
    order = np.argsort(np.arctan2(both[..., 1], both[..., 0]), axis=1)
    both = np.take_along_axis(both, order[..., None], axis=1)
    farthest = []
    for centre, root in ((centres[:-1], roots[:-1]), (centres[1:], roots[1:])):
        on_circle = both @ root
        on_circle /= np.linalg.norm(on_circle, axis=-1, keepdims=True)
        farthest.append(centre[:, None] + on_circle @ np.swapaxes(root, 1, 2))
    first, second = farthest
    is_first = np.sum((first - second) * both, axis=-1) >= 0
    return np.where(is_first[..., None], first, second)
