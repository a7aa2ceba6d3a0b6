"""Facts about scenarios and their files."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import FmpError, StationError
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.model_files import models_dir
from fmp_drake.station.scenario import LoadScenario, Scenario

BUNDLED = sorted(path.stem for path in (models_dir() / "scenarios").glob("*.yaml"))


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "scene.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def dump(scenario):
    return yaml_dump_typed(scenario)


@pytest.mark.parametrize("name", BUNDLED)
def test_bundled_scenario_builds(name):
    scenario = LoadScenario(name)
    scene = AddBoardScene(DiagramBuilder(), scenario, start=scenario.start_position())
    assert scene.plant.is_finalized()


def test_table_top_is_the_default():
    assert dump(LoadScenario("table_top")) == dump(Scenario())


def test_name_and_path_mean_the_same():
    path = models_dir() / "scenarios" / "table_top.yaml"
    assert dump(LoadScenario(path)) == dump(LoadScenario("table_top"))
    assert dump(LoadScenario(str(path))) == dump(LoadScenario("table_top"))


def test_what_is_left_out_keeps_its_default(write):
    scenario = LoadScenario(write("press: {force: 6.5}\n"))
    assert scenario.press.force == 6.5
    scenario.press.force = Scenario().press.force
    assert dump(scenario) == dump(Scenario())


def test_scenario_survives_a_round_trip(write):
    scenario = Scenario()
    scenario.board.translation = [0.45, 0.1, 0.15]
    scenario.board.rpy = [0.1, 0.2, 0.3]
    scenario.impedance.translational_stiffness = [800.0, 900.0, 100.0]
    scenario.press.engage_height = 0.02
    scenario.ink.cell = 0.01
    scenario.start = [0.01, 0.02, 0.03]
    scenario.plant.time_step = 0.0005
    again = LoadScenario(write(dump(scenario)))
    assert dump(again) == dump(scenario)
    assert dump(yaml_load_typed(schema=Scenario, data=dump(scenario))) == dump(scenario)


def test_two_scenarios_share_no_list():
    one, two = Scenario(), Scenario()
    one.board.translation[0] = 9.0
    one.start[0] = 9.0
    one.posture[0] = 9.0
    assert dump(two) == dump(Scenario())


def test_pose_of_the_board_is_roll_pitch_yaw(write):
    scenario = LoadScenario(
        write("board: {translation: [0.5, 0.1, 0.2], rpy: [0.0, -0.3, 0.2]}\n")
    )
    X_WB = scenario.board.pose()
    assert_allclose(X_WB.translation(), [0.5, 0.1, 0.2])
    normal = [
        np.cos(0.2) * np.sin(-0.3),
        np.sin(0.2) * np.sin(-0.3),
        np.cos(-0.3),
    ]
    assert_allclose(X_WB.rotation().col(2), normal, atol=1e-12)


def test_eraser_is_held_with_its_felt_to_the_board():
    R_BE = Scenario().eraser_orientation()
    assert_allclose(R_BE.matrix(), np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(StationError, match="no scenario billiards") as caught:
        LoadScenario("billiards")
    for name in BUNDLED:
        assert name in str(caught.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(StationError, match=r"no scenario .*nowhere\.yaml.*table_top"):
        LoadScenario(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("robot: ur5\n", "robot"),
        ("board: {height: 1.0}\n", "height"),
        ("press: {force: hard}\n", "hard"),
        ("press: 10\n", "10"),
        ("board: {translation: 3}\n", "not iterable"),
        ("impedance: {damping_ratio: [1, 2]}\n", "damping_ratio"),
        ("board: {translation: [0, 0\n", "while parsing"),
        (": : :\n", "while parsing"),
        ("", "NoneType"),
        ("- 1\n", "list"),
    ],
)
def test_file_that_is_no_scenario_is_refused_in_one_line(write, text, reason):
    with pytest.raises(StationError, match=r"scene\.yaml is not a scenario") as caught:
        LoadScenario(write(text))
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"\xff\xfe\x00board")
    with pytest.raises(StationError, match="is not a scenario"):
        LoadScenario(path)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("board: {translation: [0.5, 0.0]}", "board.translation"),
        ("board: {rpy: [0.0, .nan, 0.0]}", "board.rpy"),
        ("start: [0.0, 0.0, .inf]", "start"),
        ("start: []", "start"),
        ("posture: [0.0, 1.0]", "posture"),
        ("impedance: {orientation: [0.0]}", "impedance.orientation"),
        ("plant: {time_step: -0.001}", "plant.time_step"),
        ("plant: {time_step: .nan}", "plant.time_step"),
        ("plant: {contact_model: glue}", "glue"),
        ("plant: {discrete_contact_approximation: none}", "none"),
    ],
)
def test_value_that_does_not_fit_is_named_when_the_scene_is_built(write, text, what):
    scenario = LoadScenario(write(text))
    with pytest.raises(FmpError, match=what.replace(".", r"\.")):
        AddBoardScene(DiagramBuilder(), scenario, start=scenario.start_position())


def test_start_that_the_arm_cannot_reach_is_refused():
    with pytest.raises(StationError, match="cannot bring the eraser to"):
        AddBoardScene(DiagramBuilder(), Scenario(), start=[0.6, 0.0, 0.05])
