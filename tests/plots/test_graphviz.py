"""Facts about the pictures of diagrams."""

import re
import shutil
import subprocess
from xml.etree import ElementTree

import matplotlib.image
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain, Integrator, PassThrough

from fmp_drake.errors import FmpError
from fmp_drake.plots import graphviz
from fmp_drake.plots.graphviz import check_graph, graph_text, write_graph


@pytest.fixture(scope="module")
def loop():
    """A plant (an integrator) under a controller (a gain) with a feed-forward."""
    builder = DiagramBuilder()
    systems = {
        "controller": Gain(-1.0, 2),
        "sum": Adder(2, 2),
        "plant": Integrator(2),
        "idle": PassThrough(2),
    }
    for name, system in systems.items():
        system.set_name(name)
        builder.AddSystem(system)
    controller, total, plant = (systems[n] for n in ("controller", "sum", "plant"))
    builder.Connect(plant.get_output_port(), controller.get_input_port())
    builder.Connect(controller.get_output_port(), total.get_input_port(0))
    builder.Connect(total.get_output_port(), plant.get_input_port())
    builder.ExportInput(total.get_input_port(1), "feed_forward")
    builder.ExportOutput(plant.get_output_port(), "state")
    return builder.Build()


@pytest.fixture
def dot():
    if shutil.which("dot") is None:
        pytest.skip("pictures of diagrams need Graphviz")


def cell(text, label):
    """Return the attributes of the table cell that shows a label."""
    return re.search(rf"<TD ([^>]*)>{label}</TD>", text)[1]


def test_every_connection_is_drawn_once(loop):
    text = graph_text(loop)
    assert sorted(re.findall(r"^(\S.*) -> (\S.*?);$", text, re.MULTILINE)) == [
        ('"controller":y0:e', '"sum":u0:w'),
        ('"plant out":y0:e', '"controller":u0:w'),
        ('"sum":y0:e', '"plant in":u0:w'),
    ]


def test_a_plant_is_cut_in_two_so_that_all_runs_from_left_to_right(loop):
    text = graph_text(loop)
    assert text.count("<B>plant</B>") == 2
    assert text.count("<B>controller</B>") == 1
    assert "constraint=false" not in text


def test_ports_are_named_and_exported_ones_coloured(loop):
    text = graph_text(loop)
    assert graphviz._IMPORTED in cell(text, "u1")
    assert graphviz._PLAIN in cell(text, "u0")
    assert text.count(f'BGCOLOR="{graphviz._EXPORTED}"') == 1
    assert text.count(f'BGCOLOR="{graphviz._IMPORTED}"') == 1


def test_what_nothing_is_connected_to_shows_no_ports(loop):
    (idle,) = re.findall(r'^"idle" .*$', graph_text(loop), re.MULTILINE)
    assert "PORT" not in idle
    assert "PassThrough" in idle


def test_of_two_systems_that_feed_each_other_the_one_that_gives_more_stands_left():
    builder = DiagramBuilder()
    few, many = Integrator(1), Adder(2, 1)
    for name, system in (("few", few), ("many", many)):
        system.set_name(name)
        builder.AddSystem(system)
    for i in range(2):
        builder.Connect(few.get_output_port(), many.get_input_port(i))
    builder.Connect(many.get_output_port(), few.get_input_port())
    (turned,) = re.findall(
        r"^.*constraint=false.*$", graph_text(builder.Build()), re.MULTILINE
    )
    assert turned.startswith('"many"')


def test_a_dot_file_needs_no_program(loop, monkeypatch, outputs):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    write_graph(loop, outputs / "d.dot")
    assert (outputs / "d.dot").read_text() == graph_text(loop)
    with pytest.raises(FmpError, match="apt-get install graphviz"):
        write_graph(loop, outputs / "d.svg")
    assert [p.name for p in outputs.iterdir()] == ["d.dot"]


@pytest.mark.usefixtures("dot")
class TestPictures:
    def test_an_svg_shows_every_system(self, loop, outputs):
        write_graph(loop, outputs / "d.svg")
        root = ElementTree.parse(outputs / "d.svg").getroot()
        words = {"".join(e.itertext()) for e in root.iter() if e.tag.endswith("}text")}
        assert {"controller", "sum", "plant", "idle", "Integrator"} <= words

    def test_a_png_and_a_pdf_open(self, loop, outputs):
        write_graph(loop, outputs / "d.png")
        height, width, _ = matplotlib.image.imread(outputs / "d.png").shape
        assert width > height > 50
        write_graph(loop, outputs / "d.pdf")
        assert (outputs / "d.pdf").read_bytes().startswith(b"%PDF")
        assert len(list(outputs.iterdir())) == 2


@pytest.mark.parametrize("name", ["d.jpg", "d", "d.dot.gz"])
def test_other_endings_are_refused(name, loop, outputs):
    with pytest.raises(FmpError, match=r"end in \.svg, \.png, \.pdf or \.dot"):
        check_graph(outputs / name)
    with pytest.raises(FmpError, match="end in"):
        write_graph(loop, outputs / name)
    check_graph(None)
    check_graph(outputs / "d.dot")


def test_a_folder_that_is_missing_is_named(outputs):
    with pytest.raises(FmpError, match="there is no folder"):
        check_graph(outputs / "no" / "d.dot")


def test_a_program_that_fails_is_an_error_and_keeps_the_older(
    loop, monkeypatch, outputs
):
    older = outputs / "d.svg"
    older.write_text("precious")

    def fail(command, **_):
        raise subprocess.CalledProcessError(1, command, stderr=b"out of order")

    monkeypatch.setattr(shutil, "which", lambda name: name)
    monkeypatch.setattr(subprocess, "run", fail)
    with pytest.raises(FmpError, match="out of order"):
        write_graph(loop, older)
    assert older.read_text() == "precious"
    assert list(outputs.iterdir()) == [older]
