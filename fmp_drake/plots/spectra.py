"""Spectra: which frequencies a demonstration is made of."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fmp_drake.errors import SkillError
from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.style import (
    DEMONSTRATED,
    finish_times,
    legend_above,
    set_title,
    time_axes,
)
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
    highest: float | None = None,
    axes: Axes | Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw the amplitude of every harmonic of the windows, with its spread.

    A point is the median over the windows, its bar holds 90 % of them. The constant
    part is left out.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted: it says how long the windows are.
    demonstrations : Demonstration or sequence of Demonstration
    channels : sequence of str, optional
        The channels to draw; all where None.
    highest : float, optional
        Greatest frequency shown, Hz; where None, that below which 99 % of the power
        of each channel lies.
    axes : sequence of Axes, optional
        One for each channel.

    Returns
    -------
    tuple of Axes
    """
    if highest is not None and not (np.isfinite(highest) and highest > 0):
        raise SkillError(f"highest is {highest} Hz; it must be positive.")
    names = Channels.of_skill(skill)
    windows, _ = cut_windows(skill, as_list(demonstrations), names)
    indices = names.indices(channels)
    made = time_axes(axes, names, len(indices))
    # (N, D, harmonics), without the constant part.
    amplitudes = np.swapaxes(polar(skill.basis, windows)[0], 1, 2)[..., 1:]
    frequencies = np.arange(1, amplitudes.shape[-1] + 1) * skill.rate / skill.n_steps
    if highest is None:
        count = _harmonics_with_energy(amplitudes[:, indices])
    else:
        # At least two, so that the axis has a length.
        count = max(2, int(np.sum(frequencies <= highest * (1 + 1e-9))))
    frequencies = frequencies[:count]
    for ax, i in zip(made, indices, strict=True):
        low, middle, high = np.percentile(amplitudes[:, i, :count], [5, 50, 95], axis=0)
        ax.vlines(
            frequencies,
            low,
            high,
            color=DEMONSTRATED,
            linewidth=3.0,
            label="5 to 95 %",
        )
        ax.plot(frequencies, middle, "o", color="0.15", markersize=3.5, label="median")
        ax.set_ylim(bottom=0)
        ax.set_xlim(left=0)
    set_title(made[0], f"harmonics of {len(windows)} windows")
    legend_above(made[0])
    labels = [names.label(i) for i in indices]
    finish_times(made, labels, xlabel="frequency (Hz)")
    return made


def _harmonics_with_energy(amplitudes: NDArray[np.float64]) -> int:
    """Return how many harmonics hold nearly all the power of every channel."""
    power = np.mean(amplitudes**2, axis=0)
    share = np.cumsum(power, axis=-1) / np.maximum(
        np.sum(power, axis=-1, keepdims=True), 1e-300
    )
    needed = 1 + int(np.max(np.argmax(share >= _SHOWN_ENERGY, axis=-1)))
    return min(max(needed, _FEWEST_HARMONICS), amplitudes.shape[-1])
