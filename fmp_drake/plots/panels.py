"""Channels of a picture, and its axes in the plane or over time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from fmp_drake.errors import RunError
from fmp_drake.plots.style import (
    DEMONSTRATED,
    finish_times,
    legend_above,
    set_title,
    shape_of,
)
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive

type Demonstrations = Demonstration | Sequence[Demonstration]

# Smallest ratio of the shorter to the longer side of axes with equal scales.
_MIN_RATIO = 0.4
_PLANE_WIDTH = 5.5  # Of a figure with one picture, inches.


@dataclass(frozen=True)
class Channels:
    """Names and units of the channels of a skill or of demonstrations.

    Attributes
    ----------
    names, units : tuple of str
    """

    names: tuple[str, ...]
    units: tuple[str, ...]

    @classmethod
    def of_skill(cls, skill: FourierMovementPrimitive) -> Self:
        """Return the channels of a fitted skill."""
        skill.check_fitted()
        return cls(skill.channels_, skill.units_)

    @classmethod
    def of_demonstrations(cls, demonstrations: Sequence[Demonstration]) -> Self:
        """Return the common channels of demonstrations."""
        if not demonstrations:
            raise RunError("there is no demonstration; give at least one.")
        channels = cls(demonstrations[0].channels, demonstrations[0].units)
        channels.check(demonstrations)
        return channels

    def check(self, demonstrations: Sequence[Demonstration]) -> None:
        """Raise a RunError if a demonstration has other channels."""
        for number, demonstration in enumerate(demonstrations):
            if demonstration.channels != self.names:
                raise RunError(
                    f"demonstration {number} has the channels "
                    f"{', '.join(demonstration.channels)}; the others and the skill "
                    f"in this picture have {', '.join(self.names)}. Select the same "
                    "ones (Demonstration.select)."
                )

    def label(self, index: int) -> str:
        """Return the name and the unit of a channel."""
        return f"{self.names[index]} ({self.units[index]})"


def as_list(demonstrations: Demonstrations) -> list[Demonstration]:
    """Return one or several demonstrations as a list."""
    if isinstance(demonstrations, Demonstration):
        return [demonstrations]
    return list(demonstrations)


class PlanePanel:
    """Picture in the plane of the first two channels: x upwards, y to the left.

    Parameters
    ----------
    channels : Channels
        At least two.
    ax : Axes, optional
        Axes of a new figure, fitted to its content, if None.

    Attributes
    ----------
    ax : Axes
    """

    def __init__(self, channels: Channels, ax: Axes | None) -> None:
        if len(channels.names) < 2:
            raise RunError(
                f"there is only the channel {channels.names[0]}; a picture in the "
                "plane needs two. Draw it over time."
            )
        self._channels = channels
        self._figure: Figure | None = None
        if ax is None:
            self._figure = Figure((_PLANE_WIDTH, _PLANE_WIDTH), layout="constrained")
            ax = self._figure.subplots()
        self.ax = ax

    def path(self, values: ArrayLike, **style: Any) -> None:
        """Draw values (N, D) as a line."""
        self.ax.plot(*np.asarray(values, dtype=float)[:, [1, 0]].T, **style)

    def background(self, demonstrations: Demonstrations) -> None:
        """Draw demonstrations of the same channels in grey."""
        recordings = as_list(demonstrations)
        self._channels.check(recordings)
        for recording in recordings:
            self.grey_path(recording.values)

    def grey_path(self, values: ArrayLike) -> None:
        """Draw demonstrated values (N, D) behind everything else."""
        style = {"color": DEMONSTRATED, "linewidth": 0.4, "zorder": 1.5}
        self.path(values, label="demonstrated", **style)

    def finish(self, title: str) -> Axes:
        """Set title and labels, orient the plane, and return the axes."""
        ax = self.ax
        set_title(ax, title)
        ax.autoscale_view()
        ax.xaxis.set_inverted(True)
        ax.set_xlabel(self._channels.label(1))
        ax.set_ylabel(self._channels.label(0))
        ax.locator_params(nbins=6)
        if self._channels.units[0] == self._channels.units[1]:
            ax.set_aspect("equal")
            _widen(ax)
            if self._figure is not None:
                ratio = shape_of(np.ptp(ax.get_ylim()), np.ptp(ax.get_xlim()))
                self._figure.set_figheight(1.0 + (_PLANE_WIDTH - 1.2) * ratio)
            else:
                _thin_out_ticks(ax)
        return ax


def _thin_out_ticks(ax: Axes) -> None:
    """Reduce the ticks of a small picture, whose labels would overlap."""
    ax.locator_params(nbins=4)
    ratio = abs(np.ptp(ax.get_xlim()) / np.ptp(ax.get_ylim()))
    shorter: Literal["x", "y"] = "x" if ratio < 1 else "y"
    if (ratio := min(ratio, 1 / ratio)) < 0.8:
        bins = max(2, int(4 * ratio))
        ax.locator_params(axis=shorter, nbins=bins, min_n_ticks=2)


def _widen(ax: Axes) -> None:
    """Limit the aspect ratio so that the labels of ticks do not overlap."""
    low, high = np.reshape(ax.dataLim.extents, (2, 2))
    if np.all(np.isfinite([low, high])):
        middle, half = (low + high) / 2, 0.5 * _MIN_RATIO * np.max(high - low)
        ax.update_datalim([middle - half, middle + half])
        ax.autoscale_view()


class TimePanels:
    """Axes over time below each other, one for each channel, with an optional strip.

    Iteration yields the axes and the index of each channel.

    Parameters
    ----------
    channels : Channels
    axes : sequence of Axes
        One for each channel, then one for the strip, if any.
    """

    def __init__(self, channels: Channels, axes: Sequence[Axes]) -> None:
        self._channels = channels
        self._axes = tuple(axes)

    def __iter__(self) -> Iterator[tuple[Axes, int]]:
        """Iterate over axes and indices of the channels."""
        indices = range(len(self._channels.names))
        return iter(zip(self._axes, indices, strict=False))

    def finish(
        self, title: str, *, xlabel: str = "time (s)", strip: str = ""
    ) -> tuple[Axes, ...]:
        """Set title, legend and labels; return the axes. `strip` is the strip's label."""
        labels = [self._channels.label(i) for _, i in self]
        set_title(self._axes[0], title)
        legend_above(self._axes[0])
        finish_times(self._axes, [*labels, *([strip] if strip else [])], xlabel=xlabel)
        return self._axes
