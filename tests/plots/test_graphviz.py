"""Facts about the pictures of diagrams."""

import shutil
import subprocess
from xml.etree import ElementTree

import matplotlib.image
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain, Integrator, PassThrough

from fmp_drake.errors import FmpError
from fmp_drake.plots.run_page import check_graph, write_graph


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


def test_picture_shows_connections_and_exported_ports(loop, outputs):
    write_graph(loop, outputs / "d.dot")
    text = (outputs / "d.dot").read_text()
    for name in ("controller", "sum", "plant", "idle", "feed_forward", "state"):
        assert name in text
    # Inputs and outputs of the plant stand apart.
    assert text.count("name=plant") == 2
    assert text.count("name=controller") == 1


def test_a_dot_file_needs_no_program(loop, monkeypatch, outputs):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    write_graph(loop, outputs / "d.dot")
    assert (outputs / "d.dot").read_text().startswith("digraph")
    with pytest.raises(FmpError, match="apt-get install graphviz"):
        write_graph(loop, outputs / "d.svg")
    assert [p.name for p in outputs.iterdir()] == ["d.dot"]


@pytest.mark.usefixtures("dot")
class TestPictures:
    def test_an_svg_shows_every_system(self, loop, outputs):
        write_graph(loop, outputs / "d.svg")
        root = ElementTree.parse(outputs / "d.svg").getroot()
        words = {"".join(e.itertext()) for e in root.iter() if e.tag.endswith("}text")}
        names = {f"name={name}" for name in ("controller", "sum", "plant", "idle")}
        assert names | {"Integrator"} <= words

    def test_a_png_and_a_pdf_open(self, loop, outputs):
        write_graph(loop, outputs / "d.png")
        height, width, _ = matplotlib.image.imread(outputs / "d.png").shape
        assert min(width, height) > 50
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
