"""Pictures of what was learned: samples and components."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.stats import chi2

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number
from fmp_drake.plots.channels import Channels, Demonstrations
from fmp_drake.plots.panels import PlanePanel, TimePanels
from fmp_drake.plots.style import SAMPLED, component_color, lighten
from fmp_drake.primitives import FourierMovementPrimitive

_ANGLES = np.linspace(0, 2 * np.pi, 48, endpoint=False)
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def sample_windows(
    skill: FourierMovementPrimitive, n: int, seed: int
) -> NDArray[np.float64]:
    """Return windows sampled from a skill without the isotropic noise, (n, T, D)."""
    check_number(n, "n", least=1, whole=True, error=RunError)
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
    panel = PlanePanel(Channels.of_skill(skill), plane, ax)
    panel.background(demonstrations)
    for sample in sample_windows(skill, n, seed):
        panel.path(sample, color=SAMPLED, linewidth=0.8, alpha=0.8)
    return panel.finish(f"{n} samples of {skill.n_steps / skill.rate:g} s")


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
    panels = TimePanels(Channels.of_skill(skill), channels, axes)
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
    *,
    component: int = 0,
    confidence: float = 0.95,
    demonstrations: Demonstrations = (),
    plane: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the mean of a component and the tube that its ellipses sweep.

    At every step of the window the tube contains `confidence` of the component; the
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
    check_number(confidence, "confidence", above=0.0, below=1.0, error=RunError)
    panel = PlanePanel(Channels.of_skill(skill), plane, ax)
    up, left = panel.plane
    mean, covariances = _moments(skill, component)
    centres = mean[:, [left, up]]
    roots = np.linalg.cholesky(covariances[:, [[left], [up]], [left, up]])
    roots *= np.sqrt(chi2.ppf(confidence, 2))
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
        label=f"{100 * confidence:g} %",
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
        f"component {component} ({percent:.0f} %): mean, {100 * confidence:g} % tube"
    )


def _moments(
    skill: FourierMovementPrimitive, component: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean (T, D) and covariance (T, D, D) of a component at every step."""
    m = len(skill.components_)
    check_number(
        component, "component", least=0, most=m - 1, whole=True, error=RunError
    )
    mean = skill.synthesize(skill.components_[component].mean)
    covariances = [skill.covariance(component, t) for t in range(skill.n_steps)]
    return mean, np.stack(covariances)
