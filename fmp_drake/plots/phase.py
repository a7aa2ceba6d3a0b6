"""Pictures of a phase model: its cycle, how tempo and size varied, and its residual."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from fmp_drake.errors import RunError
from fmp_drake.plots.channels import Channels, Demonstrations
from fmp_drake.plots.panels import PlanePanel
from fmp_drake.plots.style import PLAYED, SAMPLED, component_color, set_title
from fmp_drake.primitives import FourierMovementPrimitive

_PHASES = np.linspace(0, 2 * np.pi, 241)


def draw_phase(
    skill: FourierMovementPrimitive,
    *,
    demonstrations: Demonstrations = (),
    plane: Sequence[str] | None = None,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw what a phase model has learned, in three pictures.

    The mean cycle in the colours of its phase (over the phase, for a skill of one
    channel); tempo and size of each demonstrated cycle; the standard deviation of what
    the cycle leaves, over the phase.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted, with a phase model.
    demonstrations : Demonstration or sequence of Demonstration
        Drawn in grey behind the cycle.
    plane : sequence of two str, optional
        The upward channel and the one to the left; the first two where None.
    axes : sequence of three Axes, optional
        Those of a new figure where None.

    Returns
    -------
    tuple of Axes
    """
    model = skill.phase_model_
    if model is None:
        raise RunError(f"the skill has no phase model: {skill.model_reason_}.")
    channels = Channels.of_skill(skill)
    if axes is None:
        axes = Figure(figsize=(15, 4.5), layout="constrained").subplots(1, 3)
    first, second, third = axes
    cycle = model.cycle.values(_PHASES) * skill.scales_
    if len(channels.names) > 1:
        panel = PlanePanel(channels, plane, first)
        panel.background(demonstrations)
        up, left = cycle[:, panel.plane].T
        points = np.column_stack([left, up])
        line = LineCollection(
            list(np.stack([points[:-1], points[1:]], axis=1)),
            array=_PHASES[:-1],
            cmap=matplotlib.colormaps["twilight"],
            linewidth=2.5,
            zorder=3.0,
        )
        panel.ax.add_collection(line)
        panel.finish("mean cycle, coloured by its phase")
        bar = first.figure.colorbar(line, ax=first, shrink=0.7)
        bar.set_label("phase (rad)")
    else:
        first.plot(_PHASES, cycle[:, 0], color=PLAYED)
        first.set_xlabel("phase (rad)")
        first.set_ylabel(channels.label(0))
        set_title(first, "mean cycle")
    count = np.arange(1, model.cycles + 1)
    second.plot(count, 100 * skill.tempos_, ".-", color=PLAYED, label="tempo")
    second.plot(count, 100 * skill.amplitudes_, ".-", color=SAMPLED, label="size")
    second.set_xlabel("demonstrated cycle")
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
    set_title(third, "what the cycle leaves")
    return first, second, third
