"""Pictures of a phase model: its cycle, its tempo and size, and its residual."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from fmp_drake.errors import RunError
from fmp_drake.plots.panels import Channels, Demonstrations, PlanePanel
from fmp_drake.plots.style import (
    PLAYED,
    SAMPLED,
    add_colorbar,
    add_lines,
    component_color,
    set_title,
)
from fmp_drake.primitives import FourierMovementPrimitive

_PHASES = np.linspace(0, 2 * np.pi, 241)


def draw_phase(
    skill: FourierMovementPrimitive,
    axes: Sequence[Axes],
    *,
    demonstrations: Demonstrations = (),
) -> None:
    """Draw a phase model in three pictures.

    The mean cycle in the colours of its phase (over the phase, for a skill of one
    channel); tempo and size of each demonstrated cycle; the standard deviation of the
    residual over the phase.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted, with a phase model.
    axes : sequence of three Axes
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey behind the cycle.
    """
    model = skill.phase_model_
    if model is None:
        raise RunError(f"the skill has no phase model: {skill.model_reason_}.")
    channels = Channels.of_skill(skill)
    first, second, third = axes
    cycle = model.cycle.values(_PHASES) * skill.scales_
    if len(channels.names) > 1:
        panel = PlanePanel(channels, first)
        panel.background(demonstrations)
        points = cycle[:, [1, 0]]
        segments = np.stack([points[:-1], points[1:]], axis=1)
        cmap = matplotlib.colormaps["twilight"]
        style = {"cmap": cmap, "linewidth": 2.5, "zorder": 3.0}
        line = add_lines(first, segments, _PHASES[:-1], **style)
        panel.finish("mean cycle")
        add_colorbar(first, line, "phase (rad)")
    else:
        first.plot(_PHASES, cycle[:, 0], color=PLAYED)
        first.set_xlabel("phase (rad)")
        first.set_ylabel(channels.label(0))
        set_title(first, "mean cycle")
    count = np.arange(1, model.cycles + 1)
    second.plot(count, 100 * skill.tempos_, ".-", color=PLAYED, label="tempo")
    second.plot(count, 100 * skill.amplitudes_, ".-", color=SAMPLED, label="size")
    second.set_xlabel("demonstrated cycle")
    second.locator_params(axis="x", integer=True)
    second.set_ylabel("of the mean (%)")
    second.legend(frameon=False)
    set_title(second, f"{model.cycles} cycles of {skill.period_:.2f} s")
    factor = model.residual.factor(_PHASES) * skill.scales_[:, None]
    spread = np.sqrt(np.sum(factor**2, axis=2))
    for i, name in enumerate(channels.names):
        third.plot(_PHASES, spread[:, i], color=component_color(i), label=name)
    third.set_ylim(bottom=0)
    third.set_xlabel("phase (rad)")
    third.set_ylabel(f"standard deviation ({', '.join(sorted(set(channels.units)))})")
    third.legend(frameon=False)
    set_title(third, "residual of the cycle")
