"""Facts about scenarios and their files."""

import copy
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import FmpError, StationError
from fmp_drake.station import MakeStation, MakeWipingStation
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.scenario import (
    ListScenarios,
    LoadScenario,
    ParseScenario,
    Scenario,
)
from fmp_drake.station.scenario_parts import BoardConfig

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
    scene = AddBoardScene(DiagramBuilder(), scenario, start=scenario.start)
    assert scene.plant.is_finalized()


def test_table_top_is_the_default():
    scenario = LoadScenario("table_top")
    scenario.description = ""
    assert dump(scenario) == dump(Scenario())


def test_every_bundled_scenario_has_a_description():
    assert BUNDLED == ListScenarios()
    assert len({LoadScenario(name).description for name in BUNDLED}) == len(BUNDLED)
    for name in BUNDLED:
        assert LoadScenario(name).description.endswith(".")


def test_files_that_a_scenario_names_are_beside_it(write, tmp_path):
    scenario = LoadScenario(
        write("skill: {demonstration: mine.csv}\nink: {picture: cat.png}\n")
    )
    assert scenario.skill.demonstration == str(tmp_path / "mine.csv")
    (tmp_path / "dataset").mkdir()
    for name in ("mine.parquet", "MINE.CSV", "dataset"):
        skill = LoadScenario(write(f"skill: {{demonstration: {name}}}")).skill
        assert skill.demonstration == str(tmp_path / name)
    assert scenario.ink.picture == str(tmp_path / "cat.png")
    assert LoadScenario(write("skill: {demonstration: eight}")).skill.demonstration == (
        "eight"
    )
    skill = LoadScenario(write("skill: {file: skill.npz}")).skill
    assert skill.file == str(tmp_path / "skill.npz")


def test_numbers_may_be_written_without_a_point(write):
    assert LoadScenario(write("simulator: {accuracy: 1e-4}")).simulator.accuracy == 1e-4


@pytest.mark.parametrize(
    ("yaw", "expected"),
    [(0.0, (0.12, 0.05)), (90.0, (0.05, 0.12)), (180.0, (0.12, 0.05))],
)
def test_the_footprint_on_the_board_follows_the_yaw_of_the_eraser(yaw, expected):
    scenario = Scenario()
    scenario.impedance.orientation = [np.pi, 0.0, np.deg2rad(yaw)]
    assert scenario.board_footprint() == pytest.approx(expected, abs=1e-9)


def test_the_footprint_of_an_eraser_askew_is_the_rectangle_around_it():
    scenario = Scenario()
    scenario.impedance.orientation = [np.pi, 0.0, np.deg2rad(30)]
    corners = [(x, y) for x in (-0.06, 0.06) for y in (-0.025, 0.025)]
    turned = [scenario.eraser_orientation().multiply([x, y, 0.0]) for x, y in corners]
    assert scenario.board_footprint() == pytest.approx(np.ptp(turned, axis=0)[:2])


def test_name_and_path_mean_the_same():
    path = models_dir() / "scenarios" / "table_top.yaml"
    assert dump(LoadScenario(path)) == dump(LoadScenario("table_top"))
    assert dump(LoadScenario(str(path))) == dump(LoadScenario("table_top"))


def test_missing_keys_have_their_defaults(write):
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


@pytest.mark.parametrize("name", ListScenarios())
def test_bundled_scenario_equals_its_copies_and_no_changed_one(name):
    scenario = LoadScenario(name)
    for again in (
        LoadScenario(name),
        pickle.loads(pickle.dumps(scenario)),
        copy.deepcopy(scenario),
        ParseScenario(dump(scenario)),
    ):
        assert again == scenario
        assert dump(again) == dump(scenario)
    for part, key, value in (
        ("plant", "penetration_allowance", 0.02),
        ("simulator", "accuracy", 0.02),
        ("press", "force", 3.25),
    ):
        other = copy.deepcopy(scenario)
        setattr(getattr(other, part), key, value)
        assert other != scenario
    assert scenario != dump(scenario)


def test_two_scenarios_share_no_list():
    one, two = Scenario(), Scenario()
    one.board.translation[0] = 9.0
    one.start[0] = 9.0
    one.posture.append(9.0)
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


def test_a_robot_that_is_chosen_and_missing_is_not_a_fault_of_the_scenario():
    with pytest.raises(StationError, match=r"^there is no robot nothing; give "):
        LoadScenario("table_top", robot="nothing")


