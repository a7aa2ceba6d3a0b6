"""Spectra: which frequencies a demonstration is made of."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.panels import TimePanels
from fmp_drake.plots.style import DEMONSTRATED
from fmp_drake.plots.windows import cut_windows
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.primitives.editing.spectrum import polar

_SHOWN_ENERGY = 0.99
_FEWEST_HARMONICS = 12


def draw_spectra(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    *,
    channels: Sequence[str] | None = None,
    axes: Axes | Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw the amplitude of every harmonic of the windows, with its spread.

    A point is the median over the windows, its bar contains 90 % of them. The constant
    part is left out, and so are frequencies above which there is hardly any power.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted: its parameters are those of the windows.
    demonstrations : Demonstration or sequence of Demonstration
    channels : sequence of str, optional
        The channels to draw; all where None.
    axes : sequence of Axes, optional
        One for each channel.

    Returns
    -------
    tuple of Axes
    """
    panels = TimePanels(Channels.of_skill(skill), channels, axes)
    windows = cut_windows(skill, as_list(demonstrations))
    amplitudes = polar(windows)[0][:, 1:]  # (N, harmonics, D), the constant left out
    count = _harmonics_with_energy(amplitudes[..., [i for _, i in panels]])
    frequencies = np.arange(1, count + 1) * skill.rate / skill.n_steps
    for ax, i in panels:
        low, middle, high = np.percentile(amplitudes[:, :count, i], [5, 50, 95], axis=0)
        bars = ax.vlines(frequencies, low, high, color=DEMONSTRATED, linewidth=3.0)
        bars.set_label("5 to 95 %")
        ax.plot(frequencies, middle, "o", color="0.15", markersize=3.5, label="median")
        ax.set_ylim(bottom=0)
        ax.set_xlim(left=0)
    title = f"harmonics of {len(windows)} windows"
    return panels.finish(title, xlabel="frequency (Hz)")


def _harmonics_with_energy(amplitudes: NDArray[np.float64]) -> int:
    """Return how many harmonics contain nearly all the power of every channel."""
    power = np.mean(amplitudes**2, axis=0)
    total = np.maximum(np.sum(power, axis=0), 1e-300)
    fraction = np.cumsum(power, axis=0) / total
    needed = 1 + int(np.max(np.argmax(fraction >= _SHOWN_ENERGY, axis=0)))
    return min(max(needed, _FEWEST_HARMONICS), amplitudes.shape[1])
