"""Checks of the files that pictures are written to, before any work is done."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import check_writable


def check_picture(path: Path | None) -> None:
    """Check that a picture can be written to a file, before any work is done.

    Parameters
    ----------
    path : pathlib.Path, optional
        Nothing is checked where None.

    Raises
    ------
    RunError
        Where Matplotlib does not write files of its ending.
    FmpError
        Where its folder does not exist, or it is a folder.
    """
    check_writable(path)
    kinds = FigureCanvasAgg.get_supported_filetypes()
    if path is not None and path.suffix.lower().removeprefix(".") not in kinds:
        raise RunError(f"{path} is no picture; let its name end in .png, .svg or .pdf.")
