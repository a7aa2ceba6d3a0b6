"""Pictures of a learned skill: samples and components."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.stats import chi2

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number
from fmp_drake.plots.panels import Channels, Demonstrations, PlanePanel, TimePanels
from fmp_drake.plots.style import SAMPLED, component_color, lighten
from fmp_drake.primitives import FourierMovementPrimitive

_CONFIDENCE = 0.95
_ANGLES = np.linspace(0, 2 * np.pi, 48, endpoint=False)
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def draw_samples_in_plane(
    skill: FourierMovementPrimitive,
    *,
    n: int = 20,
    seed: int = 0,
    demonstrations: Demonstrations = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw windows sampled from a skill, over its demonstrations (Fig. 7).

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    n, seed : int
        Number of samples, without the isotropic noise, and their seed.
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey behind.
    ax : Axes, optional
        That of a new figure where None.
    """
    check_number(n, "n", least=1, whole=True, error=RunError)
    panel = PlanePanel(Channels.of_skill(skill), ax)
    panel.background(demonstrations)
    for sample in skill.sample(n, seed=seed, with_noise=False):
        panel.path(sample, color=SAMPLED, linewidth=0.8, alpha=0.8)
    return panel.finish(f"{n} samples of {skill.n_steps / skill.rate:g} s")


def draw_component_over_time(
    skill: FourierMovementPrimitive, component: int, axes: Sequence[Axes]
) -> tuple[Axes, ...]:
    """Draw the mean of a component, and 2 standard deviations about it, over time.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    component : int
        Components are sorted: 0 is the most frequent one.
    axes : sequence of Axes
        One for each channel.
    """
    panels = TimePanels(Channels.of_skill(skill), axes)
    mean, covariances = _moments(skill, component)
    color = component_color(component)
    time = np.arange(skill.n_steps) / skill.rate
    for ax, i in panels:
        draw_band(ax, time, mean[:, i], covariances[:, i, i], color)
        ax.plot(time, mean[:, i], color=color, linewidth=1.6, label="mean")
    percent = 100 * skill.proportions_[component]
    title = f"component {component} ({percent:.0f} % of the windows)"
    return panels.finish(title, xlabel="time in the window (s)")


def draw_band(
    ax: Axes,
    time: NDArray[np.float64],
    mean: NDArray[np.float64],
    variance: NDArray[np.float64],
    color: str,
) -> None:
    """Draw 2 standard deviations about a mean over time, each of shape (N,)."""
    deviation = 2 * np.sqrt(variance)
    ax.fill_between(
        time,
        mean - deviation,
        mean + deviation,
        color=lighten(color, 0.7),
        linewidth=0,
        label="2 standard deviations",
    )


def draw_component_in_plane(
    skill: FourierMovementPrimitive,
    component: int,
    ax: Axes,
    *,
    demonstrations: Demonstrations = (),
) -> Axes:
    """Draw the mean of a component and the tube that its ellipses sweep.

    At every step of the window the tube contains 95 % of the component; the outlines
    are ellipses at twelve steps, the dot is the start.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    component : int
        Components are sorted: 0 is the most frequent one.
    ax : Axes
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey.
    """
    panel = PlanePanel(Channels.of_skill(skill), ax)
    mean, covariances = _moments(skill, component)
    centres = mean[:, [1, 0]]
    roots = np.linalg.cholesky(covariances[:, [[1], [0]], [1, 0]])
    roots *= np.sqrt(chi2.ppf(_CONFIDENCE, 2))
    ellipses = centres[:, None] + _CIRCLE @ np.swapaxes(roots, 1, 2)
    pairs = np.concatenate([ellipses[:-1], ellipses[1:]], axis=1)
    color = component_color(component)
    light = lighten(color, 0.75)
    tube = PolyCollection(
        [points[ConvexHull(points).vertices] for points in pairs],
        facecolor=light,
        edgecolor=light,
        linewidth=0.5,
        zorder=1.0,
        label=f"{100 * _CONFIDENCE:g} %",
    )
    panel.ax.add_collection(tube)
    panel.background(demonstrations)
    outlines = PolyCollection(
        list(ellipses[:: max(1, round(skill.n_steps / 12))]),
        facecolor="none",
        edgecolor=lighten(color, 0.35),
        linewidth=0.6,
        zorder=2.0,
    )
    panel.ax.add_collection(outlines)
    panel.ax.plot(*centres.T, color=color, linewidth=1.6, label="mean", zorder=3.0)
    panel.ax.plot(*centres[:1].T, "o", color=color, markersize=5, zorder=3.0)
    percent = 100 * skill.proportions_[component]
    return panel.finish(
        f"component {component} ({percent:.0f} %):\nmean, {100 * _CONFIDENCE:g} % tube"
    )


def _moments(
    skill: FourierMovementPrimitive, component: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean (T, D) and covariance (T, D, D) of a component at every step."""
    mean = skill.synthesize(skill.components_[component].mean)
    covariances = [skill.covariance(component, t) for t in range(skill.n_steps)]
    return mean, np.stack(covariances)
