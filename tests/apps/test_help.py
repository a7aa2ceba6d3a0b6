"""Facts about the command line before a command runs."""

import logging
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from click import Context
from threadpoolctl import threadpool_info

from fmp_drake.apps.commands import app
from fmp_drake.apps.options import (
    LearningOptions,
    RecordingOptions,
    SceneOptions,
    arguments,
)
from fmp_drake.skills import scenario_skill
from fmp_drake.station import CheckFeasibility, LoadScenario

# Imported by the commands, and slow.
HEAVY = "{'numpy', 'pydrake', 'matplotlib', 'sklearn', 'numba', 'rich'}"


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_import_no_command(option):
    code = f"""
import sys
from fmp_drake.apps.main import main
main(["{option}"])
assert not {HEAVY} & set(sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert "fmp-drake" in done.stdout or "wipe" in done.stdout


def test_help_lists_the_description_of_each_command(command):
    text = " ".join(command("--help").out.split())
    with Context(app) as context:
        for name in app.list_commands(context):
            explained = app.get_command(context, name).help
            summary = " ".join(explained.split("\n\n")[0].split())
            assert f" {name} {summary}" in text


def test_unknown_command_is_refused(refused):
    assert "mop" in refused("mop")


def test_a_command_computes_with_one_thread_of_blas():
    with Context(app) as context:
        app.get_command(context, "learn")
        assert {pool["num_threads"] for pool in threadpool_info()} == {1}


def test_log_messages_are_one_line_on_stderr(command, capsys):
    command("--help")
    command("--help")
    logging.getLogger("fmp_drake").info("compiling")
    assert capsys.readouterr().err == "fmp-drake: compiling\n"


def options_in(text):
    return set(re.findall(r"^  (?:-\w, )?(--[\w-]+)", text, flags=re.MULTILINE))


def test_short_help_has_twelve_options_and_the_long_one_all(command):
    short = options_in(command("wipe", "--help").out) - {"--help", "--help-all"}
    complete = options_in(command("wipe", "--help-all").out)
    assert 6 <= len(short) <= 12
    assert short < complete
    assert {"--tempo", "--scenario", "--demonstration", "--skill-file"} <= short
    assert {"--video-fps", "--host", "--transform", "--seed"} <= complete - short


@pytest.mark.parametrize("name", app.list_commands(Context(app)))
def test_help_of_every_command_has_at_most_twelve_options(command, name):
    options = options_in(command(name, "--help").out) - {"--help", "--help-all"}
    assert len(options) <= 12


def test_command_with_few_options_shows_all_of_them(command):
    text = command("inspect", "--help").out
    assert "--help-all" not in text
    assert {"--columns", "--unit", "--sample-rate", "--topic"} <= options_in(text)


@pytest.mark.parametrize(
    "name", ["wipe", "check", "learn", "inspect", "teach", "worlds"]
)
def test_examples_of_the_help_are_command_lines_that_parse(name):
    with Context(app) as context:
        command = app.get_command(context, name)
        text = command.get_help(Context(command, info_name=name))
        lines = re.findall(r"^  fmp-drake (.*)$", text, flags=re.MULTILINE)
        assert lines
        for line in lines:
            _, *arguments = shlex.split(line)
            command.make_context(name, arguments)


def test_tempo_and_force_are_those_of_the_scenario_unless_they_are_given(refused):
    assert SceneOptions().load().skill.tempo == LoadScenario("table_top").skill.tempo
    assert SceneOptions(tempo=0.7).load().skill.tempo == 0.7
    assert SceneOptions(press_force=6.5).load().press.force == 6.5
    assert "tempo is -1" in refused("check", "--tempo", -1)
    # Before a recording is read.
    assert "tempo is 80" in refused("check", "--tempo", 80, "--demo", "missing.csv")
    assert "press.force is 500" in refused("check", "--press-force", 500)


def test_a_skill_that_is_too_fast_is_refused_with_a_command_that_works(refused):
    message = refused("wipe", "--headless", "--tempo", 2.0)
    line = re.search(r"Try: fmp-drake (wipe .*--tempo [\d.]+) \(--force", message)[1]
    assert 0 < float(line.split()[-1]) < 1.5
    options = SceneOptions(tempo=float(line.split()[-1]))
    scenario = options.load()
    skill, _, _ = scenario_skill(scenario)
    assert CheckFeasibility(scenario, skill).is_feasible


def test_a_press_that_is_too_strong_is_refused_with_a_force_that_works(refused):
    message = refused("wipe", "--headless", "--press-force", 50)
    assert "Try: fmp-drake wipe --press-force 30" in message


def test_a_suggested_move_of_the_board_is_added_to_the_given_one(refused):
    given = ("--robot", "iiwa14", "--move-board", 0.5, 0.0, 0.0)
    message = refused("wipe", "--headless", *given)
    line = re.search(r"Try: fmp-drake (wipe .*) \(--force", message)[1]
    flags = [*shlex.split(line)[1:]]
    context = app.get_command(Context(app), "wipe").make_context("wipe", flags)
    options = SceneOptions(
        **{f.name: context.params[f.name] for f in fields(SceneOptions)}
    )
    assert 0 <= options.move_board[0] < 0.5
    scenario = options.load()
    skill, _, _ = scenario_skill(scenario)
    assert CheckFeasibility(scenario, skill).is_feasible


def test_suggested_command_gives_the_options_that_were_given():
    scene = SceneOptions(
        scenario="iiwa_wipes",
        demonstrations=(Path("a.csv"), Path("my b.npz")),
        start=(0.1, 0, -0.2),
    )
    learning = LearningOptions(surface="fitted", extra=("orientation", "force"))
    recording = RecordingOptions(quaternions="wxyz")
    flags = arguments(scene, learning, recording)
    assert " ".join(flags) == (
        "--scenario iiwa_wipes --demo a.csv --demo my b.npz --start 0.1 0 -0.2 --surface "
        "fitted --extra orientation --extra force --quaternions wxyz"
    )
    command = app.get_command(Context(app), "wipe")
    read = command.make_context("wipe", flags).params
    assert read["demonstrations"] == scene.demonstrations
    assert read["start"] == scene.start
    assert read["extra"] == learning.extra
    assert arguments(SceneOptions(), LearningOptions(), RecordingOptions()) == []


@pytest.mark.parametrize("name", ["benchmark", "reproduce", "video", "arm", "inspect"])
def test_options_are_apart_from_help_and_examples_follow(command, name):
    text = command(name, "--help").out
    help_section = text.partition("\nHelp:\n")[2].partition("\nExamples:\n")
    assert options_in(help_section[0]) == {"--help"}
    assert f"fmp-drake {name}" in help_section[2]
