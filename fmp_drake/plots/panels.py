"""The axes of a picture: one in the plane of two channels, or a stack over time."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from fmp_drake.errors import RunError
from fmp_drake.plots.channels import Channels, Demonstrations, as_list
from fmp_drake.plots.style import (
    DEMONSTRATED,
    finish_times,
    legend_above,
    set_title,
    shape_of,
)

# Of a picture with axes of equal scale: the shorter side beside the longer.
_NARROWEST = 0.4
_PLANE_WIDTH = 5.5  # inches, of a figure of its own


class PlanePanel:
    """One picture in the plane: given axes, or those of a new figure.

    Parameters
    ----------
    channels : Channels
    plane : sequence of two str, optional
        The upward channel and the one to the left; the first two where None.
    ax : Axes, optional
        A new figure is made, and fitted to what is drawn, where None.

    Attributes
    ----------
    ax : Axes
    plane : tuple of int
        Indices of the two channels.
    """

    def __init__(
        self, channels: Channels, plane: Sequence[str] | None, ax: Axes | None
    ) -> None:
        self.plane = channels.plane(plane)
        self._channels = channels
        self._figure: Figure | None = None
        if ax is None:
            self._figure = Figure((_PLANE_WIDTH, _PLANE_WIDTH), layout="constrained")
            ax = self._figure.subplots()
        self.ax = ax

    def path(self, values: ArrayLike, **style: Any) -> None:
        """Draw values (N, D) as one line."""
        up, left = np.asarray(values, dtype=float)[:, self.plane].T
        self.ax.plot(left, up, **style)

    def background(self, demonstrations: Demonstrations) -> None:
        """Draw demonstrations of the same channels in grey."""
        recorded = as_list(demonstrations)
        self._channels.check(recorded)
        for one in recorded:
            self.grey_path(one.values)

    def grey_path(self, values: ArrayLike) -> None:
        """Draw demonstrated values (N, D) as the background of what else is drawn."""
        style = {"color": DEMONSTRATED, "linewidth": 0.4, "zorder": 1.5}
        self.path(values, label="demonstrated", **style)

    def finish(self, title: str) -> Axes:
        """Set title and labels, orient the plane, and return the axes."""
        up, left = self.plane
        ax = self.ax
        set_title(ax, title)
        ax.autoscale_view()
        ax.xaxis.set_inverted(True)
        ax.set_xlabel(self._channels.label(left))
        ax.set_ylabel(self._channels.label(up))
        ax.locator_params(nbins=6)
        if self._channels.units[up] == self._channels.units[left]:
            ax.set_aspect("equal")
            _widen(ax)
            if self._figure is not None:
                ratio = shape_of(np.ptp(ax.get_ylim()), np.ptp(ax.get_xlim()))
                self._figure.set_figheight(1.0 + (_PLANE_WIDTH - 1.2) * ratio)
        return ax


def _widen(ax: Axes) -> None:
    """Let no side be so short beside the other that the labels of its ticks overlap."""
    low, high = np.reshape(ax.dataLim.extents, (2, 2))
    if np.all(np.isfinite([low, high])):
        middle, half = (low + high) / 2, 0.5 * _NARROWEST * np.max(high - low)
        ax.update_datalim([middle - half, middle + half])
        ax.autoscale_view()


class TimePanels:
    """A stack of axes over time, one for each of some channels, with an optional strip.

    Iterating gives the axes and the index of each channel.

    Parameters
    ----------
    channels : Channels
    names : sequence of str, optional
        The channels to draw; all where None.
    axes : Axes or sequence of Axes, optional
        Those of a new figure where None.
    strip : bool
        Whether a low one without a channel is added at the bottom.

    Attributes
    ----------
    axes : tuple of Axes
    """

    def __init__(
        self,
        channels: Channels,
        names: Sequence[str] | None,
        axes: Axes | Sequence[Axes] | None,
        *,
        strip: bool = False,
    ) -> None:
        self._indices = channels.indices(names)
        self._labels = [channels.label(i) for i in self._indices]
        count = len(self._indices)
        if axes is None:
            figure = Figure(figsize=(9, 1 + 1.5 * count + strip), layout="constrained")
            ratios = [1.0] * count + [0.25] * strip
            rows = figure.subplots(
                count + strip, sharex=True, squeeze=False, height_ratios=ratios
            )
            self.axes = tuple(rows[:, 0])
        else:
            self.axes = (axes,) if isinstance(axes, Axes) else tuple(axes)
        if len(self.axes) != count + strip:
            raise RunError(
                f"{len(self.axes)} axes are given; this picture needs {count + strip}: "
                f"one for each of its {count} channels"
                f"{' and one for the strip' if strip else ''}."
            )

    def __iter__(self) -> Iterator[tuple[Axes, int]]:
        """Iterate over axes and indices of the channels."""
        return iter(zip(self.axes, self._indices, strict=False))

    def finish(
        self, title: str, *, xlabel: str = "time (s)", last: str = ""
    ) -> tuple[Axes, ...]:
        """Set title, legend and labels, and return the axes; `last` names the strip."""
        first = self.axes[0]
        set_title(first, title)
        legend_above(first)
        finish_times(
            self.axes, [*self._labels, *([last] if last else [])], xlabel=xlabel
        )
        return self.axes
