"""Facts about the site: its programs run, and its commands are valid."""

import re
import runpy
import shlex
import sys
from importlib.metadata import version
from pathlib import Path

import click
import numpy as np
import pytest

from fmp_drake.apps.commands import app
from fmp_drake.skills import scenario_skill
from fmp_drake.station import CheckFeasibility, ParseScenario
from fmp_drake.systems.panda.arm_status import FAULTS, GateFault, faults_in_words

SITE = Path(__file__).resolve().parents[1] / "examples" / "site"
PAGES = sorted(SITE.glob("[!g]*.rst")) + sorted(SITE.glob("[ht]*/*.rst"))


def blocks(language, path):
    """Return the blocks of a language on a page, without their indentation."""
    found = re.findall(
        rf"^\.\. code-block:: {language}\n\n((?:   .*\n|\n)+)",
        path.read_text("utf-8"),
        flags=re.MULTILINE,
    )
    return [re.sub(r"^   ", "", block, flags=re.MULTILINE) for block in found]


PROGRAMS = [
    page.relative_to(SITE).as_posix() for page in PAGES if blocks("python", page)
]


def commands():
    for path in PAGES:
        for line in "".join(blocks("sh", path)).splitlines():
            words = [w for w in shlex.split(line, comments=True) if w != "&"]
            if words:
                yield pytest.param(words, id=" ".join(words))


@pytest.mark.parametrize("words", list(commands()))
def test_command_is_understood(words):
    program, name, *options = words
    if program == "make":
        assert f"\n{name}: " in (SITE.parents[1] / "Makefile").read_text("utf-8")
        return
    if program == "pip":
        assert options == [f"fmp_drake-{version('fmp-drake')}-py3-none-any.whl"]
        return
    assert program == "fmp-drake"
    with click.Context(app) as context:
        app.get_command(context, name).make_context(name, options)


def test_faults_of_an_arm_have_the_words_of_the_page():
    text = (SITE / "real_arm.rst").read_text("utf-8")
    for fault in GateFault:
        row = re.search(rf"^{fault.name} +(.+)$", text, flags=re.MULTILINE)[1]
        assert faults_in_words(fault) == f"{FAULTS[fault]} ({fault.name})"
        assert row.startswith(FAULTS[fault])
    both = faults_in_words(GateFault.STALE | GateFault.GAP)
    assert re.fullmatch(r"no recent status, .*\(STALE\); .* paused: .* \(GAP\)", both)


def test_scenarios_are_understood():
    texts = [text for path in PAGES for text in blocks("yaml", path)]
    scenarios = [text for text in texts if not text.startswith("model:")]
    assert len(scenarios) > 3
    for text in scenarios:
        ParseScenario(text)


def test_skills_can_be_followed_on_the_boards_that_are_described():
    texts = blocks("yaml", SITE / "howto" / "boards.rst")
    scenarios = [ParseScenario(text) for text in texts if "demonstration: " in text]
    assert len(scenarios) > 1
    for scenario in scenarios:
        skill, *_ = scenario_skill(scenario)
        found = CheckFeasibility(scenario, skill)
        assert found.is_feasible, found.verdict


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_of_a_page_run_one_after_the_other(
    name, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    time = np.arange(800) / 20
    path = [0.1 * np.cos(2.1 * time), 0.2 * np.sin(2.1 * time), 0 * time]
    table = np.column_stack([time, *path])
    np.savetxt("my_motion.csv", table, delimiter=",", header="time,x,y,z", comments="")
    program = tmp_path / "program.py"
    program.write_text("".join(blocks("python", SITE / name)), "utf-8")
    runpy.run_path(str(program))
    assert "cannot follow" not in capsys.readouterr().out


def test_dead_links_are_found(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(SITE))
    from links import dead_links

    (tmp_path / "one.html").write_text(
        '<a href="two.html#there">.</a><a href="https://drake.mit.edu/no#where">.</a>'
        '<a href="two.html#nowhere">.</a><img src="none.png"><a href="#top">.</a>'
    )
    (tmp_path / "two.html").write_text('<p id="there"><a href="one.html">.</a></p>')
    assert [line.rsplit(" ", 1)[1] for line in dead_links(tmp_path)] == [
        "#top",
        "none.png",
        "two.html#nowhere",
    ]
    sys.modules.pop("links")
