"""Facts about the README; ``make readme`` runs its commands."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
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


def readme_claims(pattern):
    """Return the figures that a sentence of the README contains."""
    found = re.search(pattern, " ".join(README.split()))
    assert found, pattern
    return [float(figure) for figure in found.groups()]


def test_figures_of_predictions_are_those_of_the_results():
    results = (REPOSITORY / "examples/site/results.rst").read_text(encoding="utf-8")
    real, simulated = results.split("Simulated recordings\n----")
    (ratio,) = readme_claims(r"error of the next second is ([\d.]+) of")
    assert f"the error is {ratio:.2f} of replay's" in real
    least, most = readme_claims(r"(\d+) to (\d+) % of the positions")
    row = re.search(r"\* - FMP\n(?:     - .*\n){2}     - (.*)", real)[1]
    covered = [float(figure) for figure in row.split(" / ")]
    assert (least, most) == (min(covered), max(covered))
    held_out = dict(re.findall(r"\* - (.*)\n     - (\d[\d.]+) / .* / ", simulated))
    methods = (
        "FMP",
        "Gaussian process, delay embedding",
        "replay of the most similar past",
        "ProMP, own frequencies",
    )
    claimed = readme_claims(
        r"error of ([\d.]+) mm \(Gaussian process ([\d.]+), replay ([\d.]+), ProMP ([\d.]+)\)"
    )
    assert claimed == [float(held_out[method]) for method in methods]


def test_figures_of_scenarios_are_those_of_their_page():
    page = (REPOSITORY / "models/scenarios/README.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| [")]
    with_board = [row for row in rows if row[1] != "-"]
    cleaned = [float(row[1].removesuffix(" %")) for row in with_board]
    near = [float(row[4].split("/")[1].removesuffix(" %")) for row in with_board]
    least, most, fraction = readme_claims(
        r"cleans ([\d.]+) to ([\d.]+) % of .* at least ([\d.]+) % of the time"
    )
    assert (least, most) == (min(cleaned), max(cleaned))
    assert fraction == min(near)


def test_figures_of_trials_are_those_of_their_page():
    page = (REPOSITORY / "models/worlds/README.md").read_text(encoding="utf-8")
    first = page.split("\n## ")[1]
    rows = re.findall(
        r"^\| (accepted|refused).* \| (\d+) \| (\d+) \| (\d+) \|$", first, re.MULTILINE
    )
    counts = {kind: np.zeros(3, int) for kind, *_ in rows}
    for kind, *numbers in rows:
        counts[kind] += np.array(numbers, int)
    number, refused, run, feasible, accepted, passed = readme_claims(
        r"Of \[(\d+) randomised ones\]\S* (\d+) are refused .* \((\d+) of them were run "
        r"anyway, and (\d+) pass\); of the other (\d+), (\d+) pass"
    )
    assert [accepted, accepted, passed] == counts["accepted"].tolist()
    assert [refused, run, feasible] == counts["refused"].tolist()
    assert number == accepted + refused


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
