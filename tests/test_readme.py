"""Facts about the README; ``make readme`` runs its commands."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from try_readme import opens_page, steps

import fmp_drake

REPOSITORY = Path(__file__).resolve().parents[1]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
STEPS = list(steps(README))


def test_it_installs_this_version_first_and_then_shows_two_pages():
    (_, install), *shown = STEPS[:3]
    assert install == f"pip install fmp_drake-{fmp_drake.__version__}-py3-none-any.whl"
    assert [command for _, command in shown] == ["fmp-drake wipe", "fmp-drake teach"]
    assert [what for _, what in STEPS if opens_page(what)] == [w for _, w in shown]


def test_program_is_short():
    (program,) = (what for language, what in STEPS if language == "python")
    assert len(program.strip().splitlines()) <= 16


@pytest.mark.parametrize("file", ["README.md", "CONTRIBUTING.md", "examples/README.md"])
def test_targets_of_make_exist(file):
    text = (REPOSITORY / file).read_text(encoding="utf-8")
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"`make ([\w-]+)", text)):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target


def test_links_and_pictures_are_there():
    anchors = {
        re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")
        for title in re.findall(r"^#+ (.*)", README, re.MULTILINE)
    }
    links = re.findall(r'(?:\]\(|src=")(?!http)([^)"#]*)#?([^)"]*)', README)
    assert len(links) > 5
    for file, anchor in links:
        assert (REPOSITORY / file).exists(), file
        assert not anchor or anchor in anchors, anchor


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_first_make_announces_the_environment_before_it_makes_it(tmp_path):
    for name in ("Makefile", "pyproject.toml", "constraints.txt", ".python-version"):
        shutil.copy(REPOSITORY / name, tmp_path)
    planned = subprocess.run(
        ["make", "--dry-run", "wipe"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    assert planned.index("a minute or two") < planned.index("pip install")
