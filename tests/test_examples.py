"""Facts about the examples: each runs headless, with its documented output."""

import ast
import re
import runpy
import sys
from importlib import import_module
from pathlib import Path

import matplotlib.pyplot as plt
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

    yield run
    plt.close("all")


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
    assert not [
        each for each in imported if not hasattr(import_module(each[1]), "__all__")
    ]


# What each prints: an expression with groups, and what must hold of them.
FACTS = {
    "01_learn_a_skill.py": (r"(\d+) windows", lambda windows: windows > 1000),
    "02_primitive_in_your_diagram.py": (
        r"tracking error ([\d.]+) mm rms[^\0]*re-mapped (\d+) times",
        lambda error, remaps: error < 5 and remaps == 6,
    ),
    "03_wiping_station.py": (
        r"error +([\d.]+) mm.*cleaned +([\d.]+) %  \(pushed\)",
        lambda error, cleaned: error > 5 and cleaned > 10,
    ),
    "04_teach_by_mouse.py": (
        r"learned in ([\d.]+) s\nwiping: (\d+) %",
        lambda _, cleaned: cleaned > 20,
    ),
    "05_your_own_robot.py": (
        r"six joints: ([\d.]+) mm rms",
        lambda error: error < 2.0,
    ),
    "06_tilting_tool.py": (
        r"most ([\d.]+) .* ([\d.]+) mm",
        lambda degrees, distance: degrees < 0.5 and distance < 2.0,
    ),
    "07_keypoints.py": (
        r"desired y = ([\d.]+) m, result ([\d.]+) m",
        lambda desired, result: abs(desired - result) < 1e-3,
    ),
    "08_several_demonstrations.py": (
        r"sample: ([\d.]+) m, ([\d.]+) m",
        lambda equal, weighted: weighted < equal,
    ),
    "09_orientation.py": (
        r"up to ([\d.]+) degrees; demonstrated ([\d.]+)",
        lambda played, demonstrated: abs(played - demonstrated) < 5,
    ),
    "10_tempo_and_editing.py": (
        r"speed ([\d.]+) and ([\d.]+) m/s",
        lambda speed, fast_speed: 1.3 < fast_speed / speed < 1.7,
    ),
    "11_discrete_movement.py": (
        r"via-point at ([\d.]+) mm",
        lambda distance: distance < 1,
    ),
    "12_soft_where_people_vary.py": (
        r"table_top: (\d+) mm[^\0]*gentle: (\d+) mm",
        lambda stiff, soft: stiff < soft,
    ),
    "13_force_profile.py": (
        r"force error ([\d.]+) N rms",
        lambda error: error < 2.5,
    ),
    "14_compare_on_your_data.py": (
        r"phase +([\d.]+) mm\nreplay +([\d.]+) mm",
        lambda phase, replay: phase < replay,
    ),
    "15_log_of_a_run.py": (r"cleaned (\d+) % in 10 s", lambda cleaned: cleaned > 15),
    "16_worlds.py": (r"cleaned (\d+) % in 3 s", lambda cleaned: cleaned > 5),
    "17_phase.py": (r"one cycle takes ([\d.]+) s", lambda period: 2 < period < 5),
}


def test_every_example_is_run_here():
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(FACTS)


@pytest.mark.parametrize("name", FACTS)
def test_example_prints_its_documented_output(run, name):
    pattern, holds = FACTS[name]
    printed = run(name)
    found = re.search(pattern, printed)
    assert found, printed
    assert holds(*map(float, found.groups())), printed
