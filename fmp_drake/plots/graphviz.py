"""The block diagram of a station as a picture, through Graphviz.

Drake's own `GetGraphvizString` shows every port of every system; of a plant alone
those are fifty. This one shows what is connected or exported, from left to right: the
plant is cut in two, what it measures at the left, what acts on it at the right.
"""

import html
import shutil
import subprocess
from collections import Counter
from collections.abc import Collection, Iterable
from itertools import zip_longest
from pathlib import Path
from typing import Any

from pydrake.systems.framework import Diagram, InputPortIndex, OutputPortIndex

from fmp_drake.errors import RunError
from fmp_drake.primitives.data.files import check_writable, replaced, write_text

_FORMATS = (".svg", ".png", ".pdf", ".dot")
_DOTS_PER_INCH = "110"

_HEAD = """digraph station {
rankdir=LR; nodesep=0.25; ranksep=0.9; splines=spline; pad=0.2; newrank=true;
fontname="Helvetica,Arial,sans-serif"; fontsize=11; fontcolor="#555555"; labelloc=b;
label="green: an output port of the station, blue: an input port";
node [shape=plain, fontname="Helvetica,Arial,sans-serif", fontsize=10];
edge [color="#555555", arrowsize=0.6];
"""
_PLAIN, _EXPORTED, _IMPORTED = "#FFFFFF", "#D5EBDD", "#D3E3F3"


def check_graph(path: Path | None) -> None:
    """Refuse a picture of a diagram that cannot be made, before any work is done."""
    if path is None:
        return
    check_writable(path)
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise RunError(
            f"{path} is no picture of a diagram; let its name end in "
            f"{', '.join(_FORMATS[:-1])} or {_FORMATS[-1]}."
        )
    if suffix != ".dot" and shutil.which("dot") is None:
        raise RunError(
            f"{path.name} needs the program dot of Graphviz; install it (on Ubuntu "
            "and Debian: apt-get install graphviz), or write a .dot."
        )


def write_graph(diagram: Diagram, path: Path) -> None:
    """Write the block diagram of a diagram (.svg, .png, .pdf, .dot).

    Raises
    ------
    RunError
        Where it cannot be made; an existing file is then as before.
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


def graph_text(diagram: Diagram, *, split: Collection[str] = ("plant",)) -> str:
    """Return a diagram in the language of Graphviz.

    Parameters
    ----------
    diagram : Diagram
    split : collection of str
        Names of the systems whose inputs and outputs are shown apart.
    """
    inputs: dict[str, dict[int, str]] = {}
    outputs: dict[str, dict[int, str]] = {}
    wires = sorted(
        (source.get_name(), int(y), to.get_name(), int(u))
        for (to, u), (source, y) in diagram.connection_map().items()
    )
    for source_name, y, name, u in wires:
        outputs.setdefault(source_name, {})[y] = _PLAIN
        inputs.setdefault(name, {})[u] = _PLAIN
    for i in range(diagram.num_output_ports()):
        source, port = diagram.get_output_port_locator(OutputPortIndex(i))
        outputs.setdefault(source.get_name(), {})[int(port)] = _EXPORTED
    for i in range(diagram.num_input_ports()):
        for to, number in diagram.GetInputPortLocators(InputPortIndex(i)):
            inputs.setdefault(to.get_name(), {})[int(number)] = _IMPORTED
    nodes = []
    for system in diagram.GetSystems():
        name = system.get_name()
        ins = _cells(system, inputs.get(name, {}), "u")
        outs = _cells(system, outputs.get(name, {}), "y")
        if name in split:
            nodes.append(_table(_node(name, split, "in"), system, ins, []))
            nodes.append(_table(_node(name, split, "out"), system, [], outs))
        else:
            nodes.append(_table(_node(name, split, ""), system, ins, outs))
    order = [system.get_name() for system in diagram.GetSystems()]
    between = Counter((a, b) for a, _, b, _ in wires if not {a, b} & set(split))
    edges = []
    for a, y, b, u in wires:
        forth, back = between[a, b], between[b, a]
        # Of two systems that feed each other, the one that gives more stands left.
        behind = back > forth or (forth == back and order.index(a) < order.index(b))
        edges.append(
            f"{_node(a, split, 'out')}:y{y}:e -> {_node(b, split, 'in')}:u{u}:w"
            f"{' [constraint=false]' if back and behind else ''};"
        )
    return _HEAD + "\n".join([*nodes, *edges]) + "\n}\n"


def _node(name: str, split: Collection[str], side: str) -> str:
    return f'"{name} {side}"' if name in split else f'"{name}"'


def _cells(system: Any, colors: dict[int, str], letter: str) -> list[str]:
    """Return the table cells of a system's ports, in their order."""
    get = system.get_input_port if letter == "u" else system.get_output_port
    align = "left" if letter == "u" else "right"
    return [
        f'<TD PORT="{letter}{i}" BGCOLOR="{colors[i]}" ALIGN="{align}">'
        f"{html.escape(get(i).get_name())}</TD>"
        for i in sorted(colors)
    ]


def _table(node: str, system: Any, ins: Iterable[str], outs: Iterable[str]) -> str:
    """Return a node: its name, its type, and its ports in one or two columns."""
    ins, outs = list(ins), list(outs)
    columns = max(1, bool(ins) + bool(outs))
    if columns == 2:
        rows = ["".join(pair) for pair in zip_longest(ins, outs, fillvalue="<TD></TD>")]
    else:
        rows = ins or outs
    kind = system.GetSystemType().rsplit("::", 1)[-1].rsplit(".", 1)[-1]
    head = (
        f'<TD COLSPAN="{columns}" BGCOLOR="#EEEEEE"><B>{html.escape(system.get_name())}'
        f'</B><BR/><FONT POINT-SIZE="8">{html.escape(kind.split("<")[0])}</FONT></TD>'
    )
    body = "".join(f"<TR>{row}</TR>" for row in [head, *rows])
    return (
        f'{node} [label=<<TABLE BORDER="0" CELLBORDER="1" CELLSPACING="0" '
        f'CELLPADDING="3" COLOR="#999999">{body}</TABLE>>];'
    )
