"""Pictures of demonstrations: paths, windows and spectra (Fig. 3)."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmp_drake.numeric import Array
from fmp_drake.plots.style import (
    DEMONSTRATED,
    Channels,
    Demonstrations,
    PlanePanel,
    component_color,
    finish_times,
    save,
    set_title,
)
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, Rhythm
from fmp_drake.primitives.data.reading.table import count_text
from fmp_drake.primitives.data.windows import as_windows, demonstration_list
from fmp_drake.primitives.editing.spectrum import polar

_MAX_WINDOWS = 60  # More could not be distinguished.
# Fraction of the power in the drawn harmonics, and their smallest number.
_POWER_FRACTION = 0.99
_MIN_HARMONICS = 12
# Amplitude of a channel that is constant but for rounding: 1 nm, for example.
_LEAST_AMPLITUDE = 1e-9
_MOST_NAMES = 4  # Of recordings in a legend.


def plot_demonstrations(
    demonstrations: Demonstrations, path: str | Path, *, rhythm: Rhythm | None = None
) -> None:
    """Write a picture of recordings over time and in the plane (.png, .pdf, .svg).

    With the rhythm of one recording, its cycles and the parts that are left out are marked.
    """
    recordings = demonstration_list(demonstrations, "a picture")
    count = len(Channels.of_demonstrations(recordings).names)
    figure = Figure(figsize=(12, max(4.0, 1 + 1.3 * count)), layout="constrained")
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=[2, 1])[0]
    axes = left.subplots(count, squeeze=False, sharex=True)[:, 0]
    draw_demonstrations_over_time(recordings, axes)
    if rhythm is not None and len(recordings) == 1:
        _mark_rhythm(axes, rhythm, float(recordings[0].time[0]))
    if count > 1:
        plane = draw_demonstrations_in_plane(recordings, ax=right.subplots())
        set_title(plane, "in the plane")
    save(figure, path)


def _mark_rhythm(axes: Sequence[Axes], rhythm: Rhythm, start: float) -> None:
    """Mark the ends of cycles by lines, and the parts that are left out by grey areas."""
    for ax in axes:
        for bout in rhythm.bouts:
            for end in (bout.start, *bout.cycle_ends):
                ax.axvline(start + end, color=DEMONSTRATED, linewidth=0.6, zorder=0.5)
        for part in rhythm.left_out:
            ax.axvspan(
                start + part.start, start + part.end, color="0.9", linewidth=0, zorder=0
            )
    for part in rhythm.left_out:
        axes[0].annotate(
            part.kind,
            (start + (part.start + part.end) / 2, 0.98),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize="small",
        )


def draw_demonstrations_over_time(
    demonstrations: Demonstrations, axes: Sequence[Axes]
) -> tuple[Axes, ...]:
    """Draw each channel of recordings over time, in separate axes (Fig. 3a)."""
    recordings = demonstration_list(demonstrations, "a picture")
    labels = Channels.of_demonstrations(recordings).labels
    greys, count = _greys(len(recordings)), len(recordings)
    for i, ax in enumerate(axes):
        for n, (recording, grey) in enumerate(zip(recordings, greys, strict=True), 1):
            # The shades between the first and the last are in order.
            is_named = count > 1 and (count <= _MOST_NAMES or n in (1, count))
            label = f"recording {n}" if is_named else None
            values = recording.values[:, i]
            ax.plot(recording.time, values, color=grey, linewidth=0.8, label=label)
    return finish_times(axes, labels, title=_title(recordings))


def draw_demonstrations_in_plane(
    demonstrations: Demonstrations, *, ax: Axes | None = None
) -> Axes:
    """Draw the paths of recordings in the plane of their first two channels (Fig. 3b).

    Parameters
    ----------
    demonstrations : Demonstration or sequence of Demonstration
    ax : Axes, optional
        Axes of a new figure if None.
    """
    recordings = demonstration_list(demonstrations, "a picture")
    panel = PlanePanel(Channels.of_demonstrations(recordings), ax)
    for recording, grey in zip(recordings, _greys(len(recordings)), strict=True):
        panel.path(recording.values, color=grey, linewidth=0.6)
    return panel.finish(_title(recordings))


def _greys(count: int) -> list[str]:
    """Return shades of grey for a number of recordings."""
    if count == 1:
        return ["0.45"]
    return [f"{grey:.2f}" for grey in np.linspace(0.3, 0.75, count)]


def _title(demonstrations: Sequence[Demonstration]) -> str:
    seconds = sum(d.duration for d in demonstrations)
    if len(demonstrations) == 1:
        return f"demonstrated: {seconds:.0f} s"
    return f"demonstrated: {len(demonstrations)} recordings, {seconds:.0f} s"


def draw_windows_in_plane(
    skill: FourierMovementPrimitive, demonstrations: Demonstrations, ax: Axes
) -> Axes:
    """Draw the windows from which a skill is learned, over each other (Fig. 3b).

    At most 60 windows are drawn, evenly spaced, in the colour of their most probable
    component.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted; its parameters determine the windows.
    demonstrations : Demonstration or sequence of Demonstration
    ax : Axes
    """
    panel = PlanePanel(Channels.of_skill(skill), ax)
    windows = _windows(skill, demonstrations)
    count, seconds = len(windows), skill.n_steps / skill.rate
    title = f"{count_text(count, 'window')} of {seconds:g} s"
    if count > _MAX_WINDOWS:
        title = f"{_MAX_WINDOWS} of {title}"
        windows = windows[np.linspace(0, count - 1, _MAX_WINDOWS).round().astype(int)]
    weights = skill.analyze(windows)
    densities = np.stack([c.log_density(weights) for c in skill.components_], axis=-1)
    numbers = np.argmax(densities + np.log(skill.proportions_), axis=-1)
    for window, number in zip(windows, numbers, strict=True):
        panel.path(window, color=component_color(number), linewidth=0.7, alpha=0.8)
    return panel.finish(title)


def _windows(skill: FourierMovementPrimitive, demonstrations: Demonstrations) -> Array:
    """Return the windows (N, T, D) from which a skill would be learned."""
    recordings = demonstration_list(demonstrations, "a picture")
    Channels.of_skill(skill).check(recordings)
    longest = max(d.duration for d in recordings)
    is_short = round(longest * skill.rate) + 1 < skill.n_steps
    is_one_cycle = skill.rhythm_ is not None and skill.rhythm_.is_one_cycle
    if is_short and skill.paths_ and (len(recordings) > 1 or is_one_cycle):
        # Recordings of one cycle each are joined, or closed, before learning.
        recordings = learned_parts(skill, recordings[0])
    return as_windows(
        recordings,
        n_steps=skill.n_steps,
        stride=skill.window_stride,
        rate=skill.rate,
        at_least=1,
    ).values


def learned_parts(
    skill: FourierMovementPrimitive, recording: Demonstration
) -> list[Demonstration]:
    """Return the paths of which a skill was learned, like one of its recordings."""
    return [
        replace(recording, time=np.arange(len(path)) / skill.rate, values=path)
        for path in skill.paths_
    ]


def draw_spectra(
    skill: FourierMovementPrimitive,
    demonstrations: Demonstrations,
    axes: Sequence[Axes],
) -> tuple[Axes, ...]:
    """Draw the amplitudes of the harmonics of the windows, with their spread.

    A point is the median over the windows; its bar contains 90 % of them. The constant
    part and high frequencies without power are omitted.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted; its parameters determine the windows.
    demonstrations : Demonstration or sequence of Demonstration
    axes : sequence of Axes
        One for each channel.
    """
    windows = _windows(skill, demonstrations)
    amplitudes = polar(windows)[0][:, 1:]  # (N, harmonics, D), without the constant
    count = _harmonic_count(amplitudes)
    frequencies = np.arange(1, count + 1) * skill.rate / skill.n_steps
    for i, ax in enumerate(axes):
        low, middle, high = np.percentile(amplitudes[:, :count, i], [5, 50, 95], axis=0)
        bars = ax.vlines(frequencies, low, high, color=DEMONSTRATED, linewidth=3.0)
        bars.set_label("5 to 95 %")
        ax.plot(frequencies, middle, "o", color="0.15", markersize=3.5, label="median")
        ax.set_ylim(0, max(ax.get_ylim()[1], _LEAST_AMPLITUDE))
        ax.set_xlim(left=0)
    title = f"harmonics of {count_text(len(windows), 'window')}"
    labels = Channels.of_skill(skill).labels
    return finish_times(axes, labels, title=title, xlabel="frequency (Hz)")


def _harmonic_count(amplitudes: Array) -> int:
    """Return the number of harmonics with 99 % of the power of every channel."""
    power = np.mean(amplitudes**2, axis=0)
    total = np.maximum(np.sum(power, axis=0), _LEAST_AMPLITUDE**2)
    fraction = np.cumsum(power, axis=0) / total
    count = 1 + int(np.max(np.argmax(fraction >= _POWER_FRACTION, axis=0)))
    return min(max(count, _MIN_HARMONICS), amplitudes.shape[1])
