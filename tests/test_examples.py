"""Every example runs, headless, as its first lines say."""

import ast
import re
import runpy
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[1]
EXAMPLES = REPOSITORY / "examples"
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """The function that runs an example in an empty folder and returns what it prints."""

    def run(name, *options):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [name, *options])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_every_example_is_run_here():
    names = {p.name for p in EXAMPLES.glob("*.py")}
    assert names == {
        "01_learn_a_skill.py",
        "02_primitive_in_your_diagram.py",
        "03_wiping_station.py",
        "04_tilting_tool.py",
    }


def test_readme_and_examples_enter_by_the_front_doors():
    programs = {path.name: path.read_text("utf-8") for path in EXAMPLES.glob("*.py")}
    programs["README.md"] = "".join(
        re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    )
    imported = {
        (program, node.module)
        for program, source in programs.items()
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("fmp_drake")
    }
    assert {program for program, _ in imported} == set(programs)
    assert not [each for each in imported if each[1].count(".") > 1]


def test_skill_is_learned_saved_and_drawn(run, tmp_path):
    printed = run("01_learn_a_skill.py")
    assert "windows" in printed
    written = {p.suffix for p in (tmp_path / "out").iterdir()}
    assert {".npz", ".png"} <= written


def test_primitive_in_a_diagram_of_ones_own_is_followed(run):
    printed = run("02_primitive_in_your_diagram.py")
    assert "re-mapped 5 times" in printed
    assert "mm rms" in printed


def test_station_wipes_the_moved_board_and_is_pushed(run):
    printed = run("03_wiping_station.py", "--headless", "--duration", "7")
    steps = [line for line in printed.splitlines() if "off the path" in line]
    assert len(steps) == 7
    assert sum("(pushed)" in line for line in steps) == 1
    assert "cleaned  0.0 %" not in steps[-1]


def test_tool_follows_while_it_tilts_and_its_stiffness_changes(run):
    printed = run("04_tilting_tool.py")
    degrees, millimetres = map(
        float, re.findall(r"most ([\d.]+) .* ([\d.]+) mm", printed)[0]
    )
    assert degrees < 0.5
    assert millimetres < 2.0
