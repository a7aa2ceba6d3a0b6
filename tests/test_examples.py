"""Every example runs, headless, as its first lines say."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[1]
EXAMPLES = REPOSITORY / "examples"
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def run(name, folder, *options):
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *options],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONWARNINGS": "error::UserWarning"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


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


def test_skill_is_learned_saved_and_drawn(tmp_path):
    printed = run("01_learn_a_skill.py", tmp_path)
    assert "windows" in printed
    written = {p.suffix for p in (tmp_path / "out").iterdir()}
    assert {".npz", ".png"} <= written


def test_primitive_in_a_diagram_of_ones_own_is_followed(tmp_path):
    printed = run("02_primitive_in_your_diagram.py", tmp_path)
    assert "re-mapped 5 times" in printed
    assert "mm rms" in printed


@pytest.mark.slow
def test_station_wipes_the_moved_board_and_is_pushed(tmp_path):
    printed = run("03_wiping_station.py", tmp_path, "--headless", "--duration", "8")
    steps = [line for line in printed.splitlines() if "off the path" in line]
    assert len(steps) == 8
    assert sum("(pushed)" in line for line in steps) == 1
    assert "cleaned  0.0 %" not in steps[-1]


def test_tool_follows_while_it_tilts_and_its_stiffness_changes(tmp_path):
    printed = run("04_tilting_tool.py", tmp_path)
    degrees, millimetres = map(
        float, re.findall(r"most ([\d.]+) .* ([\d.]+) mm", printed)[0]
    )
    assert degrees < 0.5
    assert millimetres < 2.0
