"""Facts about CONTRIBUTING.md: its files, names and commands exist."""

import ast
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PAGE = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
STEPS = re.findall(
    r"^\d+\. +(`fmp_drake.*?)(?=^\d+\. |\Z)", PAGE, re.DOTALL | re.MULTILINE
)


def quoted(text):
    return re.findall(r"`([^`]+)`", text)


def defined(module):
    """Return the names of the functions, classes and methods of a module."""
    names = set()
    for node in ast.parse((REPOSITORY / module).read_text("utf-8")).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {
                f"{node.name}.{each.name}"
                for each in node.body
                if isinstance(each, ast.FunctionDef)
            }
    return names


def test_every_file_and_folder_is_there():
    paths = [name for name in quoted(PAGE) if name.startswith("fmp_drake/")]
    assert len(paths) > 30
    assert [path for path in paths if not (REPOSITORY / path).exists()] == []


def test_walk_passes_through_the_rooms_in_order():
    rooms = [re.match(r"`fmp_drake/(\w+)", step)[1] for step in STEPS]
    assert rooms[:6] == ["primitives"] * 6
    assert set(rooms[6:-1]) == {"systems", "station"}
    assert rooms[-1] == "runs"


@pytest.mark.parametrize("step", STEPS, ids=range(1, len(STEPS) + 1))
def test_every_name_of_a_step_is_in_its_files(step):
    modules = [name for name in quoted(step) if name.endswith(".py")]
    names = {name for name in quoted(step) if not name.endswith(".py")}
    assert names <= set().union(*map(defined, modules))


def test_targets_of_make_exist():
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"`make (\w+)", PAGE)):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
