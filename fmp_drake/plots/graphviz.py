"""Pictures of block diagrams: Drake's graph, drawn by Graphviz."""

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import check_writable, replaced, write_text

if TYPE_CHECKING:
    from pydrake.systems.framework import Diagram

_FORMATS = (".svg", ".png", ".pdf", ".dot")
_DOTS_PER_INCH = "110"
# The systems of the diagram, without those of its subdiagrams. The inputs and outputs of
# the plant are separate nodes, so that the loop is drawn from left to right.
_DEPTH, _OPTIONS = 1, {"plant/split": "I/O"}


def check_graph(path: Path | None) -> None:
    """Check that a picture of a diagram can be made, before any work is done."""
    if path is None:
        return
    check_writable(path, "a picture of a diagram", _FORMATS, RunError)
    if path.suffix.lower() != ".dot" and shutil.which("dot") is None:
        raise RunError(
            f"{path.name} needs the program dot of Graphviz; install it (on Ubuntu "
            "and Debian: apt-get install graphviz), or write a .dot."
        )


def write_graph(diagram: "Diagram", path: Path) -> None:
    """Write a picture of a diagram: its systems, their ports and connections.

    Parameters
    ----------
    diagram : Diagram
    path : pathlib.Path
        Ends in .svg, .png, .pdf or .dot.

    Raises
    ------
    RunError
        If it cannot be made; an existing file then remains unchanged.
    """
    path = Path(path)
    check_graph(path)
    text = diagram.GetGraphvizString(max_depth=_DEPTH, options=_OPTIONS)
    suffix = path.suffix.lower()
    if suffix == ".dot":
        write_text(path, text, RunError)
        return
    try:
        with replaced(path, RunError) as part:
            command = ["dot", f"-T{suffix[1:]}", "-o", str(part)]
            if suffix == ".png":
                command.append(f"-Gdpi={_DOTS_PER_INCH}")
            subprocess.run(
                command, input=text.encode(), capture_output=True, check=True
            )
    except subprocess.CalledProcessError as error:
        message = error.stderr.decode(errors="replace").strip() or error.returncode
        raise RunError(f"dot could not make {path}: {message}.") from None
