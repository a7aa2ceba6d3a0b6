"""Common colours, axes, legends and file formats of all pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

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
from fmp_drake.primitives.data.files import check_writable, replaced

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
    axes: Sequence[Axes], labels: Sequence[str], *, xlabel: str = "time (s)"
) -> None:
    """Label axes below each other; only the last gets the label of the time."""
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        ax.spines[["top", "right"]].set_visible(False)
        ax.autoscale_view()
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)
    axes[-1].set_xlabel(xlabel)


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


def legend_above(ax: Axes) -> None:
    """Add a legend above the axes at the right, with each label once, if any."""
    handles, labels = ax.get_legend_handles_labels()
    handles_by_label = dict(zip(labels, handles, strict=True))
    if not handles_by_label:
        return
    legend = ax.legend(
        handles_by_label.values(),
        handles_by_label,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        columnspacing=1.2,
        handlelength=1.5,
        frameon=False,
        borderaxespad=0.0,
        fontsize="small",
    )
    for line in legend.get_lines():
        line.set_linewidth(max(1.0, line.get_linewidth()))


def label_decades(axis: Axis, multiples: Sequence[float]) -> None:
    """Label multiples of powers of ten on a logarithmic axis, as decimal numbers."""
    axis.set_major_locator(LogLocator(subs=multiples))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


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
    ):
        try:
            figure.savefig(part, dpi=150)
        except ValueError as error:
            raise RunError(f"cannot write {path}: {error}.") from None
