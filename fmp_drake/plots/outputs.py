"""Files of pictures: refused before any work is done."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import check_writable


def check_picture(path: Path | None) -> None:
    """Refuse a picture that cannot be written, before any work is done."""
    check_writable(path)
    kinds = FigureCanvasAgg.get_supported_filetypes()
    if path is not None and path.suffix.lower().removeprefix(".") not in kinds:
        raise RunError(f"{path} is no picture; let its name end in .png, .svg or .pdf.")
