"""The block diagram of a station as a picture, through Graphviz.

Drake's own `GetGraphvizString` shows every port of every system; of a plant alone
those are fifty. This one shows what is connected or exported, from left to right: the
plant appears twice, with its outputs at the left and with its inputs at the right.
"""

import html
import shutil
import subprocess
from collections import Counter
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import check_writable, replaced, write_text

if TYPE_CHECKING:
    from pydrake.systems.framework import Diagram

_FORMATS = (".svg", ".png", ".pdf", ".dot")
_DOTS_PER_INCH = "110"

_HEAD = """digraph station {
rankdir=LR; nodesep=0.25; ranksep=0.9; splines=spline; pad=0.2; newrank=true;
fontname="Helvetica,Arial,sans-serif"; fontsize=11; fontcolor="#555555"; labelloc=b;
label="green: an output port of the station, blue: an input port";
node [shape=plain, fontname="Helvetica,Arial,sans-serif", fontsize=10];
edge [color="#555555", arrowsize=0.6];
"""
# The system whose inputs and outputs are shown apart.
_SPLIT = "plant"
# Colours of the ports that are shown, by system, "u" or "y", and index.
type _Ports = dict[tuple[str, str, int], str]
_PLAIN, _EXPORTED, _IMPORTED = "#FFFFFF", "#D5EBDD", "#D3E3F3"


def check_graph(path: Path | None) -> None:
    """Refuse a picture of a diagram that cannot be made, before any work is done."""
    if path is None:
        return
    check_writable(path)
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise RunError(
            f"{path} is not a picture of a diagram; its name must end in "
            f"{', '.join(_FORMATS[:-1])} or {_FORMATS[-1]}."
        )
    if suffix != ".dot" and shutil.which("dot") is None:
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
        Where it cannot be made; an existing file is then left as it was.
    """
    path = Path(path)
    check_graph(path)
    text = graph_text(diagram)
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
        said = error.stderr.decode(errors="replace").strip() or error.returncode
        raise RunError(f"dot could not make {path}: {said}.") from None


def graph_text(diagram: "Diagram") -> str:
    """Return a diagram in the language of Graphviz."""
    from pydrake.systems.framework import InputPortIndex, OutputPortIndex

    wires = sorted(
        (source.get_name(), int(y), to.get_name(), int(u))
        for (to, u), (source, y) in diagram.connection_map().items()
    )
    ports: _Ports = {}
    for a, y, b, u in wires:
        ports[a, "y", y] = ports[b, "u", u] = _PLAIN
    for i in range(diagram.num_output_ports()):
        source, port = diagram.get_output_port_locator(OutputPortIndex(i))
        ports[source.get_name(), "y", int(port)] = _EXPORTED
    for i in range(diagram.num_input_ports()):
        for to, number in diagram.GetInputPortLocators(InputPortIndex(i)):
            ports[to.get_name(), "u", int(number)] = _IMPORTED
    nodes = []
    for system in diagram.GetSystems():
        ins, outs = (_cells(system, letter, ports) for letter in "uy")
        if system.get_name() == _SPLIT:
            nodes += [_node(f"{_SPLIT} in", system, ins, [])]
            nodes += [_node(f"{_SPLIT} out", system, [], outs)]
        else:
            nodes += [_node(system.get_name(), system, ins, outs)]
    order = [system.get_name() for system in diagram.GetSystems()]
    between = Counter((a, b) for a, _, b, _ in wires if _SPLIT not in (a, b))
    edges = []
    for a, y, b, u in wires:
        forth, back = between[a, b], between[b, a]
        # Of two systems that feed each other, the one that gives more stands left.
        behind = back > forth or (forth == back and order.index(a) < order.index(b))
        start = f"{a} out" if a == _SPLIT else a
        end = f"{b} in" if b == _SPLIT else b
        edges.append(
            f'"{start}":y{y}:e -> "{end}":u{u}:w'
            f"{' [constraint=false]' if back and behind else ''};"
        )
    return _HEAD + "\n".join([*nodes, *edges]) + "\n}\n"


def _cells(system: Any, letter: str, ports: _Ports) -> list[str]:
    """Return the table cells of a system's inputs (u) or outputs (y), in their order."""
    get = system.get_input_port if letter == "u" else system.get_output_port
    align = "left" if letter == "u" else "right"
    return [
        f'<TD PORT="{letter}{i}" BGCOLOR="{color}" ALIGN="{align}">'
        f"{html.escape(get(i).get_name())}</TD>"
        for (name, side, i), color in sorted(ports.items())
        if (name, side) == (system.get_name(), letter)
    ]


def _node(name: str, system: Any, ins: list[str], outs: list[str]) -> str:
    """Return a node: its name, its type, and its ports in one or two columns."""
    columns, empty = (2, "<TD></TD>") if ins and outs else (1, "")
    rows = ["".join(pair) for pair in zip_longest(ins, outs, fillvalue=empty)]
    kind = system.GetSystemType().rsplit("::", 1)[-1].rsplit(".", 1)[-1]
    head = (
        f'<TD COLSPAN="{columns}" BGCOLOR="#EEEEEE"><B>{html.escape(system.get_name())}'
        f'</B><BR/><FONT POINT-SIZE="8">{html.escape(kind.split("<")[0])}</FONT></TD>'
    )
    body = "".join(f"<TR>{row}</TR>" for row in [head, *rows])
    return (
        f'"{name}" [label=<<TABLE BORDER="0" CELLBORDER="1" CELLSPACING="0" '
        f'CELLPADDING="3" COLOR="#999999">{body}</TABLE>>];'
    )
