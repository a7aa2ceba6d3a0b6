"""Files that the commands write: refused before any work is done."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

from fmp_drake.errors import FmpError


def check_writable(path: Path | None) -> None:
    """Refuse an output file that cannot be written, before any work is done."""
    if path is None:
        return
    if not path.absolute().parent.is_dir():
        raise FmpError(
            f"there is no folder {path.absolute().parent} to write {path.name} into."
        )
    if path.is_dir():
        raise FmpError(f"{path} is a folder; give the name of a file to write.")


def check_picture(path: Path | None) -> None:
    """Refuse a picture that cannot be written, before any work is done."""
    check_writable(path)
    kinds = FigureCanvasAgg.get_supported_filetypes()
    if path is not None and path.suffix.lower().removeprefix(".") not in kinds:
        raise FmpError(f"{path} is no picture; let its name end in .png, .svg or .pdf.")
