"""A page about one skill: what was shown, what was learned, what is played."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fmp_drake.plots.channels import Channels, Demonstrations
from fmp_drake.plots.heatmaps import draw_heatmaps
from fmp_drake.plots.learned import (
    draw_component_in_plane,
    draw_component_over_time,
    draw_samples_in_plane,
)
from fmp_drake.plots.phase import draw_phase
from fmp_drake.plots.played import draw_rollout_over_time, draw_way_back
from fmp_drake.plots.recorded import draw_demonstrations_in_plane
from fmp_drake.plots.spectra import draw_spectra
from fmp_drake.plots.style import same_limits, save, shape_of
from fmp_drake.plots.windows import draw_windows_over_time
from fmp_drake.primitives import FourierMovementPrimitive, Player


def plot_skill(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    path: Path,
    *,
    plane: Sequence[str] | None = None,
) -> None:
    """Write the page that `draw_skill` draws to a file (.png, .pdf, .svg)."""
    save(draw_skill(skill, demonstrations, plane=plane), path)


def draw_skill(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    *,
    plane: Sequence[str] | None = None,
) -> Figure:
    """Return a page about a skill and the demonstrations it was learned from.

    A skill of one channel has no plane: its windows and its most frequent component
    are drawn over time instead. Where there is a phase model, its pictures follow.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    demonstrations : Demonstration or sequence of Demonstration
    plane : sequence of two str, optional
        The upward channel and the one to the left; the first two where None.
    """
    names = Channels.of_skill(skill)
    channels = len(names.names)
    low, high = skill.extent_
    outside = high + 0.5 * (high - low)
    player = Player(skill)
    ratio = 0.4
    if channels > 1:
        # Two rows of four pictures in the plane, as high as what the skill does.
        samples = skill.sample(200, with_noise=False)
        span = np.ptp(samples, axis=(0, 1))[list(names.plane(plane))]
        ratio = shape_of(*span)
    heights = [2 * (0.9 + 2.8 * ratio), 1 + 1.3 * channels]
    if skill.phase_model_ is not None:
        heights.append(3.8)
    figure = Figure(figsize=(15, sum(heights)), layout="constrained")
    parts = figure.subfigures(len(heights), squeeze=False, height_ratios=heights)
    top, bottom = parts[:2, 0]
    if skill.phase_model_ is not None:
        axes = parts[2, 0].subplots(1, 3)
        draw_phase(skill, demonstrations=demonstrations, plane=plane, axes=axes)
    if channels > 1:
        axes = top.subplots(2, 4)
        draw_demonstrations_in_plane(demonstrations, plane=plane, ax=axes[0, 0])
        draw_samples_in_plane(
            skill, demonstrations=demonstrations, plane=plane, ax=axes[0, 1]
        )
        draw_heatmaps(skill, demonstrations, plane=plane, axes=axes[0, 2:])
        for component, ax in enumerate(axes[1, :3]):
            if component >= len(skill.components_):
                ax.remove()
                continue
            draw_component_in_plane(
                skill,
                component=component,
                demonstrations=demonstrations,
                plane=plane,
                ax=ax,
            )
        draw_way_back(
            player, outside, demonstrations=demonstrations, plane=plane, ax=axes[1, 3]
        )
        shown = min(3, len(skill.components_))
        same_limits([*axes[0], *axes[1, :shown]])
    else:
        a, b = top.subplots(2, 1)
        draw_windows_over_time(skill, demonstrations, axes=a)
        draw_component_over_time(skill, axes=b)
    left, right = bottom.subfigures(1, 2, width_ratios=[1, 2])
    draw_spectra(skill, demonstrations, axes=left.subplots(channels, sharex=True))
    ratios = [1.0] * channels + [0.25]
    rows = right.subplots(channels + 1, sharex=True, height_ratios=ratios)
    draw_rollout_over_time(player, outside, axes=rows)
    return figure