def test_missing_file_is_named(tmp_path):
    with pytest.raises(StationError, match=r"no scenario .*nowhere\.yaml.*table_top"):
        LoadScenario(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize(
    ("text", "reasons"),
    [
        ("arm: ur5\n", ["arm", "board", "disturbances"]),
        ("robot: nothing\n", ["there is no robot nothing", "panda"]),
        ("board: {height: 1.0}\n", ["board has no key 'height'", "translation, rpy"]),
        ("plant: {tme_step: 1.0}\n", ["plant has no key", "time_step"]),
        ("simulator: {scheme: cenic}\n", ["simulator", "integration_scheme"]),
        ("impedance: {walls: {x: 1}}\n", ["impedance.walls has no key 'x'", "width"]),
        ("board: {motion: {speed: 1}}\n", ["board.motion", "amplitude, frequency"]),
        ("board: {motion: {frequency: 5}}\n", ["board.motion.frequency", "at most 3"]),
        ("disturbances: [{knd: push}]\n", ["disturbances[0]", "kind, start"]),
        ("disturbances: [{kind: kick}]\n", ["kick", "push, grasp"]),
        ("skill: {model: best}\n", ["best", "mixture, phase, automatic"]),
        ("disturbances: 3\n", ["disturbances is 3", "a list like []"]),
        ("press: {force: hard}\n", ["press.force is 'hard'", "a number"]),
        ("press: 10\n", ["press is 10", "force, engage_height"]),
        (
            "board: {translation: 3}\n",
            ["board.translation is 3", "a list like [0.55, 0.0, 0.1]"],
        ),
        ("board: {legs: 1}\n", ["board.legs is 1", "true or false"]),
        ("ink: {words: [1]}\n", ["ink.words", "text"]),
        ("skill: {push_threshold: no}\n", ["push_threshold", "number or null"]),
        ("impedance: {damping_ratio: [1, 2]}\n", ["damping_ratio", "a number"]),
        ("board: {translation: [0, 0\n", ["while parsing"]),
        (": : :\n", ["while parsing"]),
        ("", ["None", "description, plant"]),
        ("- 1\n", ["list"]),
        # What is well written but cannot be.
        ("board: {translation: [0.5, 0.0]}", ["board.translation", "3 numbers"]),
        ("board: {rpy: [0.0, .nan, 0.0]}", ["board.rpy[1] is nan", "in rad"]),
        ("board: {size: [0.05, 0.7]}", ["board.size", "at least 0.1"]),
        ("board: {shape: saddle}", ["board.shape", "plane, cylinder, dome, bowl"]),
        ("board: {axis: z}", ["board.axis is z", "x or y"]),
        ("board: {radius: 0}", ["board.radius", "positive"]),
        (
            "board: {shape: cylinder, radius: 0.1, size: [0.5, 0.7]}",
            ["board.size", "0.700 m around a cylinder of 0.1 m", "0.628 m or less"],
        ),
        ("board: {shape: bowl, size: [0.8, 0.8]}", ["1.131 m", "0.942 m or less"]),
        ("board: {friction: -1}", ["board.friction", "at least 0"]),
        ("board: {motion: {axis: [0, 0, 0]}}", ["board.motion.axis", "a direction"]),
        ("eraser: {worn: 1.5}", ["eraser.worn", "at least 0 and at most 1"]),
        ("eraser: {modulus: 0}", ["eraser.modulus", "positive"]),
        ("ink: {words: hi, picture: x.png}", ["words and a picture"]),
        ("ink: {cell: 0}", ["ink.cell"]),
        ("ink: {cell: 0.0001}", ["ink.cell is 0.0001 m", "3.5e+07 cells", "4e+06 are"]),
        ("ink: {period: 1.0e-9}", ["ink.period", "at least 0.001"]),
        ("board: {size: [1.0e+9, 1]}", ["board.size[0]", "at most 10"]),
        ("eraser: {footprint: [1.0e+9, 1]}", ["eraser.footprint[0]", "at most 1"]),
        (
            "plant: {time_step: 1.0e-9}",
            ["plant.time_step is 1e-09 s", "at least 1e-05"],
        ),
        ("eraser: {footprint: [0.008, 0.2]}", ["eraser.footprint[0]", "than 0.01"]),
        ("simulator: {start_time: 3.0}", ["simulator.start_time must be 0"]),
        (
            "plant: {contact_model: point}",
            ["plant.contact_model is point", "hydroelastic_with_fallback"],
        ),
        ("plant: {contact_model: glue}", ["plant.contact_model is glue"]),
        (
            "impedance: {friction_compensation: {height: [1.0]}}",
            ["impedance.friction_compensation.height is [1.0]", "expected 7 numbers"],
        ),
        (
            "robot: ur5e\nfriction: {enabled: true}",
            [
                "friction.height is []",
                "The robot has none: give them, or friction.enabled: false",
            ],
        ),
        (
            "impedance: {orientation: [180, 0, 0]}",
            ["impedance.orientation[0] is 180", "not degrees"],
        ),
        (
            "simulator: {integration_scheme: foo}",
            ["simulator.integration_scheme is foo", "runge_kutta3"],
        ),
        ("simulator: {accuracy: -1}", ["simulator.accuracy is -1", "positive"]),
        ("simulator: {max_step_size: 0}", ["simulator.max_step_size is 0"]),
        ("ink: {period: 1}", ["ink.period", "at most 0.25"]),
        ("friction: {height: [1, 2]}", ["friction.height is [1.0, 2.0]", "7 numbers"]),
        ("start: [0, 0, -0.1]", ["start is 100 mm below the surface of the board"]),
        ("plant: {time_step: -0.001}", ["plant.time_step is -0.001 s", "expected 0"]),
        ("plant: {time_step: .nan}", ["plant.time_step is nan s", "expected 0"]),
        ("impedance: {control_period: 1.0e-9}", ["control_period", "at least 0.0001"]),
        ("impedance: {control_period: 0.05}", ["control_period", "at most 0.02"]),
        ("skill: {candidates: 1000000000}", ["skill.candidates", "at most 1000"]),
        ("skill: {tempo: 5}", ["skill.tempo", "at most 4"]),
        ("skill: {push_threshold: 0}", ["skill.push_threshold", "positive"]),
        ("sensors: {delay: 0.002}", ["sensors.delay needs a sensors.rate"]),
        ("sensors: {rate: 5000}", ["sensors.rate", "at most 1000"]),
        ("sensors: {rate: 1000, delay: 1.0e+9}", ["sensors.delay", "at most 1"]),
        ("camera: {eye: [0, 0, 0], target: [0, 0, 0]}", ["camera"]),
        ("disturbances: [{start: -1}]", ["start", "at least 0"]),
        ("disturbances: [{every: 0.5, duration: 1}]", ["every 0.5 s"]),
        ("start: [0.0, 0.0, .inf]", ["start"]),
        ("start: []", ["start"]),
        ("posture: [0.0, 1.0]", ["posture", "7 numbers"]),
        ("impedance: {orientation: [0.0]}", ["impedance.orientation"]),
    ],
)
def test_invalid_scenario_file_is_refused_in_one_line(write, text, reasons):
    with pytest.raises(StationError, match=r"scene\.yaml is not a scenario") as caught:
        LoadScenario(write(text))
    for reason in reasons:
        assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_board_has_the_curvatures_of_its_shape():
    expected = {
        "plane": (0.0, 0.0),
        "none": (0.0, 0.0),
        "cylinder": (0.0, 2.0),
        "dome": (2.0, 2.0),
        "bowl": (-2.0, -2.0),
    }
    for shape, curvature in expected.items():
        assert BoardConfig(shape=shape, radius=0.5).curvature() == curvature
    along_y = BoardConfig(shape="cylinder", radius=0.5, axis="y")
    assert along_y.curvature() == (2.0, 0.0)


def test_bytes_that_are_not_text_are_refused(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"\xff\xfe\x00board")
    with pytest.raises(StationError, match="is not a scenario"):
        LoadScenario(path)


def test_value_that_does_not_fit_is_named_when_the_scene_is_built(write):
    scenario = LoadScenario(write("plant: {discrete_contact_approximation: none}"))
    with pytest.raises(FmpError, match="none"):
        AddBoardScene(DiagramBuilder(), scenario, start=scenario.start)


def without_board():
    scenario = Scenario()
    scenario.board = None
    return scenario


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: MakeStation("table_top", None), "needs a scenario, such as LoadScen"),
        (
            lambda: MakeStation(without_board(), None),
            "board is None; its type must be B",
        ),
        (
            lambda: MakeWipingStation(Scenario(), "wiping"),
            "skill is 'wiping'; its type must be FourierMovementPrimitive.",
        ),
        (lambda: MakeWipingStation(Scenario(), None), "skill is None; its type must"),
        (
            lambda: MakeStation(Scenario(), None, meshcat=3),
            "meshcat is 3; its type must be Meshcat or None",
        ),
        (
            lambda: MakeStation(Scenario(), None, driver="lcm"),
            "driver is 'lcm'; its type must be Driver or None",
        ),
    ],
)
def test_argument_of_another_type_is_named_when_a_station_is_built(make, words):
    with pytest.raises(StationError, match=words):
        make()


def test_start_that_the_arm_cannot_reach_is_refused():
    with pytest.raises(StationError, match="cannot bring the eraser to"):
        AddBoardScene(DiagramBuilder(), Scenario(), start=[0.6, 0.0, 0.05])
