"""Facts about the scenarios, parts and records of `fmp-drake wipe`."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image, ImageSequence
from pydrake.common.yaml import yaml_load_typed

from fmp_drake.apps import wipe as wipe_module
from fmp_drake.apps.page import open_page
from fmp_drake.errors import RunError
from fmp_drake.film import scene as film_scene
from fmp_drake.plots.run_page import RUN_PAGE_SIGNALS
from fmp_drake.primitives import Demonstration
from fmp_drake.runs import station_run
from fmp_drake.runs.log import SIGNALS, RunLog
from fmp_drake.runs.station_run import WipingRun
from fmp_drake.skills.learning import bundled_demonstrations, default_demonstration
from fmp_drake.station.page import BOARD, INK
from fmp_drake.station.scenario import ListScenarios, LoadScenario, Scenario
from fmp_drake.station.scenario_parts import ShowConfig

SHORT = ("--headless", "--duration", 0.1)
PARTS = list(vars(ShowConfig()))
# Signals that only skills with an orientation have.
OF_POSES = {"measured_pose", "desired_orientation"}


@pytest.fixture
def runs(monkeypatch):
    """Collect the runs that the command makes."""
    made = []

    class Collected(WipingRun):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            made.append(self)

    monkeypatch.setattr(station_run, "WipingRun", Collected)
    return made


@pytest.fixture
def pages(monkeypatch):
    """Collect the pages that the command opens."""
    opened = []

    def open_and_keep(console=None, **options):
        panel = open_page(console, **options)
        opened.append(panel.meshcat)
        return panel

    monkeypatch.setattr(wipe_module, "open_page", open_and_keep)
    return opened


@pytest.fixture
def write(tmp_path):
    """The function that writes a scenario."""

    def write(text, name="scene.yaml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def wiped(command, *options):
    result = command("wipe", *SHORT, *options)
    assert result.code == 0, result
    assert result.err == ""
    return result.out


# Scenarios --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["moving_board", "vertical", "words"])
def test_scenario_of_a_name_is_simulated(command, runs, outputs, name):
    report = outputs / "report.json"
    wiped(command, "--scenario", name, "--report", report)
    (run,) = runs
    assert run.scenario.description == LoadScenario(name).description
    assert json.loads(report.read_text(encoding="utf-8"))["scenario"] == name


def test_scenario_of_a_file_is_simulated(command, runs, write):
    wiped(command, "--scenario", write("board: {motion: {amplitude: 0.02}}\n"))
    assert runs[0].scenario.board.motion.amplitude == 0.02
    assert runs[0].station.HasSubsystemNamed("rail")


def test_unknown_scenario_lists_the_known_ones(refused):
    message = refused("wipe", *SHORT, "--scenario", "billiards")
    for name in ("billiards", *ListScenarios()):
        assert name in message


def test_bad_key_of_a_scenario_lists_the_good_ones(refused, write):
    scene = write("skill: {tmepo: 1.0}\n")
    message = refused("wipe", *SHORT, "--scenario", scene)
    assert "skill has no key 'tmepo'" in message
    for key in ("tempo", "push_threshold", "candidates"):
        assert key in message


def test_options_override_the_scenario(command, runs, write):
    scene = write("skill: {sample: false, seed: 5, window: 2.0, n_components: 3}\n")
    # With such short windows the movement is fast.
    wiped(command, "--scenario", scene, "--force")
    wiped(
        *(command, "--scenario", scene, "--force", "--sample", "--seed", 7),
        *("--window", 3.0, "--n-components", 2),
    )
    own, told = runs
    for run, sample, seed, steps, components in (
        (own, False, 5, 40, 3),
        (told, True, 7, 60, 2),
    ):
        player = run.station.GetSubsystemByName("fourier_primitive").player
        assert (player.sample, player.seed, run.seed) == (sample, seed, seed)
        assert run.skill.n_steps == steps
        assert len(run.skill.components_) == components


# What is played ---------------------------------------------------------------


@pytest.mark.parametrize("name", ["eight", "polishing"])
def test_scenario_names_a_bundled_demonstration(command, runs, write, name):
    wiped(command, "--scenario", write(f"skill: {{demonstration: {name}}}\n"))
    bundled = Demonstration.load(default_demonstration(name))
    assert_array_equal(runs[0].demonstrated[0], bundled.values)


def test_scenario_names_a_demonstration_beside_it(command, runs, write, make_npz):
    recording = make_npz()
    scene = write("skill: {demonstration: circles.npz, window: 2.5}\n")
    assert f"{recording.name}: placed in" in wiped(command, "--scenario", scene)
    assert len(runs[0].demonstrated[0]) == 400


def test_scenario_names_a_skill_beside_it(command, runs, write, make_npz, tmp_path):
    demo, skill = make_npz(), tmp_path / "skill.npz"
    options = ("--window", 2.5, "--n-components", 3)
    assert command("learn", demo, "--out", skill, *options).code == 0
    # With such short windows the movement is fast.
    scene = "--scenario", write("skill: {file: skill.npz}\n"), "--force"
    assert f"loaded {skill}" in wiped(command, *scene)
    # A demonstration on the command line is learned instead.
    out = wiped(command, *scene, "--demo", demo, *options)
    assert "loaded" not in out
    loaded, learned = runs
    assert len(loaded.skill.components_) == len(learned.skill.components_) == 3
    for run in runs:
        assert len(run.demonstrated) == 1
        expected = Demonstration.load(demo).values
        assert_allclose(run.demonstrated[0], expected, atol=1e-6)


def test_unknown_demonstration_lists_the_known_ones(refused, write):
    scene = write("skill: {demonstration: dance}\n")
    message = refused("wipe", *SHORT, "--scenario", scene)
    for name in ("dance", *bundled_demonstrations()):
        assert name in message


@pytest.mark.parametrize(
    "text",
    [
        "skill: {demonstration: nowhere.csv}\n",
        "skill: {demonstration: nowhere.npz}\n",
        "skill: {file: nowhere.npz}\n",
        "ink: {picture: nowhere.png}\n",
    ],
)
def test_missing_file_of_a_scenario_is_named(refused, write, text):
    assert "nowhere." in refused("wipe", *SHORT, "--scenario", write(text))


# What is shown ----------------------------------------------------------------


def hidden(*names):
    return [part for name in names for part in ("--hide", name)]


def test_everything_is_shown_unless_it_is_hidden(command, runs, pages, outputs):
    html = outputs / "run.html"
    wiped(command, "--html", html)
    wiped(command, "--html", html, *hidden(*PARTS))
    systems = (
        *("ink_visualizer", "trail_visualizer", "plan_visualizer"),
        *("force_arrow", "page_controls"),
    )
    complete, bare = runs
    for name in systems:
        assert complete.station.HasSubsystemNamed(name), name
        assert not bare.station.HasSubsystemNamed(name), name
    for name in ("ink", "demonstrations"):
        assert pages[0].HasPath(f"{BOARD}/{name}")
        assert not pages[1].HasPath(f"{BOARD}/{name}")
    assert all(page.HasPath("bodies/panda") for page in pages)
    assert all(page.HasPath(BOARD) for page in pages)


def test_one_part_is_hidden_alone(command, runs, pages, outputs):
    wiped(command, "--html", outputs / "run.html", *hidden("ink"))
    assert not pages[0].HasPath(INK)
    assert runs[0].station.HasSubsystemNamed("trail_visualizer")
    assert vars(runs[0].scenario.show) == vars(ShowConfig(ink=False))


def test_unknown_hidden_part_lists_the_parts(refused):
    message = refused("wipe", *SHORT, "--hide", "legs")
    for part in ("legs", *PARTS):
        assert part in message


# Records ----------------------------------------------------------------------


def test_log_has_all_signals_and_the_metrics(command, runs, outputs, write):
    path, report = outputs / "run.npz", outputs / "report.json"
    scene = write(
        "description: Pushed.\n"
        "disturbances: [{start: 0.5, duration: 0.1, force: [0.0, 5.0, 0.0]}]\n"
    )
    result = command(
        *("wipe", "--headless", "--duration", 1, "--scenario", scene, "--seed", 4),
        *("--log", path, "--report", report),
    )
    assert result.code == 0, result
    assert f"wrote {path}" in result.out
    log = RunLog.load(path)
    assert set(log.signals) == set(SIGNALS) - OF_POSES
    (run,) = runs
    for name in ("ink", "erase_time"):
        assert log[name].values.shape == (1, run.grid.num_cells)
        assert_array_equal(log[name].times, [1.0])
    assert_array_equal(log["ink"].values[0], run.output("ink"))
    for name, count in (("state", 1001), ("measured_position", 201), ("weights", 26)):
        assert len(log[name].values) == count
        assert_allclose(log[name].times[[0, -1]], [0.0, 1.0])
        assert_array_equal(log[name].values, run.log(name))
    pushes = log["disturbance"]
    pushed = (pushes.times > 0.505) & (pushes.times < 0.595)
    assert_allclose(pushes.values[pushed], [[0.0, 5.0, 0.0]] * sum(pushed))
    assert log.seed == 4
    assert log.metrics == json.loads(report.read_text(encoding="utf-8"))
    scenario = yaml_load_typed(schema=Scenario, data=log.scenario)
    assert scenario.description == "Pushed."


def test_run_keeps_only_the_signals_of_its_files(command, runs, outputs):
    wiped(command)
    wiped(command, "--plot", outputs / "run.png")
    assert runs[0].kept == set()
    assert runs[1].kept == set(RUN_PAGE_SIGNALS) - {"disturbance"} - OF_POSES
    with pytest.raises(RunError, match=r"the signal state was not kept; .*keeps none"):
        runs[0].log("state")


def test_gif_shows_the_run_without_a_screen(command, outputs):
    if not film_scene.renders():
        pytest.skip("films need EGL")
    film = outputs / "run.gif"
    result = command(
        *("wipe", "--headless", "--duration", 2, "--video", film),
        *("--video-width", 96, "--video-fps", 2),
    )
    assert result.code == 0, result
    assert f"wrote {film}" in result.out
    assert list(outputs.iterdir()) == [film]
    with Image.open(film) as gif:
        frames = np.array(
            [np.array(f.convert("RGB")) for f in ImageSequence.Iterator(gif)]
        )
        assert gif.info["duration"] == 500
    assert frames.shape == (5, 72, 96, 3)
    r, g, b = np.moveaxis(frames.astype(int), -1, 0)
    ink = np.mean((b > r + 60) & (b > g + 40), axis=(1, 2))
    assert ink[0] > 0.02
    # The eraser is on the board from 1.4 s on.
    assert np.abs(frames[-1].astype(int) - frames[0]).max(axis=-1).mean() > 2


@pytest.mark.parametrize("name", ["table_top", "moving_board"])
def test_picture_of_the_diagram_names_every_system(command, runs, outputs, name):
    path = outputs / "diagram.dot"
    assert f"wrote {path}" in wiped(command, "--scenario", name, "--graphviz", path)
    text = path.read_text(encoding="utf-8")
    for system in runs[0].station.GetSystems():
        assert f"name={system.get_name()}" in text


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--log", "run.csv"), "end in .npz"),
        (("--log", "missing/run.npz"), "there is no folder"),
        (("--video", "run.avi"), "end in .mp4 or .gif"),
        (("--video", "missing/run.gif"), "there is no folder"),
        (("--video", "run.gif", "--video-fps", 0), "fps is 0"),
        (("--video", "run.gif", "--video-fps", 60), "at most 50"),
        (("--video", "run.gif", "--video-speed", 0), "speed is 0"),
        (("--video", "run.gif", "--video-width", 97), "97 x 72"),
        (("--video", "run.gif", "--video-width", 8), "from 16 to 4096"),
        (("--graphviz", "diagram.jpg"), ".svg, .png"),
        (("--graphviz", "missing/diagram.dot"), "there is no folder"),
        (("--plot", "run.xyz"), "not a picture"),
        (("--html", "missing/run.html"), "there is no folder"),
        (("--report", "."), "is a folder"),
        (("--log", "a.npz", "--report", "a.npz"), "must end in .json"),
        (("--seed", -1), "seed is -1"),
        (("--scenario", "billiards"), "no scenario billiards"),
    ],
)
def test_wrong_option_is_refused_before_the_work(
    refused, outputs, monkeypatch, options, reason
):
    def work(*_, **__):
        raise AssertionError("it began to work")

    monkeypatch.setattr(wipe_module, "scenario_skill", work)
    monkeypatch.setattr(wipe_module, "MakeRun", work)
    monkeypatch.chdir(outputs)
    assert reason in refused("wipe", *SHORT, *options)
    assert list(outputs.iterdir()) == []
