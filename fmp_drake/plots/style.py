"""Colours, channels, axes, legends and file formats of all pictures."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import ArrayLike

from fmp_drake.errors import RunError
from fmp_drake.numeric import Array
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.data.channels import POSITION_CHANNELS
from fmp_drake.primitives.data.files import check_writable, replaced
from fmp_drake.primitives.data.windows import demonstration_list

if TYPE_CHECKING:
    from fmp_drake.station.scenario_parts import BoardConfig

# Colours of Okabe and Ito, which colour-blind people can distinguish.
DEMONSTRATED = "0.65"
SAMPLED = "#0072B2"
PLAYED = "#D55E00"
INFEASIBLE = "#B2182B"

# Colours of the components: the scheme of Paul Tol, for colour-blind people, too.
_COMPONENTS = (
    "#332288",
    "#44AA99",
    "#CC6677",
    "#DDCC77",
    "#88CCEE",
    "#117733",
    "#AA4499",
    "#999933",
    "#661100",
    "#882255",
)
# Two of these colours may look the same: lines in one picture differ in style, too.
_LINE_STYLES = ("-", "--", ":", "-.")

# Without the yellow end of viridis, which is hardly visible on white.
TIME_MAP: Colormap = LinearSegmentedColormap.from_list(
    "fmp_time", matplotlib.colormaps["viridis"](np.linspace(0.0, 0.88, 256))
)
# It begins with white, so that rarely visited cells fade out.
DENSITY_MAP: Colormap = LinearSegmentedColormap.from_list(
    "fmp_density", [(1, 1, 1, 1), *matplotlib.colormaps["magma_r"](np.linspace(0.1, 1))]
)
type Demonstrations = Demonstration | Sequence[Demonstration]
# Smallest ratio of the shorter to the longer side of axes with equal scales.
_MIN_RATIO = 0.4
_LONGEST_NAME = 12  # Of a channel, letters.
_PLANE_WIDTH = 5.5  # Of a figure with one picture, inches.


def component_color(component: int) -> str:
    """Return the colour of a component; ten colours repeat."""
    return _COMPONENTS[component % len(_COMPONENTS)]


def series_style(number: int) -> dict[str, Any]:
    """Return colour and line style of one of several lines in a picture."""
    style = _LINE_STYLES[number % len(_LINE_STYLES)]
    return {"color": component_color(number), "linestyle": style}


def lighten(color: str, white: float) -> tuple[float, ...]:
    """Mix a colour with a fraction of white; overlaps of opaque colours do not add up."""
    return tuple(float(c) for c in (1 - white) * np.array(to_rgb(color)) + white)


def shape_of(height: float, width: float) -> float:
    """Return the ratio of height to width, limited to 0.4 to 1.3."""
    return float(np.clip(height / max(width, 1e-12), 0.4, 1.3))


def same_limits(axes: Sequence[Axes]) -> None:
    """Set common limits of pictures in the plane, which contain all of their limits."""
    xs, ys = np.ravel([ax.get_xlim() for ax in axes]), [ax.get_ylim() for ax in axes]
    for ax in axes:
        ax.set_xlim(xs.max(), xs.min())
        ax.set_ylim(np.min(ys), np.max(ys))


def finish_times(
    axes: Sequence[Axes],
    labels: Sequence[str],
    *,
    title: str = "",
    xlabel: str = "time (s)",
) -> tuple[Axes, ...]:
    """Label axes below each other, with labels in one line, and return them.

    With a title, the first of them gets it and a legend. Only the last gets the label of
    the time.
    """
    if title:
        set_title(axes[0], title)
        legend_above(axes[0])
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        ax.spines[["top", "right"]].set_visible(False)
        ax.autoscale_view()
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)
    axes[-1].set_xlabel(xlabel)
    axes[0].figure.align_ylabels(axes)
    return tuple(axes)


def add_lines(
    ax: Axes, lines: ArrayLike, colors: ArrayLike, **style: Any
) -> LineCollection:
    """Draw lines (n, points, 2), each in the colour of a number (n,)."""
    collection = LineCollection(
        list(np.asarray(lines, dtype=float)),
        array=np.asarray(colors, dtype=float),
        capstyle="round",
        **style,
    )
    ax.add_collection(collection)
    ax.autoscale_view()
    return collection


def add_colorbar(
    ax: Axes, mappable: ScalarMappable, label: str, *, extend: str = "neither"
) -> None:
    """Add a colour bar to the right of a picture in the plane."""
    # Inset axes have the height of axes with an equal aspect, too.
    cax = ax.inset_axes((1.03, 0.0, 0.035, 1.0))
    bar = ax.figure.colorbar(mappable, cax=cax, label=label, extend=extend)
    bar.outline.set_visible(False)


def legend_above(ax: Axes) -> int:
    """Add a legend above the axes at the right, with each label once, if any.

    Return the number of its rows.
    """
    handles, labels = ax.get_legend_handles_labels()
    handles_by_label = dict(zip(labels, handles, strict=True))
    if not handles_by_label:
        return 0
    columns = 4 if len(handles_by_label) <= 4 else 3
    legend = ax.legend(
        handles_by_label.values(),
        handles_by_label,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        columnspacing=1.2,
        handlelength=1.5,
        frameon=False,
        borderaxespad=0.0,
        fontsize="small",
    )
    for line in legend.get_lines():
        line.set_linewidth(max(1.0, line.get_linewidth()))
    return -(-len(handles_by_label) // columns)


def label_decades(axis: Axis, multiples: Sequence[float]) -> None:
    """Label multiples of powers of ten on a logarithmic axis, as decimal numbers."""
    axis.set_major_locator(LogLocator(subs=multiples))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def with_unit(text: str, unit: str) -> str:
    """Return the label of an axis; a unit of 1 is left out."""
    return text if unit == "1" else f"{text} ({unit})"


def set_title(ax: Axes, title: str) -> None:
    """Set the title at the left."""
    ax.set_title(title, loc="left", fontsize="medium")


def check_picture(path: Path | None) -> None:
    """Check that a picture can be written to a file, before any work is done.

    Parameters
    ----------
    path : pathlib.Path, optional
        Nothing is checked if None.

    Raises
    ------
    RunError
        If Matplotlib does not write files with its suffix.
    FmpError
        If its folder does not exist, or it is a folder.
    """
    check_writable(path)
    formats = FigureCanvasAgg.get_supported_filetypes()
    if path is not None and path.suffix.lower().removeprefix(".") not in formats:
        raise RunError(
            f"{path} is not a picture; its name must end in .png, .svg or .pdf."
        )


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure in the format of the name's suffix."""
    path = Path(path)
    # Fonts of type 42 keep the text of a PDF searchable.
    with (
        replaced(path, RunError) as part,
        matplotlib.rc_context({"pdf.fonttype": 42}),
        warnings.catch_warnings(),
    ):
        # A letter that the font lacks is drawn as a box.
        warnings.filterwarnings("ignore", message="Glyph")
        try:
            figure.savefig(part, dpi=150)
        except ValueError as error:
            raise RunError(f"cannot write {path}: {error}.") from None


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

    @classmethod
    def of_board(cls, board: "BoardConfig") -> Self:
        """Return the coordinates of a position: (u, v, h) on a curved board."""
        is_plane = board.curvature().is_plane
        return cls(POSITION_CHANNELS if is_plane else ("u", "v", "h"), ("m",) * 3)

    def check(self, demonstrations: Sequence[Demonstration]) -> None:
        """Raise a RunError if a demonstration has other channels."""
        for number, demonstration in enumerate(demonstrations, 1):
            if demonstration.channels != self.names:
                raise RunError(
                    f"demonstration {number} has the channels "
                    f"{', '.join(demonstration.channels)}; the others in this picture "
                    f"have {', '.join(self.names)}. Draw them separately, or choose "
                    "the same ones (--columns, Demonstration.select)."
                )

    @property
    def short_names(self) -> list[str]:
        """Names for a picture: the ends of long ones, without Matplotlib's formulas."""
        names = [
            name if len(name) <= _LONGEST_NAME else f"…{name[1 - _LONGEST_NAME :]}"
            for name in self.names
        ]
        # A legend leaves out what begins with an underscore.
        return [re.sub("^_", " _", name.replace("$", r"\$")) for name in names]

    @property
    def labels(self) -> list[str]:
        """Short name and unit of each channel."""
        pairs = zip(self.short_names, self.units, strict=True)
        return [with_unit(name, unit) for name, unit in pairs]

    def ranges(self, extent: Array) -> Array:
        """Return the largest range of the channels with each channel's unit, shape (D,).

        `extent` (2, D) has the least and the greatest value of each channel.
        """
        units = np.array(self.units)
        ranges = np.ptp(extent, axis=0)
        return np.array([np.max(ranges[units == unit]) or 1.0 for unit in units])


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

    def starts(self, values: ArrayLike) -> None:
        """Mark starts (S, D) by rings, in front of everything else."""
        ring = {"markerfacecolor": "white", "markeredgecolor": PLAYED, "markersize": 8}
        style = {"linestyle": "", "marker": "o", "markeredgewidth": 2.0, "zorder": 4.0}
        self.path(values, label="start", **style, **ring)

    def background(self, demonstrations: Demonstrations) -> None:
        """Draw demonstrations of the same channels in grey."""
        recordings = demonstration_list(demonstrations, "a picture")
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
        ylabel, xlabel, *_ = self._channels.labels
        ax.set(xlabel=xlabel, ylabel=ylabel)
        ax.locator_params(nbins=6)
        if self._channels.units[0] == self._channels.units[1]:
            ax.set_aspect("equal")
            _widen(ax)
            if self._figure is not None:
                ratio = shape_of(np.ptp(ax.get_ylim()), np.ptp(ax.get_xlim()))
                self._figure.set_figheight(1.0 + (_PLANE_WIDTH - 1.2) * ratio)
            else:
                _thin_out_ticks(ax)
        elif self._figure is None:
            ax.locator_params(nbins=4)
        return ax


def _thin_out_ticks(ax: Axes) -> None:
    """Reduce the ticks of a small picture, whose labels would overlap."""
    ax.locator_params(nbins=4)
    ratio = abs(np.ptp(ax.get_xlim()) / np.ptp(ax.get_ylim()))
    shorter: Literal["x", "y"] = "x" if ratio < 1 else "y"
    if (ratio := min(ratio, 1 / ratio)) < 0.8:
        # Labels side by side need more room. One is enough: the scales are equal.
        least = 1 if shorter == "x" else 2
        bins = max(least, int(4 * ratio))
        ax.locator_params(axis=shorter, nbins=bins, min_n_ticks=least)


def _widen(ax: Axes) -> None:
    """Limit the aspect ratio so that the labels of ticks do not overlap."""
    low, high = np.reshape(ax.dataLim.extents, (2, 2))
    if np.all(np.isfinite([low, high])):
        middle, half = (low + high) / 2, 0.5 * _MIN_RATIO * np.max(high - low)
        ax.update_datalim([middle - half, middle + half])
        ax.autoscale_view()
