"""Facts about names: one for each quantity on the page, in commands, YAML and Python."""

import inspect
from dataclasses import fields
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import click
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from fmp_drake.apps.commands import app
from fmp_drake.experiments.benchmark import run_benchmark
from fmp_drake.experiments.benchmark.cleaning import run_cleaning
from fmp_drake.experiments.trials import TrialSpec, run_trials
from fmp_drake.experiments.trials.running import replay_trial
from fmp_drake.film import FilmReel, film_run
from fmp_drake.film.encode import convert_frames
from fmp_drake.primitives import (
    FourierMovementPrimitive,
    Player,
    ReadingOptions,
    find_rhythm,
)
from fmp_drake.runs import MakeRun, StationRun, TeachingSession
from fmp_drake.runs.arm_bench import ArmBench, NetworkFaults
from fmp_drake.runs.arm_run import ArmRun
from fmp_drake.skills import learn_skill, load_on_board, scenario_skill
from fmp_drake.station import LcmPanda, LoadScenario, MakeStation, Scenario
from fmp_drake.systems import FourierPrimitiveSystem, PagePanel
from fmp_drake.systems.page.page_controls import PageControls
from fmp_drake.systems.teaching.hand_motion import HandMotion


class Quantity(NamedTuple):
    """Where a quantity has a name beside its option: a slider, a YAML key, parameters."""

    python: tuple = ()
    yaml: str = ""
    has_slider: bool = False


READING = (ReadingOptions,)
LEARNING = (scenario_skill, load_on_board)
PARTS = (FourierMovementPrimitive.fit, find_rhythm, learn_skill)
QUANTITIES = {
    # On the page, too.
    "tempo": Quantity((PageControls,), "skill.tempo", has_slider=True),
    "press_force": Quantity((PageControls,), "press.force", has_slider=True),
    "sample": Quantity(
        (Player, FourierPrimitiveSystem, MakeStation, PageControls),
        "skill.sample",
        has_slider=True,
    ),
    # In scenarios, too.
    "seed": Quantity(
        (Player, FourierPrimitiveSystem, StationRun, HandMotion.make, NetworkFaults),
        "skill.seed",
    ),
    "n_components": Quantity(
        (FourierMovementPrimitive, learn_skill, scenario_skill), "skill.n_components"
    ),
    "window": Quantity(
        (FourierMovementPrimitive, learn_skill, scenario_skill), "skill.window"
    ),
    "model": Quantity(
        (FourierMovementPrimitive, learn_skill, scenario_skill), "skill.model"
    ),
    "demonstration": Quantity(
        (scenario_skill, learn_skill, StationRun), "skill.demonstration"
    ),
    "skill_file": Quantity((scenario_skill, TeachingSession), "skill.file"),
    "robot": Quantity((LoadScenario, TrialSpec.load), "robot"),
    "start": Quantity((MakeStation,), "start"),
    "target_realtime_rate": Quantity((), "simulator.target_realtime_rate"),
    "controls": Quantity((), "show.controls"),
    # In Python, too.
    "scenario": Quantity((MakeRun, scenario_skill, ArmRun)),
    "duration": Quantity(
        (
            *(Player.rollout, HandMotion.make, ArmBench.play, ArmRun.play),
            *(TrialSpec.plan, replay_trial, run_cleaning),
        )
    ),
    "start_time": Quantity(PARTS),
    "end_time": Quantity(PARTS),
    "period": Quantity(PARTS),
    "stretch": Quantity(LEARNING),
    "transform": Quantity(LEARNING),
    "surface": Quantity(LEARNING),
    "extra": Quantity(LEARNING),
    "columns": Quantity(READING),
    "unit": Quantity(READING),
    "sample_rate": Quantity(READING),
    "topic": Quantity(READING),
    "quaternions": Quantity(READING),
    "task": Quantity((HandMotion.make,)),
    "drop": Quantity((NetworkFaults,)),
    "reorder": Quantity((NetworkFaults,)),
    "corrupt": Quantity((NetworkFaults,)),
    "jitter": Quantity((NetworkFaults,)),
    "host": Quantity((PagePanel,)),
    "fps": Quantity((FilmReel, convert_frames)),
    "speed": Quantity((FilmReel,)),
    "width": Quantity((film_run,)),
    "method": Quantity((run_benchmark, run_cleaning)),
    "count": Quantity((run_trials,)),
    "force": Quantity((run_trials,)),
    "jobs": Quantity(),
    "html": Quantity((replay_trial,)),
    "video": Quantity((replay_trial,)),
}
# Files, switches and choices that only the command line has.
ONLY_OPTIONS = {
    *("arm", "as_recorded", "board", "clean", "cluster", "graphviz", "headless"),
    *("help_all", "hide", "log", "markdown", "move_board", "out", "page"),
    *("parquet", "plot", "quick", "real_time", "replay", "report", "go", "dry"),
}
# What options of `wipe` about the film begin with.
PREFIX = "video_"


def option_names():
    """Return the names of all options, each with its command."""
    names = {}
    with click.Context(app) as context:
        for command in app.list_commands(context):
            for parameter in app.get_command(context, command).params:
                if isinstance(parameter, click.Option) and not parameter.hidden:
                    name = parameter.opts[0].removeprefix("--").replace("-", "_")
                    names.setdefault(name.removeprefix(PREFIX), command)
    return names


def test_every_option_has_the_name_of_a_known_quantity():
    assert option_names().keys() == QUANTITIES.keys() | ONLY_OPTIONS


@pytest.mark.parametrize("name", QUANTITIES)
def test_a_quantity_has_one_name_in_scenarios_and_python(name):
    quantity = QUANTITIES[name]
    for function in quantity.python:
        parameters = inspect.signature(function).parameters
        assert {name, f"{name}s"} & parameters.keys(), function
    if quantity.yaml:
        reduce(getattr, quantity.yaml.split("."), Scenario())
        assert f"_{quantity.yaml.replace('.', '_')}".endswith(f"_{name}")


def test_sliders_have_the_names_of_quantities():
    meshcat = Meshcat()
    Simulator(PageControls(meshcat)).Initialize()
    labels = [label.partition(" (")[0] for label in meshcat.GetSliderNames()]
    expected = [name for name, quantity in QUANTITIES.items() if quantity.has_slider]
    assert sorted(label.replace(" ", "_") for label in labels) == sorted(expected)


def test_parts_that_can_be_hidden_and_gates_have_the_names_of_yaml():
    with click.Context(app) as context:
        hide = next(
            p for p in app.get_command(context, "wipe").params if p.name == "hide"
        )
    assert list(hide.type.choices) == [field.name for field in fields(Scenario().show)]
    assert LcmPanda().gate.dry is False


@pytest.mark.parametrize(
    ("arguments", "parameter", "value"),
    [
        (["worlds", "default", "--seconds", "3"], "duration", 3.0),
        (["worlds", "default", "--page=a.md"], "markdown", Path("a.md")),
        (["wipe", "--components", "4"], "n_components", 4),
        (["learn", "a.npz", "--out", "b.npz", "--from", "1.5"], "start_time", 1.5),
        (["record", "--hand", "eight", "--out", "a.npz"], "task", "eight"),
    ],
)
def test_a_former_option_still_works(arguments, parameter, value):
    name, *others = arguments
    with click.Context(app) as context:
        command = app.get_command(context, name)
        assert command.make_context(name, others).params[parameter] == value


def test_a_former_duration_is_checked(refused, tmp_path):
    error = refused("record", "--minutes", "-1", "--out", tmp_path / "a.npz")
    assert "minutes" in error


def test_a_key_of_yaml_with_another_name_is_refused_with_the_right_one(
    refused, tmp_path
):
    file = tmp_path / "old.yaml"
    file.write_text("skill: {components: 8}\n")
    assert "did you mean n_components?" in refused("check", "--scenario", file)
